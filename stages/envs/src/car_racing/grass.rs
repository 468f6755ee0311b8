//! The playfield with its lighter squares, computed per pixel in fixed point.

use super::camera::Camera;
use super::palette::{self, Inks};
use super::raster::Canvas;
use super::track::PLAYFIELD;

/// Squares of the pattern along half the playfield; every other one in both directions is lighter.
const HALF_SQUARES: i32 = 20;
/// Side of a square, world units.
const SQUARE: f64 = PLAYFIELD / HALF_SQUARES as f64;
/// Fractional bits of a position in squares; the rest holds +-128 squares, more than the widest view.
const BITS: u32 = 24;
/// The playfield's edges in fixed point.
const EDGE: i32 = HALF_SQUARES << BITS;

/// Fills the rows above `floor` with black, grass and squares.
pub fn draw(canvas: &mut Canvas, camera: &Camera, inks: &Inks, floor: usize) {
    let width = canvas.width();
    let [black, grass, patch] =
        [palette::BLACK, palette::GRASS, palette::PATCH].map(|colour| inks.of(colour));
    let origin = fixed(camera.world([0.5, 0.5]));
    let across = fixed_difference(camera, [1.5, 0.5]);
    let down = fixed_difference(camera, [0.5, 1.5]);
    for row in 0..floor {
        let shift = canvas.shift(row);
        let at = [0, 1].map(|axis| {
            let shifted = (f64::from(across[axis]) * shift) as i32;
            origin[axis].wrapping_add(down[axis].wrapping_mul(row as i32)).wrapping_add(shifted)
        });
        let pixels = &mut canvas.row_mut(row)[..width];
        for (column, pixel) in pixels.iter_mut().enumerate() {
            let [u, v] = [0, 1].map(|axis| at[axis].wrapping_add(across[axis].wrapping_mul(column as i32)));
            let inside = (u.wrapping_add(EDGE) as u32) < 2 * EDGE as u32
                && (v.wrapping_add(EDGE) as u32) < 2 * EDGE as u32;
            let light = ((u | v) >> BITS) & 1 == 0;
            *pixel = if inside { if light { patch } else { grass } } else { black };
        }
    }
}

fn fixed(point: [f64; 2]) -> [i32; 2] {
    point.map(|v| (v / SQUARE * f64::from(1 << BITS)) as i32)
}

/// The step from the first pixel to a neighbour.
fn fixed_difference(camera: &Camera, neighbour: [f64; 2]) -> [i32; 2] {
    let (from, to) = (camera.world([0.5, 0.5]), camera.world(neighbour));
    fixed([to[0] - from[0], to[1] - from[1]])
}
