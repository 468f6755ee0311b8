//! Shapes on the canvas: from the units of the data to tenths of a pixel, and no more of them than can be seen.

use std::collections::HashSet;
use std::convert::Infallible;

use plotters::coord::Shift;
use plotters::drawing::{DrawingArea, DrawingAreaErrorKind};
use plotters::element::{Circle, PathElement, Polygon, Rectangle, Text};
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{Color, FontStyle, FontTransform, IntoFont, RGBColor, ShapeStyle, TextStyle};

use super::clip::{Frame, Pixel};
use super::ink::{Ink, marker};
use super::layer::{Drawn, Shape};
use super::params::{Rule, Span};
use super::svg::{Svg, width_of};

/// The whole canvas.
pub(crate) type Canvas<'t> = DrawingArea<Svg<'t>, Shift>;
/// What came of drawing; the backend itself cannot fail.
pub(crate) type Painted = Result<(), DrawingAreaErrorKind<Infallible>>;

/// At most so many marks a series are drawn.
pub(crate) const MOST_POINTS: usize = 10_000;
/// Series of fewer points have larger marks.
const FEW: usize = 400;

/// Where values come to lie: `None` for what is outside the axes.
pub(crate) struct Map<'m> {
    pub(crate) place: &'m dyn Fn(f64, f64) -> Option<Pixel>,
    pub(crate) frame: Frame,
    /// True where there is one series only: marks need no shapes of their own.
    pub(crate) alone: bool,
}

impl Map<'_> {
    /// As `place`, but what a logarithmic axis has no place for lies at its low end.
    pub(crate) fn grounded(&self, x: f64, y: f64) -> Pixel {
        let across = (self.place)(x, f64::NAN).map_or(self.frame.left, |place| place.0);
        let down = (self.place)(f64::NAN, y).map_or(self.frame.bottom, |place| place.1);
        (across, down)
    }
}

/// How text stands.
#[derive(Clone, Copy)]
pub(crate) struct Words {
    pub(crate) size: i32,
    pub(crate) ink: Ink,
    pub(crate) bold: bool,
    pub(crate) upwards: bool,
    pub(crate) hold: (HPos, VPos),
}

/// Ordinary text that begins and stands on its place.
pub(crate) const WORDS: Words =
    Words { size: 110, ink: Ink::Text, bold: false, upwards: false, hold: (HPos::Left, VPos::Bottom) };

impl Words {
    pub(crate) fn style(self) -> TextStyle<'static> {
        let style = if self.bold { FontStyle::Bold } else { FontStyle::Normal };
        let font = ("sans-serif", f64::from(self.size)).into_font().style(style);
        let font = if self.upwards { font.transform(FontTransform::Rotate270) } else { font };
        let mut style = TextStyle::from(font);
        style.color = self.ink.colour().to_backend_color();
        style.pos = Pos::new(self.hold.0, self.hold.1);
        style
    }
}

pub(crate) fn write(canvas: &Canvas<'_>, text: &str, at: Pixel, words: Words) -> Painted {
    if text.is_empty() {
        return Ok(());
    }
    canvas.draw(&Text::new(text.to_owned(), at, words.style()))
}

/// A line of this colour, in tenths of a pixel.
pub(crate) fn pen(colour: RGBColor, opacity: f64, width: u32) -> ShapeStyle {
    ShapeStyle { color: colour.mix(opacity), filled: false, stroke_width: width }
}

fn fill(colour: RGBColor, opacity: f64) -> ShapeStyle {
    ShapeStyle { color: colour.mix(opacity), filled: true, stroke_width: 0 }
}

pub(crate) fn shape(canvas: &Canvas<'_>, map: &Map<'_>, drawn: &Drawn) -> Painted {
    let ink = Ink::Series(drawn.series);
    // One line over its own dots must stand out from them.
    let line_ink = if map.alone && drawn.layer == "line" { Ink::Text } else { ink };
    match &drawn.shape {
        Shape::Points(points) => {
            let pixels = points.iter().filter_map(|(x, y)| (map.place)(*x, *y));
            let pixels = pixels.filter(|pixel| map.frame.contains(*pixel));
            let pixels: Vec<Pixel> = pixels.collect();
            marks(canvas, &thinned(pixels), drawn.series, map.alone)
        }
        Shape::Line(points) => stroke(canvas, map, points, line_ink.line()),
        Shape::Steps(points) => {
            let corners: Vec<(f64, f64)> =
                points.windows(2).flat_map(|pair| [pair[0], (pair[1].0, pair[0].1)]).collect();
            let all: Vec<(f64, f64)> = corners.into_iter().chain(points.last().copied()).collect();
            stroke(canvas, map, &all, ink.line())
        }
        Shape::Band(edges) => {
            let upper = edges.iter().map(|(x, _, high)| (*x, *high));
            let lower = edges.iter().rev().map(|(x, low, _)| (*x, *low));
            region(canvas, map, &upper.collect::<Vec<_>>(), &lower.collect::<Vec<_>>(), ink)
        }
        Shape::Area(points) => {
            let ground: Vec<(f64, f64)> = points.iter().rev().map(|(x, _)| (*x, 0.0)).collect();
            region(canvas, map, points, &ground, ink)
        }
        Shape::Bars(bars) => {
            let filled = bars.iter().filter(|(_, _, height)| *height > 0.0);
            let corners = filled.filter_map(|(from, to, height)| {
                map.frame.rectangle(map.grounded(*from, *height), map.grounded(*to, 0.0))
            });
            let corners: Vec<[Pixel; 2]> = corners.collect();
            for bar in &corners {
                canvas.draw(&Rectangle::new(*bar, fill(ink.colour(), 0.55)))?;
            }
            // Bars have no markers: where colours repeat, a dashed outline tells series apart.
            for bar in corners.iter().filter(|_| ink.line() != ink.colour()) {
                canvas.draw(&Rectangle::new(*bar, pen(ink.line(), 1.0, 10)))?;
            }
            Ok(())
        }
        Shape::Level(from, to, y) => {
            let ink = if map.alone { Ink::Text } else { ink };
            stroke(canvas, map, &[(*from, *y), (*to, *y)], ink.dashed())
        }
        Shape::Mark(value) => {
            let Frame { left, top, right, bottom } = map.frame;
            let place = (map.place)(*value, f64::NAN).map(|place| place.0);
            let Some(x) = place.filter(|x| (left..=right).contains(x)) else { return Ok(()) };
            canvas.draw(&PathElement::new(vec![(x, top), (x, bottom)], pen(Ink::Mark.colour(), 1.0, 14)))?;
            let is_right = x > (left + right) / 2;
            let hold = (if is_right { HPos::Right } else { HPos::Left }, VPos::Top);
            let words = Words { size: 100, ink: Ink::Mark, hold, ..WORDS };
            words_on_paper(canvas, &drawn.strand, (if is_right { x - 30 } else { x + 30 }, top + 20), words)
        }
    }
}

/// A line, cut at the plot's edges; a row between two gaps, or alone, is a dot.
fn stroke(canvas: &Canvas<'_>, map: &Map<'_>, points: &[(f64, f64)], colour: RGBColor) -> Painted {
    for piece in map.frame.line(points.iter().map(|(x, y)| (map.place)(*x, *y))) {
        let line = thin_line(piece);
        if let [at] = line[..] {
            canvas.draw(&Circle::new(at, 20, fill(colour, 1.0)))?;
        } else {
            canvas.draw(&PathElement::new(line, pen(colour, 1.0, 16)))?;
        }
    }
    Ok(())
}

/// The region between two lines, cut at the plot's edges; over a single place it is a line.
fn region(
    canvas: &Canvas<'_>,
    map: &Map<'_>,
    there: &[(f64, f64)],
    back: &[(f64, f64)],
    ink: Ink,
) -> Painted {
    let pixels = |line: &[(f64, f64)]| {
        let line = line.iter().filter(|(x, _)| (map.place)(*x, f64::NAN).is_some());
        thin_line(line.map(|(x, y)| map.grounded(*x, *y)).collect())
    };
    let corners = map.frame.polygon([pixels(there), pixels(back)].concat());
    if corners.is_empty() {
        return Ok(());
    }
    if corners.windows(2).all(|pair| pair[0].0 == pair[1].0) {
        return canvas.draw(&PathElement::new(corners, pen(ink.colour(), 0.22, 24)));
    }
    canvas.draw(&Polygon::new(corners, fill(ink.colour(), 0.22)))
}

/// The line that looks the same with at most four points a pixel column: the first, the lowest, the highest, the last.
fn thin_line(points: Vec<Pixel>) -> Vec<Pixel> {
    let mut thin: Vec<Pixel> = Vec::new();
    for column in points.chunk_by(|a, b| a.0.div_euclid(10) == b.0.div_euclid(10)) {
        let at = |pick: Option<(usize, &Pixel)>| pick.map_or(0, |(n, _)| n);
        let mut kept = [
            0,
            at(column.iter().enumerate().min_by_key(|(_, point)| point.1)),
            at(column.iter().enumerate().max_by_key(|(_, point)| point.1)),
            column.len() - 1,
        ];
        kept.sort_unstable();
        thin.extend(kept.iter().map(|n| column[*n]));
    }
    thin.dedup();
    thin
}

/// At most [`MOST_POINTS`] marks: those that would lie on others go first.
fn thinned(mut pixels: Vec<Pixel>) -> Vec<Pixel> {
    if pixels.len() > MOST_POINTS {
        let mut seen = HashSet::new();
        pixels.retain(|(x, y)| seen.insert((x.div_euclid(10), y.div_euclid(10))));
        let every = pixels.len().div_ceil(MOST_POINTS);
        pixels = pixels.into_iter().step_by(every).collect();
    }
    pixels
}

/// Marks of a series: each has a shape of its own, so that colours are not all that tells series apart.
pub(crate) fn marks(canvas: &Canvas<'_>, pixels: &[Pixel], series: usize, alone: bool) -> Painted {
    let (size, opacity) = if pixels.len() > FEW { (16, 0.5) } else { (24, 0.75) };
    let colour = Ink::Series(series).colour();
    pixels
        .iter()
        .try_for_each(|at| mark(canvas, *at, if alone { 0 } else { series }, size, (colour, opacity)))
}

/// One mark.
pub(crate) fn mark(
    canvas: &Canvas<'_>,
    (x, y): Pixel,
    series: usize,
    size: i32,
    (colour, opacity): (RGBColor, f64),
) -> Painted {
    let polygon = |corners: &[Pixel]| {
        let corners: Vec<Pixel> = corners.iter().map(|(dx, dy)| (x + dx, y + dy)).collect();
        canvas.draw(&Polygon::new(corners, fill(colour, opacity)))
    };
    let stroke = |from: Pixel, to: Pixel| {
        let ends = vec![(x + from.0, y + from.1), (x + to.0, y + to.1)];
        canvas.draw(&PathElement::new(ends, pen(colour, opacity, 12)))
    };
    let wide = size * 5 / 4;
    match marker(series, 6) {
        0 => canvas.draw(&Circle::new((x, y), size, fill(colour, opacity))),
        1 => polygon(&[(-size, -size), (size, -size), (size, size), (-size, size)]),
        2 => polygon(&[(0, -wide), (wide, size), (-wide, size)]),
        3 => polygon(&[(0, -wide), (wide, 0), (0, wide), (-wide, 0)]),
        4 => stroke((-wide, 0), (wide, 0)).and_then(|()| stroke((0, -wide), (0, wide))),
        _ => stroke((-size, -size), (size, size)).and_then(|()| stroke((-size, size), (size, -size))),
    }
}

/// A hollow diamond: a published value.
pub(crate) fn hollow(canvas: &Canvas<'_>, (x, y): Pixel) -> Painted {
    let corners = vec![(x, y - 40), (x + 40, y), (x, y + 40), (x - 40, y), (x, y - 40)];
    canvas.draw(&PathElement::new(corners, pen(Ink::Mark.colour(), 1.0, 12)))
}

/// The shaded region of a rule, behind the data.
pub(crate) fn region_of(canvas: &Canvas<'_>, map: &Map<'_>, rule: &Rule) -> Painted {
    let Frame { left, top, right, bottom } = map.frame;
    let corners = match (rule.x, rule.y) {
        (Some(Span::Between(ends)), _) => {
            let [from, to] =
                ends.map(|value| (map.place)(value, f64::NAN).map(|place| place.0.clamp(left, right)));
            from.zip(to).map(|(from, to)| [(from, top), (to, bottom)])
        }
        (_, Some(Span::Between(ends))) => {
            let [from, to] =
                ends.map(|value| (map.place)(f64::NAN, value).map(|place| place.1.clamp(top, bottom)));
            from.zip(to).map(|(from, to)| [(left, to), (right, from)])
        }
        _ => None,
    };
    let Some(corners) = corners else { return Ok(()) };
    canvas.draw(&Rectangle::new(corners, fill(Ink::Grid.colour(), 0.18)))
}

/// The line of a rule, and its label; of a region the label alone.
pub(crate) fn rule(canvas: &Canvas<'_>, map: &Map<'_>, rule: &Rule) -> Painted {
    let Frame { left, top, right, bottom } = map.frame;
    let x = |value: f64| (map.place)(value, f64::NAN).map(|place| place.0);
    let y = |value: f64| (map.place)(f64::NAN, value).map(|place| place.1);
    let label = |at: Pixel, hold, ink| {
        words_on_paper(canvas, &rule.label, at, Words { size: 100, ink, hold, ..WORDS })
    };
    match (rule.x, rule.y) {
        (Some(Span::At(at)), _) => {
            let Some(x) = x(at).filter(|x| (left..=right).contains(x)) else { return Ok(()) };
            canvas.draw(&PathElement::new(vec![(x, top), (x, bottom)], pen(Ink::Mark.dashed(), 1.0, 10)))?;
            let is_right = x > (left + right) / 2;
            let hold = (if is_right { HPos::Right } else { HPos::Left }, VPos::Top);
            label((if is_right { x - 30 } else { x + 30 }, top + 20), hold, Ink::Mark)
        }
        (_, Some(Span::At(at))) => {
            let Some(y) = y(at).filter(|y| (top..=bottom).contains(y)) else { return Ok(()) };
            canvas.draw(&PathElement::new(vec![(left, y), (right, y)], pen(Ink::Mark.dashed(), 1.0, 10)))?;
            let (at, hold) = if y - top > 160 { (y - 20, VPos::Bottom) } else { (y + 20, VPos::Top) };
            label((right - 30, at), (HPos::Right, hold), Ink::Mark)
        }
        (Some(Span::Between([from, _])), _) => {
            let Some(from) = x(from) else { return Ok(()) };
            label((from.clamp(left, right) + 30, top + 20), (HPos::Left, VPos::Top), Ink::Quiet)
        }
        (_, Some(Span::Between([from, to]))) => {
            let (Some(from), Some(to)) = (y(from), y(to)) else { return Ok(()) };
            let at = to.clamp(top, bottom).min(from.clamp(top, bottom));
            label((right - 30, at + 20), (HPos::Right, VPos::Top), Ink::Quiet)
        }
        _ => Ok(()),
    }
}

/// Words with the background behind them, so that they can be read over dots.
fn words_on_paper(canvas: &Canvas<'_>, text: &str, (x, y): Pixel, words: Words) -> Painted {
    if text.is_empty() {
        return Ok(());
    }
    let (width, height) = (width_of(text, words.size), words.size + 20);
    let is_above = matches!(words.hold.1, VPos::Bottom);
    let left = if matches!(words.hold.0, HPos::Right) { x - width } else { x };
    let top = if is_above { y - height } else { y };
    let paper = fill(Ink::Paper.colour(), 0.8);
    canvas.draw(&Rectangle::new([(left, top), (left + width, top + height)], paper))?;
    write(canvas, text, (x, if is_above { y } else { y + 10 }), words)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thinned_line_keeps_the_peaks_of_every_pixel() {
        let zigzag: Vec<Pixel> = (0..1000).map(|n| (n / 10, if n == 505 { 900 } else { n % 3 })).collect();
        let thin = thin_line(zigzag.clone());
        assert!(thin.len() <= 44 && thin.contains(&(50, 900)), "{}", thin.len());
        assert_eq!((thin.first(), thin.last()), (zigzag.first(), zigzag.last()));
    }

    #[test]
    fn marks_that_would_lie_on_others_go_first() {
        let same: Vec<Pixel> = (0..20_000).map(|n| (n % 50 * 10, 0)).collect();
        assert_eq!(thinned(same).len(), 50);
        let few: Vec<Pixel> = vec![(0, 0); 30];
        assert_eq!(thinned(few).len(), 30);
        let many: Vec<Pixel> = (0..50_000).map(|n| (n % 500 * 10, n / 500 * 10)).collect();
        assert!(thinned(many).len() <= MOST_POINTS);
    }
}
