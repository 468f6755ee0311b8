//! DRIL's reward: the ensemble's disagreement on what the agent does, against a threshold taken from what the expert did.

use dril_kinds::{DrilParams, RewardScheme};
use dril_stage_api::StageError;
use serde::{Deserialize, Serialize};

use super::reward::{RewardNormalizer, USignal};
use crate::disagreement::{MemberOutputs, continuous_costs, quantile, reward};
use crate::ensemble::Ensemble;
use crate::frames::FrameStore;
use crate::pairs::Pairs;
use crate::rollout::Rollout;

/// Samples in one go through the ensemble. A constant: other widths give other last bits.
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
    /// The cost above which the members count as disagreeing.
    pub(super) threshold: f64,
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
        let all: Vec<usize> = (0..pairs.len()).collect();
        let costs = costs(ensemble, pairs.frames(), &all, &pairs.action_values(&all))?;
        let threshold = quantile(&costs, params.quantile)
            .ok_or_else(|| StageError::failed("there is no demonstrated pair to take a threshold from"))?;
        let envs = params.envs as usize;
        let normalizer = params.normalize_reward.then(|| RewardNormalizer::new(envs, params.gamma));
        let state = SignalState { threshold, u_signal: USignal::new(envs), normalizer };
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
    /// that was taken there, as the environment got it: within [-1, 1].
    ///
    /// # Errors
    /// The ensemble's answers are not numbers.
    pub(super) fn replace_rewards(&mut self, rollout: &mut Rollout) -> Result<RolloutSignal, StageError> {
        let slots: Vec<usize> = (0..rollout.len()).map(|entry| rollout.entry_slot(entry)).collect();
        let costs = costs(self.ensemble, &rollout.frames, &slots, &rollout.actions)?;
        for (to, cost) in rollout.rewards.iter_mut().zip(&costs) {
            *to = reward(self.scheme, *cost, self.state.threshold);
        }
        let ended = self.state.u_signal.observe(&rollout.rewards, &rollout.ends);
        if let Some(normalizer) = &mut self.state.normalizer {
            normalizer.normalize(&mut rollout.rewards, &rollout.ends);
        }
        let u_signal = (!ended.is_empty()).then(|| ended.iter().sum::<f64>() / ended.len() as f64);
        Ok(RolloutSignal { u_signal, disagreement: costs.iter().sum::<f64>() / costs.len() as f64 })
    }
}

/// The cost of each sample's action. The encoder sees every observation once, whatever the number of members.
fn costs(
    ensemble: &Ensemble,
    frames: &FrameStore,
    slots: &[usize],
    actions: &[f32],
) -> Result<Vec<f64>, StageError> {
    let (members, dims) = (ensemble.architecture().members, ensemble.architecture().actions);
    let mut costs = Vec::with_capacity(slots.len());
    for (slots, actions) in slots.chunks(BATCH).zip(actions.chunks(BATCH * dims)) {
        let answers = ensemble.answers(&frames.gather(slots));
        let outputs = MemberOutputs::new(answers, members, dims).ok_or_else(|| {
            StageError::failed("the ensemble's answers have another shape than its description")
        })?;
        costs.extend(continuous_costs(&outputs, actions));
    }
    match costs.iter().find(|cost| !cost.is_finite()) {
        None => Ok(costs),
        Some(cost) => Err(StageError::failed(format!(
            "the ensemble's disagreement is {cost}, expected a number; train it again"
        ))),
    }
}
