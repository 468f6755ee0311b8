//! What the jobs of a cluster request, and which stages they run.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::time::Duration;

use dril_stage_api::Kind;
use globset::Glob;
use serde::{Deserialize, Deserializer, de};

use super::time;
use crate::spec::limits::parse_size;

/// What jobs request: for all stages under `[slurm]`, for those of a kind under `[slurm.kinds.KIND]`, for some stages under
/// `[slurm.stages."PATTERN"]`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct JobSettings {
    /// `--partition`
    pub partition: Option<String>,
    /// `--account`
    pub account: Option<String>,
    /// `--qos`
    pub qos: Option<String>,
    /// `--time`: a stage that needs longer saves a checkpoint and continues in another job.
    #[serde(deserialize_with = "time")]
    pub time: Option<Duration>,
    /// `--mem` in bytes, for stages that have no `memory`.
    #[serde(deserialize_with = "size")]
    pub memory: Option<u64>,
    /// `--cpus-per-task`, instead of the threads that the stage requests.
    pub threads: Option<NonZeroUsize>,
    /// How long before the end of `time` a stage gets the signal to save its checkpoint.
    #[serde(deserialize_with = "time")]
    pub signal: Option<Duration>,
    /// Further arguments of `sbatch`, as `--constraint=avx2`.
    pub extra: Option<Vec<String>>,
    /// Lines of shell that run before the stage, as `module load openblas`.
    pub setup: Option<Vec<String>>,
    /// False: these stages have jobs of their own where there are pilots.
    pub pilot: Option<bool>,
}

/// `[slurm]`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(from = "Written")]
pub struct ClusterSettings {
    /// For all stages.
    pub all: JobSettings,
    /// By kind.
    pub kinds: BTreeMap<String, JobSettings>,
    /// By a pattern of stage names, as `dril*`; counts more than the kind.
    pub stages: BTreeMap<String, JobSettings>,
    /// Threads that queued and running jobs may request together.
    pub max_threads: Option<NonZeroUsize>,
    /// Long-lived jobs that run one stage after the other; without it, every stage has a job of its own.
    pub pilots: Option<usize>,
    /// How long a pilot waits for work before it ends.
    pub pilot_idle: Option<Duration>,
    /// Kinds that run beside the engine instead of in a job; without it, those that the engine's own program runs.
    pub local: Option<Vec<String>>,
}

impl ClusterSettings {
    /// What the job of a stage requests. `stage` is the stage's name, without what it is an instance of.
    pub fn of(&self, stage: &str, kind: &str) -> JobSettings {
        let mut all = JobSettings::default();
        // Where several patterns fit, the first in the order of the alphabet counts most.
        let fits =
            |pattern: &str| Glob::new(pattern).is_ok_and(|glob| glob.compile_matcher().is_match(stage));
        for (_, settings) in self.stages.iter().filter(|(pattern, _)| fits(pattern)) {
            all.fill_from(settings);
        }
        self.kinds.get(kind).into_iter().chain([&self.all]).for_each(|settings| all.fill_from(settings));
        all
    }

    /// True for kinds that run beside the engine: a stage that takes seconds has ended before a job would begin.
    pub fn is_local(&self, kind: Kind) -> bool {
        match &self.local {
            Some(kinds) => kinds.iter().any(|name| name == kind.name()),
            None => kind.worker().is_none() && !kind.is_program(),
        }
    }

    /// Takes over what is not set yet.
    pub(super) fn fill_from(&mut self, other: Self) {
        self.all.fill_from(&other.all);
        for (mine, theirs) in [(&mut self.kinds, other.kinds), (&mut self.stages, other.stages)] {
            for (name, settings) in theirs {
                mine.entry(name).or_default().fill_from(&settings);
            }
        }
        self.max_threads = self.max_threads.or(other.max_threads);
        self.pilots = self.pilots.or(other.pilots);
        self.pilot_idle = self.pilot_idle.or(other.pilot_idle);
        self.local = self.local.take().or(other.local);
    }
}

impl JobSettings {
    /// True where a value of this name is set, of those that a command may need.
    pub(super) fn has(&self, name: &str) -> bool {
        match name {
            "memory" => self.memory.is_some(),
            "time" => self.time.is_some(),
            "partition" => self.partition.is_some(),
            "account" => self.account.is_some(),
            "qos" => self.qos.is_some(),
            "extra" => self.extra.as_ref().is_some_and(|extra| !extra.is_empty()),
            _ => false,
        }
    }

    fn fill_from(&mut self, other: &Self) {
        let text = |mine: &mut Option<String>, theirs: &Option<String>| {
            *mine = mine.take().or_else(|| theirs.clone());
        };
        text(&mut self.partition, &other.partition);
        text(&mut self.account, &other.account);
        text(&mut self.qos, &other.qos);
        self.time = self.time.or(other.time);
        self.memory = self.memory.or(other.memory);
        self.threads = self.threads.or(other.threads);
        self.signal = self.signal.or(other.signal);
        self.extra = self.extra.take().or_else(|| other.extra.clone());
        self.setup = self.setup.take().or_else(|| other.setup.clone());
        self.pilot = self.pilot.or(other.pilot);
    }
}

/// The table as it is written: serde cannot both flatten and refuse unknown fields.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    partition: Option<String>,
    account: Option<String>,
    qos: Option<String>,
    #[serde(default, deserialize_with = "time")]
    time: Option<Duration>,
    #[serde(default, deserialize_with = "size")]
    memory: Option<u64>,
    threads: Option<NonZeroUsize>,
    #[serde(default, deserialize_with = "time")]
    signal: Option<Duration>,
    extra: Option<Vec<String>>,
    setup: Option<Vec<String>>,
    pilot: Option<bool>,
    #[serde(default)]
    kinds: BTreeMap<String, JobSettings>,
    #[serde(default, deserialize_with = "patterns")]
    stages: BTreeMap<String, JobSettings>,
    max_threads: Option<NonZeroUsize>,
    pilots: Option<usize>,
    #[serde(default, deserialize_with = "time")]
    pilot_idle: Option<Duration>,
    local: Option<Vec<String>>,
}

impl From<Written> for ClusterSettings {
    fn from(written: Written) -> Self {
        let Written { partition, account, qos, time, memory, threads, signal, extra, setup, pilot, .. } =
            written;
        let all = JobSettings { partition, account, qos, time, memory, threads, signal, extra, setup, pilot };
        let Written { kinds, stages, max_threads, pilots, pilot_idle, local, .. } = written;
        Self { all, kinds, stages, max_threads, pilots, pilot_idle, local }
    }
}

/// A size as `500M`.
fn size<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<u64>, D::Error> {
    let text = String::deserialize(deserializer)?;
    parse_size(&text).map(Some).map_err(de::Error::custom)
}

fn patterns<'de, D: Deserializer<'de>>(deserializer: D) -> Result<BTreeMap<String, JobSettings>, D::Error> {
    let stages = BTreeMap::<String, JobSettings>::deserialize(deserializer)?;
    for pattern in stages.keys() {
        Glob::new(pattern).map_err(de::Error::custom)?;
    }
    Ok(stages)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Settings;
    use std::path::Path;

    fn parse(text: &str) -> Result<ClusterSettings, String> {
        let parsed = Settings::parse(text.as_bytes(), Path::new("s.toml"));
        parsed.map(|settings| settings.slurm).map_err(|error| error.to_string())
    }

    #[test]
    fn settings_of_a_stage_take_precedence_over_those_of_its_kind_and_these_over_all() {
        let text = "[slurm]\npartition = \"all\"\ntime = \"1h\"\nmemory = \"2G\"\n\
                    [slurm.kinds.ppo]\npartition = \"kind\"\ntime = \"2h\"\n\
                    [slurm.stages.\"exp*\"]\ntime = \"3h\"\nextra = [\"--exclusive\"]\n";
        let slurm = parse(text).unwrap();
        let expert = slurm.of("expert", "ppo");
        assert_eq!(expert.partition.as_deref(), Some("kind"));
        assert_eq!((expert.time, expert.memory), (Some(Duration::from_secs(10_800)), Some(2 << 30)));
        assert_eq!(expert.extra.as_deref(), Some(&["--exclusive".to_owned()][..]));
        let clone = slurm.of("clone", "bc");
        assert_eq!((clone.partition.as_deref(), clone.time), (Some("all"), Some(Duration::from_secs(3600))));
    }

    #[test]
    fn a_mistake_is_named_with_its_place() {
        for (text, expected) in [
            ("[slurm]\npartiton = \"x\"\n", "s.toml:2:1: unknown field `partiton`"),
            ("[slurm]\ntime = \"soon\"\n", "s.toml:2:8: expected a time with its unit"),
            ("[slurm]\ntime = \"120\"\n", "s.toml:2:8: expected a time with its unit"),
            ("[slurm.kinds.ppo]\nmemory = \"x\"\n", "s.toml:2:10: expected a size with its unit"),
            ("[slurm.kinds.ppo]\nmemory = \"2000\"\n", "s.toml:2:10: expected a size with its unit"),
            ("[slurm.stages.\"a[\"]\ntime = \"1h\"\n", "s.toml:1:"),
        ] {
            let error = parse(text).unwrap_err();
            assert!(error.starts_with(expected), "{text}: {error}");
        }
    }
}
