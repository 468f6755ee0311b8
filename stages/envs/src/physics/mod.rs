//! Geometry and mass of rigid bodies, shared by the games.

pub mod convex;
pub mod mass;
