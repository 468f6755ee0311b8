//! Installs libtorch into `.libtorch`: pip fetches hash-pinned wheels, the needed files are taken out of them, and one
//! rename makes them visible. Until then everything is in `.libtorch.partial-<pid>`, so a crash at any moment leaves
//! nothing that looks finished; the next run removes what it left.

use std::fs::{self, File, TryLockError};
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::error::Error;
use crate::{host, process, wheels};

const PARTIAL: &str = ".libtorch.partial-";
const UNPACK: &str = include_str!("unpack.py");

/// torch-sys links with `-ltorch`. The wheel's real `libtorch.so` is an empty shell that pulls in the CUDA libraries;
/// a linker script with that name refers to the two libraries that contain the code.
const LINKER_SCRIPT: &str = "INPUT(-ltorch_cpu -lc10)";

/// Installs libtorch into `target` unless it is there already.
///
/// # Errors
/// When the host lacks something, pip fails, or the disk does.
pub fn ensure(root: &Path, target: &Path) -> Result<(), Error> {
    let _lock = lock(root)?;
    remove_remains(root)?;
    if is_complete(target) {
        return Ok(());
    }
    host::check(root)?;
    let partial = Partial::new(root)?;
    fetch(&partial.0)?;
    assemble(&partial.0)?;
    publish(&partial.0, target)
}

/// Waits until no other installation works in `root`: two at once would take each other's folders for remains.
/// Where the file system knows no locks, going on without one is better than giving up.
fn lock(root: &Path) -> Result<File, Error> {
    let folder = File::open(root).map_err(Error::io("open", root))?;
    if let Err(TryLockError::WouldBlock) = folder.try_lock() {
        println!("libtorch {}: waiting for another installation to end", wheels::VERSION);
        let _ = folder.lock();
    }
    Ok(folder)
}

/// Whether `folder` holds the right version and every file that an installation writes (headers: one of them).
fn is_complete(folder: &Path) -> bool {
    let version = fs::read_to_string(folder.join("build-version")).unwrap_or_default();
    let is_there = |(_, destination): &(&str, &str)| match destination.strip_suffix('/') {
        Some(directory) => folder.join(directory).join("torch/csrc/api/include/torch/torch.h").is_file(),
        None => folder.join(destination).is_file(),
    };
    wheels::is_right_version(&version)
        && folder.join("lib/libtorch.so").is_file()
        && wheels::WHEELS.iter().flat_map(|wheel| wheel.members).all(is_there)
}

/// The working folder of one installation; removed when it ends, well or badly.
struct Partial(PathBuf);

impl Partial {
    fn new(root: &Path) -> Result<Self, Error> {
        let folder = root.join(format!("{PARTIAL}{}", std::process::id()));
        for part in ["wheels", "tmp", "libtorch/lib"] {
            let path = folder.join(part);
            fs::create_dir_all(&path).map_err(Error::io("create", &path))?;
        }
        Ok(Self(folder))
    }
}

impl Drop for Partial {
    fn drop(&mut self) {
        // If this fails, the next run tries again.
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn remove_remains(root: &Path) -> Result<(), Error> {
    for entry in fs::read_dir(root).map_err(Error::io("read", root))?.flatten() {
        if entry.file_name().to_string_lossy().starts_with(PARTIAL) {
            fs::remove_dir_all(entry.path()).map_err(Error::io("remove", entry.path()))?;
        }
    }
    Ok(())
}

/// Downloads the wheels. pip's own settings (index, proxy, certificates) apply, from its files and its variables.
fn fetch(partial: &Path) -> Result<(), Error> {
    let requirements = partial.join("requirements.txt");
    fs::write(&requirements, wheels::requirements()).map_err(Error::io("write", &requirements))?;
    println!("libtorch {}: fetching three Python wheels (540 MB) with pip", wheels::VERSION);
    let mut pip = Command::new("python3");
    pip.args(["-m", "pip", "download", "--no-cache-dir"]).args(wheels::SELECTION);
    pip.arg("--requirement").arg(&requirements).arg("--dest").arg(partial.join("wheels"));
    pip.env("TMPDIR", partial.join("tmp"));
    process::run(&mut pip).map_err(|error| match error {
        Error::Failed { .. } => Error::Libtorch {
            problem: "pip could not fetch the wheels; its own message is above".to_owned(),
            remedy: "pip's settings (index, proxy, certificates) decide where it looks; without a network, put the \
                     path of a libtorch 2.13.0 into LIBTORCH"
                .to_owned(),
        },
        other => other,
    })
}

fn assemble(partial: &Path) -> Result<(), Error> {
    println!("libtorch {}: unpacking", wheels::VERSION);
    let folder = partial.join("libtorch");
    let mut python = Command::new("python3");
    python.args(["-c", UNPACK]).arg(partial.join("wheels")).arg(&folder).args(wheels::members());
    process::run_quietly(&mut python)?;
    for (name, text) in [("lib/libtorch.so", LINKER_SCRIPT), ("build-version", wheels::VERSION)] {
        let path = folder.join(name);
        fs::write(&path, format!("{text}\n")).map_err(Error::io("write", &path))?;
    }
    Ok(())
}

/// Puts the finished folder in its place; an unusable old one is removed with the working folder.
fn publish(partial: &Path, target: &Path) -> Result<(), Error> {
    if target.symlink_metadata().is_ok() {
        fs::rename(target, partial.join("old")).map_err(Error::io("move away", target))?;
    }
    fs::rename(partial.join("libtorch"), target).map_err(Error::io("create", target))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scratch(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("dril-install-{}-{name}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).unwrap();
        folder
    }

    fn pretend(folder: &Path) {
        let header = folder.join("include/torch/csrc/api/include/torch/torch.h");
        fs::create_dir_all(header.parent().unwrap()).unwrap();
        fs::create_dir_all(folder.join("lib")).unwrap();
        fs::write(header, "").unwrap();
        fs::write(folder.join("lib/libtorch.so"), LINKER_SCRIPT).unwrap();
        for (_, destination) in wheels::WHEELS.iter().flat_map(|wheel| wheel.members) {
            if !destination.ends_with('/') {
                fs::write(folder.join(destination), "").unwrap();
            }
        }
        fs::write(folder.join("build-version"), wheels::VERSION).unwrap();
    }

    #[test]
    fn a_folder_is_complete_only_with_every_file_and_the_right_version() {
        let root = scratch("complete");
        let folder = root.join("lt");
        assert!(!is_complete(&folder));
        pretend(&folder);
        assert!(is_complete(&folder));
        fs::remove_file(folder.join("lib/libgomp.so.1")).unwrap();
        assert!(!is_complete(&folder));
        pretend(&folder);
        fs::write(folder.join("build-version"), "2.12.0").unwrap();
        assert!(!is_complete(&folder));
        fs::remove_dir_all(&root).unwrap();
    }

    #[test]
    fn a_complete_folder_needs_no_python_and_no_network_and_remains_are_removed() {
        let root = scratch("remains");
        pretend(&root.join(".libtorch"));
        fs::create_dir_all(root.join(".libtorch.partial-1/wheels")).unwrap();
        ensure(&root, &root.join(".libtorch")).unwrap();
        assert!(!root.join(".libtorch.partial-1").exists());
        assert!(is_complete(&root.join(".libtorch")));
        fs::remove_dir_all(&root).unwrap();
    }

    #[test]
    fn publishing_replaces_an_unusable_folder_and_leaves_nothing_behind() {
        let root = scratch("publish");
        let target = root.join(".libtorch");
        fs::create_dir_all(&target).unwrap();
        fs::write(target.join("build-version"), "2.12.0").unwrap();
        let partial = Partial::new(&root).unwrap();
        pretend(&partial.0.join("libtorch"));
        publish(&partial.0, &target).unwrap();
        drop(partial);
        assert!(is_complete(&target));
        assert_eq!(fs::read_dir(&root).unwrap().count(), 1);
        fs::remove_dir_all(&root).unwrap();
    }
}
