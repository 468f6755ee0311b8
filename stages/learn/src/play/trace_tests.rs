//! Tests of traces: of an agent's own episodes, of a recording, and of what an ensemble says of both.

use super::*;
use crate::algorithms::ensemble::EnsembleStage;
use crate::play::collect::CollectStage;
use dril_kinds::{Network, PolicyFamily};
use dril_stage_api::Seed;
use dril_stage_api::testing::Bench;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// An agent with random weights in an environment of 12 steps, and what it recorded there.
struct World {
    folder: tempfile::TempDir,
    env: Value,
}

impl World {
    fn of(env: &str) -> Self {
        let world = Self { folder: tempfile::tempdir().unwrap(), env: json!({ env: { "time_limit": 12 } }) };
        let env: EnvConfig = serde_json::from_value(world.env.clone()).unwrap();
        let architecture =
            crate::spaces::architecture(&env, PolicyFamily::Beta, None, Network::ExpertCnn).unwrap();
        Policy::new(architecture, &mut Seed(1).stream("init")).unwrap().save(&world.path("policy")).unwrap();
        let params = json!({ "env": world.env, "episodes": 3, "above": -1e6, "first_seed": 30 });
        let bench = Bench::new::<CollectStage>(&params, 7).unwrap();
        world.keep(bench.input("policy", &world.path("policy"), &[]), "demonstrations");
        let params = json!({ "n_members": 2, "n_epochs": 1, "batch_size": 4 });
        let bench = Bench::new::<EnsembleStage>(&params, 7).unwrap();
        world.keep(bench.input("demonstrations", &world.path("demonstrations"), &[]), "ensemble");
        world
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn keep(&self, bench: Bench, output: &str) {
        bench.run().unwrap();
        std::fs::copy(bench.output(output).unwrap(), self.path(output)).unwrap();
    }

    /// A trace with these inputs.
    fn trace(&self, params: &Value, inputs: &[&str]) -> Bench {
        let bench = Bench::new::<TraceStage>(params, 7).unwrap();
        inputs.iter().fold(bench, |bench, input| bench.input(input, &self.path(input), &[]))
    }

    fn rows(&self, params: &Value, inputs: &[&str]) -> Rows {
        let bench = self.trace(params, inputs);
        bench.run().unwrap();
        Rows::read(&bench.output("steps").unwrap())
    }
}

struct Rows {
    headers: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Rows {
    fn read(path: &Path) -> Self {
        let mut reader = csv::Reader::from_path(path).unwrap();
        let text = |record: &csv::StringRecord| record.iter().map(str::to_owned).collect::<Vec<_>>();
        let headers = text(reader.headers().unwrap());
        Self { headers, rows: reader.records().map(|record| text(&record.unwrap())).collect() }
    }

    fn column(&self, name: &str) -> Vec<&str> {
        let at = self.headers.iter().position(|header| header == name).unwrap();
        self.rows.iter().map(|row| row[at].as_str()).collect()
    }

    fn numbers(&self, name: &str) -> Vec<f64> {
        self.column(name).into_iter().map(|cell| cell.parse().unwrap()).collect()
    }
}

#[test]
fn an_agents_own_episodes_are_those_that_it_records_elsewhere() {
    let world = World::of("car-racing");
    let played = world.rows(
        &json!({ "env": world.env, "first_seed": 30, "episodes": 3 }),
        &["policy", "demonstrations", "ensemble"],
    );
    let walked = world.rows(&json!({ "episodes": 3 }), &["demonstrations", "ensemble"]);
    assert_eq!(played.rows, walked.rows);
    assert_eq!(played.rows.len(), 36);
    assert_eq!(played.column("seed")[12..24], ["31"; 12]);
}

#[test]
fn rewards_add_up_to_the_score_and_poses_move_along_the_track() {
    let world = World::of("car-racing");
    let rows = world.rows(&json!({}), &["demonstrations"]);
    let recorded = Demonstrations::read(&world.path("demonstrations")).unwrap().episodes.remove(0);
    let (rewards, scores) = (rows.numbers("reward"), rows.numbers("score"));
    assert_eq!(scores[11], recorded.score);
    assert_eq!(scores[1], rewards[0] + rewards[1]);
    let [x, y] = ["x", "y"].map(|name| rows.numbers(name));
    let moved = (1..12).any(|at| (x[at], y[at]) != (x[0], y[0]));
    assert!(moved, "{x:?} {y:?}");
    assert!(rows.column("cost").iter().all(|cell| cell.is_empty()), "there is no ensemble");
}

#[test]
fn the_signal_is_negative_where_the_cost_is_above_the_limit() {
    let world = World::of("lunar-lander");
    let rows = world.rows(&json!({ "episodes": 3, "quantile": 0.5 }), &["demonstrations", "ensemble"]);
    let (costs, limits, signals) = (rows.numbers("cost"), rows.numbers("limit"), rows.numbers("signal"));
    let negative = costs.iter().zip(&limits).map(|(cost, limit)| if cost > limit { -1.0 } else { 1.0 });
    assert_eq!(signals, negative.collect::<Vec<_>>());
    let above = signals.iter().filter(|signal| **signal < 0.0).count();
    assert_eq!(above, 18, "the limit is the median of 36 costs");
}

#[test]
fn a_trace_of_a_few_steps_is_the_beginning_of_the_whole_one() {
    let world = World::of("lunar-lander");
    let inputs = ["demonstrations", "ensemble"];
    let whole = world.rows(&json!({ "episodes": 3 }), &inputs);
    let cut = world.rows(&json!({ "episodes": 3, "steps": 14 }), &inputs);
    assert_eq!(cut.rows[..], whole.rows[..14]);
}

#[test]
fn a_recording_that_is_not_played_again_has_no_rewards() {
    let world = World::of("lunar-lander");
    let rows = world.rows(&json!({ "replay": false }), &["demonstrations", "ensemble"]);
    assert!(rows.column("reward").iter().chain(&rows.column("x")).all(|cell| cell.is_empty()));
    assert_eq!(rows.numbers("cost").len(), 12);
}

#[test]
fn a_drawn_episode_is_a_video_a_strip_and_a_map() {
    for (env, lines) in [("car-racing", 2), ("lunar-lander", 1)] {
        let world = World::of(env);
        let bench = world.trace(&json!({ "video": true }), &["demonstrations"]);
        bench.run().unwrap();
        for (port, magic) in [("video", &b"GIF89a"[..]), ("strip", &b"\x89PNG"[..])] {
            let bytes = std::fs::read(bench.output(port).unwrap()).unwrap();
            assert!(bytes.starts_with(magic) && bytes.len() > 1000, "{env}: {port}");
        }
        let map = Rows::read(&bench.output("map").unwrap());
        let mut names = map.column("line");
        names.dedup();
        assert_eq!(names.len(), lines, "{env}: {names:?}");
    }
}

#[test]
fn a_recording_of_other_physics_and_an_ensemble_without_demonstrations_are_errors() {
    let world = World::of("lunar-lander");
    let mut demos = Demonstrations::read(&world.path("demonstrations")).unwrap();
    demos.episodes[0].score += 1.0;
    demos.write(&world.path("demonstrations")).unwrap();
    let message = world.trace(&json!({}), &["demonstrations"]).run().unwrap_err().to_string();
    assert!(message.contains("seed 30") && message.contains("`replay`"), "{message}");
    let params = json!({ "env": world.env });
    let message = world.trace(&params, &["policy", "ensemble"]).run().unwrap_err().to_string();
    assert!(message.contains("`demonstrations` is not connected"), "{message}");
    let params = json!({ "episodes": 9 });
    let message = world.trace(&params, &["demonstrations"]).run().unwrap_err().to_string();
    assert!(message.contains("has 3 episodes, expected at least 9"), "{message}");
}

#[test]
fn a_trace_has_the_same_bytes_for_ever() {
    let world = World::of("lunar-lander");
    let params = json!({ "env": world.env, "first_seed": 30, "episodes": 2, "video": true });
    let bench = world.trace(&params, &["policy", "demonstrations", "ensemble"]);
    bench.run().unwrap();
    let digest =
        |port| blake3::hash(&std::fs::read(bench.output(port).unwrap()).unwrap()).to_hex()[..16].to_owned();
    // Another digest means that results change: raise the kind's REVISION.
    assert_eq!(["steps", "map", "video"].map(digest), GOLDEN);
}

const GOLDEN: [&str; 3] = ["44d021afbd8fb933", "4bfafd1b4291083d", "eabd2fead806dd56"];
