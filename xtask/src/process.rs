//! Running other programs: every command is shown before it starts, and a failure names it.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::error::Error;

/// The project's root folder (the parent of this package's).
pub fn root() -> PathBuf {
    let package = std::env::var_os("CARGO_MANIFEST_DIR").unwrap_or_else(|| env!("CARGO_MANIFEST_DIR").into());
    Path::new(&package).parent().map_or_else(|| PathBuf::from("."), Path::to_path_buf)
}

/// The cargo that runs this command, to be run in the project's root.
pub fn cargo(root: &Path, args: &[&str]) -> Command {
    let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    command.current_dir(root).args(args);
    command
}

/// Shows the command, runs it with this terminal's streams, and waits for it.
///
/// # Errors
/// When it cannot start, or ends with anything but success.
pub fn run(command: &mut Command) -> Result<(), Error> {
    println!("$ {}", shown(command));
    run_quietly(command)
}

/// The same without showing the command.
///
/// # Errors
/// As [`run`].
pub fn run_quietly(command: &mut Command) -> Result<(), Error> {
    let status = command.status().map_err(|source| Error::Start { program: program(command), source })?;
    if status.success() {
        return Ok(());
    }
    Err(Error::Failed { command: short(command), code: status.code() })
}

/// Runs the command without showing it and returns its standard output; `None` when it is missing or fails.
pub fn output(command: &mut Command) -> Option<String> {
    let output = command.stdin(Stdio::null()).stderr(Stdio::null()).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).into_owned())
}

/// The command line as one would type it; an argument of several lines (an inline script) is abridged.
fn shown(command: &Command) -> String {
    let args = command.get_args().map(|arg| {
        let arg = arg.to_string_lossy();
        if arg.contains('\n') { "'...'".to_owned() } else { quoted(&arg) }
    });
    std::iter::once(program(command)).chain(args).collect::<Vec<_>>().join(" ")
}

fn short(command: &Command) -> String {
    let first = command.get_args().next().map(OsStr::to_string_lossy);
    first.map_or_else(|| program(command), |first| format!("{} {first}", program(command)))
}

fn program(command: &Command) -> String {
    let path = Path::new(command.get_program());
    let is_cargo = path.file_stem() == Some(OsStr::new("cargo"));
    if is_cargo { "cargo".to_owned() } else { path.display().to_string() }
}

fn quoted(arg: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "-_=./:,+@%".contains(c);
    if !arg.is_empty() && arg.chars().all(plain) { arg.to_owned() } else { format!("'{arg}'") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shown_command_quotes_what_a_shell_would_split_and_abridges_scripts() {
        let mut command = Command::new("/somewhere/bin/cargo");
        command.args(["run", "a b", "", "import os\nprint()"]);
        assert_eq!(shown(&command), "cargo run 'a b' '' '...'");
    }

    #[test]
    fn a_failing_command_names_itself_and_its_exit_code() {
        let error = run(Command::new("sh").args(["-c", "exit 7"])).unwrap_err();
        assert_eq!(error.to_string(), "`sh -c` ended with exit code 7");
    }

    #[test]
    fn a_program_that_does_not_exist_is_an_error_that_names_it() {
        let error = run(&mut Command::new("no-such-program-here")).unwrap_err();
        assert!(error.to_string().starts_with("cannot start `no-such-program-here`"));
        assert_eq!(output(&mut Command::new("no-such-program-here")), None);
    }
}
