//! Shared caches from the outside: machines that never saw each other's disk, and a cache that is cut, slow, damaged or
//! not there. The S3 tests need a server; `tests/remote/s3.sh` starts one.

use std::process::{Command, Stdio};
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::cli::WORDS;
use crate::remote_net::{Dice, Net};
use crate::sealed::{Sealed, ended};

/// Forty texts of different lengths, and one table of them.
const MANY: &str = "\
name: many
axes:
  number: [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20]
  word: [a, b]
stages:
  say:
    kind: emit
    matrix: [number, word]
    with: { text: \"${word}${number} \", times: 4000 }
  gather: { kind: concat, inputs: { parts: say } }
";

fn machine(pipeline: &str) -> Sealed {
    Sealed::with(pipeline)
}

fn shared_folder() -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let url = format!("file://{}", folder.path().display());
    (folder, url)
}

fn json(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|error| panic!("{error}: {text}"))
}

/// The last event of a run.
fn end(machine: &Sealed, args: &str) -> Value {
    machine.events(format!("--jobs 2 {args}").trim_end()).pop().unwrap()
}

fn is_sound(machine: &Sealed) -> bool {
    machine.run("cache verify").code == 0
}

#[test]
fn what_one_machine_made_another_one_takes_and_runs_nothing() {
    let (_folder, url) = shared_folder();
    let (one, other) = (machine(WORDS), machine(WORDS));
    let made = end(&one, &format!("--remote {url} --remote-mode read-write"));
    assert_eq!((&made["ran"], &made["remote"]["given"]), (&8.into(), &8.into()), "{made}");
    let said = other.run_ok(&format!("run p.yaml --remote {url}"));
    assert!(said.contains("nothing to do") || said.contains("8 cached"), "{said}");
    assert!(said.contains("shared cache: took 8 results ("), "{said}");
    let table = "results/words-full/gather.md";
    assert_eq!(one.read(table), other.read(table));
    assert!(is_sound(&other));
}

#[test]
fn a_settings_file_beside_the_pipeline_names_the_cache_and_changes_no_key() {
    let (_folder, url) = shared_folder();
    let (one, other) = (machine(WORDS), machine(WORDS));
    assert_eq!(end(&one, "")["ran"], 8);
    one.write("dril-pipe.toml", &format!("[remote]\nurl = \"{url}\"\nmode = \"read-write\"\n"));
    assert_eq!(end(&one, "")["ran"], 0, "settings are no part of a key");
    let pushed = json(&one.run_ok("cache push p.yaml --json"));
    assert_eq!((&pushed["new"], &pushed["known"]), (&8.into(), &0.into()), "{pushed}");
    other.write("dril-pipe.toml", &format!("[remote]\nurl = \"{url}\"\n"));
    let status = json(&other.run_ok("cache remote-status p.yaml --json"));
    assert_eq!((&status["results"], &status["not_made"]), (&8.into(), &8.into()), "{status}");
    assert_eq!(end(&other, "--remote off")["ran"], 8);
    other.run_ok("cache gc --older-than 0s");
    let taken = end(&other, "--set count.to=3");
    assert_eq!(taken["remote"]["taken"], 4, "the texts are the same: {taken}");
    let status = json(&other.run_ok("cache remote-status p.yaml --set count.to=3 --json"));
    assert_eq!(status["absent"].as_array().map(Vec::len), Some(4), "a run that may only read gives nothing");
}

#[test]
fn what_only_excludes_may_come_from_the_cache() {
    let (_folder, url) = shared_folder();
    let (one, other) = (machine(WORDS), machine(WORDS));
    let refused = other.run(&format!("run p.yaml gather --only --remote {url}"));
    assert_eq!(refused.code, 2, "{refused:?}");
    assert!(refused.stderr.contains("`--only` excludes"), "{}", refused.stderr);
    end(&one, &format!("--remote {url} --remote-mode read-write"));
    let taken = end(&other, &format!("gather --only --remote {url}"));
    assert_eq!((&taken["event"], &taken["ran"]), (&"ended".into(), &0.into()), "{taken}");
    let ran = end(&other, &format!("gather --only --set gather.separator=x --remote {url}"));
    assert_eq!(ran["ran"], 1, "{ran}");
}

#[test]
fn pull_takes_all_there_is_or_what_a_pipeline_needs() {
    let (_folder, url) = shared_folder();
    let one = machine(WORDS);
    one.run_ok("run p.yaml");
    one.run_ok("run p.yaml --profile quick");
    one.run_ok(&format!("cache push --remote {url}"));
    let (all, some) = (machine(WORDS), machine(WORDS));
    assert_eq!(json(&all.run_ok(&format!("cache pull --remote {url} --json")))["new"], 12);
    let pulled = json(&some.run_ok(&format!("cache pull p.yaml --profile quick --remote {url} --json")));
    assert_eq!((&pulled["new"], &pulled["absent"]), (&8.into(), &0.into()), "{pulled}");
    assert_eq!(end(&some, "--profile quick")["ran"], 0);
}

#[test]
fn a_cache_that_is_not_there_costs_a_warning_and_not_the_run() {
    let gone = machine(WORDS);
    for url in ["file:///nonexistent/cache", "http://127.0.0.1:9/cache", "s3://bucket"] {
        std::fs::remove_dir_all(gone.path("cache")).ok();
        let mut command = gone.command(&format!("run p.yaml --remote {url} --remote-mode read-write"));
        command.env("AWS_ENDPOINT_URL", "http://127.0.0.1:9").env("AWS_ACCESS_KEY_ID", "a");
        command.env("AWS_SECRET_ACCESS_KEY", "top-secret");
        let ended = ended(command);
        assert_eq!(ended.code, 0, "{ended:?}");
        assert!(ended.stdout.contains("8 ran"), "{ended:?}");
        assert!(ended.stderr.contains("does not answer"), "{url}: {ended:?}");
        assert!(!ended.stderr.contains("top-secret"), "{ended:?}");
    }
    let pushed = gone.run("cache push --remote file:///nonexistent/cache");
    assert_eq!(pushed.code, 4, "{pushed:?}");
}

#[test]
fn a_wrong_address_is_explained() {
    let sealed = machine(WORDS);
    for (url, expected) in [
        ("cache", "`cache` is no shared cache: expected `s3://bucket/prefix`"),
        ("ftp://host/x", "its scheme is `ftp`, expected `s3`"),
        ("s3://", "it names no bucket"),
        ("file://relative", "expected an absolute path"),
        (
            "https://me:secret@host/x",
            "`https://…@host/x` is no shared cache: a name or password does not belong",
        ),
    ] {
        let ended = sealed.run(&format!("run p.yaml --remote {url}"));
        assert_eq!(ended.code, 2, "{ended:?}");
        assert!(ended.stderr.contains(expected), "{url}: {}", ended.stderr);
    }
    let ended = sealed.run("cache push --remote http://127.0.0.1:9/x");
    assert!(ended.stderr.contains("can only be read"), "{ended:?}");
    let ended = sealed.run("cache push");
    assert!(ended.stderr.contains("no shared cache is named"), "{ended:?}");
    sealed.write("dril-pipe.toml", "[remote]\nulr = \"s3://b\"\n");
    let ended = sealed.run("run p.yaml");
    assert_eq!(ended.code, 2, "{ended:?}");
    assert!(ended.stderr.contains("dril-pipe.toml:2:1: unknown field `ulr`"), "{ended:?}");
}

#[test]
fn over_plain_http_that_loses_cuts_and_delays_every_byte_is_right() {
    let (folder, url) = shared_folder();
    let one = machine(MANY);
    one.run_ok("run p.yaml");
    one.run_ok(&format!("cache push --remote {url}"));
    let net = Net::files(folder.path());
    net.faults.store(4, Ordering::Relaxed);
    for _ in 0..3 {
        let other = machine(MANY);
        let began = Instant::now();
        while other.run(&format!("cache pull p.yaml --remote http://{}", net.address)).code != 0 {
            assert!(began.elapsed() < Duration::from_secs(120));
        }
        assert!(is_sound(&other));
        assert_eq!(end(&other, "")["ran"], 0);
        assert_eq!(one.read("results/many-default/gather.md"), other.read("results/many-default/gather.md"));
    }
}

/// Kills the program at random moments until it comes to its end; how often it was killed.
fn kill_until_done(
    machine: &Sealed,
    args: &str,
    dice: &Dice,
    longest: u64,
    variables: &[(String, String)],
) -> u64 {
    let (mut kills, mut failures) = (0, 0);
    loop {
        let mut command = machine.command(args);
        command.envs(variables.iter().cloned()).stdout(Stdio::null()).stderr(Stdio::null());
        let mut child = command.spawn().unwrap();
        // Ever later, so that it comes to its end on a slow machine too.
        let deadline = Instant::now() + Duration::from_micros(dice.below(longest * 1000 * (20 + kills) / 20));
        let ended = loop {
            if let Some(status) = child.try_wait().unwrap() {
                break Some(status);
            }
            if Instant::now() > deadline {
                break None;
            }
            std::thread::sleep(Duration::from_micros(200));
        };
        match ended {
            Some(status) if status.success() => return kills,
            Some(status) => {
                failures += 1;
                assert!(failures < 100, "`{args}` ends by itself with {status}");
            }
            None => {
                child.kill().unwrap();
                child.wait().unwrap();
                kills += 1;
                assert!(kills < 2000);
            }
        }
    }
}

/// Pushes from one machine and pulls to others, all killed at random moments, until there were `enough` kills. Counts
/// bytes that are wrong.
fn survive_kills(url_of: impl Fn(u32) -> String, variables: &[(String, String)], enough: u64, longest: u64) {
    let one = machine(MANY);
    one.run_ok("run p.yaml");
    let (dice, mut kills, mut round) = (Dice::default(), 0, 0);
    while kills < enough {
        round += 1;
        let url = url_of(round);
        kills += kill_until_done(&one, &format!("cache push --remote {url}"), &dice, longest, variables);
        let other = machine(MANY);
        kills +=
            kill_until_done(&other, &format!("cache pull p.yaml --remote {url}"), &dice, longest, variables);
        assert!(is_sound(&other), "round {round}");
        assert_eq!(end(&other, "")["ran"], 0, "round {round}");
        assert_eq!(one.read("results/many-default/gather.md"), other.read("results/many-default/gather.md"));
    }
    println!("{kills} kills in {round} rounds");
}

#[test]
fn push_and_pull_killed_at_random_moments_leave_no_wrong_byte() {
    let folder = tempfile::tempdir().unwrap();
    let url = |round: u32| {
        let cache = folder.path().join(round.to_string());
        std::fs::create_dir_all(&cache).unwrap();
        format!("file://{}", cache.display())
    };
    survive_kills(url, &[], 25, 60);
}

/// The server of `tests/remote/s3.sh`, with an empty bucket.
struct S3 {
    endpoint: String,
}

impl S3 {
    /// `None` where the script did not start this test.
    fn find() -> Option<Self> {
        let endpoint = std::env::var("DRIL_TEST_S3").ok();
        if endpoint.is_none() {
            println!("skipped: no S3 server; `tests/remote/s3.sh` starts one");
        }
        Some(Self { endpoint: endpoint? })
    }

    fn variables(&self, endpoint: &str) -> Vec<(String, String)> {
        [
            ("AWS_ENDPOINT_URL", endpoint),
            ("AWS_ACCESS_KEY_ID", "test"),
            ("AWS_SECRET_ACCESS_KEY", "testtest"),
            ("AWS_DEFAULT_REGION", "us-east-1"),
        ]
        .map(|(name, value)| (name.to_owned(), value.to_owned()))
        .into()
    }

    fn run(&self, machine: &Sealed, args: &str) -> String {
        let mut command: Command = machine.command(args);
        command.envs(self.variables(&self.endpoint));
        let ended = ended(command);
        assert_eq!(ended.code, 0, "{args}: {ended:?}");
        ended.stdout
    }

    /// A place of its own in the bucket.
    fn url(name: &str) -> String {
        let process = std::process::id();
        format!("s3://bucket/{name}-{process}")
    }
}

#[test]
fn on_an_s3_server_what_one_machine_made_another_one_takes() {
    let Some(s3) = S3::find() else { return };
    let url = S3::url("exchange");
    let (one, other) = (machine(MANY), machine(MANY));
    let said = s3.run(&one, &format!("run p.yaml --remote {url} --remote-mode read-write"));
    assert!(said.contains("gave 41"), "{said}");
    let status = json(&s3.run(&one, &format!("cache remote-status --remote {url} --json")));
    assert_eq!((&status["results"], status["there"].as_array().map(Vec::len)), (&41.into(), Some(41)));
    let again = json(&s3.run(&one, &format!("cache push --remote {url} --json")));
    assert_eq!((&again["new"], &again["known"], &again["contents"]), (&0.into(), &41.into(), &0.into()));
    let said = s3.run(&other, &format!("run p.yaml --remote {url}"));
    assert!(said.contains("took 41 results"), "{said}");
    assert!(is_sound(&other));
}

#[test]
fn on_an_s3_server_kills_at_random_moments_leave_no_wrong_byte() {
    let Some(s3) = S3::find() else { return };
    let variables = s3.variables(&s3.endpoint);
    survive_kills(|round| S3::url(&format!("kills-{round}")), &variables, 100, 250);
}

#[test]
fn before_an_s3_server_a_network_that_loses_cuts_and_delays_costs_no_byte() {
    let Some(s3) = S3::find() else { return };
    let server = s3.endpoint.trim_start_matches("http://").parse().unwrap();
    let net = Net::proxy(server);
    net.faults.store(4, Ordering::Relaxed);
    let variables = s3.variables(&format!("http://{}", net.address));
    let url = S3::url("network");
    let (one, other) = (machine(MANY), machine(MANY));
    one.run_ok("run p.yaml");
    for (machine, args) in [(&one, "cache push"), (&other, "cache pull p.yaml")] {
        let began = Instant::now();
        loop {
            let mut command = machine.command(&format!("{args} --remote {url}"));
            command.envs(variables.iter().cloned());
            if ended(command).code == 0 {
                break;
            }
            assert!(began.elapsed() < Duration::from_secs(300), "{args}");
        }
    }
    assert!(net.count.load(Ordering::Relaxed) > 4);
    assert!(is_sound(&other));
    assert_eq!(end(&other, "")["ran"], 0);
}
