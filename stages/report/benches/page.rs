//! How large the page about a large pipeline is, and how long it takes to write: 1,000 stages and 100,000 points.
//!
//! `cargo bench -p dril-report` says both, and fails above 2 MB or 2 seconds.
#![allow(clippy::print_stdout, clippy::unwrap_used, reason = "a program for people")]

use std::collections::BTreeMap;
use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;

use dril_report::Figure;
use dril_report::html::page;
use dril_stage_api::Artifact;
use dril_stage_api::outcome::{InputOutcome, OutputOutcome, PipelineOutcome, StageOutcome, State};
use dril_stage_api::testing::Bench;
use serde_json::{Value, json};

const MOST_BYTES: usize = 2_000_000;
const MOST_SECONDS: f64 = 2.0;
/// How often it is measured; the best counts, since neighbours can only take away.
const SPELLS: usize = 5;

fn main() -> ExitCode {
    let folder = tempfile::tempdir().unwrap();
    let outcome = large(folder.path());
    let mut best = f64::INFINITY;
    let mut bytes = 0;
    for _ in 0..SPELLS {
        let began = Instant::now();
        bytes = page(&outcome, None).unwrap().len();
        best = best.min(began.elapsed().as_secs_f64());
    }
    println!("{} stages, 100,000 points: {bytes} bytes in {best:.2} s", outcome.stages.len());
    if bytes > MOST_BYTES || best > MOST_SECONDS {
        println!("expected at most {MOST_BYTES} bytes and {MOST_SECONDS} s");
        return ExitCode::FAILURE;
    }
    ExitCode::SUCCESS
}

/// 1,000 evaluations of twenty names, a training log of 100,000 rows and its figure.
fn large(folder: &Path) -> PipelineOutcome {
    let mut stages = Vec::new();
    for n in 0..1000 {
        let rows =
            (0..40).map(|row| format!("{row},{row},{},100,finished,\n", 100 + (n * 7 + row * 13) % 50));
        let text = format!("episode,seed,score,steps,outcome,diverged_at_step\n{}", rows.collect::<String>());
        let labels = [("method", ["a", "b"][n % 2].to_owned()), ("seed", (n / 2).to_string())];
        let name = format!("stage{}", n % 20);
        stages.push(stage(
            folder,
            n,
            (&name, "evaluate"),
            &labels,
            ("scores", Artifact::SCORES, text.as_bytes()),
        ));
    }
    let rows: String =
        (0..100_000_u64).map(|n| format!("{n},{}\n", n.wrapping_mul(2_654_435_761) % 1000)).collect();
    let log = format!("step,score_mean_10\n{rows}");
    stages.push(stage(folder, 1000, ("train", "ppo"), &[], ("log", Artifact::TRAINING_LOG, log.as_bytes())));
    let params = json!({
        "title": "All points", "x": "step", "y": ["score_mean_10"], "layers": { "points": {}, "line": { "smooth": 100 } }
    });
    let bench = Bench::new::<Figure>(&params, 0).unwrap().input("data", &stages[1000].outputs[0].path, &[]);
    bench.run().unwrap();
    let svg = std::fs::read(bench.output("svg").unwrap()).unwrap();
    let mut figure = stage(folder, 1001, ("all-points", "figure"), &[], ("svg", Artifact::FIGURE, &svg));
    figure.params = params;
    figure.inputs = vec![InputOutcome {
        port: "data".to_owned(),
        stage: Some(1000),
        from: "log".to_owned(),
        labels: BTreeMap::new(),
        path: None,
    }];
    stages.push(figure);
    PipelineOutcome {
        pipeline: "large".to_owned(),
        profile: "full".to_owned(),
        first_profile: Some("full".to_owned()),
        command: vec!["large.yaml".to_owned()],
        tool: "dril-pipe".to_owned(),
        stages,
    }
}

fn stage(
    folder: &Path,
    at: usize,
    (name, kind): (&str, &str),
    labels: &[(&str, String)],
    (output, artifact, bytes): (&str, Artifact, &[u8]),
) -> StageOutcome {
    let path = folder.join(at.to_string());
    std::fs::write(&path, bytes).unwrap();
    let labels: Vec<(String, String)> =
        labels.iter().map(|(axis, value)| ((*axis).to_owned(), value.clone())).collect();
    let made = OutputOutcome {
        name: output.to_owned(),
        artifact,
        extension: "csv".to_owned(),
        digest: format!("{at:064x}"),
        bytes: bytes.len() as u64,
        path,
        file: None,
    };
    StageOutcome {
        name: name.to_owned(),
        id: format!("{name}[{at}]"),
        labels,
        kind: kind.to_owned(),
        revision: 1,
        params: Value::Object(serde_json::Map::new()),
        chosen: BTreeMap::new(),
        seed: Some(66),
        state: State::Done,
        key: Some(format!("{:064x}", at + 1)),
        inputs: Vec::new(),
        outputs: vec![made],
        seconds: Some(12.5),
        made_with: [("libtorch".to_owned(), "2.13.0".to_owned())].into(),
    }
}
