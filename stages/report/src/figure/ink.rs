//! The colours of a figure. A backend of plotters is handed RGB values only; here they are indices into a list of inks,
//! so that text and axes can follow the page's colour and lines can be dashed, which plotters has no word for.

use plotters::style::RGBColor;

/// What something is drawn in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ink {
    /// Text, axes, and a series that stands alone on its colours: the page's text colour.
    Text,
    /// Notes and labels of axes.
    Quiet,
    /// Lines of the grid.
    Grid,
    /// The background of the figure.
    Paper,
    /// Rules and published values.
    Mark,
    /// A series, by its number.
    Series(usize),
}

/// The palette of Okabe and Ito (2008), which people with any colour vision can tell apart, without its black (the
/// text's) and its yellow (too light on white).
const SERIES: [&str; 6] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];
/// How lines are dashed (the lengths of dashes and gaps): solid, then one pattern for each repetition of the palette.
const DASHES: [&str; 4] = ["", "5 3", "1.5 2.5", "8 2.5 1.5 2.5"];
const FIRST_SERIES: u8 = 8;

impl Ink {
    /// As plotters carries it.
    pub(crate) fn colour(self) -> RGBColor {
        let series = |number: usize| FIRST_SERIES + u8::try_from(number % SERIES.len()).unwrap_or_default();
        let index = match self {
            Self::Text => 0,
            Self::Quiet => 1,
            Self::Grid => 2,
            Self::Paper => 3,
            Self::Mark => 4,
            Self::Series(number) => series(number),
        };
        RGBColor(index, 0, 0)
    }

    /// The same for a line: series that share a colour have dashes of their own.
    pub(crate) fn line(self) -> RGBColor {
        self.with_dashes(self.repetition())
    }

    /// The same for a line that differs from [`Self::line`].
    pub(crate) fn dashed(self) -> RGBColor {
        self.with_dashes(self.repetition() + 1)
    }

    /// How many times the palette was used up before.
    fn repetition(self) -> usize {
        if let Self::Series(number) = self { number / SERIES.len() } else { 0 }
    }

    fn with_dashes(self, pattern: usize) -> RGBColor {
        // Plotters carries three numbers, and the index is one: the second is the pattern.
        RGBColor(self.colour().0, u8::try_from(pattern.min(DASHES.len() - 1)).unwrap_or_default(), 0)
    }
}

/// The marker shape of a series, below `shapes`: series that share a colour have different ones.
pub(crate) fn marker(series: usize, shapes: usize) -> usize {
    (series + series / SERIES.len()) % shapes
}

/// The colour's name in SVG.
pub(crate) fn css(rgb: (u8, u8, u8)) -> &'static str {
    match rgb.0 {
        0 => "currentColor",
        1 => "#767676",
        2 => "#8c8c8c",
        3 => "#fff",
        4 => "#b00020",
        series => SERIES.get(usize::from(series - FIRST_SERIES)).copied().unwrap_or("currentColor"),
    }
}

/// The class of shapes whose colour another colour scheme changes; empty for the others.
pub(crate) fn class(rgb: (u8, u8, u8)) -> &'static str {
    match rgb.0 {
        1 => "q",
        3 => "p",
        4 => "m",
        8 => "s0",
        _ => "",
    }
}

/// The dashes of lines in this ink; empty for solid lines.
pub(crate) fn dashes(rgb: (u8, u8, u8)) -> &'static str {
    DASHES.get(usize::from(rgb.1)).copied().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_ink_is_found_again_and_dashes_change_no_colour() {
        let inks = [Ink::Text, Ink::Quiet, Ink::Grid, Ink::Paper, Ink::Mark].into_iter();
        let inks: Vec<Ink> = inks.chain((0..SERIES.len()).map(Ink::Series)).collect();
        let rgb = |colour: RGBColor| (colour.0, colour.1, colour.2);
        let mut seen: Vec<&str> = inks.iter().map(|ink| css(rgb(ink.colour()))).collect();
        for ink in &inks {
            assert_eq!(css(rgb(ink.colour())), css(rgb(ink.dashed())));
            assert_eq!((dashes(rgb(ink.dashed())), dashes(rgb(ink.colour()))), ("5 3", ""));
        }
        seen.sort_unstable();
        seen.dedup();
        assert_eq!(seen.len(), inks.len());
    }

    #[test]
    fn series_of_one_colour_differ_in_marker_and_dashes_until_both_are_used_up() {
        let looks = |count: usize, look: &dyn Fn(usize) -> (u8, usize)| {
            let mut all: Vec<_> = (0..count).map(look).collect();
            all.sort_unstable();
            all.dedup();
            all.len()
        };
        let colour = |n: usize| Ink::Series(n).colour().0;
        assert_eq!(looks(36, &|n| (colour(n), marker(n, 6))), 36);
        assert_eq!(looks(24, &|n| (colour(n), usize::from(Ink::Series(n).line().1))), 24);
        assert!((0..6).all(|n| marker(n, 6) == n && Ink::Series(n).line() == Ink::Series(n).colour()));
    }
}
