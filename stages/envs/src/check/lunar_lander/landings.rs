//! Whole flights by the pilot of the recordings: recorded ones, and many of our own against the original's averages.

use dril_stage_api::Seed;
use rand::Rng;

use super::{CheckError, Recordings, Report, Run, fly};
use crate::lunar_lander::LunarLander;
use crate::lunar_lander::simulation::Simulation;
use crate::{Env, LunarLanderConfig, Outcome};

/// Name of the script that a pilot flies.
const SCRIPT: &str = "heuristic";
/// Largest difference of a flight's return.
const RETURN: f64 = 5.0;
/// Steps after which an episode is cut off.
const PATIENCE: usize = 1000;
/// Own seeds flown.
const SEEDS: u64 = 500;
/// How far landing rate and mean return of own seeds may be off the original's, percent.
const OFF: f64 = 3.0;
/// Landings per flight, and mean return, of the same pilot in Gymnasium's LunarLander-v3 (1,000 seeds): see
/// docs/environments.md.
const ORIGINAL: [f64; 2] = [0.998, 282.8];

/// Adds rows for recorded flights, and for own seeds.
pub fn check(recordings: &Recordings, report: &mut Report) -> Result<(), CheckError> {
    let (mut missed, mut returns, mut steps) = (vec![], vec![], vec![]);
    for seed in recordings.seeds() {
        let Some(run) = recordings.run(seed, SCRIPT)? else { continue };
        let mut simulation = Simulation::new(&recordings.draws(seed)?, PATIENCE);
        let total = closed_loop(&run, seed, &mut simulation);
        let landed = simulation.outcome() == Outcome::Finished;
        missed.push(f64::from(u8::from(run.landed() && !landed)));
        returns.push((total - run.total()).abs());
        steps.push((simulation.steps() as f64 - run.actions.rows() as f64).abs());
    }
    report.add(SCRIPT, "not landed, closed loop", &missed, Some(0.0));
    report.add(SCRIPT, "return, closed loop", &returns, Some(RETURN));
    report.add(SCRIPT, "steps, closed loop", &steps, None);
    let own = own_landings(SEEDS);
    let off = |i: usize| 100.0 * (own[i] / ORIGINAL[i] - 1.0).abs();
    report.add("own seeds", "landing rate off the original's, %", &[off(0)], Some(OFF));
    report.add("own seeds", "mean return off the original's, %", &[off(1)], Some(OFF));
    Ok(())
}

/// Flies by what he sees, with the recorded draws, and others once those are used up.
fn closed_loop(run: &Run, seed: u64, simulation: &mut Simulation) -> f64 {
    let mut more = Seed(seed).stream("check/dispersion");
    let mut unit = || 2.0 * (f64::from(more.next_u32()) / f64::from(u32::MAX)) - 1.0;
    let mut total = 0.0;
    while !simulation.outcome().ended() {
        let dispersion = run.draws(simulation.steps()).unwrap_or_else(|| [unit(), unit()]);
        total += simulation.step(fly(simulation.observation()), dispersion).reward;
    }
    total
}

/// Landings per flight and mean return over the seeds 0, 1, ...
pub fn own_landings(seeds: u64) -> [f64; 2] {
    let mut env = LunarLander::new(LunarLanderConfig { time_limit: PATIENCE as u32 });
    let (mut landed, mut total) = (0, 0.0);
    for seed in 0..seeds {
        let mut running = env.reset(seed).is_ok();
        while running {
            let Some(observation) = env.simulation().map(Simulation::observation) else { break };
            let Ok(step) = env.step(&fly(observation).map(|value| value as f32)) else { break };
            total += step.reward;
            landed += u64::from(step.outcome == Outcome::Finished);
            running = !step.outcome.ended();
        }
    }
    [landed as f64 / seeds as f64, total / seeds as f64]
}
