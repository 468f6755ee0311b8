//! The moon's surface: random heights, smoothed, with a flat pad in the middle. A pure function of its draws.

use super::shape::{HEIGHT, SCALE, WIDTH};

/// Points of the surface.
pub const POINTS: usize = 11;
/// Height draws: one more than there are points, since the smoothing wraps around.
pub const DRAWS: usize = POINTS + 1;
/// The points that are as high as the pad before smoothing.
const PAD: std::ops::RangeInclusive<usize> = 3..=7;
/// The pad's ends, among the points.
const PAD_ENDS: [usize; 2] = [4, 6];
/// What the original takes for a third.
const THIRD: f64 = 0.33;

/// Height that the landing pad is meant to have, world units.
pub const PAD_HEIGHT: f64 = HEIGHT / 4.0;
/// Height of the lander's origin over the pad when it stands, world units.
pub const STANDING: f64 = 18.0 / SCALE;
/// Heights are drawn evenly between 0 and this.
pub const MOST_HEIGHT: f64 = HEIGHT / 2.0;

/// The surface, from left to right.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Terrain {
    /// Its points, world units.
    pub points: [[f64; 2]; POINTS],
}

impl Terrain {
    /// From draws in [0, [`MOST_HEIGHT`]).
    pub fn new(draws: &[f64; DRAWS]) -> Self {
        let mut heights = *draws;
        heights[PAD].fill(PAD_HEIGHT);
        let smooth = |i: usize| THIRD * (heights[(i + DRAWS - 1) % DRAWS] + heights[i] + heights[i + 1]);
        Self { points: std::array::from_fn(|i| [WIDTH / (POINTS - 1) as f64 * i as f64, smooth(i)]) }
    }

    /// Where the ends of the pad are: x of the two flags.
    pub fn flags(&self) -> [f64; 2] {
        PAD_ENDS.map(|i| self.points[i][0])
    }

    /// The pieces between the points.
    pub fn edges(&self) -> impl Iterator<Item = [[f64; 2]; 2]> + '_ {
        self.points.windows(2).map(|pair| [pair[0], pair[1]])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pad_is_flat_and_a_hair_lower_than_it_is_meant_to_be() {
        let terrain = Terrain::new(&std::array::from_fn(|i| i as f64 / 2.0));
        for point in &terrain.points[PAD_ENDS[0]..=PAD_ENDS[1]] {
            assert!((point[1] - 3.3).abs() < 1e-12, "{point:?}");
        }
        assert_eq!(terrain.flags(), [8.0, 12.0]);
        assert_eq!(terrain.edges().count(), POINTS - 1);
    }

    #[test]
    fn the_first_point_is_smoothed_with_the_last_draw() {
        let mut draws = [1.0; DRAWS];
        draws[DRAWS - 1] = 4.0;
        let terrain = Terrain::new(&draws);
        assert!((terrain.points[0][1] - 0.33 * 6.0).abs() < 1e-12);
        assert!((terrain.points[POINTS - 1][1] - 0.33 * 6.0).abs() < 1e-12);
        assert!((terrain.points[1][1] - 0.33 * 3.0).abs() < 1e-12);
    }
}
