//! Speed of the environments, one thread, in steps per CPU-second (user and system time of this process), so that a busy
//! machine disturbs it less.
//!
//! - `cargo bench -p dril-envs` shows where a step's microseconds go; `-- SECONDS` for each line (1 by default).
//! - `cargo bench -p dril-envs -- --serve` measures on demand for `benches/peers/envs.py`: each line of standard input is
//!   a configuration and a number of seconds, each answer the steps and the CPU-seconds that they took.
#![allow(clippy::print_stdout)]

mod cost;

use std::io::{BufRead, Write};

use dril_envs::wrappers::preprocess::SIDE;
use dril_envs::{EnvConfig, EnvError, Frame, FrameStack};

/// What is measured whole: CarRacing with its observation of 84 x 84 x 4.
const WHOLE: [(&str, &str); 3] = [
    ("car-racing-v3", r#"{"car-racing": {"version": "v3", "lap_complete_percent": 1.0}}"#),
    ("car-racing-v0", r#"{"car-racing": {"version": "v0"}}"#),
    ("lunar-lander", r#"{"lunar-lander": {}}"#),
];
/// Steps between two looks at the clock.
const SLICE: usize = 64;

/// CPU seconds that this process has used.
fn cpu_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 / 1e9
}

/// An environment that is stepped with random actions, and reset when an episode ends.
struct Player {
    env: Box<dyn dril_envs::Env>,
    stack: FrameStack,
    seed: u64,
    random: u64,
}

impl Player {
    fn new(name: &str) -> Result<Self, EnvError> {
        let known = WHOLE.iter().find(|(known, _)| *known == name);
        let config: EnvConfig =
            known.and_then(|(_, text)| serde_json::from_str(text).ok()).ok_or_else(|| EnvError::Config {
                field: name.into(),
                message: "not one of the configurations".into(),
            })?;
        let mut env = config.build()?;
        env.reset(0)?;
        Ok(Self { env, stack: FrameStack::new(SIDE * SIDE, 4), seed: 0, random: 1 })
    }

    fn step(&mut self) -> Result<(), EnvError> {
        let action = [0; 2].map(|_| self.uniform());
        let ended = self.env.step(&action)?.outcome.ended();
        if ended {
            self.seed += 1;
            self.env.reset(self.seed)?;
            self.stack.reset();
        }
        if let Frame::Image(pixels) = self.env.frame() {
            self.stack.push(pixels);
        }
        Ok(())
    }

    /// Evenly in [-1, 1): which generator does not matter here, only that it costs nothing.
    fn uniform(&mut self) -> f32 {
        self.random =
            self.random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.random >> 40) as f32 / (1u32 << 23) as f32 - 1.0
    }

    /// Plays for a while; steps, and the CPU-seconds they took.
    fn play(&mut self, seconds: f64) -> Result<(usize, f64), EnvError> {
        let (start, mut steps) = (cpu_seconds(), 0);
        loop {
            for _ in 0..SLICE {
                self.step()?;
            }
            steps += SLICE;
            let spent = cpu_seconds() - start;
            if spent > seconds {
                return Ok((steps, spent));
            }
        }
    }
}

/// Answers lines of `NAME SECONDS` until they end.
fn serve() -> Result<(), EnvError> {
    let mut players = Vec::new();
    for (name, _) in WHOLE {
        players.push((name, Player::new(name)?));
    }
    for line in std::io::stdin().lock().lines().map_while(Result::ok) {
        let (name, seconds) = line.split_once(' ').unwrap_or((&line, "1"));
        let player = players.iter_mut().find(|(known, _)| *known == name);
        let (steps, spent) = match (player, seconds.parse()) {
            (Some((_, player)), Ok(seconds)) => player.play(seconds)?,
            _ => (0, 0.0),
        };
        println!("{steps} {spent}");
        let _ = std::io::stdout().flush();
    }
    Ok(())
}

fn main() -> Result<(), EnvError> {
    // `cargo bench` adds an argument of its own, and `cargo test --benches` none of ours.
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    if arguments.iter().any(|argument| argument == "--serve") {
        return serve();
    }
    let seconds = arguments.first().and_then(|argument| argument.parse().ok()).unwrap_or(1.0);
    for (name, _) in WHOLE {
        let mut player = Player::new(name)?;
        player.play(seconds / 4.0)?;
        cost::measure(&format!("{name}, whole"), seconds, || player.step().is_ok());
    }
    cost::parts(seconds)
}
