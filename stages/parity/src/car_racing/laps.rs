//! Whole laps by the driver of the recordings.

use dril_envs::Outcome;
use dril_envs::car_racing::driver::drive;
use dril_envs::car_racing::simulation::Simulation;

use super::motion::RULES;
use super::recording::Recordings;
use crate::error::CheckError;
use crate::report::Report;

/// Name of the script that a driver drives.
const SCRIPT: &str = "closed_loop";
/// Largest difference of a lap's return.
const RETURN: f64 = 15.0;
/// Steps after which the driver has lost his way.
const PATIENCE: usize = 3000;

/// Adds rows for laps not finished, and for their returns and lengths.
pub fn check(recordings: &Recordings, report: &mut Report) -> Result<(), CheckError> {
    let Some(meta) = &recordings.meta else { return Ok(()) };
    let known = recordings.seeds();
    let (mut unfinished, mut returns, mut steps) = (vec![], vec![], vec![]);
    for run in meta.runs.iter().filter(|run| run.script == SCRIPT && known.contains(&run.seed)) {
        let mut simulation = Simulation::new(recordings.track(run.seed)?, RULES);
        let mut total = 0.0;
        while !simulation.outcome().ended() && simulation.steps() < PATIENCE {
            total += simulation.step(&drive(&simulation)).reward;
        }
        let finished = simulation.outcome() == Outcome::Finished;
        unfinished.push(if finished { 0.0 } else { 1.0 });
        returns.push((total - run.ret).abs());
        steps.push((simulation.steps() as f64 - run.steps as f64).abs());
    }
    report.add(SCRIPT, "laps not finished", &unfinished, Some(0.0));
    report.add(SCRIPT, "return", &returns, Some(RETURN));
    report.add(SCRIPT, "steps", &steps, None);
    Ok(())
}
