//! The drawing of a figure: plotters' axes and grid in each panel, and the shapes of the layers in them.

use dril_stage_api::StageError;
use plotters::chart::ChartBuilder;
use plotters::drawing::IntoDrawingArea;
use plotters::element::{PathElement, Rectangle};
use plotters::style::text_anchor::{HPos, VPos};
use plotters::style::{Color, ShapeStyle};

use super::chart::Chart;
use super::clip::Frame;
use super::explain;
use super::ink::Ink;
use super::intervals::Entry;
use super::layout::{self, Layout, Place, WIDTH, Wishes};
use super::paint::{self, Canvas, Map, Painted, WORDS, Words};
use super::params::Rule;
use super::svg::{About, Svg, UNIT};
use super::ticks::Axis;

impl Chart<'_> {
    /// The SVG.
    ///
    /// # Errors
    /// The drawing library refuses.
    pub(crate) fn svg(&self) -> Result<String, StageError> {
        let axes = self.axes();
        let lines = 1 + layout::grid(self.params, self.data).iter().map(|(line, _)| *line).max().unwrap_or(0);
        let plot = match (self.is_interval(), lines) {
            (true, _) => 8 + self.categories.len() as i32 * (9 * self.data.series.len() as i32 + 5).max(17),
            (_, 1) if self.data.panels.len() == 1 => 260,
            (_, 1) => 190,
            (_, 2 | 3) => 140,
            _ => 110,
        };
        let own = self.params.rows.iter().chain(&self.params.columns).any(|key| key == "measure");
        let (x_title, y_title) = explain::titles(self);
        let wishes = Wishes {
            plot,
            y_label: axes.iter().map(|(_, y)| y.longest()).max().unwrap_or(0),
            x_label: axes.iter().map(|(x, _)| x.longest()).max().unwrap_or(0),
            own_y: own && !self.is_sideways() && self.params.columns.iter().any(|key| key == "measure"),
            own_x: own && self.is_sideways(),
            has_x_title: !x_title.is_empty(),
            has_y_title: !y_title.is_empty(),
            notes: explain::notes(self),
        };
        let layout = layout::layout(self.params, self.data, &wishes);
        let description = explain::description(self, &x_title, &y_title, &wishes.notes);
        let mut text = String::new();
        let about = About { title: &self.params.title, description: &description };
        let size = (WIDTH.unsigned_abs(), layout.height.unsigned_abs());
        let painted = self.paint(Svg::new(size, about, &mut text), &layout, &axes, (&x_title, &y_title));
        painted.map_err(StageError::failed)?;
        Ok(text)
    }

    fn paint(&self, svg: Svg<'_>, layout: &Layout, axes: &[(Axis, Axis)], titles: (&str, &str)) -> Painted {
        let canvas: Canvas<'_> = svg.into_drawing_area();
        let (width, height) = (WIDTH * UNIT, layout.height * UNIT);
        let paper = ShapeStyle { color: Ink::Paper.colour().to_rgba(), filled: true, stroke_width: 0 };
        canvas.draw(&Rectangle::new([(0, 0), (width, height)], paper))?;
        for (line, y) in &layout.title {
            paint::write(&canvas, line, tenths((12, *y)), Words { size: 140, bold: true, ..WORDS })?;
        }
        self.legend(&canvas, layout)?;
        for (headings, bold) in layout.headings.iter().zip([true, false]) {
            for (heading, at) in headings {
                paint::write(&canvas, heading, tenths(*at), Words { bold, ..WORDS })?;
            }
        }
        for (n, (place, (x, y))) in layout.panels.iter().zip(axes).enumerate() {
            self.panel(&canvas, *place, n, (x, y))?;
        }
        let quiet = Words { ink: Ink::Quiet, ..WORDS };
        if let (Some(first), Some(last)) =
            (layout.panels.first(), layout.panels.iter().max_by_key(|p| p.left))
        {
            let middle = (first.left + last.left + last.width) / 2;
            let hold = (HPos::Center, VPos::Top);
            paint::write(&canvas, titles.0, tenths((middle, layout.x_title)), Words { hold, ..WORDS })?;
            let words = Words { hold, upwards: true, ..WORDS };
            paint::write(&canvas, titles.1, tenths((8, layout.y_title)), words)?;
        }
        for (line, y) in &layout.notes {
            paint::write(&canvas, line, tenths((12, *y)), quiet)?;
        }
        canvas.present()
    }

    fn legend(&self, canvas: &Canvas<'_>, layout: &Layout) -> Painted {
        if let Some((title, at)) = &layout.legend_title {
            paint::write(canvas, title, tenths(*at), Words { ink: Ink::Quiet, ..WORDS })?;
        }
        let layers = &self.params.layers;
        let has_marks = layers.points.is_some() || layers.interval.is_some();
        for key in &layout.legend {
            let (x, y) = tenths(key.at);
            let colour = Ink::Series(key.series).colour();
            if has_marks {
                paint::mark(canvas, (x + 60, y - 60), key.series, 36, (colour, 1.0))?;
            } else {
                let ends = vec![(x, y - 60), (x + 120, y - 60)];
                let width = if layers.histogram.is_some() { 80 } else { 24 };
                let pen = paint::pen(Ink::Series(key.series).line(), 1.0, width);
                canvas.draw(&PathElement::new(ends, pen))?;
            }
            paint::write(canvas, &key.name, (x + 160, y), WORDS)?;
        }
        Ok(())
    }

    fn panel(&self, canvas: &Canvas<'_>, place: Place, n: usize, (x, y): (&Axis, &Axis)) -> Painted {
        let content = &self.contents[n];
        let (left, top) = tenths((place.left, place.top));
        let (width, height) = tenths((place.width, place.height));
        let (under, beside) = (if place.x_labels { 200 } else { 0 }, if place.y_labels { left } else { 0 });
        let area = canvas.clone().shrink((left - beside, top), (width + beside, height + under));
        let mut chart = ChartBuilder::on(&area)
            .x_label_area_size(under)
            .y_label_area_size(beside)
            .build_cartesian_2d(x.clone(), y.clone())?;
        let labels = Words { ink: Ink::Quiet, size: 110, ..WORDS }.style();
        chart
            .configure_mesh()
            .light_line_style(plotters::style::TRANSPARENT)
            .bold_line_style(paint::pen(Ink::Grid.colour(), 0.25, 8))
            .axis_style(paint::pen(Ink::Grid.colour(), 1.0, 8))
            .set_all_tick_mark_size(30)
            .label_style(labels)
            .draw()?;
        let (x_scale, y_scale) = (self.params.scale.x, self.params.scale.y);
        let plot = chart.plotting_area();
        // A value that is no number stands for an axis that does not matter.
        let place = |x_value: f64, y_value: f64| {
            let x_place = if x_value.is_nan() { Some(x.low) } else { x_scale.place(x_value) };
            let y_place = if y_value.is_nan() { Some(y.low) } else { y_scale.place(y_value) };
            Some(plot.map_coordinate(&(x_place?, y_place?)))
        };
        let frame = Frame { left, top, right: left + width, bottom: top + height };
        let map = Map { place: &place, frame, alone: self.data.series.len() == 1 };
        let rules = || self.params.rules.iter().filter(|rule| rule.is_for(self.measure(n)));
        let (regions, lines): (Vec<&Rule>, Vec<&Rule>) = rules().partition(|rule| rule.is_region());
        // Regions lie behind the data, lines and all labels on top of it.
        for rule in &regions {
            paint::region_of(canvas, &map, rule)?;
        }
        for drawn in &content.shapes {
            paint::shape(canvas, &map, drawn)?;
        }
        for rule in regions.into_iter().chain(lines) {
            paint::rule(canvas, &map, rule)?;
        }
        content.entries.iter().try_for_each(|entry| self.entry(canvas, &map, entry))
    }

    /// One line of an interval figure.
    fn entry(&self, canvas: &Canvas<'_>, map: &Map<'_>, entry: &Entry) -> Painted {
        let row = self.categories.iter().position(|other| *other == entry.category).unwrap_or(0);
        let many = self.data.series.len() as f64;
        // Series share a line: the first on top.
        let offset = (entry.series as f64 - (many - 1.0) / 2.0) / (many + 1.0);
        let y = self.categories.len() as f64 - 0.5 - row as f64 - offset;
        let at = |value: f64| (map.place)(value, y).filter(|pixel| map.frame.contains(*pixel));
        let colour = Ink::Series(entry.series).colour();
        if let Some(half) = entry.estimate.half_width
            && let [from, to] = [-half, half].map(|half| map.grounded(entry.estimate.mean + half, y))
            && let Some((from, to)) = map.frame.segment(from, to)
        {
            canvas.draw(&PathElement::new(vec![from, to], paint::pen(colour, 1.0, 20)))?;
        }
        if entry.estimate.half_width.is_none() && entry.means.len() > 1 {
            for pixel in entry.means.iter().filter_map(|mean| at(*mean)) {
                paint::mark(canvas, pixel, entry.series, 20, (colour, 0.6))?;
            }
        } else if let Some(pixel) = at(entry.estimate.mean) {
            paint::mark(canvas, pixel, entry.series, 34, (colour, 1.0))?;
        }
        match entry.published.and_then(at) {
            Some(pixel) => paint::hollow(canvas, pixel),
            None => Ok(()),
        }
    }
}

fn tenths((x, y): (i32, i32)) -> (i32, i32) {
    (x * UNIT, y * UNIT)
}
