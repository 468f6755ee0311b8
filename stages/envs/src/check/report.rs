//! The table that a comparison ends in.

use std::fmt;

/// One line: a measure of one script, over its seeds.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// What was replayed: a script's name, or `tracks`.
    pub script: String,
    /// What was measured, with its unit.
    pub measure: String,
    /// Number of recordings.
    pub count: usize,
    /// Middle error.
    pub median: f64,
    /// Largest error.
    pub worst: f64,
    /// The largest error allowed; none where the row only informs.
    pub limit: Option<f64>,
}

impl Row {
    /// False where the worst error is above the limit, or is no number.
    pub fn passed(&self) -> bool {
        self.limit.is_none_or(|limit| self.worst <= limit)
    }
}

/// All lines.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// In the order they were measured.
    pub rows: Vec<Row>,
}

impl Report {
    /// Adds the errors of one measure; nothing where there are none.
    pub fn add(&mut self, script: &str, measure: &str, errors: &[f64], limit: Option<f64>) {
        let mut sorted = errors.to_vec();
        sorted.sort_by(f64::total_cmp);
        if let (Some(worst), Some(median)) = (sorted.last(), sorted.get(sorted.len() / 2)) {
            self.rows.push(Row {
                script: script.to_owned(),
                measure: measure.to_owned(),
                count: sorted.len(),
                median: *median,
                worst: *worst,
                limit,
            });
        }
    }

    /// True where every tolerance is met.
    pub fn passed(&self) -> bool {
        self.rows.iter().all(Row::passed)
    }

    /// The lines that miss their tolerance.
    pub fn failures(&self) -> impl Iterator<Item = &Row> {
        self.rows.iter().filter(|row| !row.passed())
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let widths = [|row: &Row| row.script.len(), |row: &Row| row.measure.len()]
            .map(|width| self.rows.iter().map(width).max().unwrap_or(0).max(7));
        let [script, measure] = widths;
        writeln!(
            f,
            "{:script$}  {:measure$}  {:>4}  {:>10}  {:>10}  {:>10}  verdict",
            "script", "measure", "n", "median", "worst", "limit"
        )?;
        for row in &self.rows {
            let limit = row.limit.map_or_else(|| "-".to_owned(), figure);
            let verdict = match (row.limit, row.passed()) {
                (None, _) => "",
                (_, true) => "ok",
                (_, false) => "FAILED",
            };
            writeln!(
                f,
                "{:script$}  {:measure$}  {:>4}  {:>10}  {:>10}  {limit:>10}  {verdict}",
                row.script,
                row.measure,
                row.count,
                figure(row.median),
                figure(row.worst),
            )?;
        }
        Ok(())
    }
}

/// Three significant digits.
fn figure(value: f64) -> String {
    if value == 0.0 {
        "0".to_owned()
    } else if (1e-3..1e5).contains(&value.abs()) {
        let digits = 2 - value.abs().log10().floor() as i32;
        format!("{value:.*}", digits.max(0) as usize)
    } else {
        format!("{value:.1e}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_fails_above_its_limit_or_without_a_number() {
        let mut report = Report::default();
        report.add("full_gas", "pose at 50, m", &[0.001, 0.02, 0.003], Some(0.01));
        report.add("full_gas", "pose at 100, m", &[f64::NAN], Some(0.05));
        report.add("random", "pose at 100, m", &[7.0, 8.0], None);
        assert_eq!(report.rows[0].median, 0.003);
        assert_eq!(report.failures().count(), 2);
        assert!(!report.passed());
        let text = report.to_string();
        assert!(text.contains("0.0200") && text.contains("FAILED") && text.lines().count() == 4, "{text}");
    }
}
