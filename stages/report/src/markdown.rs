//! Markdown tables with padded columns, readable in a terminal too.

use crate::score::Score;

/// The alignment of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Align {
    Left,
    Right,
}

/// A column: its header, and one text a row.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Column {
    header: String,
    align: Align,
    cells: Vec<String>,
}

impl Column {
    /// A column of words; special characters are escaped.
    pub(crate) fn words(header: &str, cells: impl IntoIterator<Item = impl AsRef<str>>) -> Self {
        let cells = cells.into_iter().map(|cell| escape(cell.as_ref())).collect();
        Self { header: escape(header), align: Align::Left, cells }
    }

    /// A column of counts; `None` leaves the cell empty.
    pub(crate) fn counts(header: &str, cells: impl IntoIterator<Item = Option<usize>>) -> Self {
        let cells = cells.into_iter().map(|cell| cell.map_or_else(String::new, |n| n.to_string())).collect();
        Self { header: escape(header), align: Align::Right, cells }
    }

    /// A column of `mean ± std` with the signs one under the other; `None` leaves the cell empty.
    pub(crate) fn scores(header: &str, cells: &[Option<Score>]) -> Self {
        let widest =
            cells.iter().flatten().filter_map(|score| score.std.as_ref()).map(|std| width(std)).max();
        let cells = cells.iter().map(|cell| cell.as_ref().map_or_else(String::new, |s| s.padded(widest)));
        Self { header: escape(header), align: Align::Right, cells: cells.collect() }
    }
}

/// The table of these columns, which are equally long.
pub(crate) fn table(columns: &[Column]) -> String {
    let widths: Vec<usize> = columns
        .iter()
        .map(|column| column.cells.iter().chain([&column.header]).map(|cell| width(cell)).max())
        .map(|widest| widest.unwrap_or(0).max(3))
        .collect();
    let rows = columns.iter().map(|column| column.cells.len()).max().unwrap_or(0);
    let line = |cell: &dyn Fn(&Column, usize) -> String| {
        let cells: Vec<String> =
            columns.iter().zip(&widths).map(|(column, width)| cell(column, *width)).collect();
        format!("| {} |\n", cells.join(" | "))
    };
    let mut text = line(&|column, width| pad(&column.header, column.align, width));
    text += &line(&|column, width| rule(column.align, width));
    for row in 0..rows {
        text += &line(&|column, width| {
            pad(column.cells.get(row).map_or("", String::as_str), column.align, width)
        });
    }
    text
}

/// `text` on one line, with the characters that Markdown would take for its own escaped.
pub(crate) fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for character in one_line(text).chars() {
        if matches!(character, '|' | '\\' | '*' | '`' | '<' | '[') {
            escaped.push('\\');
        }
        escaped.push(character);
    }
    escaped
}

/// `text` with every run of white space and control characters as one space, and none at its ends.
pub(crate) fn one_line(text: &str) -> String {
    let words = text.split(|c: char| c.is_whitespace() || c.is_control()).filter(|word| !word.is_empty());
    words.collect::<Vec<_>>().join(" ")
}

fn width(text: &str) -> usize {
    text.chars().count()
}

fn pad(text: &str, align: Align, width: usize) -> String {
    match align {
        Align::Left => format!("{text:<width$}"),
        Align::Right => format!("{text:>width$}"),
    }
}

fn rule(align: Align, width: usize) -> String {
    let dashes = "-".repeat(width.saturating_sub(1));
    match align {
        Align::Left => format!(":{dashes}"),
        Align::Right => format!("{dashes}:"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn score(mean: &str, std: Option<&str>) -> Option<Score> {
        Some(Score { mean: mean.into(), std: std.map(str::to_owned) })
    }

    #[test]
    fn the_signs_of_a_column_stand_one_under_the_other() {
        let cells = [score("802", Some("197")), None, score("-5", Some("7")), score("226", None)];
        let text = table(&[Column::words("name", ["a", "b", "c", "d"]), Column::scores("score", &cells)]);
        let expected = "\
| name |     score |
| :--- | --------: |
| a    | 802 ± 197 |
| b    |           |
| c    |  -5 ±   7 |
| d    | 226       |
";
        assert_eq!(text, expected);
    }

    #[test]
    fn text_that_looks_like_markdown_stays_text() {
        assert_eq!(escape("a|b *c* `d` <e>\nf\\ [g](h)"), "a\\|b \\*c\\* \\`d\\` \\<e> f\\\\ \\[g](h)");
        assert_eq!(escape("  dril-peak_x + 1 "), "dril-peak_x + 1");
    }

    proptest! {
        #[test]
        fn every_line_is_equally_wide_and_has_the_same_bars(
            cells in prop::collection::vec(("\\PC{0,12}", "\\PC{0,12}"), 0..8),
        ) {
            let left = Column::words("left", cells.iter().map(|(cell, _)| cell));
            let right = Column::words("right | side", cells.iter().map(|(_, cell)| cell));
            let text = table(&[left, right]);
            let lines: Vec<&str> = text.lines().collect();
            prop_assert_eq!(lines.len(), cells.len() + 2);
            for line in lines {
                prop_assert_eq!(width(line), width(text.lines().next().unwrap()));
                let unescaped = line.replace("\\\\", "").replace("\\|", "");
                prop_assert_eq!(unescaped.matches('|').count(), 3, "{}", line);
            }
        }
    }
}
