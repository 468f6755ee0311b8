//! Schedulers other than Slurm, described by their commands: `[executors.NAME]`.
//!
//! A command is a line of shell with placeholders such as `{script}`. Their values are quoted for the shell where necessary.

use std::collections::BTreeMap;

use serde::{Deserialize, Deserializer, de};

use super::cluster::ClusterSettings;

/// A placeholder, and the setting of jobs without which it could have no value.
const SUBMIT: [(&str, Option<&str>); 16] = [
    ("script", None),
    ("folder", None),
    ("output", None),
    ("name", None),
    ("threads", None),
    ("gpus", None),
    ("memory_mb", Some("memory")),
    ("memory_gb", Some("memory")),
    ("memory_kb", Some("memory")),
    ("time", Some("time")),
    ("minutes", Some("time")),
    ("seconds", Some("time")),
    ("partition", Some("partition")),
    ("account", Some("account")),
    ("qos", Some("qos")),
    ("extra", None),
];
/// Settings of jobs that do nothing unless one of these placeholders takes them. `time` is none of them: a stage stops by itself
/// before its end.
const TAKEN_BY: [(&str, &[&str]); 5] = [
    ("partition", &["partition"]),
    ("account", &["account"]),
    ("qos", &["qos"]),
    ("memory", &["memory_kb", "memory_mb", "memory_gb"]),
    ("extra", &["extra"]),
];
const JOBS: [(&str, Option<&str>); 2] = [("jobs", None), ("job", None)];
const JOB: [(&str, Option<&str>); 1] = [("job", None)];

/// A scheduler by its commands.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExecutorSettings {
    /// Submits `{script}`, and prints the job's ID.
    pub submit: String,
    /// Prints a line `ID STATE [NODE]` for each job of this user; or, with `{job}`, the state of one job, and fails once it is
    /// gone.
    pub status: String,
    /// Cancels `{jobs}`; or, with `{job}`, one job.
    pub cancel: String,
    /// Sends SIGUSR1 to the script of running `{jobs}`, so that stages save a checkpoint and stop; without it they are
    /// cancelled.
    pub stop: Option<String>,
    /// Where the job's ID is in the output of `submit`, as `Job <{id}>`; without it, the last word is the ID.
    pub id: Option<String>,
    /// The environment variable with the job's ID in a job; without it, that of PBS, LSF, Grid Engine or HyperQueue.
    pub job_variable: Option<String>,
    /// Parts of messages of `submit` after which it is tried again for an hour, besides the usual ones.
    #[serde(default)]
    pub busy: Vec<String>,
    /// Parts of messages of `submit` after which trying again is useless, besides the usual ones.
    #[serde(default)]
    pub refused: Vec<String>,
    /// Names of states in the output of `status`, besides the usual ones.
    #[serde(default)]
    pub states: StateNames,
    /// What jobs request, and which stages run where.
    #[serde(default)]
    pub jobs: ClusterSettings,
}

/// Names of states. One that is neither here nor usual counts as running.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StateNames {
    /// The job waits.
    pub waiting: Vec<String>,
    /// It runs, or is about to begin or to end.
    pub running: Vec<String>,
    /// It is over.
    pub over: Vec<String>,
    /// It was cancelled.
    pub cancelled: Vec<String>,
    /// It failed, and would again.
    pub failed: Vec<String>,
}

/// All executors; names are checked.
pub(super) fn executors<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<BTreeMap<String, ExecutorSettings>, D::Error> {
    let all = BTreeMap::<String, ExecutorSettings>::deserialize(deserializer)?;
    let problems: Vec<String> = all.iter().flat_map(|(name, executor)| executor.problems(name)).collect();
    if problems.is_empty() { Ok(all) } else { Err(de::Error::custom(problems.join("; "))) }
}

impl ExecutorSettings {
    fn problems(&self, name: &str) -> Vec<String> {
        let mut problems = Vec::new();
        let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_".contains(c);
        if ["local", "slurm"].contains(&name) || !name.chars().all(is_plain) {
            problems.push(format!(
                "an executor cannot be called `{name}`: expected letters, digits, `-` and `_`, and neither `local` nor \
                 `slurm`"
            ));
        }
        let mut check = |field: &str, text: &str, known: &[(&str, Option<&str>)]| {
            for used in placeholders(text) {
                match known.iter().find(|(known, _)| *known == used) {
                    None => {
                        let known: Vec<String> = known.iter().map(|(known, _)| format!("`{{{known}}}`")).collect();
                        problems.push(format!(
                            "`{field}` of executor `{name}` has an unknown placeholder `{{{used}}}`, expected one of {} \
                             (in a shell block, write a space after the brace)",
                            known.join(", ")
                        ));
                    }
                    Some((_, Some(needed))) if !self.jobs.all.has(needed) => problems.push(format!(
                        "`submit` of executor `{name}` uses `{{{used}}}`: set `{needed}` in `[executors.{name}.jobs]`"
                    )),
                    Some(_) => {}
                }
            }
        };
        check("submit", &self.submit, &SUBMIT);
        check("status", &self.status, &JOB);
        check("cancel", &self.cancel, &JOBS);
        check("stop", self.stop.as_deref().unwrap_or_default(), &JOBS);
        for (field, text, needed) in [
            ("submit", &*self.submit, &["script"][..]),
            ("cancel", &*self.cancel, &["jobs", "job"]),
            ("stop", self.stop.as_deref().unwrap_or("{jobs}"), &["jobs", "job"]),
        ] {
            if !placeholders(text).any(|used| needed.contains(&used)) {
                problems.push(format!("`{field}` of executor `{name}` has no `{{{}}}`", needed[0]));
            }
        }
        problems.extend(self.without_effect(name));
        if self.id.as_ref().is_some_and(|id| !id.contains("{id}")) {
            problems.push(format!("`id` of executor `{name}` has no `{{id}}`"));
        }
        problems
    }

    /// Settings of jobs that `submit` does not take.
    fn without_effect(&self, name: &str) -> Vec<String> {
        let used: Vec<&str> = placeholders(&self.submit).collect();
        let jobs = format!("executors.{name}.jobs");
        let kinds = self.jobs.kinds.iter().map(|(kind, set)| (format!("{jobs}.kinds.{kind}"), set));
        let stages =
            self.jobs.stages.iter().map(|(pattern, set)| (format!("{jobs}.stages.\"{pattern}\""), set));
        let tables = std::iter::once((jobs.clone(), &self.jobs.all)).chain(kinds).chain(stages);
        let mut problems = Vec::new();
        for (table, set) in tables {
            for (setting, takers) in TAKEN_BY {
                if set.has(setting) && !takers.iter().any(|taker| used.contains(taker)) {
                    let takers: Vec<String> = takers.iter().map(|taker| format!("`{{{taker}}}`")).collect();
                    let none = if takers.len() > 1 { "none of" } else { "no" };
                    problems.push(format!(
                        "`{setting}` is set in `[{table}]`, and `submit` has {none} {}, so that it does nothing",
                        takers.join(", ")
                    ));
                }
            }
        }
        problems
    }
}

/// The placeholders in a line of shell: lower-case letters and underscores in braces. `${name}` and `{ print }` are the shell's
/// and awk's.
pub(crate) fn placeholders(text: &str) -> impl Iterator<Item = &str> {
    parts(text).filter_map(|part| match part {
        Part::Placeholder(name) => Some(name),
        Part::Text(_) => None,
    })
}

/// A piece of a template.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part<'a> {
    /// As it is.
    Text(&'a str),
    /// The name between braces.
    Placeholder(&'a str),
}

/// A template in pieces.
pub(crate) fn parts(text: &str) -> impl Iterator<Item = Part<'_>> {
    let mut rest = text;
    std::iter::from_fn(move || {
        if rest.is_empty() {
            return None;
        }
        let (part, length) = match placeholder_at(rest) {
            Some(name) => (Part::Placeholder(name), name.len() + 2),
            None => {
                // A brace after `$` belongs to the shell, and so does everything up to the next one.
                let is_start = |at: &usize| {
                    *at > 0 && !rest[..*at].ends_with('$') && placeholder_at(&rest[*at..]).is_some()
                };
                let end = rest.match_indices('{').map(|(at, _)| at).find(is_start).unwrap_or(rest.len());
                (Part::Text(&rest[..end]), end)
            }
        };
        rest = &rest[length..];
        Some(part)
    })
}

fn placeholder_at(text: &str) -> Option<&str> {
    let name = text.strip_prefix('{')?.split_once('}')?.0;
    let is_name = !name.is_empty() && name.bytes().all(|byte| byte.is_ascii_lowercase() || byte == b'_');
    is_name.then_some(name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Settings;
    use std::path::Path;

    fn parse(text: &str) -> Result<ExecutorSettings, String> {
        let parsed = Settings::parse(text.as_bytes(), Path::new("s.toml"));
        let mut executors = parsed.map_err(|error| error.to_string())?.executors;
        Ok(executors.remove("pbs").unwrap())
    }

    #[test]
    fn placeholders_are_told_from_the_braces_of_shell_and_awk() {
        let text = "qsub {script} ${name} '{print $1} { next }' {threads}";
        assert_eq!(placeholders(text).collect::<Vec<_>>(), ["script", "threads"]);
        let joined: String = parts(text)
            .map(|part| match part {
                Part::Text(text) => text.to_owned(),
                Part::Placeholder(name) => format!("<{name}>"),
            })
            .collect();
        assert_eq!(joined, "qsub <script> ${name} '{print $1} { next }' <threads>");
        assert_eq!(placeholders("{job}").collect::<Vec<_>>(), ["job"]);
    }

    #[test]
    fn an_executor_is_read_with_its_jobs() {
        let executor = parse(
            "[executors.pbs]\nsubmit = \"qsub -l mem={memory_mb}mb {script}\"\nstatus = \"qstat\"\n\
             cancel = \"qdel {jobs}\"\nstates = { over = [\"Z\"] }\n[executors.pbs.jobs]\nmemory = \"1G\"\npilots = 2\n",
        )
        .unwrap();
        assert_eq!((executor.jobs.all.memory, executor.jobs.pilots), (Some(1 << 30), Some(2)));
        assert_eq!(executor.states.over, ["Z"]);
    }

    #[test]
    fn all_mistakes_of_an_executor_are_reported_at_once() {
        let error = parse(
            "[executors.slurm]\nsubmit = \"qsub -q {queue} -l mem={memory_mb} {script}\"\nstatus = \"qstat\"\n\
             cancel = \"qdel\"\nid = \"Job\"\n",
        )
        .unwrap_err();
        for expected in [
            "s.toml:1:2: an executor cannot be called `slurm`",
            "unknown placeholder `{queue}`, expected one of `{script}`",
            "`submit` of executor `slurm` uses `{memory_mb}`: set `memory` in `[executors.slurm.jobs]`",
            "`cancel` of executor `slurm` has no `{jobs}`",
            "`id` of executor `slurm` has no `{id}`",
        ] {
            assert!(error.contains(expected), "{error}");
        }
        let error = parse("[executors.pbs]\nsubmit = \"qsub {script}\"\n").unwrap_err();
        assert!(error.contains("missing field `status`"), "{error}");
    }

    #[test]
    fn a_setting_that_no_placeholder_takes_is_an_error() {
        let text = |submit: &str, jobs: &str| {
            format!(
                "[executors.pbs]\nsubmit = \"qsub {submit} {{script}}\"\nstatus = \"qstat\"\ncancel = \"qdel {{jobs}}\"\n\
                 [executors.pbs.jobs]\n{jobs}"
            )
        };
        let error = parse(&text("", "partition = \"p\"\nextra = [\"-x\"]\nmemory = \"1G\"\n")).unwrap_err();
        for expected in [
            "`partition` is set in `[executors.pbs.jobs]`, and `submit` has no `{partition}`",
            "`extra` is set in `[executors.pbs.jobs]`, and `submit` has no `{extra}`",
            "and `submit` has none of `{memory_kb}`, `{memory_mb}`, `{memory_gb}`",
        ] {
            assert!(error.contains(expected), "{error}");
        }
        let error = parse(&text("", "[executors.pbs.jobs.kinds.a]\nqos = \"q\"\n")).unwrap_err();
        assert!(error.contains("`qos` is set in `[executors.pbs.jobs.kinds.a]`, and"), "{error}");
        let error = parse(&text("", "[executors.pbs.jobs.stages.\"a*\"]\naccount = \"q\"\n")).unwrap_err();
        assert!(error.contains("`account` is set in `[executors.pbs.jobs.stages.\"a*\"]`, and"), "{error}");
        // The stage stops by itself before the end of `time`.
        parse(&text("-q {partition}", "partition = \"p\"\ntime = \"1h\"\nthreads = 2\n")).unwrap();
    }
}
