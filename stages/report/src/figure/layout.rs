//! The layout of a figure: positions of all parts on the canvas, in pixels.

use super::data::Data;
use super::params::FigureParams;
use super::svg::width_of;

/// The width of every figure.
pub(crate) const WIDTH: i32 = 760;
const MARGIN: i32 = 12;
const TITLE: i32 = 14;
const SMALL: i32 = 11;
const LINE: i32 = 16;
/// Between panels.
const GAP: i32 = 14;

/// One entry of the legend: which series, its name, and where it stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Key {
    pub(crate) series: usize,
    pub(crate) name: String,
    pub(crate) at: (i32, i32),
}

/// Where a panel's plot lies: its left upper corner and its size, without labels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Place {
    pub(crate) left: i32,
    pub(crate) top: i32,
    pub(crate) width: i32,
    pub(crate) height: i32,
    /// True where the labels of the vertical axis stand beside it.
    pub(crate) y_labels: bool,
    /// True where the labels of the horizontal axis stand under it.
    pub(crate) x_labels: bool,
}

/// A text and the place of its baseline.
pub(crate) type Written = (String, (i32, i32));

/// The whole canvas.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Layout {
    pub(crate) height: i32,
    /// The lines of the title with the place of their baseline.
    pub(crate) title: Vec<(String, i32)>,
    pub(crate) legend: Vec<Key>,
    /// What the legend's colours stand for, and where.
    pub(crate) legend_title: Option<Written>,
    /// The names of columns (and of panels that stand in no grid) and those of rows.
    pub(crate) headings: [Vec<Written>; 2],
    pub(crate) panels: Vec<Place>,
    /// The upper end of the text under the panels; its lines.
    pub(crate) notes: Vec<(String, i32)>,
    /// Where the titles of the axes stand.
    pub(crate) x_title: i32,
    pub(crate) y_title: i32,
}

/// What the layout depends on beside the data.
#[derive(Clone, Debug, Default)]
pub(crate) struct Wishes {
    /// The height of a plot.
    pub(crate) plot: i32,
    /// Characters of the longest label of a vertical axis.
    pub(crate) y_label: usize,
    /// Characters of the longest label of a horizontal axis.
    pub(crate) x_label: usize,
    /// True where every panel needs its own labels on that axis.
    pub(crate) own_y: bool,
    pub(crate) own_x: bool,
    pub(crate) has_x_title: bool,
    pub(crate) has_y_title: bool,
    /// The texts under the panels.
    pub(crate) notes: Vec<String>,
}

/// Panels side by side: one for each column, or a few to a line where there are no rows.
pub(crate) fn across(params: &FigureParams, data: &Data) -> usize {
    let panels = data.panels.len();
    let columns = if params.rows.is_empty() { panels } else { data.columns.len() };
    let most = if params.rows.is_empty() { 4 } else { usize::MAX };
    match columns {
        5 | 6 if params.rows.is_empty() => 3,
        columns => columns.min(most).max(1),
    }
}

/// The line and the column of each panel.
pub(crate) fn grid(params: &FigureParams, data: &Data) -> Vec<(usize, usize)> {
    let across = across(params, data);
    let place = |(n, panel): (usize, &super::data::Panel)| {
        if params.rows.is_empty() {
            return (n / across, n % across);
        }
        let find = |list: &[Vec<String>], key| list.iter().position(|other| other == key).unwrap_or(0);
        (find(&data.rows, &panel.row), find(&data.columns, &panel.column))
    };
    data.panels.iter().enumerate().map(place).collect()
}

/// The headings of panels, from the values of their labels: all on one line each where every one fits, or else a line for
/// each label in all of them. A number says nothing by itself, so it has its label before it where there is room.
fn headings(labels: &[String], keys: &[&Vec<String>], width: i32) -> Vec<Vec<String>> {
    let fits = |line: &str| width_of(line, SMALL + 1) <= width;
    let words = |with_labels: bool| -> Vec<Vec<String>> {
        let word = |(label, value): (&String, &String)| {
            let is_number = with_labels && value.parse::<f64>().is_ok();
            if is_number { format!("{label} {value}") } else { value.clone() }
        };
        let filled = |key: &&Vec<String>| {
            labels.iter().zip(*key).filter(|(_, value)| !value.is_empty()).map(word).collect::<Vec<_>>()
        };
        keys.iter().map(filled).collect()
    };
    let joined = |words: Vec<Vec<String>>| -> Vec<Vec<String>> {
        let line = |words: Vec<String>| if words.is_empty() { Vec::new() } else { vec![words.join(" · ")] };
        words.into_iter().map(line).collect()
    };
    let tries = [joined(words(true)), words(true), joined(words(false))];
    let fitting = tries.into_iter().find(|lines| lines.iter().flatten().all(|line| fits(line)));
    fitting.unwrap_or_else(|| words(false))
}

/// The columns of panels: where the first plot begins, how wide each is, and how far it is from one to the next.
struct Columns {
    first: i32,
    width: i32,
    step: i32,
}

impl Columns {
    fn of(across: usize, wishes: &Wishes) -> Self {
        let label = wishes.y_label as i32 * SMALL * 6 / 10 + 12;
        let first = MARGIN / 2 + label + if wishes.has_y_title { 16 } else { 0 };
        let inner_label = if wishes.own_y { label } else { 0 };
        // The last label of one panel and the first of the next stand under the room between the two.
        let gap = inner_label + GAP.max(8 + (wishes.x_label as i32 + 1) * SMALL * 3 / 10);
        let columns = across as i32;
        let width = (WIDTH - first - MARGIN - 8 - (columns - 1) * gap) / columns;
        Self { first, width, step: width + gap }
    }
}

/// The names of the panels: one list of lines for each, of its columns and of its rows.
struct Names {
    is_grid: bool,
    over: Vec<Vec<String>>,
    beside: Vec<Vec<String>>,
}

impl Names {
    fn of(params: &FigureParams, data: &Data, width: i32) -> Self {
        let columns: Vec<&Vec<String>> = data.panels.iter().map(|panel| &panel.column).collect();
        let rows: Vec<&Vec<String>> = data.panels.iter().map(|panel| &panel.row).collect();
        let over = headings(&params.columns, &columns, width);
        Self { is_grid: !params.rows.is_empty(), over, beside: headings(&params.rows, &rows, WIDTH) }
    }

    /// The lines over all panels, and those over each panel: in a grid, columns have their names once, on top, and each
    /// row has its name over it.
    fn lines(&self) -> (i32, i32) {
        let over = self.over.iter().map(Vec::len).max().unwrap_or(0) as i32;
        if self.is_grid { (over, 1) } else { (0, over) }
    }

    fn placed(&self, grid: &[(usize, usize)], panels: &[Place]) -> [Vec<Written>; 2] {
        let (mut over, mut beside) = (Vec::new(), Vec::new());
        for (n, place) in panels.iter().enumerate() {
            let write = |lines: &[String], above: i32, names: &mut Vec<Written>| {
                for (k, text) in lines.iter().rev().enumerate() {
                    let up = 5 + above + k as i32 * (LINE - 2);
                    names.push((text.clone(), (place.left, place.top - up)));
                }
            };
            let is_first_of_row = !grid[..n].iter().any(|(line, _)| *line == grid[n].0);
            if !self.is_grid {
                write(&self.over[n], 0, &mut over);
            } else if grid[n].0 == 0 {
                write(&self.over[n], LINE - 2, &mut over);
            }
            if self.is_grid && is_first_of_row {
                write(&self.beside[n], 0, &mut beside);
            }
        }
        [over, beside]
    }
}

/// Lays everything out.
pub(crate) fn layout(params: &FigureParams, data: &Data, wishes: &Wishes) -> Layout {
    let mut y = MARGIN + TITLE;
    let mut title = Vec::new();
    for line in wrapped(&crate::markdown::one_line(&params.title), TITLE + 1) {
        title.push((line, y));
        y += TITLE + 4;
    }
    let (legend_title, legend, mut y) = legend(data, y + 2);
    let grid = grid(params, data);
    let columns = Columns::of(across(params, data), wishes);
    let names = Names::of(params, data, columns.width);
    let (top_lines, each_line) = names.lines();
    let heading_height = 4 + each_line * (LINE - 2);
    y += top_lines * (LINE - 2);
    let line_height = heading_height + wishes.plot + GAP / 2 + if wishes.own_x { LINE + 4 } else { 2 };
    let place = |(line, column): &(usize, usize)| Place {
        left: columns.first + *column as i32 * columns.step,
        top: y + *line as i32 * line_height + heading_height,
        width: columns.width,
        height: wishes.plot,
        y_labels: wishes.own_y || *column == 0,
        x_labels: wishes.own_x || !grid.contains(&(line + 1, *column)),
    };
    let panels: Vec<Place> = grid.iter().map(place).collect();
    let bottom = panels.iter().map(|panel| panel.top + panel.height).max().unwrap_or(y);
    let y_title = (y + heading_height + bottom) / 2;
    let x_title = bottom + LINE + 14;
    y = bottom + LINE + 10 + if wishes.has_x_title { LINE + 2 } else { 0 };
    let mut notes = Vec::new();
    for line in wishes.notes.iter().flat_map(|note| wrapped(note, SMALL)) {
        y += LINE - 2;
        notes.push((line, y));
    }
    let headings = names.placed(&grid, &panels);
    Layout { height: y + MARGIN, title, legend, legend_title, headings, panels, notes, x_title, y_title }
}

/// The legend, from `y` on: none for one series; in lines as long as the canvas is wide.
fn legend(data: &Data, mut y: i32) -> (Option<Written>, Vec<Key>, i32) {
    if data.series.len() < 2 {
        return (None, Vec::new(), y);
    }
    y += SMALL;
    let mut x = MARGIN;
    let names: Vec<&str> = data.colour.iter().map(String::as_str).filter(|name| *name != "column").collect();
    let title = (!names.is_empty()).then(|| (format!("{}:", names.join(" · ")), (x, y)));
    if let Some((text, _)) = &title {
        x += width_of(text, SMALL) + 8;
    }
    let mut keys = Vec::new();
    for (series, key) in data.series.iter().enumerate() {
        let name = key.join(" · ");
        let width = 16 + width_of(&name, SMALL) + 14;
        if x + width > WIDTH - MARGIN && x > MARGIN {
            (x, y) = (MARGIN, y + LINE);
        }
        keys.push(Key { series, name, at: (x, y) });
        x += width;
    }
    (title, keys, y + 8)
}

/// The text in lines that fit the canvas.
pub(crate) fn wrapped(text: &str, size: i32) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        let line = lines.last().map_or("", String::as_str);
        let longer = if line.is_empty() { word.to_owned() } else { format!("{line} {word}") };
        if width_of(&longer, size) <= WIDTH - 2 * MARGIN || line.is_empty() {
            lines.pop();
            lines.push(longer);
        } else {
            lines.push(word.to_owned());
        }
    }
    lines.retain(|line| !line.is_empty());
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_texts_are_broken_between_words() {
        let text = "word ".repeat(60);
        let lines = wrapped(&text, 11);
        assert!(lines.len() > 1 && lines.iter().all(|line| width_of(line, 11) <= WIDTH - 24));
        assert_eq!(lines.join(" "), text.trim());
    }
}
