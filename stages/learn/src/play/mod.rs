//! Acting: playing listed episodes, and the stages and services that do.

pub mod act;
pub mod collect;
pub mod evaluate;
pub mod probe;
pub mod replay;
pub mod trace;
mod walk;
