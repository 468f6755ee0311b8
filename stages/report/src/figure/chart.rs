//! What a figure shows: the shapes of each panel, and its axes.

use std::path::Path;

use dril_stage_api::StageError;

use super::data::Data;
use super::intervals::{self, Entry};
use super::layer::{self, Drawn, Shape};
use super::layout;
use super::params::{FigureParams, Span};
use super::ticks::{Axis, Scale};

/// Where the logarithmic axis of counts begins: below 1 by enough to see, and above 0.5, which would get a tick.
const LESS_THAN_ONE: f64 = 0.7;

/// Everything that is drawn in one panel.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Content {
    pub(crate) shapes: Vec<Drawn>,
    pub(crate) entries: Vec<Entry>,
}

/// A figure that is ready to be drawn.
pub(crate) struct Chart<'a> {
    pub(crate) params: &'a FigureParams,
    pub(crate) data: &'a Data,
    pub(crate) contents: Vec<Content>,
    /// The categories of an interval figure.
    pub(crate) categories: Vec<Vec<String>>,
}

impl<'a> Chart<'a> {
    /// Computes what there is to draw.
    ///
    /// # Errors
    /// As [`intervals::entries`].
    pub(crate) fn new(
        params: &'a FigureParams,
        data: &'a Data,
        reference: Option<&Path>,
    ) -> Result<Self, StageError> {
        let bounds = layer::bounds(params, data);
        let mut contents = Vec::new();
        for panel in &data.panels {
            let mut content = Content { shapes: layer::shapes(params, panel, bounds), ..Content::default() };
            if params.layers.interval.is_some() {
                content.entries = intervals::entries(params, data, panel, reference)?;
            }
            contents.push(content);
        }
        let entries: Vec<Vec<Entry>> = contents.iter().map(|content| content.entries.clone()).collect();
        let categories = intervals::in_order(&entries);
        Ok(Self { params, data, contents, categories })
    }

    pub(crate) fn is_interval(&self) -> bool {
        self.params.layers.interval.is_some()
    }

    /// True where the values of `y` lie along the horizontal axis.
    pub(crate) fn is_sideways(&self) -> bool {
        let layers = &self.params.layers;
        self.is_interval() || layers.histogram.is_some() || layers.ecdf.is_some()
    }

    /// The measure that a panel is for, where measures have panels of their own.
    pub(crate) fn measure(&self, n: usize) -> Option<&str> {
        let panel = &self.data.panels[n];
        let rows = self.params.rows.iter().zip(&panel.row);
        let mut all = rows.chain(self.params.columns.iter().zip(&panel.column));
        all.find(|(key, _)| *key == "measure").map(|(_, value)| value.as_str())
    }

    /// The axes of each panel.
    pub(crate) fn axes(&self) -> Vec<(Axis, Axis)> {
        let own = self.params.rows.iter().chain(&self.params.columns).any(|key| key == "measure");
        let groups: Vec<Option<&str>> = (0..self.contents.len()).map(|n| self.measure(n)).collect();
        let alike = |n: usize, by_measure: bool| {
            let same = move |other: &usize| !(own && by_measure) || groups[*other] == groups[n];
            (0..self.contents.len()).filter(same).collect::<Vec<_>>()
        };
        let wide = layout::across(self.params, self.data);
        let ticks = match wide {
            1 => 7,
            2 | 3 => 4,
            _ => 2,
        };
        let axes = |n: usize| {
            let (xs, ys) = (alike.clone()(n, self.is_sideways()), alike.clone()(n, !self.is_sideways()));
            let x = self.axis(&xs, true, ticks);
            let y = if self.is_interval() {
                Axis::categories(&self.category_names())
            } else {
                self.axis(&ys, false, 5)
            };
            (x, y)
        };
        (0..self.contents.len()).map(axes).collect()
    }

    fn axis(&self, panels: &[usize], is_x: bool, ticks: usize) -> Axis {
        let (scale, range) = self.scale(is_x);
        if let Some([low, high]) = range
            && let (Some(low), Some(high)) = (scale.place(low), scale.place(high))
        {
            return Axis::new(scale, (low, high), true, ticks);
        }
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        let mut take = |value: f64| {
            if let Some(place) = scale.place(value) {
                (low, high) = (low.min(place), high.max(place));
            }
        };
        // On a logarithmic axis a bar of a single count would have no height: the axis begins below it.
        if !is_x && self.params.layers.histogram.is_some() && scale == Scale::Log {
            take(LESS_THAN_ONE);
        }
        for content in panels.iter().map(|n| &self.contents[*n]) {
            content.shapes.iter().for_each(|drawn| extent(&drawn.shape, is_x, &mut take));
            for entry in content.entries.iter().filter(|_| is_x) {
                let half = entry.estimate.half_width.unwrap_or(0.0);
                take(entry.estimate.mean - half);
                take(entry.estimate.mean + half);
                entry.means.iter().copied().chain(entry.published).for_each(&mut take);
            }
        }
        for rule in
            self.params.rules.iter().filter(|rule| panels.iter().any(|n| rule.is_for(self.measure(*n))))
        {
            match if is_x { rule.x } else { rule.y } {
                Some(Span::At(at)) => take(at),
                Some(Span::Between([from, to])) => [from, to].into_iter().for_each(&mut take),
                None => {}
            }
        }
        if low > high {
            (low, high) = (0.0, 1.0);
        }
        Axis::new(scale, (low, high), false, ticks)
    }

    fn scale(&self, is_x: bool) -> (Scale, Option<[f64; 2]>) {
        let (scale, range) = (&self.params.scale, &self.params.range);
        if is_x { (scale.x, range.x) } else { (scale.y, range.y) }
    }

    fn category_names(&self) -> Vec<String> {
        let name = |values: &Vec<String>| {
            // A label that a file lacks has no value; a line of the figure needs a name all the same.
            let values: Vec<&str> =
                values.iter().map(String::as_str).filter(|value| !value.is_empty()).collect();
            if values.is_empty() { "–".to_owned() } else { values.join(" · ") }
        };
        self.categories.iter().map(name).collect()
    }
}

/// Hands over all values of a shape along one axis.
fn extent(shape: &Shape, is_x: bool, take: &mut impl FnMut(f64)) {
    use Shape::{Area, Band, Bars, Level, Line, Mark, Points, Steps};
    let mut pair = |x: f64, y: f64| take(if is_x { x } else { y });
    match shape {
        Points(points) | Line(points) | Steps(points) => points.iter().for_each(|(x, y)| pair(*x, *y)),
        Area(points) => points.iter().for_each(|(x, y)| {
            pair(*x, *y);
            pair(*x, 0.0);
        }),
        Band(edges) => edges.iter().for_each(|(x, low, high)| {
            pair(*x, *low);
            pair(*x, *high);
        }),
        Bars(bars) => bars.iter().for_each(|(from, to, height)| {
            pair(*from, 0.0);
            pair(*to, *height);
        }),
        Level(from, to, y) => {
            pair(*from, *y);
            pair(*to, *y);
        }
        Mark(value) => pair(*value, f64::NAN),
    }
}
