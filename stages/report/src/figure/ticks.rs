//! Ticks of an axis and their labels: round numbers, all with the same number of decimals.

use std::ops::Range;

use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};

/// The scale of an axis.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize, serde::Serialize, schemars::JsonSchema,
)]
#[serde(rename_all = "kebab-case")]
pub enum Scale {
    /// Linear.
    #[default]
    Linear,
    /// Logarithmic; values of 0 and below are omitted.
    Log,
}

impl Scale {
    /// The place of a value on the axis; `None` where it has none.
    pub(crate) fn place(self, value: f64) -> Option<f64> {
        match self {
            Self::Linear => value.is_finite().then_some(value),
            Self::Log => (value.is_finite() && value > 0.0).then(|| value.log10()),
        }
    }
}

/// Nothing is mapped farther from the beginning of an axis, in the canvas's units.
const FAR: f64 = 1e8;

/// An axis: its ends, and its ticks with their labels, all as places.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Axis {
    pub(crate) low: f64,
    pub(crate) high: f64,
    pub(crate) ticks: Vec<(f64, String)>,
}

impl Axis {
    /// An axis for places from `low` to `high`, with about `wanted` ticks. Its ends are the data's, with a little room,
    /// unless `fixed`.
    pub(crate) fn new(scale: Scale, (low, high): (f64, f64), fixed: bool, wanted: usize) -> Self {
        let (mut low, mut high) = if low < high { (low, high) } else { (low - 0.5, low + 0.5) };
        if !fixed {
            let room = (high - low) * 0.03;
            // Counts and shares begin at 0: no room below it.
            low = if low == 0.0 { 0.0 } else { low - room };
            high += room;
        }
        let ticks = match scale {
            Scale::Linear => linear(low, high, wanted),
            Scale::Log => logarithmic(low, high, wanted),
        };
        Self { low, high, ticks }
    }

    /// An axis of so many categories, the first on top, each one wide.
    pub(crate) fn categories(names: &[String]) -> Self {
        let count = names.len() as f64;
        let place = |n: usize| count - 0.5 - n as f64;
        let ticks = names.iter().enumerate().map(|(n, name)| (place(n), name.clone())).collect();
        Self { low: 0.0, high: count.max(1.0), ticks }
    }

    /// The label of a tick, which plotters asks for by its place.
    pub(crate) fn label(&self, place: f64) -> String {
        self.ticks.iter().find(|(at, _)| *at == place).map_or_else(String::new, |(_, label)| label.clone())
    }

    /// The length of the longest label in characters.
    pub(crate) fn longest(&self) -> usize {
        self.ticks.iter().map(|(_, label)| label.chars().count()).max().unwrap_or(0)
    }
}

impl Ranged for Axis {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, place: &f64, (start, end): (i32, i32)) -> i32 {
        let share = (place - self.low) / (self.high - self.low);
        // Places far outside stay numbers that can be added and subtracted.
        start + (share * f64::from(end - start)).round().clamp(-FAR, FAR) as i32
    }

    fn key_points<H: KeyPointHint>(&self, hint: H) -> Vec<f64> {
        // Light lines lie between the ticks; there are none.
        if hint.weight().allow_light_points() {
            Vec::new()
        } else {
            self.ticks.iter().map(|(at, _)| *at).collect()
        }
    }

    fn range(&self) -> Range<f64> {
        self.low..self.high
    }
}

impl ValueFormatter<f64> for Axis {
    fn format(place: &f64) -> String {
        place.to_string()
    }

    fn format_ext(&self, place: &f64) -> String {
        self.label(*place)
    }
}

/// Ten to a whole power, by multiplication alone: the same bits everywhere.
fn power_of_ten(exponent: i32) -> f64 {
    let size = (0..exponent.abs()).fold(1.0, |size, _| size * 10.0);
    if exponent < 0 { 1.0 / size } else { size }
}

/// The largest power of ten that is at most `value` (which is more than 0).
fn exponent_below(value: f64) -> i32 {
    let mut exponent = 0;
    while exponent < 300 && power_of_ten(exponent + 1) <= value {
        exponent += 1;
    }
    while exponent > -300 && power_of_ten(exponent) > value {
        exponent -= 1;
    }
    exponent
}

fn linear(low: f64, high: f64, wanted: usize) -> Vec<(f64, String)> {
    let rough = (high - low) / wanted.max(1) as f64;
    let exponent = exponent_below(rough);
    let size = power_of_ten(exponent);
    let (times, exponent) = [1.0, 2.0, 5.0]
        .into_iter()
        .find(|times| times * size >= rough * 0.999)
        .map_or((1.0, exponent + 1), |times| (times, exponent));
    // Steps are counted, not added up, so that no error adds up either.
    let step = times * power_of_ten(exponent);
    let (first, last) = ((low / step - 1e-9).ceil(), (high / step + 1e-9).floor());
    let count = (last - first).clamp(-1.0, 100.0) as i32;
    let value = |n: i32| {
        let whole = (first + f64::from(n)) * times;
        if exponent < 0 { whole / power_of_ten(-exponent) } else { whole * power_of_ten(exponent) }
    };
    let largest = (0..=count).map(|n| value(n).abs()).fold(0.0, f64::max);
    (0..=count).map(|n| (value(n), label(value(n), exponent, largest))).collect()
}

/// A number of an axis with steps of one digit times ten to the power `exponent`, on which the largest is `largest`:
/// `1.5M`, `20k`, `0.25`, `−3`. Where a unit would need more than three decimals, the number is written out.
fn label(value: f64, exponent: i32, largest: f64) -> String {
    let decimals = usize::try_from(-exponent).unwrap_or(0);
    let (unit, power) = match largest {
        _ if decimals > 6 || largest >= 1e12 => return minus(format!("{value:e}")),
        _ if largest >= 1e6 => ("M", 6),
        _ if largest >= 2e4 => ("k", 3),
        _ => ("", 0),
    };
    if power == 0 || power - exponent > 3 {
        return minus(format!("{value:.decimals$}"));
    }
    let text = format!("{:.3}", value / power_of_ten(power));
    let text = text.trim_end_matches('0').trim_end_matches('.');
    minus(if text == "0" { text.to_owned() } else { format!("{text}{unit}") })
}

/// With the sign of typographers, and none for zero.
fn minus(text: String) -> String {
    match text.strip_prefix('-') {
        Some(rest) if rest.bytes().all(|byte| matches!(byte, b'0' | b'.')) => rest.to_owned(),
        Some(rest) => format!("−{rest}"),
        None => text,
    }
}

/// Ticks at whole powers of ten, and where there are too few of them, at 2 and 5 times these.
fn logarithmic(low: f64, high: f64, wanted: usize) -> Vec<(f64, String)> {
    let (first, last) = (low.floor() as i32, high.ceil() as i32);
    let inside = |place: f64| low - 1e-9 <= place && place <= high + 1e-9;
    let decades: Vec<i32> = (first..=last).filter(|decade| inside(f64::from(*decade))).collect();
    let every = decades.len().div_ceil(wanted.max(1)).max(1);
    if decades.len() >= 3 {
        let kept = decades.iter().filter(|decade| decade.rem_euclid(every as i32) == 0);
        return kept.map(|decade| (f64::from(*decade), log_label(1, *decade))).collect();
    }
    let mut ticks = Vec::new();
    for decade in first..=last {
        for (times, place) in [(1, 0.0), (2, std::f64::consts::LOG10_2), (5, 1.0 - std::f64::consts::LOG10_2)]
        {
            let place = f64::from(decade) + place;
            if inside(place) {
                ticks.push((place, log_label(times, decade)));
            }
        }
    }
    if ticks.len() >= 2 {
        return ticks;
    }
    // Within a factor of two or so: round values as on a linear axis, where they lie on this one.
    let values = linear(10.0_f64.powf(low), 10.0_f64.powf(high), wanted).into_iter();
    values.map(|(value, label)| (value.log10(), label)).filter(|(place, _)| inside(*place)).collect()
}

fn log_label(times: i32, decade: i32) -> String {
    let value = f64::from(times) * power_of_ten(decade);
    match decade {
        -4..=-1 => format!("{value:.0$}", decade.unsigned_abs() as usize),
        0..=3 => format!("{value:.0}"),
        _ => minus(format!("{times}e{decade}")).replace("e-", "e−"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn labels(scale: Scale, low: f64, high: f64) -> Vec<String> {
        Axis::new(scale, (low, high), true, 5).ticks.into_iter().map(|(_, label)| label).collect()
    }

    #[test]
    fn ticks_are_round_numbers_with_the_decimals_that_they_need() {
        assert_eq!(labels(Scale::Linear, -600.0, 400.0), ["−600", "−400", "−200", "0", "200", "400"]);
        assert_eq!(labels(Scale::Linear, 0.0, 0.3), ["0.0", "0.1", "0.2", "0.3"]);
        assert_eq!(labels(Scale::Linear, 0.0, 3e6), ["0", "1M", "2M", "3M"]);
        assert_eq!(labels(Scale::Linear, 0.0, 25_000.0), ["0", "5k", "10k", "15k", "20k", "25k"]);
        assert_eq!(labels(Scale::Linear, 2_000_000.0, 2_004_000.0)[..2], ["2M", "2.001M"]);
        assert_eq!(labels(Scale::Linear, 2_000_000.0, 2_000_100.0)[..2], ["2000000", "2000020"]);
        assert_eq!(labels(Scale::Linear, -25_001.0, -25_000.0)[..2], ["−25001.0", "−25000.8"]);
        assert_eq!(labels(Scale::Log, -3.2, 0.6), ["0.001", "0.01", "0.1", "1"]);
        assert_eq!(labels(Scale::Log, 0.1, 1.2), ["2", "5", "10"]);
        assert_eq!(labels(Scale::Log, 0.31, 0.68), ["3", "4"], "between 2 and 5");
    }

    #[test]
    fn one_value_has_an_axis_around_it() {
        let axis = Axis::new(Scale::Linear, (7.0, 7.0), true, 5);
        assert!(axis.low < 7.0 && axis.high > 7.0 && axis.ticks.len() > 2);
    }

    proptest! {
        #[test]
        fn ticks_lie_on_the_axis_in_order_and_are_not_too_many(
            low in -1e9..1e9_f64, width in 1e-6..1e9_f64, wanted in 2..10_usize,
        ) {
            let axis = Axis::new(Scale::Linear, (low, low + width), true, wanted);
            let slack = width * 1e-6;
            for pair in axis.ticks.windows(2) {
                prop_assert!(pair[0].0 < pair[1].0);
                prop_assert!(pair[0].1 != pair[1].1, "{:?}", axis.ticks);
            }
            prop_assert!(axis.ticks.iter().all(|(at, _)| low - slack <= *at && *at <= low + width + slack));
            prop_assert!(axis.ticks.len() <= 3 * wanted + 2, "{:?}", axis.ticks);
        }
    }
}
