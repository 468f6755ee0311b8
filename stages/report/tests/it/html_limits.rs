//! The page leaves nothing out without saying so, and stays below its size.

use dril_report::Figure;
use dril_report::html::page;
use dril_stage_api::Artifact;
use serde_json::json;

use crate::lab::{Lab, losses, scores};

/// The size that docs/report.md promises.
const MOST_BYTES: usize = 2_000_000;

/// The part of a page between a section's heading and its end.
fn section<'p>(page: &'p str, anchor: &str) -> &'p str {
    let rest = page.split(&format!("id=\"{anchor}\"")).nth(1).unwrap();
    rest.split("</section>").next().unwrap()
}

/// A CSV file of 100 rows and this many columns.
fn wide(columns: usize) -> Vec<u8> {
    let header: Vec<String> = (0..columns).map(|n| format!("c{n}")).collect();
    let mut text = header.join(",") + "\n";
    for row in 0..100 {
        let cells: Vec<String> = (0..columns).map(|n| format!("{}.25", row * 1000 + n)).collect();
        text += &(cells.join(",") + "\n");
    }
    text.into_bytes()
}

#[test]
fn instances_that_a_figure_does_not_draw_have_a_default_figure() {
    let mut lab = Lab::new("thesis");
    let all: Vec<(usize, &str)> = ["k0", "k1", "k2", "k3"]
        .into_iter()
        .enumerate()
        .map(|(n, k)| {
            let bytes = scores(100.0, 50.0, n, 40);
            (
                lab.stage("sc", "evaluate", &[("k", k)], &[("scores", Artifact::SCORES, "csv", &bytes)]),
                "scores",
            )
        })
        .collect();
    let params = json!({ "title": "Two of four", "preset": "scores", "columns": ["k"] });
    lab.run::<Figure>("some", "figure", &params, "data", &all[..2], None);
    let text = lab.page("some-instances");
    let curves = section(&text, "curves");
    assert!(curves.contains("<code>sc.scores</code>") && curves.contains("2 files"), "{curves}");
    assert!(curves.contains("k2") && curves.contains("k3") && !curves.contains("k1"), "{curves}");
    let mut drawn = Lab::new("thesis");
    let bytes = scores(100.0, 50.0, 0, 40);
    let at = drawn.stage("sc", "evaluate", &[("k", "k0")], &[("scores", Artifact::SCORES, "csv", &bytes)]);
    drawn.run::<Figure>("all", "figure", &params, "data", &[(at, "scores")], None);
    assert!(!drawn.page("all-instances").contains("id=\"curves\""), "nothing is drawn twice");
}

#[test]
fn a_default_figure_of_many_files_says_how_many_it_draws() {
    let mut lab = Lab::new("thesis");
    for n in 0..120 {
        let bytes = scores(100.0, 50.0, n, 5);
        let output = [("scores", Artifact::SCORES, "csv", bytes.as_slice())];
        lab.stage("sc", "evaluate", &[("seed", &n.to_string())], &output);
    }
    let text = lab.page("many-files");
    assert!(section(&text, "curves").contains("the first 100 of 120 files"));
}

#[test]
fn a_default_figure_that_cannot_be_drawn_or_does_not_fit_is_named() {
    let mut lab = Lab::new("thesis");
    lab.stage("words", "command", &[], &[("log", Artifact::TRAINING_LOG, "csv", b"word\nfox\n")]);
    // Many curves of hundreds of points each: a figure of megabytes.
    for stage in ["a", "b", "c"] {
        for n in 0..100 {
            let axes = [("x", n / 10), ("y", n % 10)].map(|(axis, value)| (axis, value.to_string()));
            let labels: Vec<(&str, &str)> =
                axes.iter().map(|(axis, value)| (*axis, value.as_str())).collect();
            lab.stage(stage, "ensemble", &labels, &[("log", Artifact::TRAINING_LOG, "csv", &losses(n))]);
        }
    }
    let text = lab.page("no-figures");
    let curves = section(&text, "curves");
    assert!(curves.contains("No default figure can be drawn of <code>words.log</code>"), "{}", curves.len());
    assert!(
        curves.contains("too large for this page") && curves.contains("<code>c.log</code>"),
        "{}",
        curves.len()
    );
    assert!(text.len() < MOST_BYTES, "{}", text.len());
}

#[test]
fn a_wide_table_is_cut_and_the_page_stays_small() {
    let mut lab = Lab::new("thesis");
    for n in 1500..1504 {
        lab.stage(&format!("wide{n}"), "command", &[], &[("t", Artifact::TABLE, "csv", &wide(n))]);
    }
    let text = lab.page("wide");
    assert!(text.len() < MOST_BYTES, "{}", text.len());
    assert!(section(&text, "results").contains("more rows; the file has all of them"));
    let others = section(&text, "tables");
    assert_eq!(others.matches("more rows; the file has all of them").count(), 3);
    assert!(!text.contains("There is nothing to show here"));
}

#[test]
fn a_table_that_does_not_fit_is_a_link_and_not_an_empty_table() {
    let mut lab = Lab::new("thesis");
    lab.stage("huge", "command", &[], &[("t", Artifact::TABLE, "csv", &wide(40_000))]);
    lab.stage("vast", "command", &[], &[("t", Artifact::TABLE, "csv", &wide(30_000))]);
    lab.stage("empty", "command", &[], &[("t", Artifact::TABLE, "csv", b"a,b\n")]);
    let text = lab.page("huge");
    assert!(text.len() < MOST_BYTES, "{}", text.len());
    let (first, others) = (section(&text, "results"), section(&text, "tables"));
    assert!(first.contains("Too large for this page") && first.contains("href=\"./huge.csv\""), "{first}");
    assert!(others.contains("Too large for this page") && others.contains("href=\"./vast.csv\""), "{others}");
    assert_eq!(text.matches("There is nothing to show here").count(), 1, "{others}");
}

#[test]
fn a_figure_of_a_format_that_pages_cannot_show_is_not_called_too_large() {
    let mut lab = Lab::new("thesis");
    lab.stage("plot", "command", &[], &[("figure", Artifact::FIGURE, "pdf", b"%PDF-1.7")]);
    let text = lab.page("pdf");
    let figures = section(&text, "figures");
    assert!(
        !figures.contains("Too large") && figures.contains("A page cannot show this format"),
        "{figures}"
    );
}

#[test]
fn the_provenance_of_very_many_stages_is_cut_and_says_so() {
    let mut lab = Lab::new("thesis");
    for n in 0..3000 {
        let at = lab.stage(&format!("stage-{n}"), "command", &[], &[]);
        lab.outcome.stages[at].chosen = [("shell".to_owned(), json!("x".repeat(100)))].into();
    }
    let text = page(&lab.outcome, None).unwrap();
    assert!(text.len() < MOST_BYTES, "{}", text.len());
    let provenance = section(&text, "provenance");
    assert!(provenance.contains("stage-0") && provenance.contains("more stages"), "{}", provenance.len());
}
