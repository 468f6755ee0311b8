//! Demonstrations as numbered transitions: observations and the actions taken there.

use std::path::Path;

use dril_envs::{ActionSpace, Demonstrations, DemosHeader, Episode, Frame, ObservationSpace};
use dril_stage_api::StageError;

use super::frames::FrameStore;
use crate::nn::Batch;

/// The transitions of all episodes, in order, numbered from 0.
#[derive(Clone, Debug, PartialEq)]
pub struct Transitions {
    /// The observation of transition i is the stack whose newest frame is in slot i.
    frames: FrameStore,
    /// The action of transition i starts at `i·dims`, as recorded.
    actions: Vec<f32>,
    dims: usize,
    /// Action space.
    space: ActionSpace,
    lengths: Vec<usize>,
}

impl Transitions {
    /// Reads the demonstrations at the input `port`, in two passes: to count and check, and to store, so that frames are in
    /// memory only once.
    ///
    /// # Errors
    /// The file cannot be read, has no transition, or has an action that is not finite or does not exist.
    pub fn load(port: &str, path: &Path) -> Result<Self, StageError> {
        let wrong = |message: String| StageError::input(port, path, message);
        let (mut lengths, mut odd, mut choices) = (Vec::new(), None, None);
        let header = Demonstrations::read_each(path, |header, episode| {
            let choices = *choices.get_or_insert_with(|| choices_of(header));
            if odd.is_none() {
                let message = odd_action(choices, &episode);
                odd = message.map(|message| format!("episode {} has {message}", lengths.len()));
            }
            lengths.push(episode.steps(header.action_dims));
        });
        let header = header.map_err(|error| wrong(error.to_string()))?;
        if let Some(message) = odd {
            return Err(wrong(message));
        }
        let steps = lengths.iter().sum();
        if steps == 0 {
            return Err(wrong(format!("has no step in {} episodes, expected at least one", lengths.len())));
        }
        let (_, space) = header.env.spaces().map_err(|error| wrong(error.to_string()))?;
        let space = match space {
            ActionSpace::Continuous { .. } => ActionSpace::Continuous { dims: header.action_dims },
            choices @ ActionSpace::Discrete { .. } => choices,
        };
        let mut frames = FrameStore::with_slots(header.observation_space, steps);
        let mut actions = Vec::with_capacity(steps * header.action_dims);
        let mut slots = 0..steps;
        let read = Demonstrations::read_each(path, |header, episode| {
            actions.extend_from_slice(&episode.actions);
            for ((step, frame), slot) in
                frames_of(&episode, &header.observation_space).enumerate().zip(&mut slots)
            {
                frames.set(slot, frame, step == 0);
            }
        });
        read.map_err(|error| wrong(error.to_string()))?;
        Ok(Self { frames, actions, dims: header.action_dims, space, lengths })
    }

    /// Number of transitions.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// True if there is no transition.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Observation space.
    pub fn observation(&self) -> ObservationSpace {
        self.frames.observation()
    }

    /// Values per action; 1 for discrete actions.
    pub fn dims(&self) -> usize {
        self.dims
    }

    /// Action space.
    pub fn action_space(&self) -> ActionSpace {
        self.space
    }

    /// Number of transitions in each episode.
    pub fn lengths(&self) -> &[usize] {
        &self.lengths
    }

    /// The frames; the newest frame of transition i is in slot i.
    pub fn frames(&self) -> &FrameStore {
        &self.frames
    }

    /// The observations of these transitions, as a batch (see [`FrameStore::gather`]).
    pub fn observations(&self, transitions: &[usize]) -> Batch {
        self.frames.gather(transitions)
    }

    /// The actions of these transitions, as recorded, [transitions, dims].
    pub fn actions(&self, transitions: &[usize]) -> Vec<f32> {
        transitions
            .iter()
            .flat_map(|transition| &self.actions[transition * self.dims..][..self.dims])
            .copied()
            .collect()
    }
}

/// Number of discrete actions, if actions are discrete.
fn choices_of(header: &DemosHeader) -> Option<usize> {
    match header.env.spaces().ok()?.1 {
        ActionSpace::Discrete { actions } => Some(actions),
        ActionSpace::Continuous { .. } => None,
    }
}

/// Describes an invalid action of the episode, if there is one.
fn odd_action(choices: Option<usize>, episode: &Episode) -> Option<String> {
    if episode.actions.iter().any(|action| !action.is_finite()) {
        return Some("an action that is not a number".to_owned());
    }
    let count = choices?;
    let known = |action: &&f32| action.fract() == 0.0 && (0.0..count as f32).contains(*action);
    let odd = episode.actions.iter().find(|action| !known(action))?;
    Some(format!("the action {odd}, expected a discrete action from 0 to {}", count - 1))
}

/// The observations of an episode, one before each action.
pub(crate) fn frames_of<'a>(
    episode: &'a Episode,
    space: &ObservationSpace,
) -> Box<dyn Iterator<Item = Frame<'a>> + 'a> {
    let len = space.frame_len().max(1);
    match space {
        ObservationSpace::Image { .. } => Box::new(episode.frames.chunks_exact(len).map(Frame::Image)),
        ObservationSpace::Vector { .. } => Box::new(episode.vectors.chunks_exact(len).map(Frame::Vector)),
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use dril_envs::{ActionRange, EnvConfig, Outcome};

    /// Episodes of these lengths in a made-up world of two numbers; what is done is a smooth function of both, beyond
    /// [-1, 1] at times.
    pub(crate) fn vector_demos(lengths: &[usize]) -> Demonstrations {
        let header = DemosHeader {
            observation_space: ObservationSpace::Vector { len: 2 },
            ..image_demos(0, 0.0).header
        };
        let episodes = lengths.iter().enumerate().map(|(index, &length)| {
            let seen =
                (0..length).map(|step| [(step as f32 * 0.3).sin(), (index as f32 + step as f32 * 0.7).cos()]);
            let seen: Vec<[f32; 2]> = seen.collect();
            Episode {
                seed: index as u64,
                score: 1.0,
                outcome: Outcome::Finished,
                frames: Vec::new(),
                vectors: seen.concat(),
                actions: seen.iter().flat_map(|[x, y]| [1.2 * x, 0.5 * x * y]).collect(),
            }
        });
        Demonstrations { header, episodes: episodes.collect() }
    }

    pub(crate) fn image_demos(steps: usize, action: f32) -> Demonstrations {
        let size = 36 * 36;
        let episode = |seed: u64| Episode {
            seed,
            score: 930.5,
            outcome: Outcome::Finished,
            // Grey that grows by one a step.
            frames: (0..steps * size).map(|at| ((at / size) as u64 + 10 * seed) as u8).collect(),
            vectors: Vec::new(),
            actions: (0..steps * 2).map(|at| if at == 0 { action } else { at as f32 / 100.0 }).collect(),
        };
        Demonstrations {
            header: DemosHeader {
                env: EnvConfig::default(),
                observation_space: ObservationSpace::Image { height: 36, width: 36, stack: 4 },
                action_dims: 2,
                action_range: ActionRange::Raw,
                mode: "stochastic".to_owned(),
            },
            episodes: vec![episode(1), episode(2)],
        }
    }

    #[test]
    fn a_recording_becomes_numbered_pairs_and_stacks_stay_within_their_episode() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.demos");
        image_demos(6, 2.5).write(&path).unwrap();
        let transitions = Transitions::load("demonstrations", &path).unwrap();
        assert_eq!((transitions.len(), transitions.dims(), transitions.lengths()), (12, 2, &[6, 6][..]));
        assert_eq!(transitions.actions(&[0, 7]), [2.5, 0.01, 0.02, 0.03]);
        // The newest values of each plane of the second episode's second stack: two planes are black.
        let Batch::Images { bytes, .. } = transitions.observations(&[7]) else { panic!("images") };
        let planes: Vec<u8> = bytes.chunks(16).take(4).map(|plane| plane[0]).collect();
        assert_eq!(planes, [0, 0, 20, 21]);
    }

    #[test]
    fn a_recording_without_steps_or_with_an_action_that_is_no_number_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.demos");
        for (demos, part) in [
            (image_demos(0, 0.0), "no step in 2 episodes"),
            (image_demos(3, f32::NAN), "episode 0 has an action that is not a number"),
        ] {
            demos.write(&path).unwrap();
            let message = Transitions::load("demonstrations", &path).unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
    }
}
