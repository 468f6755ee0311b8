//! Tables and statistics from the scores that stages wrote.
//!
//! | kind | from | to |
//! |---|---|---|
//! | [`Table`] | evaluations, the thesis's values | their table as CSV and as Markdown |
//! | [`Leaderboard`] | named evaluations, published results | one list of both |
//! | [`Select`] | candidates and their evaluations | the best candidate, and the ranking |
//!
//! All three are functions of the bytes and labels of their inputs alone: no random number, no clock, and no order but
//! the one in which the engine hands the inputs over (the order of the matrix).

mod caption;
mod leaderboard;
mod markdown;
mod number;
mod pivot;
mod reference;
mod samples;
mod score;
mod select;
pub mod stats;
mod table;

use dril_stage_api::Kind;

pub use leaderboard::{Leaderboard, LeaderboardParams};
pub use select::{By, Select, SelectParams};
pub use table::{Table, TableParams};

/// The stage kinds of this package.
pub const KINDS: [Kind; 3] = [Kind::of::<Table>(), Kind::of::<Leaderboard>(), Kind::of::<Select>()];
