//! What can be painted on: a [`crate::raster::Canvas`] with one sample per pixel, or a [`crate::coverage::AreaCanvas`],
//! whose pixels are means over their area.

use crate::raster::Dot;

/// Something that takes convex polygons, later ones over earlier ones.
pub trait Surface {
    /// Columns and lines of its coordinates: x runs to the right, y down, and the middle of line 0 is at y = 0.5.
    fn size(&self) -> [usize; 2];

    /// Fills the lines above `floor` with one ink.
    fn clear(&mut self, ink: u8, floor: usize);

    /// Fills the convex polygon (corners in either turning direction) in the lines above `floor`.
    fn fill(&mut self, corners: &[Dot], ink: u8, floor: usize);

    /// Fills the axis-parallel rectangle between two corners.
    fn fill_box(&mut self, from: Dot, to: Dot, ink: u8);

    /// True where the polygons of one mosaic, between [`Surface::begin_mosaic`] and [`Surface::end_mosaic`], come from
    /// front to back: those filled first hide later ones.
    const MOSAIC_FROM_FRONT: bool;

    /// The polygons that follow share edges: what is below must not shine through the seams.
    fn begin_mosaic(&mut self);

    /// The mosaic is complete; `floor` is the largest that its polygons had.
    fn end_mosaic(&mut self, floor: usize);
}
