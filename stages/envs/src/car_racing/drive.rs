//! `drive`: records laps of a scripted driver, so that imitation can be tried without training an expert first.
//!
//! The driver knows the track ahead, which policies do not see: it is an expert to imitate, not a baseline.

use dril_stage_api::{Ctx, Describe, Needs, Ports, Problems, Seed, Stage, StageError, draw};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::driver::drive as steer;
use super::{CarRacing, CarRacingConfig};
use crate::episode::Game;
use crate::params::{check_attempts, check_env, check_seeds};
use crate::{
    ActionRange, DEMONSTRATIONS, Demonstrations, DemosHeader, Env, EnvConfig, EnvError, Episode, Frame,
    Outcome,
};

/// Records laps of a scripted driver.
#[derive(Clone, Copy, Debug)]
pub struct Drive;

/// Parameters of a `drive` stage (`with:`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DriveParams {
    /// The environment; only `car-racing` is supported.
    pub env: EnvConfig,
    /// Number of episodes to keep.
    #[serde(default = "twenty")]
    pub episodes: u64,
    /// Minimum score: only episodes that score more are kept.
    #[serde(default = "eight_hundred")]
    pub above: f64,
    /// Maximum number of episodes to drive.
    #[serde(default = "five_hundred")]
    pub max_attempts: u64,
    /// Attempt i uses the environment seed `first_seed` + i, which determines its track.
    pub first_seed: u64,
    /// Standard deviation of noise that is added to the executed actions, but not to the recorded ones: the car leaves the
    /// driver's line, and the driver demonstrates how to return (Laskey et al. 2017, "DART").
    #[serde(default)]
    pub noise: f64,
    /// Number of steps for which a noise sample is held. Independent samples at every step (1) average out; samples that are
    /// held push the car off its line, or even off the road.
    #[serde(default = "one")]
    pub noise_steps: u64,
}

fn one() -> u64 {
    1
}

fn twenty() -> u64 {
    20
}

fn five_hundred() -> u64 {
    500
}

fn eight_hundred() -> f64 {
    800.0
}

/// Maximum noise.
const MOST_NOISE: f64 = 2.0;

impl Describe for Drive {
    const KIND: &'static str = "drive";
    const REVISION: u32 = 3;
    const RENAMED: &'static [(&'static str, &'static str)] = &[("first_track_seed", "first_seed")];
    const ABOUT: &'static str = "records laps of a scripted CarRacing driver that score above a threshold";
    type Params = DriveParams;

    fn check(params: &DriveParams, problems: &mut Problems) {
        check_env(&params.env, problems);
        if car_racing(&params.env).is_none() {
            problems.add("env", "the scripted driver supports only `car-racing`");
        }
        check_attempts(params.episodes, params.max_attempts, problems);
        check_seeds(params.first_seed, params.max_attempts, problems);
        problems.range("noise", params.noise, 0.0..=MOST_NOISE, "a number from 0 to 2");
        problems.positive("noise_steps", params.noise_steps);
    }

    fn ports(_: &DriveParams) -> Ports {
        Ports::new().output(
            "demonstrations",
            DEMONSTRATIONS,
            "demos",
            "the kept laps, with the driver's actions without noise",
        )
    }

    fn needs(params: &DriveParams) -> Needs {
        Needs::seconds(0.5 + 0.1 * params.episodes as f64)
    }
}

impl Stage for Drive {
    type Kind = Self;

    fn run(params: &DriveParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        let config = car_racing(&params.env)
            .ok_or_else(|| StageError::failed("the scripted driver supports only `car-racing`"))?;
        let mut env = CarRacing::new(config.clone());
        let mut kept = Vec::new();
        let mut best = f64::NEG_INFINITY;
        for attempt in 0..params.max_attempts {
            ctx.stop_if_cancelled()?;
            let seed = ctx.seed().child(&format!("episode/{attempt}"));
            let episode =
                lap(&mut env, params.first_seed + attempt, params, seed).map_err(StageError::failed)?;
            best = best.max(episode.score);
            if episode.score > params.above {
                kept.push(episode);
            }
            let found = kept.len() as u64;
            ctx.progress(found, params.episodes, "episodes", || format!("{} attempts", attempt + 1));
            if found == params.episodes {
                let demonstrations = Demonstrations { header: header(params), episodes: kept };
                return demonstrations.write(ctx.output("demonstrations")?).map_err(StageError::failed);
            }
        }
        Err(StageError::failed(format!(
            "{} of {} laps scored above {}, expected {}; the best scored {best:.1}: lower `above` or `noise`, or raise \
             `max_attempts`",
            kept.len(),
            params.max_attempts,
            params.above,
            params.episodes
        )))
    }
}

fn car_racing(env: &EnvConfig) -> Option<&CarRacingConfig> {
    match env {
        EnvConfig::CarRacing(config) => Some(config),
        _ => None,
    }
}

fn header(params: &DriveParams) -> DemosHeader {
    DemosHeader {
        env: params.env.clone(),
        observation_space: CarRacing::SPACES.0,
        action_dims: CarRacing::SPACES.1.action_len(),
        action_range: ActionRange::Bounded,
        mode: "scripted".to_owned(),
    }
}

/// Drives one episode; noise is drawn from the stream `noise` of `seed`.
fn lap(env: &mut CarRacing, track_seed: u64, params: &DriveParams, seed: Seed) -> Result<Episode, EnvError> {
    let mut stream = seed.stream("noise");
    let mut push = [0.0; 2];
    let mut steps = 0;
    let mut episode = Episode {
        seed: track_seed,
        score: 0.0,
        outcome: Outcome::Running,
        frames: Vec::new(),
        vectors: Vec::new(),
        actions: Vec::new(),
    };
    env.reset(track_seed)?;
    while !episode.outcome.ended() {
        let controls = env.simulation().map(steer).ok_or(EnvError::NotStarted)?;
        let action = [controls.steer as f32, (controls.gas - controls.brake) as f32];
        if let Frame::Image(pixels) = env.frame() {
            episode.frames.extend_from_slice(pixels);
        }
        episode.actions.extend(action);
        if steps % params.noise_steps == 0 {
            push = push.map(|_| (params.noise * draw::normal(&mut stream)) as f32);
        }
        steps += 1;
        let pushed = [0, 1].map(|i| (action[i] + push[i]).clamp(-1.0, 1.0));
        let step = env.step(&pushed)?;
        episode.score += step.reward;
        episode.outcome = step.outcome;
    }
    Ok(episode)
}

#[cfg(test)]
mod tests {
    use super::*;
    use dril_stage_api::testing::Bench;
    use serde_json::json;

    fn driven(params: serde_json::Value, seed: u64) -> Result<Demonstrations, StageError> {
        let bench = Bench::new::<Drive>(&params, seed)?;
        bench.run()?;
        Ok(Demonstrations::read(&bench.output("demonstrations")?).unwrap())
    }

    #[test]
    fn the_driver_finishes_its_laps_and_they_are_kept_with_what_was_seen_and_done() {
        let params = json!({ "env": { "car-racing": {} }, "episodes": 2, "above": 850, "first_seed": 7 });
        let laps = driven(params, 1).unwrap();
        assert_eq!(laps.episodes.len(), 2);
        for lap in &laps.episodes {
            assert!(lap.score > 850.0 && lap.score < 1000.0, "{}", lap.score);
            assert!(lap.actions.iter().all(|action| (-1.0..=1.0).contains(action)));
            assert_eq!(lap.frames.len(), lap.steps(2) * 84 * 84);
        }
    }

    #[test]
    fn noise_moves_the_car_and_not_the_recorded_actions() {
        let params = |noise: f64| {
            json!({
                "env": { "car-racing": { "time_limit": 60 } },
                "episodes": 1, "above": -200, "first_seed": 7, "noise": noise
            })
        };
        let (calm, pushed) = (driven(params(0.0), 1).unwrap(), driven(params(0.3), 1).unwrap());
        assert_eq!(calm, driven(params(0.0), 2).unwrap(), "without noise there is nothing to draw");
        assert_eq!(pushed, driven(params(0.3), 1).unwrap());
        assert_ne!(pushed, driven(params(0.3), 2).unwrap());
        assert_eq!(calm.episodes[0].actions[..2], pushed.episodes[0].actions[..2], "the start is the same");
        assert_ne!(calm.episodes[0].frames, pushed.episodes[0].frames);
    }

    #[test]
    fn noise_that_lasts_pushes_the_car_further_off_its_line() {
        let laps = |steps: u64| {
            let params = json!({
                "env": { "car-racing": { "time_limit": 400 } }, "episodes": 3, "above": -200, "first_seed": 7,
                "noise": 0.5, "noise_steps": steps
            });
            driven(params, 1).unwrap()
        };
        // The driver steers the harder, the further he is off.
        let steering = |laps: &Demonstrations| -> f64 {
            let steers = laps.episodes.iter().flat_map(|lap| lap.actions.chunks(2).map(|action| action[0]));
            let (sum, count) = steers.fold((0.0, 0), |(sum, n), steer| (sum + f64::from(steer.abs()), n + 1));
            sum / f64::from(count)
        };
        let (shaken, pushed) = (laps(1), laps(12));
        assert!(steering(&pushed) > 1.25 * steering(&shaken), "{} {}", steering(&pushed), steering(&shaken));
        assert_eq!(pushed, laps(12));
    }

    #[test]
    fn too_few_good_laps_are_an_error_that_says_what_to_change() {
        let params = json!({
            "env": { "car-racing": { "time_limit": 5 } },
            "episodes": 1, "above": 900, "max_attempts": 2, "first_seed": 7
        });
        let message = driven(params, 1).unwrap_err().to_string();
        for part in ["0 of 2 laps", "above 900", "the best scored", "`max_attempts`"] {
            assert!(message.contains(part), "{message}");
        }
    }

    #[test]
    fn all_wrong_parameters_are_reported_at_once() {
        let params = json!({
            "env": { "car-racing": { "time_limit": 0 } },
            "episodes": 9, "max_attempts": 3, "first_seed": u64::MAX, "noise": -1.0,
            "noise_steps": 0
        });
        let problems = dril_stage_api::Kind::of::<Drive>().normalize(&params).unwrap_err();
        let mut paths: Vec<String> = problems.iter().map(|problem| problem.path.join(".")).collect();
        paths.sort();
        let wanted = ["env.car-racing.time_limit", "first_seed", "max_attempts", "noise", "noise_steps"];
        assert_eq!(paths, wanted);
        let old = json!({ "env": { "car-racing": {} }, "first_track_seed": 7 });
        let problems = dril_stage_api::Kind::of::<Drive>().normalize(&old).unwrap_err();
        assert_eq!(problems[0].message, "`first_track_seed` is now `first_seed`");
    }
}
