//! An episode as every environment keeps it: its seed and the actions taken, by which it can be played again up to the
//! same point, and how it stands.

use crate::env::checked;
use crate::{EnvError, EnvSnapshot, Outcome, Step};

/// Steps for which room is made at an episode's start, at most.
const MOST_ROOM: usize = 1 << 20;

/// The episode at hand of a game `G`.
pub(crate) struct Played<G> {
    /// The game itself.
    pub game: G,
    seed: u64,
    actions: Vec<f32>,
    steps: usize,
    outcome: Outcome,
}

/// A game in this process whose actions are `DIMS` numbers in [-1, 1].
pub(crate) trait Game<const DIMS: usize> {
    /// Plays one step.
    fn play(&mut self, action: [f32; DIMS]) -> Step;
}

impl<G> Played<G> {
    /// The beginning of an episode that takes up to `values` numbers for its actions; they go where those of the episode
    /// `before` were.
    pub fn begin(seed: u64, game: G, values: usize, before: Option<Self>) -> Self {
        let mut actions = before.map_or_else(Vec::new, |before| before.actions);
        actions.clear();
        actions.reserve(values.min(MOST_ROOM));
        Self { game, seed, actions, steps: 0, outcome: Outcome::Running }
    }

    /// # Errors
    /// The episode is over.
    pub fn check_running(&self) -> Result<(), EnvError> {
        if self.outcome.ended() { Err(EnvError::Over { length: self.steps }) } else { Ok(()) }
    }

    /// Notes an action that is being taken.
    pub fn note_action(&mut self, action: &[f32]) {
        self.actions.extend_from_slice(action);
    }

    /// Notes what came of it.
    pub fn note_step(&mut self, step: Step) {
        self.steps += 1;
        self.outcome = step.outcome;
    }

    /// Takes one step.
    ///
    /// # Errors
    /// The episode is over, or the action is not one.
    pub fn step<const DIMS: usize>(&mut self, action: &[f32]) -> Result<Step, EnvError>
    where
        G: Game<DIMS>,
    {
        self.check_running()?;
        let action = checked(action)?;
        self.note_action(&action);
        let step = self.game.play(action);
        self.note_step(step);
        Ok(step)
    }

    /// What it takes to play the episode again; empty where there is none.
    pub fn snapshot(this: Option<&Self>) -> EnvSnapshot {
        this.map_or_else(EnvSnapshot::default, |episode| EnvSnapshot {
            seed: Some(episode.seed),
            actions: episode.actions.clone(),
        })
    }
}

impl EnvSnapshot {
    /// Takes the snapshot's actions, of `dims` numbers each, by `step`.
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
