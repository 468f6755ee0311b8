//! Ground and first moment from recorded draws.

use dril_envs::lunar_lander::simulation::Simulation;
use dril_envs::lunar_lander::start::{Start, Velocities};

use super::recording::Recordings;
use crate::error::CheckError;
use crate::report::Report;

/// Largest difference of the ground.
const GROUND: f64 = 1e-6;
/// Largest difference of a pose or velocity after the reset.
const FIRST: f64 = 1e-4;

/// Adds rows for the ground, poses and velocities.
pub fn check(recordings: &Recordings, report: &mut Report) -> Result<(), CheckError> {
    let (mut grounds, mut poses, mut legs, mut velocities) = (vec![], vec![], vec![], vec![]);
    for seed in recordings.seeds() {
        let draws = recordings.draws(seed)?;
        let simulation = Simulation::new(&draws, usize::MAX);
        let own: Vec<f64> = simulation.terrain().points.iter().flatten().copied().collect();
        grounds.push(largest(&own, &recordings.array("terrain", seed)?.values));
        let Some(script) = recordings.scripts().into_iter().next() else { continue };
        let Some(run) = recordings.run(seed, &script)? else { continue };
        let (start, row) = (Start::pushed(draws.force), run.bodies.row(0));
        let own = |values: &[f32]| values.iter().copied().map(f64::from).collect::<Vec<_>>();
        let [x, y] = start.position;
        poses.push(largest(&own(&[x, y, start.angle]), &row[..3]));
        legs.push(largest(&own(&start.legs), &[row[8] - row[2], row[14] - row[2]]));
        let Velocities { linear: [vx, vy], spin, legs: [right, left] } = start.shown;
        let speeds = own(&[vx, vy, spin, right + spin, left + spin]);
        velocities.push(largest(&speeds, &[row[3], row[4], row[5], row[11], row[17]]));
    }
    report.add("start", "ground, m", &grounds, Some(GROUND));
    report.add("start", "lander's pose, m and rad", &poses, Some(FIRST));
    report.add("start", "legs' angles, rad", &legs, Some(FIRST));
    report.add("start", "velocities, m/s and rad/s", &velocities, Some(FIRST));
    Ok(())
}

/// Infinite where the lengths differ.
fn largest(own: &[f64], recorded: &[f64]) -> f64 {
    if own.len() != recorded.len() {
        return f64::INFINITY;
    }
    own.iter().zip(recorded).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}
