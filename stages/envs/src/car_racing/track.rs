//! The track generator: random checkpoints around the origin, and a walk that steers from one to the next until it has
//! closed a loop. A pure function of its draws, so recorded draws give the recorded track.

use std::f64::consts::{PI, TAU};

use dril_stage_api::math;

/// Checkpoints around the origin.
const CHECKPOINTS: usize = 12;
/// Draws that one attempt takes: angle and radius of each checkpoint.
pub const DRAWS: usize = 2 * CHECKPOINTS;
/// World units per unit of the original's drawing.
const SCALE: f64 = 6.0;
/// Outer radius of the checkpoints, world units.
const RADIUS: f64 = 900.0 / SCALE;
/// Distance between way points, world units.
const DETAIL_STEP: f64 = 21.0 / SCALE;
/// Largest change of heading per way point, radians.
const TURN_RATE: f64 = 0.31;
/// Half the road's width, world units.
pub const HALF_WIDTH: f64 = 40.0 / SCALE;
/// Width of a kerb, world units.
const KERB_WIDTH: f64 = 8.0 / SCALE;
/// Consecutive sharp turns in one direction that make a kerb.
const KERB_TURNS: usize = 4;
/// Heading change per way point above which a turn is sharp: a fifth of the turn rate.
const SHARP_TURN: f64 = TURN_RATE * 0.2;
/// The walk gives up after so many way points.
const WALK_LIMIT: usize = 2500;
/// Half the side of the playfield: leaving it ends the episode.
pub const PLAYFIELD: f64 = 2000.0 / SCALE;

/// A point in the world, units as above.
pub type Point = [f64; 2];

/// A point of the track's centre line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WayPoint {
    /// Angle around the origin, radians, as the walk counted it.
    pub alpha: f64,
    /// Heading, radians: forward is (-sin, cos).
    pub beta: f64,
    /// Position.
    pub x: f64,
    /// Position.
    pub y: f64,
}

/// The red and white border of a sharp turn, beside one tile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kerb {
    /// The tile it belongs to.
    pub tile: usize,
    /// Corners: inner and outer at the tile's own point, outer and inner at the point before.
    pub corners: [Point; 4],
    /// White, else red.
    pub white: bool,
}

/// A closed track.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Track {
    /// Centre line; the last point joins the first.
    pub way_points: Vec<WayPoint>,
    /// Corners of tile i, which joins way point i to the one before: left and right at i, right and left at i - 1.
    pub tiles: Vec<[Point; 4]>,
    /// Kerbs, in the order of their tiles.
    pub kerbs: Vec<Kerb>,
}

/// A track's draws from uniform numbers in [0, 1): angle offset in [0, pi/6) and radius in [50, 150), in turn.
pub fn scale_draws(uniform: impl IntoIterator<Item = f64>) -> impl Iterator<Item = f64> {
    uniform.into_iter().enumerate().map(|(at, u)| {
        let (low, high) = if at % 2 == 0 { (0.0, TAU / CHECKPOINTS as f64) } else { (RADIUS / 3.0, RADIUS) };
        low + (high - low) * u
    })
}

impl Track {
    /// The track of the first attempt that closes, and the number of attempts; none where the draws run out first.
    pub fn generate(draws: impl IntoIterator<Item = f64>) -> Option<(Self, usize)> {
        let mut draws = draws.into_iter();
        let mut walk = Vec::with_capacity(WALK_LIMIT);
        for attempt in 1.. {
            let mut taken = [0.0; DRAWS];
            for slot in &mut taken {
                *slot = draws.next()?;
            }
            walk_checkpoints(&checkpoints(&taken), &mut walk);
            if let Some(lap) = closed_lap(&walk) {
                return Some((Self::from_way_points(lap.to_vec()), attempt));
            }
        }
        None
    }

    /// Tiles and kerbs along a closed centre line.
    pub fn from_way_points(way_points: Vec<WayPoint>) -> Self {
        let tiles = (0..way_points.len()).map(|i| tile(&way_points, i)).collect();
        let flags = kerb_flags(&way_points);
        let kerbs = (0..way_points.len()).filter(|i| flags[*i]).map(|i| kerb(&way_points, i)).collect();
        Self { way_points, tiles, kerbs }
    }
}

#[derive(Clone, Copy)]
struct Checkpoint {
    alpha: f64,
    position: Point,
}

fn checkpoints(draws: &[f64; DRAWS]) -> [Checkpoint; CHECKPOINTS] {
    std::array::from_fn(|c| {
        let sector = TAU * c as f64 / CHECKPOINTS as f64;
        // First and last are fixed, so that every track passes the start line far outside.
        let (alpha, radius) = match c {
            0 => (0.0, 1.5 * RADIUS),
            _ if c == CHECKPOINTS - 1 => (sector, 1.5 * RADIUS),
            _ => (sector + draws[2 * c], draws[2 * c + 1]),
        };
        Checkpoint { alpha, position: [radius * math::cos(alpha), radius * math::sin(alpha)] }
    })
}

/// Steers from checkpoint to checkpoint, at most five laps.
fn walk_checkpoints(checkpoints: &[Checkpoint; CHECKPOINTS], walk: &mut Vec<WayPoint>) {
    walk.clear();
    let [mut x, mut y] = [1.5 * RADIUS, 0.0];
    let (mut beta, mut destination, mut laps, mut other_side) = (0.0_f64, 0, 0, false);
    while walk.len() < WALK_LIMIT && laps <= 4 {
        let mut alpha = math::atan2(y, x);
        if other_side && alpha > 0.0 {
            laps += 1;
            other_side = false;
        }
        if alpha < 0.0 {
            other_side = true;
            alpha += TAU;
        }
        let target = next_checkpoint(checkpoints, &mut destination, &mut alpha);
        let (sin, cos) = math::sin_cos(beta);
        let across = SCALE * (cos * (target[0] - x) + sin * (target[1] - y));
        while beta - alpha > 1.5 * PI {
            beta -= TAU;
        }
        while beta - alpha < -1.5 * PI {
            beta += TAU;
        }
        let before = beta;
        let turn = TURN_RATE.min((0.001 * across).abs());
        if across > 0.3 {
            beta -= turn;
        } else if across < -0.3 {
            beta += turn;
        }
        x += -sin * DETAIL_STEP;
        y += cos * DETAIL_STEP;
        walk.push(WayPoint { alpha, beta: before * 0.5 + beta * 0.5, x, y });
    }
}

/// The first checkpoint at or beyond `alpha`, from `destination` on; takes a turn off `alpha` when the list wraps.
fn next_checkpoint(checkpoints: &[Checkpoint], destination: &mut usize, alpha: &mut f64) -> Point {
    loop {
        let checkpoint = &checkpoints[*destination % CHECKPOINTS];
        if *alpha <= checkpoint.alpha {
            return checkpoint.position;
        }
        *destination += 1;
        if (*destination).is_multiple_of(CHECKPOINTS) {
            *alpha -= TAU;
        }
    }
}

/// The walk's last whole lap from start line to start line, where its ends meet.
fn closed_lap(walk: &[WayPoint]) -> Option<&[WayPoint]> {
    let start_line = -PI / CHECKPOINTS as f64;
    let crosses = |i: &usize| walk[*i].alpha > start_line && walk[*i - 1].alpha <= start_line;
    let mut crossings = (1..walk.len()).rev().filter(crosses);
    let (last, first) = (crossings.next()?, crossings.next()?);
    let lap = walk.get(first..last - 1)?;
    let (head, tail) = (lap.first()?, lap.last()?);
    let (sin, cos) = math::sin_cos(head.beta);
    let gap = math::hypot(cos * (head.x - tail.x), sin * (head.y - tail.y));
    (gap <= DETAIL_STEP).then_some(lap)
}

fn before(i: usize, n: usize, back: usize) -> usize {
    (i + n - back % n) % n
}

/// Two points of the cross section at a way point, `from` and `to` units to the right of the centre.
fn section(point: &WayPoint, from: f64, to: f64) -> [Point; 2] {
    let (sin, cos) = math::sin_cos(point.beta);
    [from, to].map(|right| [point.x + right * cos, point.y + right * sin])
}

fn tile(points: &[WayPoint], i: usize) -> [Point; 4] {
    let [left, right] = section(&points[i], -HALF_WIDTH, HALF_WIDTH);
    let [left_before, right_before] = section(&points[before(i, points.len(), 1)], -HALF_WIDTH, HALF_WIDTH);
    [left, right, right_before, left_before]
}

fn kerb(points: &[WayPoint], i: usize) -> Kerb {
    let previous = &points[before(i, points.len(), 1)];
    let side = (previous.beta - points[i].beta).signum();
    let (from, to) = (side * HALF_WIDTH, side * (HALF_WIDTH + KERB_WIDTH));
    let [inner, outer] = section(&points[i], from, to);
    let [inner_before, outer_before] = section(previous, from, to);
    Kerb { tile: i, corners: [inner, outer, outer_before, inner_before], white: i.is_multiple_of(2) }
}

/// Which tiles have a kerb: those at the end of four sharp turns in one direction, and the three tiles before.
fn kerb_flags(points: &[WayPoint]) -> Vec<bool> {
    let n = points.len();
    let turn = |i: usize, back: usize| points[before(i, n, back)].beta - points[before(i, n, back + 1)].beta;
    let mut flags: Vec<bool> = (0..n)
        .map(|i| {
            let side = turn(i, 0).signum();
            (0..KERB_TURNS).all(|k| turn(i, k).abs() > SHARP_TURN && turn(i, k).signum() == side)
        })
        .collect();
    // In place and forward, as the original: what wraps around to the end is widened once more.
    for i in 0..n {
        if flags[i] {
            for back in 0..KERB_TURNS {
                flags[before(i, n, back)] = true;
            }
        }
    }
    flags
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn distance(a: Point, b: Point) -> f64 {
        (a[0] - b[0]).hypot(a[1] - b[1])
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn a_track_is_a_closed_ring_of_convex_tiles(uniform in prop::collection::vec(0.0..1.0f64, 20 * DRAWS)) {
            let Some((track, attempts)) = Track::generate(scale_draws(uniform)) else { return Ok(()) };
            prop_assert!(attempts <= 20);
            let n = track.tiles.len();
            prop_assert!((200..400).contains(&n), "{} tiles", n);
            for (i, tile) in track.tiles.iter().enumerate() {
                let previous = &track.tiles[before(i, n, 1)];
                prop_assert!(distance(tile[3], previous[0]) < 1e-9 && distance(tile[2], previous[1]) < 1e-9);
                prop_assert!((distance(tile[0], tile[1]) - 2.0 * HALF_WIDTH).abs() < 1e-9);
            }
            for kerb in &track.kerbs {
                let [inner, outer, ..] = kerb.corners;
                prop_assert!((distance(inner, outer) - KERB_WIDTH).abs() < 1e-9);
                let edge = track.tiles[kerb.tile];
                prop_assert!(distance(inner, edge[0]).min(distance(inner, edge[1])) < 1e-9);
            }
        }
    }

    #[test]
    fn draws_that_run_out_make_no_track() {
        assert_eq!(Track::generate([0.1; DRAWS - 1]), None);
        assert_eq!(Track::generate(scale_draws(std::iter::empty())), None);
    }

    #[test]
    fn draws_are_scaled_to_angle_and_radius_in_turn() {
        let scaled: Vec<f64> = scale_draws([0.5, 0.5, 0.0, 1.0]).collect();
        assert!((scaled[0] - PI / 12.0).abs() < 1e-12 && (scaled[1] - 100.0).abs() < 1e-12, "{scaled:?}");
        assert!(scaled[2] == 0.0 && (scaled[3] - 150.0).abs() < 1e-12, "{scaled:?}");
    }
}
