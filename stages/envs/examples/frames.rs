//! Draws a strip of an episode: `cargo run --release -p dril-envs --example frames -- strip.png [seed] [v0|v3]`.
#![allow(clippy::print_stdout)]

use dril_envs::{CarRacingConfig, CarRacingVersion, EnvConfig, EnvError, Frame, RgbImage};

fn main() -> Result<(), EnvError> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().unwrap_or_else(|| "strip.png".into());
    let seed = arguments.next().and_then(|seed| seed.parse().ok()).unwrap_or(0);
    let version = match arguments.next().as_deref() {
        Some("v3") => CarRacingVersion::V3,
        _ => CarRacingVersion::V0,
    };
    let mut env = EnvConfig::CarRacing(CarRacingConfig { version, ..Default::default() }).build()?;
    env.reset(seed)?;
    let (mut images, mut greys) = (Vec::new(), Vec::new());
    for step in 0..200 {
        if [0, 20, 60, 100, 150, 199].contains(&step) {
            images.push(env.render(288, 288)?);
            if let Frame::Image(pixels) = env.frame() {
                greys.push(RgbImage::from_grey(84, 84, pixels).enlarged(3));
            }
        }
        let steer = if step % 80 < 40 { 0.3 } else { -0.3 };
        let outcome = env.step(&[steer, 0.3])?.outcome;
        if outcome.ended() {
            break;
        }
    }
    RgbImage::strip(&images).write_png(path.as_ref())?;
    RgbImage::strip(&greys).write_png(format!("{}.grey.png", path.trim_end_matches(".png")).as_ref())?;
    println!("{path}");
    Ok(())
}
