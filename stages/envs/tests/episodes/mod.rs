//! Whole episodes as digests: every state, reward, observation and some images for people, for the tests of equal bits.

use dril_envs::car_racing::CarRacing;
use dril_envs::car_racing::driver::drive;
use dril_envs::car_racing::world::Motion;
use dril_envs::lunar_lander::LunarLander;
use dril_envs::lunar_lander::pilot::fly;
use dril_envs::{
    CarRacingConfig, CarRacingVersion, Demonstrations, Drive, Env, EnvError, Frame, LunarLanderConfig,
    Outcome, Step,
};
use dril_stage_api::testing::Bench;

/// A change here means that results of CarRacing or LunarLander change: raise the revision of every kind that plays.
pub const GOLDEN: [(&str, &str); 5] = [
    ("tracks", "d86f80af71a066e9"),
    ("car-racing v0", "fda3d0c0ba45bf84"),
    ("car-racing v3", "4f0ebf51c34b592e"),
    ("lunar-lander", "37f1a36f9091ee7a"),
    ("drive with noise", "5e9ca7127f6c0b56"),
];

/// Steps between two images for people.
const IMAGES: usize = 64;

/// The digests of all episodes, by name.
pub fn all() -> Result<[(&'static str, String); 5], Box<dyn std::error::Error>> {
    Ok([
        ("tracks", tracks()?),
        ("car-racing v0", car_racing(CarRacingVersion::V0)?),
        ("car-racing v3", car_racing(CarRacingVersion::V3)?),
        ("lunar-lander", lunar_lander()?),
        ("drive with noise", noisy_drive()?),
    ])
}

/// The start of the hash of all that happened.
struct Digest(blake3::Hasher);

impl Digest {
    fn new() -> Self {
        Self(blake3::Hasher::new())
    }

    fn numbers(&mut self, values: &[f64]) {
        values.iter().for_each(|value| {
            self.0.update(&value.to_bits().to_le_bytes());
        });
    }

    /// Reward, observation, and now and then an image for people.
    fn step(&mut self, env: &mut dyn Env, step: Step, at: usize) -> Result<(), EnvError> {
        self.numbers(&[step.reward]);
        match env.frame() {
            Frame::Image(pixels) => drop(self.0.update(pixels)),
            Frame::Vector(values) => self.numbers(&values.iter().map(|v| f64::from(*v)).collect::<Vec<_>>()),
        }
        if at.is_multiple_of(IMAGES) {
            self.0.update(&env.render(150, 100)?.rgb);
        }
        Ok(())
    }

    fn end(self) -> String {
        self.0.finalize().to_hex()[..16].to_owned()
    }
}

/// What is added to the driver's actions: pushes that last for some steps, full steering among them.
fn push(step: usize) -> [f32; 2] {
    match step / 12 % 8 {
        1 => [0.9, 0.0],
        2 => [-0.6, -0.1],
        5 => [-1.0, 0.3],
        6 => [0.37, -0.4],
        _ => [0.0, 0.0],
    }
}

/// An episode of CarRacing by the scripted driver, pushed off its line.
fn car_racing(version: CarRacingVersion) -> Result<String, EnvError> {
    let mut env = CarRacing::new(CarRacingConfig { version, time_limit: 600, ..CarRacingConfig::default() });
    let mut digest = Digest::new();
    env.reset(31)?;
    let mut outcome = Outcome::Running;
    let mut at = 0;
    while !outcome.ended() {
        let driver = env.simulation().map(drive).ok_or(EnvError::NotStarted)?;
        let push = push(at);
        let step =
            env.step(&[driver.steer as f32 + push[0], (driver.gas - driver.brake) as f32 + push[1]])?;
        at += 1;
        outcome = step.outcome;
        digest.step(&mut env, step, at)?;
        let car = env.simulation().ok_or(EnvError::NotStarted)?.car();
        for Motion { position, cos_sin, velocity, spin } in car.world().wheels().iter().chain([car.hull()]) {
            digest.numbers(&[*position, *cos_sin, *velocity, [*spin, 0.0]].concat());
        }
        for (tyre, stop) in car.tyres.iter().zip(car.world().stops()) {
            digest.numbers(&[tyre.omega, tyre.phase, f64::from(stop.hold())]);
        }
    }
    Ok(digest.end())
}

/// Episodes of LunarLander by the simple pilot: a landing, and one with the engines held at random that ends earlier.
fn lunar_lander() -> Result<String, EnvError> {
    let mut env = LunarLander::new(LunarLanderConfig::default());
    let mut digest = Digest::new();
    for (seed, piloted) in [(5, true), (6, false)] {
        env.reset(seed)?;
        let mut outcome = Outcome::Running;
        let mut at = 0;
        while !outcome.ended() {
            let seen = *env.simulation().ok_or(EnvError::NotStarted)?.observation();
            let held = [(at / 9 * 5 % 7) as f64 / 3.0 - 1.0, (at / 7 * 3 % 5) as f64 / 2.0 - 1.0];
            let step = env.step(&if piloted { fly(&seen) } else { held }.map(|v| v as f32))?;
            at += 1;
            outcome = step.outcome;
            digest.step(&mut env, step, at)?;
            let simulation = env.simulation().ok_or(EnvError::NotStarted)?;
            digest.numbers(simulation.observation());
            for body in simulation.motions() {
                let numbers = [body.position, body.velocity, [body.angle, body.spin]].concat();
                digest.numbers(&numbers.into_iter().map(f64::from).collect::<Vec<_>>());
            }
        }
    }
    Ok(digest.end())
}

/// Tracks of many seeds.
fn tracks() -> Result<String, EnvError> {
    let mut digest = Digest::new();
    for seed in 0..40 {
        let (track, _) = CarRacing::track(seed)?;
        for point in &track.way_points {
            digest.numbers(&[point.alpha, point.beta, point.x, point.y]);
        }
        let corners = track.tiles.iter().chain(track.kerbs.iter().map(|kerb| &kerb.corners));
        corners.flatten().for_each(|corner| digest.numbers(corner));
    }
    Ok(digest.end())
}

/// A recording of the stage kind `drive`, with noise.
fn noisy_drive() -> Result<String, Box<dyn std::error::Error>> {
    let params = serde_json::json!({
        "env": { "car-racing": { "time_limit": 120 } },
        "episodes": 1, "above": -200, "first_seed": 7, "noise": 0.3, "noise_steps": 5
    });
    let bench = Bench::new::<Drive>(&params, 3)?;
    bench.run()?;
    let mut digest = Digest::new();
    for episode in Demonstrations::read(&bench.output("demonstrations")?)?.episodes {
        digest.numbers(&[episode.score]);
        digest.numbers(&episode.actions.iter().map(|value| f64::from(*value)).collect::<Vec<_>>());
        digest.0.update(&episode.frames);
    }
    Ok(digest.end())
}
