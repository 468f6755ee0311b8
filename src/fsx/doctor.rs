//! Measures what a file system gives of the things that a store relies on (`docs/design/store.md`): on this machine alone, and with a
//! second process on another one ([`pair`]).

mod pair;

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant, SystemTime};

pub use pair::{Attended, attend};

use super::{FsError, Result, heartbeat};

/// The folder of a measurement, in the folder that is measured.
const FOLDER: &str = ".dril-doctor";
/// With less free space a store is not used comfortably.
const COMFORTABLE: u64 = 1 << 30;
/// An fsync that takes longer makes every result late.
const SLOW_SYNC: Duration = Duration::from_millis(100);
/// A time of the file system that differs more from the local clock is mentioned.
const OFFSET: Duration = Duration::from_secs(2);

/// Whether a file system gives something.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Health {
    /// Yes.
    Ok,
    /// Not quite, or not at all where that can be done without.
    Degraded,
    /// No, and a store relies on it.
    Fails,
    /// It was not measured.
    Unknown,
}

/// What was measured.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Check {
    /// Its name, the same for ever.
    pub name: &'static str,
    /// The verdict.
    pub health: Health,
    /// What was seen.
    pub seen: String,
    /// What that means for a user; empty where all is well.
    pub means: &'static str,
}

impl Check {
    fn new(name: &'static str, health: Health, seen: impl Into<String>, means: &'static str) -> Self {
        Self { name, health, seen: seen.into(), means: if health == Health::Ok { "" } else { means } }
    }

    /// The verdict of a measurement that may be impossible: then what it is for does not work either.
    fn of(name: &'static str, measured: io::Result<Self>, means: &'static str) -> Self {
        measured.unwrap_or_else(|error| Self::new(name, Health::Fails, error.to_string(), means))
    }
}

/// Measures the file system of `folder`. Its own files are in a folder that is removed at the end. A process that
/// [attends](attend) on another machine takes part.
///
/// # Errors
/// `folder` does not exist, or nothing can be created in it.
pub fn examine(folder: &Path) -> Result<Vec<Check>> {
    let place = folder.join(FOLDER);
    std::fs::metadata(folder).map_err(FsError::at("access", folder))?;
    super::create_dir_all(&place)?;
    let own = tempfile::Builder::new()
        .prefix("own-")
        .tempdir_in(&place)
        .map_err(FsError::at("write in", &place))?;
    let at = own.path();
    let mut checks = vec![
        Check::of("create", create(at), "two engines could build the same stage: do not keep a store here"),
        Check::of("rename", rename(at), "half a result could be read: do not keep a store here"),
        Check::of("time", time(at), "engines on other machines could be taken for dead"),
        locks(at),
        moves(at),
        links(at),
        blocks(at),
        Check::of("sync", sync(at), "results could be lost with the power"),
        Check::of("space", space(at), "results cannot be stored"),
        Check::of("names", names(at), "outputs whose names differ only in case collide"),
    ];
    checks.extend(pair::lead(&place)?);
    drop(own);
    // Others may be measuring here.
    let _ = std::fs::remove_dir(&place);
    Ok(checks)
}

fn new_file(path: &Path) -> io::Result<File> {
    OpenOptions::new().write(true).create_new(true).open(path)
}

/// Of many that create the same file, one gets it.
fn create(at: &Path) -> io::Result<Check> {
    const NAMES: usize = 100;
    let win = || -> io::Result<Vec<usize>> {
        let mut won = Vec::new();
        for name in 0..NAMES {
            match new_file(&at.join(format!("create-{name}"))) {
                Ok(_) => won.push(name),
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error),
            }
        }
        Ok(won)
    };
    let won: Vec<io::Result<Vec<usize>>> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..4).map(|_| scope.spawn(win)).collect();
        threads.into_iter().map(|thread| thread.join().unwrap_or_else(|_| Ok(Vec::new()))).collect()
    });
    let mut all: Vec<usize> = won.into_iter().collect::<io::Result<Vec<_>>>()?.concat();
    all.sort_unstable();
    let health = if all.iter().copied().eq(0..NAMES) { Health::Ok } else { Health::Fails };
    let seen = format!("{} of {NAMES} files had one creator", unique(&all));
    Ok(Check::new("create", health, seen, "two engines could build the same stage: do not keep a store here"))
}

/// How many numbers are there once; the list is sorted.
fn unique(sorted: &[usize]) -> usize {
    sorted.chunk_by(|one, other| one == other).filter(|same| same.len() == 1).count()
}

/// Who reads a file while others replace it sees one of them as a whole.
fn rename(at: &Path) -> io::Result<Check> {
    const ROUNDS: usize = 200;
    const BYTES: usize = 64 * 1024;
    let target = at.join("target");
    let over = AtomicBool::new(false);
    std::fs::write(&target, vec![b'a'; BYTES])?;
    let (mixed, reads) = std::thread::scope(|scope| {
        let reader = scope.spawn(|| {
            let (mut mixed, mut reads) = (0, 0);
            while !over.load(Ordering::Relaxed) || reads == 0 {
                reads += 1;
                let whole = std::fs::read(&target)
                    .is_ok_and(|read| read.len() == BYTES && read.iter().all(|byte| *byte == read[0]));
                mixed += usize::from(!whole);
            }
            (mixed, reads)
        });
        let written = (0..ROUNDS).try_for_each(|round| {
            let draft = at.join("draft");
            std::fs::write(&draft, vec![b'a' + u8::from(round % 2 == 0); BYTES])?;
            std::fs::rename(&draft, &target)
        });
        over.store(true, Ordering::Relaxed);
        written.map(|()| reader.join().unwrap_or((1, 1)))
    })?;
    let health = if mixed == 0 { Health::Ok } else { Health::Fails };
    let seen = format!("{mixed} of {reads} reads during {ROUNDS} replacements were not whole");
    Ok(Check::new("rename", health, seen, "half a result could be read: do not keep a store here"))
}

/// A touched file has a new time, and not a local one.
fn time(at: &Path) -> io::Result<Check> {
    let path = at.join("time");
    drop(new_file(&path)?);
    let before = std::fs::metadata(&path)?.modified()?;
    let began = Instant::now();
    let after = loop {
        std::thread::sleep(Duration::from_millis(50));
        if heartbeat::touch(&path).is_err() {
            return Err(io::Error::other("a file cannot be touched"));
        }
        let now = std::fs::metadata(&path)?.modified()?;
        if now > before || began.elapsed() > Duration::from_secs(5) {
            break now;
        }
    };
    if after <= before {
        let means = "engines on other machines would be taken for dead: do not share a store here";
        return Ok(Check::new("time", Health::Fails, "a touched file keeps its time", means));
    }
    let step = after.duration_since(before).unwrap_or_default();
    let local = SystemTime::now();
    let (offset, sign) = match after.duration_since(local) {
        Ok(ahead) => (ahead, "ahead of"),
        Err(behind) => (behind.duration(), "behind"),
    };
    let seen = match offset > OFFSET {
        true => format!("its clock is {:.1} s {sign} the local one", offset.as_secs_f64()),
        false => format!("a touch moves it by {} ms", step.as_millis()),
    };
    // An offset does no harm: ages are measured with the clock of the file system alone.
    Ok(Check::new("time", Health::Ok, seen, ""))
}

/// Kernel locks between processes of this machine.
fn locks(at: &Path) -> Check {
    let means = "after `kill -9` the next run waits a minute for the stages that were running";
    let path = at.join("lock");
    let test = || -> io::Result<bool> {
        let (one, other) = (new_file(&path)?, File::open(&path)?);
        one.lock()?;
        let excluded = matches!(other.try_lock(), Err(std::fs::TryLockError::WouldBlock));
        one.unlock()?;
        Ok(excluded && other.try_lock().is_ok())
    };
    match test() {
        Ok(true) => Check::new("flock", Health::Ok, "kernel locks exclude each other on this machine", ""),
        Ok(false) => Check::new(
            "flock",
            Health::Fails,
            "two have the same kernel lock",
            "two engines of this machine could build the same stage: do not keep a store here",
        ),
        Err(error) => Check::new("flock", Health::Degraded, error.to_string(), means),
    }
}

/// Moving a file without replacing another.
fn moves(at: &Path) -> Check {
    let (from, to) = (at.join("from"), at.join("to"));
    let test = || -> io::Result<bool> {
        for expected in [true, false] {
            std::fs::write(&from, b"content")?;
            let moved = super::rename_new(&from, &to).map_err(|error| error.source)?;
            if moved.is_some() != expected {
                return Ok(false);
            }
        }
        Ok(true)
    };
    let means = "results cannot be stored: do not keep a store here";
    match test() {
        Ok(true) => Check::new("move", Health::Ok, "a file is moved only where nothing is", ""),
        Ok(false) => Check::new("move", Health::Fails, "a file that is moved replaces another", means),
        Err(error) => Check::new("move", Health::Fails, error.to_string(), means),
    }
}

fn links(at: &Path) -> Check {
    let made =
        new_file(&at.join("linked")).and_then(|_| std::fs::hard_link(at.join("linked"), at.join("link")));
    match made {
        Ok(()) => Check::new("links", Health::Ok, "there are hard links", ""),
        Err(error) => Check::new(
            "links",
            Health::Degraded,
            error.to_string(),
            "a folder that a stage reads is copied, which takes time and room",
        ),
    }
}

fn blocks(at: &Path) -> Check {
    let means =
        "commands get copies of their inputs, which takes time and room; btrfs, XFS and ZFS share them";
    let test = || -> Result<bool> {
        super::write(&at.join("blocks"), &[7; 8192])?;
        let file = super::open(&at.join("blocks"))?;
        Ok(super::clone_file(&file, &at.join("shared"), 0o444)?.is_some())
    };
    match test() {
        Ok(true) => Check::new("reflinks", Health::Ok, "files can share their blocks", ""),
        Ok(false) => Check::new("reflinks", Health::Degraded, "files cannot share their blocks", means),
        Err(error) => Check::new("reflinks", Health::Degraded, error.to_string(), means),
    }
}

fn sync(at: &Path) -> io::Result<Check> {
    let mut times = Vec::new();
    for round in 0..5 {
        let began = Instant::now();
        let mut file = new_file(&at.join(format!("sync-{round}")))?;
        file.write_all(&[7; 4096])?;
        file.sync_all()?;
        File::open(at)?.sync_all()?;
        times.push(began.elapsed());
    }
    times.sort_unstable();
    let middle = times[times.len() / 2];
    let health = if middle > SLOW_SYNC { Health::Degraded } else { Health::Ok };
    let seen = format!("a small file is durable after {:.1} ms", middle.as_secs_f64() * 1000.0);
    Ok(Check::new("sync", health, seen, "every result takes so long to be stored; stages do not wait for it"))
}

fn space(at: &Path) -> io::Result<Check> {
    let system = rustix::fs::statvfs(at)?;
    let free = system.f_bavail.saturating_mul(system.f_frsize);
    let (health, means) = match free {
        0 => (Health::Fails, "nothing can be stored"),
        _ if free < COMFORTABLE || system.f_favail == 0 && system.f_files > 0 => {
            (Health::Degraded, "a run may find the disk full; see `dril-pipe cache gc`")
        }
        _ => (Health::Ok, ""),
    };
    let files =
        if system.f_files > 0 { format!(", room for {} files", system.f_favail) } else { String::new() };
    let seen = format!("{:.1} GB free{files}", free as f64 / 1e9);
    Ok(Check::new("space", health, seen, means))
}

fn names(at: &Path) -> io::Result<Check> {
    drop(new_file(&at.join("Case"))?);
    let apart = new_file(&at.join("case")).is_ok();
    let (health, seen) = match apart {
        true => (Health::Ok, "names that differ in case are different"),
        false => (Health::Degraded, "names that differ in case are the same"),
    };
    Ok(Check::new("names", health, seen, "outputs whose names differ only in case collide"))
}

/// A path that no other process uses.
fn unique_name(prefix: &str) -> PathBuf {
    let time = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default().as_nanos();
    format!("{prefix}-{}-{}-{time:x}", super::host::this().name, std::process::id()).into()
}
