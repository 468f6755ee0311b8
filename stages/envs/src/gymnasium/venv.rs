//! The Python for Gymnasium: a virtual environment with pinned packages, created when it is first needed, or a Python
//! named by the user.

use std::ffi::OsString;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::OnceLock;

use super::GymnasiumError;

/// The packages with their dependencies, one per line, with exact versions.
pub(super) const REQUIREMENTS: &str = include_str!("requirements.txt");
/// The Python that creates the virtual environment.
const PYTHON: &str = "python3";
/// The oldest supported Python, as text and as numbers.
const OLDEST: (&str, (u32, u32)) = ("3.11", (3, 11));
/// Lines of pip's output that an error shows.
const LINES: usize = 15;

/// Where the Python packages are.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PythonHome {
    /// The folder for virtual environments.
    pub folder: PathBuf,
    /// A Python that already has the packages; then nothing is installed.
    pub python: Option<PathBuf>,
}

/// The environment variable that names the folder for virtual environments.
const FOLDER_VARIABLE: &str = "DRIL_PIPE_VENVS";
/// The environment variable that names a Python with the packages.
const PYTHON_VARIABLE: &str = "DRIL_PIPE_PYTHON";

impl PythonHome {
    /// The home that the environment names: `DRIL_PIPE_PYTHON`, and `DRIL_PIPE_VENVS` or else the user's cache folder as in the
    /// XDG base directory specification.
    pub fn from_environment() -> Self {
        Self::from_variables(|name| std::env::var_os(name))
    }

    fn from_variables(variable: impl Fn(&str) -> Option<OsString>) -> Self {
        let variable = |name: &str| variable(name).filter(|value| !value.is_empty()).map(PathBuf::from);
        let cache = || variable("XDG_CACHE_HOME").or_else(|| Some(variable("HOME")?.join(".cache")));
        let default = || cache().unwrap_or_else(std::env::temp_dir).join("dril-pipe");
        let folder = variable(FOLDER_VARIABLE).unwrap_or_else(default);
        Self { folder, python: variable(PYTHON_VARIABLE) }
    }
}

static HOME: OnceLock<PythonHome> = OnceLock::new();

/// Sets where the Python packages are. A program calls it once, before it builds an environment; only the first call has
/// an effect. The location changes no result: a worker with other versions is rejected.
pub fn keep_python_in(home: PythonHome) {
    let _ = HOME.set(home);
}

/// The Python with the packages; installs them if they are missing.
///
/// # Errors
/// There is no Python, or the packages cannot be installed; the message lists the commands to run.
pub fn python() -> Result<PathBuf, GymnasiumError> {
    let home = HOME.get().ok_or(GymnasiumError::NoFolder)?;
    match &home.python {
        Some(python) => Ok(python.clone()),
        None => ready(&home.folder, PYTHON),
    }
}

/// The virtual environment in `folder` for these requirements, created by `python` if it is missing.
fn ready(folder: &Path, python: &str) -> Result<PathBuf, GymnasiumError> {
    let digest = blake3::hash(REQUIREMENTS.as_bytes()).to_hex();
    let target = folder.join(format!("gymnasium-{}", &digest[..12]));
    let program = target.join("bin/python");
    if program.exists() {
        return Ok(program);
    }
    let partial = folder.join(format!("gymnasium-{}.partial", &digest[..12]));
    let by_hand = || commands(&target, python);
    let failed = |message: String| GymnasiumError::Install { message, commands: by_hand() };
    check_version(python)?;
    let io = |doing: &str, path: &Path, error: std::io::Error| {
        failed(format!("cannot {doing} `{}`: {error}", path.display()))
    };
    fs::create_dir_all(folder).map_err(|error| io("create", folder, error))?;
    // Several stages may need it at once: one creates it, the others wait. The lock is released with its process.
    let lock = target.with_extension("lock");
    let held = File::create(&lock).and_then(|file| file.lock().map(|()| file));
    let _held = held.map_err(|error| io("lock", &lock, error))?;
    if program.exists() {
        return Ok(program);
    }
    if partial.exists() {
        fs::remove_dir_all(&partial).map_err(|error| io("remove", &partial, error))?;
    }
    install(&partial, python).map_err(failed)?;
    fs::rename(&partial, &target).map_err(|error| io("rename", &partial, error))?;
    Ok(program)
}

fn check_version(python: &str) -> Result<(), GymnasiumError> {
    let wrong = |seen: String| GymnasiumError::NoPython {
        seen,
        expected: OLDEST.0,
        packages: REQUIREMENTS.split_whitespace().collect::<Vec<_>>().join(" "),
    };
    let ask = ["-c", "import sys; print(*sys.version_info[:2])"];
    let output = Command::new(python).args(ask).stdin(Stdio::null()).output();
    let output = output.map_err(|error| wrong(format!("`{python}` cannot be started ({error})")))?;
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let numbers: Vec<u32> = text.split_whitespace().filter_map(|word| word.parse().ok()).collect();
    match numbers[..] {
        [major, minor] if (major, minor) >= OLDEST.1 => Ok(()),
        [major, minor] => Err(wrong(format!("`{python}` is Python {major}.{minor}"))),
        _ => Err(wrong(format!("`{python}` did not report its version"))),
    }
}

/// Creates a virtual environment with the packages. It is created without pip, which some systems cannot install; the pip
/// of `python` is used instead.
fn install(folder: &Path, python: &str) -> Result<(), String> {
    run(Command::new(python).args(["-m", "venv", "--without-pip"]).arg(folder))?;
    let requirements = folder.join("requirements.txt");
    fs::write(&requirements, REQUIREMENTS)
        .map_err(|error| format!("cannot write `{}`: {error}", requirements.display()))?;
    let mut pip = Command::new(python);
    pip.args(["-m", "pip", "--python"]).arg(folder.join("bin/python"));
    pip.args(PIP).arg("--requirement").arg(&requirements);
    run(&mut pip)
}

/// All packages are listed with their versions, and nothing is built from source.
const PIP: [&str; 6] =
    ["install", "--no-input", "--no-deps", "--only-binary=:all:", "--quiet", "--disable-pip-version-check"];

fn run(command: &mut Command) -> Result<(), String> {
    let shown = |command: &Command| {
        let words = std::iter::once(command.get_program()).chain(command.get_args());
        words.map(|word| word.to_string_lossy().into_owned()).collect::<Vec<_>>().join(" ")
    };
    match command.stdin(Stdio::null()).output() {
        Ok(output) if output.status.success() => Ok(()),
        Ok(output) => {
            Err(format!("`{}` failed ({}):\n{}", shown(command), output.status, last_lines(&output)))
        }
        Err(error) => Err(format!("`{}` cannot be started: {error}", shown(command))),
    }
}

fn last_lines(output: &Output) -> String {
    let text = [output.stdout.as_slice(), &output.stderr].concat();
    let text = String::from_utf8_lossy(&text);
    let lines: Vec<&str> = text.lines().filter(|line| !line.trim().is_empty()).collect();
    lines[lines.len().saturating_sub(LINES)..].join("\n")
}

/// The commands that create it by hand.
fn commands(target: &Path, python: &str) -> String {
    let target = target.display();
    let packages = REQUIREMENTS.split_whitespace().collect::<Vec<_>>().join(" ");
    format!(
        "  {python} -m venv {target}\n  {target}/bin/python -m pip install {packages}\n\
         or put the path of a Python that has these packages into DRIL_PIPE_PYTHON"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_package_has_an_exact_version() {
        for line in REQUIREMENTS.lines() {
            let (name, version) = line.split_once("==").unwrap_or_else(|| panic!("{line}"));
            assert!(!name.is_empty() && version.chars().all(|c| c.is_ascii_digit() || c == '.'), "{line}");
        }
    }

    #[test]
    fn a_missing_python_is_an_error_that_says_what_to_do() {
        let folder = tempfile::tempdir().unwrap();
        let error = ready(folder.path(), "no-such-python").unwrap_err().to_string();
        for words in
            ["`no-such-python` cannot be started", "expected Python 3.11", "DRIL_PIPE_PYTHON", "gymnasium=="]
        {
            assert!(error.contains(words), "{error}");
        }
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "nothing is left behind");
    }

    /// A Python that says it is new enough, and of which nothing else works.
    fn broken_python(folder: &Path) -> String {
        use std::os::unix::fs::PermissionsExt;
        let path = folder.join("python");
        fs::write(&path, "#!/bin/sh\ncase $1 in -c) echo 3 12;; *) echo no network >&2; exit 3;; esac\n")
            .unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
        path.to_string_lossy().into_owned()
    }

    #[test]
    fn an_installation_that_fails_says_why_and_what_to_type_and_is_tried_again() {
        let folder = tempfile::tempdir().unwrap();
        let python = broken_python(folder.path());
        for _ in 0..2 {
            let error = ready(&folder.path().join("venvs"), &python).unwrap_err().to_string();
            for words in ["no network", "exit status: 3", "-m venv", "-m pip install ale-py=="] {
                assert!(error.contains(words), "{error}");
            }
        }
    }

    #[test]
    fn an_old_python_is_refused_with_its_version() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("python");
        fs::write(&path, "#!/bin/sh\necho 3 8\n").unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
        let error = ready(folder.path(), &path.to_string_lossy()).unwrap_err().to_string();
        assert!(error.contains("is Python 3.8, expected Python 3.11"), "{error}");
    }

    #[test]
    fn the_named_folder_wins_then_the_cache_then_home() {
        let with = |names: &[(&str, &str)]| {
            let names: Vec<(String, String)> =
                names.iter().map(|(name, value)| ((*name).to_owned(), (*value).to_owned())).collect();
            let find = |name: &str| {
                names.iter().find(|(other, _)| other == name).map(|(_, value)| OsString::from(value))
            };
            PythonHome::from_variables(find).folder
        };
        let all = [(FOLDER_VARIABLE, "/v"), ("XDG_CACHE_HOME", "/c"), ("HOME", "/h")];
        assert_eq!(with(&all), PathBuf::from("/v"));
        assert_eq!(with(&all[1..]), PathBuf::from("/c/dril-pipe"));
        assert_eq!(with(&all[2..]), PathBuf::from("/h/.cache/dril-pipe"));
        assert!(with(&[]).ends_with("dril-pipe"));
    }
}
