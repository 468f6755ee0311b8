//! The parameters of the kind `figure`, and what a preset fills in.

use dril_stage_api::Problems;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::ticks::Scale;

/// Parameters of [`Figure`](super::Figure).
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FigureParams {
    /// The title.
    pub title: String,
    /// A common type of figure: sets those of `x`, `y`, `layers` and `scale` that are not given.
    #[serde(default)]
    pub preset: Option<Preset>,
    /// The column on the horizontal axis. Default: the row number, from 0.
    #[serde(default)]
    pub x: Option<String>,
    /// The columns to draw. Each entry is one measure; several columns in one entry share a panel and an axis.
    #[serde(default)]
    pub y: Vec<Measure>,
    /// One row of panels for each value of these labels. `measure` stands for the entries of `y`.
    #[serde(default)]
    pub rows: Vec<String>,
    /// One column of panels for each value of these labels.
    #[serde(default)]
    pub columns: Vec<String>,
    /// One colour for each value of these labels. `column` stands for the columns of the files.
    #[serde(default)]
    pub colour: Vec<String>,
    /// Labels to aggregate over: lines become the mean over their values, and intervals treat these as trainings.
    #[serde(default)]
    pub pool: Vec<String>,
    /// For intervals: one line of the figure for each value of these labels. Default: all labels that vary and are not
    /// used elsewhere.
    #[serde(default)]
    pub categories: Vec<String>,
    /// The layers to draw.
    #[serde(default)]
    pub layers: Layers,
    /// Lines and regions at fixed values.
    #[serde(default)]
    pub rules: Vec<Rule>,
    /// Logarithmic axes.
    #[serde(default)]
    pub scale: Scales,
    /// Limits of the axes. What crosses them is cut there; a note counts what lies outside.
    #[serde(default)]
    pub range: Ranges,
    /// Title of the horizontal axis. Default: the name of the column.
    #[serde(default)]
    pub x_title: String,
    /// Title of the vertical axis. Default: the names of the columns.
    #[serde(default)]
    pub y_title: String,
    /// A sentence to print under the figure.
    #[serde(default)]
    pub note: String,
    /// The profile of the run.
    #[serde(default)]
    pub profile: String,
    /// The profile with the sizes of the experiment; at any other the figure states that its sizes are reduced. Without it,
    /// these are `full` and `default`, the profile of a file without `profiles`.
    #[serde(default)]
    pub full_profile: Option<String>,
}

/// An entry of `y`.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum Measure {
    /// A column; `action_*` means all columns with that prefix.
    Column(String),
    /// Several columns in one panel.
    Columns {
        /// Their names.
        columns: Vec<String>,
        /// The title of the axis.
        title: String,
        /// A value to draw as a line across each panel, for histograms and `ecdf`.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        mark: Option<Mark>,
    },
}

/// A value that is marked in a distribution.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Mark {
    /// The column with the value; the first number in each file is drawn.
    pub column: String,
    /// Its label.
    pub label: String,
}

impl Measure {
    /// Its columns; a trailing `*` matches all columns with that prefix.
    pub(crate) fn columns(&self) -> Vec<&str> {
        match self {
            Self::Column(name) => vec![name],
            Self::Columns { columns, .. } => columns.iter().map(String::as_str).collect(),
        }
    }

    /// Its title.
    pub(crate) fn title(&self) -> &str {
        match self {
            Self::Column(name) => name,
            Self::Columns { title, .. } => title,
        }
    }

    /// The value to draw beside it.
    pub(crate) fn mark(&self) -> Option<&Mark> {
        match self {
            Self::Column(_) => None,
            Self::Columns { mark, .. } => mark.as_ref(),
        }
    }
}

/// A common type of figure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Preset {
    /// Mean over trainings with a min–max band: `score_mean_10` over `step`.
    Curve,
    /// Losses over epochs on a logarithmic axis: `train_loss` and `val_loss` over `epoch`.
    Losses,
    /// The score of each training episode, and their moving average over 100 episodes.
    Episodes,
    /// The scores of an evaluation in order, and their mean.
    Scores,
    /// One episode step by step: a row of panels for each measure.
    Trace,
    /// A histogram.
    Distribution,
    /// Means with their 95 % intervals.
    Interval,
}

/// The layers, in the order in which they are drawn.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Layers {
    /// The area between each line and 0.
    pub area: Option<Area>,
    /// A band around each line: over the labels of `pool`, or over the last rows.
    pub band: Option<Band>,
    /// Counts per bin, with the measure on the horizontal axis.
    pub histogram: Option<Histogram>,
    /// One marker per row.
    pub points: Option<Points>,
    /// The rows, connected.
    pub line: Option<Line>,
    /// The mean of all rows of each line, as a dashed horizontal line.
    pub mean: Option<Mean>,
    /// The empirical distribution function, with the measure on the horizontal axis.
    pub ecdf: Option<Ecdf>,
    /// Means with 95 % intervals, one category per line, with the measure on the horizontal axis.
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
    /// Window of the moving average: each point is the mean of the last rows, itself included. 0 and 1: no smoothing.
    pub smooth: usize,
}

/// The extent of a band.
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
    /// Its extent.
    pub of: BandOf,
    /// 0: at each value of `x`, over the lines that `pool` aggregates. Otherwise: over a moving window of this many rows,
    /// of all these lines.
    pub window: usize,
}

/// The layer `histogram`.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Histogram {
    /// Number of bins of equal width over the range of the values.
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
    /// Position on the horizontal axis.
    pub x: Option<Span>,
    /// Position on the vertical axis.
    pub y: Option<Span>,
    /// Its label.
    pub label: String,
    /// Titles of the entries of `y` in whose panels it is drawn, if they have panels of their own. Default: all.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub measures: Vec<String>,
}

impl Rule {
    /// True for a region, false for a line.
    pub(crate) fn is_region(&self) -> bool {
        [self.x, self.y].iter().any(|span| matches!(span, Some(Span::Between(_))))
    }

    /// True where it is drawn in panels of this measure.
    pub(crate) fn is_for(&self, measure: Option<&str>) -> bool {
        self.measures.is_empty() || measure.is_some_and(|name| self.measures.iter().any(|one| one == name))
    }
}

/// Linear or logarithmic axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Scales {
    /// Along the horizontal axis.
    pub x: Scale,
    /// Along the vertical axis.
    pub y: Scale,
}

/// Limits of the axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Ranges {
    /// Of the horizontal axis.
    pub x: Option<[f64; 2]>,
    /// Of the vertical axis.
    pub y: Option<[f64; 2]>,
}

impl FigureParams {
    /// With the values of the preset where none are given.
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
        check_marks(&full, problems);
        check_rules(&full, problems);
        check_ranges(&full, problems);
    }
}

fn check_ranges(full: &FigureParams, problems: &mut Problems) {
    let axes = [("range.x", full.range.x, full.scale.x), ("range.y", full.range.y, full.scale.y)];
    for (name, range, scale) in axes {
        let Some([low, high]) = range else { continue };
        if !(low < high && (high - low).is_finite()) {
            problems.add(name, format!("`{name}` is no range, expected two numbers, the smaller first"));
        } else if scale == Scale::Log && low <= 0.0 {
            let message = format!("`{name}` begins at {low}, expected more than 0 on a logarithmic axis");
            problems.add(name, message);
        }
    }
}

fn check_marks(full: &FigureParams, problems: &mut Problems) {
    let is_distribution = full.layers.histogram.is_some() || full.layers.ecdf.is_some();
    for (n, measure) in full.y.iter().enumerate() {
        if measure.mark().is_some() && !is_distribution {
            let message = "`mark` is drawn across a distribution, expected the layer `histogram` or `ecdf`";
            problems.add(&format!("y.{n}.mark"), message);
        }
    }
}

fn check_rules(full: &FigureParams, problems: &mut Problems) {
    for (n, rule) in full.rules.iter().enumerate() {
        if rule.x.is_some() == rule.y.is_some() {
            problems.add(&format!("rules.{n}"), "a rule has one of `x` and `y`");
        }
        for name in rule.measures.iter().filter(|name| full.y.iter().all(|one| one.title() != name.as_str()))
        {
            let message = format!("`{name}` is no entry of `y`, expected the column or title of one");
            problems.add(&format!("rules.{n}.measures"), message);
        }
    }
}
