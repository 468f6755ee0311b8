//! Recorded flights: the same actions and draws from the same start, no correction on the way.

use dril_envs::lunar_lander::simulation::{OBSERVED, Simulation};

use super::recording::{Recordings, Run};
use crate::error::CheckError;
use crate::report::Report;

/// The script that is compared up to a tolerance; where engines fire, or after a contact, small differences grow.
const FREE_FALL: &str = "noop";
/// Largest difference of an observation before anything touches the ground.
const FLIGHT: f64 = 1e-3;
/// Values of an observation that are no flags.
const SMOOTH: usize = 6;

/// What a replay showed.
struct Replay {
    /// Largest difference of an observation before the first contact.
    flight: f64,
    /// Largest difference of a reward in the same time.
    reward: f64,
    /// Difference of the sum of rewards.
    total: f64,
    /// Difference in steps.
    steps: f64,
    /// 1 where one ends otherwise than the other.
    otherwise: f64,
}

/// Adds rows for every script.
pub fn check(recordings: &Recordings, report: &mut Report) -> Result<(), CheckError> {
    for script in recordings.scripts() {
        let mut replays = Vec::new();
        for seed in recordings.seeds() {
            if let Some(run) = recordings.run(seed, &script)? {
                replays.push(replay(&run, Simulation::new(&recordings.draws(seed)?, usize::MAX)));
            }
        }
        let limit = (script == FREE_FALL).then_some(FLIGHT);
        let mut add = |measure: &str, of: fn(&Replay) -> f64, limit| {
            report.add(&script, measure, &replays.iter().map(of).collect::<Vec<_>>(), limit);
        };
        add("observations before contact", |replay| replay.flight, limit);
        add("rewards before contact", |replay| replay.reward, None);
        add("return, open loop", |replay| replay.total, None);
        add("steps, open loop", |replay| replay.steps, None);
        add("ends otherwise, open loop", |replay| replay.otherwise, None);
    }
    Ok(())
}

fn replay(run: &Run, mut simulation: Simulation) -> Replay {
    let mut replay = Replay { flight: 0.0, reward: 0.0, total: -run.total(), steps: 0.0, otherwise: 0.0 };
    let mut flying = true;
    let mut last = None;
    replay.look(run, simulation.observation(), 0);
    for (step, action) in run.actions.values.chunks_exact(2).enumerate() {
        if simulation.outcome().ended() {
            break;
        }
        let result = simulation.step([action[0], action[1]], run.draws(step).unwrap_or_default());
        replay.total += result.reward;
        last = Some(result.reward);
        let recorded = run.observations.row(step + 1);
        let ended = result.outcome.ended() || step + 1 == run.actions.rows();
        let touches = |observation: &[f64]| observation[SMOOTH..].iter().any(|flag| *flag > 0.0);
        flying &= !ended && !touches(recorded) && !touches(simulation.observation());
        if flying {
            replay.look(run, simulation.observation(), step + 1);
            let off = (result.reward - run.rewards.values[step + 1]).abs();
            replay.reward = replay.reward.max(off);
        }
    }
    replay.steps = (simulation.steps() as f64 - run.actions.rows() as f64).abs();
    let end = |reward: Option<f64>| reward.filter(|reward| reward.abs() == 100.0);
    replay.otherwise = f64::from(u8::from(end(last) != end(run.rewards.values.last().copied())));
    replay.total = replay.total.abs();
    replay
}

impl Replay {
    fn look(&mut self, run: &Run, observation: &[f64; OBSERVED], moment: usize) {
        let recorded = run.observations.row(moment);
        for (own, recorded) in observation[..SMOOTH].iter().zip(recorded) {
            self.flight = self.flight.max((own - recorded).abs());
        }
    }
}
