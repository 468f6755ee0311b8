//! Stage kinds for the engine's tests: quick, free of learning, and able to misbehave on request.
//!
//! - `emit` writes its text (no seed); `concat` joins what is wired to it (fan-in); `count` counts slowly from a seeded
//!   start, says how far it is, keeps checkpoints, and can be configured to fail, crash, hang, or leave bad outputs.
//! - `elsewhere` is described here and run by an executable that does not exist.
//!
//! With `DRIL_FAKES_TRACE` set to a file, stages append what they do to it: `<event> <kind> <key> <pid>`.
#![allow(dead_code, clippy::unwrap_used, clippy::panic, clippy::print_stdout, clippy::print_stderr)]

use std::io::Write;
use std::path::Path;
use std::time::Duration;

use dril_stage_api::{
    Artifact, Ctx, Describe, Kind, Needs, Ports, Problems, Registry, Stage, StageError, Tool, ToolOption,
    ToolValue,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Artifact types, as a stage package would define them.
const POLICY: Artifact = Artifact::new("policy", "safetensors");
const DEMONSTRATIONS: Artifact = Artifact::new("demonstrations", "bin");

/// The fakes.
pub const KINDS: [Kind; 4] = [
    Kind::of::<Emit>(),
    Kind::of::<Concat>(),
    Kind::of::<Count>(),
    Kind::run_by::<Elsewhere>("dril-pipe-nowhere"),
];

/// A tool that prints its request.
pub const PEEK: Tool = Tool {
    name: "peek",
    about: "Print what a tool is asked for",
    examples: &["dril-pipe peek p.yaml:count --out peek.txt"],
    artifact: POLICY,
    value_name: "POLICY",
    artifact_about: "A file, or a finished stage of a pipeline",
    artifact_example: "p.yaml:count",
    options: &[
        ToolOption::new("seed", ToolValue::Count, "7", "A number"),
        ToolOption::required("out", ToolValue::NewFile(&["txt"], "`.txt` is text"), "The file to write"),
        ToolOption::from_stage("text", ToolValue::Yaml("{ a: 1 }"), "A parameter of the stage"),
        ToolOption::new("mode", ToolValue::Choice(&["fast", "slow"]), "slow", "A word"),
        ToolOption::new("speed", ToolValue::Number, "0.5", "Another number"),
    ],
    worker: "fakes",
    service: "__peek",
};

/// The registry of the fakes.
pub fn registry() -> Registry {
    dril_stage_api::artifact::register(&[POLICY, DEMONSTRATIONS]).unwrap();
    Registry::new([&KINDS[..], &dril_pipe::kinds::KINDS].concat()).unwrap()
}

/// Writes its text.
pub struct Emit;

/// Parameters of `emit`.
#[derive(Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EmitParams {
    /// The text to write.
    text: String,
    /// How many times.
    #[serde(default = "one")]
    times: u32,
    /// The text in capitals: equal outputs from different parameters, where the text has no letters.
    #[serde(default)]
    loud: bool,
    /// Cost of the work, for the order of stages.
    #[serde(default = "one_second")]
    cost: f64,
}

fn one() -> u32 {
    1
}

fn one_second() -> f64 {
    1.0
}

impl Describe for Emit {
    const KIND: &'static str = "emit";
    const REVISION: u32 = 1;
    const ABOUT: &'static str = "writes a text";
    const SEEDED: bool = false;
    type Params = EmitParams;

    fn check(params: &EmitParams, problems: &mut Problems) {
        problems.positive("times", params.times.into());
        problems.positive_number("cost", params.cost);
    }

    fn ports(_: &EmitParams) -> Ports {
        Ports::new().optional("after", Artifact::FILE, "is ignored").output(
            "text",
            DEMONSTRATIONS,
            "txt",
            "the text",
        )
    }

    fn needs(params: &EmitParams) -> Needs {
        Needs { threads: 1, cost: params.cost }
    }
}

impl Stage for Emit {
    type Kind = Self;

    fn run(params: &EmitParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        trace("begin", "emit", ctx);
        let text = if params.loud { params.text.to_uppercase() } else { params.text.clone() };
        ctx.write_output("text", text.repeat(params.times as usize))?;
        trace("end", "emit", ctx);
        Ok(())
    }
}

/// Joins what is wired to it.
pub struct Concat;

/// Parameters of `concat`.
#[derive(Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ConcatParams {
    /// What stands between the parts.
    #[serde(default = "newline")]
    separator: String,
    /// The parts cut to so many bytes: an edit behind them does not change the output.
    #[serde(default)]
    keep: Option<usize>,
    /// Label names and values before each part.
    #[serde(default)]
    labels: bool,
    /// Cost of the work, for the order of stages.
    #[serde(default = "one_second")]
    cost: f64,
}

fn newline() -> String {
    "\n".to_owned()
}

impl Describe for Concat {
    const KIND: &'static str = "concat";
    const REVISION: u32 = 1;
    const ABOUT: &'static str = "joins texts";
    const SEEDED: bool = false;
    type Params = ConcatParams;

    fn ports(_: &ConcatParams) -> Ports {
        Ports::new().many("parts", Artifact::FILE, "the texts to join").output(
            "joined",
            Artifact::TABLE,
            "md",
            "the joined text",
        )
    }

    fn needs(params: &ConcatParams) -> Needs {
        Needs { threads: 1, cost: params.cost }
    }
}

impl Stage for Concat {
    type Kind = Self;

    fn run(params: &ConcatParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        trace("begin", "concat", ctx);
        let mut parts = Vec::new();
        for item in ctx.inputs("parts") {
            let bytes = std::fs::read(item.path).map_err(StageError::io("cannot read", item.path))?;
            let kept = &bytes[..bytes.len().min(params.keep.unwrap_or(usize::MAX))];
            let labels: Vec<String> =
                item.labels.iter().map(|(axis, value)| format!("{axis}={value}")).collect();
            let head = if params.labels { format!("[{}] ", labels.join(", ")) } else { String::new() };
            parts.push(format!("{head}{}", String::from_utf8_lossy(kept)));
        }
        ctx.write_output("joined", parts.join(&params.separator))?;
        trace("end", "concat", ctx);
        Ok(())
    }
}

/// Counts, slowly.
pub struct Count;

/// Parameters of `count`.
#[derive(Debug, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CountParams {
    /// How far to count.
    #[serde(default = "three")]
    to: u64,
    /// Milliseconds for each step.
    #[serde(default)]
    step_millis: u64,
    /// What to do instead of a clean end.
    #[serde(default)]
    mishap: Mishap,
    /// The step at which to do it.
    #[serde(default)]
    at: u64,
    /// How often, for `flaky`.
    #[serde(default)]
    times: u64,
    /// Begins only once so many stages have begun, by the trace: proof that they run side by side.
    #[serde(default)]
    meet: usize,
    /// Threads that it claims to need.
    #[serde(default = "one_thread")]
    threads: usize,
    /// Cost of the work, for the order of stages.
    #[serde(default = "one_second")]
    cost: f64,
}

/// A way to go wrong.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Mishap {
    /// None.
    #[default]
    None,
    /// An error.
    Fail,
    /// An error about its input, with its path.
    Refuse,
    /// A panic.
    Panic,
    /// An abort, as from a broken library.
    Crash,
    /// An exit that says nothing.
    Exit,
    /// Never ends and does not listen.
    Hang,
    /// Leaves an output out.
    NoOutput,
    /// Makes a folder of an output.
    Folder,
    /// Makes a link of an output.
    Link,
    /// Leaves a process behind that holds the standard output and writes to the trace.
    Orphan,
    /// Prints a lot of text that is no message.
    Chatter,
    /// Fails as often as `times` says, and then no more.
    Flaky,
    /// Keeps 300 MiB of memory for 20 s.
    Eat,
}

fn three() -> u64 {
    3
}

fn one_thread() -> usize {
    1
}

impl Describe for Count {
    const KIND: &'static str = "count";
    const REVISION: u32 = 1;
    const ABOUT: &'static str = "counts slowly";
    type Params = CountParams;

    fn check(params: &CountParams, problems: &mut Problems) {
        problems.positive("to", params.to);
        problems.positive_number("cost", params.cost);
    }

    fn ports(_: &CountParams) -> Ports {
        Ports::new()
            .optional("start", DEMONSTRATIONS, "a text that the count begins with")
            .output("count", POLICY, "txt", "the numbers")
            .output("log", Artifact::TRAINING_LOG, "csv", "step and number")
    }

    fn needs(params: &CountParams) -> Needs {
        Needs { threads: params.threads, cost: params.cost }
    }
}

/// What `count` keeps in its checkpoint.
#[derive(Serialize, Deserialize)]
struct Counting {
    step: u64,
    lines: String,
}

impl Stage for Count {
    type Kind = Self;

    fn run(params: &CountParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        trace("begin", "count", ctx);
        meet(params.meet)?;
        let saved = ctx.checkpoints().join("state.json");
        let mut state = match std::fs::read(&saved) {
            Ok(bytes) => serde_json::from_slice(&bytes).map_err(StageError::failed)?,
            Err(_) => Counting { step: 0, lines: String::new() },
        };
        while state.step < params.to {
            mishap(params, state.step, ctx)?;
            std::thread::sleep(Duration::from_millis(params.step_millis));
            let number = ctx.seed().child(&state.step.to_string()).0;
            state.lines.push_str(&format!("{},{number}\n", state.step));
            state.step += 1;
            ctx.progress(state.step, params.to, "numbers", || format!("at {}", state.step));
            trace("step", "count", ctx);
            if ctx.checkpoint_due() {
                save(&saved, &state)?;
            }
            ctx.stop_if_cancelled()?;
        }
        finish(params, &state, ctx)?;
        trace("end", "count", ctx);
        Ok(())
    }
}

fn save(path: &Path, state: &Counting) -> Result<(), StageError> {
    let bytes = serde_json::to_vec(state).map_err(StageError::failed)?;
    let temporary = path.with_extension("new");
    std::fs::write(&temporary, bytes).map_err(StageError::io("cannot write", &temporary))?;
    std::fs::rename(&temporary, path).map_err(StageError::io("cannot write", path))
}

fn mishap(params: &CountParams, step: u64, ctx: &Ctx<'_>) -> Result<(), StageError> {
    if step != params.at {
        return Ok(());
    }
    match params.mishap {
        Mishap::Fail => return Err(StageError::failed(format!("fails as configured at {step}"))),
        Mishap::Refuse => {
            return Err(StageError::input("start", ctx.input("start")?, "set up to refuse /etc/fakes/it"));
        }
        Mishap::Panic => panic!("panics as configured at {step}"),
        Mishap::Crash => {
            eprintln!("about to crash");
            std::process::abort()
        }
        Mishap::Exit => std::process::exit(9),
        Mishap::Hang => loop {
            std::thread::sleep(Duration::from_millis(20));
            trace("hang", "count", ctx);
        },
        Mishap::Orphan => {
            let script = "while true; do echo left sh - $$ >> \"$DRIL_FAKES_TRACE\"; sleep 0.02; done";
            std::process::Command::new("sh").args(["-c", script]).spawn().map_err(StageError::failed)?;
        }
        Mishap::Flaky => {
            let tries = ctx.checkpoints().join("tries");
            let before = std::fs::read(&tries).unwrap_or_default().len() as u64;
            if before < params.times {
                std::fs::write(&tries, vec![b'x'; before as usize + 1]).map_err(StageError::failed)?;
                return Err(StageError::failed(format!("try {} is none of the good ones", before + 1)));
            }
        }
        Mishap::Eat => {
            let eaten = vec![7_u8; 300 << 20];
            std::thread::sleep(Duration::from_secs(20));
            drop(eaten);
        }
        Mishap::Chatter => {
            for line in 0..20_000 {
                println!("chatter {line}");
            }
        }
        Mishap::None | Mishap::NoOutput | Mishap::Folder | Mishap::Link => {}
    }
    Ok(())
}

fn finish(params: &CountParams, state: &Counting, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
    let start = match ctx.optional_input("start") {
        Some(path) => std::fs::read_to_string(path).map_err(StageError::io("cannot read", path))?,
        None => String::new(),
    };
    ctx.write_output("log", format!("step,number\n{}", state.lines))?;
    let path = ctx.output("count")?;
    match params.mishap {
        Mishap::NoOutput => Ok(()),
        Mishap::Folder => std::fs::create_dir(path).map_err(StageError::io("cannot make", path)),
        Mishap::Link => {
            std::os::unix::fs::symlink("/etc/hostname", path).map_err(StageError::io("cannot link", path))
        }
        _ => ctx.write_output("count", format!("{start}{}", state.lines)),
    }
}

/// Run by another executable, which is not there.
pub struct Elsewhere;

impl Describe for Elsewhere {
    const KIND: &'static str = "elsewhere";
    const REVISION: u32 = 1;
    const ABOUT: &'static str = "is run by another executable";
    type Params = EmitParams;

    fn ports(params: &EmitParams) -> Ports {
        Emit::ports(params)
    }
}

/// Waits until so many stages have begun; an error where they do not come.
fn meet(others: usize) -> Result<(), StageError> {
    let Some(path) = std::env::var_os("DRIL_FAKES_TRACE").filter(|_| others > 0) else { return Ok(()) };
    for _ in 0..5_000 {
        let text = std::fs::read_to_string(&path).map_err(StageError::failed)?;
        if text.lines().filter(|line| line.starts_with("begin ")).count() >= others {
            return Ok(());
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    Err(StageError::failed(format!("waited too long for {others} stages to begin")))
}

fn trace(event: &str, kind: &str, ctx: &Ctx<'_>) {
    let Some(path) = std::env::var_os("DRIL_FAKES_TRACE") else { return };
    let Ok(mut file) = std::fs::OpenOptions::new().append(true).create(true).open(path) else { return };
    let key = ctx
        .checkpoints()
        .parent()
        .and_then(Path::file_name)
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned();
    let _ = file.write_all(format!("{event} {kind} {key} {}\n", std::process::id()).as_bytes());
}
