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
/// Set in the index of an ink whose lines are dashed.
const DASHED: u8 = 0x80;
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

    /// The same, dashed.
    pub(crate) fn dashed(self) -> RGBColor {
        RGBColor(self.colour().0 | DASHED, 0, 0)
    }
}

/// The colour's name in SVG.
pub(crate) fn css(rgb: (u8, u8, u8)) -> &'static str {
    match rgb.0 & !DASHED {
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
    match rgb.0 & !DASHED {
        1 => "q",
        3 => "p",
        4 => "m",
        8 => "s0",
        _ => "",
    }
}

/// True for an ink whose lines are dashed.
pub(crate) fn is_dashed(rgb: (u8, u8, u8)) -> bool {
    rgb.0 & DASHED != 0
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
            assert!(is_dashed(rgb(ink.dashed())) && !is_dashed(rgb(ink.colour())));
        }
        seen.sort_unstable();
        seen.dedup();
        assert_eq!(seen.len(), inks.len());
    }
}
