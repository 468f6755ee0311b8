//! Labels that parameters name and inputs lack are found before anything runs, and nothing else is.

use dril_report::{Compare, Figure, Findings, Leaderboard, Select, Table};
use dril_stage_api::{FanIns, Incoming, Kind, Labels, ParamProblem, scores};
use serde_json::{Value, json};

fn labels(pairs: &[(&str, &str)]) -> Labels {
    pairs.iter().map(|(axis, value)| ((*axis).to_owned(), (*value).to_owned())).collect()
}

/// Path, message and hint of each problem, where artifacts with these columns at `port` have these labels.
fn found(
    kind: Kind,
    params: &Value,
    (port, columns): (&str, Option<&[&'static str]>),
    all: &[Labels],
) -> Vec<(String, String, String)> {
    let params = kind.normalize(params).unwrap();
    let incoming = |labels| Incoming { labels, columns };
    let inputs: FanIns<'_> = [(port, all.iter().map(incoming).collect())].into_iter().collect();
    let shown =
        |problem: ParamProblem| (problem.path.join("."), problem.message, problem.hint.unwrap_or_default());
    kind.check_labels(&params, &inputs).into_iter().map(shown).collect()
}

fn paths(found: &[(String, String, String)]) -> Vec<&str> {
    found.iter().map(|(path, _, _)| path.as_str()).collect()
}

fn two_policies() -> [Labels; 2] {
    [labels(&[("policy", "beta"), ("seed", "1")]), labels(&[("policy", "gaussian"), ("seed", "1")])]
}

const SCORES: (&str, Option<&[&str]>) = ("scores", Some(&scores::COLUMNS));
const DATA: (&str, Option<&[&str]>) = ("data", Some(&scores::COLUMNS));

#[test]
fn a_key_of_a_table_that_no_evaluation_has_is_found_with_the_one_that_was_meant() {
    let with = |keys: &[&str]| json!({"title": "t", "profile": "p", "keys": keys});
    let kind = Kind::of::<Table>();
    assert_eq!(found(kind, &with(&["policy", "seed"]), SCORES, &two_policies()), []);
    let hint = "did you mean `policy`? the labels at `scores` are `policy`, `seed`";
    assert_eq!(
        found(kind, &with(&["seed", "polcy"]), SCORES, &two_policies()),
        [("keys.1".to_owned(), "unknown label `polcy`".to_owned(), hint.to_owned())]
    );
    let uneven = [labels(&[("policy", "beta")]), labels(&[])];
    let found = found(kind, &with(&["policy"]), SCORES, &uneven);
    assert_eq!(found[0].1, "an artifact at `scores` has no label `policy`; its labels are none");
}

#[test]
fn the_axis_of_a_comparison_and_the_names_of_a_leaderboard_are_required() {
    let with = |axis: &str| json!({"title": "t", "profile": "p", "axis": axis, "base": "beta"});
    let compare = Kind::of::<Compare>();
    assert_eq!(found(compare, &with("policy"), SCORES, &two_policies()), []);
    assert_eq!(paths(&found(compare, &with("polcy"), SCORES, &two_policies())), ["axis"]);
    let (board, with) = (Kind::of::<Leaderboard>(), json!({"title": "t", "profile": "p"}));
    assert_eq!(found(board, &with, SCORES, &[labels(&[("name", "PPO")])]), []);
    let found = found(board, &with, SCORES, &[labels(&[("name", "PPO")]), labels(&[("policy", "beta")])]);
    assert!(
        found[0].1.starts_with("an evaluation at `scores` has no name; give each item a name"),
        "{found:?}"
    );
}

#[test]
fn labels_of_claims_are_required_on_some_cell_and_those_of_trainings_on_all() {
    let with_best = |left: &str, trainings: &str, best_of: &str| {
        json!({"title": "t", "profile": "p", "trainings": [trainings], "claims": [{
            "claim": "c", "is": "greater", "left": {left: "beta"}, "right": {"policy": "gaussian"},
            "where": {"mode": "stochastic"}, "best_of": [best_of],
        }]})
    };
    let with = |left: &str, trainings: &str| with_best(left, trainings, "mode");
    let all = two_policies().map(|mut labels| {
        labels.insert("mode".to_owned(), "stochastic".to_owned());
        labels
    });
    let kind = Kind::of::<Findings>();
    assert_eq!(found(kind, &with("policy", "seed"), SCORES, &all), []);
    let wrong = found(kind, &with("polcy", "sed"), SCORES, &all);
    assert_eq!(paths(&wrong), ["trainings.0", "claims.0.left.polcy"]);
    let wrong = found(kind, &with_best("policy", "seed", "mod"), SCORES, &all);
    assert_eq!(paths(&wrong), ["claims.0.best_of.0"]);
    assert!(wrong[0].2.starts_with("did you mean `mode`?"), "{wrong:?}");
    // A claim may be about some of the cells only.
    let more = [&all[..], &[labels(&[("seed", "1")])]].concat();
    assert_eq!(found(kind, &with("policy", "seed"), SCORES, &more), []);
}

#[test]
fn two_evaluations_with_the_same_labels_are_found_whatever_reads_them() {
    let twice = [&two_policies()[..], &two_policies()[1..]].concat();
    let message = "items 2 and 3 at `scores` have the same labels (policy=gaussian, seed=1), expected each combination once; \
                   wire each stage once, or give the items names, as in `scores: { first: ..., second: ... }`";
    let claim =
        json!({"claim": "c", "is": "greater", "left": {"policy": "beta"}, "right": {"policy": "gaussian"}});
    for (kind, params) in [
        (Kind::of::<Table>(), json!({"title": "t", "profile": "p", "keys": ["policy"]})),
        (Kind::of::<Compare>(), json!({"title": "t", "profile": "p", "axis": "policy", "base": "beta"})),
        (Kind::of::<Findings>(), json!({"title": "t", "profile": "p", "claims": [claim]})),
        (Kind::of::<Select>(), json!({})),
    ] {
        assert_eq!(found(kind, &params, SCORES, &two_policies()), [], "{}", kind.name());
        assert_eq!(found(kind, &params, SCORES, &twice)[0].1, message, "{}", kind.name());
    }
    let named = ["PPO", "PPO"].map(|name| labels(&[("name", name)]));
    let board = json!({"title": "t", "profile": "p"});
    assert!(found(Kind::of::<Leaderboard>(), &board, SCORES, &named)[0].1.starts_with("items 1 and 2 at"));
    let figure = json!({"title": "t", "preset": "scores"});
    assert!(found(Kind::of::<Figure>(), &figure, DATA, &twice)[0].1.starts_with("items 2 and 3 at `data`"));
}

#[test]
fn a_label_of_a_figure_may_be_a_column_so_it_is_only_checked_where_the_columns_are_known() {
    let with = |field: &str, label: &str| json!({"title": "t", "preset": "scores", field: [label]});
    let kind = Kind::of::<Figure>();
    for field in ["rows", "columns", "colour", "categories"] {
        for label in ["policy", "outcome", "track_seed", "measure", "column"] {
            assert_eq!(found(kind, &with(field, label), DATA, &two_policies()), [], "{field} {label}");
        }
        let hint = "did you mean `policy`? the labels at `data` are `policy`, `seed`";
        assert_eq!(
            found(kind, &with(field, "polcy"), DATA, &two_policies()),
            [(format!("{field}.0"), "unknown label `polcy`".to_owned(), hint.to_owned())]
        );
        assert_eq!(found(kind, &with(field, "polcy"), ("data", None), &two_policies()), []);
    }
    // One figure serves one seed or several.
    assert_eq!(found(kind, &with("pool", "training"), DATA, &two_policies()), []);
}

#[test]
fn a_column_that_the_files_of_a_figure_cannot_have_is_found_with_the_one_that_was_meant() {
    let kind = Kind::of::<Figure>();
    let y = json!(["score", "sc*", "scroe", { "title": "both", "columns": ["steps", "stebs", "x*"], "mark": { "column": "m", "label": "m" } }]);
    let params = json!({ "title": "T", "x": "epizode", "y": y, "layers": { "histogram": {} } });
    let wrong = found(kind, &params, DATA, &two_policies());
    assert_eq!(paths(&wrong), ["x", "y.2", "y.3.columns.1", "y.3.columns.2", "y.3.mark.column"]);
    assert_eq!(wrong[0].1, "unknown column `epizode`");
    assert!(
        wrong[0].2.starts_with("did you mean `episode`? the columns of a file at `data` are `episode`, ")
    );
    assert_eq!(found(kind, &params, ("data", None), &two_policies()), []);
    // A preset names columns, too.
    let curve = json!({ "title": "T", "preset": "curve" });
    assert_eq!(paths(&found(kind, &curve, DATA, &two_policies())), ["x", "y.0"]);
}
