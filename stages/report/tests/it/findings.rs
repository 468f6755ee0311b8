//! The kind `findings`: verdicts over tracks and over trainings, and what is refused.

use dril_report::Findings;
use dril_stage_api::testing::Bench;
use serde_json::{Value, json};

use crate::fakes::{self, output};

fn noise(n: usize) -> f64 {
    let mixed = (n as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40;
    f64::from(u32::try_from(mixed).unwrap()) / f64::from(1 << 24) - 0.5
}

/// Scores around `mean`: what is hard on a track is so for all, the rest is each one's own.
fn scores(mean: f64, own: usize, count: usize) -> Vec<f64> {
    (0..count).map(|n| mean + 300.0 * noise(n) + 40.0 * noise(own * 1000 + n)).collect()
}

fn params(claims: Value) -> Value {
    json!({ "title": "Findings", "profile": "full", "full_profile": "full", "claims": claims })
}

/// One line of the CSV for each claim, as cells.
fn lines(bench: &Bench) -> Vec<Vec<String>> {
    bench.run().unwrap();
    let text = output(bench, "csv");
    text.lines().skip(1).map(|line| line.split(',').map(str::to_owned).collect()).collect()
}

fn claim(text: &str, is: &str, margin: f64, left: &str, right: &str) -> Value {
    json!({ "claim": text, "is": is, "margin": margin, "left": { "method": left }, "right": { "method": right } })
}

#[test]
fn one_training_a_cell_is_judged_by_differences_on_equal_tracks() {
    let claims = json!([
        claim("much beats little", "greater", 0.0, "much", "little"),
        claim("little beats much", "greater", 0.0, "little", "much"),
        claim("some equals little", "equal", 50.0, "some", "little"),
        claim("some is no better than little", "not-greater", 50.0, "some", "little"),
        claim("some equals little to the point", "equal", 0.5, "some", "little"),
    ]);
    let mut bench = Bench::new::<Findings>(&params(claims), 0).unwrap();
    for (n, (method, mean)) in [("little", 100.0), ("some", 101.0), ("much", 160.0)].into_iter().enumerate() {
        for (m, demonstrations) in ["1", "20"].into_iter().enumerate() {
            let path = fakes::scores(&bench, &format!("{n}{m}"), &scores(mean, 2 * n + m, 100));
            bench = bench.input("scores", &path, &[("method", method), ("demonstrations", demonstrations)]);
        }
    }
    let lines = lines(&bench);
    let verdicts: Vec<&str> = lines.iter().map(|line| line[2].as_str()).collect();
    assert_eq!(verdicts, ["holds", "contradicted", "holds", "holds", "undecided"]);
    // Two pairs of cells; on each track their mean; 100 tracks.
    assert_eq!(lines[0][7..11], ["100", "tracks", "2", "2"]);
    let (mean, low): (f64, f64) = (lines[0][3].parse().unwrap(), lines[0][4].parse().unwrap());
    // What is hard on a track cancels: the interval is far narrower than the scores' spread of 87 would make it.
    assert!((mean - 60.0).abs() < 3.0 && mean - low < 3.5, "{:?}", lines[0]);
    let page = output(&bench, "markdown");
    assert!(page.contains("unit: the track, paired") && page.contains("Holm over the 5 claims"), "{page}");
    assert_eq!(output(&bench, "pairs").lines().count(), 11);
}

#[test]
fn differences_between_0_and_1_have_the_decimals_that_are_asked_for() {
    let run = |decimals: u8| {
        let mut with = params(json!([claim("much beats little", "greater", 0.0, "much", "little")]));
        with["decimals"] = json!(decimals);
        let mut bench = Bench::new::<Findings>(&with, 0).unwrap();
        for (method, score) in [("little", 0.5), ("much", 0.875)] {
            let path = fakes::scores(&bench, method, &[score; 40]);
            bench = bench.input("scores", &path, &[("method", method)]);
        }
        let line = lines(&bench).remove(0);
        let pairs = output(&bench, "pairs");
        (line[3].clone(), pairs.lines().nth(1).unwrap().to_owned(), output(&bench, "markdown"))
    };
    let (difference, pair, page) = run(2);
    assert_eq!(difference, "0.3750");
    assert!(pair.contains(",0.3750,0.3750,0.3750,40"), "{pair}");
    assert!(page.contains("0.38 ± 0.00"), "{page}");
    let (difference, _, page) = run(0);
    assert!(difference == "0.38" && page.contains("| 0 ± 0 "), "{page}");
}

#[test]
fn several_trainings_are_the_unit_and_their_episodes_are_not() {
    let mut params = params(json!([claim("b beats a", "greater", 0.0, "b", "a")]));
    params["trainings"] = json!(["seed"]);
    let run = |count: usize, shift: [f64; 5]| {
        let mut bench = Bench::new::<Findings>(&params, 0).unwrap();
        for (seed, shift) in shift.into_iter().take(count).enumerate() {
            for (n, method) in ["a", "b"].into_iter().enumerate() {
                let mean = 100.0 + if n == 1 { shift } else { 0.0 };
                let path = fakes::scores(&bench, &format!("{seed}{n}"), &scores(mean, 7 * seed + n, 100));
                bench = bench.input("scores", &path, &[("method", method), ("seed", &seed.to_string())]);
            }
        }
        lines(&bench).remove(0)
    };
    let clear = run(5, [80.0, 90.0, 100.0, 110.0, 120.0]);
    assert_eq!((&*clear[2], &*clear[7], &*clear[8]), ("holds", "5", "trainings"));
    // The episodes would call this clear, the trainings do not: they differ too much among themselves.
    assert_eq!(run(5, [300.0, -200.0, 250.0, -150.0, 100.0])[2], "undecided");
    let two = run(2, [100.0; 5]);
    assert_eq!((&*two[2], &*two[4], &*two[6]), ("undecided", "", ""));
}

#[test]
fn the_best_is_chosen_on_other_episodes_than_it_is_compared_on() {
    let claims = json!([{
        "claim": "b beats the better of a", "is": "greater", "left": { "method": "b", "mode": "s" },
        "right": { "method": "a" }, "best_of": ["mode"],
    }]);
    let mut bench = Bench::new::<Findings>(&params(claims), 0).unwrap();
    // By luck on the episodes that choose, `a d` looks best; on the others it is the worst.
    let lucky: Vec<f64> = (0..80).map(|n| if n % 2 == 0 { 900.0 } else { 100.0 + noise(n) }).collect();
    let cells = [("a", "d", lucky), ("a", "s", scores(300.0, 1, 80)), ("b", "s", scores(250.0, 2, 80))];
    for (n, (method, mode, values)) in cells.into_iter().enumerate() {
        let path = fakes::scores(&bench, &n.to_string(), &values);
        bench = bench.input("scores", &path, &[("method", method), ("mode", mode)]);
    }
    let line = lines(&bench).remove(0);
    assert_eq!((&*line[2], &*line[7]), ("holds", "40"), "{line:?}");
}

#[test]
fn the_published_difference_stands_beside_it() {
    let claims = json!([{
        "claim": "bounded clones equal clipped peaks", "is": "equal", "margin": 50,
        "left": { "expert": "bounded", "method": "bc", "mode": "stochastic", "policy": "beta", "demonstrations": 20 },
        "right": { "expert": "clipped", "method": "dril-peak", "mode": "stochastic", "policy": "gaussian", "demonstrations": 20 },
    }]);
    let mut bench = Bench::new::<Findings>(&params(claims), 0).unwrap();
    for (n, labels) in fakes::matrix().iter().enumerate() {
        let (mean, std) = fakes::reported(labels);
        let path = fakes::scores(&bench, &n.to_string(), &fakes::spread(mean, std));
        bench = bench.input("scores", &path, labels);
    }
    let bench = bench.input("reference", &fakes::reference("table22.csv"), &[]);
    let line = lines(&bench).remove(0);
    // The thesis: -8 with ±60 unpaired.
    let half: f64 = line[13].parse::<f64>().unwrap() - line[11].parse::<f64>().unwrap();
    assert_eq!(line[11], "-8.00");
    assert!((half - 60.0).abs() < 2.0, "{line:?}");
}

#[test]
fn claims_that_no_cells_answer_are_refused_with_what_is_missing() {
    let refused = |claims: Value, cells: &[&[(&str, &str)]]| {
        let mut bench = Bench::new::<Findings>(&params(claims), 0).unwrap();
        for (n, labels) in cells.iter().enumerate() {
            let path = fakes::scores(&bench, &n.to_string(), &[1.0, 2.0]);
            bench = bench.input("scores", &path, labels);
        }
        bench.run().unwrap_err().to_string()
    };
    let claims = || json!([claim("b beats a", "greater", 0.0, "b", "a")]);
    let message = refused(claims(), &[&[("method", "c")]]);
    assert!(message.contains("no evaluation is on either side"), "{message}");
    let message = refused(claims(), &[&[("method", "a"), ("mode", "d")]]);
    assert!(message.contains("nothing is on the left for (mode=d)"), "{message}");
    let claims =
        json!([{ "claim": "c", "is": "greater", "left": { "method": "b" }, "right": { "mode": "d" } }]);
    let message = refused(claims, &[&[("method", "b"), ("mode", "s")], &[("method", "b"), ("mode", "d")]]);
    assert!(message.contains("2 cells are on the left") && message.contains("best_of"), "{message}");
}

#[test]
fn trainings_that_diverged_are_counted_and_named() {
    let claims =
        json!([claim("b beats a", "greater", 0.0, "b", "a"), claim("c beats a", "greater", 0.0, "c", "a")]);
    let mut bench = Bench::new::<Findings>(&params(claims), 0).unwrap();
    for (n, (method, diverged_at_step)) in
        [("a", None), ("b", Some(8192)), ("c", None), ("d", Some(1))].into_iter().enumerate()
    {
        let path = fakes::scores(&bench, &n.to_string(), &scores(100.0, n, 40));
        let mut rows = dril_stage_api::scores::read("scores", &path).unwrap();
        rows.iter_mut().for_each(|row| row.diverged_at_step = diverged_at_step);
        dril_stage_api::scores::write(&path, &rows).unwrap();
        bench = bench.input("scores", &path, &[("method", method)]);
    }
    let lines = lines(&bench);
    assert!(output(&bench, "csv").lines().next().unwrap().ends_with(",diverged"));
    assert_eq!((lines[0].last().unwrap().as_str(), lines[1].last().unwrap().as_str()), ("1", "0"));
    let page = output(&bench, "markdown");
    assert!(page.contains("**training diverged**") && page.contains("method=b"), "{page}");
    assert!(!page.contains("method=d"), "no claim is about it: {page}");
}
