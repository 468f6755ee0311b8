//! How soon a script becomes unpredictable: the simulation against itself, begun a ten-thousandth otherwise.

use dril_envs::car_racing::positions::{BODIES, Velocity, anchor, rotate};
use dril_envs::car_racing::simulation::Simulation;
use dril_stage_api::math;

use super::motion::{RULES, controls};
use super::recording::Recordings;
use crate::error::CheckError;
use crate::report::Report;

/// By how much the second car is turned (radians), and how fast it moves and turns when it starts.
const NUDGE: f32 = 1e-4;
/// How far apart the two may come before the script counts as chaotic, world units.
const APART: f64 = 0.05;

/// Adds a row per script: the step from which a nudge of the start has grown five hundredfold, or the script's length.
/// A comparison of poses means little after it. `median` is the middle seed's, `worst` the last.
pub fn check(recordings: &Recordings, report: &mut Report) -> Result<(), CheckError> {
    for script in recordings.scripts() {
        let mut steps = Vec::new();
        for seed in recordings.seeds() {
            let Some(run) = recordings.run(seed, &script)? else { continue };
            let mut one = Simulation::new(recordings.track(seed)?, RULES);
            let mut other = Simulation::new(recordings.track(seed)?, RULES);
            nudge(&mut other);
            let apart = run.actions.values.chunks_exact(3).position(|action| {
                one.step(&controls(action));
                other.step(&controls(action));
                let [a, b] = [&one, &other].map(|simulation| simulation.car().hull().position);
                math::hypot(a[0] - b[0], a[1] - b[1]) > APART
            });
            steps.push(apart.unwrap_or(run.actions.rows()) as f64);
        }
        report.add(&script, "start off by 1e-4: step of 5 cm", &steps, None);
    }
    Ok(())
}

/// Turns the whole car about the hull's origin.
fn nudge(simulation: &mut Simulation) {
    let world = simulation.car_mut().world_mut();
    let mut poses = *world.poses();
    for pose in &mut poses {
        pose.angle += NUDGE;
    }
    for i in 1..BODIES {
        let [dx, dy] = rotate(poses[0].angle, anchor(i - 1));
        (poses[i].x, poses[i].y) = (poses[0].x + dx, poses[0].y + dy);
    }
    world.place(poses, [Velocity { linear: [NUDGE; 2], spin: NUDGE }; BODIES]);
}
