//! The shell for a command's `shell` script: it also stops at a failure inside a pipe.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Command as Process;
use std::sync::OnceLock;

use crate::fsx;

/// Linux limits an argument to 128 KiB (`MAX_ARG_STRLEN`); a longer script is run from a file.
const LONGEST_ARGUMENT: usize = 100 * 1024;

/// Prefix for a plain `sh`: some do not support the option.
const PIPEFAIL: &str = "if (set -o pipefail) 2>/dev/null; then set -o pipefail; fi; ";

/// The program that runs `text`. A text that is too long for an argument is put into the file `script`.
pub(super) fn process(text: &str, path: Option<&OsStr>, script: &Path) -> fsx::Result<Process> {
    // A shell that starts twice as fast is enough where there is no pipe to look into.
    let bash = if has_pipe(text) { bash(path) } else { None };
    let (mut process, text) = match bash {
        Some(bash) => {
            let mut process = Process::new(bash);
            process.args(["-euo", "pipefail"]);
            (process, text.to_owned())
        }
        None => {
            let mut process = Process::new("/bin/sh");
            process.arg("-eu");
            let before = if has_pipe(text) { PIPEFAIL } else { "" };
            (process, format!("{before}{text}"))
        }
    };
    if text.len() > LONGEST_ARGUMENT {
        fsx::write(script, text.as_bytes())?;
        process.arg(script);
    } else {
        process.arg("-c").arg(text);
    }
    Ok(process)
}

/// True where there may be a pipe in a text; a `|` that means something else costs nothing but a slower start.
fn has_pipe(text: &str) -> bool {
    text.replace("||", "").contains('|')
}

/// Where bash is: on the command's own PATH where it has one, else on that of the run; looked for once for the latter.
fn bash(path: Option<&OsStr>) -> Option<PathBuf> {
    static USUAL: OnceLock<Option<PathBuf>> = OnceLock::new();
    match path {
        Some(path) => find(path),
        None => USUAL.get_or_init(|| find(&std::env::var_os("PATH").unwrap_or_default())).clone(),
    }
}

fn find(path: &OsStr) -> Option<PathBuf> {
    let usual = ["/bin", "/usr/bin", "/usr/local/bin"].map(PathBuf::from);
    let folders = std::env::split_paths(path).filter(|folder| folder.is_absolute()).chain(usual);
    folders
        .map(|folder| folder.join("bash"))
        .find(|bash| matches!(fsx::outside(bash), Ok(fsx::Outside::File(stat)) if stat.executable))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plain_shell_runs_the_text_as_well_and_knows_the_failure_in_a_pipe_where_it_can() {
        let text = format!("{PIPEFAIL}echo a | cat\nexit 3");
        let output = Process::new("/bin/sh").args(["-euc", &text]).output().unwrap();
        assert_eq!((output.status.code(), output.stdout.as_slice()), (Some(3), b"a\n".as_slice()));
    }

    #[test]
    fn a_script_with_a_pipe_is_distinguished_from_one_without() {
        assert!(has_pipe("a | b") && has_pipe("a|b || c") && has_pipe("x=$(a|b)"));
        assert!(!has_pipe("a || b; c && d"));
    }

    #[test]
    fn a_text_that_is_too_long_for_an_argument_is_run_from_a_file() {
        let place = tempfile::tempdir().unwrap();
        let script = place.path().join("script");
        let text = format!(": {}\necho done", "x".repeat(300_000));
        let output = process(&text, None, &script).unwrap().output().unwrap();
        assert_eq!(output.stdout, b"done\n");
        assert!(script.is_file());
    }
}
