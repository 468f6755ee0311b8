//! The file of a lease: what it says, and whether its owner is alive.

use std::io::Read;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use super::{FsError, Result, clock, host};

/// How long a lease of work is held without a sign of life. Long enough for a file server that is busy, short enough to wait for.
pub const WORK: Duration = Duration::from_secs(60);
/// As [`WORK`], for runs: nobody waits for what a dead run left, and a run that was cut off from the file server for minutes is
/// not to lose what it relies on.
pub const RUN: Duration = Duration::from_secs(15 * 60);

/// How long a lease is held that names no owner yet: its owner does so with the next system call after it made the file.
const UNNAMED: Duration = Duration::from_secs(5);

/// The first word of a lease: its format.
pub(super) const FORMAT: &str = "lease-1";

/// A lease that was found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Seen {
    text: String,
    touched: SystemTime,
}

/// What a lease says: `lease-1 <patience in ms> <boot>:<device> <host> <process> <unique name>`.
struct Owner<'t> {
    patience: Duration,
    place: &'t str,
    host: &'t str,
    name: &'t str,
}

/// The folder of a lease.
pub(super) fn folder(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

impl Seen {
    /// A lease with that text.
    pub fn of(text: &str) -> Self {
        Self { text: text.to_owned(), touched: UNIX_EPOCH }
    }

    /// The lease at `path`; `None` where there is none. The file is opened, since network file systems may answer questions
    /// about a file that is not open from a cache.
    pub fn at(path: &Path) -> Result<Option<Self>> {
        let file = match super::if_there("open the lease", path, std::fs::File::open(path)) {
            // The server has forgotten a file that was removed at this moment.
            Err(error) if error.source.raw_os_error() == Some(rustix::io::Errno::STALE.raw_os_error()) => {
                None
            }
            file => file?,
        };
        let Some(mut file) = file else { return Ok(None) };
        let mut text = String::new();
        // Whatever is no text is no lease of ours, and is judged by its age.
        let _ = Read::by_ref(&mut file).take(1024).read_to_string(&mut text);
        let touched =
            file.metadata().and_then(|meta| meta.modified()).map_err(FsError::at("access", path))?;
        Ok(Some(Self { text, touched }))
    }

    /// True while it is held. `alone`: see [`Lease::take`].
    pub fn is_held(&self, path: &Path, alone: bool) -> bool {
        let owner = self.owner();
        if alone && owner.as_ref().is_some_and(|owner| owner.is_here(path)) {
            return false;
        }
        let patience = owner.map_or(super::fault::patience(WORK).min(UNNAMED), |owner| owner.patience);
        self.age(path) < patience
    }

    /// How long ago it was touched, by the clock of its file system.
    fn age(&self, path: &Path) -> Duration {
        clock::now(folder(path)).duration_since(self.touched).unwrap_or_default()
    }

    /// What it says, unique to it.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// See [`Seen::text`].
    pub fn into_text(self) -> String {
        self.text
    }

    /// The name of the machine that holds it; `None` where it is no lease.
    pub fn host(&self) -> Option<&str> {
        self.owner().map(|owner| owner.host)
    }

    fn owner(&self) -> Option<Owner<'_>> {
        let mut words = self.text.strip_suffix('\n')?.split(' ');
        let (FORMAT, millis, place) = (words.next()?, words.next()?, words.next()?) else { return None };
        let (host, _process, name) = (words.next()?, words.next()?, words.next()?);
        Some(Owner { patience: Duration::from_millis(millis.parse().ok()?), place, host, name })
    }

    /// The path of the lease on the right to remove this one.
    pub fn right_to_remove(&self, path: &Path) -> PathBuf {
        let mut right = path.as_os_str().to_owned();
        right.push(".");
        match self.owner() {
            Some(owner) => right.push(owner.name),
            // Of a process that died between two system calls: identified by its time.
            None => {
                let time = self.touched.duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos();
                right.push(format!("unknown-{time:x}"));
            }
        }
        right.into()
    }
}

impl Owner<'_> {
    /// True where it runs on this machine and sees the same kernel locks: a file system that is mounted twice may have two sets.
    fn is_here(&self, path: &Path) -> bool {
        let Some((boot, device)) = self.place.rsplit_once(':') else { return false };
        boot == host::this().boot
            && std::fs::metadata(folder(path)).is_ok_and(|meta| device.parse() == Ok(meta.dev()))
    }
}
