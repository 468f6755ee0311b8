//! A scheduler by the commands that `[executors.NAME]` of the settings describes, for systems such as PBS, LSF, Grid Engine and
//! HyperQueue.

use std::collections::BTreeMap;
use std::process::{Command, Output};
use std::time::Duration;

use super::scheduler::{JobId, Scheduler, Seen, State, Submission, SubmitError};
use crate::exec::quoted;
use crate::settings::{ExecutorSettings, Part, parts, placeholders};

/// Jobs in one command line.
const JOBS: usize = 1000;

/// Parts of messages, in lower case, after which a submission is tried again for an hour.
const BUSY: [&str; 14] = [
    "busy",
    "timed out",
    "timeout",
    "time out",
    "connect",
    "try again",
    "temporar",
    "unavailable",
    "not responding",
    "no response",
    "overload",
    "limit",
    "too many",
    "unreachable",
];
/// Parts of messages, in lower case, after which trying again is useless.
const REFUSED: [&str; 9] = [
    "unknown queue",
    "no such queue",
    "illegal",
    "invalid",
    "syntax",
    "unauthorized",
    "not permitted",
    "denied",
    "command not found",
];
/// States of PBS, Grid Engine, LSF and HyperQueue, in lower case.
const WAITING: [&str; 10] = ["q", "h", "w", "qw", "hqw", "pend", "psusp", "wait", "waiting", "pending"];
const OVER: [&str; 10] = ["f", "c", "x", "done", "exit", "finished", "completed", "zombi", "eqw", "gone"];
const CANCELLED: [&str; 2] = ["canceled", "cancelled"];
const FAILED: [&str; 1] = ["failed"];

/// A scheduler by its commands.
#[derive(Clone, Debug)]
pub struct Template {
    name: String,
    settings: ExecutorSettings,
}

impl Template {
    /// The executor `name` of the settings.
    pub fn new(name: &str, settings: ExecutorSettings) -> Self {
        Self { name: name.to_owned(), settings }
    }

    /// True where `status` is about one job.
    fn asks_for_each(&self) -> bool {
        placeholders(&self.settings.status).any(|name| name == "job")
    }

    fn state(&self, name: &str) -> State {
        let states = &self.settings.states;
        let lower = name.to_ascii_lowercase();
        let is = |own: &[String], usual: &[&str]| {
            // What the user lists for another state is not usual any more.
            let listed = [&states.waiting, &states.running, &states.over, &states.cancelled, &states.failed];
            let is_listed = listed.iter().any(|list| list.iter().any(|listed| listed == name));
            own.iter().any(|own| own == name) || (!is_listed && usual.contains(&&*lower))
        };
        if is(&states.waiting, &WAITING) {
            State::Waiting
        } else if is(&states.cancelled, &CANCELLED) {
            State::Over("CANCELLED".to_owned())
        } else if is(&states.failed, &FAILED) {
            State::Over("FAILED".to_owned())
        } else if is(&states.over, &OVER) {
            State::Over(name.to_owned())
        } else {
            State::Running
        }
    }

    /// The ID in the output of `submit`.
    fn id(&self, output: &str) -> Option<JobId> {
        let id = match &self.settings.id {
            None => output.split_whitespace().last()?,
            Some(pattern) => {
                let (before, after) = pattern.split_once("{id}")?;
                let rest = output.split_once(before)?.1;
                if after.is_empty() { rest.split_whitespace().next()? } else { rest.split_once(after)?.0 }
            }
        };
        Some(short(id)).filter(|id| !id.is_empty())
    }

    fn submission_error(&self, error: String) -> SubmitError {
        let lower = error.to_ascii_lowercase();
        let has = |own: &[String], usual: &[&str]| {
            own.iter().any(|part| error.contains(part)) || usual.iter().any(|part| lower.contains(part))
        };
        // The user's own first.
        if has(&self.settings.refused, &[]) {
            SubmitError::Refused(error)
        } else if has(&self.settings.busy, &[]) {
            SubmitError::Busy(error)
        } else if has(&[], &REFUSED) {
            SubmitError::Refused(error)
        } else if has(&[], &BUSY) {
            SubmitError::Busy(error)
        } else {
            SubmitError::Unclear(error)
        }
    }

    /// Runs a command for jobs: once for all, or once for each.
    fn for_jobs(&self, template: &str, jobs: &[JobId]) -> Result<(), String> {
        let each = placeholders(template).any(|name| name == "job");
        for jobs in jobs.chunks(if each { 1 } else { JOBS }) {
            let list = jobs.iter().map(|job| quoted(job)).collect::<Vec<_>>().join(" ");
            shell(&fill(template, |_| list.clone()))?;
        }
        Ok(())
    }
}

impl Scheduler for Template {
    fn name(&self) -> &str {
        &self.name
    }

    fn job_in_shell(&self) -> Option<String> {
        // PBS, LSF, Grid Engine, HyperQueue.
        let usual = || "${PBS_JOBID:-${LSB_JOBID:-${JOB_ID:-${HQ_JOB_ID:-}}}}".to_owned();
        let own = self.settings.job_variable.as_ref();
        Some(own.map_or_else(usual, |variable| format!("${{{variable}:-}}")))
    }

    fn signals_before_the_end(&self) -> bool {
        false
    }

    fn check(&self) -> Result<(), String> {
        if self.asks_for_each() {
            return Ok(());
        }
        self.list().map(drop).map_err(|error| format!("`status` of executor `{}` fails: {error}", self.name))
    }

    fn submit(&self, submission: &Submission) -> Result<JobId, SubmitError> {
        if submission.gpus > 0 && !placeholders(&self.settings.submit).any(|name| name == "gpus") {
            return Err(SubmitError::Refused(format!(
                "it needs {} GPUs, and `submit` of executor `{}` has no `{{gpus}}`",
                submission.gpus, self.name
            )));
        }
        let command = fill(&self.settings.submit, |name| value(submission, name));
        let output = shell(&command).map_err(|error| self.submission_error(error))?;
        self.id(&output).ok_or_else(|| {
            let output = output.trim();
            SubmitError::Unclear(format!("`submit` printed `{output}`, where no job ID was found"))
        })
    }

    fn list(&self) -> Result<BTreeMap<JobId, Seen>, String> {
        if self.asks_for_each() {
            return Ok(BTreeMap::new());
        }
        let output = match shell(&self.settings.status) {
            Err(error) if says_no_jobs(&error) => return Ok(BTreeMap::new()),
            output => output?,
        };
        let line = |line: &str| {
            let mut words = line.split_whitespace();
            let (job, state) = (short(words.next()?), self.state(words.next()?));
            Some((job, Seen { state, node: words.next().unwrap_or_default().to_owned() }))
        };
        Ok(output.lines().filter_map(line).collect())
    }

    fn look(&self, job: &JobId) -> Result<Option<Seen>, String> {
        if !self.asks_for_each() {
            // What is not in the list is gone.
            return Ok(None);
        }
        match shell(&fill(&self.settings.status, |_| quoted(job))) {
            Ok(output) => {
                let state = output.split_whitespace().last().map_or(State::Running, |name| self.state(name));
                Ok(Some(Seen { state, node: String::new() }))
            }
            Err(error) if matches!(self.submission_error(error.clone()), SubmitError::Busy(_)) => Err(error),
            Err(_) => Ok(None),
        }
    }

    /// These commands know no names. A job that was submitted twice runs its stage once.
    fn find(&self, _: &str) -> Result<Option<JobId>, String> {
        Ok(None)
    }

    fn stop(&self, jobs: &[JobId]) -> Result<(), String> {
        let Some(stop) = &self.settings.stop else { return self.cancel(jobs) };
        let listed = self.list()?;
        let waits = |job: &&JobId| matches!(listed.get(*job), Some(Seen { state: State::Waiting, .. }));
        let (waiting, running): (Vec<&JobId>, Vec<&JobId>) = jobs.iter().partition(waits);
        self.cancel(&waiting.into_iter().cloned().collect::<Vec<_>>())?;
        self.for_jobs(stop, &running.into_iter().cloned().collect::<Vec<_>>())
    }

    fn cancel(&self, jobs: &[JobId]) -> Result<(), String> {
        self.for_jobs(&self.settings.cancel, jobs)
    }
}

/// True for messages as "No job found" or "No unfinished job found", with which LSF's `bjobs` fails where there is none.
fn says_no_jobs(error: &str) -> bool {
    let lower = error.to_ascii_lowercase();
    let words: Vec<&str> =
        lower.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty()).collect();
    let ends = words.windows(2).enumerate().filter(|(_, two)| matches!(two, ["job" | "jobs", "found"]));
    ends.into_iter().any(|(at, _)| words[at.saturating_sub(2)..at].contains(&"no"))
}

/// An ID without the server's name: `12` of `12.server`, which some commands shorten.
fn short(id: &str) -> JobId {
    id.split('.').next().unwrap_or_default().to_owned()
}

/// A line of shell with its placeholders replaced.
fn fill(template: &str, value: impl Fn(&str) -> String) -> String {
    parts(template)
        .map(|part| match part {
            Part::Text(text) => text.to_owned(),
            Part::Placeholder(name) => value(name),
        })
        .collect()
}

/// The value of a placeholder of `submit`. Settings were checked to have it.
fn value(submission: &Submission, name: &str) -> String {
    let Submission { script, folder, threads, memory, time, gpus, .. } = submission;
    let (memory, seconds) = (memory.unwrap_or(0), time.unwrap_or(Duration::ZERO).as_secs());
    let text = |value: &Option<String>| quoted(value.as_deref().unwrap_or_default());
    match name {
        "script" => quoted(&script.to_string_lossy()),
        "folder" => quoted(&folder.to_string_lossy()),
        "output" => quoted(&folder.join(super::prepare::OUTPUT).to_string_lossy()),
        "name" => submission.name.clone(),
        "threads" => threads.to_string(),
        "gpus" => gpus.to_string(),
        "memory_kb" => memory.div_ceil(1 << 10).to_string(),
        "memory_mb" => memory.div_ceil(1 << 20).to_string(),
        "memory_gb" => memory.div_ceil(1 << 30).to_string(),
        "seconds" => seconds.to_string(),
        "minutes" => seconds.div_ceil(60).to_string(),
        "time" => format!("{:02}:{:02}:{:02}", seconds / 3600, seconds / 60 % 60, seconds % 60),
        "partition" => text(&submission.partition),
        "account" => text(&submission.account),
        "qos" => text(&submission.qos),
        _ => submission.extra.iter().map(|extra| quoted(extra)).collect::<Vec<_>>().join(" "),
    }
}

/// The output of a line of shell. A failure inside a pipe is one of the whole line.
fn shell(line: &str) -> Result<String, String> {
    let output = Command::new("bash").args(["-o", "pipefail", "-c", line]).output();
    let Output { status, stdout, stderr } = output.map_err(|error| format!("`bash`: {error}"))?;
    if status.success() {
        return Ok(String::from_utf8_lossy(&stdout).into_owned());
    }
    let program = line.split_whitespace().next().unwrap_or_default();
    let texts = [stderr, stdout].map(|text| String::from_utf8_lossy(&text).trim().replace('\n', "; "));
    let text = texts.into_iter().find(|text| !text.is_empty()).unwrap_or_else(|| status.to_string());
    Err(format!("`{program}`: {text}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn template(change: impl Fn(&mut ExecutorSettings)) -> Template {
        let mut settings = ExecutorSettings::default();
        change(&mut settings);
        Template::new("pbs", settings)
    }

    #[test]
    fn the_id_of_a_job_is_found_in_what_other_schedulers_print() {
        let id = |output: &str, pattern: Option<&str>| {
            template(|settings| settings.id = pattern.map(str::to_owned)).id(output)
        };
        assert_eq!(id("4711.pbs01\n", None).as_deref(), Some("4711"));
        let lsf = "Job <12> is submitted to queue <normal>.\n";
        assert_eq!(id(lsf, Some("Job <{id}>")).as_deref(), Some("12"));
        assert_eq!(id("Your job 7 (\"x\") has been submitted\n", Some("job {id}")).as_deref(), Some("7"));
        assert_eq!(id(" \n", None), None);
        assert_eq!(id("Job <12>", Some("Task <{id}>")), None);
    }

    #[test]
    fn states_of_several_schedulers_are_known_and_own_names_take_precedence() {
        let usual = template(|_| {});
        for (name, expected) in [
            ("Q", State::Waiting),
            ("PEND", State::Waiting),
            ("R", State::Running),
            ("SOMETHING", State::Running),
            ("DONE", State::Over("DONE".to_owned())),
            ("CANCELED", State::Over("CANCELLED".to_owned())),
            ("FAILED", State::Over("FAILED".to_owned())),
        ] {
            assert_eq!(usual.state(name), expected, "{name}");
        }
        let own = template(|settings| settings.states.running = vec!["C".to_owned()]);
        assert_eq!((own.state("C"), own.state("F")), (State::Running, State::Over("F".to_owned())));
    }

    #[test]
    fn errors_of_submissions_are_told_apart() {
        let template = template(|settings| settings.busy = vec!["queue is full".to_owned()]);
        let error = |text: &str| template.submission_error(text.to_owned());
        assert!(matches!(error("qsub: Unknown queue"), SubmitError::Refused(_)));
        assert!(matches!(error("qsub: cannot connect to server"), SubmitError::Busy(_)));
        assert!(matches!(error("the queue is full"), SubmitError::Busy(_)));
        assert!(matches!(error("?"), SubmitError::Unclear(_)));
    }

    #[test]
    fn a_list_without_jobs_is_distinguished_from_a_scheduler_that_does_not_answer() {
        for none in ["`bjobs`: No job found", "No unfinished job found", "No matching jobs found in queue x"]
        {
            assert!(says_no_jobs(none), "{none}");
        }
        for error in ["cannot connect", "Job <12> is not found", "no server; 3 jobs found", "job found"] {
            assert!(!says_no_jobs(error), "{error}");
        }
    }

    #[test]
    fn placeholders_have_values_in_the_units_of_the_scheduler() {
        let submission = Submission {
            name: "dril-1".into(),
            script: "/a b/job.sh".into(),
            folder: "/s".into(),
            threads: 3,
            memory: Some((1 << 30) + 1),
            time: Some(Duration::from_secs(3661)),
            signal: Duration::from_secs(60),
            gpus: 2,
            partition: Some("p".into()),
            account: None,
            qos: None,
            extra: vec!["-P x".into(), "-V".into()],
        };
        let line = "q -N {name} -n {threads} {memory_mb} {memory_gb} {time} {minutes} {gpus} {partition} {extra} {script}";
        let filled = fill(line, |name| value(&submission, name));
        assert_eq!(filled, "q -N dril-1 -n 3 1025 2 01:01:01 62 2 'p' '-P x' '-V' '/a b/job.sh'");
    }
}
