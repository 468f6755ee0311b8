//! The kind `figure`: which files it takes, what it draws, and that equal inputs give equal bytes.

use std::path::PathBuf;

use dril_report::Figure;
use dril_stage_api::testing::Bench;
use serde_json::{Value, json};

use crate::fakes::{self, output};

/// Numbers that look like training scores, the same on every machine.
fn noise(n: u64) -> f64 {
    let mixed = (n + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40;
    f64::from(u32::try_from(mixed).unwrap()) / f64::from(1 << 24)
}

fn episodes(bench: &Bench, name: &str, count: u64) -> PathBuf {
    let path = bench.folder().join(format!("{name}.csv"));
    let row = |n: u64| {
        let score = -300.0 + 500.0 * (n as f64 / count as f64).sqrt() + 200.0 * (noise(n) - 0.5);
        format!("{n},{},{:.3},{:.4}\n", 200 * n, score, 0.02 * noise(n + count))
    };
    let rows: String = (0..count).map(row).collect();
    std::fs::write(&path, format!("episode,step,score,u_signal\n{rows}")).unwrap();
    path
}

pub(crate) fn drawn(params: &Value, counts: &[u64]) -> (String, String) {
    let mut bench = Bench::new::<Figure>(params, 0).unwrap();
    for (n, count) in counts.iter().enumerate() {
        let policy = if n % 2 == 0 { "gaussian" } else { "beta" };
        let path = episodes(&bench, &format!("data{n}"), *count);
        bench = bench.input("data", &path, &[("policy", policy), ("seed", &n.to_string())]);
    }
    bench.run().unwrap();
    (output(&bench, "svg"), output(&bench, "csv"))
}

/// The data of all paths with this text among their attributes.
pub(crate) fn paths<'s>(svg: &'s str, with: &str) -> Vec<&'s str> {
    let lines = svg.lines().filter(|line| line.starts_with("<path") && line.contains(with));
    lines.map(|line| line.split(" d=\"").nth(1).unwrap()).collect()
}

/// All corners of a path's data, as places on the canvas.
pub(crate) fn corners(data: &str) -> Vec<(f64, f64)> {
    let data = data.split('"').next().unwrap();
    let (mut at, mut start, mut corners) = ((0.0, 0.0), (0.0, 0.0), Vec::new());
    for piece in data.split('m').skip(1) {
        let spaced = piece.replace("h0", "").replace('z', "").replace('-', " -");
        let numbers: Vec<f64> = spaced.split_whitespace().map(|number| number.parse().unwrap()).collect();
        assert!(numbers.len().is_multiple_of(2), "{piece}");
        for (n, step) in numbers.chunks(2).enumerate() {
            at = (at.0 + step[0], at.1 + step[1]);
            start = if n == 0 { at } else { start };
            corners.push(at);
        }
        at = if piece.ends_with('z') { start } else { at };
    }
    corners
}

/// Every shape lies on the canvas, every element is closed, and no text leaves its element.
pub(crate) fn well_formed(svg: &str) {
    let size = svg.split("viewBox=\"0 0 ").nth(1).unwrap().split('"').next().unwrap();
    let size: Vec<f64> = size.split(' ').map(|number| number.parse().unwrap()).collect();
    for (x, y) in paths(svg, "").into_iter().flat_map(corners) {
        assert!(
            (-0.1..=size[0] + 0.1).contains(&x) && (-0.1..=size[1] + 0.1).contains(&y),
            "{x} {y} {size:?}"
        );
    }
    // Every element is closed, in order; attributes hold no bare brackets or ampersands.
    let mut open = Vec::new();
    for tag in svg.split('<').skip(1) {
        let (tag, text) = tag.split_once('>').unwrap();
        assert!(
            !text
                .replace("&amp;", "")
                .replace("&lt;", "")
                .replace("&gt;", "")
                .replace("&quot;", "")
                .contains('&')
        );
        let name = tag.split([' ', '/']).find(|part| !part.is_empty()).unwrap();
        if tag.starts_with('/') {
            assert_eq!(open.pop(), Some(name));
        } else if !tag.ends_with('/') {
            open.push(name);
        }
    }
    assert!(open.is_empty(), "{open:?}");
}

#[test]
fn thousands_of_points_are_one_path_and_text_is_text() {
    let params = json!({
        "title": "Scores & <more>", "preset": "episodes", "colour": ["policy"],
        "rules": [{ "y": 200, "label": "solved" }],
    });
    let (svg, csv) = drawn(&params, &[3000, 3000]);
    well_formed(&svg);
    assert!(svg.len() < 160_000, "{} bytes", svg.len());
    let dots = paths(&svg, "stroke-linecap=\"round\"");
    // The second series has squares; the legend has one mark of each.
    assert!(dots.iter().any(|data| data.matches("h0").count() == 3000), "{}", dots.len());
    for part in [
        "viewBox=\"0 0 760 ",
        "role=\"img\"",
        "<title>Scores &amp; &lt;more&gt;</title>",
        "<desc>score over episode",
    ] {
        assert!(svg.contains(part), "{part}");
    }
    for text in ["solved", "gaussian", "beta", "policy:", "mean of the last 100 rows"] {
        assert!(svg.lines().any(|line| line.starts_with("<text") && line.contains(text)), "{text}");
    }
    assert!(
        !svg.contains("http://") || svg.matches("http").count() == 1,
        "only the name space is an address"
    );
    assert_eq!(csv.lines().filter(|line| line.contains(",points,")).count(), 6000);
}

#[test]
fn equal_inputs_give_equal_bytes_and_the_order_of_series_is_that_of_the_input() {
    let params = json!({ "title": "T", "preset": "episodes", "colour": ["policy"], "columns": ["seed"] });
    let first = drawn(&params, &[50, 60, 70]);
    assert_eq!(first, drawn(&params, &[50, 60, 70]));
    let (gaussian, beta) = (first.0.find(">gaussian<").unwrap(), first.0.find(">beta<").unwrap());
    assert!(gaussian < beta);
}

#[test]
fn more_points_than_can_be_seen_are_thinned_and_the_csv_is_whole() {
    let params = json!({ "title": "T", "preset": "episodes" });
    let (svg, csv) = drawn(&params, &[100_000]);
    assert!(svg.len() < 200_000, "{} bytes", svg.len());
    assert!(svg.contains("thinned to 10000 a series (the CSV has all 100000)"));
    assert_eq!(csv.lines().filter(|line| line.contains("points,")).count(), 100_000);
}

#[test]
fn what_is_taken_together_is_a_mean_and_a_band_that_is_named() {
    let params = json!({
        "title": "T", "x": "episode", "y": ["score"], "pool": ["seed"], "colour": ["policy"],
        "layers": { "line": {}, "band": { "of": "min-max" } },
    });
    let (svg, csv) = drawn(&params, &[40, 40, 40, 40]);
    assert!(
        svg.contains(
            "Line: mean over 2 values of seed; band: lowest to highest value over 2 values of seed."
        )
    );
    assert_eq!(csv.lines().filter(|line| line.contains(",line,")).count(), 80);
    assert_eq!(csv.lines().filter(|line| line.contains(",band,")).count(), 80);
}

#[test]
fn measures_have_panels_of_their_own() {
    let params = json!({
        "title": "T", "x": "episode", "y": ["score", "u_signal"], "rows": ["measure"], "columns": ["policy"],
        "layers": { "line": { "smooth": 10 } },
    });
    let (svg, csv) = drawn(&params, &[30, 30]);
    for heading in ["gaussian", "beta", "score", "u_signal"] {
        assert_eq!(svg.matches(&format!(">{heading}<")).count(), 1, "{heading}");
    }
    assert!(csv.starts_with("measure,policy,layer,strand,x,y,low,high,n\nscore,gaussian,line,"));
}

#[test]
fn intervals_stand_beside_published_values() {
    let params = json!({
        "title": "T", "preset": "interval", "pool": ["seed"], "colour": ["mode"],
        "categories": ["expert", "method", "policy", "demonstrations"],
    });
    let mut bench = Bench::new::<Figure>(&params, 0).unwrap();
    for (n, labels) in fakes::matrix().iter().enumerate() {
        let (mean, std) = fakes::reported(labels);
        let path = fakes::scores(&bench, &n.to_string(), &fakes::spread(mean + 20.0, std));
        bench = bench.input("data", &path, labels);
    }
    let bench = bench.input("reference", &fakes::reference("table22.csv"), &[]);
    bench.run().unwrap();
    let (svg, csv) = (output(&bench, "svg"), output(&bench, "csv"));
    well_formed(&svg);
    assert!(svg.contains("hollow diamond: published value") && svg.contains("one training"), "{svg}");
    assert_eq!(csv.lines().filter(|line| line.contains(",interval,")).count(), 48);
    assert_eq!(csv.lines().filter(|line| line.contains(",published,")).count(), 48);
    // 125 ± 113 over 100 episodes: the half width is 1.984 × 113 / √99.
    assert!(csv.contains("deterministic,clipped,bc,gaussian,1,interval,,145.0000,,122.46"), "{csv}");
}

#[test]
fn distributions_losses_and_traces_are_drawn() {
    for (params, part) in [
        (
            json!({ "title": "T", "preset": "distribution", "rules": [{ "x": 0, "label": "zero" }] }),
            ">count<",
        ),
        (json!({ "title": "T", "y": ["score"], "layers": { "ecdf": {} } }), ">share<"),
        (
            json!({ "title": "T", "x": "step", "y": ["u_signal"], "layers": { "line": {} }, "scale": { "y": "log" } }),
            ">u_signal<",
        ),
        (
            json!({ "title": "T", "preset": "trace", "y": ["score", "u_signal"], "range": { "x": [0, 2000] } }),
            ">step<",
        ),
        (
            json!({ "title": "T", "x": "episode", "y": ["score"], "layers": { "area": {}, "mean": {} } }),
            ">score<",
        ),
    ] {
        let (svg, _) = drawn(&params, &[300]);
        well_formed(&svg);
        assert!(svg.contains(part), "{params}: {svg}");
        // No coordinate lies outside the canvas by more than its margins.
        assert!(paths(&svg, "").len() > 3, "{params}");
    }
}

#[test]
fn what_cannot_be_drawn_is_refused_with_what_was_seen() {
    let run = |params: Value, text: &str| {
        let bench = Bench::new::<Figure>(&params, 0).unwrap();
        let path = bench.folder().join("data.csv");
        std::fs::write(&path, text).unwrap();
        bench.input("data", &path, &[("policy", "beta")]).run().unwrap_err().to_string()
    };
    let params = json!({ "title": "T", "preset": "scores" });
    let message = run(params.clone(), "episode,points\n1,2\n");
    assert!(message.contains("has no column `score`; its columns are `episode`, `points`"), "{message}");
    let message = run(params.clone(), "episode,score\n1,two\n");
    assert!(message.contains("line 2: `score` is `two`, expected a number"), "{message}");
    let message = run(params.clone(), "episode,score\r\n1,2\r\n\r\n2,two\r\n");
    assert!(message.contains("line 4: `score` is `two`, expected a number"), "{message}");
    let message = run(params.clone(), "episode,score\r\n1,2\r\n2\r\n");
    assert!(message.contains("not a CSV file: line 3 has 1 cell, expected 2"), "{message}");
    let message = run(params, "episode,score\n1,\n");
    assert!(message.contains("no file of input `data` has a row to draw"), "{message}");
    let message =
        run(json!({ "title": "T", "preset": "scores", "colour": ["seed"] }), "episode,score\n1,2\n");
    assert!(message.contains("has neither a label nor a column `seed`"), "{message}");
    for (params, part) in [
        (json!({ "title": "", "preset": "scores" }), "`title` is empty"),
        (json!({ "title": "T" }), "`y` has no column"),
        (
            json!({ "title": "T", "y": ["a"], "layers": { "points": {}, "histogram": {} } }),
            "axes of their own",
        ),
        (json!({ "title": "T", "preset": "scores", "rules": [{}] }), "one of `x` and `y`"),
        (
            json!({ "title": "T", "preset": "scores", "rows": ["a"], "colour": ["a"] }),
            "`a` is in `rows` already",
        ),
    ] {
        let message = Bench::new::<Figure>(&params, 0).err().unwrap().to_string();
        assert!(message.contains(part), "{params}: {message}");
    }
}

#[test]
fn a_mark_stands_across_the_histogram_of_its_measure_and_widens_the_axis() {
    let params = json!({
        "title": "t", "layers": { "histogram": { "bins": 4 } },
        "y": [{ "title": "steering", "columns": ["action_0"], "mark": { "column": "expert_0", "label": "expert" } }]
    });
    let bench = Bench::new::<Figure>(&params, 0).unwrap();
    let path = bench.folder().join("draws.csv");
    std::fs::write(&path, "action_0,expert_0\n0.1,0.9\n0.2,0.9\n0.4,0.9\n").unwrap();
    let bench = bench.input("data", &path, &[]);
    bench.run().unwrap();
    let (svg, csv) = (output(&bench, "svg"), output(&bench, "csv"));
    assert!(csv.contains("\nsteering,mark,expert,0.9,,,,\n") || csv.contains("mark,expert,0.9,"), "{csv}");
    assert!(svg.contains(">expert</text>"), "{svg}");
    let line = paths(&svg, "#b00020");
    let places: Vec<f64> = line.iter().flat_map(|data| corners(data)).map(|(x, _)| x).collect();
    let bars: Vec<f64> =
        paths(&svg, "#0072b2").iter().flat_map(|data| corners(data)).map(|(x, _)| x).collect();
    let rightmost = bars.iter().copied().fold(0.0, f64::max);
    assert!(places.iter().all(|x| *x > rightmost), "{places:?} {rightmost}");
}

#[test]
fn a_mark_needs_a_distribution_and_a_rule_names_measures_that_there_are() {
    let params = json!({
        "title": "t", "preset": "trace", "y": [{ "title": "a", "columns": ["a"], "mark": { "column": "b", "label": "b" } }],
        "rules": [{ "y": 1, "measures": ["c"] }]
    });
    let problems = dril_stage_api::Kind::of::<Figure>().normalize(&params).unwrap_err();
    let mut paths: Vec<String> = problems.iter().map(|problem| problem.path.join(".")).collect();
    paths.sort();
    assert_eq!(paths, ["rules.0.measures", "y.0.mark"]);
}

#[test]
fn a_rule_is_drawn_in_the_panels_of_its_measures_only() {
    let params = |measures: Value| {
        let rule = json!({ "y": 0.5, "label": "limit", "measures": measures });
        json!({ "title": "t", "preset": "trace", "x": "episode", "y": ["score", "u_signal"], "rules": [rule] })
    };
    let labels = |measures: Value| drawn(&params(measures), &[30]).0.matches(">limit</text>").count();
    assert_eq!((labels(json!([])), labels(json!(["score"]))), (2, 1));
}

#[test]
fn a_region_is_grey_and_lies_behind_the_data() {
    let rules = json!([{ "y": [-100, 100], "label": "valid" }]);
    let params =
        json!({ "title": "t", "x": "episode", "y": ["score"], "layers": { "points": {} }, "rules": rules });
    let (svg, _) = drawn(&params, &[30]);
    let at = |text: &str| svg.find(text).unwrap_or_else(|| panic!("{text}: {svg}"));
    assert!(at("fill-opacity=\"0.18\"") < at("#0072b2"), "{svg}");
    assert!(at("#0072b2") < at(">valid</text>"), "the label is readable over the data");
}

#[test]
fn a_figure_of_a_file_without_profiles_says_nothing_of_reduced_sizes() {
    let svg = |profile: &str, full: Option<&str>| {
        let with = json!({ "title": "T", "preset": "episodes", "profile": profile, "full_profile": full });
        drawn(&with, &[40]).0
    };
    assert!(!svg("default", None).contains("sizes are reduced"));
    assert!(svg("default", Some("full")).contains("Profile default: sizes are reduced"));
    assert!(svg("smoke", None).contains("not those of profile full"));
}
