//! CSV files as HTML tables.

use maud::{Markup, html};

use super::{LARGEST_TABLE, Room};

/// Rows shown, the first number with which the table fits; the file has all of them.
const ROWS: [usize; 3] = [100, 20, 5];

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

    /// The table with as many rows as fit; `None` where none of [`ROWS`] does.
    pub(crate) fn table(&self, caption: &str, room: &mut Room) -> Option<Markup> {
        let fits = |rows: &usize| {
            let cells = self.rows.iter().take(*rows).flatten().chain(&self.headers);
            // A quick lower bound, so that a file of many megabytes is not written out for nothing.
            cells.map(|cell| cell.len() + "<td></td>".len()).sum::<usize>() <= LARGEST_TABLE
        };
        let shown = ROWS.iter().filter(|rows| fits(rows)).map(|rows| self.first(*rows, caption));
        let mut shown = shown.filter(|shown| shown.0.len() <= LARGEST_TABLE);
        shown.find(|shown| room.take(shown.0.len()))
    }

    /// The table, cut after this many rows.
    fn first(&self, rows: usize, caption: &str) -> Markup {
        let numeric: Vec<bool> = (0..self.headers.len()).map(|column| self.is_numeric(column)).collect();
        let class = |column: usize| numeric.get(column).copied().unwrap_or(false).then_some("n");
        let more = self.rows.len().saturating_sub(rows);
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
                        @for row in self.rows.iter().take(rows) {
                            tr { @for (n, cell) in row.iter().enumerate() { td class=[class(n)] { (cell) } } }
                        }
                    }
                }
            }
            @if more > 0 { p class="quiet" { "and " (super::count(more, "more row")) "; the file has all of them." } }
        }
    }
}
