//! Rows of text in columns; the last column is wrapped.

/// Cells wider than this share of the width do not push other columns away.
const PART: usize = 4;
/// Cells up to this width always fit.
const NARROW: usize = 24;
/// Cells from this width on never push other columns away.
const WIDE: usize = 44;
/// With less width than this, the last column goes below the others.
const NARROWEST: usize = 24;

/// Colours a padded cell of a column.
pub(super) type Paint<'a> = &'a dyn Fn(usize, String) -> String;

/// The rows (all of equal length), indented by two, in lines of at most `room` columns where the words allow it.
pub(super) fn render(rows: &[Vec<String>], room: usize, paint: Paint<'_>) -> String {
    let fixed = rows.first().map_or(0, Vec::len).saturating_sub(1);
    let widest = (room / PART).clamp(NARROW, WIDE);
    let widths: Vec<usize> = (0..fixed).map(|column| width(rows, column, widest)).collect();
    let start: usize = 2 + widths.iter().map(|width| width + 2).sum::<usize>();
    let below = start.saturating_add(NARROWEST) > room;
    let indent = if below { 6 } else { start };
    let mut text = String::new();
    for row in rows {
        let length = |(cell, width): (&String, &usize)| cell.chars().count().max(*width) + 2;
        let overflows = 2 + row.iter().zip(&widths).map(length).sum::<usize>() > start;
        let mut line = "  ".to_owned();
        for (column, (cell, width)) in row.iter().zip(&widths).enumerate() {
            line += &paint(column, format!("{cell:<width$}"));
            line += "  ";
        }
        let words = row.last().map(String::as_str).unwrap_or_default();
        let lines = wrap(words, room.saturating_sub(indent).max(16));
        for (number, part) in lines.into_iter().enumerate() {
            // With unlimited width, a long row stays on one line, so that it can be searched.
            let beside = number == 0 && !below && (!overflows || room == usize::MAX);
            if !beside {
                text += line.trim_end();
                text.push('\n');
                line = " ".repeat(indent);
            }
            line += &paint(fixed, part);
        }
        text += line.trim_end();
        text.push('\n');
    }
    text
}

fn width(rows: &[Vec<String>], column: usize, widest: usize) -> usize {
    let widths = rows.iter().filter_map(|row| row.get(column)).map(|cell| cell.chars().count());
    widths.filter(|width| *width <= widest).max().unwrap_or(0)
}

/// Breaks a text at spaces into lines of at most `width` characters; a longer word gets a line of its own.
pub(super) fn wrap(text: &str, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split(' ').filter(|word| !word.is_empty()) {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(room: usize) -> String {
        let row = |cells: [&str; 3]| cells.map(str::to_owned).to_vec();
        let rows = [row(["a", "integer", "how many of them there are"]), row(["long-name", "map", ""])];
        render(&rows, room, &|_, cell| cell)
    }

    #[test]
    fn lines_break_at_spaces_and_lose_no_word() {
        assert_eq!(wrap("a bb ccc dddd", 6), ["a bb", "ccc", "dddd"]);
        assert_eq!(wrap("incomprehensibilities x", 5), ["incomprehensibilities", "x"]);
        assert!(wrap("", 5).is_empty());
    }

    #[test]
    fn columns_line_up() {
        let expected = "  a          integer  how many of them there are\n  long-name  map\n";
        assert_eq!(table(80), expected);
    }

    #[test]
    fn a_narrow_terminal_gets_the_words_below() {
        let expected = "  a          integer\n      how many of them there\n      are\n  long-name  map\n";
        assert_eq!(table(30), expected);
    }
}
