//! The kind `select`: which candidate it takes, and what it writes about the others.

use std::path::PathBuf;

use dril_report::{Findings, Select};
use dril_stage_api::Kind;
use dril_stage_api::testing::Bench;
use proptest::prelude::*;
use serde_json::json;

use crate::fakes::{self, output};

fn select() -> Bench {
    Bench::new::<Select>(&json!({}), 0).unwrap()
}

/// A candidate whose bytes are no text.
fn candidate(bench: &Bench, name: &str) -> PathBuf {
    let path = bench.folder().join(format!("{name}.safetensors"));
    std::fs::write(&path, [name.as_bytes(), &[0, 255, 13, 10]].concat()).unwrap();
    path
}

fn with_candidates(names: &[&str]) -> Bench {
    names.iter().fold(select(), |bench, name| {
        let path = candidate(&bench, name);
        bench.input("candidates", &path, &[("expert", "clipped"), ("seed", name)])
    })
}

fn with_scores(bench: Bench, seed: &str, values: &[f64]) -> Bench {
    let path = fakes::scores(&bench, &format!("scores-{seed}"), values);
    bench.input("scores", &path, &[("expert", "clipped"), ("seed", seed)])
}

fn chosen(bench: &Bench) -> Vec<u8> {
    std::fs::read(bench.output("policy").unwrap()).unwrap()
}

#[test]
fn the_best_candidate_is_copied_byte_for_byte_and_all_are_ranked() {
    let bench = with_candidates(&["1", "2", "3"]);
    // Scores arrive in another order than candidates: labels decide, not positions.
    let bench = with_scores(bench, "3", &[900.0, 903.0]);
    let bench = with_scores(bench, "1", &[910.0, 100.0]);
    let bench = with_scores(bench, "2", &[905.0, 899.0]);
    bench.run().unwrap();
    assert_eq!(chosen(&bench), [b'2', 0, 255, 13, 10]);
    insta::assert_snapshot!("ranking_csv", output(&bench, "ranking"));
}

#[test]
fn scores_between_0_and_1_are_ranked_with_the_decimals_that_are_asked_for() {
    let bench = Bench::new::<Select>(&json!({ "decimals": 3 }), 0).unwrap();
    let path = candidate(&bench, "1");
    let bench = bench.input("candidates", &path, &[("expert", "clipped"), ("seed", "1")]);
    let bench = with_scores(bench, "1", &[0.8765, 0.8767]);
    bench.run().unwrap();
    assert!(
        output(&bench, "ranking").contains("clipped,1,0.87660,0.00010,2,0,true"),
        "{}",
        output(&bench, "ranking")
    );
}

#[test]
fn parameters_that_were_added_later_leave_the_keys_of_earlier_stages_alone() {
    let select = Kind::of::<Select>();
    for same in [json!({}), json!({ "decimals": 0 })] {
        assert_eq!(select.normalize(&same).unwrap(), json!({ "by": "mean" }));
    }
    let claim = json!({ "claim": "c", "is": "greater", "left": { "m": 1 }, "right": { "m": 2 } });
    let with = json!({ "title": "T", "profile": "p", "claims": [claim], "decimals": 0 });
    let params = Kind::of::<Findings>().normalize(&with).unwrap();
    assert!(params.get("decimals").is_none(), "{params}");
}

#[test]
fn of_equal_candidates_the_first_of_the_matrix_is_chosen() {
    let bench = with_candidates(&["9", "1", "5"]);
    let bench = with_scores(with_scores(with_scores(bench, "1", &[7.0]), "5", &[7.0]), "9", &[6.0, 8.0]);
    bench.run().unwrap();
    assert_eq!(chosen(&bench)[0], b'9');
}

#[test]
fn one_candidate_without_labels_is_its_own_best() {
    let bench = select();
    let (policy, scores) = (candidate(&bench, "only"), fakes::scores(&bench, "scores", &[1.0]));
    let bench = bench.input("candidates", &policy, &[]).input("scores", &scores, &[]);
    bench.run().unwrap();
    assert_eq!(chosen(&bench), b"only\0\xff\r\n");
    assert_eq!(output(&bench, "ranking"), "mean,std,episodes,diverged,chosen\n1.00,0.00,1,0,true\n");
}

#[test]
fn the_ranking_marks_a_candidate_whose_training_diverged() {
    let bench = with_scores(with_candidates(&["1", "2"]), "1", &[1.0]);
    let path = fakes::diverged_scores(&bench, "scores-2", &[2.0]);
    let bench = bench.input("scores", &path, &[("expert", "clipped"), ("seed", "2")]);
    bench.run().unwrap();
    let ranking = output(&bench, "ranking");
    assert!(ranking.ends_with("clipped,2,2.00,0.00,1,1,true\nclipped,1,1.00,0.00,1,0,false\n"), "{ranking}");
}

#[test]
fn a_candidate_without_scores_and_scores_without_a_candidate_are_refused() {
    let bench = with_scores(with_candidates(&["1", "2"]), "1", &[1.0]);
    let message = bench.run().unwrap_err().to_string();
    assert!(message.starts_with("input `candidates`"), "{message}");
    assert!(message.contains("(expert=clipped, seed=2) has no counterpart at `scores`"), "{message}");
    assert!(message.contains("there are (expert=clipped, seed=1)"), "{message}");
    let bench = with_scores(with_scores(with_candidates(&["1"]), "1", &[1.0]), "2", &[1.0]);
    let message = bench.run().unwrap_err().to_string();
    assert!(message.starts_with("input `scores`"), "{message}");
    assert!(message.contains("seed=2) has no counterpart at `candidates`"), "{message}");
}

#[test]
fn candidates_or_scores_of_equal_labels_cannot_be_matched() {
    let bench = with_scores(with_candidates(&["1", "1"]), "1", &[1.0]);
    let message = bench.run().unwrap_err().to_string();
    assert!(message.contains("input `candidates`") && message.contains("items 1 and 2"), "{message}");
    let bench = with_scores(with_scores(with_candidates(&["1"]), "1", &[1.0]), "1", &[2.0]);
    let message = bench.run().unwrap_err().to_string();
    assert!(message.contains("input `scores`") && message.contains("items 1 and 2"), "{message}");
}

#[test]
fn an_axis_with_the_name_of_a_ranking_column_is_refused() {
    let bench = select();
    let (policy, scores) = (candidate(&bench, "only"), fakes::scores(&bench, "scores", &[1.0]));
    let bench =
        bench.input("candidates", &policy, &[("mean", "1")]).input("scores", &scores, &[("mean", "1")]);
    let message = bench.run().unwrap_err().to_string();
    assert!(message.contains("an axis is called `mean`"), "{message}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn no_candidate_is_better_than_the_chosen_one_and_none_before_it_as_good(
        scores in prop::collection::vec(prop::collection::vec(-3..4_i32, 1..4), 1..6),
    ) {
        let names: Vec<String> = (0..scores.len()).map(|n| n.to_string()).collect();
        let mut bench = with_candidates(&names.iter().map(String::as_str).collect::<Vec<_>>());
        for (name, values) in names.iter().zip(&scores) {
            bench = with_scores(bench, name, &values.iter().map(|v| f64::from(*v)).collect::<Vec<_>>());
        }
        bench.run().unwrap();
        let best = usize::from(chosen(&bench)[0] - b'0');
        // Means as fractions over 6, which three, two and one divide: exact.
        let mean = |values: &Vec<i32>| values.iter().sum::<i32>() * 6 / i32::try_from(values.len()).unwrap();
        let highest = scores.iter().map(mean).max().unwrap();
        prop_assert_eq!(scores.iter().position(|values| mean(values) == highest).unwrap(), best);
    }
}
