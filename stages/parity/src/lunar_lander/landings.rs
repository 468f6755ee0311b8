//! Whole flights by the pilot of the recordings: recorded ones, and many of our own against the original's averages,
//! which are either known ([`check`]) or flown now by the bridge ([`check_gymnasium`]).

use dril_envs::gymnasium::GymnasiumConfig;
use dril_envs::lunar_lander::LunarLander;
use dril_envs::lunar_lander::pilot::fly;
use dril_envs::lunar_lander::simulation::{OBSERVED, Simulation};
use dril_envs::{Env, EnvConfig, EnvError, Frame, LunarLanderConfig, Outcome};
use dril_stage_api::Seed;
use rand::Rng;

use super::recording::{Recordings, Run};
use crate::error::CheckError;
use crate::report::Report;

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
/// The same pilot in Gymnasium's LunarLander-v3 (1,000 seeds): see docs/environments.md.
const ORIGINAL: Landings = Landings { rate: 0.998, mean_return: 282.8 };
/// The original as the bridge plays it.
const GYMNASIUM: &str = "LunarLanderContinuous-v3";

/// How a pilot fared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Landings {
    /// Landings per flight, 0 to 1.
    pub rate: f64,
    /// Mean sum of rewards of a flight.
    pub mean_return: f64,
}

impl Landings {
    /// How far the two figures are off another's, percent.
    fn off(&self, other: &Self) -> [f64; 2] {
        [self.rate / other.rate, self.mean_return / other.mean_return]
            .map(|ratio| 100.0 * (ratio - 1.0).abs())
    }
}

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
    let [rate, mean_return] = own_landings(SEEDS)?.off(&ORIGINAL);
    report.add("own seeds", "landing rate off the original's, %", &[rate], Some(OFF));
    report.add("own seeds", "mean return off the original's, %", &[mean_return], Some(OFF));
    Ok(())
}

/// Adds rows for as many flights in Gymnasium's own game, played by the bridge, as on our own seeds.
pub fn check_gymnasium(report: &mut Report) -> Result<(), CheckError> {
    let mut original = EnvConfig::Gymnasium(GymnasiumConfig::new(GYMNASIUM)).build()?;
    let (own, original) = (own_landings(SEEDS)?, land(original.as_mut(), SEEDS)?);
    for (whose, landings) in [("ours", own), ("Gymnasium's", original)] {
        report.add("landings", &format!("{whose}, rate, %"), &[100.0 * landings.rate], None);
        report.add("landings", &format!("{whose}, mean return"), &[landings.mean_return], None);
    }
    let [rate, mean_return] = own.off(&original);
    report.add("landings", "rate off Gymnasium's, %", &[rate], Some(OFF));
    report.add("landings", "mean return off Gymnasium's, %", &[mean_return], Some(OFF));
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

/// The pilot's landings in our game.
///
/// # Errors
/// None that is known: the pilot's actions are numbers.
pub fn own_landings(seeds: u64) -> Result<Landings, EnvError> {
    land(&mut LunarLander::new(LunarLanderConfig { time_limit: PATIENCE as u32 }), seeds)
}

/// The pilot's landings in a game that shows what LunarLander shows, on the seeds 0, 1, ...
///
/// # Errors
/// The game's own.
pub fn land(env: &mut dyn Env, seeds: u64) -> Result<Landings, EnvError> {
    let (mut landed, mut total) = (0, 0.0);
    for seed in 0..seeds {
        env.reset(seed)?;
        loop {
            let step = env.step(&fly(&seen(env)?).map(|value| value as f32))?;
            total += step.reward;
            landed += u64::from(step.outcome == Outcome::Finished);
            if step.outcome.ended() {
                break;
            }
        }
    }
    Ok(Landings { rate: landed as f64 / seeds as f64, mean_return: total / seeds as f64 })
}

fn seen(env: &dyn Env) -> Result<[f64; OBSERVED], EnvError> {
    let Frame::Vector(values) = env.frame() else { return Err(not_a_lander(0)) };
    let values: &[f32; OBSERVED] = values.try_into().map_err(|_| not_a_lander(values.len()))?;
    Ok(values.map(f64::from))
}

fn not_a_lander(seen: usize) -> EnvError {
    let message = format!("shows {seen} numbers, expected the {OBSERVED} of LunarLander");
    EnvError::Config { field: "env".to_owned(), message }
}
