//! Compares the game with recordings: `cargo run --release -p dril-envs --example check -- FOLDER`.
#![allow(clippy::print_stdout)]

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let folder = std::env::args().nth(1).ok_or("expected the folder of the recordings")?;
    let report = dril_envs::check::run(folder.as_ref())?;
    print!("{report}");
    if report.passed() { Ok(()) } else { Err("a tolerance is missed".into()) }
}
