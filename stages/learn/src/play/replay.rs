//! Videos of episodes: the policy plays an episode as in the stage `evaluate`, and every few steps are rendered.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use dril_envs::recordings::video::panel::{self, Gauge, Reading};
use dril_envs::recordings::video::{Format, Video};
use dril_envs::{ActionSpace, EnvConfig};
use dril_kinds::Mode;
use dril_stage_api::{Seed, StageError};
use serde::Deserialize;

use super::act::{Play, PlayedEpisode, Player};
use crate::policy::Policy;

/// What to replay, and how to render it.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Replay {
    /// The policy's file.
    pub policy: PathBuf,
    /// The environment; default: `car-racing`, if it matches the policy.
    pub env: Option<EnvConfig>,
    /// Seed of the environment, and of a stochastic policy.
    pub seed: u64,
    /// How the policy chooses its actions.
    pub mode: Mode,
    /// The file to write; its extension determines the format: see [`Format::of`].
    pub out: PathBuf,
    /// Width of a frame, pixels.
    pub width: usize,
    /// Render every Nth step.
    pub every: u64,
    /// Playback speed, relative to real time.
    pub speed: f64,
}

/// The service behind `dril-pipe replay`: the one argument is a [`Replay`] as JSON.
///
/// # Errors
/// As [`run`], or the argument is invalid.
pub fn command(args: &[OsString]) -> Result<String, String> {
    let [text] = args else { return Err(format!("{} arguments, expected one", args.len())) };
    let replay = serde_json::from_str(&text.to_string_lossy());
    let replay: Replay = replay.map_err(|error| format!("this episode cannot be replayed: {error}"))?;
    run(&replay).map_err(|error| error.to_string())
}

/// Plays the episode and writes the video; returns a summary.
///
/// # Errors
/// The policy does not match the environment, the environment fails or cannot render, or the file cannot be written.
pub fn run(replay: &Replay) -> Result<String, StageError> {
    let format = Format::of(&replay.out).map_err(StageError::failed)?;
    check(replay)?;
    let policy = Policy::load("policy", &replay.policy)?;
    let env = env_for(&policy, replay)?;
    let play = Play {
        mode: replay.mode,
        mean_action_probability: 0.0,
        first_seed: replay.seed,
        episodes: 1,
        record: true,
    };
    let mut player = Player::new(&policy, &env, play, Seed(replay.seed))?;
    let mut video = Video::default();
    let last = loop {
        let Some(ended) = player.step()? else {
            return Err(StageError::failed("the episode did not begin"));
        };
        if let Some(last) = ended.into_iter().next() {
            break last;
        }
        if let Some(played) =
            player.playing(0).filter(|played| played.steps % replay.every == 1 % replay.every)
        {
            let reading = read(played, &env)?;
            draw(&mut player, &mut video, (replay.width, &env), &reading)?;
        }
    };
    let reading = read(&last, &env)?;
    draw(&mut player, &mut video, (replay.width, &env), &reading)?;
    let milliseconds = 1000.0 * replay.every as f64 / (env.steps_per_second() * replay.speed);
    video.write(&replay.out, format, (milliseconds.round() as u32).max(1)).map_err(StageError::failed)?;
    Ok(summary(&last, &video, &replay.out))
}

fn check(replay: &Replay) -> Result<(), StageError> {
    let widths = panel::LEAST_WIDTH..=2000;
    if !widths.contains(&replay.width) {
        return Err(StageError::failed(format!(
            "a width of {}, expected {} to {} pixels",
            replay.width,
            widths.start(),
            widths.end()
        )));
    }
    if replay.every == 0 {
        return Err(StageError::failed("every 0th step is drawn, expected 1 or more"));
    }
    if !(replay.speed.is_finite() && replay.speed > 0.0) {
        return Err(StageError::failed(format!(
            "a speed of {}, expected a number more than 0",
            replay.speed
        )));
    }
    Ok(())
}

fn env_for(policy: &Policy, replay: &Replay) -> Result<EnvConfig, StageError> {
    if let Some(env) = &replay.env {
        return match env.check().into_iter().next() {
            None => Ok(env.clone()),
            Some((field, message)) => Err(StageError::failed(format!("`{field}`: {message}"))),
        };
    }
    let env = EnvConfig::default();
    crate::spaces::check(policy, &env).map_err(|_| {
        StageError::failed(
            "the policy file does not name its environment; set it, as in `--env '{ gymnasium: \
             LunarLanderContinuous-v3 }'`",
        )
    })?;
    Ok(env)
}

/// Content of the bar under the image.
struct Bar {
    score: f64,
    step: u64,
    outcome: dril_envs::Outcome,
    gauges: Vec<Gauge>,
}

fn read(played: &PlayedEpisode, env: &EnvConfig) -> Result<Bar, StageError> {
    let (_, space) = env.spaces().map_err(StageError::failed)?;
    let action = &played.actions[played.actions.len().saturating_sub(space.action_len())..];
    let labels = env.action_labels();
    let gauges = match space {
        ActionSpace::Continuous { .. } => {
            let label = |index: usize| {
                labels.get(index).map_or_else(|| format!("action {index}"), |label| (*label).to_owned())
            };
            let bar = |(index, value): (usize, &f32)| Gauge::Bar { label: label(index), value: *value };
            action.iter().enumerate().map(bar).collect()
        }
        ActionSpace::Discrete { actions } => {
            let label = |index: usize| {
                labels.get(index).map_or_else(|| index.to_string(), |label| (*label).to_owned())
            };
            let chosen = action.first().map_or(0, |chosen| *chosen as usize);
            vec![Gauge::Choice { labels: (0..actions).map(label).collect(), chosen }]
        }
    };
    Ok(Bar { score: played.score, step: played.steps, outcome: played.outcome, gauges })
}

fn draw(
    player: &mut Player<'_>,
    video: &mut Video,
    (width, env): (usize, &EnvConfig),
    bar: &Bar,
) -> Result<(), StageError> {
    let height = (width as f64 / env.aspect_ratio()).round() as usize;
    let image = player.env(0).render(width, height).map_err(StageError::failed)?;
    let reading = Reading { score: bar.score, step: bar.step, outcome: bar.outcome, gauges: &bar.gauges };
    video.push(&panel::under(&image, &reading)).map_err(StageError::failed)
}

fn summary(played: &PlayedEpisode, video: &Video, out: &Path) -> String {
    let ending = match played.outcome {
        dril_envs::Outcome::Finished => "finished",
        dril_envs::Outcome::Failed => "failed",
        _ => "cut off by the time limit",
    };
    format!(
        "{}: seed {}, score {:.1} after {} steps ({ending}); {} frames\n",
        out.display(),
        played.seed,
        played.score,
        played.steps,
        video.len()
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use dril_kinds::{Network, PolicyFamily};

    fn replay(out: &str) -> (tempfile::TempDir, Replay) {
        let folder = tempfile::tempdir().unwrap();
        let env: EnvConfig =
            serde_json::from_value(serde_json::json!({ "car-racing": { "time_limit": 9 } })).unwrap();
        let policy = folder.path().join("policy.safetensors");
        let architecture =
            crate::spaces::architecture(&env, PolicyFamily::Beta, None, Network::ExpertCnn).unwrap();
        Policy::new(architecture, &mut Seed(1).stream("init")).unwrap().save(&policy).unwrap();
        let out = folder.path().join(out);
        let mode = Mode::Stochastic;
        (folder, Replay { policy, env: Some(env), seed: 5, mode, out, width: 360, every: 2, speed: 1.0 })
    }

    #[test]
    fn an_episode_becomes_a_video_that_shows_its_last_step() {
        for out in ["lap.gif", "lap.apng", "lap.png"] {
            let (_folder, replay) = replay(out);
            let said = run(&replay).unwrap();
            assert!(said.contains("seed 5, score ") && said.contains("after 9 steps (cut off"), "{said}");
            // Steps 1, 3, 5, 7, and the last one.
            assert!(said.contains("; 5 frames"), "{said}");
            assert!(std::fs::metadata(&replay.out).unwrap().len() > 1000, "{out}");
        }
    }

    #[test]
    fn what_cannot_be_drawn_is_told_before_the_episode_is_played() {
        let (_folder, good) = replay("lap.gif");
        for (replay, words) in [
            (Replay { out: "lap.avi".into(), ..good.clone() }, ".gif or .apng"),
            (Replay { width: 10, ..good.clone() }, "a width of 10"),
            (Replay { every: 0, ..good.clone() }, "every 0th"),
            (Replay { speed: 0.0, ..good.clone() }, "a speed of 0"),
            (Replay { policy: "none.safetensors".into(), ..good.clone() }, "none.safetensors"),
        ] {
            let message = run(&replay).unwrap_err().to_string();
            assert!(message.contains(words), "{message}");
        }
    }
}
