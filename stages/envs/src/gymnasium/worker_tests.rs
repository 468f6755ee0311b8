//! Every way in which the other side can fail, played by a small Python script.

use super::*;
use rustix::process::{Pid, test_kill_process};

/// A launch of the script, which needs no package, with little patience.
pub(in crate::gymnasium) fn fake() -> Launch {
    let requirements = format!("{:?}", crate::gymnasium::venv::REQUIREMENTS);
    Launch {
        program: "python3".into(),
        source: include_str!("fake.py").replace("@REQUIREMENTS@", &requirements),
        start: Duration::from_secs(60),
        step: Duration::from_secs(60),
    }
}

fn impatient() -> Launch {
    Launch { start: Duration::from_secs(3), step: Duration::from_secs(1), ..fake() }
}

fn worker(id: &str, launch: &Launch) -> Result<Worker, GymnasiumError> {
    Worker::start(launch, &GymnasiumConfig::new(id), 2, false)
}

fn step(worker: &mut Worker) -> Result<Step, GymnasiumError> {
    worker.ask(Operation::Step, 1, 0, &0.5f32.to_le_bytes())?;
    worker.fetch(1)
}

/// True while there is such a process that is not dead.
fn lives(process: u32) -> bool {
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat"));
    if let Ok(stat) = stat {
        return !stat.contains(") Z ");
    }
    let process = Pid::from_raw(process as i32).unwrap();
    test_kill_process(process).is_ok()
}

/// The error of a step, after which the worker is dead and says the same again.
fn step_error(id: &str, launch: &Launch) -> String {
    let mut worker = worker(id, launch).unwrap();
    worker.ask(Operation::Reset, 1, 5, &[]).unwrap();
    worker.fetch(1).unwrap();
    let error = step(&mut worker).unwrap_err();
    assert!(!lives(worker.process()), "{id}");
    assert_eq!(step(&mut worker).unwrap_err(), error, "nothing is asked of a dead worker");
    error.to_string()
}

fn has(text: &str, words: &[&str]) {
    for word in words {
        assert!(text.contains(word), "`{word}` is missing in: {text}");
    }
}

#[test]
fn requests_may_be_sent_ahead_and_replies_fetched_in_any_order() {
    let mut worker = worker("counter", &fake()).unwrap();
    for env in [0, 1] {
        worker.ask(Operation::Reset, env, 7 + env as u64, &[]).unwrap();
    }
    worker.fetch(1).unwrap();
    worker.ask(Operation::Step, 1, 0, &2.0f32.to_le_bytes()).unwrap();
    worker.fetch(0).unwrap();
    worker.ask(Operation::Step, 0, 0, &1.0f32.to_le_bytes()).unwrap();
    assert_eq!(worker.fetch(0).unwrap().reward, 8.0);
    assert_eq!(worker.fetch(1).unwrap().reward, 17.0);
    assert_eq!(worker.seen(1), [8.0f32, 1.0].map(f32::to_le_bytes).concat());
}

#[test]
fn a_worker_that_dies_is_told_with_its_last_words() {
    let text = step_error("dies-stepping", &fake());
    has(
        &text,
        &["`dies-stepping` exited while stepping", "exit status: 7", "MemoryError: no room for the car"],
    );
    let text = worker("dies-early", &fake()).unwrap_err().to_string();
    has(&text, &["exited while starting", "exit status: 7", "no room"]);
    let text = step_error("halves", &fake());
    has(&text, &["exited while stepping", "exit status: 0", "(it said nothing)"]);
}

#[test]
fn a_worker_that_hangs_is_killed_after_a_while() {
    let text = step_error("hangs-stepping", &impatient());
    has(&text, &["did not respond for 1 s while stepping", "was killed"]);
    let text = worker("hangs-early", &impatient()).unwrap_err().to_string();
    has(&text, &["did not respond for 3 s while starting"]);
}

#[test]
fn what_others_print_between_the_replies_is_noticed() {
    let text = step_error("prints-stepping", &fake());
    has(&text, &["invalid response while stepping", "begins with `pygam`, expected `DRYMS`"]);
    let text = worker("prints-early", &fake()).unwrap_err().to_string();
    has(&text, &["invalid response while starting", "expected `DRILGYM1`"]);
    let text = worker("other-protocol", &fake()).unwrap_err().to_string();
    has(&text, &["protocol 2, expected 1"]);
}

#[test]
fn an_unknown_id_and_other_packages_are_refused_with_what_to_do() {
    let text = worker("Nonsense-v0", &fake()).unwrap_err().to_string();
    has(&text, &["Gymnasium has no environment `Nonsense-v0`", "did you mean `Sense`?"]);
    let text = worker("old-packages", &fake()).unwrap_err().to_string();
    has(&text, &["gymnasium 0.26.3, expected gymnasium 1.", "-m pip install gymnasium=="]);
    let text = worker("no-packages", &fake()).unwrap_err().to_string();
    has(&text, &["no package box2d, expected box2d"]);
    let missing = Launch { program: "no-such-python".into(), ..fake() };
    let text = worker("counter", &missing).unwrap_err().to_string();
    has(&text, &["cannot start `no-such-python`", "set DRIL_PIPE_PYTHON", "leave it unset"]);
}

#[test]
fn a_dropped_worker_leaves_no_process_behind() {
    let worker = worker("counter", &fake()).unwrap();
    let process = worker.process();
    assert!(lives(process));
    drop(worker);
    assert!(!lives(process));
}

#[test]
fn a_worker_ends_with_the_program_that_started_it_even_while_it_hangs() {
    let folder = tempfile::tempdir().unwrap();
    let note = folder.path().join("process");
    let name = "gymnasium::worker::tests::a_program_that_waits_for_a_worker_that_hangs";
    let mut parent = Command::new(std::env::current_exe().unwrap())
        .args(["--ignored", "--exact", name])
        .env("DRIL_TEST_NOTE", &note)
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let process = wait_for(|| std::fs::read_to_string(&note).ok()?.strip_suffix('\n')?.parse::<u32>().ok());
    assert!(lives(process));
    parent.kill().unwrap();
    parent.wait().unwrap();
    wait_for(|| (!lives(process)).then_some(()));
}

#[test]
#[ignore = "the other process of the test above"]
fn a_program_that_waits_for_a_worker_that_hangs() {
    let Some(note) = std::env::var_os("DRIL_TEST_NOTE") else { return };
    let hang = format!("open({note:?}, 'w').write(f'{{os.getpid()}}\\n'); time.sleep(1000)");
    let hanging = SOURCE.replace("import ale_py\n", &format!("{hang}\n"));
    assert_ne!(hanging, SOURCE);
    let _ = worker("counter", &Launch { source: hanging, ..fake() });
}

fn wait_for<T>(mut look: impl FnMut() -> Option<T>) -> T {
    let deadline = Instant::now() + Duration::from_secs(60);
    loop {
        if let Some(found) = look() {
            return found;
        }
        assert!(Instant::now() < deadline, "waited too long");
        std::thread::sleep(Duration::from_millis(50));
    }
}

#[test]
fn a_signal_to_stop_leaves_the_worker_to_the_stage_that_saves_its_state() {
    let mut worker = Command::new("python3")
        .args(["-c", include_str!("worker.py")])
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    // The mask of ignored signals, where signal n is bit n - 1.
    let ignored = || {
        let status = std::fs::read_to_string(format!("/proc/{}/status", worker.id())).unwrap();
        let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:")).unwrap().trim();
        u64::from_str_radix(mask, 16).unwrap()
    };
    let stops = [2, 15].iter().fold(0, |mask, signal| mask | 1_u64 << (signal - 1));
    let deadline = Instant::now() + Duration::from_secs(60);
    while ignored() & stops != stops {
        assert!(Instant::now() < deadline, "it would die of a signal");
        std::thread::sleep(Duration::from_millis(10));
    }
    drop(worker.stdin.take());
    worker.wait().unwrap();
}
