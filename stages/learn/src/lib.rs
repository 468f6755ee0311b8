//! The learning stages: PPO, behaviour cloning, the ensemble, DRIL, collecting and evaluating.
