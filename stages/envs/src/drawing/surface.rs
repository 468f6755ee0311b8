//! What convex polygons are painted on: a [`super::canvas::Canvas`] with one sample per pixel, or a
//! [`super::coverage::AreaCanvas`], whose pixels are means over their area.

/// A point of the image: x to the right, y down, in pixels. The pixel at column c and row r has its centre at
/// (c + 0.5, r + 0.5).
pub type Point = [f64; 2];

/// A surface for convex polygons, painted over each other in order.
pub trait Surface {
    /// Size in columns and lines: x to the right, y down; the middle of line 0 is at y = 0.5.
    fn size(&self) -> [usize; 2];

    /// Fills the lines above `floor` with one ink.
    fn clear(&mut self, ink: u8, floor: usize);

    /// Fills a convex polygon (in either orientation) in the lines above `floor`.
    fn fill(&mut self, corners: &[Point], ink: u8, floor: usize);

    /// Fills an axis-aligned rectangle.
    fn fill_box(&mut self, from: Point, to: Point, ink: u8);

    /// True if the polygons of a mosaic, between [`Surface::begin_mosaic`] and [`Surface::end_mosaic`], are painted front to
    /// back: earlier ones hide later ones.
    const MOSAIC_FROM_FRONT: bool;

    /// Starts a mosaic: the polygons that follow share edges, and the background must not show through the seams.
    fn begin_mosaic(&mut self);

    /// Ends a mosaic; `floor` is the largest one of its polygons.
    fn end_mosaic(&mut self, floor: usize);
}
