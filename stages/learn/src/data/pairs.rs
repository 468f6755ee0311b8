//! Demonstrations as the imitators use them: numbered pairs of what was seen and what was done.

use std::path::Path;

use dril_envs::{ActionSpace, Demonstrations, DemosHeader, Episode, Frame, ObservationSpace};
use dril_stage_api::StageError;

use super::frames::FrameStore;
use crate::nn::Batch;

/// The pairs of all episodes in order, numbered from 0.
#[derive(Clone, Debug, PartialEq)]
pub struct Pairs {
    /// Pair i's observation is the stack whose newest frame lies in slot i.
    frames: FrameStore,
    /// Pair i's action stands at `i·dims`, as it was recorded.
    actions: Vec<f32>,
    dims: usize,
    /// What actions are.
    space: ActionSpace,
    lengths: Vec<usize>,
}

impl Pairs {
    /// Reads the demonstrations at the input `port`, twice: to count and check, and to keep them, so that frames are in
    /// memory once.
    ///
    /// # Errors
    /// The file cannot be read, holds no pair, or an action that is not a number.
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
            return Err(wrong(format!("has no step in {} episodes, expected some", lengths.len())));
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

    /// How many pairs there are.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// True where there is no pair.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// What observations look like.
    pub fn observation(&self) -> ObservationSpace {
        self.frames.observation()
    }

    /// How many numbers an action has; one for a choice.
    pub fn dims(&self) -> usize {
        self.dims
    }

    /// What actions are.
    pub fn action_space(&self) -> ActionSpace {
        self.space
    }

    /// The number of pairs in each episode.
    pub fn lengths(&self) -> &[usize] {
        &self.lengths
    }

    /// What was seen; pair i's newest frame lies in slot i.
    pub fn frames(&self) -> &FrameStore {
        &self.frames
    }

    /// The observations of these pairs, as a network takes them (see [`FrameStore::gather`]).
    pub fn observations(&self, pairs: &[usize]) -> Batch {
        self.frames.gather(pairs)
    }

    /// The actions of these pairs as they were recorded, [pairs, dims].
    pub fn actions(&self, pairs: &[usize]) -> Vec<f32> {
        pairs.iter().flat_map(|pair| &self.actions[pair * self.dims..][..self.dims]).copied().collect()
    }
}

/// How many choices there are, where actions are choices.
fn choices_of(header: &DemosHeader) -> Option<usize> {
    match header.env.spaces().ok()?.1 {
        ActionSpace::Discrete { actions } => Some(actions),
        ActionSpace::Continuous { .. } => None,
    }
}

/// What is wrong with an action of the episode, where something is.
fn odd_action(choices: Option<usize>, episode: &Episode) -> Option<String> {
    if episode.actions.iter().any(|action| !action.is_finite()) {
        return Some("an action that is not a number".to_owned());
    }
    let count = choices?;
    let known = |action: &&f32| action.fract() == 0.0 && (0.0..count as f32).contains(*action);
    let odd = episode.actions.iter().find(|action| !known(action))?;
    Some(format!("the action {odd}, expected a choice from 0 to {}", count - 1))
}

/// What was seen before each action of an episode.
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
        let pairs = Pairs::load("demonstrations", &path).unwrap();
        assert_eq!((pairs.len(), pairs.dims(), pairs.lengths()), (12, 2, &[6, 6][..]));
        assert_eq!(pairs.actions(&[0, 7]), [2.5, 0.01, 0.02, 0.03]);
        // The newest values of each plane of the second episode's second stack: two planes are black.
        let Batch::Images { bytes, .. } = pairs.observations(&[7]) else { panic!("images") };
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
            let message = Pairs::load("demonstrations", &path).unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
    }
}
