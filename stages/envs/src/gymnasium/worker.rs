//! The Python process that runs environments, and the pipes to it. Every wait has a timeout, every failure kills the
//! process, and dropping it leaves nothing behind.
//!
//! The process watches its parent itself (`worker.py`): the kernel's parent-death signal follows the thread that started
//! the process, and environments move between threads.

use std::collections::VecDeque;
use std::io::{Read, Write};
use std::os::fd::{AsFd, BorrowedFd};
use std::path::PathBuf;
use std::process::{Child, ChildStderr, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::config::playing;
use super::protocol::{
    Greeting, MAGIC, MOST_GREETING, Operation, PROTOCOL, REPLY, RawObservation, Refusal, Setup, reply,
    request,
};
use super::{GymnasiumConfig, GymnasiumError};
use crate::{ActionSpace, Step};

/// The worker's source.
const SOURCE: &str = include_str!("worker.py");
/// Bytes of the worker's last output that are kept.
const LAST_WORDS: usize = 4096;
/// Writes of at most this size do not block once the pipe is writable.
const ATOMIC_WRITE: usize = 4096;
/// Timeout for a process that closed its pipes to exit.
const GRACE: Duration = Duration::from_secs(2);
/// Size of the pipes, so that the replies of all environments fit and neither side blocks the other.
const PIPE: usize = 1 << 20;

/// How a worker is started, and its timeouts.
#[derive(Clone, Debug)]
pub struct Launch {
    /// The Python executable.
    pub program: PathBuf,
    /// The worker's source.
    pub source: String,
    /// Timeout of the greeting: it may have to load its packages from a slow disk.
    pub start: Duration,
    /// Timeout of a reply.
    pub step: Duration,
}

impl Launch {
    /// The real worker.
    pub fn new(program: PathBuf) -> Self {
        let (start, step) = (Duration::from_secs(600), Duration::from_secs(300));
        Self { program, source: SOURCE.to_owned(), start, step }
    }
}

/// A running worker.
#[derive(Debug)]
pub struct Worker {
    id: String,
    child: Child,
    /// None once the process has to exit.
    requests: Option<ChildStdin>,
    replies: ChildStdout,
    words: Arc<Mutex<VecDeque<u8>>>,
    listener: Option<JoinHandle<()>>,
    patience: Duration,
    shown: RawObservation,
    action: ActionSpace,
    image: Option<[usize; 2]>,
    /// Pending requests, oldest first.
    asked: VecDeque<(Operation, usize)>,
    /// The latest reply for each environment that was not fetched yet.
    answered: Vec<Option<Step>>,
    seen: Vec<Vec<u8>>,
    /// The error that ended it, returned by all later calls.
    broken: Option<GymnasiumError>,
}

impl Worker {
    /// Starts a worker for `count` environments; `images` allows rendering.
    ///
    /// # Errors
    /// It cannot be started, has the wrong packages, or cannot create the environment.
    pub fn start(
        launch: &Launch,
        config: &GymnasiumConfig,
        count: usize,
        images: bool,
    ) -> Result<Self, GymnasiumError> {
        let mut child = spawn(launch)?;
        let (Some(requests), Some(replies), Some(stderr)) =
            (child.stdin.take(), child.stdout.take(), child.stderr.take())
        else {
            return Err(GymnasiumError::Start {
                program: launch.program.clone(),
                message: "it has no pipes".to_owned(),
            });
        };
        widen(requests.as_fd());
        widen(replies.as_fd());
        let words = Arc::new(Mutex::new(VecDeque::new()));
        let listener = listen(stderr, Arc::clone(&words));
        let mut worker = Self {
            id: config.id.clone(),
            child,
            requests: Some(requests),
            replies,
            words,
            listener,
            patience: launch.start,
            shown: RawObservation::Vector { len: 0 },
            action: ActionSpace::Discrete { actions: 0 },
            image: None,
            asked: VecDeque::new(),
            answered: vec![None; count],
            seen: vec![Vec::new(); count],
            broken: None,
        };
        let greeting = worker.greet(config, count, images)?;
        worker.accept(greeting, launch)?;
        worker.patience = launch.step;
        Ok(worker)
    }

    /// Raw observations, before preprocessing.
    pub fn shown(&self) -> RawObservation {
        self.shown
    }

    /// Action space.
    pub fn action(&self) -> &ActionSpace {
        &self.action
    }

    /// Height and width of rendered images; none if rendering was not requested.
    pub fn image(&self) -> Option<[usize; 2]> {
        self.image
    }

    /// The process id.
    #[cfg(test)]
    pub fn process(&self) -> u32 {
        self.child.id()
    }

    /// Sends a request; [`Worker::fetch`] waits for the reply.
    ///
    /// # Errors
    /// The worker exited, or does not read.
    pub fn ask(
        &mut self,
        operation: Operation,
        env: usize,
        seed: u64,
        body: &[u8],
    ) -> Result<(), GymnasiumError> {
        self.check()?;
        self.send(&request(operation, env, seed, body), operation.doing())?;
        self.asked.push_back((operation, env));
        Ok(())
    }

    /// Waits for the reply to the environment's request; [`Worker::seen`] then returns its observation.
    ///
    /// # Errors
    /// The worker exited, hangs, or sent an invalid response.
    pub fn fetch(&mut self, env: usize) -> Result<Step, GymnasiumError> {
        self.check()?;
        loop {
            if let Some(step) = self.answered[env].take() {
                return Ok(step);
            }
            let Some((operation, of)) = self.asked.pop_front() else {
                return Err(self.malformed("waiting", "nothing was asked of that environment".to_owned()));
            };
            self.read_reply(operation, of)?;
        }
    }

    /// The bytes of the environment's latest reply.
    pub fn seen(&self, env: usize) -> &[u8] {
        &self.seen[env]
    }

    fn check(&self) -> Result<(), GymnasiumError> {
        self.broken.clone().map_or(Ok(()), Err)
    }

    fn read_reply(&mut self, operation: Operation, env: usize) -> Result<(), GymnasiumError> {
        let doing = operation.doing();
        let mut head = [0; REPLY];
        self.receive(&mut head, doing)?;
        let (of, step) =
            reply(&head, operation, self.seen.len()).map_err(|message| self.malformed(doing, message))?;
        if of != env {
            return Err(self.malformed(doing, format!("it is of environment {of}, expected {env}")));
        }
        let bytes = match (operation, self.image) {
            (Operation::Render, Some([height, width])) => height * width * 3,
            _ => self.shown.bytes(),
        };
        let mut seen = std::mem::take(&mut self.seen[env]);
        seen.resize(bytes, 0);
        let received = self.receive(&mut seen, doing);
        self.seen[env] = seen;
        self.answered[env] = Some(step);
        received
    }

    fn greet(
        &mut self,
        config: &GymnasiumConfig,
        count: usize,
        images: bool,
    ) -> Result<Greeting, GymnasiumError> {
        const DOING: &str = "starting";
        let order = Setup {
            id: &config.id,
            kwargs: &config.kwargs,
            time_limit: config.time_limit,
            count,
            images,
            draws: config.tracks == super::Tracks::CarRacing,
            packages: playing().map(|(name, _)| name).collect(),
        };
        let mut line =
            serde_json::to_vec(&order).map_err(|error| self.malformed(DOING, error.to_string()))?;
        line.push(b'\n');
        self.send(&line, DOING)?;
        let mut head = [0; 12];
        self.receive(&mut head, DOING)?;
        let (magic, length) = head.split_at(MAGIC.len());
        let length = u32::from_le_bytes([length[0], length[1], length[2], length[3]]);
        if magic != MAGIC || length > MOST_GREETING {
            let (seen, wanted) = (head.escape_ascii(), MAGIC.escape_ascii());
            return Err(self.malformed(DOING, format!("it begins with `{seen}`, expected `{wanted}`")));
        }
        let mut text = vec![0; length as usize];
        self.receive(&mut text, DOING)?;
        serde_json::from_slice(&text).map_err(|error| self.malformed(DOING, error.to_string()))
    }

    /// Checks the greeting, and stores its content.
    fn accept(&mut self, greeting: Greeting, launch: &Launch) -> Result<(), GymnasiumError> {
        if greeting.protocol != PROTOCOL {
            let message = format!("it uses protocol {}, expected {PROTOCOL}", greeting.protocol);
            return Err(self.malformed("starting", message));
        }
        for (name, version) in playing() {
            let seen = greeting.versions.get(name).and_then(Option::as_deref);
            if seen != Some(version) {
                let seen = seen.map_or_else(|| format!("no package {name}"), |seen| format!("{name} {seen}"));
                let program = launch.program.clone();
                let fix = format!("install it with `{} -m pip install {name}=={version}`", program.display());
                let error =
                    GymnasiumError::Package { program, seen, expected: format!("{name} {version}"), fix };
                return Err(self.fail(error));
            }
        }
        if let Some(refusal) = greeting.refused {
            let error = refused(&self.id, refusal, launch);
            return Err(self.fail(error));
        }
        let (Some(shown), Some(action)) = (greeting.observation, greeting.action) else {
            return Err(
                self.malformed("starting", "the greeting has no observation and action space".to_owned())
            );
        };
        (self.shown, self.action, self.image) = (shown, action, greeting.image);
        Ok(())
    }

    fn send(&mut self, bytes: &[u8], doing: &'static str) -> Result<(), GymnasiumError> {
        let deadline = Instant::now() + self.patience;
        for part in bytes.chunks(ATOMIC_WRITE) {
            let Some(requests) = &mut self.requests else { return Err(self.died(doing)) };
            let ready = wait(requests.as_fd(), PollFlags::OUT, deadline);
            let written = match ready {
                Ok(true) => requests.write_all(part),
                Ok(false) => return Err(self.hung(doing)),
                Err(error) => Err(error),
            };
            if written.is_err() {
                return Err(self.died(doing));
            }
        }
        Ok(())
    }

    fn receive(&mut self, into: &mut [u8], doing: &'static str) -> Result<(), GymnasiumError> {
        let mut filled = 0;
        let deadline = Instant::now() + self.patience;
        while filled < into.len() {
            match wait(self.replies.as_fd(), PollFlags::IN, deadline) {
                Ok(true) => {}
                Ok(false) => return Err(self.hung(doing)),
                Err(_) => return Err(self.died(doing)),
            }
            match self.replies.read(&mut into[filled..]) {
                Ok(0) => return Err(self.died(doing)),
                Ok(read) => filled += read,
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(_) => return Err(self.died(doing)),
            }
        }
        Ok(())
    }

    fn died(&mut self, doing: &'static str) -> GymnasiumError {
        let status =
            self.end(GRACE).map_or_else(|| "its end is unknown".to_owned(), |status| status.to_string());
        let error = GymnasiumError::Died { id: self.id.clone(), doing, status, words: self.last_words() };
        self.fail(error)
    }

    fn hung(&mut self, doing: &'static str) -> GymnasiumError {
        let seconds = self.patience.as_secs();
        self.fail(GymnasiumError::Hung { id: self.id.clone(), doing, seconds })
    }

    fn malformed(&mut self, doing: &'static str, message: String) -> GymnasiumError {
        self.fail(GymnasiumError::Malformed { id: self.id.clone(), doing, message })
    }

    /// Ends the worker and stores the error.
    fn fail(&mut self, error: GymnasiumError) -> GymnasiumError {
        self.end(Duration::ZERO);
        self.broken = Some(error.clone());
        error
    }

    /// Closes its input, and kills it unless it ends within `grace`.
    fn end(&mut self, grace: Duration) -> Option<ExitStatus> {
        self.requests = None;
        let deadline = Instant::now() + grace;
        while Instant::now() < deadline {
            match self.child.try_wait() {
                Ok(None) => std::thread::sleep(Duration::from_millis(5)),
                Ok(Some(status)) => return Some(status),
                Err(_) => return None,
            }
        }
        // It may have ended meanwhile; either way it is gone after this.
        let _ = self.child.kill();
        self.child.wait().ok()
    }

    fn last_words(&mut self) -> String {
        if let Some(listener) = self.listener.take() {
            // What the process started may hold the pipe open; nobody waits for that.
            let deadline = Instant::now() + GRACE;
            while !listener.is_finished() && Instant::now() < deadline {
                std::thread::sleep(Duration::from_millis(5));
            }
        }
        let words = self.words.lock().unwrap_or_else(PoisonError::into_inner);
        let (first, second) = words.as_slices();
        let text = String::from_utf8_lossy(&[first, second].concat()).trim().to_owned();
        if text.is_empty() { "(it said nothing)".to_owned() } else { text }
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.end(Duration::ZERO);
    }
}

fn spawn(launch: &Launch) -> Result<Child, GymnasiumError> {
    Command::new(&launch.program)
        // Isolated: only its own packages, whatever the user's environment says.
        .args(["-I", "-c", &launch.source])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(|error| GymnasiumError::Start {
            program: launch.program.clone(),
            message: error.to_string(),
        })
}

fn refused(id: &str, refusal: Refusal, launch: &Launch) -> GymnasiumError {
    let (id, message) = (id.to_owned(), refusal.message);
    match refusal.kind.as_str() {
        "unknown" => GymnasiumError::Unknown { id, message },
        "missing" => GymnasiumError::Package {
            program: launch.program.clone(),
            seen: format!("not all that `{id}` needs ({message})"),
            expected: "its packages".to_owned(),
            fix: "put the path of a Python that has them, beside the packages of this program, into DRIL_PIPE_PYTHON"
                .to_owned(),
        },
        _ => GymnasiumError::Refused { id, message },
    }
}

/// Keeps the end of what the process writes to its standard error.
fn listen(mut stderr: ChildStderr, words: Arc<Mutex<VecDeque<u8>>>) -> Option<JoinHandle<()>> {
    let hear = move || {
        let mut part = [0; 1024];
        while let Ok(read @ 1..) = stderr.read(&mut part) {
            let mut words = words.lock().unwrap_or_else(PoisonError::into_inner);
            words.extend(&part[..read]);
            let surplus = words.len().saturating_sub(LAST_WORDS);
            words.drain(..surplus);
        }
    };
    std::thread::Builder::new().name("gymnasium-stderr".to_owned()).spawn(hear).ok()
}

/// True once the pipe is ready, false at the deadline.
fn wait(pipe: BorrowedFd<'_>, flags: PollFlags, deadline: Instant) -> std::io::Result<bool> {
    loop {
        let rest = deadline.saturating_duration_since(Instant::now());
        let timeout = Timespec::try_from(rest).map_err(std::io::Error::other)?;
        match poll(&mut [PollFd::from_borrowed_fd(pipe, flags)], Some(&timeout)) {
            Ok(0) if Instant::now() >= deadline => return Ok(false),
            Ok(0) | Err(rustix::io::Errno::INTR) => {}
            Ok(_) => return Ok(true),
            Err(error) => return Err(error.into()),
        }
    }
}

#[cfg(target_os = "linux")]
fn widen(pipe: BorrowedFd<'_>) {
    // Where the system does not allow it, requests and replies take more turns.
    let _ = rustix::pipe::fcntl_setpipe_size(pipe, PIPE);
}

#[cfg(not(target_os = "linux"))]
fn widen(_: BorrowedFd<'_>) {
    let _ = PIPE;
}

#[cfg(test)]
#[path = "worker_tests.rs"]
pub(super) mod tests;
