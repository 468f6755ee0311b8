//! The bridge to Gymnasium and the Arcade Learning Environment, whose environments run in a Python process.
//!
//! One process runs a group of environments independently, so that an episode is still determined by its seed and
//! actions. Images get the thesis's preprocessing (greyscale, 84 x 84); numbers are passed on. [`config`] has the settings
//! in the pipeline file, [`venv`] the Python packages, [`protocol`] the messages over the pipes, [`worker`] the process.

mod config;
mod error;
mod protocol;
mod venv;
mod worker;

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde_json::Value;

use crate::car_racing::CarRacing;
use crate::drawing::resample::AreaResampler;
use crate::episode::{EpisodeRunner, Game, check_values};
use crate::lunar_lander::LunarLander;
use crate::wrappers::preprocess::{self, FULL, SIDE};
use crate::{ActionSpace, Env, EnvError, EnvSettings, EnvSnapshot, Frame, ObservationSpace, RgbImage, Step};
use protocol::{Operation, RawObservation};
use worker::{Launch, Worker};

pub use config::{GymnasiumConfig, Tracks, versions};
pub use error::GymnasiumError;
pub use venv::{PythonHome, keep_python_in, python};

impl EnvSettings for GymnasiumConfig {
    fn check(&self) -> Vec<(String, String)> {
        GymnasiumConfig::check(self)
    }

    fn build(&self, count: usize, workers: usize) -> Result<Vec<Box<dyn Env>>, EnvError> {
        let envs = start(&Launch::new(python()?), self, count, workers)?;
        Ok(envs.into_iter().map(|env| Box::new(env) as Box<dyn Env>).collect())
    }

    fn known_spaces(&self) -> Option<(ObservationSpace, ActionSpace)> {
        // `continuous` changes the action space.
        if self.kwargs.contains_key("continuous") {
            return None;
        }
        match self.id.as_str() {
            "CarRacing-v3" => Some(CarRacing::SPACES),
            "LunarLanderContinuous-v3" => Some(LunarLander::SPACES),
            _ => None,
        }
    }

    fn spaces(&self) -> Result<(ObservationSpace, ActionSpace), EnvError> {
        self.known_spaces().map_or_else(|| ask_for_spaces(self), Ok)
    }

    fn action_labels(&self) -> &'static [&'static str] {
        match self.id.as_str() {
            id if id.starts_with("CarRacing-") => &["steer", "brake | gas"],
            id if id.starts_with("LunarLanderContinuous-") => &["main", "side"],
            id if id.starts_with("LunarLander-") => &["wait", "left", "main", "right"],
            id if id.contains("Breakout") => &["noop", "fire", "right", "left"],
            _ => &[],
        }
    }

    fn steps_per_second(&self) -> f64 {
        // Gymnasium's own environments run at 50 steps a second; Atari has 60 frames, and a step lasts four.
        match self.kwargs.get("frameskip").and_then(Value::as_f64) {
            _ if !self.id.starts_with("ALE/") => 50.0,
            Some(frames) if frames >= 1.0 => 60.0 / frames,
            _ => 15.0,
        }
    }

    fn aspect_ratio(&self) -> f64 {
        // Gymnasium's own environments render 600 x 400; Atari's 160 x 210 pixels are shown on a 4:3 screen.
        if self.id.starts_with("ALE/") { 4.0 / 3.0 } else { 1.5 }
    }
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

/// The spaces of an environment that is not known here: starts a worker once per configuration, and asks it.
fn ask_for_spaces(config: &GymnasiumConfig) -> Result<(ObservationSpace, ActionSpace), EnvError> {
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

/// An environment that a worker runs.
struct GymnasiumEnv {
    launch: Launch,
    config: GymnasiumConfig,
    worker: Arc<Mutex<Worker>>,
    index: usize,
    spaces: (ObservationSpace, ActionSpace),
    view: View,
    episode: Option<EpisodeRunner<RemoteGame>>,
}

/// The state of the worker's episode that is known here.
struct RemoteGame {
    /// True between [`Env::begin`] and [`Env::step`].
    begun: bool,
}

/// Converts raw observations to those of the policy.
enum View {
    Image { grey: Vec<u8>, area: Option<AreaResampler>, pixels: Box<[u8; SIDE * SIDE]> },
    Vector(Vec<f32>),
}

impl View {
    fn new(shown: RawObservation) -> Self {
        match shown {
            RawObservation::Image { height, width, .. } => {
                let is_usual = [height, width] == [FULL; 2];
                let area = (!is_usual).then(|| AreaResampler::new([height, width], [SIDE; 2]));
                Self::Image { grey: vec![0; height * width], area, pixels: Box::new([0; SIDE * SIDE]) }
            }
            RawObservation::Vector { len } => Self::Vector(vec![0.0; len]),
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
        if operation != Operation::Render {
            self.view.take(worker.seen(self.index));
        }
        Ok(step)
    }

    /// The action with every value in its range.
    fn checked(&self, action: &[f32]) -> Result<Vec<f32>, EnvError> {
        check_values(action, self.spaces.1.action_len())?;
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

    fn running(&mut self) -> Result<&mut EpisodeRunner<RemoteGame>, EnvError> {
        let episode = self.episode.as_mut().ok_or(EnvError::NotStarted)?;
        episode.check_running()?;
        Ok(episode)
    }

    /// Moves the episode to its own worker, which can render.
    fn move_to_a_rendering_worker(&mut self) -> Result<(), EnvError> {
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
        if self.episode.take().is_some_and(|episode| episode.simulation.begun) {
            // The reply of an abandoned step comes before that of the reset.
            locked(&self.worker).fetch(self.index)?;
        }
        let draws = match self.config.tracks {
            Tracks::Gymnasium => Vec::new(),
            Tracks::CarRacing => {
                CarRacing::track_draws(seed)?.into_iter().flat_map(f64::to_le_bytes).collect()
            }
        };
        self.call(Operation::Reset, seed, &draws)?;
        self.episode = Some(EpisodeRunner::begin(seed, RemoteGame { begun: false }, 0, None));
        Ok(())
    }

    fn begin(&mut self, action: &[f32]) -> Result<(), EnvError> {
        let action = self.checked(action)?;
        let episode = self.running()?;
        if std::mem::replace(&mut episode.simulation.begun, true) {
            return Ok(());
        }
        episode.record_action(&action);
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
        episode.simulation.begun = false;
        episode.record_step(step);
        Ok(step)
    }

    fn frame(&self) -> Frame<'_> {
        match &self.view {
            View::Image { pixels, .. } => Frame::Image(pixels.as_slice()),
            View::Vector(values) => Frame::Vector(values),
        }
    }

    fn snapshot(&self) -> EnvSnapshot {
        EpisodeRunner::snapshot(self.episode.as_ref())
    }

    fn restore(&mut self, snapshot: &EnvSnapshot) -> Result<(), EnvError> {
        let Some(seed) = snapshot.seed else {
            self.episode = None;
            return Ok(());
        };
        self.reset(seed)?;
        snapshot.replay(self.spaces.1.action_len(), |action| self.step(action))
    }

    fn render(&mut self, width: usize, height: usize) -> Result<RgbImage, EnvError> {
        if self.episode.is_none() {
            return Err(EnvError::NotStarted);
        }
        RgbImage::check_size(width, height)?;
        let image = locked(&self.worker).image();
        let drawn = match image {
            Some(size) => size,
            None => {
                self.move_to_a_rendering_worker()?;
                let size = locked(&self.worker).image();
                size.ok_or_else(|| EnvError::Render(format!("`{}` has no image", self.config.id)))?
            }
        };
        self.call(Operation::Render, 0, &[])?;
        let mut image = RgbImage::new(width, height);
        AreaResampler::new(drawn, [height, width]).apply(
            locked(&self.worker).seen(self.index),
            3,
            &mut image.rgb,
        );
        Ok(image)
    }
}

#[cfg(test)]
#[path = "bridge_tests.rs"]
mod tests;
