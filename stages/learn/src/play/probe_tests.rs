//! Tests of probes.

use super::*;
use crate::data::transitions::tests::image_demos;
use dril_envs::{EnvConfig, Outcome};
use dril_kinds::PolicyFamily;
use dril_stage_api::testing::Bench;
use serde_json::{Value, json};

/// A recording of three steps on LunarLander, every number of which is known.
fn landing() -> Demonstrations {
    let env: EnvConfig = serde_json::from_value(json!({ "lunar-lander": {} })).unwrap();
    let (observation_space, _) = env.spaces().unwrap();
    let header = DemosHeader { env, observation_space, ..image_demos(0, 0.0).header };
    let vectors = (0..24).map(|at| (at as f32 * 0.1) - 1.0).collect();
    let actions = vec![0.0, 0.1, 0.5, -0.25, 1.0, -1.0];
    let episode =
        Episode { seed: 3, score: 0.0, outcome: Outcome::Failed, frames: Vec::new(), vectors, actions };
    Demonstrations { header, episodes: vec![episode] }
}

fn bench(params: &Value, demos: &Demonstrations) -> Bench {
    let bench = Bench::new::<ProbeStage>(params, 5).unwrap();
    let path = bench.folder().join("in.demos");
    demos.write(&path).unwrap();
    bench.input("demonstrations", &path, &[])
}

/// The cells of an output, without its header.
fn rows(bench: &Bench, port: &str) -> Vec<Vec<f64>> {
    let mut reader = csv::Reader::from_path(bench.output(port).unwrap()).unwrap();
    let number = |cell: &str| cell.parse().unwrap_or(f64::NAN);
    reader.records().map(|record| record.unwrap().iter().map(number).collect()).collect()
}

#[test]
fn draws_have_the_mean_and_the_deviation_of_the_distribution() {
    for family in ["gaussian", "beta"] {
        let bench = bench(&json!({ "fresh": family, "step": 1, "draws": 20000 }), &landing());
        bench.run().unwrap();
        let draws = rows(&bench, "draws");
        assert_eq!(draws.len(), 20_000);
        for (n, row) in rows(&bench, "distribution").into_iter().enumerate() {
            let (mean, deviation) = (row[1], row[2]);
            let drawn = || draws.iter().map(|draw| draw[1 + n]);
            let found = drawn().sum::<f64>() / 20_000.0;
            assert!((found - mean).abs() < 4.0 * deviation / 141.0, "{family}: {found} {mean}");
            let spread = (drawn().map(|x| (x - found) * (x - found)).sum::<f64>() / 20_000.0).sqrt();
            assert!((spread / deviation - 1.0).abs() < 0.05, "{family}: {spread} {deviation}");
        }
    }
}

#[test]
fn the_experts_action_is_that_of_the_step() {
    let bench = bench(&json!({ "fresh": "beta", "step": 1, "draws": 2 }), &landing());
    bench.run().unwrap();
    assert_eq!(rows(&bench, "distribution").iter().map(|row| row[6]).collect::<Vec<_>>(), [0.5, -0.25]);
    assert!(rows(&bench, "draws").iter().all(|draw| draw[3..] == [0.5, -0.25]));
    assert!(std::fs::read(bench.output("image").unwrap()).unwrap().starts_with(b"\x89PNG"));
}

#[test]
fn an_image_is_shown_with_those_before_it() {
    let params = json!({ "fresh": "gaussian", "network": "atari-cnn", "step": 2, "draws": 1 });
    let bench = bench(&params, &image_demos(6, 0.0));
    bench.run().unwrap();
    let png = std::fs::read(bench.output("image").unwrap()).unwrap();
    let width = u32::from_be_bytes([png[16], png[17], png[18], png[19]]);
    assert_eq!(width, 3 * 72 + 2 * 2, "three frames of 36 pixels, twice as large, with gaps");
}

#[test]
fn a_step_that_is_not_there_and_an_agent_of_another_environment_are_errors() {
    let error = |params: &Value, demos: &Demonstrations| bench(params, demos).run().unwrap_err().to_string();
    let message = error(&json!({ "fresh": "beta", "step": 3 }), &landing());
    assert!(message.contains("episode 0 has 3 steps, expected one with the number 3"), "{message}");
    let message = error(&json!({ "fresh": "beta", "episode": 1 }), &landing());
    assert!(message.contains("has 1 episodes"), "{message}");
    let message = error(&json!({ "fresh": "categorical" }), &landing());
    assert!(message.contains("set `policy` to"), "{message}");
    let stage = bench(&json!({}), &landing());
    let path = stage.folder().join("policy");
    let env = EnvConfig::default();
    let architecture =
        crate::spaces::architecture(&env, PolicyFamily::Beta, None, Network::ExpertCnn).unwrap();
    Policy::new(architecture, &mut dril_stage_api::Seed(1).stream("init")).unwrap().save(&path).unwrap();
    let message = stage.input("policy", &path, &[]).run().unwrap_err().to_string();
    assert!(message.contains("give it a recording of the environment"), "{message}");
}

#[test]
fn a_probe_has_the_same_bytes_for_ever() {
    let bench = bench(&json!({ "fresh": "beta", "draws": 100 }), &landing());
    bench.run().unwrap();
    let digest =
        |port| blake3::hash(&std::fs::read(bench.output(port).unwrap()).unwrap()).to_hex()[..16].to_owned();
    // Another digest means that results change: raise the kind's REVISION.
    assert_eq!(["distribution", "draws", "image"].map(digest), GOLDEN);
}

const GOLDEN: [&str; 3] = ["b658722c554c6826", "1744a9194b9806e8", "b94cb143b47c5df2"];
