//! What the host must provide before half a gigabyte is downloaded: platform, Python with pip, a C++ compiler, room.

use std::path::Path;
use std::process::Command;

use crate::error::Error;
use crate::process;

/// Peak use while installing: the wheels and, at different times, pip's temporary copy or the unpacked files.
const NEEDED_BYTES: u64 = 1_200_000_000;

/// pip accepts several `--platform` options since this version.
const OLDEST_PIP: (u32, u32) = (20, 3);

/// Prints pip's version and the bytes that are free in the folder given as argument, a line each.
const PROBE: &str = "import shutil, sys
try:
    import pip
    print(pip.__version__)
except ImportError:
    print('none')
print(shutil.disk_usage(sys.argv[1]).free)
";

/// Checks all of it.
///
/// # Errors
/// [`Error::Host`] with what to install or free.
pub fn check(root: &Path) -> Result<(), Error> {
    check_platform(std::env::consts::OS, std::env::consts::ARCH)?;
    check_compiler()?;
    let probe = process::output(Command::new("python3").args(["-c", PROBE]).arg(root)).ok_or_else(|| {
        host(
            "no working `python3` on the PATH",
            "install Python 3 with pip (packages `python3` and `python3-pip`)",
        )
    })?;
    let mut lines = probe.lines();
    check_pip(lines.next().unwrap_or_default())?;
    check_room(lines.next().and_then(|bytes| bytes.parse().ok()), root)
}

fn check_platform(os: &str, arch: &str) -> Result<(), Error> {
    if (os, arch) == ("linux", "x86_64") {
        return Ok(());
    }
    Err(host(
        &format!("`cargo xtask libtorch` knows x86-64 Linux only, and this is {arch} {os}"),
        "put the path of a libtorch 2.13.0 for this platform (a folder with lib/ and include/) into LIBTORCH, \
         or `pip install torch==2.13.0` and set LIBTORCH_USE_PYTORCH=1",
    ))
}

fn check_compiler() -> Result<(), Error> {
    // The same choice as the `cc` crate makes when torch-sys is built.
    let compiler = std::env::var("CXX").unwrap_or_else(|_| "c++".to_owned());
    let mut words = compiler.split_whitespace();
    let program = words.next().unwrap_or("c++");
    if process::output(Command::new(program).args(words).arg("--version")).is_some() {
        return Ok(());
    }
    Err(host(
        &format!("no working C++ compiler: `{compiler} --version` failed"),
        "install one (package `g++` or `gcc-c++`), or name yours in CXX; the bindings to libtorch are C++",
    ))
}

fn check_pip(version: &str) -> Result<(), Error> {
    let mut numbers = version.split('.').map_while(|part| part.parse::<u32>().ok());
    let remedy = "install pip for python3 (package `python3-pip`) or `python3 -m pip install --upgrade pip`";
    match (numbers.next(), numbers.next()) {
        (Some(major), minor) if (major, minor.unwrap_or(0)) >= OLDEST_PIP => Ok(()),
        (Some(_), _) => Err(host(&format!("pip {version} is too old, expected 20.3 or newer"), remedy)),
        (None, _) => Err(host("`python3` has no pip", remedy)),
    }
}

fn check_room(free: Option<u64>, root: &Path) -> Result<(), Error> {
    match free {
        Some(free) if free < NEEDED_BYTES => Err(host(
            &format!(
                "installing libtorch needs {} MB, and `{}` has {} MB free",
                NEEDED_BYTES / 1_000_000,
                root.display(),
                free / 1_000_000
            ),
            "free some disk space; 490 MB of it stay in use",
        )),
        _ => Ok(()),
    }
}

fn host(problem: &str, remedy: &str) -> Error {
    Error::Host { problem: problem.to_owned(), remedy: remedy.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_platforms_get_a_hint_about_libtorch_in_the_environment() {
        assert!(check_platform("linux", "x86_64").is_ok());
        for (os, arch) in [("macos", "aarch64"), ("linux", "aarch64"), ("windows", "x86_64")] {
            let error = check_platform(os, arch).unwrap_err();
            assert!(error.to_string().contains(arch) && error.hints()[0].contains("LIBTORCH"));
        }
    }

    #[test]
    fn pip_must_be_there_and_know_several_platforms() {
        assert!(check_pip("23.2.1").is_ok() && check_pip("20.3").is_ok() && check_pip("26.0.dev1").is_ok());
        assert!(check_pip("20.2.4").unwrap_err().to_string().contains("too old"));
        assert!(check_pip("none").unwrap_err().to_string().contains("no pip"));
    }

    #[test]
    fn too_little_room_is_refused_and_unknown_room_is_not() {
        assert!(check_room(Some(NEEDED_BYTES), Path::new(".")).is_ok());
        assert!(check_room(None, Path::new(".")).is_ok());
        let error = check_room(Some(1_000_000), Path::new(".")).unwrap_err();
        assert!(error.to_string().contains("1 MB free"));
    }
}
