//! Tables and statistics from the scores that stages wrote.
//!
//! | kind | from | to |
//! |---|---|---|
//! | [`Table`] | evaluations, published values | their table as CSV and as Markdown |
//! | [`Leaderboard`] | named evaluations, published results | one list of both |
//! | [`Compare`] | evaluations on the same tracks | side by side, with ratio and paired difference |
//! | [`Select`] | candidates and their evaluations | the best candidate, and the ranking |
//!
//! All are functions of the bytes and labels of their inputs alone: no random number, no clock, and no order but
//! the one in which the engine hands the inputs over (the order of the matrix).

mod caption;
mod compare;
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

pub use compare::{Compare, CompareParams};
pub use leaderboard::{Leaderboard, LeaderboardParams};
pub use select::{By, Select, SelectParams};
pub use table::{Table, TableParams};

/// The stage kinds of this package.
pub const KINDS: [Kind; 4] =
    [Kind::of::<Table>(), Kind::of::<Leaderboard>(), Kind::of::<Compare>(), Kind::of::<Select>()];
