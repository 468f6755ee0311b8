//! The kind `compare`.

use dril_report::Compare;
use dril_stage_api::testing::Bench;
use serde_json::json;

use crate::fakes::{self, output};

fn bench() -> Bench {
    let params = json!({
        "title": "Transfer", "profile": "full", "full_profile": "full", "axis": "place", "base": "home"
    });
    Bench::new::<Compare>(&params, 0).unwrap()
}

#[test]
fn scores_stand_beside_those_of_the_base_with_ratio_and_paired_difference() {
    let mut bench = bench();
    for (place, mode, scores) in [
        ("home", "deterministic", [900.0, 800.0, 700.0]),
        ("abroad", "deterministic", [880.0, 810.0, 680.0]),
        ("home", "stochastic", [600.0, 500.0, 400.0]),
        ("abroad", "stochastic", [600.0, 500.0, 400.0]),
    ] {
        let path = fakes::scores(&bench, &format!("{place}-{mode}"), &scores);
        bench = bench.input("scores", &path, &[("place", place), ("mode", mode)]);
    }
    bench.run().unwrap();
    // Differences -20, 10, -20: mean -10, sample deviation 17.32, over the root of 3.
    assert_eq!(
        output(&bench, "csv"),
        "mode,place,mean,std,episodes,diverged,ratio,difference,difference_error\n\
         deterministic,home,800.00,81.65,3,0,1.0000,0.00,0.00\n\
         deterministic,abroad,790.00,82.87,3,0,0.9875,-10.00,10.00\n\
         stochastic,home,500.00,81.65,3,0,1.0000,0.00,0.00\n\
         stochastic,abroad,500.00,81.65,3,0,1.0000,0.00,0.00\n"
    );
    insta::assert_snapshot!("compare_markdown", output(&bench, "markdown"));
}

#[test]
fn an_agent_whose_training_diverged_is_marked() {
    let bench = bench();
    let home = fakes::scores(&bench, "home", &[2.0]);
    let away = fakes::diverged_scores(&bench, "away", &[1.0]);
    let bench =
        bench.input("scores", &home, &[("place", "home")]).input("scores", &away, &[("place", "away")]);
    bench.run().unwrap();
    let csv = output(&bench, "csv");
    assert!(csv.ends_with("home,2.00,0.00,1,0,1.0000,0.00,\naway,1.00,0.00,1,1,0.5000,-1.00,\n"), "{csv}");
    let page = output(&bench, "markdown");
    assert!(page.contains("**training diverged**") && page.contains("evaluated: place=away\n"), "{page}");
}

#[test]
fn what_cannot_be_compared_is_refused_with_its_labels() {
    let one = |labels: &[(&str, &str)], more: &[f64]| {
        let bench = bench();
        let (home, away) = (fakes::scores(&bench, "home", &[1.0]), fakes::scores(&bench, "away", more));
        let bench = bench.input("scores", &home, &[("place", "home")]).input("scores", &away, labels);
        bench.run().unwrap_err().to_string()
    };
    let message = one(&[("mode", "mean")], &[1.0]);
    assert!(message.contains("no label `place`; its labels are mode=mean"), "{message}");
    let message = one(&[("mode", "mean"), ("place", "away")], &[1.0]);
    assert!(message.contains("no evaluation has place=home and otherwise the same labels"), "{message}");
    let message = one(&[("place", "away")], &[1.0, 2.0]);
    assert!(message.contains("different seeds") && message.contains("`first_seed`"), "{message}");
}

#[test]
fn differences_of_scores_between_0_and_1_have_the_decimals_that_are_asked_for() {
    let params =
        json!({ "title": "Losses", "profile": "default", "axis": "place", "base": "home", "decimals": 3 });
    let bench = Bench::new::<Compare>(&params, 0).unwrap();
    let home = fakes::scores(&bench, "home", &[0.5, 0.25]);
    let away = fakes::scores(&bench, "away", &[0.5, 0.375]);
    let bench =
        bench.input("scores", &home, &[("place", "home")]).input("scores", &away, &[("place", "away")]);
    bench.run().unwrap();
    let csv = output(&bench, "csv");
    assert!(csv.ends_with("away,0.43750,0.06250,2,0,1.1667,0.06250,0.06250\n"), "{csv}");
    let page = output(&bench, "markdown");
    assert!(page.contains("| away  | 0.438 ± 0.062 | 116.7 % | 0.0625 ± 0.0625 |"), "{page}");
    assert!(!page.contains("reduced"), "{page}");
}
