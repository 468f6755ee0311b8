//! A pipeline's results, made up for the tests of the page.
//!
//! With `DRIL_PIPE_PAGES=FOLDER` the pages are kept there, for `tools/pages/check.mjs` and for eyes.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use dril_report::html::page;
use dril_stage_api::outcome::{InputOutcome, OutputOutcome, PipelineOutcome, StageOutcome, State};
use dril_stage_api::testing::Bench;
use dril_stage_api::{Artifact, Stage};
use serde_json::{Value, json};

/// An outcome whose results lie in a folder of its own.
pub struct Lab {
    pub folder: tempfile::TempDir,
    pub outcome: PipelineOutcome,
}

impl Lab {
    /// An empty one.
    pub fn new(profile: &str) -> Self {
        let outcome = PipelineOutcome {
            pipeline: "thesis".into(),
            profile: profile.into(),
            first_profile: Some("thesis".into()),
            command: vec!["pipelines/thesis.yaml".into(), "--profile".into(), profile.into()],
            tool: "dril-pipe 0.1.0".into(),
            stages: Vec::new(),
        };
        Self { folder: tempfile::tempdir().unwrap(), outcome }
    }

    /// Adds a stage that is done.
    pub fn stage(
        &mut self,
        name: &str,
        kind: &str,
        labels: &[(&str, &str)],
        outputs: &[(&str, Artifact, &str, &[u8])],
    ) -> usize {
        let at = self.outcome.stages.len();
        let labels: Vec<(String, String)> =
            labels.iter().map(|(axis, value)| ((*axis).to_owned(), (*value).to_owned())).collect();
        let values: Vec<&str> = labels.iter().map(|(_, value)| value.as_str()).collect();
        let id = if values.is_empty() { name.to_owned() } else { format!("{name}[{}]", values.join(", ")) };
        let output = |(port, artifact, extension, bytes): &(&str, Artifact, &str, &[u8])| {
            let path = self.folder.path().join(format!("{at}-{port}"));
            std::fs::write(&path, bytes).unwrap();
            let digest = format!("{:064x}", at * 31 + bytes.len());
            let file = artifact.is_result().then(|| format!("{name}.{extension}"));
            OutputOutcome {
                name: (*port).to_owned(),
                artifact: *artifact,
                extension: (*extension).to_owned(),
                digest,
                bytes: bytes.len() as u64,
                path,
                file,
            }
        };
        let stage = StageOutcome {
            name: name.to_owned(),
            id,
            labels,
            kind: kind.to_owned(),
            revision: 1,
            params: json!({}),
            chosen: BTreeMap::new(),
            seed: Some(66),
            state: State::Done,
            key: Some(format!("{:064x}", at + 1)),
            inputs: Vec::new(),
            outputs: outputs.iter().map(output).collect(),
            seconds: Some(12.5),
            made_with: [("libtorch".to_owned(), "2.13.0".to_owned())].into(),
        };
        self.outcome.stages.push(stage);
        at
    }

    /// Runs a stage of this package on outputs of others, and adds it with what it made.
    pub fn run<S: Stage>(
        &mut self,
        name: &str,
        kind: &str,
        params: &Value,
        port: &str,
        from: &[(usize, &str)],
        reference: Option<&Path>,
    ) {
        let mut bench = Bench::new::<S>(params, 0).unwrap();
        let mut inputs = Vec::new();
        for (stage, output) in from {
            let source = &self.outcome.stages[*stage];
            let labels: Vec<(&str, &str)> =
                source.labels.iter().map(|(axis, value)| (axis.as_str(), value.as_str())).collect();
            let path = &source.outputs.iter().find(|other| other.name == *output).unwrap().path;
            bench = bench.input(port, path, &labels);
            inputs.push(InputOutcome {
                port: port.to_owned(),
                stage: Some(*stage),
                from: (*output).to_owned(),
                labels: source.labels.iter().cloned().collect(),
                path: None,
            });
        }
        if let Some(reference) = reference {
            bench = bench.input("reference", reference, &[]);
        }
        bench.run().unwrap();
        let read = |output: &str| std::fs::read(bench.output(output).unwrap()).unwrap();
        let at = match kind {
            "figure" => self.stage(
                name,
                kind,
                &[],
                &[
                    ("svg", Artifact::FIGURE, "svg", &read("svg")),
                    ("csv", Artifact::TABLE, "csv", &read("csv")),
                ],
            ),
            _ => self.stage(name, kind, &[], &[("csv", Artifact::TABLE, "csv", &read("csv"))]),
        };
        self.outcome.stages[at].params = bench.job().params.clone();
        self.outcome.stages[at].chosen = [("title".to_owned(), params["title"].clone())].into();
        self.outcome.stages[at].inputs = inputs;
        self.outcome.stages[at].seed = None;
    }

    /// The page.
    pub fn page(&self, name: &str) -> String {
        let text = page(&self.outcome, None).unwrap();
        if let Some(folder) = std::env::var_os("DRIL_PIPE_PAGES") {
            let folder = PathBuf::from(folder).join(name);
            std::fs::create_dir_all(&folder).unwrap();
            std::fs::write(folder.join("report.html"), &text).unwrap();
            for output in self.outcome.stages.iter().flat_map(|stage| &stage.outputs) {
                if let Some(file) = &output.file {
                    std::fs::copy(&output.path, folder.join(file)).unwrap();
                }
            }
        }
        text
    }
}

/// A number between -0.5 and 0.5 that looks random.
pub fn noise(n: usize) -> f64 {
    let mixed = (n as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40;
    f64::from(u32::try_from(mixed).unwrap()) / f64::from(1 << 24) - 0.5
}

/// An evaluation around a mean.
pub fn scores(mean: f64, std: f64, own: usize, count: usize) -> Vec<u8> {
    let row = |n: usize| {
        let score = mean + std * (1.5 * noise(n) + 3.0 * noise(own * 1000 + n));
        format!("{n},{},{score:.2},1000,time-limit\n", 2_000_000 + n)
    };
    let rows: String = (0..count).map(row).collect();
    format!("episode,track_seed,score,steps,outcome\n{rows}").into_bytes()
}

/// The log of an ensemble.
pub fn losses(own: usize) -> Vec<u8> {
    let row = |n: usize| {
        let loss = 3.0 / n as f64 + 0.01 + 0.004 * noise(own + n).abs();
        format!("{n},{loss:.6},{:.6}\n", loss * 1.3)
    };
    let rows: String = (1..600).map(row).collect();
    format!("epoch,train_loss,val_loss\n{rows}").into_bytes()
}
