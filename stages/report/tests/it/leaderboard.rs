//! The kind `leaderboard` on the thesis's comparison with other methods.

use dril_report::Leaderboard;
use dril_stage_api::testing::Bench;
use serde_json::json;

use crate::fakes::{self, output, reference, spread};

fn leaderboard(profile: &str) -> Bench {
    Bench::new::<Leaderboard>(&json!({
        "title": "Table 23: against other methods", "profile": profile, "full_profile": "thesis", "reference_name": "thesis"
    }), 0)
        .unwrap()
}

#[test]
fn table_23_lists_the_literature_and_then_this_run_beside_the_thesis() {
    let mut bench = leaderboard("desk");
    for (name, policy, mean, std) in [
        ("dril-peak gaussian stochastic", "gaussian", 640.5, 210.0),
        ("bc beta stochastic", "beta", 801.25, 99.5),
    ] {
        let path = fakes::scores(&bench, policy, &spread(mean, std));
        bench = bench.input("scores", &path, &[("name", name), ("policy", policy)]);
    }
    let bench = bench.input("reference", &reference("table23.csv"), &[]);
    bench.run().unwrap();
    insta::assert_snapshot!("table23_csv", output(&bench, "csv"));
    insta::assert_snapshot!("table23_markdown", output(&bench, "markdown"));
}

#[test]
fn an_algorithm_that_this_run_lacks_or_the_thesis_lacks_is_listed_all_the_same() {
    let bench = leaderboard("thesis");
    let (one, two) = (fakes::scores(&bench, "one", &[1.0, 3.0]), fakes::scores(&bench, "two", &[5.0]));
    let path = bench.folder().join("reference.csv");
    std::fs::write(
        &path,
        "algorithm,mean,std,source\nours,7,1,thesis\nsac,9,,\"Doe, 2020\"\nold,4,2,thesis\n",
    )
    .unwrap();
    let bench = bench
        .input("scores", &one, &[("name", "new"), ("seed", "1")])
        .input("scores", &two, &[("name", "new"), ("seed", "2")])
        .input("scores", &two, &[("name", "ours")])
        .input("reference", &path, &[]);
    bench.run().unwrap();
    insta::assert_snapshot!("other_rows_csv", output(&bench, "csv"));
    insta::assert_snapshot!("other_rows_markdown", output(&bench, "markdown"));
}

#[test]
fn an_algorithm_whose_training_diverged_is_marked() {
    let bench = leaderboard("thesis");
    let mut inputs = Vec::new();
    for (name, diverged_at_step) in [("sound", None), ("lost", Some(8192))] {
        let path = fakes::scores(&bench, name, &[1.0, 3.0]);
        let mut rows = dril_stage_api::scores::read("scores", &path).unwrap();
        rows.iter_mut().for_each(|row| row.diverged_at_step = diverged_at_step);
        dril_stage_api::scores::write(&path, &rows).unwrap();
        inputs.push((path, name));
    }
    let bench = inputs
        .iter()
        .fold(bench, |bench, (path, name)| bench.input("scores", path, &[("name", name)]))
        .input("reference", &reference("table23.csv"), &[]);
    bench.run().unwrap();
    let text = output(&bench, "csv");
    assert!(text.contains("sound,2.00,1.00,2,0,this run,,\nlost,2.00,1.00,2,1,this run,,\n"), "{text}");
    let page = output(&bench, "markdown");
    assert!(page.contains("**training diverged**") && page.contains("were evaluated: lost\n"), "{page}");
}

#[test]
fn an_evaluation_without_a_name_is_refused_with_how_to_give_one() {
    let bench = leaderboard("thesis");
    let path = fakes::scores(&bench, "one", &[1.0]);
    let bench = bench.input("scores", &path, &[("policy", "beta")]).input(
        "reference",
        &reference("table23.csv"),
        &[],
    );
    let message = bench.run().unwrap_err().to_string();
    assert!(
        message.contains("has no label `name`; its labels are policy=beta; give each item a name"),
        "{message}"
    );
}

#[test]
fn a_reference_with_other_columns_or_an_algorithm_twice_is_refused() {
    for (text, part) in [
        ("algorithm,mean,std\na,1,2\n", "has no column `source`"),
        ("algorithm,mean,std,source\na,1,2,x\na,3,4,x\n", "lines 2 and 3 both give algorithm=a, source=x"),
    ] {
        let bench = leaderboard("thesis");
        let (scores, path) = (fakes::scores(&bench, "one", &[1.0]), bench.folder().join("reference.csv"));
        std::fs::write(&path, text).unwrap();
        let bench = bench.input("scores", &scores, &[("name", "a")]).input("reference", &path, &[]);
        let message = bench.run().unwrap_err().to_string();
        assert!(message.contains(part), "{message}");
    }
}

#[test]
fn own_scores_have_the_decimals_that_are_asked_for_and_published_ones_their_own() {
    let params =
        json!({ "title": "Accuracy", "profile": "default", "reference_name": "paper", "decimals": 2 });
    let bench = Bench::new::<Leaderboard>(&params, 0).unwrap();
    let (scores, path) = (fakes::scores(&bench, "one", &[0.5, 0.75]), bench.folder().join("reference.csv"));
    std::fs::write(&path, "algorithm,mean,std,source\nours,0.6,,paper\nsac,0.9125,0.1,Doe\n").unwrap();
    let bench = bench.input("scores", &scores, &[("name", "ours")]).input("reference", &path, &[]);
    bench.run().unwrap();
    let csv = output(&bench, "csv");
    assert!(csv.ends_with("sac,0.9125,0.1,,,Doe,,\nours,0.6250,0.1250,2,0,this run,0.6,\n"), "{csv}");
    let page = output(&bench, "markdown");
    for part in ["0.9125 ±  0.1", "0.62 ± 0.12", "|   0.6 |"] {
        assert!(page.contains(part), "{part}: {page}");
    }
    assert!(!page.contains("reduced"), "{page}");
}
