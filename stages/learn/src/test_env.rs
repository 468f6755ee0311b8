//! A world so small that learning in it takes a second: see a number, say it.

use dril_envs::{
    ActionSpace, Env, EnvError, EnvSnapshot, Frame, ObservationSpace, Outcome, RgbImage, Step, VecEnv,
};
use dril_stage_api::{Seed, StreamRng};
use rand::RngExt;

/// Shows a number from -1 to 1 and rewards 1 − |action − number|; an episode has `steps` of them. With choices, the
/// right one is 0 for numbers up to -1/3, 1 up to 1/3, 2 above, and rewards 1.
pub(crate) struct Echo {
    steps: usize,
    choices: bool,
    /// How the last step ends the episode.
    outcome: Outcome,
    seed: Option<u64>,
    numbers: StreamRng,
    shown: [f32; 1],
    actions: Vec<f32>,
}

impl Echo {
    pub(crate) fn new(steps: usize, outcome: Outcome) -> Self {
        let numbers = Seed(0).stream("numbers");
        Self { steps, choices: false, outcome, seed: None, numbers, shown: [0.0], actions: Vec::new() }
    }

    pub(crate) const SPACES: (ObservationSpace, ActionSpace) =
        (ObservationSpace::Vector { len: 1 }, ActionSpace::Continuous { dims: 1 });

    /// Several, side by side.
    pub(crate) fn several(count: usize, steps: usize, outcome: Outcome) -> VecEnv {
        let envs = (0..count).map(|_| Box::new(Self::new(steps, outcome)) as Box<dyn Env>);
        VecEnv::of(envs.collect(), Self::SPACES, 1).unwrap()
    }

    /// Several that take choices.
    pub(crate) fn choosing(count: usize, steps: usize) -> VecEnv {
        let envs = (0..count).map(|_| {
            Box::new(Self { choices: true, ..Self::new(steps, Outcome::TimeLimit) }) as Box<dyn Env>
        });
        let spaces = (Self::SPACES.0, ActionSpace::Discrete { actions: 3 });
        VecEnv::of(envs.collect(), spaces, 1).unwrap()
    }

    fn show(&mut self) {
        self.shown = [2.0 * self.numbers.random::<f32>() - 1.0];
    }
}

impl Env for Echo {
    fn observation_space(&self) -> ObservationSpace {
        Self::SPACES.0
    }

    fn action_space(&self) -> ActionSpace {
        if self.choices { ActionSpace::Discrete { actions: 3 } } else { Self::SPACES.1 }
    }

    fn reset(&mut self, seed: u64) -> Result<(), EnvError> {
        self.seed = Some(seed);
        self.numbers = Seed(seed).stream("numbers");
        self.actions.clear();
        self.show();
        Ok(())
    }

    fn step(&mut self, action: &[f32]) -> Result<Step, EnvError> {
        if self.actions.len() == self.steps {
            return Err(EnvError::Over { length: self.steps });
        }
        self.actions.push(action[0]);
        let reward = if self.choices {
            let right = ((self.shown[0] + 1.0) * 1.5).min(2.0).floor();
            f64::from(u8::from(right == action[0]))
        } else {
            f64::from(1.0 - (action[0].clamp(-1.0, 1.0) - self.shown[0]).abs())
        };
        self.show();
        let over = self.actions.len() == self.steps;
        Ok(Step { reward, outcome: if over { self.outcome } else { Outcome::Running } })
    }

    fn frame(&self) -> Frame<'_> {
        Frame::Vector(&self.shown)
    }

    fn snapshot(&self) -> EnvSnapshot {
        EnvSnapshot { seed: self.seed, actions: self.actions.clone() }
    }

    fn restore(&mut self, snapshot: &EnvSnapshot) -> Result<(), EnvError> {
        let seed = snapshot.seed.ok_or_else(|| EnvError::Snapshot("no episode".into()))?;
        self.reset(seed)?;
        snapshot.actions.iter().try_for_each(|action| self.step(&[*action]).map(|_| ()))
    }

    fn render(&mut self, _: usize, _: usize) -> Result<RgbImage, EnvError> {
        Err(EnvError::Render("there is nothing to see".into()))
    }
}
