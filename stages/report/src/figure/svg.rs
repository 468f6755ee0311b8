//! A backend for plotters that writes compact SVG: one unit of plotters is a tenth of a pixel, neighbours of one style
//! are one path, text is text, and no number has more than one decimal. Equal calls give equal bytes.

use std::convert::Infallible;
use std::fmt::Write as _;

use plotters_backend::text_anchor::{HPos, VPos};
use plotters_backend::{
    BackendColor, BackendCoord, BackendStyle, BackendTextStyle, DrawingBackend, DrawingErrorKind, FontStyle,
    FontTransform,
};

use super::ink;

/// Units of plotters in a pixel.
pub(crate) const UNIT: i32 = 10;

/// The width of an average character of a sans-serif font, in ems. Wide enough for DejaVu and Verdana.
const CHARACTER: f64 = 0.6;

/// What a drawing says of itself: read out by screen readers, shown as a tooltip.
#[derive(Clone, Copy, Debug)]
pub(crate) struct About<'a> {
    pub(crate) title: &'a str,
    pub(crate) description: &'a str,
}

/// The SVG text as it grows.
#[derive(Debug)]
pub(crate) struct Svg<'t> {
    size: (u32, u32),
    text: &'t mut String,
    /// The path that the next shape of the same style joins: its attributes and its data.
    open: Option<(String, String)>,
    /// Where the open path ends.
    at: BackendCoord,
}

type Drawn = Result<(), DrawingErrorKind<Infallible>>;

impl<'t> Svg<'t> {
    /// A drawing of so many pixels.
    pub(crate) fn new(size: (u32, u32), about: About<'_>, text: &'t mut String) -> Self {
        let (width, height) = size;
        let (title, description) = (escape(about.title), escape(about.description));
        let _ = write!(
            text,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" class=\"dp-figure\" viewBox=\"0 0 {width} {height}\" \
             width=\"{width}\" height=\"{height}\" style=\"max-width:100%;height:auto\" role=\"img\" \
             aria-label=\"{title}\" font-family=\"system-ui,sans-serif\" color=\"#1a1a1a\">\n\
             <title>{title}</title>\n<desc>{description}</desc>\n<style>{STYLE}</style>\n"
        );
        Self { size: (width * UNIT as u32, height * UNIT as u32), text, open: None, at: (0, 0) }
    }

    fn close(&mut self) {
        if let Some((attributes, data)) = self.open.take() {
            let _ = writeln!(self.text, "<path {attributes} d=\"{data}\"/>");
        }
    }

    /// The data of the path with these attributes.
    fn path(&mut self, attributes: String) -> &mut String {
        if self.open.as_ref().is_none_or(|(open, _)| *open != attributes) {
            self.close();
            self.at = (0, 0);
        }
        &mut self.open.get_or_insert_with(|| (attributes, String::new())).1
    }

    /// Adds the points as one piece of the path, as steps from one to the next; `ending` closes it, or says what to draw
    /// at a point that stands alone.
    fn points(&mut self, attributes: String, points: impl IntoIterator<Item = BackendCoord>, ending: &str) {
        let goes_on = self.open.as_ref().is_some_and(|(open, _)| *open == attributes);
        let mut at = if goes_on { self.at } else { (0, 0) };
        let data = self.path(attributes);
        let mut start = None;
        for point in points {
            if start == Some(point) && point == at {
                continue;
            }
            let step = (point.0 - at.0, point.1 - at.1);
            match start {
                // A small letter makes the pairs after it steps as well; at the beginning it means the same place.
                None => data.push('m'),
                // Pairs after the first are lines.
                Some(_) if step.0 >= 0 => data.push(' '),
                Some(_) => {}
            }
            pair(data, step);
            start = start.or(Some(point));
            at = point;
        }
        let Some(start) = start else { return };
        data.push_str(ending);
        self.at = if ending == "z" { start } else { at };
    }
}

/// A step as `3 4`, `3-4` or `.5 2`: only the separators that SVG needs.
fn pair(text: &mut String, (x, y): BackendCoord) {
    number(text, x);
    let before = text.len();
    number(text, y);
    if !text[before..].starts_with('-') {
        text.insert(before, ' ');
    }
}

fn number(text: &mut String, tenths: i32) {
    if tenths < 0 {
        text.push('-');
    }
    let (whole, rest) = (tenths.unsigned_abs() / 10, tenths.unsigned_abs() % 10);
    if whole != 0 || rest == 0 {
        let _ = write!(text, "{whole}");
    }
    if rest != 0 {
        let _ = write!(text, ".{rest}");
    }
}

fn absolute(tenths: i32) -> String {
    let mut text = String::new();
    number(&mut text, tenths);
    text
}

/// Text that may stand between tags and in attributes.
pub(crate) fn escape(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            '"' => safe.push_str("&quot;"),
            // XML has no way to write most control characters.
            c if c.is_control() => safe.push(' '),
            c => safe.push(c),
        }
    }
    safe
}

/// The width of a text in tenths of a pixel, at most.
pub(crate) fn width_of(text: &str, size: i32) -> i32 {
    (text.chars().count() as f64 * f64::from(size) * CHARACTER) as i32
}

/// Colours of dark pages; without it, and for programs that know no style sheets, the attributes hold.
const STYLE: &str = "@media(prefers-color-scheme:dark){.dp-figure{color:#e6e6e6}.dp-figure .p{fill:#161616}\
                     .dp-figure .q{fill:#a0a0a0}.dp-figure .m{fill:#ff7b72}.dp-figure path.m{stroke:#ff7b72}\
                     .dp-figure .s0{fill:#3ba3e0}.dp-figure path.s0{stroke:#3ba3e0}.dp-figure path[fill=none]{fill:none}\
                     .dp-figure path[stroke=none]{stroke:none}}";

fn classed(colour: BackendColor) -> String {
    match ink::class(colour.rgb) {
        "" => String::new(),
        class => format!("class=\"{class}\" "),
    }
}

fn opacity(name: &str, colour: BackendColor) -> String {
    if colour.alpha >= 1.0 { String::new() } else { format!(" {name}=\"{:.2}\"", colour.alpha) }
}

fn stroke(style: &impl BackendStyle) -> String {
    let colour = style.color();
    let dashes = match ink::dashes(colour.rgb) {
        "" => String::new(),
        dashes => format!(" stroke-dasharray=\"{dashes}\""),
    };
    let width = absolute(i32::try_from(style.stroke_width()).unwrap_or(UNIT));
    format!(
        "{}fill=\"none\" stroke=\"{}\" stroke-width=\"{width}\"{}{dashes} stroke-linejoin=\"round\"",
        classed(colour),
        ink::css(colour.rgb),
        opacity("stroke-opacity", colour)
    )
}

fn filled(colour: BackendColor) -> String {
    let opacity = opacity("fill-opacity", colour);
    format!("{}stroke=\"none\" fill=\"{}\"{opacity}", classed(colour), ink::css(colour.rgb))
}

impl DrawingBackend for Svg<'_> {
    type ErrorType = Infallible;

    fn get_size(&self) -> (u32, u32) {
        self.size
    }

    fn ensure_prepared(&mut self) -> Drawn {
        Ok(())
    }

    fn present(&mut self) -> Drawn {
        self.close();
        self.text.push_str("</svg>\n");
        Ok(())
    }

    fn draw_pixel(&mut self, point: BackendCoord, colour: BackendColor) -> Drawn {
        let corners = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(x, y)| (point.0 + x, point.1 + y));
        self.points(filled(colour), corners, "z");
        Ok(())
    }

    fn draw_line<S: BackendStyle>(&mut self, from: BackendCoord, to: BackendCoord, style: &S) -> Drawn {
        self.draw_path([from, to], style)
    }

    fn draw_rect<S: BackendStyle>(
        &mut self,
        (left, top): BackendCoord,
        (right, bottom): BackendCoord,
        style: &S,
        fill: bool,
    ) -> Drawn {
        let attributes = if fill { filled(style.color()) } else { stroke(style) };
        self.points(attributes, [(left, top), (right, top), (right, bottom), (left, bottom)], "z");
        Ok(())
    }

    fn draw_path<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(
        &mut self,
        path: I,
        style: &S,
    ) -> Drawn {
        self.points(stroke(style), path, "");
        Ok(())
    }

    /// A disc is a line of no length with round ends: the shortest way to draw thousands of them.
    fn draw_circle<S: BackendStyle>(
        &mut self,
        centre: BackendCoord,
        radius: u32,
        style: &S,
        _: bool,
    ) -> Drawn {
        let colour = style.color();
        let width = absolute(i32::try_from(2 * radius).unwrap_or(UNIT));
        let attributes = format!(
            "{}fill=\"none\" stroke=\"{}\" stroke-width=\"{width}\"{} stroke-linecap=\"round\"",
            classed(colour),
            ink::css(colour.rgb),
            opacity("stroke-opacity", colour)
        );
        self.points(attributes, [centre], "h0");
        Ok(())
    }

    fn fill_polygon<S: BackendStyle, I: IntoIterator<Item = BackendCoord>>(
        &mut self,
        corners: I,
        style: &S,
    ) -> Drawn {
        self.points(filled(style.color()), corners, "z");
        Ok(())
    }

    fn draw_text<T: BackendTextStyle>(&mut self, text: &str, style: &T, (x, y): BackendCoord) -> Drawn {
        self.close();
        let size = style.size();
        let anchor = match style.anchor().h_pos {
            HPos::Left => "",
            HPos::Center => " text-anchor=\"middle\"",
            HPos::Right => " text-anchor=\"end\"",
        };
        // The baseline, from where in its box the text is to be held: SVG's own `dominant-baseline` is missing in many
        // programs.
        let down = match style.anchor().v_pos {
            VPos::Top => 0.8,
            VPos::Center => 0.35,
            VPos::Bottom => -0.2,
        };
        let down = (down * size) as i32;
        let (place, angle) = match style.transform() {
            FontTransform::Rotate90 => ((x - down, y), 90),
            FontTransform::Rotate270 => ((x + down, y), -90),
            _ => ((x, y + down), 0),
        };
        let (x, y) = (absolute(place.0), absolute(place.1));
        let turned =
            if angle == 0 { String::new() } else { format!(" transform=\"rotate({angle} {x} {y})\"") };
        let bold = if matches!(style.style(), FontStyle::Bold) { " font-weight=\"600\"" } else { "" };
        let (colour, size) = (style.color(), absolute(size as i32));
        let _ = writeln!(
            self.text,
            "<text {}x=\"{x}\" y=\"{y}\" font-size=\"{size}\" fill=\"{}\"{anchor}{bold}{turned}>{}</text>",
            classed(colour),
            ink::css(colour.rgb),
            escape(text)
        );
        Ok(())
    }

    fn estimate_text_size<T: BackendTextStyle>(
        &self,
        text: &str,
        style: &T,
    ) -> Result<(u32, u32), DrawingErrorKind<Infallible>> {
        let size = style.size() as i32;
        Ok((width_of(text, size).unsigned_abs(), size.unsigned_abs()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_written_with_no_more_than_svg_needs() {
        let mut text = String::new();
        for step in [(0, 0), (15, -3), (-20, 7), (4, 10)] {
            pair(&mut text, step);
            text.push(',');
        }
        assert_eq!(text, "0 0,1.5-.3,-2 .7,.4 1,");
    }

    #[test]
    fn text_cannot_leave_its_element() {
        assert_eq!(escape("<a b=\"c\">&\u{7}</a>"), "&lt;a b=&quot;c&quot;&gt;&amp; &lt;/a&gt;");
    }
}
