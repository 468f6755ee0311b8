//! The parameters of the kind `figure`, and what a preset fills in.

use dril_stage_api::Problems;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::ticks::Scale;

/// Parameters of [`Figure`](super::Figure).
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FigureParams {
    /// The heading.
    pub title: String,
    /// A usual kind of figure: fills in whatever of `x`, `y`, `layers` and `scale` is left out.
    #[serde(default)]
    pub preset: Option<Preset>,
    /// The column along the horizontal axis; without it, the number of the row, from 0.
    #[serde(default)]
    pub x: Option<String>,
    /// The columns to draw, each a measure of its own; several columns in one entry share a panel and an axis.
    #[serde(default)]
    pub y: Vec<Measure>,
    /// The labels whose values tell rows of panels apart. `measure` stands for the entries of `y`.
    #[serde(default)]
    pub rows: Vec<String>,
    /// The labels whose values tell columns of panels apart.
    #[serde(default)]
    pub columns: Vec<String>,
    /// The labels whose values tell colours apart. `column` stands for the columns of the files.
    #[serde(default)]
    pub colour: Vec<String>,
    /// The labels whose values are taken together: lines become the mean over them.
    #[serde(default)]
    pub pool: Vec<String>,
    /// For intervals: the labels whose values tell the lines of the figure apart; without it, all labels that vary and
    /// have no other place.
    #[serde(default)]
    pub categories: Vec<String>,
    /// What is drawn.
    #[serde(default)]
    pub layers: Layers,
    /// Lines and regions at fixed values.
    #[serde(default)]
    pub rules: Vec<Rule>,
    /// Logarithmic axes.
    #[serde(default)]
    pub scale: Scales,
    /// The part that is shown; what lies outside is not drawn.
    #[serde(default)]
    pub range: Ranges,
    /// What stands at the horizontal axis, where the column's name does not do.
    #[serde(default)]
    pub x_title: String,
    /// What stands at the vertical axis, where the columns' names do not do.
    #[serde(default)]
    pub y_title: String,
    /// A sentence to print under the figure.
    #[serde(default)]
    pub note: String,
    /// The profile at which the figure is made; at any other than `full_profile` it says that its sizes are reduced.
    #[serde(default)]
    pub profile: String,
    /// The profile whose sizes are those of the experiment.
    #[serde(default = "crate::caption::full_profile")]
    pub full_profile: String,
}

/// What a figure's `y` lists.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum Measure {
    /// A column; `action_*` means all columns that begin so.
    Column(String),
    /// Columns that belong together.
    Columns {
        /// Their names.
        columns: Vec<String>,
        /// What they are, as it stands at the axis.
        title: String,
    },
}

impl Measure {
    /// Its columns, with `*` at the end for all that begin so.
    pub(crate) fn columns(&self) -> Vec<&str> {
        match self {
            Self::Column(name) => vec![name],
            Self::Columns { columns, .. } => columns.iter().map(String::as_str).collect(),
        }
    }

    /// What it is called.
    pub(crate) fn title(&self) -> &str {
        match self {
            Self::Column(name) => name,
            Self::Columns { title, .. } => title,
        }
    }
}

/// A usual kind of figure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// Mean over trainings, and the band from the lowest to the highest: `score_mean_10` over `step`.
    Curve,
    /// Losses over epochs on a logarithmic axis: `train_loss` and `val_loss` over `epoch`.
    Losses,
    /// The score of each training episode, and the mean of the last 100.
    Episodes,
    /// The scores of an evaluation in order, and their mean.
    Scores,
    /// One episode step by step: a row of panels for each measure.
    Trace,
    /// How often each value occurs.
    Distribution,
    /// Means with their 95 % intervals.
    Interval,
}

/// The layers, drawn in the order in which they stand here.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Layers {
    /// The area between each line and 0.
    pub area: Option<Area>,
    /// A band around a line: over the labels of `pool`, or over the last rows.
    pub band: Option<Band>,
    /// How often each value occurs; the measure is then along the horizontal axis.
    pub histogram: Option<Histogram>,
    /// One mark a row.
    pub points: Option<Points>,
    /// The rows, joined.
    pub line: Option<Line>,
    /// The mean of all rows of a series, as a horizontal line.
    pub mean: Option<Mean>,
    /// The share of rows with at most each value; the measure is then along the horizontal axis.
    pub ecdf: Option<Ecdf>,
    /// Means with their 95 % intervals, one category a line; the measure is then along the horizontal axis.
    pub interval: Option<Intervals>,
}

/// The layer `area`.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Area {}

/// The layer `points`.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Points {}

/// The layer `mean`.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Mean {}

/// The layer `ecdf`.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Ecdf {}

/// The layer `interval`.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Intervals {}

/// The layer `line`.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Line {
    /// Each point is the mean of so many rows, itself the last; 0 and 1 leave the rows as they are.
    pub smooth: usize,
}

/// What a band reaches over.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum BandOf {
    /// From the lowest to the highest value.
    #[default]
    MinMax,
    /// From the 10 % to the 90 % quantile.
    Quantiles,
    /// The 95 % interval of the mean.
    Interval,
}

/// The layer `band`.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Band {
    /// What it reaches over.
    pub of: BandOf,
    /// 0: over the series that are taken together, at each value of `x`. Otherwise: over so many rows of each line,
    /// the row itself the last.
    pub window: usize,
}

/// The layer `histogram`.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Histogram {
    /// Into so many equal parts the range of the values is divided.
    pub bins: usize,
}

impl Default for Histogram {
    fn default() -> Self {
        Self { bins: 40 }
    }
}

/// A value, or a region from one value to another.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum Span {
    /// A line.
    At(f64),
    /// A region.
    Between([f64; 2]),
}

/// A line or region at fixed values.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Rule {
    /// Where on the horizontal axis.
    pub x: Option<Span>,
    /// Where on the vertical axis.
    pub y: Option<Span>,
    /// What it means.
    pub label: String,
}

/// How values are laid out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Scales {
    /// Along the horizontal axis.
    pub x: Scale,
    /// Along the vertical axis.
    pub y: Scale,
}

/// What is shown of the axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Ranges {
    /// Of the horizontal axis.
    pub x: Option<[f64; 2]>,
    /// Of the vertical axis.
    pub y: Option<[f64; 2]>,
}

impl FigureParams {
    /// With what the preset says wherever nothing else is said.
    pub(crate) fn filled(&self) -> Self {
        let mut full = self.clone();
        let Some(preset) = self.preset else { return full };
        let measures =
            |names: &[&str]| names.iter().map(|name| Measure::Column((*name).to_owned())).collect();
        let some = |name: &str| Some(name.to_owned());
        let (x, y, layers): (_, Vec<Measure>, _) = match preset {
            Preset::Curve => (
                some("step"),
                measures(&["score_mean_10"]),
                Layers { line: Some(Line::default()), band: Some(Band::default()), ..Layers::default() },
            ),
            Preset::Losses => (
                some("epoch"),
                measures(&["train_loss", "val_loss"]),
                Layers { line: Some(Line::default()), ..Layers::default() },
            ),
            Preset::Episodes => (
                some("episode"),
                measures(&["score"]),
                Layers { points: Some(Points {}), line: Some(Line { smooth: 100 }), ..Layers::default() },
            ),
            Preset::Scores => (
                some("episode"),
                measures(&["score"]),
                Layers { points: Some(Points {}), mean: Some(Mean {}), ..Layers::default() },
            ),
            Preset::Trace => (
                some("step"),
                measures(&["reward"]),
                Layers { line: Some(Line::default()), ..Layers::default() },
            ),
            Preset::Distribution => (
                None,
                measures(&["score"]),
                Layers { histogram: Some(Histogram::default()), ..Layers::default() },
            ),
            Preset::Interval => {
                (None, measures(&["score"]), Layers { interval: Some(Intervals {}), ..Layers::default() })
            }
        };
        full.x = full.x.or(x);
        if full.y.is_empty() {
            full.y = y;
        }
        if full.layers == Layers::default() {
            full.layers = layers;
        }
        if preset == Preset::Losses && full.scale == Scales::default() {
            full.scale.y = Scale::Log;
        }
        if preset == Preset::Trace && full.rows.is_empty() {
            full.rows = vec!["measure".to_owned()];
        }
        full
    }

    /// Reports what cannot be drawn.
    pub(crate) fn check(&self, problems: &mut Problems) {
        if crate::markdown::one_line(&self.title).is_empty() {
            problems.add("title", "`title` is empty, expected the figure's title");
        }
        let full = self.filled();
        if full.y.is_empty() || full.y.iter().any(|measure| measure.columns().is_empty()) {
            problems.add("y", "`y` has no column, expected at least one, or a `preset`");
        }
        if full.layers == Layers::default() {
            problems.add("layers", "`layers` is empty, expected at least one layer, or a `preset`");
        }
        let Layers { area, band, points, line, mean, histogram, ecdf, interval } = &full.layers;
        let along_x = [histogram.is_some(), ecdf.is_some(), interval.is_some()];
        let along_y = [area.is_some(), band.is_some(), points.is_some(), line.is_some(), mean.is_some()];
        if along_x.into_iter().filter(|there| *there).count() > 1
            || along_x.contains(&true) && along_y.contains(&true)
        {
            let message = "`histogram`, `ecdf` and `interval` have axes of their own, expected them alone";
            problems.add("layers", message);
        }
        if histogram.as_ref().is_some_and(|histogram| !(1..=1000).contains(&histogram.bins)) {
            problems.add("layers.histogram.bins", "`bins` is out of range, expected 1 to 1000");
        }
        let lists = [
            ("rows", &self.rows),
            ("columns", &self.columns),
            ("colour", &self.colour),
            ("pool", &self.pool),
        ];
        for (n, (name, list)) in lists.iter().enumerate() {
            for (m, label) in list.iter().enumerate() {
                let used = lists[..n].iter().find(|(_, other)| other.contains(label));
                let twice = list[..m].contains(label).then_some(*name);
                if let Some(other) = used.map(|(other, _)| *other).or(twice) {
                    let message = format!("`{label}` is in `{other}` already, expected it once");
                    problems.add(&format!("{name}.{m}"), message);
                }
            }
        }
        for (n, rule) in self.rules.iter().enumerate() {
            if rule.x.is_some() == rule.y.is_some() {
                problems.add(&format!("rules.{n}"), "a rule has one of `x` and `y`");
            }
        }
        for (name, range) in [("range.x", self.range.x), ("range.y", self.range.y)] {
            if range.is_some_and(|[low, high]| !(low < high && (high - low).is_finite())) {
                problems.add(name, format!("`{name}` is no range, expected two numbers, the smaller first"));
            }
        }
    }
}
