//! The pipeline files that come with the program, against the kinds that come with it.

use std::collections::BTreeMap;
use std::path::Path;

use dril_envs::DEMONSTRATIONS;
use dril_kinds::artifacts::POLICY;
use dril_pipe::plan::{KeyInput, KeyInputs, warnings};
use dril_pipe::resolve::{Choices, Graph, Origin, Source, resolve};
use dril_pipe::spec::{SourceName, Spec, parse, parse_with};
use dril_pipe::store::{Digest, Key};
use dril_stage_api::{Kind, Registry};

fn registry() -> Registry {
    dril_stage_api::artifact::register(&[POLICY, DEMONSTRATIONS]).unwrap();
    let engine = &dril_pipe::kinds::KINDS[..];
    let kinds: Vec<Kind> = [engine, &dril_kinds::KINDS, &dril_envs::KINDS, &dril_report::KINDS].concat();
    Registry::new(kinds).unwrap()
}

fn text(file: &str) -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines").join(file)).unwrap()
}

fn graph(profile: &str, set: &[&str]) -> Graph {
    graph_of("thesis.yaml", profile, set)
}

fn spec_of(file: &str) -> Spec {
    let mut load = |path: &str| Ok(text(path).into_bytes());
    parse_with(text(file).as_bytes(), &SourceName(format!("pipelines/{file}")), &mut load).unwrap()
}

fn graph_of(file: &str, profile: &str, set: &[&str]) -> Graph {
    let spec = spec_of(file);
    let set = set.iter().map(|set| (*set).to_owned()).collect();
    let choices = Choices { profile: Some(profile.to_owned()), set, ..Choices::default() };
    resolve(&spec, &choices, &registry()).unwrap_or_else(|said| panic!("{said}"))
}

fn instances(graph: &Graph) -> BTreeMap<String, usize> {
    let mut counts = BTreeMap::new();
    for stage in graph.stages.node_weights() {
        *counts.entry(stage.name.to_string()).or_default() += 1;
    }
    counts
}

#[test]
fn the_thesis_resolves_at_every_profile() {
    let spec = spec_of("thesis.yaml");
    let profiles: Vec<&str> = spec.profiles().collect();
    assert_eq!(profiles, ["thesis", "desk", "smoke"]);
    for (profile, seeds) in profiles.into_iter().zip([5, 0, 2]) {
        let counts = instances(&graph(profile, &[]));
        for (stage, count) in [
            // At `desk` the experts are agents that were trained before.
            ("train-expert", 2 * seeds),
            ("choose-expert", if seeds > 0 { 2 } else { 0 }),
            ("kept-expert", if seeds > 0 { 0 } else { 2 }),
            ("dataset", 4),
            ("clone", 8),
            ("ensemble", 4),
            ("dril", 8),
            ("evaluate", 48),
        ] {
            assert_eq!(counts.get(stage).copied().unwrap_or(0), count, "{stage} at {profile}");
        }
    }
}

#[test]
fn every_pipeline_resolves_at_every_profile() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines");
    let mut seen = 0;
    for entry in std::fs::read_dir(&folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|ending| ending != "yaml") {
            continue;
        }
        let file = path.file_name().unwrap().to_str().unwrap();
        let spec = spec_of(file);
        let profiles: Vec<&str> = spec.profiles().collect();
        assert!(profiles.contains(&"smoke"), "{file} has no profile that takes minutes");
        for profile in profiles {
            let graph = graph_of(file, profile, &[]);
            assert!(graph.stages.node_count() > 1, "{file} at {profile}");
            let warned = warnings(&graph, &graph, &folder);
            assert!(warned.is_empty(), "{file} at {profile}: {warned:?}");
            seen += 1;
        }
    }
    assert!(seen >= 6);
}

#[test]
fn the_schema_fits_every_pipeline() {
    let schema = dril_pipe::spec::schema(&registry());
    jsonschema::meta::validate(&schema).unwrap();
    let schema = jsonschema::validator_for(&schema).unwrap();
    for entry in std::fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|ending| ending != "yaml") {
            continue;
        }
        let value: serde_json::Value =
            serde_saphyr::from_str(&std::fs::read_to_string(&path).unwrap()).unwrap();
        let errors: Vec<String> =
            schema.iter_errors(&value).map(|error| format!("{}: {error}", error.instance_path())).collect();
        assert!(errors.is_empty(), "{}: {errors:#?}", path.display());
    }
}

#[test]
fn the_annexs_experts_are_those_of_the_thesis() {
    let experts = |graph: &Graph| {
        let mut found: Vec<_> = graph
            .stages
            .node_weights()
            .filter(|stage| stage.kind.name() == "ppo")
            .map(|stage| format!("{:?} {:?}", stage.seed, stage.params))
            .collect();
        found.sort();
        found
    };
    let (annex, thesis) = (graph_of("expert.yaml", "annex", &[]), graph("thesis", &[]));
    assert_eq!(experts(&annex).len(), 10);
    assert_eq!(experts(&annex), experts(&thesis));
}

#[test]
fn the_control_trains_as_the_thesis_does_except_for_the_reward() {
    let training = |graph: &Graph, id: &str| {
        let stage = graph.stages.node_weights().find(|stage| &*stage.id == id);
        let stage = stage.unwrap_or_else(|| panic!("no {id}"));
        (stage.seed, stage.params.clone())
    };
    let control = graph_of("constant_reward.yaml", "desk", &[]);
    for (label, reward) in [("ensemble", "plus-minus-one"), ("constant", "constant")] {
        let thesis = graph("desk", &[&format!("dril.reward={reward}")]);
        for cell in [
            "expert=bounded, policy=gaussian, demonstrations=1",
            "expert=clipped, policy=gaussian, demonstrations=20",
        ] {
            let here = format!("dril-by-reward[{cell}, reward={label}, training=1]");
            assert_eq!(training(&control, &here), training(&thesis, &format!("dril[{cell}]")), "{here}");
        }
    }
}

#[test]
fn the_lunar_lander_resolves_at_every_profile() {
    for (profile, seeds) in [("full", 5), ("smoke", 2)] {
        let counts = instances(&graph_of("lunar_lander.yaml", profile, &[]));
        for (stage, count) in [
            ("train-expert", 2 * seeds),
            ("score-expert", 4 * seeds),
            ("choose-expert", 1),
            ("clone", 2),
            ("dril", 2),
            ("evaluate", 12),
        ] {
            assert_eq!(counts.get(stage).copied().unwrap_or(0), count, "{stage} at {profile}");
        }
    }
}

#[test]
fn the_tables_read_the_evaluations_that_they_show() {
    let graph = graph("thesis", &[]);
    for (table, cells) in [("table12", 2), ("table20", 8), ("table22", 48)] {
        let stage = graph.stages.node_weights().find(|stage| &*stage.name == table).unwrap();
        let scores = stage.inputs.iter().find(|wire| wire.port == "scores").unwrap();
        assert_eq!(scores.sources.len(), cells, "{table}");
    }
}

#[test]
fn a_number_set_on_the_command_line_reaches_its_stages_only() {
    let (before, after) = (graph("smoke", &[]), graph("smoke", &["dril.total_timesteps=4096"]));
    let changed: Vec<&str> = before
        .stages
        .node_weights()
        .zip(after.stages.node_weights())
        .filter(|(before, after)| before.params != after.params)
        .map(|(before, _)| &*before.name)
        .collect();
    assert_eq!(changed, ["dril"; 8]);
}

#[test]
fn the_example_that_opens_the_reference_resolves() {
    let page =
        std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/pipeline-file.md")).unwrap();
    let example = page.split("```yaml\n").nth(1).unwrap().split("```").next().unwrap();
    let spec = parse(example, &SourceName("docs/pipeline-file.md".to_owned())).unwrap();
    let graph = resolve(&spec, &Choices::default(), &registry()).unwrap_or_else(|said| panic!("{said}"));
    let ids: Vec<&str> = graph.stages.node_weights().map(|stage| &*stage.id).collect();
    assert_eq!(
        ids,
        [
            "train[policy=gaussian]",
            "train[policy=beta]",
            "score[policy=gaussian]",
            "score[policy=beta]",
            "table"
        ]
    );
}

#[test]
fn one_glance_shows_the_experiment() {
    assert!(text("thesis.yaml").lines().count() <= 190);
}

#[test]
fn the_transfer_scores_the_same_tracks_by_the_same_rules_in_both_places() {
    for (profile, limit) in [("full", 1000), ("smoke", 60)] {
        let graph = graph_of("transfer.yaml", profile, &[]);
        let params = |id: &str| {
            let stage = graph.stages.node_weights().find(|stage| &*stage.id == id);
            stage.unwrap_or_else(|| panic!("no {id} at {profile}")).params.clone()
        };
        for mode in ["deterministic", "stochastic"] {
            let mut home = params(&format!("evaluate[mode={mode}, env=home]"));
            let mut abroad = params(&format!("evaluate[mode={mode}, env=gymnasium]"));
            let [ours, theirs] = [&mut home, &mut abroad].map(|params| params["env"].take());
            assert_eq!(home, abroad, "all but the environment");
            assert_eq!(ours, serde_json::json!({ "car-racing": { "version": "v3", "time_limit": limit } }));
            let theirs = &theirs["gymnasium"];
            assert_eq!((&theirs["id"], &theirs["tracks"]), (&"CarRacing-v3".into(), &"car-racing".into()));
            assert_eq!(theirs["time_limit"].as_u64().unwrap_or(1000), limit);
            // What `version: v3` has by itself.
            assert_eq!(theirs["kwargs"]["lap_complete_percent"], 0.95);
        }
    }
}

#[test]
fn the_readme_shows_the_first_pipeline_as_it_is() {
    let readme = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("README.md")).unwrap();
    assert!(readme.contains(&format!("```yaml\n{}```", text("first.yaml"))));
}

/// Key and outputs of each stage of a profile in `thesis.lock`.
fn locked(profile: &str) -> BTreeMap<String, (Key, BTreeMap<String, Digest>)> {
    let all = text("thesis.lock");
    let lines = all.lines().filter_map(|line| line.strip_prefix(&format!("{profile}\t")));
    let line = |line: &str| {
        let mut cells = line.split('\t');
        let (stage, key) = (cells.next().unwrap().to_owned(), cells.next().unwrap().parse().unwrap());
        let output = |cell: &str| {
            let (output, digest) = cell.split_once('=').unwrap();
            (output.to_owned(), digest.parse().unwrap())
        };
        (stage, (key, cells.map(output).collect()))
    };
    lines.map(line).collect()
}

#[test]
fn the_lock_file_of_the_thesis_has_the_keys_of_its_stages() {
    assert!(!locked("smoke").is_empty());
    for profile in ["desk", "smoke"] {
        let (graph, locked) = (graph(profile, &[]), locked(profile));
        // Computing it takes hours, so after a change of learning it may be absent for some time.
        if locked.is_empty() && profile == "desk" {
            continue;
        }
        let digest = |source: &Source| match &source.from {
            Origin::Stage { stage, output } => locked[&*graph.stages[*stage].id].1[*output],
            Origin::File { path, .. } => {
                let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines").join(path);
                Digest::new(*blake3::hash(&std::fs::read(path).unwrap()).as_bytes())
            }
        };
        for stage in graph.stages.node_weights() {
            let mut inputs = Vec::new();
            for wire in &stage.inputs {
                let items = wire.sources.iter().map(|source| (digest(source), &source.labels)).collect();
                inputs.push(KeyInput { port: wire.port, many: wire.many, items });
            }
            let key = KeyInputs {
                kind: stage.kind.name(),
                revision: stage.kind.revision(),
                params: &stage.params,
                seed: stage.seed.map(|seed| seed.0),
                inputs,
            };
            let hint = "if the change is meant, run the pipeline at this profile with `--lock`";
            assert_eq!(key.key().unwrap(), locked[&*stage.id].0, "{} at {profile}: {hint}", stage.id);
        }
        assert_eq!(locked.len(), graph.stages.node_count(), "{profile}");
    }
}
