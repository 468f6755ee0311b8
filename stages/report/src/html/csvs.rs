//! CSV files as HTML tables.

use maud::{Markup, html};

/// Rows shown, at most; the file has all of them.
pub(crate) const MOST_ROWS: usize = 100;

/// A CSV file in memory.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Csv {
    pub(crate) headers: Vec<String>,
    pub(crate) rows: Vec<Vec<String>>,
}

impl Csv {
    /// Parses it; `None` if it is not CSV or has no row.
    pub(crate) fn parse(bytes: &[u8]) -> Option<Self> {
        let mut reader = csv::ReaderBuilder::new().flexible(true).from_reader(bytes);
        let text = |record: &csv::StringRecord| record.iter().map(str::to_owned).collect::<Vec<_>>();
        let headers = text(reader.headers().ok()?);
        let rows = reader.records().map(|record| record.map(|record| text(&record)));
        let rows = rows.collect::<Result<Vec<_>, _>>().ok()?;
        (!rows.is_empty()).then_some(Self { headers, rows })
    }

    /// The index of a column.
    pub(crate) fn at(&self, name: &str) -> Option<usize> {
        self.headers.iter().position(|header| header == name)
    }

    /// A cell; empty if the column is absent.
    pub(crate) fn cell<'c>(&'c self, row: &'c [String], name: &str) -> &'c str {
        self.at(name).and_then(|at| row.get(at)).map_or("", String::as_str)
    }

    /// True where all cells of a column that are not empty are numbers.
    fn is_numeric(&self, column: usize) -> bool {
        let cells = self.rows.iter().filter_map(|row| row.get(column)).filter(|cell| !cell.is_empty());
        let mut cells = cells.peekable();
        cells.peek().is_some() && cells.all(|cell| cell.parse::<f64>().is_ok())
    }

    /// The table, cut after [`MOST_ROWS`] rows.
    pub(crate) fn table(&self, caption: &str) -> Markup {
        let numeric: Vec<bool> = (0..self.headers.len()).map(|column| self.is_numeric(column)).collect();
        let class = |column: usize| numeric.get(column).copied().unwrap_or(false).then_some("n");
        let more = self.rows.len().saturating_sub(MOST_ROWS);
        html! {
            div class="wide" tabindex="0" role="region" aria-label=(caption) {
                table {
                    caption { (caption) }
                    thead { tr {
                        @for (n, header) in self.headers.iter().enumerate() {
                            th scope="col" class=[class(n)] { (header) }
                        }
                    } }
                    tbody {
                        @for row in self.rows.iter().take(MOST_ROWS) {
                            tr { @for (n, cell) in row.iter().enumerate() { td class=[class(n)] { (cell) } } }
                        }
                    }
                }
            }
            @if more > 0 { p class="quiet" { "and " (super::count(more, "more row")) "; the file has all of them." } }
        }
    }
}
