//! The colours of the image, as one byte each, and what they become: grey levels or RGB.

use crate::CarRacingVersion;

/// Red, green and blue.
pub type Rgb = [u8; 3];
/// Index of a colour in the palette.
pub type Colour = u8;

/// Outside the playfield, the bar, the wheels.
pub const BLACK: Colour = 0;
/// The playfield.
pub const GRASS: Colour = 1;
/// Its lighter squares.
pub const PATCH: Colour = 2;
/// The road's three shades, by tile number; a touched tile has the first.
pub const ROAD: [Colour; 3] = [3, 4, 5];
/// Every other kerb.
pub const KERB_RED: Colour = 6;
/// The other kerbs, and the speed gauge.
pub const WHITE: Colour = 7;
/// The mark that shows a wheel turning.
pub const WHEEL_MARK: Colour = 8;
/// The car.
pub const HULL: Colour = 9;
/// Gauges of the front wheels.
pub const BLUE: Colour = 10;
/// Gauges of the rear wheels.
pub const PURPLE: Colour = 11;
/// Gauge of the steering.
pub const GREEN: Colour = 12;
/// Gauge of the yaw rate.
pub const RED: Colour = 13;
/// Colours there are.
pub const COUNT: usize = 14;

/// RGB of every colour: the originals' colours in 8 bits.
pub fn rgb(version: CarRacingVersion) -> [Rgb; COUNT] {
    let mut rgb = NAMED;
    if version == CarRacingVersion::V3 {
        // It cuts off what OpenGL rounds.
        rgb[ROAD[1] as usize] = [104; 3];
        rgb[WHEEL_MARK as usize] = [77; 3];
    }
    rgb
}

/// The colours as version 0 draws them.
const NAMED: [Rgb; COUNT] = [
    [0, 0, 0],
    [102, 204, 102],
    [102, 230, 102],
    [102, 102, 102],
    [105, 105, 105],
    [107, 107, 107],
    [255, 0, 0],
    [255, 255, 255],
    [76, 76, 76],
    [204, 0, 0],
    [0, 0, 255],
    [51, 0, 255],
    [0, 255, 0],
    [255, 0, 0],
];

/// What is written into an image for each colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Inks(pub [u8; COUNT]);

impl Inks {
    /// The colours themselves, for an image to be looked up later.
    pub fn indices() -> Self {
        Self(std::array::from_fn(|colour| colour as u8))
    }

    /// What to write for a colour.
    pub fn of(&self, colour: Colour) -> u8 {
        self.0[colour as usize]
    }
}

/// Luma of an RGB colour, 0.299 R + 0.587 G + 0.114 B rounded: the fixed-point form of OpenCV's conversion.
pub fn grey([red, green, blue]: [u8; 3]) -> u8 {
    const SHIFT: u32 = 15;
    let sum = 9798 * u32::from(red) + 19235 * u32::from(green) + 3735 * u32::from(blue);
    ((sum + (1 << (SHIFT - 1))) >> SHIFT) as u8
}
