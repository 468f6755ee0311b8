//! From a pipeline file to its stage instances: parameters, matrices, wiring, profiles and overrides.

use std::collections::BTreeMap;

use dril_pipe::resolve::{Choices, Graph, Origin, StageInstance, resolve};
use dril_pipe::spec::{Diagnostics, SourceName, parse};
use dril_stage_api::Seed;
use proptest::prelude::*;
use serde_json::{Value, json};

use crate::samples;

fn name() -> SourceName {
    SourceName("sample.yaml".to_owned())
}

fn try_graph(text: &str, profile: Option<&str>, set: &[&str]) -> Result<Graph, Diagnostics> {
    let choices = Choices {
        profile: profile.map(str::to_owned),
        set: set.iter().map(|set| (*set).to_owned()).collect(),
        ..Choices::default()
    };
    resolve(&parse(text, &name())?, &choices, &samples::registry())
}

fn graph_of(text: &str, profile: Option<&str>, set: &[&str]) -> Graph {
    try_graph(text, profile, set).unwrap_or_else(|said| panic!("{said}"))
}

/// Stages under a name, which every file needs.
fn graph(stages: &str) -> Graph {
    graph_of(&format!("name: sample\n{stages}"), None, &[])
}

fn instance<'g>(graph: &'g Graph, id: &str) -> &'g StageInstance {
    let found = graph.stages.node_weights().find(|stage| &*stage.id == id);
    found.unwrap_or_else(|| panic!("no {id} in {:?}", ids(graph)))
}

fn ids(graph: &Graph) -> Vec<&str> {
    graph.stages.node_weights().map(|stage| &*stage.id).collect()
}

/// What is wired to an input: `stage[...].output` or the file's path, with the labels.
fn wired(graph: &Graph, id: &str, port: &str) -> Vec<(String, BTreeMap<String, String>)> {
    let wire = instance(graph, id).inputs.iter().find(|wire| wire.port == port);
    let sources = wire.map(|wire| wire.sources.as_slice()).unwrap_or_default();
    let shown = sources.iter().map(|source| {
        let from = match &source.from {
            Origin::Stage { stage, output } => format!("{}.{output}", graph.stages[*stage].id),
            Origin::File { path, .. } => path.clone(),
        };
        (from, source.labels.clone())
    });
    shown.collect()
}

fn wired_names(graph: &Graph, id: &str, port: &str) -> Vec<String> {
    wired(graph, id, port).into_iter().map(|(from, _)| from).collect()
}

const TRAIN: &str = "stages: { train: { kind: train, with: { steps: 5 } } }";

#[test]
fn the_sample_resolves_in_both_profiles() {
    let text = include_str!("sample.yaml");
    let full = graph_of(text, None, &[]);
    assert_eq!((full.pipeline.as_str(), full.profile.as_str()), ("sample", "full"));
    assert_eq!(full.stages.node_count(), 4 + 4 + 2 + 8 + 2);
    assert_eq!(graph_of(text, Some("smoke"), &[]).stages.node_count(), 1 + 2 + 1 + 4 + 2);
}

#[test]
fn instances_are_named_by_their_coordinates_and_the_last_axis_is_the_fastest() {
    let graph = graph(
        "axes: { seed: [1, 2], policy: [gaussian, beta] }\n\
         stages: { train: { kind: train, matrix: [policy, seed], with: { steps: 5, policy: $policy } } }",
    );
    let expected = [
        "train[policy=gaussian, seed=1]",
        "train[policy=gaussian, seed=2]",
        "train[policy=beta, seed=1]",
        "train[policy=beta, seed=2]",
    ];
    assert_eq!(ids(&graph), expected);
    assert_eq!(instance(&graph, expected[2]).params["policy"], "beta");
}

#[test]
fn a_matrix_mixes_shared_axes_with_values_of_its_own() {
    let graph = graph(
        "axes: { seed: [1, 2], expert: { a: { steps: 5 }, b: { steps: 6 } } }\n\
         stages:\n  x: { kind: train, matrix: { steps: [7, 8] }, with: { steps: $steps } }\n  \
         y: { kind: train, matrix: [seed, { expert: [b] }], with: { steps: $expert.steps } }",
    );
    assert_eq!(ids(&graph), ["x[steps=7]", "x[steps=8]", "y[seed=1, expert=b]", "y[seed=2, expert=b]"]);
    assert_eq!(instance(&graph, "y[seed=1, expert=b]").params["steps"], 6);
}

#[test]
fn a_reference_alone_keeps_its_type_and_inside_a_text_it_becomes_text() {
    let graph = graph(
        "params: { size: 5, rate: 0.5, track: { track: { laps: $size } }, layers: [1, $size], label: \"n=${size}\" }\n\
         stages:\n  train: { kind: train, with: { steps: $size, learning_rate: '${rate}', env: $track, layers: $layers } }\n  \
         table: { kind: tabulate, with: { title: \"${label}, $$5, ${profile}/${pipeline}\" }, inputs: { scores: { file: a.csv } } }",
    );
    let params = &instance(&graph, "train").params;
    assert_eq!(params["steps"], json!(5));
    assert_eq!(params["learning_rate"], json!(0.5));
    assert_eq!(params["env"], json!({"track": {"laps": 5}}));
    assert_eq!(params["layers"], json!([1, 5]));
    assert_eq!(instance(&graph, "table").params["title"], "n=5, $5, default/sample");
}

#[test]
fn with_may_be_one_reference_and_a_profile_still_changes_a_field_of_it() {
    let text = "name: sample\nparams: { base: { steps: 5, env: { track: { laps: 2 } } } }\n\
                stages: { train: { kind: train, with: $base } }\n\
                profiles: { full: {}, fast: { train: { env: { track: { laps: 1 } } } } }";
    assert_eq!(instance(&graph_of(text, None, &[]), "train").params["env"], json!({"track": {"laps": 2}}));
    let fast = graph_of(text, Some("fast"), &[]);
    assert_eq!(instance(&fast, "train").params["env"], json!({"track": {"laps": 1}}));
    assert_eq!(instance(&fast, "train").params["steps"], 5);
}

#[test]
fn set_goes_over_profile_over_stage_over_defaults() {
    let text = |profile: &str| {
        format!(
            "name: sample\ndefaults: {{ train: {{ with: {{ steps: 1, learning_rate: 0.1 }} }} }}\n\
             stages: {{ train: {{ kind: train, with: {{ steps: 2 }} }}, plain: {{ kind: train }} }}\n\
             profiles: {{ p: {profile} }}"
        )
    };
    let steps = |profile: &str, set: &[&str]| {
        instance(&graph_of(&text(profile), None, set), "train").params["steps"].clone()
    };
    assert_eq!(steps("{}", &[]), 2);
    assert_eq!(steps("{ train: { steps: 3 } }", &[]), 3);
    assert_eq!(steps("{ train: { steps: 3 } }", &["train.steps=4"]), 4);
    assert_eq!(steps("{}", &["train.steps=4", "train.steps=5"]), 5);
    // A profile's defaults are still defaults: what the stage says of itself holds.
    assert_eq!(steps("{ defaults: { train: { with: { steps: 9 } } } }", &[]), 2);
    let graph = graph_of(&text("{ defaults: { train: { with: { steps: 9 } } } }"), None, &[]);
    assert_eq!(instance(&graph, "plain").params["steps"], 9);
    assert_eq!(instance(&graph, "plain").params["learning_rate"], 0.1);
}

#[test]
fn a_later_set_of_the_same_field_replaces_an_earlier_sweep() {
    let text = "name: sample\nstages: { train: { kind: train, with: { steps: 5 } } }";
    for (set, expected) in [
        (&["train.steps=1,2", "train.steps=7"][..], &["train"][..]),
        (&["train.steps=7", "train.steps=1,2"], &["train[steps=1]", "train[steps=2]"]),
        (&["train.steps=1,2", "train.steps=3,4"], &["train[steps=3]", "train[steps=4]"]),
        (&["train.steps=1,2", "train={ steps: 7 }"], &["train"]),
        (&["train.env.track.laps=1,2", "train.env.track=!replace {}"], &["train"]),
        (&["train.env.track.laps=1,2", "train.env=!replace { maze: { size: 2 } }"], &["train"]),
        (&["train.env.track.laps=1,2", "train.env.track={ laps: 3 }"], &["train"]),
        // What does not touch the field leaves the sweep alone.
        (&["train.steps=1,2", "train.anneal=true"], &["train[steps=1]", "train[steps=2]"]),
        (&["train.env.track.laps=1,2", "train.env.track={}"], &["train[laps=1]", "train[laps=2]"]),
    ] {
        assert_eq!(ids(&graph_of(text, None, set)), expected, "{set:?}");
    }
    let last = graph_of(text, None, &["train.steps=1,2", "train.steps=7"]);
    assert_eq!(instance(&last, "train").params["steps"], 7);
}

#[test]
fn the_order_of_the_variables_that_are_passed_to_a_command_does_not_change_its_parameters() {
    let params = |names: &str| {
        let text = format!(
            "stages: {{ c: {{ kind: command, with: {{ run: [x], outputs: {{ o: ~ }}, pass_env: {names} }} }} }}"
        );
        instance(&graph(&text), "c").params.clone()
    };
    assert_eq!(params("[TOKEN, PROXY]"), params("[PROXY, TOKEN]"));
    assert_eq!(params("[TOKEN, PROXY, TOKEN]"), params("[PROXY, TOKEN]"));
    assert_ne!(params("[TOKEN]"), params("[PROXY, TOKEN]"));
}

#[test]
fn the_notation_of_a_commands_files_does_not_change_its_parameters() {
    let params = |outputs: &str, inputs: &str| {
        let text = format!(
            "stages: {{ c: {{ kind: command, with: {{ run: [x, \"{{inputs.i}}\"], outputs: {outputs}, inputs: {inputs} }}, \
             inputs: {{ i: {{ file: f }} }} }} }}"
        );
        let graph = graph(&text);
        instance(&graph, "c").params.clone()
    };
    for same in [
        &[
            "{ o: ~ }",
            "{ o: {} }",
            "{ o: { type: file } }",
            "{ o: outputs/o.bin }",
            "{ o: ./outputs//o.bin }",
        ][..],
        &["{ o: o.csv }", "{ o: { path: o.csv } }", "{ o: { type: file, path: ./o.csv } }"],
        &["{ o: m/ }", "{ o: { type: folder, path: m } }", "{ o: { path: ./m// } }"],
        &["{ o: { type: table } }", "{ o: { type: table, path: outputs/o.csv } }"],
        &["{ o: { type: folder } }", "{ o: outputs/o/ }", "{ o: { type: folder, path: outputs/o/ } }"],
    ] {
        for other in same {
            assert_eq!(params(other, "{}"), params(same[0], "{}"), "{other}");
        }
    }
    for same in [
        &[
            "{}",
            "{ i: ~ }",
            "{ i: {} }",
            "{ i: inputs/i }",
            "{ i: { path: ./inputs/i, type: any, many: false } }",
        ][..],
        &["{ i: data/ }", "{ i: { path: data, type: folder } }"],
        &["{ i: data }", "{ i: { path: ./data, type: any } }"],
        &["{ i: { type: folder } }", "{ i: inputs/i/ }"],
    ] {
        for other in same {
            assert_eq!(params("{ o: ~ }", other), params("{ o: ~ }", same[0]), "{other}");
        }
    }
    assert_eq!(params("{ o: ~ }", "{}")["outputs"], json!({ "o": {} }), "the usual notation keeps its key");
    assert_ne!(
        params("{ o: ~ }", "{}"),
        params("{ o: ~ }", "{ j: { optional: true } }"),
        "an input of its own"
    );
    assert_ne!(params("{ o: { type: table } }", "{}"), params("{ o: ~ }", "{}"));
}

#[test]
fn set_reaches_params_axes_defaults_and_the_seed() {
    let text = "name: sample\nparams: { car: { track: { laps: 2 } } }\naxes: { seed: [1, 2] }\n\
                stages: { train: { kind: train, matrix: [seed], with: { steps: 5, env: $car } } }";
    let set = ["params.car.track.laps=50", "axes.seed=9", "seed=3", "defaults.train.with.learning_rate=0.5"];
    let graph = graph_of(text, None, &set);
    let train = instance(&graph, "train[seed=9]");
    assert_eq!(train.params["env"], json!({"track": {"laps": 50}}));
    assert_eq!(train.params["learning_rate"], 0.5);
    assert_eq!(train.seed, Some(Seed(3)));
}

#[test]
fn a_list_over_an_axis_with_fields_chooses_among_its_values() {
    let text = "name: sample\naxes: { expert: { a: { steps: 5 }, b: { steps: 6 }, c: { steps: 7 } } }\n\
                stages: { train: { kind: train, matrix: [expert], with: { steps: $expert.steps } } }";
    let graph = graph_of(text, None, &["axes.expert=[c, a]"]);
    assert_eq!(ids(&graph), ["train[expert=c]", "train[expert=a]"]);
    assert_eq!(instance(&graph, "train[expert=c]").params["steps"], 7);
    assert_eq!(ids(&graph_of(text, None, &["axes.expert=c"])), ["train[expert=c]"]);
    let more = graph_of(text, None, &["axes.expert={ b: { steps: 8 }, d: { steps: 9 } }"]);
    assert_eq!(more.stages.node_count(), 4);
    assert_eq!(instance(&more, "train[expert=b]").params["steps"], 8);
}

#[test]
fn a_map_tagged_replace_takes_the_place_of_what_it_overrides() {
    let graph = graph(
        "defaults: { train: { with: { steps: 5, env: { track: { laps: 2 } } } } }\n\
         stages: { train: { kind: train, with: { env: !replace { maze: { size: 4 } } } } }",
    );
    assert_eq!(instance(&graph, "train").params["env"], json!({"maze": {"size": 4}}));
}

#[test]
fn seeds_come_from_the_stage_or_the_pipeline_and_a_kind_without_chance_has_none() {
    let graph = graph(
        "seed: 7\naxes: { seed: [1, 18446744073709551615] }\nstages:\n  \
         own: { kind: train, matrix: [seed], seed: $seed, with: { steps: 5 } }\n  \
         pipelines: { kind: train, with: { steps: 5 } }\n  \
         table: { kind: tabulate, inputs: { scores: { file: a.csv } } }",
    );
    assert_eq!(instance(&graph, "own[seed=1]").seed, Some(Seed(1)));
    assert_eq!(instance(&graph, "own[seed=18446744073709551615]").seed, Some(Seed(u64::MAX)));
    assert_eq!(instance(&graph, "pipelines").seed, Some(Seed(7)));
    assert_eq!(instance(&graph, "table").seed, None);
    assert_eq!(instance(&self::graph(TRAIN), "train").seed, Some(Seed(0)));
}

#[test]
fn an_axis_that_both_stages_have_connects_equal_values() {
    let graph = graph(
        "axes: { seed: [1, 2], mode: [a, b] }\nstages:\n  \
         train: { kind: train, matrix: [seed], with: { steps: 5 } }\n  \
         score: { kind: score, matrix: [mode, seed], inputs: { policy: train } }",
    );
    assert_eq!(
        wired(&graph, "score[mode=b, seed=2]", "policy"),
        [("train[seed=2].policy".to_owned(), BTreeMap::new())]
    );
    assert_eq!(graph.stages.edge_count(), 4);
}

#[test]
fn a_fan_in_takes_all_in_the_order_of_the_matrix_with_labels() {
    let graph = graph(
        "axes: { seed: [2, 1], mode: [b, a] }\nstages:\n  \
         train: { kind: train, matrix: [seed], with: { steps: 5 } }\n  \
         score: { kind: score, matrix: [mode, seed], inputs: { policy: train } }\n  \
         table: { kind: tabulate, matrix: [mode], inputs: { scores: score } }\n  \
         all: { kind: tabulate, inputs: { scores: \"score[mode=a|b, seed=*].scores\" } }",
    );
    let found = wired(&graph, "table[mode=a]", "scores");
    assert_eq!(found.len(), 2);
    assert_eq!(found[0].0, "score[mode=a, seed=2].scores");
    assert_eq!(json!(found[0].1), json!({"mode": "a", "seed": "2"}));
    let all = wired_names(&graph, "all", "scores");
    assert_eq!(all[0], "score[mode=b, seed=2].scores");
    assert_eq!(all.len(), 4);
}

#[test]
fn wiring_looks_names_up_alone_and_inside_brackets() {
    let graph = graph(
        "params: { chosen: [2, 3], one: 1 }\n\
         axes: { seed: [1, 2, 3], weights: { best: { from: imitate.best }, last: { from: \"imitate.last\" } } }\nstages:\n  \
         train: { kind: train, matrix: [seed], with: { steps: 5 } }\n  \
         record: { kind: record, inputs: { policy: \"train[seed=$one].${word}\" } }\n  \
         imitate: { kind: imitate, inputs: { demonstrations: record } }\n  \
         score: { kind: score, matrix: [weights], inputs: { policy: $weights.from } }\n  \
         each: { kind: score, matrix: [seed], inputs: { policy: train } }\n  \
         table: { kind: tabulate, inputs: { scores: \"each[seed=$chosen]\" } }"
            .replace("${word}", "policy")
            .as_str(),
    );
    assert_eq!(wired_names(&graph, "record", "policy"), ["train[seed=1].policy"]);
    assert_eq!(wired_names(&graph, "score[weights=last]", "policy"), ["imitate.last"]);
    assert_eq!(wired_names(&graph, "table", "scores"), ["each[seed=2].scores", "each[seed=3].scores"]);
}

#[test]
fn a_fan_in_takes_lists_names_and_files() {
    let graph = graph(
        "axes: { mode: [a, b] }\nstages:\n  \
         train: { kind: train, with: { steps: 5 } }\n  \
         score: { kind: score, matrix: [mode], inputs: { policy: train.policy } }\n  \
         list: { kind: tabulate, inputs: { scores: [\"score[mode=b]\", \"score[mode=a]\", { file: old.csv }] } }\n  \
         named: { kind: tabulate, inputs: { scores: { all of it: score, old: { file: \"${pipeline}.csv\" } } } }",
    );
    assert_eq!(
        wired_names(&graph, "list", "scores"),
        ["score[mode=b].scores", "score[mode=a].scores", "old.csv"]
    );
    let named = wired(&graph, "named", "scores");
    assert_eq!(json!(named[1]), json!(["score[mode=b].scores", {"mode": "b", "name": "all of it"}]));
    assert_eq!(json!(named[2]), json!(["sample.csv", {"name": "old"}]));
}

#[test]
fn a_file_knows_where_the_pipeline_file_names_it() {
    let graph = graph("stages:\n  table: { kind: tabulate, inputs: { scores: { file: a.csv } } }");
    let Origin::File { path, place, .. } = &instance(&graph, "table").inputs[0].sources[0].from else {
        panic!()
    };
    assert_eq!((path.as_str(), place.as_str()), ("a.csv", "sample.yaml:3:54"));
}

#[test]
fn default_wiring_holds_unless_a_stage_says_otherwise_or_nothing() {
    let text = "name: sample\ndefaults: { tabulate: { inputs: { scores: { file: d.csv }, reference: { file: r.csv } } } }\nstages:\n  \
                plain: { kind: tabulate }\n  other: { kind: tabulate, inputs: { reference: { file: o.csv } } }\n  \
                none: { kind: tabulate, inputs: { reference: ~ } }";
    let graph = graph_of(text, None, &[]);
    assert_eq!(wired_names(&graph, "plain", "reference"), ["r.csv"]);
    assert_eq!(wired_names(&graph, "other", "reference"), ["o.csv"]);
    assert!(wired(&graph, "none", "reference").is_empty());
    let set = graph_of(text, None, &["defaults.tabulate.inputs.reference.file=s.csv"]);
    assert_eq!(wired_names(&set, "plain", "reference"), ["s.csv"]);
}

#[test]
fn the_output_of_the_right_type_is_found_without_naming_it() {
    let graph = graph(
        "stages:\n  train: { kind: train, with: { steps: 5 } }\n  score: { kind: score, inputs: { policy: train } }",
    );
    assert_eq!(wired_names(&graph, "score", "policy"), ["train.policy"]);
}

#[test]
fn a_stage_may_read_other_instances_of_itself() {
    let graph = graph(
        "axes: { round: { first: { before: start }, second: { before: 'table[round=first]' } } }\nstages:\n  \
         start: { kind: tabulate, inputs: { scores: { file: a.csv } } }\n  \
         table: { kind: tabulate, matrix: [round], inputs: { scores: { file: a.csv }, reference: $round.before } }",
    );
    assert_eq!(wired_names(&graph, "table[round=first]", "reference"), ["start.table"]);
    assert_eq!(wired_names(&graph, "table[round=second]", "reference"), ["table[round=first].table"]);
    assert_eq!(graph.stages.edge_count(), 2);
}

#[test]
fn without_a_choice_the_first_profile_holds_and_without_profiles_the_default_one() {
    let text =
        format!("name: sample\n{TRAIN}\nprofiles: {{ slow: {{ train: {{ steps: 6 }} }}, fast: {{}} }}");
    let graph = graph_of(&text, None, &[]);
    assert_eq!((graph.profile.as_str(), &instance(&graph, "train").params["steps"]), ("slow", &json!(6)));
    let plain = format!("name: sample\n{TRAIN}");
    assert_eq!(graph_of(&plain, None, &[]).profile, "default");
    assert_eq!(graph_of(&plain, Some("default"), &[]).profile, "default");
}

#[test]
fn aliases_of_yaml_are_values_like_others() {
    let graph = graph(
        "params: { a: &x [1, 2], b: *x }\nstages: { train: { kind: train, with: { steps: 5, layers: $b } } }",
    );
    assert_eq!(instance(&graph, "train").params["layers"], json!([1, 2]));
}

/// A value in YAML, in block or flow style.
fn yaml(value: &Value, block: bool, indent: usize) -> String {
    match value {
        Value::Object(map) if block && !map.is_empty() => map
            .iter()
            .map(|(key, value)| format!("\n{:indent$}{key}: {}", "", yaml(value, block, indent + 2)))
            .collect(),
        // JSON is YAML.
        other => other.to_string(),
    }
}

fn params() -> impl Strategy<Value = Vec<(String, Value)>> {
    let steps = (1..1_000_000_u64).prop_map(|n| ("steps".to_owned(), json!(n)));
    let rate = (1e-9..1.0_f64).prop_map(|x| ("learning_rate".to_owned(), json!(x)));
    let layers = proptest::collection::vec(0..512_u32, 0..4).prop_map(|n| ("layers".to_owned(), json!(n)));
    let env = (1..9_u32).prop_map(|n| ("env".to_owned(), json!({"track": {"laps": n}})));
    let anneal = any::<bool>().prop_map(|b| ("anneal".to_owned(), json!(b)));
    let policy = prop_oneof![Just("gaussian"), Just("beta")].prop_map(|p| ("policy".to_owned(), json!(p)));
    (steps, rate, layers, env, anneal, policy).prop_map(|(a, b, c, d, e, f)| vec![a, b, c, d, e, f])
}

proptest! {
    #[test]
    fn order_comments_and_style_do_not_change_the_parameters(
        (given, shuffled) in params().prop_flat_map(|list| (Just(list.clone()), Just(list).prop_shuffle())),
        block: bool,
        comments in proptest::collection::vec("[ -~]{0,20}", 6),
    ) {
        let text = |list: &[(String, Value)], block: bool, comments: &[String]| {
            let mut text = "name: sample\nstages:\n  train:\n    kind: train\n    with:\n".to_owned();
            for (at, (key, value)) in list.iter().enumerate() {
                let comment = comments.get(at).map(|comment| format!("  # {comment}\n\n")).unwrap_or_default();
                text.push_str(&format!("{comment}      {key}: {}\n", yaml(value, block, 8)));
            }
            text
        };
        let plain = graph_of(&text(&given, false, &[]), None, &[]);
        let other = graph_of(&text(&shuffled, block, &comments), None, &[]);
        prop_assert_eq!(&instance(&plain, "train").params, &instance(&other, "train").params);
        for (key, value) in &given {
            prop_assert_eq!(&instance(&plain, "train").params[key.as_str()], value);
        }
    }

    #[test]
    fn a_random_matrix_expands_to_its_product_in_order(
        axes in proptest::collection::vec((any::<bool>(), proptest::collection::btree_set(0..50_u32, 1..4)), 0..4),
    ) {
        let mut shared = String::new();
        let mut matrix = Vec::new();
        let mut expected = vec![String::new()];
        for (at, (inline, values)) in axes.iter().enumerate() {
            // Backwards: the order is the file's, not that of the values.
            let values: Vec<String> = values.iter().rev().map(u32::to_string).collect();
            let list = format!("a{at}: [{}]", values.join(", "));
            if *inline {
                matrix.push(format!("{{ {list} }}"));
            } else {
                shared.push_str(&format!("  {list}\n"));
                matrix.push(format!("a{at}"));
            }
            let comma = if at == 0 { "" } else { ", " };
            expected = expected.iter().flat_map(|before| values.iter().map(move |value| format!("{before}{comma}a{at}={value}"))).collect();
        }
        let shared = if shared.is_empty() { String::new() } else { format!("axes:\n{shared}") };
        let text = format!("{shared}stages:\n  train: {{ kind: train, matrix: [{}], with: {{ steps: 5 }} }}", matrix.join(", "));
        let expected: Vec<String> = expected.iter().map(|at| if axes.is_empty() { "train".to_owned() } else { format!("train[{at}]") }).collect();
        let graph = graph(&text);
        prop_assert_eq!(ids(&graph), expected);
        for stage in graph.stages.node_weights() {
            prop_assert_eq!(stage.coordinates.len(), axes.len());
        }
    }
}
