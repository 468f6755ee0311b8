//! Images of recorded states against recorded images.

use dril_envs::CarRacingVersion;
use dril_envs::car_racing::render::{Output, Renderer};
use dril_envs::car_racing::scene::Scene;
use dril_envs::wrappers::preprocess::FULL;

use super::playback::{Playback, body};
use super::recording::Recordings;
use crate::error::CheckError;
use crate::npz::{Array, Npz};
use crate::report::Report;

/// Rows of the bar and columns of the score text, which other fonts draw otherwise.
const TEXT: (std::ops::Range<usize>, std::ops::Range<usize>) = (84..96, 0..14);
/// Levels that a channel may differ by, and the largest part of the pixels that may differ by more, percent.
const V0: (f64, f64) = (1.0, 0.1);
/// The same for version 3.
const V3: (f64, f64) = (8.0, 2.0);

/// Adds a row per script and version.
pub fn check(recordings: &Recordings, report: &mut Report) -> Result<(), CheckError> {
    if let Some(frames) = &recordings.v0_frames {
        v0(recordings, frames, report)?;
    }
    if let Some(frames) = &recordings.v3_frames {
        v3(recordings, frames, report)?;
    }
    Ok(())
}

fn v0(recordings: &Recordings, frames: &Npz, report: &mut Report) -> Result<(), CheckError> {
    let keys: Vec<String> =
        frames.names().filter_map(|name| name.strip_prefix("f_")).map(str::to_owned).collect();
    let mut errors = std::collections::BTreeMap::<&str, Vec<f64>>::new();
    let mut renderer = Renderer::new(CarRacingVersion::V0, Output::Rgb, [FULL; 2]);
    for key in &keys {
        let Some((seed, script)) = key.split_once('_') else { continue };
        let Ok(seed) = seed.parse() else { continue };
        let track = recordings.track(seed)?;
        let [images, states, touched] =
            ["f", "s", "touched"].map(|part| frames.array(&format!("{part}_{key}")));
        let (images, states, touched) = (images?, states?, touched?);
        for moment in 0..images.rows() {
            let faded = unpacked(&touched, moment, track.tiles.len());
            renderer.draw(&track, &scene_of(states.row(moment), &faded));
            let off = percent_off(renderer.pixels(), images.row(moment), V0.0);
            errors.entry(script).or_default().push(off);
        }
    }
    for (script, errors) in errors {
        report.add(script, "v0 pixels off by more than 1, %", &errors, Some(V0.1));
    }
    Ok(())
}

fn v3(recordings: &Recordings, frames: &Npz, report: &mut Report) -> Result<(), CheckError> {
    let keys: Vec<String> =
        frames.names().filter_map(|name| name.strip_prefix("f_")).map(str::to_owned).collect();
    let mut errors = std::collections::BTreeMap::<&str, Vec<f64>>::new();
    let mut renderer = Renderer::new(CarRacingVersion::V3, Output::Rgb, [FULL; 2]);
    for key in &keys {
        let Some((seed, script)) = key.split_once('_') else { continue };
        let Ok(seed) = seed.parse() else { continue };
        let Some(run) = recordings.run(seed, script)? else { continue };
        let [images, moments] = ["f", "i"].map(|part| frames.array(&format!("{part}_{key}")));
        let (images, moments) = (images?, moments?);
        let mut playback = Playback::new(&run, recordings.track(seed)?);
        for (image, moment) in moments.values.iter().enumerate() {
            playback.go_to(*moment as usize);
            renderer.draw(&playback.track, &playback.scene());
            let off = percent_off(renderer.pixels(), images.row(image), V3.0);
            errors.entry(script).or_default().push(off);
        }
    }
    for (script, errors) in errors {
        report.add(script, "v3 pixels off by more than 8, %", &errors, Some(V3.1));
    }
    Ok(())
}

/// The scene of a row: the columns of a run's states, then score, time, and x, y, angle of each wheel.
fn scene_of<'a>(row: &[f64], faded: &'a [bool]) -> Scene<'a> {
    let four = |from: usize| [0, 1, 2, 3].map(|i| row[from + i]);
    Scene {
        hull: body(&row[..3], &row[3..6]),
        wheels: [0, 1, 2, 3].map(|i| body(&row[20 + 3 * i..23 + 3 * i], &[0.0; 3])),
        phases: four(14),
        omegas: four(10),
        steering: row[6],
        time: row[19],
        score: row[18],
        faded,
    }
}

/// Flags packed eight to a byte, the first in the highest bit.
fn unpacked(packed: &Array, moment: usize, count: usize) -> Vec<bool> {
    let row = packed.row(moment);
    (0..count).map(|i| row.get(i / 8).is_some_and(|byte| (*byte as u8) & (0x80 >> (i % 8)) != 0)).collect()
}

/// Percent of the pixels outside the text of which a channel differs by more than `levels`.
fn percent_off(own: &[u8], recorded: &[f64], levels: f64) -> f64 {
    let (mut off, mut all) = (0, 0);
    for (at, (a, b)) in own.chunks_exact(3).zip(recorded.chunks_exact(3)).enumerate() {
        if TEXT.0.contains(&(at / FULL)) && TEXT.1.contains(&(at % FULL)) {
            continue;
        }
        all += 1;
        off += usize::from(a.iter().zip(b).any(|(a, b)| (f64::from(*a) - b).abs() > levels));
    }
    100.0 * off as f64 / f64::from(all.max(1))
}
