//! The bridge: environments of Gymnasium and the Arcade Learning Environment, played by a Python process beside this one.
//!
//! One process plays a whole group of environments ([`build`]); each answers for itself, so an episode still follows
//! from its seed and its actions alone. Pictures get the thesis's preprocessing (grey, 84 x 84); what is a number here
//! stays one. [`config`] is what stands in the pipeline file, [`venv`] where the packages come from, [`protocol`] what
//! goes over the pipes, [`worker`] the process.

mod config;
mod error;
mod protocol;
mod venv;
mod worker;

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::area::Area;
use crate::car_racing::CarRacing;
use crate::played::Played;
use crate::preprocess::{self, FULL, SIDE};
use crate::{ActionSpace, Env, EnvError, EnvSnapshot, Frame, ObservationSpace, Picture, Step};
use protocol::{Operation, Shown};
use worker::{Launch, Worker};

pub use config::{GymnasiumConfig, Tracks, versions};
pub use error::GymnasiumError;
pub use venv::{PythonHome, keep_python_in, python};

/// Largest side of a picture for people.
const MOST_PIXELS: usize = 4096;

/// `count` environments in up to `workers` processes.
///
/// # Errors
/// There is no Python with the packages, or it cannot play this environment.
pub(crate) fn build(
    config: &GymnasiumConfig,
    count: usize,
    workers: usize,
) -> Result<Vec<Box<dyn Env>>, EnvError> {
    let launch = Launch::new(python()?);
    let envs = start(&launch, config, count, workers)?;
    Ok(envs.into_iter().map(|env| Box::new(env) as Box<dyn Env>).collect())
}

fn start(
    launch: &Launch,
    config: &GymnasiumConfig,
    count: usize,
    workers: usize,
) -> Result<Vec<GymnasiumEnv>, EnvError> {
    let workers = workers.clamp(1, count.max(1));
    let mut envs = Vec::with_capacity(count);
    for group in 0..workers {
        let size = count / workers + usize::from(group < count % workers);
        let worker = Worker::start(launch, config, size, false)?;
        let worker = Arc::new(Mutex::new(worker));
        envs.extend(
            (0..size)
                .map(|index| GymnasiumEnv::new(launch.clone(), config.clone(), Arc::clone(&worker), index)),
        );
    }
    Ok(envs)
}

/// What an environment shows and takes. For ids that are not known here a worker is started once and asked.
///
/// # Errors
/// As [`build`].
pub(crate) fn spaces(config: &GymnasiumConfig) -> Result<(ObservationSpace, ActionSpace), EnvError> {
    if let Some(spaces) = known_spaces(config) {
        return Ok(spaces);
    }
    /// By the configuration as JSON.
    static ASKED: Mutex<Option<HashMap<String, (ObservationSpace, ActionSpace)>>> = Mutex::new(None);
    let name = serde_json::to_string(config).unwrap_or_default();
    let mut asked = ASKED.lock().unwrap_or_else(PoisonError::into_inner);
    let asked = asked.get_or_insert_default();
    if let Some(spaces) = asked.get(&name) {
        return Ok(*spaces);
    }
    let worker = Worker::start(&Launch::new(python()?), config, 1, false)?;
    let spaces = (worker.shown().space(), *worker.action());
    asked.insert(name, spaces);
    Ok(spaces)
}

/// The spaces of the ids that are used most; `continuous` changes them.
fn known_spaces(config: &GymnasiumConfig) -> Option<(ObservationSpace, ActionSpace)> {
    if config.kwargs.contains_key("continuous") {
        return None;
    }
    match config.id.as_str() {
        "CarRacing-v3" => Some(CarRacing::SPACES),
        "LunarLanderContinuous-v3" => {
            Some((ObservationSpace::Vector { len: 8 }, ActionSpace::Continuous { dims: 2 }))
        }
        _ => None,
    }
}

/// An environment that a worker plays.
struct GymnasiumEnv {
    launch: Launch,
    config: GymnasiumConfig,
    worker: Arc<Mutex<Worker>>,
    index: usize,
    spaces: (ObservationSpace, ActionSpace),
    view: View,
    episode: Option<Played<Elsewhere>>,
}

/// The game that the worker plays, as far as it is known here.
struct Elsewhere {
    /// True from [`Env::begin`] to [`Env::step`].
    begun: bool,
}

/// What policies see of what an environment shows.
enum View {
    Image { grey: Vec<u8>, area: Option<Area>, pixels: Box<[u8; SIDE * SIDE]> },
    Vector(Vec<f32>),
}

impl View {
    fn new(shown: Shown) -> Self {
        match shown {
            Shown::Image { height, width, .. } => {
                let is_usual = [height, width] == [FULL; 2];
                let area = (!is_usual).then(|| Area::new([height, width], [SIDE; 2]));
                Self::Image { grey: vec![0; height * width], area, pixels: Box::new([0; SIDE * SIDE]) }
            }
            Shown::Vector { len } => Self::Vector(vec![0.0; len]),
        }
    }

    fn take(&mut self, seen: &[u8]) {
        match self {
            Self::Image { grey, area, pixels } => {
                if seen.len() == grey.len() {
                    grey.copy_from_slice(seen);
                } else {
                    preprocess::to_grey(seen, grey);
                }
                match (area, <&[u8; FULL * FULL]>::try_from(grey.as_slice())) {
                    (Some(area), _) if area.from() == [SIDE; 2] => pixels.copy_from_slice(grey),
                    (Some(area), _) => area.apply(grey, 1, pixels.as_mut_slice()),
                    (None, Ok(full)) => preprocess::shrink(full, pixels),
                    (None, Err(_)) => {}
                }
            }
            Self::Vector(values) => {
                for (value, bytes) in values.iter_mut().zip(seen.as_chunks::<4>().0) {
                    *value = f32::from_le_bytes(*bytes);
                }
            }
        }
    }
}

impl GymnasiumEnv {
    fn new(launch: Launch, config: GymnasiumConfig, worker: Arc<Mutex<Worker>>, index: usize) -> Self {
        let (shown, action) = {
            let worker = locked(&worker);
            (worker.shown(), *worker.action())
        };
        let view = View::new(shown);
        Self { launch, config, worker, index, spaces: (shown.space(), action), view, episode: None }
    }

    /// Sends a request and waits for the reply.
    fn call(&mut self, operation: Operation, seed: u64, body: &[u8]) -> Result<Step, EnvError> {
        let mut worker = locked(&self.worker);
        worker.ask(operation, self.index, seed, body)?;
        let step = worker.fetch(self.index)?;
        if operation != Operation::Picture {
            self.view.take(worker.seen(self.index));
        }
        Ok(step)
    }

    /// The action with every value in its range.
    fn checked(&self, action: &[f32]) -> Result<Vec<f32>, EnvError> {
        let expected = self.spaces.1.action_len();
        if action.len() != expected {
            return Err(EnvError::ActionLength { seen: action.len(), expected });
        }
        if let Some(dimension) = action.iter().position(|value| value.is_nan()) {
            return Err(EnvError::ActionNan { dimension });
        }
        match self.spaces.1 {
            ActionSpace::Continuous { .. } => Ok(action.iter().map(|value| value.clamp(-1.0, 1.0)).collect()),
            ActionSpace::Discrete { actions } => {
                let (chosen, choices) = (action[0], actions);
                if chosen.fract() != 0.0 || !(0.0..actions as f32).contains(&chosen) {
                    return Err(EnvError::Choice { chosen, choices });
                }
                Ok(action.to_vec())
            }
        }
    }

    fn running(&mut self) -> Result<&mut Played<Elsewhere>, EnvError> {
        let episode = self.episode.as_mut().ok_or(EnvError::NotStarted)?;
        episode.check_running()?;
        Ok(episode)
    }

    /// Moves the episode to a worker of its own that can draw.
    fn move_to_a_worker_that_draws(&mut self) -> Result<(), EnvError> {
        let snapshot = self.snapshot();
        let worker = Worker::start(&self.launch, &self.config, 1, true)?;
        (self.worker, self.index) = (Arc::new(Mutex::new(worker)), 0);
        self.restore(&snapshot)
    }
}

fn locked(worker: &Mutex<Worker>) -> MutexGuard<'_, Worker> {
    worker.lock().unwrap_or_else(PoisonError::into_inner)
}

fn le_bytes(action: &[f32]) -> Vec<u8> {
    action.iter().flat_map(|value| value.to_le_bytes()).collect()
}

impl Env for GymnasiumEnv {
    fn observation_space(&self) -> ObservationSpace {
        self.spaces.0
    }

    fn action_space(&self) -> ActionSpace {
        self.spaces.1
    }

    fn reset(&mut self, seed: u64) -> Result<(), EnvError> {
        if self.episode.take().is_some_and(|episode| episode.game.begun) {
            // The reply of a step that nobody asked for any more stands before that of the reset.
            locked(&self.worker).fetch(self.index)?;
        }
        let draws = match self.config.tracks {
            Tracks::Gymnasium => Vec::new(),
            Tracks::CarRacing => {
                CarRacing::track_draws(seed)?.into_iter().flat_map(f64::to_le_bytes).collect()
            }
        };
        self.call(Operation::Reset, seed, &draws)?;
        self.episode = Some(Played::begin(seed, Elsewhere { begun: false }, 0, None));
        Ok(())
    }

    fn begin(&mut self, action: &[f32]) -> Result<(), EnvError> {
        let action = self.checked(action)?;
        let episode = self.running()?;
        if std::mem::replace(&mut episode.game.begun, true) {
            return Ok(());
        }
        episode.note_action(&action);
        Ok(locked(&self.worker).ask(Operation::Step, self.index, 0, &le_bytes(&action))?)
    }

    fn step(&mut self, action: &[f32]) -> Result<Step, EnvError> {
        self.begin(action)?;
        let step = {
            let mut worker = locked(&self.worker);
            let step = worker.fetch(self.index)?;
            self.view.take(worker.seen(self.index));
            step
        };
        let episode = self.running()?;
        episode.game.begun = false;
        episode.note_step(step);
        Ok(step)
    }

    fn frame(&self) -> Frame<'_> {
        match &self.view {
            View::Image { pixels, .. } => Frame::Image(pixels.as_slice()),
            View::Vector(values) => Frame::Vector(values),
        }
    }

    fn snapshot(&self) -> EnvSnapshot {
        Played::snapshot(self.episode.as_ref())
    }

    fn restore(&mut self, snapshot: &EnvSnapshot) -> Result<(), EnvError> {
        let Some(seed) = snapshot.seed else {
            self.episode = None;
            return Ok(());
        };
        self.reset(seed)?;
        snapshot.replay(self.spaces.1.action_len(), |action| self.step(action))
    }

    fn render(&mut self, width: usize, height: usize) -> Result<Picture, EnvError> {
        if self.episode.is_none() {
            return Err(EnvError::NotStarted);
        }
        if !(1..=MOST_PIXELS).contains(&width) || !(1..=MOST_PIXELS).contains(&height) {
            let message = format!("{width} x {height} pixels, expected 1 to {MOST_PIXELS} a side");
            return Err(EnvError::Picture(message));
        }
        let picture = locked(&self.worker).picture();
        let drawn = match picture {
            Some(size) => size,
            None => {
                self.move_to_a_worker_that_draws()?;
                let size = locked(&self.worker).picture();
                size.ok_or_else(|| EnvError::Picture(format!("`{}` has no picture", self.config.id)))?
            }
        };
        self.call(Operation::Picture, 0, &[])?;
        let mut picture = Picture::new(width, height);
        Area::new(drawn, [height, width]).apply(locked(&self.worker).seen(self.index), 3, &mut picture.rgb);
        Ok(picture)
    }
}

#[cfg(test)]
#[path = "bridge_tests.rs"]
mod tests;
