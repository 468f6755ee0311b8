//! One stage from its job to its record: what a worker thread does while the dispatcher goes on.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::SyncSender;
use std::time::{Duration, Instant};

use dril_stage_api::{Artifact, Job, Kind, Message, Output, Ports};

use super::check::Again;
use super::dispatch::{Shape, log_stem};
use super::inputs::{self, Placed};
use super::job::{job, output_path, outside, record};
use super::resources::{Pool, Units};
use super::runner::{Exit, Launch, Runner};
use super::{Cause, Options};
use crate::fsx::{self, Entry, FsError, Lock};
use crate::plan::OutsideFile;
use crate::resolve::StageIndex;
use crate::spec::Limits;
use crate::store::{self, Blob, Key, Outputs, Record, Run, Store, StoreError, Stored};

/// How soon a wish to stop is noticed between two tries.
const GLANCE: Duration = Duration::from_millis(50);

/// What all stages of a run share.
#[derive(Clone, Copy)]
pub(super) struct Site<'a> {
    pub store: &'a Store,
    pub runner: &'a dyn Runner,
    pub options: &'a Options,
    /// Raised when running stages shall stop.
    pub halt: &'a AtomicBool,
}

/// A stage that is to run, with the right to make its record.
pub(super) struct Task<'a> {
    pub stage: StageIndex,
    pub key: Key,
    pub lock: Lock,
    /// What it holds of counted resources.
    pub units: Units,
    pub run: Arc<Run>,
    pub job: Job,
    pub ports: &'a Ports,
    pub kind: Kind,
    pub threads: usize,
    pub limits: Limits,
    /// Files from outside that it reads.
    pub files: Vec<&'a OutsideFile>,
    /// What it reads in its private folder.
    pub placed: Vec<Placed>,
    /// All but what is known only afterwards.
    pub record: Record,
    /// A folder that is not there yet.
    pub folder: PathBuf,
    pub log: PathBuf,
}

/// What a worker tells the dispatcher.
pub(super) enum News {
    /// The stage said something.
    Said(StageIndex, Message),
    /// Its process is gone. Where it succeeded, its outputs can be read from now on, so that those who wait for them can
    /// start; a crash before [`News::Committed`] costs that it runs again, and nothing else, since keys go by content.
    Built(StageIndex, Result<Arc<Outputs>, Failure>),
    /// It failed and will be tried again: the number of the try, why, and how long until then.
    Retrying(StageIndex, u32, String, Duration),
    /// Its record is written and durable. Comes after `Built` where that was a success.
    Committed(StageIndex, Result<Duration, String>),
}

/// Why a stage has no outputs.
#[derive(Debug)]
pub(super) enum Failure {
    /// It was asked to stop, and did.
    Stopped,
    /// It failed.
    Failed(String, Cause),
}

impl Failure {
    pub(super) fn by_itself(error: impl ToString) -> Self {
        Self::Failed(error.to_string(), Cause::Failed)
    }

    pub(super) fn of_store(error: impl ToString) -> Self {
        Self::Failed(error.to_string(), Cause::Store)
    }
}

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Self {
        Self::of_store(error)
    }
}

impl From<FsError> for Failure {
    fn from(error: FsError) -> Self {
        Self::of_store(error)
    }
}

impl<'a> Task<'a> {
    /// What a stage needs in order to run, all that feeds it being done.
    pub fn new(
        stage: StageIndex,
        key: Key,
        (lock, units): (Lock, Units),
        run: Arc<Run>,
        shape: Shape<'a>,
        done: &[Option<Arc<Outputs>>],
        site: Site<'_>,
    ) -> Self {
        let node = &shape.graph.stages[stage];
        let folder = run.temporary().join(key.hex());
        let (job, placed) = job(node, &key, &folder, done, shape, site);
        Self {
            log: run.log(&log_stem(shape.graph, stage, Some(&key))),
            job,
            placed,
            record: record(node, done, shape),
            ports: &node.ports,
            kind: node.kind,
            threads: node.needs.threads.max(1),
            limits: node.limits,
            files: outside(node, shape).collect(),
            stage,
            key,
            lock,
            units,
            run,
            folder,
        }
    }

    /// Does it all. The dispatcher may have gone in the meantime; then nobody is told.
    pub fn work(mut self, site: Site<'_>, news: &SyncSender<News>) {
        let stage = self.stage;
        let said = |message| drop(news.send(News::Said(stage, message)));
        // A fault in a runner must not leave the dispatcher waiting for ever.
        let mut retrying = |retry, error, pause| drop(news.send(News::Retrying(stage, retry, error, pause)));
        let built = catch_unwind(AssertUnwindSafe(|| self.build_until(site, &mut { said }, &mut retrying)));
        let built = built.unwrap_or_else(|_| Err(Failure::by_itself("the engine's worker panicked")));
        match built {
            Err(failure) => drop(news.send(News::Built(stage, Err(failure)))),
            Ok((blobs, took)) => {
                let outputs = Arc::new(self.record.outputs.clone());
                let _ = news.send(News::Built(stage, Ok(outputs)));
                let committed = self.commit(site.store, &blobs).map_err(|error| error.to_string());
                let _ = news.send(News::Committed(stage, committed.map(|()| took)));
            }
        }
        self.run.clear(&self.folder);
        let _ = self.lock.remove();
    }

    /// Builds it, again and again as far as its `retries` allow. What is wrong with the store is no better the next time.
    fn build_until(
        &mut self,
        site: Site<'_>,
        hear: &mut dyn FnMut(Message),
        retrying: &mut dyn FnMut(u32, String, Duration),
    ) -> Result<(Vec<Blob>, Duration), Failure> {
        let mut retry = 0;
        loop {
            let error = match self.build(site, hear) {
                Err(Failure::Failed(error, cause))
                    if cause != Cause::Store && retry < self.limits.retries =>
                {
                    error
                }
                other => return other,
            };
            retry += 1;
            let pause = self.limits.pause_before(retry);
            retrying(retry, error, pause);
            let began = Instant::now();
            while began.elapsed() < pause {
                if site.halt.load(Ordering::Relaxed) {
                    return Err(Failure::Stopped);
                }
                std::thread::sleep(GLANCE.min(pause - began.elapsed().min(pause)));
            }
        }
    }

    fn build(
        &mut self,
        site: Site<'_>,
        hear: &mut dyn FnMut(Message),
    ) -> Result<(Vec<Blob>, Duration), Failure> {
        for file in &self.files {
            let _held = site.store.hold()?;
            self.run.rely_on([], [file.digest])?;
            if let Some(folder) = &file.folder {
                self.run.rely_on([], folder.files().map(|(_, file)| file.digest))?;
            }
            bring_in(file, site.store, &self.run)?;
        }
        // What an earlier stage of this run with the same key has left (two that were forced).
        fsx::remove_dir_all(&self.folder)?;
        fsx::create_dir(&self.folder)?;
        if self.ports.outside.is_some() {
            self.pass_on();
            return Ok((Vec::new(), Duration::ZERO));
        }
        let laid = inputs::lay_out(&self.placed, site.store)?;
        let launch = Launch {
            job: &self.job,
            kind: self.kind,
            lock: Some(&self.lock),
            log: &self.log,
            folder: &self.folder,
            threads: self.threads,
            units: &self.units,
            stop: site.halt,
            grace: site.options.grace,
            limits: self.limits,
        };
        let began = Instant::now();
        let with = &mut self.record.fingerprint.with;
        let mut hear = |message| match message {
            Message::MadeWith(said) => with.extend(said),
            other => hear(other),
        };
        ended(site.runner.run(&launch, &mut hear), &self.limits)
            .map_err(|failure| self.in_words_of_the_file(failure))?;
        let took = began.elapsed();
        laid.check()?;
        self.record.seconds = took.as_secs_f64();
        Ok((self.take_outputs(site.store)?, took))
    }

    /// An error with its inputs named as the pipeline file does: a stage knows only where their contents lie.
    fn in_words_of_the_file(&self, failure: Failure) -> Failure {
        let Failure::Failed(mut error, cause) = failure else { return failure };
        for (port, items) in &self.job.inputs {
            let origins = self.record.inputs.iter().find(|input| input.port == *port);
            for (item, origin) in items.iter().zip(origins.iter().flat_map(|input| &input.items)) {
                if let Some(path) = item.path.to_str().filter(|path| error.contains(*path)) {
                    error = error.replace(path, &format!("{} (input `{port}`, {path})", origin.from));
                }
            }
        }
        Failure::Failed(error, cause)
    }

    /// What was brought in from outside is the output, as it is.
    fn pass_on(&mut self) {
        for (file, output) in self.files.iter().zip(&self.ports.outputs) {
            let stored = Stored {
                digest: file.digest,
                bytes: file.bytes,
                extension: output.extension.to_owned(),
                folder: file.folder.is_some(),
                executable: file.executable,
            };
            self.record.outputs.insert(output.name.to_owned(), stored);
        }
    }

    /// Moves what the stage wrote into the store; all of its outputs are there and are what they should be, or none is
    /// taken.
    fn take_outputs(&mut self, store: &Store) -> Result<Vec<Blob>, Failure> {
        let mut paths = Vec::with_capacity(self.ports.outputs.len());
        for output in &self.ports.outputs {
            let path = output_path(&self.folder, output.name, output.extension);
            check_output(output, &path)?;
            paths.push(path);
        }
        let mut blobs = Vec::with_capacity(paths.len());
        // Until its record is there, nothing else says that a content is needed.
        let _held = store.hold()?;
        for (output, path) in self.ports.outputs.iter().zip(paths) {
            let folder = output.artifact == Artifact::Folder;
            let executable = !folder && fsx::is_executable(&path)?;
            let blob = if folder { store.take_folder(&path)? } else { store.take(&path)? };
            self.run.rely_on([], blob.contents())?;
            let (digest, bytes, extension) = (blob.digest, blob.bytes, output.extension.to_owned());
            let stored = Stored { digest, bytes, extension, folder, executable };
            self.record.outputs.insert(output.name.to_owned(), stored);
            blobs.push(blob);
        }
        Ok(blobs)
    }

    fn commit(&self, store: &Store, blobs: &[Blob]) -> Result<(), StoreError> {
        store.commit(&self.key, &self.record, blobs, &self.folder)?;
        store.clear_checkpoints(&self.key, &self.folder)
    }
}

/// Runs a stage whose result is there once more, beside it, and compares.
pub(super) fn again(
    stage: StageIndex,
    key: &Key,
    run: &Run,
    log: &Path,
    shape: Shape<'_>,
    done: &[Option<Arc<Outputs>>],
    site: Site<'_>,
) -> Again {
    let folder = run.temporary().join(key.hex());
    let came = run_again(stage, key, run, (&folder, log), shape, done, site);
    let _ = fsx::remove_dir_all(&folder);
    match came {
        Ok(again) => again,
        Err(Failure::Stopped) => Again::Stopped,
        Err(Failure::Failed(error, _)) => Again::Failed(error),
    }
}

/// Copies a file or folder from outside into the store.
fn bring_in(file: &OutsideFile, store: &Store, run: &Run) -> Result<(), StoreError> {
    match &file.folder {
        Some(folder) => store.import_folder(&file.path, folder, run),
        None => store.import(&file.path, &file.digest, run),
    }
}

fn run_again(
    stage: StageIndex,
    key: &Key,
    run: &Run,
    (folder, log): (&Path, &Path),
    shape: Shape<'_>,
    done: &[Option<Arc<Outputs>>],
    site: Site<'_>,
) -> Result<Again, Failure> {
    let node = &shape.graph.stages[stage];
    let Some(outputs) = &done[stage.index()] else { return Ok(Again::Same) };
    if node.ports.outside.is_some() {
        return Ok(Again::Same);
    }
    for file in outside(node, shape) {
        bring_in(file, site.store, run)?;
    }
    fsx::create_dir(folder)?;
    let (mut job, placed) = job(node, key, folder, done, shape, site);
    inputs::lay_out(&placed, site.store)?;
    let lock = Lock::acquire(&folder.join("lock"))?;
    let units = Pool::new(&site.options.resources).take(stage, &node.resources);
    // A place of its own: what the first run left must not help the second.
    job.checkpoints = folder.join("again").join("files");
    let launch = Launch {
        job: &job,
        kind: node.kind,
        lock: Some(&lock),
        log,
        folder,
        threads: node.needs.threads.max(1),
        units: &units,
        stop: site.halt,
        grace: site.options.grace,
        limits: node.limits,
    };
    ended(site.runner.run(&launch, &mut |_| {}), &node.limits)?;
    for output in &node.ports.outputs {
        let path = output_path(folder, output.name, output.extension);
        check_output(output, &path)?;
        let Some(stored) = outputs.get(output.name) else { continue };
        let digest = match output.artifact {
            Artifact::Folder => store::hash_folder(&path)?.digest(),
            _ => store::hash_file(&path)?.0,
        };
        if digest != stored.digest {
            let at = if stored.folder {
                0
            } else {
                fsx::first_difference(&path, &site.store.blob_path(&stored.digest))?
            };
            let kept = run.folder().join("differs").join(format!(
                "{}-{}.{}",
                key.short(),
                output.name,
                output.extension
            ));
            fsx::rename_into(&path, &kept)?;
            return Ok(Again::Differs { output: output.name.to_owned(), at, path: kept });
        }
    }
    Ok(Again::Same)
}

fn ended(exit: std::io::Result<Exit>, limits: &Limits) -> Result<(), Failure> {
    match exit {
        Ok(Exit::Done) => Ok(()),
        Ok(Exit::Stopped) => Err(Failure::Stopped),
        Ok(Exit::Failed(error)) => Err(Failure::by_itself(error)),
        Ok(Exit::OutOfMemory(error)) => Err(Failure::Failed(error, Cause::Memory)),
        Ok(Exit::TimedOut) => {
            let limit = limits.timeout.unwrap_or_default().as_secs_f64();
            Err(Failure::Failed(
                format!("it took longer than the {limit} s that its `timeout` allows"),
                Cause::Timeout,
            ))
        }
        Err(error) => Err(Failure::by_itself(error)),
    }
}

fn check_output(output: &Output, path: &Path) -> Result<(), Failure> {
    let expected = if output.artifact == Artifact::Folder { "folder" } else { "file" };
    let seen = match fsx::entry(path)? {
        Some(Entry::File(_)) if expected == "file" => return Ok(()),
        Some(Entry::Folder) if expected == "folder" => return Ok(()),
        None => return Err(Failure::by_itself(format!("output `{}` was not written", output.name))),
        Some(Entry::File(_)) => "is a file",
        Some(Entry::Folder) => "is a folder",
        Some(Entry::Other) => "is a link or no regular file",
    };
    Err(Failure::by_itself(format!("output `{}` {seen}, expected a {expected}", output.name)))
}
