//! Tracks of own seeds against what was measured on the original's.

use dril_envs::car_racing::CarRacing;
use dril_envs::car_racing::track::Track;
use dril_stage_api::math;

use super::recording::Recordings;
use crate::error::CheckError;
use crate::report::Report;

/// Own seeds looked at.
const SEEDS: u64 = 2000;
/// Part of the original's attempts that close, and how far off may be, percent.
const ACCEPTED: (f64, f64) = (92.8, 1.5);
/// Tiles of the original's tracks: mean and 5, 50 and 95 % quantiles, and how far off may be.
const TILES: ([f64; 4], f64) = ([293.0, 258.0, 292.0, 331.0], 4.0);
/// How far the mean track may be longer or shorter than its tiles are meant to be, share. A single track may differ by
/// more: its first and last point meet within a tile's length.
const LENGTH: f64 = 0.01;
/// How far the mean turn per way point may be off the recorded tracks', percent: those are few.
const TURN: f64 = 15.0;

/// Adds rows for acceptance, number of tiles, length and curvature.
pub fn check(recordings: &Recordings, report: &mut Report) -> Result<(), CheckError> {
    let (mut attempts, mut tiles, mut lengths, mut turns) = (0, vec![], vec![], vec![]);
    for (track, tries) in (0..SEEDS).filter_map(|seed| CarRacing::track(seed).ok()) {
        attempts += tries;
        tiles.push(track.tiles.len() as f64);
        lengths.push((length(&track) / (3.5 * track.tiles.len() as f64) - 1.0).abs());
        turns.push(turn(&track));
    }
    let accepted = 100.0 * tiles.len() as f64 / attempts.max(1) as f64;
    report.add("own tracks", "attempts accepted, points", &[(accepted - ACCEPTED.0).abs()], Some(ACCEPTED.1));
    tiles.sort_by(f64::total_cmp);
    let quantile = |share: f64| tiles.get((share * tiles.len() as f64) as usize).copied().unwrap_or(f64::NAN);
    let own = [mean(&tiles), quantile(0.05), quantile(0.5), quantile(0.95)];
    let errors: Vec<f64> = own.iter().zip(TILES.0).map(|(a, b)| (a - b).abs()).collect();
    report.add("own tracks", "tiles: mean and quantiles", &errors, Some(TILES.1));
    report.add("own tracks", "length off 3.5 a tile, mean share", &[mean(&lengths)], Some(LENGTH));
    report.add("own tracks", "length off 3.5 a tile, each", &lengths, None);
    let recorded: Result<Vec<f64>, CheckError> =
        recordings.seeds().into_iter().map(|seed| Ok(turn(&recordings.track(seed)?))).collect();
    let off = 100.0 * (mean(&turns) / mean(&recorded?) - 1.0).abs();
    report.add("own tracks", "mean turn off recorded, %", &[off], Some(TURN));
    Ok(())
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Length of the centre line, world units.
fn length(track: &Track) -> f64 {
    let points = &track.way_points;
    let next = points.iter().cycle().skip(1);
    points.iter().zip(next).map(|(a, b)| math::hypot(a.x - b.x, a.y - b.y)).sum()
}

/// Mean change of heading per way point, radians.
fn turn(track: &Track) -> f64 {
    let turns = track.way_points.windows(2).map(|pair| (pair[1].beta - pair[0].beta).abs());
    turns.sum::<f64>() / track.way_points.len() as f64
}
