//! Recorded actions, played again from the seed of their episode: what an environment gives that no recording keeps.

use dril_envs::recordings::video::{Format, Video};
use dril_envs::{DemosHeader, Env, EnvConfig, EnvError, Episode, MapLine, Pose};
use dril_stage_api::{Ctx, StageError};

/// Images a second.
const RATE: f64 = 10.0;
/// Columns of an image.
const WIDTH: f64 = 240.0;
/// Scores of a recording and of its repetition may differ by this much of their size: their sums are not rounded alike.
const CLOSE: f64 = 1e-9;

/// What happened at each step of an episode.
#[derive(Debug, Default)]
pub(super) struct Walk {
    /// The rewards.
    pub(super) rewards: Vec<f64>,
    /// The pose after each step, where the environment has one.
    pub(super) poses: Vec<Option<Pose>>,
    /// The lines of its world.
    pub(super) map: Vec<MapLine>,
    /// Its images, where they were asked for; empty otherwise.
    video: Video,
}

impl Walk {
    /// Plays the actions of an episode again. Every few steps an image is kept where `draws` says so.
    ///
    /// # Errors
    /// The environment fails, or the episode comes out with another score than the recording has.
    pub(super) fn again(header: &DemosHeader, episode: &Episode, draws: bool) -> Result<Self, StageError> {
        let mut env = header.env.build().map_err(StageError::failed)?;
        let walk = Self::play(env.as_mut(), header, episode, draws).map_err(StageError::failed)?;
        let score: f64 = walk.rewards.iter().sum();
        if (score - episode.score).abs() > CLOSE * (1.0 + episode.score.abs()) {
            return Err(StageError::failed(format!(
                "the actions of the episode with seed {} give a score of {score} when they are played again, but {} was \
                 recorded: another version of the environment made the recording; record it again, or set `replay` to \
                 false",
                episode.seed, episode.score
            )));
        }
        Ok(walk)
    }

    fn play(
        env: &mut dyn Env,
        header: &DemosHeader,
        episode: &Episode,
        draws: bool,
    ) -> Result<Self, EnvError> {
        let every = ((header.env.steps_per_second() / RATE).round() as usize).max(1);
        env.reset(episode.seed)?;
        let mut walk = Self { map: env.map(), ..Self::default() };
        for (step, action) in episode.actions.chunks_exact(header.action_dims.max(1)).enumerate() {
            if draws && step % every == 0 {
                walk.video.push(&env.render(WIDTH as usize, height(&header.env))?)?;
            }
            walk.rewards.push(env.step(action)?.reward);
            walk.poses.push(env.pose());
        }
        if draws {
            walk.video.push(&env.render(WIDTH as usize, height(&header.env))?)?;
        }
        Ok(walk)
    }

    /// Writes the images to the outputs `strip` and `video`.
    ///
    /// # Errors
    /// A file cannot be written.
    pub(super) fn write_images(&self, ctx: &Ctx<'_>) -> Result<(), StageError> {
        let milliseconds = (1000.0 / RATE) as u32;
        for (port, format) in [("strip", Format::Strip), ("video", Format::Gif)] {
            self.video.write(ctx.output(port)?, format, milliseconds).map_err(StageError::failed)?;
        }
        Ok(())
    }
}

fn height(env: &EnvConfig) -> usize {
    (WIDTH / env.aspect_ratio()).round() as usize
}
