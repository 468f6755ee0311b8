//! Numbers as text, the same on every machine.

/// `value` with this many decimals. Never a negative zero: a mean of -0.001 is `0.00`.
pub(crate) fn fixed(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.bytes().all(|byte| matches!(byte, b'0' | b'.')) => rest.to_owned(),
        _ => text,
    }
}

/// As in the CSV files: two decimals more than in the Markdown table.
pub(crate) fn precise(value: f64, decimals: u8) -> String {
    fixed(value, usize::from(decimals) + 2)
}

/// As in the Markdown tables by default, and in the thesis: no decimals.
pub(crate) fn rounded(value: f64) -> String {
    fixed(value, 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_has_no_sign() {
        assert_eq!(precise(-0.001, 0), "0.00");
        assert_eq!(precise(-0.0, 0), "0.00");
        assert_eq!(rounded(-0.4), "0");
        assert_eq!(rounded(-0.6), "-1");
        assert_eq!(precise(-10.0, 0), "-10.00");
    }

    #[test]
    fn a_number_half_way_goes_to_the_even_neighbour() {
        assert_eq!((rounded(0.5), rounded(1.5), rounded(2.5)), ("0".into(), "2".into(), "2".into()));
        assert_eq!((precise(1.125, 0), precise(1.125, 1)), ("1.12".into(), "1.125".into()));
    }
}
