//! The kind `table` on the thesis's 48 evaluations and parts of them.

use dril_report::Table;
use dril_stage_api::testing::Bench;
use dril_stage_api::{Kind, StageError};
use serde_json::{Value, json};

use crate::fakes::{self, output, reference, spread};

const KEYS: [&str; 5] = ["expert", "method", "mode", "policy", "demonstrations"];

fn params(title: &str, columns: &[&str]) -> Value {
    json!({"title": title, "profile": "thesis", "full_profile": "thesis", "reference_name": "thesis", "keys": KEYS, "columns": columns})
}

/// A table of the evaluations whose labels include `part`; each cell is off the thesis's by a little of its own.
fn table(params: &Value, part: &[(&str, &str)]) -> Bench {
    let mut bench = Bench::new::<Table>(params, 0).unwrap();
    for (n, labels) in fakes::matrix().iter().enumerate() {
        if part.iter().all(|label| labels.contains(label)) {
            let (mean, std) = fakes::reported(labels);
            let off = [0.0, 3.25, -17.5, 140.0, -61.125][n % 5];
            let path =
                fakes::scores(&bench, &format!("scores-{n}"), &spread(mean + off, std + off.abs() / 8.0));
            bench = bench.input("scores", &path, labels);
        }
    }
    bench.input("reference", &reference("table22.csv"), &[])
}

fn failure(bench: &Bench) -> String {
    bench.run().unwrap_err().to_string()
}

#[test]
fn table_22_has_its_48_cells_beside_the_thesis() {
    let bench = table(&params("Table 22: all policies", &["demonstrations", "policy"]), &[]);
    bench.run().unwrap();
    insta::assert_snapshot!("table22_csv", output(&bench, "csv"));
    insta::assert_snapshot!("table22_markdown", output(&bench, "markdown"));
}

#[test]
fn labels_of_one_value_stand_above_the_table_and_not_in_its_rows() {
    let part = [("expert", "clipped"), ("mode", "deterministic"), ("policy", "gaussian")];
    let bench = table(&params("Table 14: behaviour cloning and DRIL", &["demonstrations"]), &part);
    bench.run().unwrap();
    insta::assert_snapshot!("table14_markdown", output(&bench, "markdown"));
}

#[test]
fn a_table_of_one_row_needs_no_row_labels() {
    let part = [("expert", "clipped"), ("method", "bc"), ("mode", "deterministic"), ("policy", "gaussian")];
    let mut with = params("Table 12: behaviour cloning", &["demonstrations"]);
    with["profile"] = json!("smoke");
    with["note"] = json!("A note on this table.");
    let bench = table(&with, &part);
    bench.run().unwrap();
    insta::assert_snapshot!("table12_markdown", output(&bench, "markdown"));
}

#[test]
fn without_columns_every_cell_is_a_row_and_without_a_reference_there_is_no_thesis() {
    let mut bench = Bench::new::<Table>(&params("Long", &[]), 0).unwrap();
    for (n, labels) in fakes::matrix().iter().take(6).enumerate() {
        let path = fakes::scores(&bench, &n.to_string(), &[n as f64; 2]);
        bench = bench.input("scores", &path, labels);
    }
    bench.run().unwrap();
    insta::assert_snapshot!("long_markdown", output(&bench, "markdown"));
    assert!(output(&bench, "csv").ends_with("clipped,bc,stochastic,gaussian,20,5.00,0.00,2,1,,0,,\n"));
}

#[test]
fn the_std_is_the_one_of_the_thesis_so_equal_scores_give_equal_numbers() {
    let mut bench = Bench::new::<Table>(&params("Table 22", &[]), 0).unwrap();
    for (n, labels) in fakes::matrix().iter().enumerate() {
        let (mean, std) = fakes::reported(labels);
        let path = fakes::scores(&bench, &n.to_string(), &spread(mean, std));
        bench = bench.input("scores", &path, labels);
    }
    let bench = bench.input("reference", &reference("table22.csv"), &[]);
    bench.run().unwrap();
    let text = output(&bench, "csv");
    assert_eq!(text.lines().count(), 49);
    for line in text.lines().skip(1) {
        let cells: Vec<&str> = line.split(',').collect();
        assert_eq!(
            (cells[5], cells[6]),
            (&*format!("{}.00", cells[11]), &*format!("{}.00", cells[12])),
            "{line}"
        );
    }
}

#[test]
fn two_runs_give_the_same_bytes() {
    let with = params("Table 22", &["demonstrations", "policy"]);
    let (first, second) = (table(&with, &[]), table(&with, &[]));
    first.run().unwrap();
    second.run().unwrap();
    for port in ["csv", "markdown"] {
        assert_eq!(output(&first, port), output(&second, port));
    }
}

#[test]
fn rows_and_columns_keep_the_order_of_the_input_and_not_the_alphabet() {
    let with = json!({"title": "T", "profile": "full", "keys": ["row", "column"], "columns": ["column"]});
    let mut bench = Bench::new::<Table>(&with, 0).unwrap();
    for (n, labels) in [("z", "20"), ("z", "3"), ("a", "100"), ("a", "20"), ("m", "3")].iter().enumerate() {
        let path = fakes::scores(&bench, &n.to_string(), &[n as f64]);
        bench = bench.input("scores", &path, &[("row", labels.0), ("column", labels.1)]);
    }
    bench.run().unwrap();
    insta::assert_snapshot!("order_csv", output(&bench, "csv"));
    insta::assert_snapshot!("order_markdown", output(&bench, "markdown"));
}

#[test]
fn evaluations_that_differ_outside_the_keys_are_pooled_and_the_table_says_so() {
    let with = json!({"title": "Pooled", "profile": "full", "keys": ["policy"]});
    let mut bench = Bench::new::<Table>(&with, 0).unwrap();
    for (name, policy, seed, values) in [
        ("a", "beta", "1", vec![10.0, 20.0]),
        ("b", "beta", "2", vec![60.0]),
        ("c", "gaussian", "1", vec![5.0]),
        ("d", "gaussian", "2", vec![7.0, 9.0]),
    ] {
        let path = fakes::scores(&bench, name, &values);
        bench = bench.input("scores", &path, &[("policy", policy), ("seed", seed), ("env", "car")]);
    }
    bench.run().unwrap();
    insta::assert_snapshot!("pooled_csv", output(&bench, "csv"));
    insta::assert_snapshot!("pooled_markdown", output(&bench, "markdown"));
}

#[test]
fn a_pooled_cell_has_the_standard_error_over_its_trainings() {
    let with = json!({"title": "Pooled", "profile": "full", "keys": ["policy"]});
    let mut bench = Bench::new::<Table>(&with, 0).unwrap();
    for (policy, seed, shift) in
        [("beta", "1", 0.0), ("beta", "2", 10.0), ("beta", "3", 20.0), ("gaussian", "1", 5.0)]
    {
        let values: Vec<f64> = (0..100).map(|n| shift + f64::from(n % 2)).collect();
        let path = fakes::scores(&bench, &format!("{policy}{seed}"), &values);
        bench = bench.input("scores", &path, &[("policy", policy), ("seed", seed)]);
    }
    bench.run().unwrap();
    let text = output(&bench, "csv");
    assert!(text.starts_with("policy,mean,std,episodes,trainings,mean_error,diverged,"), "{text}");
    // Means 0.5, 10.5 and 20.5: their sample deviation is 10, over the root of 3.
    assert!(text.contains("beta,10.50,8.18,300,3,5.77,0,,\n"), "{text}");
    assert!(text.contains("gaussian,5.50,0.50,100,1,,0,,\n"), "{text}");
}

#[test]
fn a_reference_may_know_more_or_fewer_cells_than_the_run() {
    let with = json!({"title": "T", "profile": "full", "keys": ["policy"], "columns": ["policy"]});
    let mut bench = Bench::new::<Table>(&with, 0).unwrap();
    for policy in ["beta", "gaussian", "uniform"] {
        let path = fakes::scores(&bench, policy, &[1.0, 2.0]);
        bench = bench.input("scores", &path, &[("policy", policy)]);
    }
    let path = bench.folder().join("reference.csv");
    std::fs::write(&path, "mean,policy,std,source\n219.0,gaussian,,annex\n9,categorical,1,\n").unwrap();
    let bench = bench.input("reference", &path, &[]);
    bench.run().unwrap();
    insta::assert_snapshot!("partial_reference_csv", output(&bench, "csv"));
    insta::assert_snapshot!("partial_reference_markdown", output(&bench, "markdown"));
}

#[test]
fn a_cell_of_an_agent_whose_training_diverged_is_marked() {
    let with = json!({"title": "T", "profile": "full", "keys": ["policy"]});
    let mut bench = Bench::new::<Table>(&with, 0).unwrap();
    let files = [
        ("beta", fakes::scores(&bench, "beta", &[1.0, 2.0])),
        ("gaussian", fakes::diverged_scores(&bench, "gaussian", &[1.0, 2.0])),
    ];
    for (policy, path) in files {
        bench = bench.input("scores", &path, &[("policy", policy)]);
    }
    bench.run().unwrap();
    assert!(output(&bench, "csv").contains("beta,1.50,0.50,2,1,,0,,\ngaussian,1.50,0.50,2,1,,1,,\n"));
    let page = output(&bench, "markdown");
    assert!(page.contains("**training diverged**") && page.contains("policy=gaussian"), "{page}");
    assert!(!page.contains("policy=beta"), "{page}");
}

#[test]
fn labels_with_commas_quotes_and_bars_survive_both_formats() {
    let with = json!({"title": "a|b", "profile": "full", "keys": ["lr, decay", "policy"]});
    let bench = Bench::new::<Table>(&with, 0).unwrap();
    let path = fakes::scores(&bench, "a", &[1.0]);
    let bench = bench.input("scores", &path, &[("lr, decay", "1e-3, \"fast\""), ("policy", "a|b")]);
    bench.run().unwrap();
    assert!(output(&bench, "csv").starts_with("\"lr, decay\",policy,mean"));
    assert!(output(&bench, "csv").contains("\"1e-3, \"\"fast\"\"\",a|b,1.00,0.00,1,1,,0,,\n"));
    assert!(output(&bench, "markdown").contains("# a\\|b"));
    assert!(output(&bench, "markdown").contains("policy: a\\|b"));
}

/// A table of these parameters over evaluations with the labels `rate` and `seed`.
fn pooled(with: &Value, evaluations: &[(&str, &str, &[f64])]) -> Bench {
    let mut bench = Bench::new::<Table>(with, 0).unwrap();
    for (rate, seed, values) in evaluations {
        let path = fakes::scores(&bench, &format!("{rate}-{seed}"), values);
        bench = bench.input("scores", &path, &[("rate", rate), ("seed", seed)]);
    }
    bench.run().unwrap();
    bench
}

#[test]
fn a_file_without_profiles_is_not_warned_of_reduced_sizes() {
    let page = |profile: &str, full: Option<&str>| {
        let mut with = json!({"title": "T", "profile": profile, "keys": ["rate"]});
        if let Some(full) = full {
            with["full_profile"] = json!(full);
        }
        output(&pooled(&with, &[("1", "1", &[1.0])]), "markdown")
    };
    // What the engine calls the profile of a file without `profiles`.
    let default = page("default", None);
    assert!(!default.contains("reduced") && default.contains("- profile: `default`\n"), "{default}");
    assert!(!page("full", None).contains("reduced"));
    assert!(page("smoke", None).contains("not comparable with those at profile `full`"));
    // A file with profiles of its own may call the small one `default`: it says which is the full one.
    assert!(page("default", Some("full")).contains("not comparable with those at profile `full`"));
}

#[test]
fn scores_between_0_and_1_have_the_decimals_that_are_asked_for() {
    let with = json!({
        "title": "Accuracy", "profile": "default", "reference_name": "paper", "keys": ["rate"], "decimals": 3,
    });
    let bench = [("0.1", "1", [0.25, 0.5]), ("0.1", "2", [0.75, 0.875]), ("0.01", "1", [1.0, 0.9990234375])]
        .iter()
        .fold(Bench::new::<Table>(&with, 0).unwrap(), |bench, (rate, seed, values)| {
            let path = fakes::scores(&bench, &format!("{rate}-{seed}"), values);
            bench.input("scores", &path, &[("rate", rate), ("seed", seed)])
        });
    let path = bench.folder().join("reference.csv");
    std::fs::write(&path, "rate,mean,std\n0.1,0.61,0.2\n0.01,0.9876543,\n").unwrap();
    let bench = bench.input("reference", &path, &[]);
    bench.run().unwrap();
    insta::assert_snapshot!("decimals_csv", output(&bench, "csv"));
    insta::assert_snapshot!("decimals_markdown", output(&bench, "markdown"));
}

#[test]
fn without_decimals_numbers_are_as_with_0_of_them() {
    let evaluations: [(&str, &str, &[f64]); 2] = [("1", "1", &[0.5, 0.5]), ("2", "1", &[1.125, 2.5])];
    let mut with = json!({"title": "T", "profile": "full", "keys": ["rate"]});
    let implicit = pooled(&with, &evaluations);
    with["decimals"] = json!(0);
    let explicit = pooled(&with, &evaluations);
    for port in ["csv", "markdown"] {
        assert_eq!(output(&implicit, port), output(&explicit, port));
    }
    // Ties go to the even neighbour.
    assert!(output(&implicit, "markdown").contains("| 1    | 0 ± 0 |"), "{}", output(&implicit, "markdown"));
}

#[test]
fn more_decimals_than_a_score_can_have_are_refused() {
    let with = json!({"title": "T", "profile": "p", "keys": ["rate"], "decimals": 7});
    let problems = Kind::of::<Table>().normalize(&with).unwrap_err();
    assert_eq!(problems[0].message, "`decimals` is 7, expected 0 to 6");
    for wrong in [json!(-1), json!(300), json!(1.5)] {
        let with = json!({"title": "T", "profile": "p", "keys": ["rate"], "decimals": wrong});
        let problems = Kind::of::<Table>().normalize(&with).unwrap_err();
        assert_eq!(problems[0].path, ["decimals"]);
    }
}

#[test]
fn trainings_of_equal_bytes_in_one_cell_are_named() {
    let with = json!({"title": "T", "profile": "full", "keys": ["rate"]});
    let page = |evaluations: &[(&str, &str, &[f64])]| output(&pooled(&with, evaluations), "markdown");
    let some = page(&[
        ("1", "1", &[0.5, 0.6]),
        ("1", "2", &[0.5, 0.6]),
        ("1", "3", &[0.6, 0.5]),
        ("2", "1", &[0.5, 0.6]),
        ("2", "2", &[0.7, 0.8]),
    ]);
    let expected = "- **equal evaluations**: 2 of the 3 pooled into rate=1 have the same bytes as another one of the cell; \
                    if they should differ, check that the value of seed reaches the program\n";
    assert!(some.contains(expected), "{some}");
    let both = page(&[("1", "1", &[0.5]), ("1", "2", &[0.5]), ("2", "1", &[0.5]), ("2", "2", &[0.5])]);
    assert!(both.contains("2 of the 2 pooled into rate=1; 2 of the 2 pooled into rate=2 have"), "{both}");
    // Equal evaluations in two cells are no repetitions.
    let none = page(&[("1", "1", &[0.5]), ("1", "2", &[0.6]), ("2", "1", &[0.5]), ("2", "2", &[0.6])]);
    assert!(!none.contains("equal evaluations"), "{none}");
}

#[test]
fn an_evaluation_without_a_label_of_the_keys_is_named() {
    let bench = table(&params("T", &[]), &[("policy", "beta")]);
    let path = fakes::scores(&bench, "bare", &[1.0]);
    let message = failure(&bench.input("scores", &path, &[("expert", "clipped"), ("method", "bc")]));
    for part in [
        "input `scores`",
        "bare.csv",
        "item 25 of this input has no label `mode`",
        "its labels are expert=clipped, method=bc",
        "take the key out of `keys`",
    ] {
        assert!(message.contains(part), "{message}");
    }
}

#[test]
fn an_evaluation_wired_twice_does_not_count_twice() {
    let bench = table(&params("T", &[]), &[]);
    let path = fakes::scores(&bench, "again", &[1.0]);
    let message = failure(&bench.input("scores", &path, &fakes::matrix()[3]));
    assert!(message.contains("items 4 and 49 at `scores` have the same labels"), "{message}");
    assert!(message.contains("wire each stage once"), "{message}");
}

#[test]
fn files_that_hold_no_scores_are_refused() {
    for (text, part) in [("", "has no episode"), ("a,b\n1,2\n", "not a table of scores")] {
        let bench = Bench::new::<Table>(&params("T", &[]), 0).unwrap();
        let path = bench.folder().join("broken.csv");
        std::fs::write(&path, text).unwrap();
        let message = failure(&bench.input("scores", &path, &fakes::matrix()[0]));
        assert!(message.contains("broken.csv") && message.contains(part), "{message}");
    }
    let bench = Bench::new::<Table>(&params("T", &[]), 0).unwrap();
    let path = fakes::scores(&bench, "huge", &[f64::MAX, f64::MAX]);
    let message = failure(&bench.input("scores", &path, &fakes::matrix()[0]));
    assert!(message.contains("too large to average"), "{message}");
}

#[test]
fn a_reference_without_a_key_names_the_columns_seen_and_expected() {
    let bench = table(&json!({"title": "T", "profile": "full", "keys": ["expert", "polcy"]}), &[]);
    assert!(failure(&bench).contains("has no label `polcy`"), "the evaluations are read first");
    let with = json!({"title": "T", "profile": "full", "keys": ["expert", "seed"]});
    let bench = Bench::new::<Table>(&with, 0).unwrap();
    let path = fakes::scores(&bench, "a", &[1.0]);
    let bench = bench.input("scores", &path, &[("expert", "clipped"), ("seed", "1")]);
    let message = failure(&bench.input("reference", &reference("table22.csv"), &[]));
    for part in
        ["input `reference`", "table22.csv", "has no column `seed`", "`demonstrations`", "expected `expert`"]
    {
        assert!(message.contains(part), "{message}");
    }
}

#[test]
fn an_input_that_is_not_connected_and_a_request_to_stop_end_the_stage() {
    let bench = Bench::new::<Table>(&params("T", &[]), 0).unwrap();
    assert!(matches!(bench.run(), Err(StageError::Port(_))));
    let bench = table(&params("T", &[]), &[]);
    bench.cancel.store(true, std::sync::atomic::Ordering::Relaxed);
    assert!(matches!(bench.run(), Err(StageError::Cancelled)));
}

#[test]
fn all_wrong_parameters_are_reported_at_once() {
    let with = json!({
        "title": "", "profile": "a`b", "keys": ["mode", "mean", "mode"], "columns": ["policy", "mode", "mode"],
    });
    let problems = Kind::of::<Table>().normalize(&with).unwrap_err();
    let found: Vec<String> =
        problems.iter().map(|p| format!("{}: {}", p.path.join("."), p.message)).collect();
    let expected = [
        "title: `title` is empty, expected the table's title",
        "profile: `profile` is \"a`b\", expected a profile's name, without line breaks and backticks",
        "keys.1: `mean` is a column of the table itself, expected a label",
        "keys.2: `mode` is in `keys` twice, expected it once",
        "columns.0: `policy` is not in `keys`, expected one of `mode`, `mean`, `mode`",
        "columns.2: `mode` is in `columns` twice, expected it once",
    ];
    assert_eq!(found, expected);
    for name in ["", "a\nb", "this run"] {
        let with = json!({"title": "T", "profile": "p", "keys": ["mode"], "reference_name": name});
        let problems = Kind::of::<Table>().normalize(&with).unwrap_err();
        assert_eq!(problems[0].path, ["reference_name"], "{name:?}");
    }
    let problems =
        Kind::of::<Table>().normalize(&json!({"title": "T", "profile": "p", "keys": []})).unwrap_err();
    assert_eq!(problems[0].message, "`keys` is empty, expected at least one label");
}
