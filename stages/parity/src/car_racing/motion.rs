//! The car's motion against recorded runs: the same actions from the same start, no correction on the way.

use dril_envs::car_racing::car::{Car, Controls};
use dril_envs::car_racing::positions::{Pose, Velocity};
use dril_envs::car_racing::simulation::{Rules, Simulation};
use dril_stage_api::math;

use super::recording::{Recordings, Run};
use crate::error::CheckError;
use crate::npz::Array;
use crate::report::Report;

/// No end but the playfield's: recordings were made with all tiles as the goal.
pub const RULES: Rules = Rules { lap_share: 1.0, time_limit: usize::MAX };
/// How closely a script must be followed after how many steps, world units; later moments are reported only.
const POSES: [(usize, Option<f64>); 5] =
    [(0, Some(1e-3)), (50, Some(0.01)), (100, Some(0.05)), (200, None), (300, None)];
/// Most that a run may be ahead or behind in tiles.
const TILES: f64 = 1.0;
/// Largest relative error of one step.
const ONE_STEP: f64 = 1e-3;

/// Errors of one replayed run.
struct Replay {
    /// Distance of the hull from the recorded one, per moment.
    distance: Vec<f64>,
    /// Difference in visited tiles, per moment.
    tiles: Vec<f64>,
    /// Largest difference of a reward while the tiles agree.
    reward: f64,
}

/// Adds rows for every script, and for single steps.
pub fn check(recordings: &Recordings, report: &mut Report) -> Result<(), CheckError> {
    for script in recordings.scripts() {
        let mut replays = Vec::new();
        for seed in recordings.seeds() {
            if let Some(run) = recordings.run(seed, &script)? {
                replays.push(replay(&run, Simulation::new(recordings.track(seed)?, RULES)));
            }
        }
        add_rows(&script, &replays, report);
    }
    one_step(recordings, report)
}

fn add_rows(script: &str, replays: &[Replay], report: &mut Report) {
    for (moment, limit) in POSES {
        let errors: Vec<f64> = replays.iter().filter_map(|r| r.distance.get(moment).copied()).collect();
        report.add(script, &format!("pose at {moment}, m"), &errors, limit);
    }
    let worst = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
    let tiles: Vec<f64> = replays.iter().map(|r| worst(&r.tiles)).collect();
    report.add(script, "tiles visited", &tiles, Some(TILES));
    let rewards: Vec<f64> = replays.iter().map(|r| r.reward).collect();
    report.add(script, "reward while tiles agree", &rewards, Some(1e-9));
}

/// Drives a simulation by recorded actions.
fn replay(run: &Run, mut simulation: Simulation) -> Replay {
    let mut replay = Replay { distance: vec![], tiles: vec![], reward: 0.0 };
    let mut agreed = true;
    replay.look(run, &simulation, 0);
    for (step, action) in run.actions.values.chunks_exact(3).enumerate() {
        if simulation.outcome().ended() {
            break;
        }
        let reward = simulation.step(&controls(action)).reward;
        replay.look(run, &simulation, step + 1);
        agreed &= replay.tiles.last() == Some(&0.0);
        if agreed {
            replay.reward = replay.reward.max((reward - run.rewards.values[step + 1]).abs());
        }
    }
    replay
}

impl Replay {
    fn look(&mut self, run: &Run, simulation: &Simulation, moment: usize) {
        let [x, y] = simulation.car().hull().position;
        let state = run.states.row(moment);
        self.distance.push(math::hypot(x - state[0], y - state[1]));
        self.tiles.push((simulation.tiles().visits() as f64 - run.visited.values[moment]).abs());
    }
}

/// Steering, gas and brake as recorded.
pub fn controls(action: &[f64]) -> Controls {
    Controls { steer: action[0], gas: action[1], brake: action[2] }
}

/// One step from every recorded state of a run with all details: wheel speeds and velocities afterwards.
fn one_step(recordings: &Recordings, report: &mut Report) -> Result<(), CheckError> {
    let Some(traces) = &recordings.traces else { return Ok(()) };
    let keys: Vec<&str> = traces.names().filter_map(|name| name.strip_prefix("detail_wheels_")).collect();
    for key in keys {
        let array = |part: &str| traces.array(&format!("detail_{part}_{key}"));
        let (wheels, hulls, actions) = (array("wheels")?, array("hull")?, array("actions")?);
        let (mut tyres, mut bodies, mut joints) = (vec![], vec![], vec![]);
        for moment in 1..wheels.rows() {
            let mut car = place(&hulls, &wheels, moment - 1);
            let under = wheel_columns(&wheels, moment - 1, 12);
            car.control(&controls(actions.row(moment)));
            car.step(under.map(|count| count > 0.0));
            let omegas = car.tyres.map(|tyre| tyre.omega);
            tyres.push(relative(&omegas, &wheel_columns(&wheels, moment, 6)));
            let (hull, row) = (car.hull(), hulls.row(moment));
            let own = [hull.velocity[0], hull.velocity[1], hull.spin];
            bodies.push(relative(&own, &row[3..6]));
            let angles = [0, 1, 2, 3].map(|i| car.world().joint_angle(i));
            joints.push(largest(&angles, &wheel_columns(&wheels, moment, 9)));
        }
        report.add("one step", "wheel speeds, relative", &tyres, Some(ONE_STEP));
        report.add("one step", "hull velocity, relative", &bodies, Some(ONE_STEP));
        report.add("one step", "steering angle, rad", &joints, Some(ONE_STEP));
    }
    Ok(())
}

/// A car in a recorded state.
fn place(hulls: &Array, wheels: &Array, moment: usize) -> Car {
    let pose = |row: &[f64]| Pose { x: row[0] as f32, y: row[1] as f32, angle: row[2] as f32 };
    let velocity = |row: &[f64]| Velocity { linear: [row[3] as f32, row[4] as f32], spin: row[5] as f32 };
    let rows: [&[f64]; 5] = std::array::from_fn(|body| match body {
        0 => hulls.row(moment),
        wheel => &wheels.row(moment)[13 * (wheel - 1)..13 * wheel],
    });
    let mut car = Car::new(rows.map(pose));
    car.world_mut().place(rows.map(pose), rows.map(velocity));
    for (tyre, row) in car.tyres.iter_mut().zip(&rows[1..]) {
        (tyre.omega, tyre.gas, tyre.brake) = (row[6], row[7], row[8]);
    }
    car
}

fn wheel_columns(wheels: &Array, moment: usize, column: usize) -> [f64; 4] {
    [0, 1, 2, 3].map(|i| wheels.row(moment)[13 * i + column])
}

fn largest(own: &[f64], recorded: &[f64]) -> f64 {
    own.iter().zip(recorded).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// The largest difference in parts of the largest value, or of 1 where all are smaller.
fn relative(own: &[f64], recorded: &[f64]) -> f64 {
    largest(own, recorded) / recorded.iter().map(|v| v.abs()).fold(1.0, f64::max)
}
