//! DRIL's reward: the ensemble's disagreement on what the agent does, against a threshold taken from what the expert did.

use dril_envs::ActionSpace;
use dril_kinds::{DrilParams, RewardScheme, Thresholds};
use dril_stage_api::StageError;
use serde::{Deserialize, Serialize};

use super::disagreement::{MemberOutputs, continuous_costs, discrete_costs, quantile, reward};
use super::u_signal::USignal;
use crate::algorithms::ensemble::Ensemble;
use crate::data::frames::FrameStore;
use crate::data::pairs::Pairs;
use crate::training::normalize::RewardNormalizer;
use crate::training::rollout::Rollout;

/// Samples in one forward pass of the ensemble.
const BATCH: usize = 256;

/// Makes rewards, and keeps what they depend on from one rollout to the next.
pub(super) struct Signal<'a> {
    ensemble: &'a Ensemble,
    scheme: RewardScheme,
    state: SignalState,
}

/// The part of a checkpoint.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct SignalState {
    /// The cost above which the members count as disagreeing; not used where each choice has its own.
    pub(super) threshold: f64,
    /// The same for each choice; empty where actions are numbers.
    pub(super) thresholds: Vec<f64>,
    u_signal: USignal,
    /// None where rewards are not scaled.
    normalizer: Option<RewardNormalizer>,
}

/// What a rollout's rewards were.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct RolloutSignal {
    /// The mean U-signal of the episodes that ended in it; none where none did.
    pub(super) u_signal: Option<f64>,
    /// The mean cost.
    pub(super) disagreement: f64,
}

impl<'a> Signal<'a> {
    /// The signal of an ensemble. The threshold is the quantile of the cost over all demonstrated pairs, those that are
    /// held out from cloning included.
    ///
    /// # Errors
    /// The ensemble's answers are not numbers.
    pub(super) fn new(
        ensemble: &'a Ensemble,
        pairs: &Pairs,
        params: &DrilParams,
    ) -> Result<Self, StageError> {
        let (threshold, thresholds) = limits(ensemble, pairs, params.quantile, params.thresholds)?;
        let (envs, gamma) = (params.on_policy.n_envs as usize, params.on_policy.gamma);
        let normalizer = params.on_policy.normalize_reward.then(|| RewardNormalizer::new(envs, gamma));
        let state = SignalState { threshold, thresholds, u_signal: USignal::new(envs), normalizer };
        Ok(Self { ensemble, scheme: params.reward, state })
    }

    /// The signal as a checkpoint has it.
    pub(super) fn restored(ensemble: &'a Ensemble, scheme: RewardScheme, state: SignalState) -> Self {
        Self { ensemble, scheme, state }
    }

    /// The part of a checkpoint.
    pub(super) fn state(&self) -> &SignalState {
        &self.state
    }

    /// Puts the ensemble's rewards in place of the environments'. Each is for the state that was acted in and the action
    /// that was taken there, as the environment got it: within [-1, 1]. Gives a summary, and the U-signal of each episode
    /// that ended, in order.
    ///
    /// # Errors
    /// The ensemble's answers are not numbers.
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

/// The cost above which the members count as disagreeing: one for all actions, and one for each choice (none where
/// actions are numbers). It is a quantile of the cost over all demonstrated pairs.
pub(crate) fn limits(
    ensemble: &Ensemble,
    pairs: &Pairs,
    q: f64,
    thresholds: Thresholds,
) -> Result<(f64, Vec<f64>), StageError> {
    let all: Vec<usize> = (0..pairs.len()).collect();
    let (threshold, thresholds) = match ensemble.architecture().actions {
        ActionSpace::Continuous { .. } => {
            let costs = costs(ensemble, pairs.frames(), &all, &pairs.actions(&all))?;
            (quantile(&costs, q), Vec::new())
        }
        ActionSpace::Discrete { .. } => {
            // The quantile of each choice's cost over all pairs, whichever choice was made there (thesis figure 17).
            let costs = choice_costs(ensemble, pairs.frames(), &all)?;
            let mut own: Vec<f64> = costs.iter().filter_map(|costs| quantile(costs, q)).collect();
            if let (Thresholds::LastChoice, Some(last)) = (thresholds, own.last().copied()) {
                own.fill(last);
            }
            (own.last().copied(), own)
        }
    };
    let threshold = threshold
        .ok_or_else(|| StageError::failed("there is no demonstrated pair to take a threshold from"))?;
    Ok((threshold, thresholds))
}

/// The limit for an action, of those that [`limits`] gives.
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
            "the ensemble's disagreement is {cost}, expected a number; train it again"
        ))),
    }
}

/// The cost of every choice in each of these slots, [choice][slot].
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

/// What the ensemble answers to the observations in these slots, batch by batch. The encoder sees every observation
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
            StageError::failed("the ensemble's answers have another shape than its description")
        })?;
        each(&outputs);
    }
    Ok(())
}
