//! The table that a comparison ends in.

use std::fmt;

use dril_stage_api::math;

/// One line: a measure of one script, over its seeds.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// The game, as [`Report::begin`] named it.
    pub env: String,
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
    /// In the order they were measured, one game after the other.
    pub rows: Vec<Row>,
    env: String,
}

impl Report {
    /// The rows that follow are of this game.
    pub fn begin(&mut self, env: &str) {
        env.clone_into(&mut self.env);
    }

    /// Adds the errors of one measure; nothing where there are none.
    pub fn add(&mut self, script: &str, measure: &str, errors: &[f64], limit: Option<f64>) {
        let mut sorted = errors.to_vec();
        sorted.sort_by(f64::total_cmp);
        if let (Some(worst), Some(median)) = (sorted.last(), sorted.get(sorted.len() / 2)) {
            self.rows.push(Row {
                env: self.env.clone(),
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
    /// One table for each game, and whether all is well.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let widths = [|row: &Row| row.script.len(), |row: &Row| row.measure.len()]
            .map(|width| self.rows.iter().map(width).max().unwrap_or(0).max(7));
        for rows in self.rows.chunk_by(|a, b| a.env == b.env) {
            writeln!(f, "{}\n", rows[0].env)?;
            write_row(f, widths, ["script", "measure", "n", "median", "worst", "limit", "verdict"])?;
            for row in rows {
                let limit = row.limit.map_or_else(|| "-".to_owned(), figure);
                let verdict = match (row.limit, row.passed()) {
                    (None, _) => "",
                    (_, true) => "ok",
                    (_, false) => "FAILED",
                };
                let [count, median, worst] = [row.count.to_string(), figure(row.median), figure(row.worst)];
                write_row(f, widths, [&row.script, &row.measure, &count, &median, &worst, &limit, verdict])?;
            }
            writeln!(f)?;
        }
        let limits = self.rows.iter().filter(|row| row.limit.is_some()).count();
        match self.failures().count() {
            0 => writeln!(f, "all {limits} tolerances are met"),
            missed => writeln!(f, "{missed} of {limits} tolerances missed"),
        }
    }
}

fn write_row(f: &mut fmt::Formatter<'_>, [script, measure]: [usize; 2], cells: [&str; 7]) -> fmt::Result {
    let [first, second, count, median, worst, limit, verdict] = cells;
    let line = format!(
        "  {first:script$}  {second:measure$}  {count:>4}  {median:>8}  {worst:>8}  {limit:>8}  {verdict}"
    );
    writeln!(f, "{}", line.trim_end())
}

/// Three significant digits.
fn figure(value: f64) -> String {
    if value == 0.0 {
        "0".to_owned()
    } else if (1e-3..1e5).contains(&value.abs()) {
        let digits = 2 - math::log10(value.abs()).floor() as i32;
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
        assert!(text.contains("0.0200") && text.contains("FAILED"), "{text}");
        assert!(text.ends_with("\n2 of 2 tolerances missed\n"), "{text}");
    }

    #[test]
    fn every_game_has_a_table_of_its_own() {
        let mut report = Report::default();
        for env in ["one", "other"] {
            report.begin(env);
            report.add("script", "measure", &[0.5], Some(1.0));
        }
        let text = report.to_string();
        assert_eq!(text.matches("verdict").count(), 2, "{text}");
        assert!(text.starts_with("one\n") && text.contains("\n\nother\n"), "{text}");
        assert!(text.ends_with("\nall 2 tolerances are met\n"), "{text}");
    }
}
