//! DRIL's reward: the ensemble's disagreement on the policy's actions, compared with a threshold from the expert's.

use dril_envs::ActionSpace;
use dril_kinds::{DrilParams, RewardScheme, Thresholds};
use dril_stage_api::StageError;
use serde::{Deserialize, Serialize};

use super::disagreement::{MemberOutputs, continuous_costs, discrete_costs, quantile, reward};
use super::u_signal::USignal;
use crate::algorithms::ensemble::Ensemble;
use crate::data::frames::FrameStore;
use crate::data::transitions::Transitions;
use crate::training::normalize::RewardNormalizer;
use crate::training::rollout::Rollout;

/// Samples in one forward pass of the ensemble.
const BATCH: usize = 256;

/// Computes rewards, and keeps their state between rollouts.
pub(super) struct Signal<'a> {
    ensemble: &'a Ensemble,
    scheme: RewardScheme,
    state: SignalState,
}

/// The state for checkpoints.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct SignalState {
    /// The cost above which the members count as disagreeing; not used if there is one per discrete action.
    pub(super) threshold: f64,
    /// The same for each discrete action; empty for continuous actions.
    pub(super) thresholds: Vec<f64>,
    u_signal: USignal,
    /// None if rewards are not scaled.
    normalizer: Option<RewardNormalizer>,
}

/// Summary of a rollout's rewards.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct RolloutSignal {
    /// The mean U-signal of the episodes that ended in it, if any.
    pub(super) u_signal: Option<f64>,
    /// The mean cost.
    pub(super) disagreement: f64,
}

impl<'a> Signal<'a> {
    /// The signal of an ensemble. The threshold is the quantile of the cost over all demonstrated transitions, including
    /// those held out from cloning.
    ///
    /// # Errors
    /// The ensemble's outputs are not finite.
    pub(super) fn new(
        ensemble: &'a Ensemble,
        transitions: &Transitions,
        params: &DrilParams,
    ) -> Result<Self, StageError> {
        let (threshold, thresholds) = limits(ensemble, transitions, params.quantile, params.thresholds)?;
        let (envs, gamma) = (params.on_policy.n_envs as usize, params.update.gamma);
        let normalizer = params.on_policy.normalize_reward.then(|| RewardNormalizer::new(envs, gamma));
        let state = SignalState { threshold, thresholds, u_signal: USignal::new(envs), normalizer };
        Ok(Self { ensemble, scheme: params.reward, state })
    }

    /// The signal from a checkpoint.
    pub(super) fn restored(ensemble: &'a Ensemble, scheme: RewardScheme, state: SignalState) -> Self {
        Self { ensemble, scheme, state }
    }

    /// The state for checkpoints.
    pub(super) fn state(&self) -> &SignalState {
        &self.state
    }

    /// Replaces the environments' rewards by the ensemble's, each for a state and the action taken there, as the
    /// environment used it (within [-1, 1]). Returns a summary, and the U-signal of each episode that ended, in order.
    ///
    /// # Errors
    /// The ensemble's outputs are not finite.
    pub(super) fn replace_rewards(
        &mut self,
        rollout: &mut Rollout,
    ) -> Result<(RolloutSignal, Vec<f64>), StageError> {
        let slots: Vec<usize> = (0..rollout.len()).map(|entry| rollout.entry_slot(entry)).collect();
        let costs = costs(self.ensemble, &rollout.frames, &slots, &rollout.actions)?;
        let actions = rollout.actions.chunks_exact(rollout.dims);
        for ((to, cost), action) in rollout.rewards.iter_mut().zip(&costs).zip(actions) {
            *to = reward(self.scheme, *cost, self.state.limit(action));
        }
        let signals = self.state.u_signal.observe(&rollout.rewards, &rollout.dones);
        if let Some(normalizer) = &mut self.state.normalizer {
            normalizer.normalize(&mut rollout.rewards, &rollout.dones);
        }
        let u_signal = (!signals.is_empty()).then(|| signals.iter().sum::<f64>() / signals.len() as f64);
        let disagreement = costs.iter().sum::<f64>() / costs.len() as f64;
        Ok((RolloutSignal { u_signal, disagreement }, signals))
    }
}

impl SignalState {
    /// The threshold for an action.
    fn limit(&self, action: &[f32]) -> f64 {
        limit(self.threshold, &self.thresholds, action)
    }
}

/// The cost above which the members count as disagreeing: one for all actions, and one per discrete action (empty for
/// continuous actions). It is a quantile of the cost over all demonstrated transitions.
///
/// # Errors
/// The ensemble's outputs are not finite.
pub(crate) fn limits(
    ensemble: &Ensemble,
    transitions: &Transitions,
    q: f64,
    thresholds: Thresholds,
) -> Result<(f64, Vec<f64>), StageError> {
    let all: Vec<usize> = (0..transitions.len()).collect();
    let (threshold, thresholds) = match ensemble.architecture().actions {
        ActionSpace::Continuous { .. } => {
            let costs = costs(ensemble, transitions.frames(), &all, &transitions.actions(&all))?;
            (quantile(&costs, q), Vec::new())
        }
        ActionSpace::Discrete { .. } => {
            // Over all transitions, whichever action was taken there (thesis figure 17).
            let costs = choice_costs(ensemble, transitions.frames(), &all)?;
            let mut own: Vec<f64> = costs.iter().filter_map(|costs| quantile(costs, q)).collect();
            if let (Thresholds::LastChoice, Some(last)) = (thresholds, own.last().copied()) {
                own.fill(last);
            }
            (own.last().copied(), own)
        }
    };
    let threshold = threshold
        .ok_or_else(|| StageError::failed("there is no demonstrated transition to take a threshold from"))?;
    Ok((threshold, thresholds))
}

/// The threshold for an action, from the result of [`limits`].
pub(crate) fn limit(threshold: f64, thresholds: &[f64], action: &[f32]) -> f64 {
    let choice = action.first().map_or(0, |choice| *choice as usize);
    thresholds.get(choice).copied().unwrap_or(threshold)
}

/// The cost of each sample's action.
pub(crate) fn costs(
    ensemble: &Ensemble,
    frames: &FrameStore,
    slots: &[usize],
    actions: &[f32],
) -> Result<Vec<f64>, StageError> {
    let space = ensemble.architecture().actions;
    let len = space.action_len();
    let mut costs = Vec::with_capacity(slots.len());
    let mut actions = actions.chunks(BATCH * len);
    for_batches(ensemble, frames, slots, |outputs| {
        let actions = actions.next().unwrap_or_default();
        match space {
            ActionSpace::Continuous { .. } => costs.extend(continuous_costs(outputs, actions)),
            ActionSpace::Discrete { .. } => costs.extend(discrete_costs(outputs, actions)),
        }
    })?;
    match costs.iter().find(|cost| !cost.is_finite()) {
        None => Ok(costs),
        Some(cost) => Err(StageError::failed(format!(
            "the ensemble's disagreement is {cost}, expected a finite number; train the ensemble again"
        ))),
    }
}

/// The cost of every discrete action for each of these slots, [action][slot].
pub(crate) fn choice_costs(
    ensemble: &Ensemble,
    frames: &FrameStore,
    slots: &[usize],
) -> Result<Vec<Vec<f64>>, StageError> {
    let mut costs: Vec<Vec<f64>> = vec![Vec::new(); ensemble.architecture().actions.outputs()];
    for_batches(ensemble, frames, slots, |outputs| {
        for (choice, costs) in costs.iter_mut().enumerate() {
            costs.extend((0..outputs.samples()).map(|sample| outputs.discrete_cost(sample, choice)));
        }
    })?;
    Ok(costs)
}

/// The ensemble's outputs for the observations in these slots, batch by batch. The encoder processes each observation
/// once, whatever the number of members.
fn for_batches(
    ensemble: &Ensemble,
    frames: &FrameStore,
    slots: &[usize],
    mut each: impl FnMut(&MemberOutputs),
) -> Result<(), StageError> {
    let (members, count) = (ensemble.architecture().members, ensemble.architecture().actions.outputs());
    for slots in slots.chunks(BATCH) {
        let answers = ensemble.answers(&frames.gather(slots));
        let outputs = MemberOutputs::new(answers, members, count).ok_or_else(|| {
            StageError::failed("the shape of the ensemble's outputs does not match its description")
        })?;
        each(&outputs);
    }
    Ok(())
}
