//! The parameters of the kind `findings`.

use std::collections::BTreeMap;

use dril_stage_api::{FanIns, Problems};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::markdown::one_line;
use crate::samples::PORT;

/// Parameters of [`Findings`](super::Findings).
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FindingsParams {
    /// The title.
    pub title: String,
    /// The profile of the run; printed with the findings.
    pub profile: String,
    /// The profile with the sizes of the experiment; at any other the page states that sizes are reduced. Without it,
    /// these are `full` and `default`, the profile of a file without `profiles`.
    #[serde(default)]
    pub full_profile: Option<String>,
    /// The labels that distinguish trainings of one cell, such as `seed`. Without any, each cell has one training, and
    /// findings hold for these policies only.
    #[serde(default)]
    pub trainings: Vec<String>,
    /// The claims; they are tested as one family.
    pub claims: Vec<Claim>,
    /// Number of episodes behind each value of the reference.
    #[serde(default = "hundred")]
    pub reference_episodes: u32,
    /// Decimals of the differences in the Markdown table, 0 to 6. The CSV files have two more.
    #[serde(default, skip_serializing_if = "crate::caption::is_default")]
    pub decimals: u8,
    /// A sentence to print under the table.
    #[serde(default)]
    pub note: String,
}

fn hundred() -> u32 {
    100
}

/// A claim about differences `left` − `right` between cells, averaged over all pairs that agree in all other labels.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Claim {
    /// The claim as a sentence.
    pub claim: String,
    /// What it claims about the difference.
    pub is: Relation,
    /// The smallest relevant difference, in points.
    #[serde(default)]
    pub margin: f64,
    /// Labels and values of the cells on the left.
    pub left: BTreeMap<String, Value>,
    /// Labels and values of the cells on the right.
    pub right: BTreeMap<String, Value>,
    /// Labels and values of the cells on both sides.
    #[serde(default, rename = "where")]
    pub both: BTreeMap<String, Value>,
    /// Of cells that differ in these labels only, the best represents its side. It is chosen on every other episode and
    /// compared on the rest.
    #[serde(default)]
    pub best_of: Vec<String>,
}

/// What a claim says about a difference.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Relation {
    /// The left exceeds the right by more than the margin.
    Greater,
    /// The left exceeds the right by less than the margin.
    NotGreater,
    /// Neither exceeds the other by the margin.
    Equal,
}

/// The value of a label.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum Value {
    /// As it stands.
    Text(String),
    /// A number, without decimals.
    Whole(i64),
    /// A number.
    Number(f64),
}

impl std::fmt::Display for Value {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Text(text) => f.write_str(text),
            Self::Whole(number) => number.fmt(f),
            Self::Number(number) => number.fmt(f),
        }
    }
}

impl Relation {
    /// In words, with the margin.
    pub(crate) fn words(self, margin: f64) -> String {
        match (self, margin == 0.0) {
            (Self::Greater, true) => "left is greater".to_owned(),
            (Self::Greater, false) => format!("left is greater by more than {margin}"),
            (Self::NotGreater, true) => "left is smaller".to_owned(),
            (Self::NotGreater, false) => format!("left is not greater by {margin}"),
            (Self::Equal, _) => format!("within ±{margin}"),
        }
    }
}

impl FindingsParams {
    /// Reports labels that leave a claim without a cell, or without cells to choose from.
    pub(crate) fn check_labels(&self, inputs: &FanIns<'_>, problems: &mut Problems) {
        for (n, label) in self.trainings.iter().enumerate() {
            inputs.require(PORT, label, &format!("trainings.{n}"), problems);
        }
        if inputs.at(PORT).is_empty() {
            return;
        }
        for (n, claim) in self.claims.iter().enumerate() {
            for (side, labels) in [("left", &claim.left), ("right", &claim.right), ("where", &claim.both)] {
                // Cells may differ in their labels, but a side without any cell is an error.
                for label in labels.keys().filter(|label| !inputs.has(PORT, label)) {
                    inputs.unknown(PORT, label, &format!("claims.{n}.{side}.{label}"), problems);
                }
            }
            // Misspelt, it would choose between nothing, and cells that should be candidates would be pairs.
            let unknown = claim.best_of.iter().enumerate().filter(|(_, label)| !inputs.has(PORT, label));
            for (at, label) in unknown {
                inputs.unknown(PORT, label, &format!("claims.{n}.best_of.{at}"), problems);
            }
        }
    }

    pub(crate) fn check(&self, problems: &mut Problems) {
        let Self { title, profile, full_profile, note, .. } = self;
        let full_profile = full_profile.as_deref();
        crate::caption::Caption { title, profile, full_profile, note }.check(problems);
        crate::caption::check_decimals(self.decimals, problems);
        if self.claims.is_empty() {
            problems.add("claims", "`claims` is empty, expected at least one");
        }
        problems.positive("reference_episodes", self.reference_episodes.into());
        for (n, claim) in self.claims.iter().enumerate() {
            let mut wrong =
                |field: &str, message: String| problems.add(&format!("claims.{n}.{field}"), message);
            if one_line(&claim.claim).is_empty() {
                wrong("claim", "`claim` is empty, expected a sentence".to_owned());
            }
            if !(claim.margin.is_finite() && claim.margin >= 0.0) {
                wrong("margin", format!("`margin` is {}, expected a number from 0 on", claim.margin));
            }
            if claim.is == Relation::Equal && claim.margin == 0.0 {
                wrong(
                    "margin",
                    "no two means are found equal to the last digit, expected a margin above 0".to_owned(),
                );
            }
            if claim.left == claim.right {
                wrong("right", "`left` and `right` are the same cells".to_owned());
            }
            for label in claim.both.keys() {
                if claim.left.contains_key(label) || claim.right.contains_key(label) {
                    wrong("where", format!("`{label}` is in `left` or `right` too, expected it once"));
                }
            }
        }
    }
}
