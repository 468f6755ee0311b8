//! Published results as a CSV file: key columns, `mean`, and `std` if one was published. Numbers keep the digits of the
//! file.

use std::path::Path;

use dril_stage_api::{StageError, lines};

/// The name of the input in every kind that has one.
pub(crate) const PORT: &str = "reference";

/// A number of the file: its digits as published, and its value.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Published {
    pub(crate) text: String,
    pub(crate) value: f64,
}

/// A published result; an empty cell of the file is a number that was not published.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Row {
    /// The values of the key columns, in the order asked for.
    pub(crate) key: Vec<String>,
    pub(crate) mean: Option<Published>,
    pub(crate) std: Option<Published>,
    line: u64,
}

/// The file, in its own order.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Reference {
    pub(crate) rows: Vec<Row>,
}

impl Reference {
    /// Reads the file at input [`PORT`]. Columns other than `keys`, `mean` and `std` are left alone; only `std` may be
    /// missing.
    ///
    /// # Errors
    /// The file cannot be read, a column is missing or duplicated, there is no row, a cell is not a number, or two rows have
    /// the same key.
    pub(crate) fn read(path: &Path, keys: &[&str]) -> Result<Self, StageError> {
        let bytes = std::fs::read(path).map_err(StageError::io("cannot read", path))?;
        Self::parse(&bytes, keys).map_err(|message| StageError::input(PORT, path, message))
    }

    fn parse(bytes: &[u8], keys: &[&str]) -> Result<Self, String> {
        let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(bytes);
        let unreadable =
            |error: csv::Error| format!("not a CSV file: {}", lines::explain(&error, bytes, None));
        let headers = reader.headers().map_err(unreadable)?.clone();
        let at = positions(&headers, keys)?;
        let mut rows: Vec<Row> = Vec::new();
        for record in reader.records() {
            let record = record.map_err(unreadable)?;
            let line = record.position().map_or(0, |position| lines::of(bytes, position));
            let row = row(&record, line, keys, &at)?;
            if let Some(first) = rows.iter().find(|other| other.key == row.key) {
                let key = describe(keys, &row.key);
                return Err(format!(
                    "lines {} and {} both give {key}, expected one row for it; remove one of them",
                    first.line, row.line
                ));
            }
            rows.push(row);
        }
        if rows.is_empty() {
            return Err("has no row under its header, expected at least one".to_owned());
        }
        Ok(Self { rows })
    }

    /// The row of that key.
    pub(crate) fn get(&self, key: &[String]) -> Option<&Row> {
        self.rows.iter().find(|row| row.key == key)
    }
}

/// Where the key columns and `mean` are, in this order, and after them `std` if there is one.
fn positions(headers: &csv::StringRecord, keys: &[&str]) -> Result<Vec<usize>, String> {
    let wanted: Vec<&str> = keys.iter().copied().chain(["mean"]).collect();
    let list = |names: &mut dyn Iterator<Item = &str>| {
        names.map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ")
    };
    let count = |name: &str| headers.iter().filter(|header| *header == name).count();
    let missing = list(&mut wanted.iter().copied().filter(|name| count(name) == 0));
    if !missing.is_empty() {
        let seen = if headers.is_empty() { "none".to_owned() } else { list(&mut headers.iter()) };
        let expected = list(&mut wanted.iter().copied());
        return Err(format!("has no column {missing}: its columns are {seen}, expected {expected}"));
    }
    let wanted: Vec<&str> = wanted.into_iter().chain(["std"]).collect();
    let repeated = list(&mut wanted.iter().copied().filter(|name| count(name) > 1));
    if !repeated.is_empty() {
        return Err(format!("has column {repeated} more than once, expected each once"));
    }
    Ok(wanted.iter().filter_map(|name| headers.iter().position(|header| header == *name)).collect())
}

fn row(record: &csv::StringRecord, line: u64, keys: &[&str], at: &[usize]) -> Result<Row, String> {
    let cell = |column: usize| at.get(column).and_then(|at| record.get(*at)).unwrap_or_default();
    let key: Vec<String> = (0..keys.len()).map(|column| cell(column).to_owned()).collect();
    let mean = number(cell(keys.len()), "mean", line)?;
    let std = number(cell(keys.len() + 1), "std", line)?;
    if let Some(std) = std.as_ref().filter(|std| std.value < 0.0) {
        return Err(format!("line {line}: `std` is {}, expected at least 0", std.text));
    }
    Ok(Row { key, mean, std, line })
}

fn number(text: &str, column: &str, line: u64) -> Result<Option<Published>, String> {
    if text.is_empty() {
        return Ok(None);
    }
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(Some(Published { text: text.to_owned(), value })),
        _ => Err(format!("line {line}: `{column}` is `{text}`, expected a number or an empty cell")),
    }
}

/// `expert=clipped, method=bc`.
pub(crate) fn describe(keys: &[&str], values: &[String]) -> String {
    let pairs: Vec<String> = keys.iter().zip(values).map(|(key, value)| format!("{key}={value}")).collect();
    pairs.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_found_by_key_whatever_the_order_of_the_columns() {
        let text = "std,note,policy,mean,expert\n113, x ,gaussian , 125.0,clipped\n,,beta,163,clipped\n";
        let reference = Reference::parse(text.as_bytes(), &["expert", "policy"]).unwrap();
        let row = reference.get(&["clipped".into(), "gaussian".into()]).unwrap();
        assert_eq!(row.mean, Some(Published { text: "125.0".into(), value: 125.0 }));
        assert_eq!(reference.get(&["clipped".into(), "beta".into()]).unwrap().std, None);
        assert_eq!(reference.get(&["beta".into(), "clipped".into()]), None);
    }

    #[test]
    fn the_published_values_that_come_with_the_program_can_be_read() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../pipelines/reference");
        for (file, keys, rows) in [
            ("table22.csv", &["expert", "method", "mode", "policy", "demonstrations"][..], 48),
            ("table23.csv", &["algorithm", "source"], 7),
            ("annex_agents.csv", &["environment", "policy", "mode"], 8),
            ("annex_table3.csv", &["algorithm", "source"], 8),
        ] {
            assert_eq!(Reference::read(&folder.join(file), keys).unwrap().rows.len(), rows, "{file}");
        }
    }

    #[test]
    fn a_file_without_standard_deviations_is_read() {
        let reference = Reference::parse(b"note,mean,key\nof five seeds,225.7,a\n", &["key"]).unwrap();
        let row = reference.get(&["a".into()]).unwrap();
        assert_eq!(row.mean.as_ref().map(|mean| mean.text.as_str()), Some("225.7"));
        assert_eq!(row.std, None);
    }

    #[test]
    fn a_broken_file_is_refused_with_what_was_seen_and_where() {
        for (text, part) in [
            ("", "has no column `key`, `mean`: its columns are none"),
            (
                "kay,mean,std\na,1,2\n",
                "has no column `key`: its columns are `kay`, `mean`, `std`, expected `key`, `mean`",
            ),
            ("key,mean,std,std\na,1,2,3\n", "has column `std` more than once"),
            ("key,mean,std\n", "has no row under its header"),
            ("key,mean,std\na,1,2\nb,3\n", "not a CSV file"),
            ("key,mean,std\na,1,2\nb,one,2\n", "line 3: `mean` is `one`, expected a number"),
            ("key,mean,std\na,inf,2\n", "line 2: `mean` is `inf`"),
            ("key,mean,std\na,1,-2\n", "line 2: `std` is -2, expected at least 0"),
            ("key,mean,std\na,1,2\nb,1,2\na,3,4\n", "lines 2 and 4 both give key=a"),
        ] {
            let message = Reference::parse(text.as_bytes(), &["key"]).unwrap_err();
            assert!(message.contains(part), "{text:?}: {message}");
        }
    }

    #[test]
    fn lines_are_counted_as_an_editor_counts_them() {
        for text in [
            "key,mean,std\na,1,2\n\nb,one,2\n",
            "key,mean,std\r\na,1,2\r\n\r\nb,one,2\r\n",
            "key,mean,std\ra,1,2\r\rb,one,2\r",
            "\u{feff}key,mean,std\r\n\"a\r\n\",1,2\r\nb,one,2\r\n",
        ] {
            let message = Reference::parse(text.as_bytes(), &["key"]).unwrap_err();
            assert!(message.starts_with("line 4: `mean` is `one`"), "{text:?}: {message}");
        }
        let message = Reference::parse(b"key,mean\r\na,1\r\nb\r\n", &["key"]).unwrap_err();
        assert!(message.contains("line 3 has 1 cell, expected 2"), "{message}");
        let message = Reference::parse(b"key,mean\r\na,1\r\n\xff,2\r\n", &["key"]).unwrap_err();
        assert!(message.contains("line 3 is not UTF-8"), "{message}");
    }

    #[test]
    fn bytes_that_are_no_text_are_refused() {
        let message = Reference::parse(b"key,mean,std\n\xff\xfe,1,2\n", &["key"]).unwrap_err();
        assert!(message.contains("not a CSV file"), "{message}");
    }
}
