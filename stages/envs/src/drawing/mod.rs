//! Drawing: polygons into pixels, images of one size into another, and the images that people look at.
//!
//! [`surface`] says what can be painted on; [`canvas`] and [`coverage`] are the two surfaces, both on top of the scan
//! conversion in [`scan`]. [`resample`] scales images, and [`image`] holds one with its PNG form.

pub mod canvas;
pub mod coverage;
pub mod image;
pub mod resample;
pub mod scan;
pub mod surface;
