//! The value of a plain YAML scalar, by the core schema of YAML 1.2 (section 10.3.2).
//!
//! Two rules are stricter. Numbers must be finite and exact: `.nan`, `.inf`, `1e999` and integers beyond 64 bits are errors. And a
//! decimal with leading zeros is a text, because YAML 1.1 reads it as octal.

use serde_json::Number;

use super::node::Value;

/// The value of a plain scalar; the error says what is wrong with a number.
pub(super) fn read(text: &str) -> Result<Value, String> {
    match text {
        "" | "~" | "null" | "Null" | "NULL" => return Ok(Value::Null),
        "true" | "True" | "TRUE" => return Ok(Value::Bool(true)),
        "false" | "False" | "FALSE" => return Ok(Value::Bool(false)),
        _ => {}
    }
    let bare = text.strip_prefix(['-', '+']).unwrap_or(text);
    if matches!(bare, ".inf" | ".Inf" | ".INF") || matches!(text, ".nan" | ".NaN" | ".NAN") {
        return Err(format!("found `{text}`, expected a finite number"));
    }
    match number(text, bare)? {
        Some(number) => Ok(Value::Number(number, text.into())),
        None => Ok(Value::Text(text.into())),
    }
}

fn number(text: &str, bare: &str) -> Result<Option<Number>, String> {
    let beyond =
        || format!("found `{}`, expected a whole number of at most 64 bits", super::node::shorten(text));
    for (prefix, radix) in [("0x", 16), ("0o", 8)] {
        // No sign here in the core schema; `from_str_radix` would take one after the prefix, too.
        if let Some(digits) = text.strip_prefix(prefix).filter(|digits| !digits.is_empty()) {
            if !digits.chars().all(|digit| digit.is_digit(radix)) {
                return Ok(None);
            }
            return u64::from_str_radix(digits, radix).map(|n| Some(n.into())).map_err(|_| beyond());
        }
    }
    let whole = bare.find(|c: char| !c.is_ascii_digit()).unwrap_or(bare.len());
    if whole > 1 && bare.starts_with('0') {
        return Ok(None);
    }
    if whole == bare.len() && whole > 0 {
        let positive = text.strip_prefix('+').unwrap_or(text);
        let small = positive.parse::<u64>().ok().map(Number::from);
        return match small.or_else(|| positive.parse::<i64>().ok().map(Number::from)) {
            Some(number) => Ok(Some(number)),
            None => Err(beyond()),
        };
    }
    if !is_float(bare, whole) {
        return Ok(None);
    }
    // Rust reads what the schema allows, correctly rounded; only the size may be beyond it.
    match text.parse::<f64>().ok().and_then(Number::from_f64) {
        Some(number) => Ok(Some(number)),
        None => Err(format!("found `{}`, expected a finite number", super::node::shorten(text))),
    }
}

/// `( \. [0-9]+ | [0-9]+ ( \. [0-9]* )? ) ( [eE] [-+]? [0-9]+ )?`, of which the first `whole` bytes are digits.
fn is_float(bare: &str, whole: usize) -> bool {
    let digits = |text: &str| text.bytes().take_while(u8::is_ascii_digit).count();
    let mut rest = &bare[whole..];
    if let Some(fraction) = rest.strip_prefix('.') {
        let count = digits(fraction);
        if whole == 0 && count == 0 {
            return false;
        }
        rest = &fraction[count..];
    } else if whole == 0 {
        return false;
    }
    if let Some(exponent) = rest.strip_prefix(['e', 'E']) {
        let exponent = exponent.strip_prefix(['-', '+']).unwrap_or(exponent);
        let count = digits(exponent);
        return count > 0 && count == exponent.len();
    }
    rest.is_empty()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shown(text: &str) -> String {
        match read(text) {
            Ok(Value::Null) => "null".into(),
            Ok(Value::Bool(value)) => value.to_string(),
            Ok(Value::Number(number, _)) => number.to_string(),
            Ok(Value::Text(text)) => format!("'{text}'"),
            Ok(other) => panic!("{other:?}"),
            Err(message) => format!("error: {message}"),
        }
    }

    #[test]
    fn plain_scalars_follow_the_core_schema() {
        for (text, expected) in [
            ("~", "null"),
            ("", "null"),
            ("TRUE", "true"),
            ("1", "1"),
            ("+1", "1"),
            ("-17", "-17"),
            ("18446744073709551615", "18446744073709551615"),
            ("0x1F", "31"),
            ("0o17", "15"),
            ("1.0", "1.0"),
            (".5", "0.5"),
            ("5.", "5.0"),
            ("2.5e-4", "0.00025"),
            ("1e3", "1000.0"),
            ("-1E+2", "-100.0"),
        ] {
            assert_eq!(shown(text), expected, "{text}");
        }
    }

    #[test]
    fn what_only_looks_like_a_value_stays_text() {
        for text in [
            "yes", "no", "on", "y", "0777", "007.5", "1_000", "1e", "e1", ".", "-", "+", "1.2.3", "0x",
            "0xg", "-0x1", "nan", "inf", "NaN", "1 2", "--1", ".e1", "tRue", "0o8", "0x+1", "infinity",
        ] {
            assert_eq!(shown(text), format!("'{text}'"));
        }
    }

    #[test]
    fn numbers_that_are_not_finite_or_lose_digits_are_errors() {
        for text in [
            ".nan",
            ".NaN",
            ".inf",
            "-.INF",
            "+.inf",
            "1e999",
            "18446744073709551616",
            "-9223372036854775809",
            "0xfffffffffffffffff",
        ] {
            assert!(shown(text).starts_with("error: "), "{text}: {}", shown(text));
        }
    }
}
