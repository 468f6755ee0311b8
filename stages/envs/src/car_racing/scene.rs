//! What there is to draw: all that an image depends on, whether it comes from a running episode or from a recording.

use super::world::Motion;

/// One moment of an episode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scene<'a> {
    /// The hull.
    pub hull: Motion,
    /// The wheels: front left, front right, rear left, rear right.
    pub wheels: [Motion; 4],
    /// Rotation angle of each wheel, radians.
    pub phases: [f64; 4],
    /// Rotation speed of each wheel, radians per second.
    pub omegas: [f64; 4],
    /// Steering angle of the front left wheel, radians.
    pub steering: f64,
    /// Seconds since the episode's start; the view zooms in during the first.
    pub time: f64,
    /// The score that stands in the corner.
    pub score: f64,
    /// Per tile: true once the car has touched it.
    pub faded: &'a [bool],
}
