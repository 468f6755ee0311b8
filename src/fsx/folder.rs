//! Walks folders, and reads the metadata that identifies the state of a file.

use std::fs::Metadata;
use std::io;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use super::{FsError, Result, create_dir_all, step};

/// The maximum depth of folders; deeper ones are a mistake, such as a folder that contains a copy of itself.
const DEEPEST: usize = 200;

/// The metadata of a file. While all of it is the same, the content is the same, except for a change within the resolution of the
/// clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stat {
    /// The device.
    pub device: u64,
    /// The inode.
    pub inode: u64,
    /// Bytes.
    pub bytes: u64,
    /// The last change of the content, in nanoseconds since 1970.
    pub modified: i64,
    /// The last change of anything about it, in nanoseconds since 1970; no program can set it.
    pub changed: i64,
    /// True where it is executable.
    pub executable: bool,
}

impl Stat {
    pub(super) fn of(meta: &Metadata) -> Self {
        let nanoseconds =
            |seconds: i64, rest: i64| seconds.saturating_mul(1_000_000_000).saturating_add(rest);
        Self {
            device: meta.dev(),
            inode: meta.ino(),
            bytes: meta.len(),
            modified: nanoseconds(meta.mtime(), meta.mtime_nsec()),
            changed: nanoseconds(meta.ctime(), meta.ctime_nsec()),
            executable: meta.permissions().mode() & 0o111 != 0,
        }
    }
}

/// True where the files in a folder, all the way down, have at most so many bytes; false where that cannot be seen.
pub fn holds_at_most(folder: &Path, bytes: u64) -> bool {
    left_of(folder, bytes, 0).is_some()
}

fn left_of(folder: &Path, bytes: u64, depth: usize) -> Option<u64> {
    let mut left = bytes;
    for entry in std::fs::read_dir(folder).ok()? {
        let entry = entry.ok().filter(|_| depth < DEEPEST)?;
        let kind = entry.file_type().ok()?;
        if kind.is_dir() {
            left = left_of(&entry.path(), left, depth + 1)?;
        } else if kind.is_file() {
            left = left.checked_sub(entry.metadata().ok()?.len())?;
        }
    }
    Some(left)
}

/// The latest modification time of a file or folder and of everything below it, links not followed; `None` where there is
/// nothing. A folder's own time does not change when a file in it is overwritten.
///
/// # Errors
/// It cannot be read. What disappears meanwhile is not an error.
pub fn newest(path: &Path) -> Result<Option<SystemTime>> {
    let mut newest = super::modified(path)?;
    let mut open = vec![(path.to_owned(), 0)];
    while let Some((folder, depth)) = open.pop() {
        let entries = match std::fs::read_dir(&folder) {
            Ok(entries) => entries,
            Err(error) if matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => {
                continue;
            }
            Err(error) => return Err(FsError::at("list", &folder)(error)),
        };
        for entry in entries {
            let path = entry.map_err(FsError::at("list", &folder))?.path();
            newest = newest.max(super::modified(&path)?);
            if depth < DEEPEST && path.symlink_metadata().is_ok_and(|meta| meta.is_dir()) {
                open.push((path, depth + 1));
            }
        }
    }
    Ok(newest)
}

/// The type of a file from outside, links followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outside {
    /// A regular file.
    File(Stat),
    /// A folder.
    Folder,
}

/// The type of a file from outside.
///
/// # Errors
/// It does not exist, or is neither a file nor a folder.
pub fn outside(path: &Path) -> Result<Outside> {
    sort(path, &std::fs::metadata(path).map_err(FsError::at("read", path))?)
}

fn sort(path: &Path, meta: &Metadata) -> Result<Outside> {
    if meta.is_file() {
        Ok(Outside::File(Stat::of(meta)))
    } else if meta.is_dir() {
        Ok(Outside::Folder)
    } else {
        Err(refuse(path, "it is neither a file nor a folder"))
    }
}

/// An entry of a folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Inside {
    /// Its path, relative to the folder.
    pub path: PathBuf,
    /// What is there.
    pub what: What,
}

/// The types of entries in a folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum What {
    /// A file, or a link to one outside the folder.
    File(Stat),
    /// An empty folder.
    Empty,
    /// A symbolic link to something in the same folder: where it leads, relative to the folder that the link lies in, as
    /// any number of `..`, then names.
    Link(PathBuf),
}

/// What to do with a symbolic link to a file in the same folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Links {
    /// Its file is taken for it.
    Follow,
    /// It is kept as a link.
    Keep,
}

/// All files, empty folders and links below `root` but for what is `left_out` (asked with the path in `root`; what is in a
/// folder that is left out is left out too), in no order that means anything. A link to a folder inside `root` is
/// kept, one to a file outside is taken for its file.
///
/// # Errors
/// Something cannot be read, or is neither file nor folder; a link leads nowhere, in a circle, or to a folder outside.
pub fn walk(root: &Path, links: Links, left_out: &dyn Fn(&Path) -> bool) -> Result<Vec<Inside>> {
    let mut found = Vec::new();
    let mut open = vec![(PathBuf::new(), 0)];
    while let Some((folder, depth)) = open.pop() {
        let path = root.join(&folder);
        if depth > DEEPEST {
            return Err(refuse(&path, "it is nested more than 200 folders deep"));
        }
        let mut empty = true;
        for entry in std::fs::read_dir(&path).map_err(FsError::at("list", &path))? {
            let entry = entry.map_err(FsError::at("list", &path))?;
            let (inside, path) = (folder.join(entry.file_name()), entry.path());
            if left_out(&inside) {
                continue;
            }
            empty = false;
            let kind = entry.file_type().map_err(FsError::at("access", &path))?;
            if kind.is_dir() {
                open.push((inside, depth + 1));
                continue;
            }
            let what = if kind.is_symlink() { link(root, &inside, links)? } else { what(&path)? };
            found.push(Inside { path: inside, what });
        }
        if empty && depth > 0 {
            found.push(Inside { path: folder, what: What::Empty });
        }
    }
    Ok(found)
}

fn what(path: &Path) -> Result<What> {
    match outside(path)? {
        Outside::File(stat) => Ok(What::File(stat)),
        Outside::Folder => Err(refuse(path, "it is now a folder, but was not when it was listed")),
    }
}

/// What is at `inside`, a symbolic link in `root`.
fn link(root: &Path, inside: &Path, links: Links) -> Result<What> {
    let path = root.join(inside);
    let target = std::fs::read_link(&path).map_err(FsError::at("read", &path))?;
    let leads_to = format!("it is a link to `{}`", target.display());
    let refuse = |why: &str| FsError::at("read", &path)(io::Error::other(format!("{leads_to}, {why}")));
    let end = path.canonicalize().map_err(|error| match error.raw_os_error() {
        Some(libc::ELOOP) => refuse("and is circular"),
        _ if error.kind() == io::ErrorKind::NotFound => refuse("which does not exist: the link is broken"),
        _ => FsError::at("read", &path)(error),
    })?;
    let real_root = root.canonicalize().map_err(FsError::at("access", root))?;
    let within = end.strip_prefix(&real_root).ok();
    match (outside(&path)?, within) {
        (Outside::File(stat), _) if links == Links::Follow => Ok(What::File(stat)),
        (Outside::File(stat), None) => Ok(What::File(stat)),
        (Outside::Folder, None) => {
            Err(refuse("a folder outside this one, which is not followed: copy that folder"))
        }
        (_, Some(end)) => {
            let above = inside.parent().unwrap_or(Path::new(""));
            // As it was written, where that is plain.
            let written = if is_plain_target(above, &target) { target } else { relative(above, end) };
            Ok(What::Link(written))
        }
    }
}

/// Gives the owner of a folder, which is no link, all permissions on it: what is in a folder can be moved only with them.
fn own(folder: &Path) -> Result<()> {
    let meta = std::fs::symlink_metadata(folder).map_err(FsError::at("access", folder))?;
    let mode = meta.permissions().mode();
    if !meta.is_dir() || mode & 0o700 == 0o700 {
        return Ok(());
    }
    let rights = std::fs::Permissions::from_mode(mode & 0o7777 | 0o700);
    std::fs::set_permissions(folder, rights).map_err(FsError::at("make writable", folder))
}

/// Gives the owner all permissions on the folder `root` and on the folders between it and `inside`, a path in it. What is missing
/// there is no error.
///
/// # Errors
/// They belong to another user.
pub fn own_above(root: &Path, inside: &Path) -> Result<()> {
    own(root)?;
    let mut folder = root.to_owned();
    for part in inside.parent().unwrap_or(Path::new("")).components() {
        folder.push(part);
        match own(&folder) {
            Err(error) if error.is_not_found() => break,
            result => result?,
        }
    }
    Ok(())
}

/// Makes an output folder ready to be stored: its folders are writable, and its links independent of where it lies: those that
/// lead inside it lead there by the shortest way, those that lead to a file outside become copies of it.
///
/// # Errors
/// As [`walk`]; or the folder cannot be written.
pub fn settle_links(root: &Path) -> Result<()> {
    let mut open = vec![PathBuf::new()];
    // All are looked at before one is changed: they may lead to each other.
    let mut found = Vec::new();
    while let Some(folder) = open.pop() {
        let path = root.join(&folder);
        own(&path)?;
        for entry in std::fs::read_dir(&path).map_err(FsError::at("list", &path))? {
            let entry = entry.map_err(FsError::at("list", &path))?;
            let kind = entry.file_type().map_err(FsError::at("access", &entry.path()))?;
            let inside = folder.join(entry.file_name());
            if kind.is_symlink() {
                found.push((link(root, &inside, Links::Keep)?, inside));
            } else if kind.is_dir() && folder.components().count() < DEEPEST {
                open.push(inside);
            }
        }
    }
    for (what, inside) in found {
        let path = root.join(inside);
        match what {
            What::Link(to) if std::fs::read_link(&path).ok().as_ref() != Some(&to) => {
                super::remove_file(&path)?;
                super::symlink(&to, &path)?;
            }
            What::File(_) => super::be_a_file(&path)?,
            What::Link(_) | What::Empty => {}
        }
    }
    Ok(())
}

/// True for where a link in the folder `above` may lead, both in one folder: as any number of `..` that do not lead out of
/// it, then names. A `..` behind a name is none of these: where it leads depends on what the name is.
pub fn is_plain_target(above: &Path, target: &Path) -> bool {
    let depth = above.components().count();
    let mut parts = target.as_os_str().as_encoded_bytes().split(|byte| *byte == b'/').peekable();
    let mut up = 0;
    while parts.next_if(|part| *part == b"..").is_some() {
        up += 1;
    }
    let rest: Vec<&[u8]> = parts.collect();
    up <= depth
        && (up > 0 || !rest.is_empty())
        && rest.iter().all(|part| !matches!(*part, b"" | b"." | b".."))
}

/// The way from the folder `from` to `to`, both in one folder, or both absolute.
pub fn relative(from: &Path, to: &Path) -> PathBuf {
    let shared = from.components().zip(to.components()).take_while(|(a, b)| a == b).count();
    let up = from.components().skip(shared).map(|_| "..");
    let way: PathBuf = up
        .map(std::ffi::OsStr::new)
        .chain(to.components().skip(shared).map(|part| part.as_os_str()))
        .collect();
    match (way.as_os_str().is_empty(), from.file_name()) {
        (false, _) => way,
        // The folder that the link lies in: named, since `.` is no name.
        (true, Some(name)) => Path::new("..").join(name),
        (true, None) => way,
    }
}

fn refuse(path: &Path, why: &'static str) -> FsError {
    FsError::at("read", path)(io::Error::other(why))
}

/// Puts the read-only file `from` at `to`, which shares its content where the file system allows that. An executable one
/// is copied: the right to execute belongs to the file, not to its name.
///
/// # Errors
/// `from` is not there, or `to` cannot be made.
pub fn put(from: &Path, to: &Path, executable: bool) -> Result<()> {
    if let Some(folder) = to.parent() {
        create_dir_all(folder)?;
    }
    step("link", to)?;
    if !executable && std::fs::hard_link(from, to).is_ok() {
        return Ok(());
    }
    super::copy(from, to)?;
    let mode = if executable { 0o555 } else { 0o444 };
    let rights = std::fs::Permissions::from_mode(mode);
    std::fs::set_permissions(to, rights).map_err(FsError::at("make read-only", to))
}

/// For [`walk`]: everything counts.
pub fn nothing(_: &Path) -> bool {
    false
}
