//! Past runs, from their folders under `runs-v1`. Invalid lines are skipped.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use serde::Deserialize;
use serde_json::Value;

use super::run::begun_at;
use super::{Key, Store, StoreError};
use crate::fsx::{self, Lock};

/// A run, from its folder.
#[derive(Clone, Debug)]
pub struct PastRun {
    /// Its name, which sorts by time.
    pub id: String,
    /// Its folder.
    pub folder: PathBuf,
    /// The pipeline's name; empty where the manifest is lost.
    pub pipeline: String,
    /// The profile.
    pub profile: String,
    /// When it started, by the clock at the time.
    pub began: SystemTime,
    /// The manifest.
    pub manifest: Value,
    /// The outcome of each stage in its event log, by id.
    pub stages: BTreeMap<String, StageOfRun>,
    /// How it ended; `None` while it is running, or where it died.
    pub end: Option<RunEnd>,
    /// True while its process is alive.
    pub alive: bool,
}

/// The outcome of a stage in a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StageOfRun {
    /// Its key, if it was known.
    pub key: Option<Key>,
    /// Its outcome.
    pub fate: StageState,
    /// When that was logged, in seconds since the run started.
    pub at: f64,
    /// Its duration, if it finished.
    pub seconds: Option<f64>,
    /// Why it failed.
    pub error: Option<String>,
    /// Why it ran, from the event log.
    pub why: Vec<Value>,
}

/// What became of a stage in a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StageState {
    /// It was cached.
    Cached,
    /// It was started and no end was logged: it is running, or died with the run.
    Started,
    /// It ran and finished.
    Ran,
    /// It failed.
    Failed,
    /// It could not run because a stage upstream failed.
    Skipped,
    /// It was stopped.
    Stopped,
    /// It waited for another process.
    #[default]
    Waiting,
}

impl StageState {
    /// True where its work was begun, however it ended.
    pub fn was_started(self) -> bool {
        matches!(self, Self::Started | Self::Ran | Self::Failed | Self::Stopped)
    }

    /// Its name in output.
    pub fn name(self) -> &'static str {
        match self {
            Self::Cached => "cached",
            Self::Started => "started",
            Self::Ran => "ran",
            Self::Failed => "failed",
            Self::Skipped => "skipped",
            Self::Stopped => "stopped",
            Self::Waiting => "waiting",
        }
    }
}

/// The counts that a run ended with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(default)]
pub struct RunEnd {
    /// Cache hits.
    pub cached: usize,
    /// Stages that ran and finished.
    pub ran: usize,
    /// Stages that failed.
    pub failed: usize,
    /// Stages that were skipped because a stage upstream failed.
    pub skipped: usize,
    /// Stages that were stopped or never started.
    pub stopped: usize,
    /// How long it took.
    pub seconds: f64,
}

#[derive(Deserialize)]
struct Line {
    event: String,
    #[serde(default)]
    at: f64,
    stage: Option<String>,
    key: Option<Key>,
    seconds: Option<f64>,
    error: Option<String>,
    #[serde(default)]
    why: Vec<Value>,
}

impl Store {
    /// The names of all runs, latest first.
    pub fn run_ids(&self) -> Result<Vec<String>, StoreError> {
        let mut paths = fsx::list(&self.root().join("runs-v1"))?;
        paths.reverse();
        let name = |path: &PathBuf| Some(path.file_name()?.to_str()?.to_owned());
        Ok(paths.iter().filter_map(name).filter(|id| begun_at(id).is_some()).collect())
    }

    /// Reads a run.
    ///
    /// # Errors
    /// Its folder cannot be read.
    pub fn past_run(&self, id: &str) -> Result<PastRun, StoreError> {
        let folder = self.root().join("runs-v1").join(id);
        let manifest: Value = fsx::read_if_there(&folder.join("run.json"))?
            .and_then(|bytes| serde_json::from_slice(&bytes).ok())
            .unwrap_or_default();
        let text = |field: &str| manifest[field].as_str().unwrap_or_default().to_owned();
        let events = fsx::read_if_there(&folder.join("events.jsonl"))?.unwrap_or_default();
        let (stages, end) = stages_of(&events);
        Ok(PastRun {
            id: id.to_owned(),
            pipeline: text("pipeline"),
            profile: text("profile"),
            began: UNIX_EPOCH + begun_at(id).unwrap_or_default(),
            manifest,
            stages,
            end,
            alive: self.is_alive(id),
            folder,
        })
    }

    /// True while the process of that run is alive.
    pub fn is_alive(&self, id: &str) -> bool {
        matches!(Lock::is_held(&self.root().join("tmp").join(format!("{id}.lock"))), Ok(true))
    }

    /// True while some process builds that key.
    pub fn is_being_made(&self, key: &Key) -> bool {
        matches!(Lock::is_held(&self.root().join("locks-v1").join(key.hex())), Ok(true))
    }

    /// When the record of a key was written; `None` where there is none.
    pub fn made_at(&self, key: &Key) -> Result<Option<SystemTime>, StoreError> {
        Ok(fsx::modified(&self.record_path(key))?)
    }
}

impl PastRun {
    /// The log of a stage that this run started; `None` where it did not start it.
    pub fn log_of(&self, stage: &str) -> Option<PathBuf> {
        let ending = format!("-{}.log", self.stages.get(stage)?.key?.short());
        let logs = fsx::list(&self.folder.join("logs")).unwrap_or_default();
        let is_of =
            |path: &Path| path.file_name().is_some_and(|name| name.to_string_lossy().ends_with(&ending));
        logs.into_iter().find(|path| is_of(path))
    }

    /// The time of an event `at` this many seconds.
    pub fn time(&self, at: f64) -> SystemTime {
        self.began + Duration::try_from_secs_f64(at).unwrap_or_default()
    }
}

/// The outcome of each stage in an event log, by id, and the end of the run.
pub(super) fn stages_of(events: &[u8]) -> (BTreeMap<String, StageOfRun>, Option<RunEnd>) {
    let (mut stages, mut end) = (BTreeMap::new(), None);
    for line in events.split(|byte| *byte == b'\n').filter(|line| !line.is_empty()) {
        hear(line, &mut stages, &mut end);
    }
    (stages, end)
}

fn hear(line: &[u8], stages: &mut BTreeMap<String, StageOfRun>, end: &mut Option<RunEnd>) {
    let Ok(line_of) = serde_json::from_slice::<Line>(line) else { return };
    if line_of.event == "run-finished" {
        *end = serde_json::from_slice(line).ok();
        return;
    }
    let fate = match &*line_of.event {
        "cached" => StageState::Cached,
        "started" => StageState::Started,
        "finished" => StageState::Ran,
        "failed" => StageState::Failed,
        "skipped" => StageState::Skipped,
        "stopped" => StageState::Stopped,
        "waiting" => StageState::Waiting,
        _ => return,
    };
    let Some(name) = line_of.stage else { return };
    let stage = stages.entry(name).or_default();
    stage.fate = fate;
    stage.at = line_of.at;
    stage.key = line_of.key.or(stage.key);
    stage.seconds = line_of.seconds.or(stage.seconds);
    stage.error = line_of.error;
    if fate == StageState::Started {
        stage.why = line_of.why;
    }
}
