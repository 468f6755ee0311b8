//! The playfield with its lighter squares.

use super::paint::Painter;
use super::palette;
use super::track::PLAYFIELD;
use crate::drawing::surface::Surface;

/// Squares of the pattern along half the playfield; every other one in both directions is lighter.
const HALF_SQUARES: i32 = 20;
/// Side of a square, world units.
const SQUARE: f64 = PLAYFIELD / HALF_SQUARES as f64;

impl<S: Surface> Painter<'_, S> {
    /// Black, the playfield, and its lighter squares.
    pub fn grass(&mut self) {
        let (middle, radius) = self.camera.view();
        let inside = middle.iter().all(|at| at.abs() + radius < PLAYFIELD);
        let ground = self.inks.of(if inside { palette::GRASS } else { palette::BLACK });
        self.surface.clear(ground, self.floor);
        if !inside {
            self.square([-PLAYFIELD; 2], 2.0 * PLAYFIELD, palette::GRASS);
        }
        let [columns, rows] = middle.map(|at| light_squares(at - radius, at + radius));
        for column in columns {
            for row in rows.clone() {
                let corner = [column, row].map(|index| f64::from(2 * index) * SQUARE);
                if self.camera.may_see(corner, 2.0 * SQUARE) {
                    self.square(corner, SQUARE, palette::PATCH);
                }
            }
        }
    }

    /// Fills the square with its lowest corner and side, world units.
    fn square(&mut self, [x, y]: [f64; 2], side: f64, colour: palette::Colour) {
        let corners = [[x, y], [x + side, y], [x + side, y + side], [x, y + side]];
        self.fill(&corners.map(|corner| self.camera.dot(corner)), colour);
    }
}

/// Half the numbers of the lighter squares that lie between two coordinates.
fn light_squares(from: f64, to: f64) -> std::ops::Range<i32> {
    let (first, end) = (-HALF_SQUARES / 2, HALF_SQUARES / 2);
    let index = |at: f64| (at / (2.0 * SQUARE)).floor().clamp(-1e3, 1e3) as i32;
    index(from).max(first)..(index(to) + 1).min(end)
}
