//! Copies of files, and checks whether a file can still be changed.

use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::Path;
use std::time::SystemTime;

use super::fault::step;
use super::{FsError, Result, Stat};

/// The buffer size for copying.
const PORTION: usize = 256 * 1024;

/// A file that we created, with its metadata at the time.
#[derive(Debug)]
pub struct Made {
    /// Its metadata.
    pub stat: Stat,
    /// Its creation time, if the file system has one.
    created: Option<SystemTime>,
    /// While it is open, its inode number is not reused. Not open for every one of thousands.
    _held: Option<File>,
}

impl Made {
    /// Its current metadata; `None` where it is gone or was replaced.
    pub fn now(&self, path: &Path) -> Result<Option<Stat>> {
        let meta = super::if_there("access", path, std::fs::symlink_metadata(path))?;
        let Some(meta) = meta.filter(std::fs::Metadata::is_file) else { return Ok(None) };
        let stat = Stat::of(&meta);
        let is_same = (stat.device, stat.inode) == (self.stat.device, self.stat.inode)
            && meta.created().ok() == self.created;
        Ok(is_same.then_some(stat))
    }

    /// Keeps it open, so that its inode number is not reused.
    pub fn hold(&mut self, path: &Path) -> Result<()> {
        // For reading: a program file that is open for writing cannot be started.
        self._held = Some(super::open(path)?);
        Ok(())
    }
}

/// Creates the new file `to` from the same blocks as `source`, with these permissions. `None`, and no file, where the file system
/// cannot share blocks between them.
pub fn clone_file(source: &File, to: &Path, mode: u32) -> Result<Option<Made>> {
    if !may_share_blocks(source) {
        return Ok(None);
    }
    step("write", to)?;
    let file = create_new(to)?;
    if share_blocks(source, &file).is_err() {
        super::remove_file(to)?;
        return Ok(None);
    }
    with_mode(&file, to, mode).map(Some)
}

/// Copies the open file `source`, called `name` in errors, to the new file `to`, with these permissions.
///
/// # Errors
/// `source` cannot be read or `to` cannot be written.
pub fn copy_with_mode(source: &mut impl Read, name: &Path, to: &Path, mode: u32) -> Result<Made> {
    step("write", to)?;
    let mut file = create_new(to)?;
    pour(source, name, &mut file, to)?;
    with_mode(&file, to, mode)
}

/// Copies all of `source`, which is called `name`, into `file` at `to`.
pub(super) fn pour(source: &mut impl Read, name: &Path, file: &mut File, to: &Path) -> Result<()> {
    let mut buffer = vec![0; PORTION];
    loop {
        match source.read(&mut buffer) {
            Ok(0) => return Ok(()),
            Ok(count) => file.write_all(&buffer[..count]).map_err(FsError::at("write", to))?,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(FsError::at("read", name)(error)),
        }
    }
}

fn create_new(to: &Path) -> Result<File> {
    OpenOptions::new().write(true).create_new(true).mode(0o600).open(to).map_err(FsError::at("write", to))
}

fn with_mode(file: &File, path: &Path, mode: u32) -> Result<Made> {
    let rights = std::fs::Permissions::from_mode(mode);
    file.set_permissions(rights).map_err(FsError::at("make read-only", path))?;
    let meta = file.metadata().map_err(FsError::at("access", path))?;
    Ok(Made { stat: Stat::of(&meta), created: meta.created().ok(), _held: None })
}

/// False for file systems that are known not to share blocks, so that it is not tried for every file.
#[cfg(target_os = "linux")]
fn may_share_blocks(file: &File) -> bool {
    // ext4, tmpfs, and the overlay of containers, from `linux/magic.h`.
    const NEVER: [i128; 3] = [0xef53, 0x0102_1994, 0x794c_7630];
    rustix::fs::fstatfs(file).is_ok_and(|system| !NEVER.contains(&i128::from(system.f_type)))
}

#[cfg(target_os = "linux")]
fn share_blocks(from: &File, to: &File) -> io::Result<()> {
    Ok(rustix::fs::ioctl_ficlone(to, from)?)
}

#[cfg(not(target_os = "linux"))]
fn may_share_blocks(_: &File) -> bool {
    false
}

#[cfg(not(target_os = "linux"))]
fn share_blocks(_: &File, _: &File) -> io::Result<()> {
    Err(io::ErrorKind::Unsupported.into())
}

/// True where a file can be changed without opening it by this name: it has another hard link, or is open for writing. If the
/// system cannot tell whether it is open, it counts as not open.
pub fn is_in_other_hands(file: &File, path: &Path) -> Result<bool> {
    let meta = file.metadata().map_err(FsError::at("access", path))?;
    Ok(meta.nlink() > 1 || is_open_for_writing(file))
}

/// A lease for reading is given only where nobody has the file open for writing (fcntl(2), "Leases").
#[cfg(target_os = "linux")]
#[allow(unsafe_code)]
fn is_open_for_writing(file: &File) -> bool {
    use std::os::fd::AsRawFd;
    // From `linux/fcntl.h`; the crate leaves it out.
    const F_SETSIG: libc::c_int = 10;
    let descriptor = file.as_raw_fd();
    // If another process opens the file while the lease is held, the kernel sends a signal; SIGURG is ignored, unlike the
    // default.
    // SAFETY: the calls take integers only, and the descriptor is open as long as `file` is borrowed.
    let given = unsafe {
        libc::fcntl(descriptor, F_SETSIG, libc::SIGURG) == 0
            && libc::fcntl(descriptor, libc::F_SETLEASE, libc::F_RDLCK) == 0
    };
    if !given {
        return io::Error::last_os_error().raw_os_error() == Some(libc::EAGAIN);
    }
    // SAFETY: as above.
    unsafe { libc::fcntl(descriptor, libc::F_SETLEASE, libc::F_UNLCK) };
    false
}

#[cfg(not(target_os = "linux"))]
fn is_open_for_writing(_: &File) -> bool {
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(target_os = "linux")]
    fn a_file_is_in_other_hands_while_it_is_open_for_writing_or_has_another_name() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("f");
        let writer = File::create(&path).unwrap();
        let file = File::open(&path).unwrap();
        assert!(is_in_other_hands(&file, &path).unwrap());
        drop(writer);
        let _reader = File::open(&path).unwrap();
        assert!(!is_in_other_hands(&file, &path).unwrap());
        std::fs::hard_link(&path, place.path().join("g")).unwrap();
        assert!(is_in_other_hands(&file, &path).unwrap());
    }
}
