//! The last lines of a log.

use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use super::{FsError, Result, open};

/// The last lines of a text file: at most `lines`, from at most the last 64 KiB, each with at most `width` characters. Of a line
/// that overwrites itself (a progress bar), only the last state is returned.
pub fn tail(path: &Path, lines: usize, width: usize) -> Result<Vec<String>> {
    const WINDOW: u64 = 64 * 1024;
    let mut file = open(path)?;
    let length = file.metadata().map_err(FsError::at("read", path))?.len();
    file.seek(SeekFrom::Start(length.saturating_sub(WINDOW))).map_err(FsError::at("read", path))?;
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes).map_err(FsError::at("read", path))?;
    let text = String::from_utf8_lossy(&bytes);
    let all: Vec<&str> = text.lines().collect();
    Ok(all[all.len().saturating_sub(lines)..].iter().map(|line| last_state(line, width)).collect())
}

/// Calls `each` with the lines of a text file, first to last, until it returns false. The file may be longer than the memory. Of a
/// line that overwrites itself, only the last state is seen.
pub fn each_line(path: &Path, mut each: impl FnMut(String) -> bool) -> Result<()> {
    let mut reader = BufReader::new(open(path)?);
    let mut bytes = Vec::new();
    while reader.read_until(b'\n', &mut bytes).map_err(FsError::at("read", path))? > 0 {
        let text = String::from_utf8_lossy(&bytes);
        if !each(last_state(text.strip_suffix('\n').unwrap_or(&text), usize::MAX)) {
            break;
        }
        bytes.clear();
    }
    Ok(())
}

/// What is to be seen of a line at its end, in at most `width` characters.
fn last_state(line: &str, width: usize) -> String {
    let state = line.rsplit('\r').find(|state| !state.trim().is_empty()).unwrap_or_default();
    match state.char_indices().nth(width) {
        Some((end, _)) => format!("{}… ({} more characters)", &state[..end], state[end..].chars().count()),
        None => state.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tail_is_the_last_lines() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        let text: String = (0..20_000).map(|line| format!("line {line}\n")).collect();
        std::fs::write(&path, text).unwrap();
        assert_eq!(tail(&path, 2, 80).unwrap(), ["line 19998", "line 19999"]);
        assert_eq!(tail(&path, 0, 80).unwrap(), [""; 0]);
        std::fs::write(&path, format!("one\r two\r  \r\nabc{}\n", "x".repeat(100_000))).unwrap();
        assert_eq!(tail(&path, 1, 3).unwrap(), ["xxx… (65532 more characters)"]);
        std::fs::write(&path, "10 %\r 50 %\r100 %\r\nend").unwrap();
        assert_eq!(tail(&path, 5, 80).unwrap(), ["100 %", "end"]);
    }

    #[test]
    fn each_line_is_seen_once_in_order_and_no_longer_than_wanted() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        let lines = |most: usize| {
            let mut seen = Vec::new();
            each_line(&path, |line| {
                seen.push(line);
                seen.len() < most
            })
            .unwrap();
            seen
        };
        std::fs::write(&path, b"a\r\n\n 1 %\r 2 %\nb\xff\nend").unwrap();
        assert_eq!(lines(9), ["a", "", " 2 %", "b\u{fffd}", "end"]);
        assert_eq!(lines(2), ["a", ""]);
        std::fs::write(&path, "").unwrap();
        assert_eq!(lines(9), [""; 0]);
    }
}
