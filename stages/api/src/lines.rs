//! The lines of CSV files in messages: csv's own numbers are wrong after `\r\n` and empty lines.

/// What is wrong in a CSV file of these bytes, with the line and, if `headers` are known, the column.
pub fn explain(error: &csv::Error, bytes: &[u8], headers: Option<&csv::StringRecord>) -> String {
    match error.kind() {
        csv::ErrorKind::UnequalLengths { pos: Some(position), expected_len, len } => {
            let (line, cells) = (of(bytes, position), if *len == 1 { "cell" } else { "cells" });
            format!("line {line} has {len} {cells}, expected {expected_len}")
        }
        csv::ErrorKind::Utf8 { pos: Some(position), .. } => {
            format!("line {} is not UTF-8", of(bytes, position))
        }
        csv::ErrorKind::Deserialize { pos: Some(position), err } => {
            let field = err.field().and_then(|field| usize::try_from(field).ok());
            let column = headers.zip(field).and_then(|(headers, field)| headers.get(field));
            let column = column.map(|column| format!(" in column `{column}`")).unwrap_or_default();
            format!("line {}{column}: {}", of(bytes, position), err.kind())
        }
        _ => error.to_string(),
    }
}

/// The line at which a record begins, from 1. The position of a record, and its own line number, may lie before the end of
/// the line above (`\r\n`) and before empty lines.
pub fn of(bytes: &[u8], position: &csv::Position) -> u64 {
    let at = usize::try_from(position.byte()).map_or(bytes.len(), |at| at.min(bytes.len()));
    let skipped = bytes[at..].iter().take_while(|byte| matches!(byte, b'\r' | b'\n')).count();
    let before = &bytes[..at + skipped];
    let ends = before.iter().enumerate().filter(|(n, byte)| match byte {
        b'\n' => true,
        b'\r' => before.get(n + 1) != Some(&b'\n'),
        _ => false,
    });
    ends.count() as u64 + 1
}
