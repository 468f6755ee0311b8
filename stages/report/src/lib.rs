//! Tables and statistics from the scores that stages wrote.
//!
//! | kind | from | to |
//! |---|---|---|
//! | [`Table`] | evaluations, published values | their table as CSV and as Markdown |
//! | [`Leaderboard`] | named evaluations, published results | one list of both |
//! | [`Compare`] | evaluations on the same tracks | side by side, with ratio and paired difference |
//! | [`Figure`] | CSV files of any stage | their figure as SVG, and what it draws as CSV |
//! | [`Findings`] | evaluations, claims about them | which claims hold, with intervals and tests |
//! | [`Select`] | candidates and their evaluations | the best candidate, and the ranking |
//!
//! All are functions of the bytes and labels of their inputs alone: no random number, no clock, and no order but
//! the one in which the engine hands the inputs over (the order of the matrix).

mod caption;
mod compare;
pub mod figure;
pub mod findings;
pub mod html;
pub mod inference;
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
pub use figure::{Figure, FigureParams};
pub use findings::{Findings, FindingsParams};
pub use leaderboard::{Leaderboard, LeaderboardParams};
pub use select::{By, Select, SelectParams};
pub use table::{Table, TableParams};

/// The stage kinds of this package.
pub const KINDS: [Kind; 6] = [
    Kind::of::<Table>(),
    Kind::of::<Leaderboard>(),
    Kind::of::<Compare>(),
    Kind::of::<Select>(),
    Kind::of::<Figure>(),
    Kind::of::<Findings>(),
];
