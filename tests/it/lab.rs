//! A store in a temporary folder, and runs of fakes on it whose events can be asked afterwards.
#![allow(dead_code, clippy::unwrap_used, clippy::panic, clippy::print_stdout, clippy::print_stderr)]

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::AtomicBool;

use dril_pipe::exec::{self, ChildRunner, Event, Executed, InlineRunner, Options, Runner};
use dril_pipe::plan::{self, Plan, Reason, Verdict};
use dril_pipe::resolve::{Graph, StageIndex};
use dril_pipe::store::{Outputs, Store};

use crate::fakes;
use crate::scenario::{self, Scenario, StageLine};

/// A store and a folder for files from outside.
pub struct Lab {
    pub folder: tempfile::TempDir,
    pub store: Store,
}

/// A run that is over.
pub struct Ran {
    pub graph: Graph,
    pub executed: Executed,
    pub events: Vec<Event>,
}

impl Lab {
    pub fn new() -> Self {
        // In memory where that can be had: what is tested here dies with processes, not with the power, and hundreds of
        // runs that each wait for a disk take minutes.
        let memory = Path::new("/dev/shm");
        let folder =
            if memory.is_dir() { tempfile::tempdir_in(memory) } else { tempfile::tempdir() }.unwrap();
        let store = Store::open(&folder.path().join("store")).unwrap();
        Self { folder, store }
    }

    /// A file from outside.
    pub fn file(&self, name: &str, text: &str) {
        std::fs::write(self.folder.path().join(name), text).unwrap();
    }

    /// Where the trace of stages in child processes goes.
    pub fn trace_file(&self) -> PathBuf {
        self.folder.path().join("trace")
    }

    /// The lines of the trace.
    pub fn trace(&self) -> Vec<String> {
        let text = std::fs::read_to_string(self.trace_file()).unwrap_or_default();
        text.lines().map(str::to_owned).collect()
    }

    pub fn plan<'g>(&self, graph: &'g Graph) -> Plan<'g> {
        plan::plan(graph, &self.store, self.folder.path()).unwrap()
    }

    /// What would happen to each stage, as text: `name: cached`, `name: run [...]`, `name: after a b [...]`.
    pub fn verdicts(&self, stages: &[StageLine]) -> Vec<String> {
        let graph = scenario::graph(stages);
        let name = |stage: StageIndex| graph.stages[stage].name.to_string();
        let line = |(stage, verdict): &(StageIndex, Verdict)| match verdict {
            Verdict::Cached { .. } => format!("{}: cached", name(*stage)),
            Verdict::Run { why, .. } => format!("{}: run [{}]", name(*stage), reasons(why)),
            Verdict::DependsOn { stages, why } => {
                let stages: Vec<String> = stages.iter().map(|stage| name(*stage)).collect();
                format!("{}: after {} [{}]", name(*stage), stages.join(" "), reasons(why))
            }
        };
        self.plan(&graph).steps.iter().map(line).collect()
    }

    /// Runs stages in this process, on one thread.
    pub fn run(&self, stages: &[StageLine]) -> Ran {
        let runner = InlineRunner { registry: fakes::registry() };
        self.run_with(stages, &runner, &Options { threads: 1, ..Options::default() }, &AtomicBool::new(false))
    }

    /// Runs stages in child processes.
    pub fn run_children(&self, stages: &[StageLine], options: &Options) -> Ran {
        self.run_with(stages, &self.children(), options, &AtomicBool::new(false))
    }

    /// Runs stages.
    pub fn run_with(
        &self,
        stages: &[StageLine],
        runner: &dyn Runner,
        options: &Options,
        stop: &AtomicBool,
    ) -> Ran {
        self.run_watched(stages, runner, options, stop, &mut |_| {})
    }

    /// Runs stages; `watch` sees every event as it happens.
    pub fn run_watched(
        &self,
        stages: &[StageLine],
        runner: &dyn Runner,
        options: &Options,
        stop: &AtomicBool,
        watch: &mut dyn FnMut(&Event),
    ) -> Ran {
        let graph = scenario::graph(stages);
        let mut events = Vec::new();
        let executed = exec::execute(self.plan(&graph), &self.store, runner, options, stop, &mut |event| {
            watch(event);
            events.push(event.clone());
        });
        Ran { executed: executed.unwrap(), events, graph }
    }

    /// Starts stages as processes of the fakes' program, which trace what they do.
    pub fn children(&self) -> ChildRunner {
        let mut trace = OsString::from("DRIL_FAKES_TRACE=");
        trace.push(self.trace_file());
        ChildRunner::new("/usr/bin/env", [trace, fakes_program().into(), "__stage".into()])
    }

    /// An engine in a process of its own that will run these stages.
    pub fn engine(&self, stages: &[StageLine], threads: usize) -> Command {
        let scenario = Scenario {
            store: self.store.root().to_owned(),
            base: self.folder.path().to_owned(),
            threads,
            checkpoint_seconds: 0.0,
            stages: stages.to_vec(),
        };
        let file = tempfile::NamedTempFile::new_in(self.folder.path()).unwrap();
        serde_json::to_writer(&file, &scenario).unwrap();
        let (_, path) = file.keep().unwrap();
        let mut command = Command::new(fakes_program());
        command.arg("__engine").arg(path).env("DRIL_FAKES_TRACE", self.trace_file());
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        command
    }
}

impl Ran {
    /// The names of the stages that were started, in that order.
    pub fn started(&self) -> Vec<String> {
        self.names(|event| match event {
            Event::StageStarted { stage, .. } => Some(*stage),
            _ => None,
        })
    }

    /// The names of the stages that an event of some sort is about.
    pub fn names(&self, pick: impl Fn(&Event) -> Option<StageIndex>) -> Vec<String> {
        self.events.iter().filter_map(pick).map(|stage| self.graph.stages[stage].name.to_string()).collect()
    }

    /// The error of the stage that failed.
    pub fn error(&self) -> String {
        let errors = self.events.iter().filter_map(|event| match event {
            Event::StageFailed { failure, .. } => Some(failure.to_string()),
            _ => None,
        });
        errors.collect::<Vec<_>>().join("; ")
    }

    /// The outputs of a stage that is done.
    pub fn outputs(&self, name: &str) -> &Outputs {
        let stage =
            self.graph.stages.node_indices().find(|index| &*self.graph.stages[*index].name == name).unwrap();
        self.executed.outputs(stage).unwrap_or_else(|| panic!("`{name}` is not done"))
    }

    /// The text of a stage's output.
    pub fn text(&self, lab: &Lab, stage: &str, output: &str) -> String {
        std::fs::read_to_string(lab.store.blob_path(&self.outputs(stage)[output].digest)).unwrap()
    }

    /// Counts as `ran cached failed skipped stopped`.
    pub fn counts(&self) -> [usize; 5] {
        let outcome = &self.executed.outcome;
        [outcome.ran, outcome.cached, outcome.failed, outcome.skipped, outcome.stopped]
    }
}

fn reasons(why: &[Reason]) -> String {
    let shown: Vec<String> = why
        .iter()
        .map(|reason| match reason {
            Reason::New => "new".to_owned(),
            Reason::Forced => "forced".to_owned(),
            Reason::Param { path, old, new } => {
                let text = |value: &Option<String>| value.clone().unwrap_or_else(|| "-".to_owned());
                format!("{path}: {} -> {}", text(old), text(new))
            }
            Reason::Seed { old, new } => format!("seed {old:?} -> {new:?}"),
            Reason::Revision { old, new } => format!("revision {old} -> {new}"),
            Reason::Kind { old, new } => format!("kind {old} -> {new}"),
            Reason::Input { port, from, .. } => format!("{port} from {from}"),
            Reason::Rights { port, from, executable } => {
                format!("{port} from {from} executable: {executable}")
            }
            Reason::Lost { output } => format!("lost {output}"),
            Reason::Damaged { .. } => "damaged".to_owned(),
        })
        .collect();
    shown.join(", ")
}

/// The program of `fakes_main.rs`. Cargo builds it with the tests, as an example.
pub fn fakes_program() -> PathBuf {
    let tests = std::env::current_exe().unwrap();
    let program = tests.parent().and_then(Path::parent).unwrap().join("examples/fakes");
    assert!(program.is_file(), "{} is missing: run `cargo test` without `--test`", program.display());
    program
}

/// All files below a folder, sorted, relative to it.
pub fn files_below(root: &Path) -> Vec<String> {
    let mut found = Vec::new();
    let mut folders = vec![root.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                found.push(path.strip_prefix(root).unwrap().to_string_lossy().into_owned());
            }
        }
    }
    found.sort();
    found
}
