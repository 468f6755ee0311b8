//! Slurm through its commands: `sbatch`, `squeue`, `scontrol`, `scancel`. Never `sacct`: many clusters switch accounting off,
//! and on others its database is hours behind.

use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::process::{Command, Output};
use std::time::Duration;

use super::prepare::OUTPUT;
use super::scheduler::{JobId, Scheduler, Seen, State, Submission, SubmitError};

/// Slurm, reached by the commands on the search path.
#[derive(Clone, Debug, Default)]
pub struct Slurm;

/// Parts of messages of `sbatch` after which trying again is useless.
const FINAL: [&str; 9] = [
    "invalid",
    "unrecognized",
    "unknown option",
    "is not available",
    "not permitted",
    "does not exist",
    "more processors requested",
    "unable to open file",
    "memory specification can not be satisfied",
];

/// Variables of a job that the engine itself may run in. Commands take defaults from them, which may contradict the options
/// of a new job.
const INHERITED: [&str; 6] = [
    "SLURM_MEM_PER_CPU",
    "SLURM_MEM_PER_NODE",
    "SLURM_MEM_PER_GPU",
    "SLURM_CPUS_PER_TASK",
    "SLURM_TIMELIMIT",
    "SLURM_EXPORT_ENV",
];

impl Scheduler for Slurm {
    fn name(&self) -> &str {
        "Slurm"
    }

    fn check(&self) -> Result<(), String> {
        output_of(Command::new("squeue").args(["--noheader", "--me", "--format=%i"])).map(drop)
    }

    fn submit(&self, submission: &Submission) -> Result<JobId, SubmitError> {
        let output = output_of(Command::new("sbatch").args(arguments(submission))).map_err(|error| {
            let lower = error.to_ascii_lowercase();
            if FINAL.iter().any(|text| lower.contains(text)) || lower.starts_with(MISSING) {
                SubmitError::Refused(error)
            } else {
                SubmitError::Busy(error)
            }
        })?;
        // `ID`, or `ID;cluster` where there are several clusters.
        let id = output.trim().split(';').next().unwrap_or_default();
        if id.is_empty() || !id.bytes().all(|byte| byte.is_ascii_digit()) {
            return Err(SubmitError::Busy(format!(
                "`sbatch` printed `{}`, expected a job number",
                output.trim()
            )));
        }
        Ok(id.to_owned())
    }

    fn list(&self) -> Result<BTreeMap<JobId, Seen>, String> {
        let output = output_of(Command::new("squeue").args([
            "--noheader",
            "--me",
            "--states=all",
            "--format=%i|%T|%N",
        ]))?;
        Ok(output.lines().filter_map(line).collect())
    }

    fn look(&self, job: &JobId) -> Result<Option<Seen>, String> {
        match output_of(Command::new("scontrol").args(["--oneliner", "show", "job", job])) {
            Ok(output) => Ok(seen(&output)),
            Err(error) if error.contains("Invalid job id") => Ok(None),
            Err(error) => Err(error),
        }
    }

    fn find(&self, name: &str) -> Result<Option<JobId>, String> {
        let name = format!("--name={name}");
        let output = output_of(Command::new("squeue").args([
            "--noheader",
            "--me",
            "--states=all",
            "--format=%i",
            &name,
        ]))?;
        Ok(output.lines().map(str::trim).find(|line| !line.is_empty()).map(str::to_owned))
    }

    fn stop(&self, jobs: &[JobId]) -> Result<(), String> {
        cancel(&["--state=PENDING"], jobs)?;
        // Only to the job's script, which is the program that runs the stage: it makes the stage stop.
        cancel(&["--batch", "--signal=USR1", "--state=RUNNING"], jobs)
    }

    fn cancel(&self, jobs: &[JobId]) -> Result<(), String> {
        cancel(&[], jobs)
    }
}

/// The arguments of `sbatch`.
fn arguments(submission: &Submission) -> Vec<String> {
    let Submission { name, script, folder, threads, memory, time, signal, gpus, .. } = submission;
    let output = folder.join(OUTPUT);
    let mut all = vec![
        "--parsable".to_owned(),
        format!("--job-name={name}"),
        format!("--chdir={}", folder.display()),
        format!("--output={}", output.display()),
        "--open-mode=append".to_owned(),
        "--requeue".to_owned(),
        "--nodes=1".to_owned(),
        "--ntasks=1".to_owned(),
        format!("--cpus-per-task={threads}"),
        format!("--signal=B:USR1@{}", signal.as_secs().max(1)),
    ];
    all.extend(memory.map(|bytes| format!("--mem={}M", bytes.div_ceil(1 << 20))));
    all.extend(time.map(|time| format!("--time={}", minutes(time))));
    if *gpus > 0 {
        all.push(format!("--gres=gpu:{gpus}"));
    }
    let Submission { partition, account, qos, extra, .. } = submission;
    for (option, value) in [("partition", partition), ("account", account), ("qos", qos)] {
        all.extend(value.as_ref().map(|value| format!("--{option}={value}")));
    }
    all.extend(extra.iter().cloned());
    all.push(script.display().to_string());
    all
}

/// Slurm counts in whole minutes.
fn minutes(time: Duration) -> u64 {
    time.as_secs().div_ceil(60).max(1)
}

fn cancel(options: &[&str], jobs: &[JobId]) -> Result<(), String> {
    // A command line has room for some thousand IDs.
    for jobs in jobs.chunks(1000) {
        match output_of(Command::new("scancel").args(options).args(jobs)) {
            Ok(_) => {}
            // It is fine if a job has ended in the meantime.
            Err(error) if error.contains("Invalid job id") || error.contains("already completing") => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// `4711|RUNNING|n1`
fn line(line: &str) -> Option<(JobId, Seen)> {
    let mut fields = line.trim().split('|');
    let (job, state, node) = (fields.next()?, fields.next()?, fields.next().unwrap_or_default());
    Some((job.to_owned(), Seen { state: self::state(state), node: node.to_owned() }))
}

/// From the output of `scontrol --oneliner show job`.
fn seen(line: &str) -> Option<Seen> {
    let field = |name: &str| line.split_whitespace().find_map(|word| word.strip_prefix(name));
    let node = field("BatchHost=").or_else(|| field("NodeList=")).filter(|node| *node != "(null)");
    Some(Seen { state: state(field("JobState=")?), node: node.unwrap_or_default().to_owned() })
}

/// An unknown state counts as running: a newer Slurm may have further states.
fn state(name: &str) -> State {
    match name {
        "PENDING" | "REQUEUED" | "REQUEUE_FED" | "REQUEUE_HOLD" | "RESV_DEL_HOLD" | "SPECIAL_EXIT" => {
            State::Waiting
        }
        "BOOT_FAIL" | "CANCELLED" | "COMPLETED" | "DEADLINE" | "FAILED" | "NODE_FAIL" | "OUT_OF_MEMORY"
        | "PREEMPTED" | "REVOKED" | "TIMEOUT" => State::Over(name.to_owned()),
        _ => State::Running,
    }
}

const MISSING: &str = "there is no program";

/// The output of a command.
fn output_of(command: &mut Command) -> Result<String, String> {
    for name in INHERITED {
        command.env_remove(name);
    }
    let program = command.get_program().to_string_lossy().into_owned();
    match command.output() {
        Ok(Output { status, stdout, .. }) if status.success() => {
            Ok(String::from_utf8_lossy(&stdout).into_owned())
        }
        Ok(Output { status, stdout, stderr }) => {
            let texts =
                [stderr, stdout].map(|text| String::from_utf8_lossy(&text).trim().replace('\n', "; "));
            let text = texts.into_iter().find(|text| !text.is_empty()).unwrap_or_else(|| status.to_string());
            Err(format!("`{program}`: {text}"))
        }
        Err(error) if error.kind() == ErrorKind::NotFound => Err(format!(
            "{MISSING} `{program}` here: run this where Slurm's commands are, as on a login node"
        )),
        Err(error) => Err(format!("`{program}`: {error}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_output_of_slurm_is_parsed() {
        assert_eq!(
            line("12|PENDING|\n"),
            Some(("12".into(), Seen { state: State::Waiting, node: String::new() }))
        );
        let running = Seen { state: State::Running, node: "n[1-2]".into() };
        assert_eq!(line("12_3|COMPLETING|n[1-2]"), Some(("12_3".into(), running)));
        let text = "JobId=7 JobName=x UserId=me(1) JobState=NODE_FAIL Reason=None Requeue=1 ExitCode=0:0 \
                    NodeList=(null) BatchHost=n3 Command=/a b";
        let expected = Seen { state: State::Over("NODE_FAIL".into()), node: "n3".into() };
        assert_eq!(seen(text), Some(expected));
        assert_eq!(seen("slurm_load_jobs error"), None);
        assert_eq!(state("SOMETHING_NEW"), State::Running);
    }

    #[test]
    fn a_job_requests_what_its_stage_needs() {
        let submission = Submission {
            name: "dril-1".into(),
            script: "/s/job.sh".into(),
            folder: "/s".into(),
            threads: 3,
            memory: Some((1 << 30) + 1),
            time: Some(Duration::from_secs(61)),
            signal: Duration::from_secs(60),
            gpus: 2,
            partition: Some("p".into()),
            account: None,
            qos: None,
            extra: vec!["--exclusive".into()],
        };
        let arguments = arguments(&submission).join(" ");
        for expected in [
            "--cpus-per-task=3",
            "--mem=1025M",
            "--time=2 ",
            "--signal=B:USR1@60",
            "--gres=gpu:2",
            "--partition=p --exclusive /s/job.sh",
        ] {
            assert!(arguments.contains(expected), "{arguments}");
        }
    }
}
