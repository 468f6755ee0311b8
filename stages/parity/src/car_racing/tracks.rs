//! Tracks from recorded draws against recorded tracks.

use super::recording::Recordings;
use crate::error::CheckError;
use crate::npz::Array;
use crate::report::Report;

/// Largest difference of a coordinate or angle.
const LIMIT: f64 = 1e-6;

/// Adds rows for way points, tiles and kerbs.
pub fn check(recordings: &Recordings, report: &mut Report) -> Result<(), CheckError> {
    let Some(recorded) = &recordings.tracks else { return Ok(()) };
    let (mut way_points, mut tiles, mut kerbs, mut colours) = (vec![], vec![], vec![], vec![]);
    for seed in recordings.seeds() {
        let track = recordings.track(seed)?;
        let own: Vec<f64> = track.way_points.iter().flat_map(|p| [p.alpha, p.beta, p.x, p.y]).collect();
        way_points.push(largest_difference(&own, &recorded.array(&format!("track_{seed}"))?));
        let own: Vec<f64> = track.tiles.iter().flatten().flatten().copied().collect();
        tiles.push(beyond_rounding(&own, &recorded.array(&format!("tiles_{seed}"))?));
        let own: Vec<f64> = track.kerbs.iter().flat_map(|kerb| kerb.corners).flatten().collect();
        kerbs.push(beyond_rounding(&own, &recorded.array(&format!("kerbs_{seed}"))?));
        let own: Vec<f64> = track.kerbs.iter().map(|kerb| f64::from(u8::from(kerb.white))).collect();
        colours.push(largest_difference(&own, &recorded.array(&format!("kerb_white_{seed}"))?));
    }
    report.add("tracks", "way points, m and rad", &way_points, Some(LIMIT));
    report.add("tracks", "tiles beyond f32 rounding, m", &tiles, Some(LIMIT));
    report.add("tracks", "kerbs beyond f32 rounding, m", &kerbs, Some(LIMIT));
    report.add("tracks", "kerb colours", &colours, Some(0.0));
    Ok(())
}

/// Infinite where the lengths differ.
fn largest_difference(own: &[f64], recorded: &Array) -> f64 {
    if own.len() != recorded.values.len() {
        return f64::INFINITY;
    }
    own.iter().zip(&recorded.values).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// As [`largest_difference`], for values that were rounded to `f32` when they were recorded.
fn beyond_rounding(own: &[f64], recorded: &Array) -> f64 {
    if own.len() != recorded.values.len() {
        return f64::INFINITY;
    }
    let error = |(a, b): (&f64, &f64)| {
        let half_step = f64::from((*b as f32).abs().next_up() - (*b as f32).abs()) / 2.0;
        ((a - b).abs() - half_step).max(0.0)
    };
    own.iter().zip(&recorded.values).map(error).fold(0.0, f64::max)
}
