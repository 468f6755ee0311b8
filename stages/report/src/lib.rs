//! Tables and statistics from the scores that stages wrote.
//!
//! | kind | from | to |
//! |---|---|---|
//! | [`Table`] | evaluations, published values | a table as CSV and Markdown |
//! | [`Leaderboard`] | named evaluations, published results | one list of both |
//! | [`Compare`] | evaluations on the same tracks | ratios and paired differences |
//! | [`Figure`] | CSV files of any stage | a figure as SVG, and its values as CSV |
//! | [`Findings`] | evaluations, claims about them | verdicts, with intervals and tests |
//! | [`Select`] | candidates and their evaluations | the best candidate, and the ranking |
//!
//! All are pure functions of the bytes and labels of their inputs, in the order of the matrix: no random numbers and no
//! clock.

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
