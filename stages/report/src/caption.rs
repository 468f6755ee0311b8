//! The text around a Markdown table: title, profile, and the meaning of its numbers.

use dril_stage_api::Problems;

use crate::markdown::{escape, one_line};

/// The profile that is taken for the full experiment unless the pipeline file names another.
const FULL: &str = "full";

/// What the engine calls the only profile of a file without `profiles`. Its sizes are those of the experiment.
const ONLY: &str = "default";

/// The full profile, where results of `profile` are not comparable with its results; `None` where they are.
pub(crate) fn reduced_from<'a>(profile: &str, full_profile: Option<&'a str>) -> Option<&'a str> {
    let full = full_profile.unwrap_or(FULL);
    let is_full = profile == full || (full_profile.is_none() && profile == ONLY);
    (!is_full).then_some(full)
}

/// The most decimals of a table's numbers. The CSV has two more: eight, of the about sixteen digits of an `f64`.
const MOST_DECIMALS: u8 = 6;

/// Reports a number of decimals that no table has.
pub(crate) fn check_decimals(decimals: u8, problems: &mut Problems) {
    problems.range("decimals", decimals, ..=MOST_DECIMALS, &format!("0 to {MOST_DECIMALS}"));
}

/// True for the default of `decimals`, which is left out where a stage had its results before the parameter existed.
pub(crate) fn is_default(decimals: &u8) -> bool {
    *decimals == 0
}

/// What the published numbers are called unless the pipeline file says whose they are.
pub(crate) fn reference_name() -> String {
    "reference".to_owned()
}

/// Reports a name of the published numbers that cannot stand in a cell.
pub(crate) fn check_reference_name(name: &str, problems: &mut Problems) {
    if name.trim().is_empty() || name.contains(char::is_control) {
        let message = format!("`reference_name` is {name:?}, expected a name on one line, as `thesis`");
        problems.add("reference_name", message);
    } else if name == OURS {
        problems
            .add("reference_name", format!("`reference_name` is `{OURS}`, which names this run's own rows"));
    }
}

/// The source of what this run computed.
pub(crate) const OURS: &str = "this run";

/// The parameters that every table has.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Caption<'a> {
    pub(crate) title: &'a str,
    pub(crate) profile: &'a str,
    pub(crate) full_profile: Option<&'a str>,
    pub(crate) note: &'a str,
}

impl Caption<'_> {
    /// Reports texts that cannot stand where they are printed.
    pub(crate) fn check(&self, problems: &mut Problems) {
        if one_line(self.title).is_empty() {
            problems.add("title", "`title` is empty, expected the table's title");
        }
        let names = [("profile", Some(self.profile)), ("full_profile", self.full_profile)];
        for (field, value) in names.into_iter().filter_map(|(field, value)| Some((field, value?))) {
            if value.trim().is_empty() || value.contains(|c: char| c.is_control() || c == '`') {
                let message = "expected a profile's name, without line breaks and backticks";
                problems.add(field, format!("`{field}` is {value:?}, {message}"));
            }
        }
    }

    /// The whole page: title, a warning where the sizes are reduced, `lead` (what holds for the whole table), the
    /// table, and `remarks` (what its numbers are) as a list.
    pub(crate) fn page(&self, lead: &[String], table: &str, remarks: &[String]) -> String {
        let mut blocks = vec![format!("# {}", escape(self.title))];
        if let Some(full) = reduced_from(self.profile, self.full_profile) {
            blocks.push(format!(
                "> made at profile `{}`: sizes are reduced, scores are not comparable with those at profile `{full}`",
                self.profile
            ));
        }
        blocks.extend(lead.iter().cloned());
        blocks.push(table.trim_end().to_owned());
        let mut list: Vec<String> = remarks.iter().map(|remark| format!("- {remark}")).collect();
        list.push(format!("- profile: `{}`", self.profile));
        blocks.push(list.join("\n"));
        if !self.note.trim().is_empty() {
            blocks.push(escape(self.note));
        }
        blocks.join("\n\n") + "\n"
    }
}

/// Which results are of agents whose training diverged; `None` without any.
pub(crate) fn divergence(diverged: &[String]) -> Option<String> {
    let names: Vec<String> = diverged.iter().map(|name| escape(name)).collect();
    (!names.is_empty()).then(|| {
        format!("**training diverged**, and the last finite weights were evaluated: {}", names.join("; "))
    })
}

/// What a cell's `mean ± std` is, for cells of so many episodes.
pub(crate) fn statistic(episodes: impl IntoIterator<Item = usize>) -> String {
    let mut range: Option<(usize, usize)> = None;
    for n in episodes {
        range = Some(range.map_or((n, n), |(low, high)| (low.min(n), high.max(n))));
    }
    let episodes = match range {
        None => "its episodes".to_owned(),
        Some((1, 1)) => "1 episode each".to_owned(),
        Some((low, high)) if low == high => format!("{low} episodes each"),
        Some((low, high)) => format!("{low} to {high} episodes each"),
    };
    format!("this run: mean ± population standard deviation (ddof 0) over {episodes}")
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAPTION: Caption<'_> =
        Caption { title: "T", profile: "smoke", full_profile: None, note: "a *note*\nof two lines\n" };

    #[test]
    fn only_a_reduced_profile_is_warned_about_and_both_are_named() {
        let smoke = CAPTION.page(&[], "| t |\n", &[]);
        assert!(smoke.contains("> made at profile `smoke`: sizes are reduced, scores are not comparable"));
        assert!(smoke.contains("\n- profile: `smoke`\n"));
        assert!(smoke.contains("not comparable with those at profile `full`"), "{smoke}");
        let full = Caption { profile: "full", ..CAPTION }.page(&[], "| t |\n", &[]);
        assert!(!full.contains("comparable") && full.contains("\n- profile: `full`\n"), "{full}");
    }

    #[test]
    fn the_profile_of_a_file_without_profiles_is_full_unless_the_file_says_otherwise() {
        assert_eq!(reduced_from("default", None), None);
        assert_eq!(reduced_from("default", Some("full")), Some("full"));
        assert_eq!(reduced_from("full", None), None);
        assert_eq!(reduced_from("smoke", None), Some("full"));
        assert_eq!(reduced_from("full", Some("thesis")), Some("thesis"));
        assert_eq!(reduced_from("thesis", Some("thesis")), None);
    }

    #[test]
    fn a_note_stands_under_the_table_as_one_paragraph() {
        assert!(CAPTION.page(&[], "| t |\n", &[]).ends_with("\n\na \\*note\\* of two lines\n"));
    }

    #[test]
    fn an_empty_title_and_a_profile_that_is_no_name_are_refused() {
        let mut problems = Problems::default();
        Caption { title: " \n", profile: "", full_profile: Some("a`b"), note: "" }.check(&mut problems);
        let paths: Vec<String> = problems.into_vec().iter().map(|p| p.path.join(".")).collect();
        assert_eq!(paths, ["title", "profile", "full_profile"]);
    }

    #[test]
    fn the_number_of_episodes_is_a_range_where_cells_differ() {
        assert!(statistic([100, 100]).ends_with("over 100 episodes each"));
        assert!(statistic([3, 1, 2]).ends_with("over 1 to 3 episodes each"));
        assert!(statistic([1]).ends_with("over 1 episode each"));
    }
}
