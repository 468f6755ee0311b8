//! From files and labels to strands (sequences of numbers), grouped by panel and colour.

use std::collections::{BTreeMap, HashMap};

use dril_stage_api::{FanIns, Incoming, InputItem, Problems, StageError, lines};

use super::params::{FigureParams, Measure};

/// The name of the input.
pub(crate) const PORT: &str = "data";

/// Rows of one file and one column, in the order of the file.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Strand {
    /// The labels of the file, `measure`, `column`, and values of other columns that serve as labels.
    pub(crate) labels: BTreeMap<String, String>,
    pub(crate) x: Vec<f64>,
    pub(crate) y: Vec<f64>,
    /// Label and value of the measure's mark.
    pub(crate) mark: Option<(String, f64)>,
}

/// Everything of one colour.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Series {
    /// The values of the labels of `colour`.
    pub(crate) key: Vec<String>,
    /// Its number among all series of the figure: the colour.
    pub(crate) number: usize,
    /// Groups of strands; each group is aggregated into one line.
    pub(crate) groups: Vec<Vec<Strand>>,
}

/// One pair of axes.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Panel {
    pub(crate) row: Vec<String>,
    pub(crate) column: Vec<String>,
    pub(crate) series: Vec<Series>,
}

/// All that is to be drawn.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Data {
    pub(crate) panels: Vec<Panel>,
    /// The keys of `rows`, `columns` and `colour`, each value once, in the order of the matrix.
    pub(crate) rows: Vec<Vec<String>>,
    pub(crate) columns: Vec<Vec<String>>,
    pub(crate) series: Vec<Vec<String>>,
    /// The labels of `colour`, which grow by `column` where columns would otherwise look alike.
    pub(crate) colour: Vec<String>,
}

/// True for what a figure has besides the labels of its files.
pub(crate) fn is_pseudo(label: &str) -> bool {
    label == "measure" || label == "column"
}

/// The lists whose labels each file needs, or a column of that name, with the names of the parameters.
fn keys(params: &FigureParams) -> [(&'static str, &Vec<String>); 4] {
    let FigureParams { rows, columns, colour, categories, .. } = params;
    [("rows", rows), ("columns", columns), ("colour", colour), ("categories", categories)]
}

/// Reports labels that a file is certain to lack, because its columns are known, too.
pub(crate) fn check_labels(params: &FigureParams, inputs: &FanIns<'_>, problems: &mut Problems) {
    for (field, list) in keys(params) {
        for (n, key) in list.iter().enumerate().filter(|(_, key)| !is_pseudo(key)) {
            let lacks = |incoming: &Incoming<'_>| {
                let has_column = incoming.columns.is_none_or(|columns| columns.contains(&key.as_str()));
                !has_column && !incoming.labels.contains_key(key)
            };
            let path = format!("{field}.{n}");
            if !inputs.at(PORT).iter().any(lacks) {
                continue;
            }
            if inputs.has(PORT, key) {
                inputs.require(PORT, key, &path, problems);
            } else {
                inputs.unknown(PORT, key, &path, problems);
            }
        }
    }
}

/// Reports columns that a file is certain to lack.
pub(crate) fn check_columns(params: &FigureParams, inputs: &FanIns<'_>, problems: &mut Problems) {
    let x = params.x.iter().map(|name| ("x".to_owned(), name.as_str()));
    let y = params.y.iter().enumerate().flat_map(|(n, measure)| {
        let place = move |m: usize| match measure {
            Measure::Column(_) => format!("y.{n}"),
            Measure::Columns { .. } => format!("y.{n}.columns.{m}"),
        };
        let mark = measure.mark().map(|mark| (format!("y.{n}.mark.column"), mark.column.as_str()));
        measure.columns().into_iter().enumerate().map(move |(m, name)| (place(m), name)).chain(mark)
    });
    for (path, name) in x.chain(y) {
        let is_it = |column: &&str| match name.strip_suffix('*') {
            Some(start) => column.starts_with(start),
            None => *column == name,
        };
        let mut known = inputs.at(PORT).iter().filter_map(|incoming| incoming.columns);
        if let Some(columns) = known.find(|columns| !columns.iter().any(is_it)) {
            problems.unknown(&path, "column", name, &format!("the columns of a file at `{PORT}`"), columns);
        }
    }
}

/// Reads the files.
///
/// # Errors
/// A file is not CSV, lacks a column or a label, or has text where a number is needed.
pub(crate) fn read(params: &FigureParams, items: &[InputItem<'_>]) -> Result<Vec<Strand>, StageError> {
    let mut strands = Vec::new();
    for item in items {
        let bytes = std::fs::read(item.path).map_err(StageError::io("cannot read", item.path))?;
        let labels = item.labels.iter().map(|(name, value)| (name.clone(), value.clone())).collect();
        let read = file(params, &labels, &bytes);
        strands.extend(read.map_err(|message| {
            let labels = crate::samples::describe(item.labels);
            StageError::input(PORT, item.path, format!("{message} (labels: {labels})"))
        })?);
    }
    Ok(strands)
}

/// The strands of one file.
pub(crate) fn file(
    params: &FigureParams,
    labels: &BTreeMap<String, String>,
    bytes: &[u8],
) -> Result<Vec<Strand>, String> {
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(bytes);
    let unreadable = |error: csv::Error| format!("not a CSV file: {}", lines::explain(&error, bytes, None));
    let headers = reader.headers().map_err(unreadable)?.clone();
    let at = |name: &str| headers.iter().position(|header| header == name);
    let missing = |name: &str| format!("has no column `{name}`; its columns are {}", listed(&headers));
    let x = params.x.as_deref().map(|name| at(name).ok_or_else(|| missing(name))).transpose()?;
    let mut wanted: Vec<(&Measure, usize)> = Vec::new();
    let mut marks: Vec<Option<usize>> = Vec::new();
    for measure in &params.y {
        let mark = measure.mark().map(|mark| at(&mark.column).ok_or_else(|| missing(&mark.column)));
        let mark = mark.transpose()?;
        for name in measure.columns() {
            let found: Vec<usize> = match name.strip_suffix('*') {
                Some(start) => (0..headers.len()).filter(|at| headers[*at].starts_with(start)).collect(),
                None => at(name).into_iter().collect(),
            };
            if found.is_empty() {
                return Err(missing(name));
            }
            marks.extend(found.iter().map(|_| mark));
            wanted.extend(found.into_iter().map(|at| (measure, at)));
        }
    }
    let splits = splits(params, labels, &headers)?;
    // Labels of `pool` may be absent, so that one figure serves one training or several. Columns do not serve as labels
    // here: the column `seed` in a file of scores is the seed of each episode.
    let mut strands: Vec<Strand> = Vec::new();
    let mut places: HashMap<(usize, Vec<String>), usize> = HashMap::new();
    for (n, record) in reader.records().enumerate() {
        let record = record.map_err(unreadable)?;
        let number = |at: usize| {
            number(&record[at], &headers[at]).map_err(|message| {
                let line = record.position().map_or(0, |position| lines::of(bytes, position));
                format!("line {line}: {message}")
            })
        };
        let Some(x) = x.map_or(Ok(Some(n as f64)), number)? else { continue };
        for (m, (measure, column)) in wanted.iter().enumerate() {
            let Some(y) = number(*column)? else { continue };
            let split: Vec<String> = splits.iter().map(|(_, at)| record[*at].to_owned()).collect();
            let place = *places.entry((m, split.clone())).or_insert_with(|| {
                let mut labels = labels.clone();
                labels.insert("measure".to_owned(), measure.title().to_owned());
                labels.insert("column".to_owned(), headers[*column].to_owned());
                labels.extend(splits.iter().map(|(key, _)| (*key).clone()).zip(split));
                strands.push(Strand { labels, x: Vec::new(), y: Vec::new(), mark: None });
                strands.len() - 1
            });
            if let (None, Some(at), Some(mark)) = (&strands[place].mark, marks[m], measure.mark()) {
                strands[place].mark = number(at)?.map(|value| (mark.label.clone(), value));
            }
            strands[place].x.push(x);
            strands[place].y.push(y);
        }
    }
    Ok(strands)
}

/// Labels that no axis of the matrix has and that are columns of the file, with the places of these.
fn splits<'p>(
    params: &'p FigureParams,
    labels: &BTreeMap<String, String>,
    headers: &csv::StringRecord,
) -> Result<Vec<(&'p String, usize)>, String> {
    let keys = keys(params).into_iter().flat_map(|(_, list)| list);
    let split = |key: &'p String| match headers.iter().position(|header| header == key) {
        Some(at) => Ok((key, at)),
        None => {
            let columns = listed(headers);
            Err(format!("has neither a label nor a column `{key}`; its columns are {columns}"))
        }
    };
    keys.filter(|key| !labels.contains_key(*key) && !is_pseudo(key)).map(split).collect()
}

fn listed(headers: &csv::StringRecord) -> String {
    headers.iter().map(|header| format!("`{header}`")).collect::<Vec<_>>().join(", ")
}

/// The number in a cell; `None` for empty cells and numbers that are not finite.
fn number(text: &str, column: &str) -> Result<Option<f64>, String> {
    if text.is_empty() {
        return Ok(None);
    }
    let value: f64 = text.parse().map_err(|_| format!("`{column}` is `{text}`, expected a number"))?;
    Ok(Some(value).filter(|value| value.is_finite()))
}

/// Groups strands by panel and colour.
///
/// # Errors
/// There is nothing to draw.
pub(crate) fn arrange(params: &FigureParams, strands: Vec<Strand>) -> Result<Data, StageError> {
    let mut colour = params.colour.clone();
    let taken = [&params.rows, &params.columns, &params.colour, &params.pool, &params.categories];
    let is_free = |label: &str| taken.iter().all(|list| list.iter().all(|key| key != label));
    // Columns of one panel that nothing else tells apart have colours of their own.
    let several = |measure: &Measure| measure.columns().len() > 1 || measure.columns()[0].ends_with('*');
    let several = params.y.iter().any(several) || params.y.len() > 1 && is_free("measure");
    if several && is_free("column") {
        colour.push("column".to_owned());
    }
    let mut data =
        Data { panels: Vec::new(), rows: Vec::new(), columns: Vec::new(), series: Vec::new(), colour };
    let mut places: HashMap<(usize, usize, Vec<String>), usize> = HashMap::new();
    for strand in strands.into_iter().filter(|strand| !strand.y.is_empty()) {
        let key = |names: &[String]| -> Vec<String> {
            names.iter().map(|name| strand.labels.get(name).cloned().unwrap_or_default()).collect()
        };
        let (row, column, series) = (key(&params.rows), key(&params.columns), key(&data.colour));
        note(&mut data.rows, &row);
        note(&mut data.columns, &column);
        let number = note(&mut data.series, &series);
        let panel = data.panels.iter().position(|panel| panel.row == row && panel.column == column);
        let panel = panel.unwrap_or_else(|| {
            data.panels.push(Panel { row: row.clone(), column: column.clone(), series: Vec::new() });
            data.panels.len() - 1
        });
        let all = &mut data.panels[panel].series;
        let at = all.iter().position(|other| other.key == series).unwrap_or_else(|| {
            all.push(Series { key: series.clone(), number, groups: Vec::new() });
            all.len() - 1
        });
        // What is left of the labels tells strands of one colour apart.
        let rest: Vec<String> = strand
            .labels
            .iter()
            .filter(|(name, _)| !params.pool.contains(name))
            .map(|(name, value)| format!("{name}\0{value}"))
            .collect();
        let groups = &mut all[at].groups;
        let group = *places.entry((panel, at, rest)).or_insert(groups.len());
        match groups.get_mut(group) {
            Some(group) => group.push(strand),
            None => groups.push(vec![strand]),
        }
    }
    if data.panels.is_empty() {
        return Err(StageError::failed("no file of input `data` has a row to draw, expected at least one"));
    }
    sort(&mut data);
    Ok(data)
}

/// Puts panels and series into the order of their labels: by the first label, then the second, each by the order in
/// which its values come first.
fn sort(data: &mut Data) {
    let before = data.series.clone();
    for keys in [&mut data.rows, &mut data.columns, &mut data.series] {
        crate::pivot::sort_by_appearance(keys, Vec::as_slice);
    }
    let place = |list: &[Vec<String>], key: &Vec<String>| list.iter().position(|other| other == key);
    let (rows, columns, series) = (&data.rows, &data.columns, &data.series);
    data.panels.sort_by_key(|panel| (place(rows, &panel.row), place(columns, &panel.column)));
    for panel in &mut data.panels {
        for one in &mut panel.series {
            one.number = place(series, &before[one.number]).unwrap_or(one.number);
        }
        panel.series.sort_by_key(|one| one.number);
    }
}

/// Its index in the list; it is appended if absent.
fn note(list: &mut Vec<Vec<String>>, key: &Vec<String>) -> usize {
    list.iter().position(|other| other == key).unwrap_or_else(|| {
        list.push(key.clone());
        list.len() - 1
    })
}
