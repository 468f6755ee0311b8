//! The kind `figure` at its limits: values outside of the axes, single rows, many colours, and files that are no trainings
//! of one cell.

use dril_report::Figure;
use dril_stage_api::testing::Bench;
use serde_json::{Value, json};

use crate::fakes::output;
use crate::figure::{corners, paths, well_formed};

/// A file's text with its labels.
type File<'f> = (String, &'f [(&'f str, &'f str)]);

fn bench(params: &Value, files: &[File<'_>]) -> Bench {
    let mut bench = Bench::new::<Figure>(params, 0).unwrap();
    for (n, (text, labels)) in files.iter().enumerate() {
        let path = bench.folder().join(format!("{n}.csv"));
        std::fs::write(&path, text).unwrap();
        bench = bench.input("data", &path, labels);
    }
    bench
}

/// The SVG and the CSV.
fn draw(params: &Value, files: &[File<'_>]) -> (String, String) {
    let bench = bench(params, files);
    bench.run().unwrap();
    let svg = output(&bench, "svg");
    well_formed(&svg);
    (svg, output(&bench, "csv"))
}

/// Rows of `step,score`.
fn rows(scores: impl IntoIterator<Item = f64>) -> String {
    let rows = scores.into_iter().enumerate().map(|(step, score)| format!("{step},{score}\n"));
    format!("step,score\n{}", rows.collect::<String>())
}

/// The corners of all that is drawn with these attributes, in tenths of a pixel.
fn places(svg: &str, with: &str) -> Vec<(i32, i32)> {
    let tenths = |value: f64| (10.0 * value).round() as i32;
    paths(svg, with).into_iter().flat_map(corners).map(|(x, y)| (tenths(x), tenths(y))).collect()
}

/// Its left, top, right and bottom.
fn extent(svg: &str, with: &str) -> [i32; 4] {
    places(svg, with).into_iter().fold([i32::MAX, i32::MAX, i32::MIN, i32::MIN], |edge, (x, y)| {
        [edge[0].min(x), edge[1].min(y), edge[2].max(x), edge[3].max(y)]
    })
}

/// Lines, bars, bands, and a rule's region, which has the size of the axes where it is as large as the range.
const LINE: &str = "stroke-width=\"1.6\"";
const BARS: &str = "fill-opacity=\"0.55\"";
const BAND: &str = "fill-opacity=\"0.22\"";
const FRAME: &str = "fill-opacity=\"0.18\"";

/// True to a tenth of a pixel, by which the drawing library's axes end before the plot does.
fn is_inside(svg: &str, with: &str) -> bool {
    let (shape, frame) = (extent(svg, with), extent(svg, FRAME));
    let lower = shape[0] >= frame[0] && shape[1] >= frame[1];
    lower && shape[2] <= frame[2] + 1 && shape[3] <= frame[3] + 1
}

/// Parameters with the vertical axis from 0 to 100.
fn zoomed(layers: Value) -> Value {
    let rule = json!({ "y": [0, 100] });
    json!({ "title": "T", "x": "step", "y": ["score"], "layers": layers, "rules": [rule], "range": { "y": [0, 100] } })
}

#[test]
fn a_line_is_cut_where_it_leaves_the_axes_and_goes_on_where_it_enters_them() {
    let zigzag = rows((0..40).map(|n| if n % 2 == 0 { 500.0 } else { 5.0 }));
    let (svg, csv) = draw(&zoomed(json!({ "line": {} })), &[(zigzag, &[])]);
    assert!(is_inside(&svg, LINE));
    let (line, frame) = (extent(&svg, LINE), extent(&svg, FRAME));
    assert_eq!(line[1], frame[1], "it reaches the upper edge");
    // Every low row has an edge on its left, and all but the last one on its right.
    assert_eq!(places(&svg, LINE).iter().filter(|(_, y)| *y == frame[1]).count(), 39);
    assert!(svg.contains("20 points of the lines lie outside the axes"), "{svg}");
    assert_eq!(csv.lines().count(), 41, "the CSV has them all");
}

#[test]
fn a_zoom_between_two_rows_shows_the_line_that_connects_them() {
    let mut params = zoomed(json!({ "line": {} }));
    params["range"]["x"] = json!([0.25, 0.75]);
    let (svg, _) = draw(&params, &[(rows([0.0, 100.0]), &[])]);
    let (line, frame) = (extent(&svg, LINE), extent(&svg, FRAME));
    assert!(is_inside(&svg, LINE) && line[0] == frame[0] && line[2] >= frame[2], "{line:?} {frame:?}");
    let quarter = f64::from(frame[1]) + 0.25 * f64::from(frame[3] - frame[1]);
    assert!((f64::from(line[1]) - quarter).abs() <= 2.0, "{line:?} {frame:?}");
}

#[test]
fn bars_bands_and_means_stay_inside_the_axes_and_the_note_counts_what_does_not() {
    let (svg, _) = draw(
        &json!({
            "title": "T", "y": ["score"], "layers": { "histogram": { "bins": 2 } },
            "range": { "y": [0, 10] }, "rules": [{ "y": [0, 10] }],
        }),
        &[(rows((0..60).map(|n| if n < 50 { 0.0 } else { 1.0 })), &[])],
    );
    assert!(is_inside(&svg, BARS), "{svg}");
    assert!(svg.contains("1 bar reaches beyond the axes"), "{svg}");

    let (svg, _) = draw(&zoomed(json!({ "mean": {} })), &[(rows([500.0, 510.0]), &[])]);
    assert!(paths(&svg, LINE).is_empty(), "{svg}");
    assert!(svg.contains("1 mean lies outside the axes"), "{svg}");

    let mut params = zoomed(json!({ "band": {} }));
    params["pool"] = json!(["seed"]);
    let files: [File<'_>; 2] =
        [(rows([0.0, 0.0]), &[("seed", "1")]), (rows([50.0, 150.0]), &[("seed", "2")])];
    let (svg, _) = draw(&params, &files);
    // Its upper edge crosses 100 half way between the two rows, so it is not cut at one of them.
    let (band, top) = (extent(&svg, BAND), extent(&svg, FRAME)[1]);
    let leaves = places(&svg, BAND).into_iter().filter(|(_, y)| *y == top).map(|(x, _)| x).min();
    assert!((leaves.unwrap() - (band[0] + band[2]) / 2).abs() <= 2, "{leaves:?} {band:?}");
    assert!(svg.contains("1 point of the bands lies outside the axes"), "{svg}");
}

#[test]
fn an_interval_that_crosses_the_edge_is_drawn_as_far_as_it_lies_inside() {
    let scores = |middle: f64| rows((0..40).map(|n| middle + if n % 2 == 0 { 300.0 } else { -300.0 }));
    let params = json!({
        "title": "T", "preset": "interval", "categories": ["k"],
        "range": { "x": [450, 550] }, "rules": [{ "x": [450, 550] }],
    });
    let (svg, _) = draw(&params, &[(scores(500.0), &[("k", "a")]), (scores(900.0), &[("k", "b")])]);
    let (bar, frame) = (extent(&svg, "stroke-width=\"2\""), extent(&svg, FRAME));
    assert!(is_inside(&svg, "stroke-width=\"2\"") && bar[0] == frame[0] && bar[2] >= frame[2], "{svg}");
    assert!(svg.contains("1 mean lies outside the axes"), "{svg}");
    assert!(svg.contains("2 bars reach beyond the axes"), "{svg}");
}

#[test]
fn a_line_of_one_row_is_a_dot() {
    let text = "epoch,train_loss,val_loss\n0,0.5,0.4\n".to_owned();
    let (svg, _) = draw(&json!({ "title": "T", "preset": "losses" }), &[(text, &[])]);
    let dots = |colour: &str| {
        let all = paths(&svg, colour).into_iter();
        all.filter(|data| data.contains("h0")).count()
    };
    assert_eq!((dots("#0072b2"), dots("#d55e00")), (1, 1), "{svg}");
}

#[test]
fn bars_stand_on_the_low_end_of_a_logarithmic_axis() {
    let params = json!({
        "title": "T", "y": ["score"], "layers": { "histogram": { "bins": 2 } }, "scale": { "y": "log" },
        "range": { "y": [0.5, 500] }, "rules": [{ "y": [0.5, 500] }],
    });
    let (svg, _) = draw(&params, &[(rows((0..101).map(|n| if n < 100 { 0.0 } else { 1.0 })), &[])]);
    let (bars, frame) = (extent(&svg, BARS), extent(&svg, FRAME));
    assert!(is_inside(&svg, BARS) && bars[3] >= frame[3], "{svg}");
    let tops = places(&svg, BARS).into_iter().filter(|(_, y)| *y < frame[3]);
    assert_eq!(tops.count(), 4, "two bars");

    let params = json!({ "title": "T", "preset": "distribution", "scale": { "y": "log" } });
    let (svg, _) = draw(&params, &[(rows((0..101).map(|n| if n < 100 { 0.0 } else { 1.0 })), &[])]);
    assert_eq!(places(&svg, BARS).len(), 8, "a bar of one count has a height as well");
    assert!(!svg.contains(">0.5<"), "{svg}");
}

#[test]
fn values_without_a_place_on_a_logarithmic_axis_are_counted() {
    let params = json!({ "title": "T", "x": "step", "y": ["score"], "layers": { "line": {} }, "scale": { "y": "log" } });
    let (svg, _) = draw(&params, &[(rows([1.0, 0.0, -3.0, 10.0]), &[])]);
    assert!(svg.contains("2 points of the lines at or below 0 are omitted"), "{svg}");
    let problem = |range: Value| {
        let params = json!({ "title": "T", "preset": "losses", "range": { "y": range } });
        Bench::new::<Figure>(&params, 0).err().map(|error| error.to_string())
    };
    assert!(problem(json!([0, 1])).unwrap().contains("a logarithmic axis"));
    assert_eq!(problem(json!([0.1, 1])), None);
}

#[test]
fn values_far_beyond_the_axes_are_drawn_no_farther_than_their_edges() {
    let far = rows([50.0, 1e300, -1e300, 50.0]);
    let (svg, _) = draw(&zoomed(json!({ "line": {}, "points": {} })), &[(far, &[])]);
    assert!(is_inside(&svg, LINE));
}

#[test]
fn trainings_are_files_that_differ_in_labels_of_pool_only() {
    let files: Vec<File<'_>> = vec![
        (rows([1.0]), &[("k", "1"), ("mode", "drawn"), ("seed", "1")]),
        (rows([2.0]), &[("k", "1"), ("mode", "mean"), ("seed", "2")]),
        (rows([3.0]), &[("k", "1"), ("mode", "mean"), ("seed", "3")]),
    ];
    let params =
        |pool: Value| json!({ "title": "T", "preset": "interval", "categories": ["k"], "pool": pool });
    let message = bench(&params(json!([])), &files).run().unwrap_err().to_string();
    for part in ["`mode` (drawn, mean)", "`seed` (1, 2, 3)", "k=1", "not in `pool`", "add"] {
        assert!(message.contains(part), "{part}: {message}");
    }
    let message = bench(&params(json!(["seed"])), &files).run().unwrap_err().to_string();
    assert!(message.contains("`mode`") && !message.contains("`seed`"), "{message}");
    let (svg, _) = draw(&params(json!(["seed", "mode"])), &files);
    assert!(svg.contains("over 3 trainings"), "{svg}");
}

#[test]
fn a_label_that_some_files_lack_makes_categories_of_their_own() {
    let files: [File<'_>; 2] = [(rows([1.0]), &[("mode", "drawn")]), (rows([2.0]), &[])];
    let (_, csv) = draw(&json!({ "title": "T", "preset": "interval" }), &files);
    let rows: Vec<&str> = csv.lines().collect();
    assert_eq!(rows[1..], ["drawn,interval,,1.0000,,,,1", ",interval,,2.0000,,,,1"], "{csv}");
}

#[test]
fn a_band_over_a_window_covers_all_that_is_pooled() {
    let params = json!({
        "title": "T", "x": "step", "y": ["score"], "pool": ["seed"],
        "layers": { "line": { "smooth": 2 }, "band": { "window": 2 } },
    });
    let files: [File<'_>; 2] =
        [(rows([1.0, 2.0, 3.0]), &[("seed", "1")]), (rows([11.0, 12.0, 13.0]), &[("seed", "2")])];
    let (svg, csv) = draw(&params, &files);
    let band: Vec<&str> = csv.lines().filter(|line| line.starts_with("band,")).collect();
    assert_eq!(band, ["band,,0,,1,11,", "band,,1,,1,12,", "band,,2,,2,13,"]);
    assert!(svg.contains("band: lowest to highest value of the last 2 rows of 2 values of seed"), "{svg}");
}

#[test]
fn the_note_on_what_is_pooled_says_where_there_is_less() {
    let params = json!({
        "title": "T", "x": "step", "y": ["score"], "pool": ["seed"], "layers": { "line": {}, "band": {} },
    });
    let three: File<'_> = (rows([1.0, 2.0, 3.0]), &[("seed", "1")]);
    let (svg, _) = draw(&params, &[three.clone(), (rows([5.0, 6.0]), &[("seed", "2")])]);
    assert!(svg.contains("Line: mean over 1 to 2 values of seed; band:"), "{svg}");
    assert!(svg.contains("value over 2 values of seed"), "a band needs two: {svg}");
    let elsewhere = "step,score\n0.5,1\n".to_owned();
    let (svg, _) = draw(&params, &[three, (elsewhere, &[("seed", "2")])]);
    assert!(svg.contains("Line: mean over 1 value of seed, as no two share a step."), "{svg}");
}

#[test]
fn series_that_share_a_colour_differ_in_marks_and_dashes() {
    let layers = json!({ "points": {}, "line": {} });
    let params = json!({ "title": "T", "x": "step", "y": ["score"], "colour": ["k"], "layers": layers });
    let names = ["0", "1", "2", "3", "4", "5", "6", "7"];
    let labels = names.map(|name| [("k", name)]);
    let files: Vec<File<'_>> = labels.iter().map(|labels| (rows([1.0, 2.0]), &labels[..])).collect();
    let (svg, _) = draw(&params, &files);
    let blue = |with: &str| {
        let lines = svg.lines().filter(|line| line.starts_with("<path") && line.contains("#0072b2"));
        lines.filter(|line| line.contains(with)).count()
    };
    assert!(blue("stroke-linecap") > 0 && blue("fill=\"#0072b2\"") > 0, "discs and squares: {svg}");
    assert_eq!(blue("stroke-dasharray"), 1, "{svg}");
    let all = svg.lines().filter(|line| line.contains("stroke-dasharray")).count();
    assert_eq!(all, 2, "the seventh and the eighth: {svg}");
}
