//! A scheduler that is described by its commands: stand-ins for those of PBS (`tests/executor/`) that run jobs in the
//! background.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use dril_pipe::cluster::{ClusterRunner, Pace, Site, Template};
use dril_pipe::exec::Options;
use dril_pipe::settings::{ExecutorSettings, Settings};
use serde_json::json;

use crate::lab::{Lab, Ran};
use crate::scenario::StageLine;
use crate::sealed::{self, Sealed};

/// The commands, with their queue in a folder.
pub fn pbs(queue: &Path, jobs: &str) -> String {
    std::fs::create_dir_all(queue).unwrap();
    let commands = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/executor");
    let (commands, queue) = (commands.display(), queue.display());
    format!(
        "[executors.pbs]\n\
         submit = \"QUEUE={queue} {commands}/qsub -N {{name}} -o {{output}} -l ncpus={{threads}}:mem={{memory_mb}}mb {{script}}\"\n\
         status = \"QUEUE={queue} {commands}/qstat\"\n\
         cancel = \"QUEUE={queue} {commands}/qdel {{jobs}}\"\n\
         stop = \"QUEUE={queue} {commands}/qsig -s USR1 {{jobs}}\"\n\
         [executors.pbs.jobs]\n\
         memory = \"100M\"\n\
         local = []\n\
         {jobs}\n"
    )
}

fn executor(queue: &Path, jobs: &str) -> ExecutorSettings {
    let text = pbs(queue, jobs);
    Settings::parse(text.as_bytes(), Path::new("s.toml")).unwrap().executors.remove("pbs").unwrap()
}

/// A queue in the lab's folder.
fn queue(lab: &Lab) -> PathBuf {
    let queue = lab.folder.path().join("queue");
    std::fs::create_dir_all(&queue).unwrap();
    queue
}

fn run(lab: &Lab, stages: &[StageLine], executor: ExecutorSettings) -> Ran {
    let jobs = executor.jobs.clone();
    let pace = Pace {
        look: Duration::from_millis(20),
        ask: Duration::from_millis(200),
        settle: Duration::from_millis(400),
    };
    let site = Site {
        pace,
        program: sealed::program(),
        ..Site::new(std::path::absolute(lab.store.root()).unwrap()).unwrap()
    };
    let runner = ClusterRunner::new(Arc::new(Template::new("pbs", executor)), jobs, site).unwrap();
    let options = Options { threads: 8, checkpoint_seconds: 0.0, ..Options::default() };
    lab.run_with(stages, &runner, &options, &AtomicBool::new(false))
}

fn words(count: usize) -> Vec<StageLine> {
    (0..count)
        .map(|number| StageLine::new(&format!("s{number}"), "emit", json!({ "text": number.to_string() })))
        .collect()
}

/// Jobs that were submitted.
pub fn submitted(queue: &Path) -> usize {
    std::fs::read_dir(queue).unwrap().filter(|entry| entry.as_ref().unwrap().path().is_dir()).count()
}

const CHAIN: &str = "name: chain\naxes: { word: [one, two] }\nstages:\n  \
    say: { kind: emit, matrix: [word], with: { text: \"${word} \" } }\n  \
    count: { kind: count, matrix: [word], with: { to: 20, step_millis: 50 }, inputs: { start: say } }\n  \
    gather: { kind: concat, inputs: { parts: count.count } }\n";

#[test]
fn another_scheduler_gives_the_results_of_a_local_run_with_and_without_pilots() {
    let sealed = Sealed::with(CHAIN);
    sealed.run_ok("run p.yaml --cache local --out here");
    for (number, pilots) in ["", "pilots = 2"].iter().enumerate() {
        let queue = sealed.path(&format!("queue{number}"));
        sealed.write("dril-pipe.toml", &pbs(&queue, pilots));
        sealed.run_ok(&format!("run p.yaml --executor pbs --cache c{number} --out r{number}"));
        let file = format!("r{number}/gather.md");
        assert_eq!(sealed.read(&file), sealed.read("here/gather.md"));
        assert_eq!(submitted(&queue), if pilots.is_empty() { 5 } else { 2 });
    }
    let requests = sealed.read("queue0/requests");
    assert!(requests.lines().all(|line| line == "ncpus=1:mem=100mb"), "{requests}");
}

#[test]
fn an_executor_that_is_not_in_the_settings_is_reported_with_those_that_are() {
    let sealed = Sealed::with(CHAIN);
    sealed.write("dril-pipe.toml", &pbs(&sealed.path("queue"), ""));
    let ended = sealed.run("run p.yaml --executor lsf");
    assert_eq!(ended.code, 2, "{ended:?}");
    assert!(ended.stderr.contains("expected one of `local`, `slurm`, `pbs`"), "{}", ended.stderr);
}

#[test]
fn a_busy_scheduler_is_tried_again_and_a_refusal_is_an_error_that_names_it() {
    let lab = Lab::new();
    let queue = queue(&lab);
    std::fs::write(queue.join("busy"), "2").unwrap();
    let ran = run(&lab, &words(3), executor(&queue, ""));
    assert_eq!(ran.counts(), [3, 0, 0, 0, 0], "{}", ran.error());
    assert_eq!(submitted(&queue), 3);
    std::fs::write(queue.join("refuse"), "").unwrap();
    let ran = run(&lab, &words(4), executor(&queue, "pilots = 2"));
    assert_eq!(ran.counts(), [0, 3, 1, 0, 0]);
    assert!(ran.error().contains("pbs refuses its job: `QUEUE="), "{}", ran.error());
    assert!(ran.error().contains("qsub: Unknown queue"), "{}", ran.error());
}

#[test]
fn a_job_that_vanishes_is_submitted_again() {
    let lab = Lab::new();
    let queue = queue(&lab);
    std::fs::write(queue.join("vanish"), "").unwrap();
    let ran = run(&lab, &words(2), executor(&queue, ""));
    assert_eq!(ran.counts(), [2, 0, 0, 0, 0], "{}", ran.error());
    assert_eq!(submitted(&queue), 3);
}

#[test]
fn without_signals_of_the_scheduler_a_stage_stops_by_itself_before_its_time_is_over() {
    let lab = Lab::new();
    let queue = queue(&lab);
    let stages = [StageLine::new("long", "count", json!({ "to": 30, "step_millis": 100 }))];
    let ran = run(&lab, &stages, executor(&queue, "time = \"3s\"\nsignal = \"2s\""));
    assert_eq!(ran.counts(), [1, 0, 0, 0, 0], "{}", ran.error());
    assert!(submitted(&queue) >= 3, "{} jobs of a second for a stage of three", submitted(&queue));
}

#[test]
fn a_stage_that_is_signalled_before_its_job_is_stopped_and_not_failed() {
    let lab = Lab::new();
    let queue = queue(&lab);
    let stages = [StageLine::new("long", "count", json!({ "to": 200, "step_millis": 10 }))];
    let commands = executor(&queue, "");
    let cancel = commands.cancel.replace("{jobs}", "1");
    let kill = std::thread::spawn({
        let checkpoints = lab.store.root().join("checkpoints-v1");
        move || {
            let began = Instant::now();
            while began.elapsed() < Duration::from_secs(20) && !has_checkpoint(&checkpoints) {
                std::thread::sleep(Duration::from_millis(20));
            }
            assert!(std::process::Command::new("bash").args(["-c", &cancel]).status().unwrap().success());
        }
    });
    let ran = run(&lab, &stages, commands);
    kill.join().unwrap();
    assert_eq!(ran.counts(), [1, 0, 0, 0, 0], "{}", ran.error());
    assert_eq!(submitted(&queue), 2);
}

fn has_checkpoint(checkpoints: &Path) -> bool {
    let folders = std::fs::read_dir(checkpoints).into_iter().flatten().flatten();
    folders
        .flat_map(|key| std::fs::read_dir(key.path()).into_iter().flatten().flatten())
        .any(|found| found.path().join("state.json").is_file() || found.file_name() == "state.json")
}

#[test]
fn an_interrupt_stops_jobs_with_a_checkpoint_with_and_without_a_command_for_signals() {
    for has_stop in [true, false] {
        let sealed = Sealed::with(CHAIN);
        sealed.run_ok("run p.yaml --cache local --out here");
        let settings = pbs(&sealed.path("queue"), "");
        let settings: Vec<&str> =
            settings.lines().filter(|line| has_stop || !line.starts_with("stop")).collect();
        // The variable that makes stages leave a trace reaches them only through the scheduler.
        sealed.write("dril-pipe.toml", &settings.join("\n").replace("/qsub ", "/qsub -V "));
        let trace = sealed.path("trace");
        let begun = || std::fs::read_to_string(&trace).unwrap_or_default().matches("begin count").count();
        let mut command = sealed.command("run p.yaml --executor pbs --checkpoint-every 0 --quiet");
        let mut engine = command.env("DRIL_FAKES_TRACE", &trace).spawn().unwrap();
        let began = Instant::now();
        while begun() < 2 {
            assert!(began.elapsed() < Duration::from_secs(60));
            std::thread::sleep(Duration::from_millis(10));
        }
        std::thread::sleep(Duration::from_millis(200));
        let pid = rustix::process::Pid::from_child(&engine);
        rustix::process::kill_process(pid, rustix::process::Signal::TERM).unwrap();
        let stopped = Instant::now();
        assert_eq!(engine.wait().unwrap().code(), Some(130));
        assert!(stopped.elapsed() < Duration::from_secs(30), "it waited for files that will not come");
        let mut again = sealed.command("run p.yaml --executor pbs --out r --quiet");
        assert!(again.env("DRIL_FAKES_TRACE", &trace).status().unwrap().success());
        let steps = std::fs::read_to_string(&trace).unwrap().matches("step count").count();
        assert_eq!(steps, 40, "every step once");
        assert_eq!(sealed.read("r/gather.md"), sealed.read("here/gather.md"));
    }
}

/// A stage of a shell script whose output is its table.
fn script(name: &str, with: &str, shell: &str, fields: &str) -> String {
    format!(
        "  {name}:\n    kind: command\n    timeout: 20s\n{fields}    with:\n      outputs: {{ t: {{ type: table, path: t.csv }} }}\n\
         {with}      shell: |\n        {shell}\n"
    )
}

#[test]
fn stages_on_gpus_run_side_by_side_on_those_that_the_scheduler_assigned() {
    let sealed = Sealed::new();
    let folder = sealed.path("").display().to_string();
    let stage = |own: &str, other: &str| {
        let shell = format!(
            "echo $$CUDA_VISIBLE_DEVICES $$DRIL_RESOURCE_GPU > {{outputs.t}}; touch {folder}{own}; \
             until test -e {folder}{other}; do sleep 0.05; done"
        );
        script(own, "", &shell, "    resources: { gpu: 1 }\n")
    };
    sealed.write("p.yaml", &format!("name: g\nstages:\n{}{}", stage("one", "two"), stage("two", "one")));
    let queue = sealed.path("queue");
    sealed.write("dril-pipe.toml", &pbs(&queue, "").replace("-l ncpus", "-l ngpus={gpus}:ncpus"));
    sealed.write("queue/gpus", "");
    sealed.run_ok("run p.yaml --executor pbs");
    let mut seen = ["one", "two"].map(|name| sealed.read(&format!("results/g-default/{name}.csv")));
    seen.sort();
    assert_eq!(seen, ["5 5\n", "6 6\n"]);
    assert!(sealed.read("queue/requests").starts_with("ngpus=1:ncpus=1"));
    let mut command = sealed.command("run p.yaml --executor pbs --resources gpu=2 --force one --force two");
    command.env("CUDA_VISIBLE_DEVICES", "3");
    assert_eq!(sealed::ended(command).code, 0, "the GPUs of this machine say nothing about the cluster");
    std::fs::remove_file(queue.join("gpus")).unwrap();
    sealed.run_ok("run p.yaml --executor pbs --force one --force two");
    let seen = ["one", "two"].map(|name| sealed.read(&format!("results/g-default/{name}.csv")));
    assert_eq!(seen, ["0 0\n", "0 0\n"], "on a node without a list of GPUs they are counted from 0");
}

#[test]
fn a_command_in_a_job_has_the_variables_and_the_programs_of_the_run() {
    let with = "      env: [IN_KEY]\n      pass_env: [TOKEN, UNSET]\n";
    let shell =
        "greet \"$$IN_KEY $$TOKEN $${UNSET-unset} $$(stat -c %a $$PWD/../environment.json)\" > {outputs.t}";
    for (number, pilots) in ["", "pilots = 1"].iter().enumerate() {
        let sealed = Sealed::with(&format!("name: v\nstages:\n{}", script("s", with, shell, "")));
        sealed.write(
            "dril-pipe.toml",
            &pbs(&sealed.path("queue"), pilots).replace("memory = ", "time = \"1h\"\nmemory = "),
        );
        sealed.write("bin/greet", "#!/bin/sh\necho hello $1\n");
        let greet = sealed.path("bin/greet");
        std::fs::set_permissions(&greet, std::os::unix::fs::PermissionsExt::from_mode(0o755)).unwrap();
        let mut command = sealed.command("run p.yaml --executor pbs");
        command.env("PATH", format!("{}:/usr/bin:/bin", sealed.path("bin").display()));
        command.env("IN_KEY", "a").env("TOKEN", "it's secret");
        let ended = sealed::ended(command);
        assert_eq!(ended.code, 0, "{number}: {ended:?}");
        assert_eq!(sealed.read("results/v-default/s.csv"), "hello a it's secret unset 600\n");
        let left = crate::lab::files_below(&sealed.path("cache"));
        assert!(left.iter().all(|file| !file.ends_with("environment.json")), "{left:?}");
        assert_eq!(submitted(&sealed.path("queue")), 1);
    }
}

#[test]
fn the_examples_of_the_manual_run_where_their_commands_behave_as_those_of_pbs_and_lsf() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let manual = std::fs::read_to_string(root.join("docs/cluster.md")).unwrap();
    for name in ["pbs", "lsf"] {
        let example = manual.split("```toml\n").find(|text| text.starts_with(&format!("[executors.{name}]")));
        let example = example.and_then(|text| text.split_once("```")).unwrap().0;
        let sealed = Sealed::with(CHAIN);
        sealed.write("dril-pipe.toml", &format!("{example}\nlocal = []\n"));
        std::fs::create_dir(sealed.path("queue")).unwrap();
        let mut command = sealed.command(&format!("run p.yaml --executor {name}"));
        command.env("PATH", format!("{}:/usr/bin:/bin", root.join("tests/executor").display()));
        command.env("QUEUE", sealed.path("queue")).env("USER", "user");
        let ended = sealed::ended(command);
        assert_eq!(ended.code, 0, "{name}: {ended:?}");
        assert_eq!(submitted(&sealed.path("queue")), 5);
    }
}

#[test]
fn settings_for_kinds_that_do_not_exist_are_errors_with_their_place() {
    let sealed = Sealed::with(CHAIN);
    sealed.write(
        "dril-pipe.toml",
        "[slurm]\nlocal = [\"concat\", \"tabel\"]\n[slurm.kinds.comand]\ntime = \"1h\"\n",
    );
    for args in ["run p.yaml", "plan p.yaml --executor slurm"] {
        let ended = sealed.run(args);
        assert_eq!(ended.code, 2, "{args}: {ended:?}");
        let place = "dril-pipe.toml:2:20: there is no kind `tabel`; there is no kind `comand`, did you mean `command`?";
        assert!(ended.stderr.contains(place), "{args}: {}", ended.stderr);
    }
    let jobs = pbs(&sealed.path("queue"), "[executors.pbs.jobs.kinds.conct]\nthreads = 1");
    sealed.write("dril-pipe.toml", &jobs);
    let ended = sealed.run("run p.yaml");
    assert!(
        ended.stderr.contains("dril-pipe.toml:9:27: there is no kind `conct`, did you mean `concat`?"),
        "{ended:?}"
    );
}
