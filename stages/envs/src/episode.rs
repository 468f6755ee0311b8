//! Episodes of games that are simulated in this process.
//!
//! A [`Game`] says how a simulation starts and what is observed of it; [`Env`] follows from that for every game. The
//! running episode keeps its seed and actions ([`EpisodeRunner`]), so that it can be replayed up to the same point.

use crate::{
    ActionSpace, Env, EnvError, EnvSnapshot, Frame, MapLine, ObservationSpace, Outcome, Pose, RgbImage, Step,
};

/// Most action values for which memory is reserved at an episode's start.
const MOST_RESERVED: usize = 1 << 20;

/// The rules and physics of one episode.
pub trait Simulate: Send {
    /// Advances by one step; the action's values lie in [-1, 1].
    fn advance(&mut self, action: &[f32]) -> Step;
}

/// A game that is simulated in this process, with continuous actions. Every game is an [`Env`].
pub trait Game: Send {
    /// One episode.
    type Simulation: Simulate;
    /// What policies see and do.
    const SPACES: (ObservationSpace, ActionSpace);

    /// The first moment of the episode that `seed` names.
    ///
    /// # Errors
    /// The seed gives no valid start.
    fn simulate(&self, seed: u64) -> Result<Self::Simulation, EnvError>;

    /// Steps after which an episode is truncated.
    fn time_limit(&self) -> usize;

    /// The running episode; none before the first reset.
    fn episode(&self) -> Option<&EpisodeRunner<Self::Simulation>>;

    /// The same, to replace it or to act in it.
    fn episode_mut(&mut self) -> &mut Option<EpisodeRunner<Self::Simulation>>;

    /// Updates the observation to the running episode; to zeros where there is none.
    fn observe(&mut self);

    /// The observation.
    fn observation(&self) -> Frame<'_>;

    /// Renders a moment of an episode.
    fn draw(&self, simulation: &Self::Simulation, width: usize, height: usize) -> RgbImage;

    /// The pose of the agent's body, for [`Env::pose`].
    fn pose_in(&self, _simulation: &Self::Simulation) -> Option<Pose> {
        None
    }

    /// The lines of the episode's world, for [`Env::map`].
    fn map_of(&self, _simulation: &Self::Simulation) -> Vec<MapLine> {
        Vec::new()
    }
}

/// A running episode of the simulation `S`.
pub struct EpisodeRunner<S> {
    /// The simulation itself.
    pub(crate) simulation: S,
    seed: u64,
    actions: Vec<f32>,
    steps: usize,
    outcome: Outcome,
}

impl<S> EpisodeRunner<S> {
    /// The start of an episode that takes up to `values` action values; they reuse the memory of the episode `before`.
    pub(crate) fn begin(seed: u64, simulation: S, values: usize, before: Option<Self>) -> Self {
        let mut actions = before.map_or_else(Vec::new, |before| before.actions);
        actions.clear();
        actions.reserve(values.min(MOST_RESERVED));
        Self { simulation, seed, actions, steps: 0, outcome: Outcome::Running }
    }

    /// # Errors
    /// The episode is over.
    pub(crate) fn check_running(&self) -> Result<(), EnvError> {
        if self.outcome.ended() { Err(EnvError::Over { length: self.steps }) } else { Ok(()) }
    }

    /// Records an action that is being taken.
    pub(crate) fn record_action(&mut self, action: &[f32]) {
        self.actions.extend_from_slice(action);
    }

    /// Records the result of that action.
    pub(crate) fn record_step(&mut self, step: Step) {
        self.steps += 1;
        self.outcome = step.outcome;
    }

    /// Seed and actions of the episode; empty where there is none.
    pub(crate) fn snapshot(this: Option<&Self>) -> EnvSnapshot {
        this.map_or_else(EnvSnapshot::default, |episode| EnvSnapshot {
            seed: Some(episode.seed),
            actions: episode.actions.clone(),
        })
    }
}

impl<S: Simulate> EpisodeRunner<S> {
    /// Takes one step; `action` has `dims` values, which are clamped to [-1, 1].
    fn step(&mut self, action: &[f32], dims: usize) -> Result<Step, EnvError> {
        self.check_running()?;
        check_values(action, dims)?;
        let taken = self.actions.len();
        self.actions.extend(action.iter().map(|value| value.clamp(-1.0, 1.0)));
        let step = self.simulation.advance(&self.actions[taken..]);
        self.record_step(step);
        Ok(step)
    }
}

/// Checks the length of an action, and that its values are numbers.
///
/// # Errors
/// Wrong length, or NaN.
pub(crate) fn check_values(action: &[f32], expected: usize) -> Result<(), EnvError> {
    if action.len() != expected {
        return Err(EnvError::ActionLength { seen: action.len(), expected });
    }
    match action.iter().position(|value| value.is_nan()) {
        Some(dimension) => Err(EnvError::ActionNan { dimension }),
        None => Ok(()),
    }
}

impl EnvSnapshot {
    /// Replays the snapshot's actions, of `dims` values each, by `step`.
    ///
    /// # Errors
    /// A step that the episode cannot have had.
    pub(crate) fn replay(
        &self,
        dims: usize,
        mut step: impl FnMut(&[f32]) -> Result<Step, EnvError>,
    ) -> Result<(), EnvError> {
        for (at, action) in self.actions.chunks(dims.max(1)).enumerate() {
            match step(action) {
                Ok(_) => {}
                // Not the snapshot's fault.
                Err(error @ EnvError::Gymnasium(_)) => return Err(error),
                Err(EnvError::Over { length }) => {
                    let actions = self.actions.len() / dims.max(1);
                    let message = format!("{actions} actions, but the episode ends after {length}");
                    return Err(EnvError::Snapshot(message));
                }
                Err(error) => return Err(EnvError::Snapshot(format!("step {at}: {error}"))),
            }
        }
        Ok(())
    }
}

/// Starts the episode that `seed` names, without observing it.
fn start<G: Game>(game: &mut G, seed: u64) -> Result<(), EnvError> {
    let simulation = game.simulate(seed)?;
    let values = game.time_limit().saturating_mul(G::SPACES.1.action_len());
    let before = game.episode_mut().take();
    *game.episode_mut() = Some(EpisodeRunner::begin(seed, simulation, values, before));
    Ok(())
}

impl<G: Game> Env for G {
    fn observation_space(&self) -> ObservationSpace {
        G::SPACES.0
    }

    fn action_space(&self) -> ActionSpace {
        G::SPACES.1
    }

    fn reset(&mut self, seed: u64) -> Result<(), EnvError> {
        start(self, seed)?;
        self.observe();
        Ok(())
    }

    fn step(&mut self, action: &[f32]) -> Result<Step, EnvError> {
        let episode = self.episode_mut().as_mut().ok_or(EnvError::NotStarted)?;
        let step = episode.step(action, G::SPACES.1.action_len())?;
        self.observe();
        Ok(step)
    }

    fn frame(&self) -> Frame<'_> {
        self.observation()
    }

    fn snapshot(&self) -> EnvSnapshot {
        EpisodeRunner::snapshot(self.episode())
    }

    fn restore(&mut self, snapshot: &EnvSnapshot) -> Result<(), EnvError> {
        match snapshot.seed {
            None => *self.episode_mut() = None,
            Some(seed) => {
                start(self, seed)?;
                let dims = G::SPACES.1.action_len();
                if let Some(episode) = self.episode_mut() {
                    snapshot.replay(dims, |action| episode.step(action, dims))?;
                }
            }
        }
        self.observe();
        Ok(())
    }

    fn render(&mut self, width: usize, height: usize) -> Result<RgbImage, EnvError> {
        let episode = self.episode().ok_or(EnvError::NotStarted)?;
        RgbImage::check_size(width, height)?;
        Ok(self.draw(&episode.simulation, width, height))
    }

    fn pose(&self) -> Option<Pose> {
        self.pose_in(&self.episode()?.simulation)
    }

    fn map(&self) -> Vec<MapLine> {
        self.episode().map_or_else(Vec::new, |episode| self.map_of(&episode.simulation))
    }
}
