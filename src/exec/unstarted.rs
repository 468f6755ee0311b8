//! Why a program could not be started. The system's own answers mislead: a script whose interpreter is missing "does not
//! exist", and a command line that is too long is blamed on the program.

use std::io::{self, Read};
use std::path::PathBuf;
use std::process::Command;

use crate::fsx;

/// Says why `process` could not be started, and what to do.
pub(super) fn reason(process: &Command, error: &io::Error) -> String {
    let program = process.get_program().to_string_lossy();
    let why = match error.kind() {
        io::ErrorKind::ArgumentListTooLong => {
            let bytes: usize = process.get_args().map(|word| word.len() + 1).sum();
            return format!(
                "cannot start `{program}`: its command line is too long for this system ({bytes} bytes): have the program \
                 read the list of its inputs in `inputs.json` (the variable DRIL_INPUTS names it), or name the folder that \
                 they lie in"
            );
        }
        io::ErrorKind::NotFound => match interpreter(process) {
            Some(said) => said,
            None => "is it installed, and on the PATH?".to_owned(),
        },
        io::ErrorKind::PermissionDenied => {
            "it may not be executed: `chmod +x` it where it is made, or run it by its interpreter, as in `[python3, \
             \"{inputs.script}\"]`"
                .to_owned()
        }
        // "Exec format error"
        _ if error.raw_os_error() == Some(libc::ENOEXEC) => {
            "it is no program of this system; a script has `#!` and its interpreter in its first line".to_owned()
        }
        _ => "is it a program that this system can run?".to_owned(),
    };
    format!("cannot start `{program}`: {error}; {why}")
}

/// What is wrong with a script that is there, and still "not found".
fn interpreter(process: &Command) -> Option<String> {
    let path = PathBuf::from(process.get_program());
    let path = match process.get_current_dir() {
        Some(folder) if path.components().count() > 1 => folder.join(path),
        _ if path.is_absolute() => path,
        _ => return None,
    };
    let mut start = [0; 256];
    let count = fsx::open(&path).ok()?.read(&mut start).ok()?;
    let Some(line) = start[..count].strip_prefix(b"#!") else {
        return Some(
            "the file is there, but what it needs to be loaded is not: was it built for another system?"
                .to_owned(),
        );
    };
    let line = line.split(|byte| *byte == b'\n').next().unwrap_or_default();
    let line = String::from_utf8_lossy(line);
    let name = line.trim_start().split([' ', '\t']).next().unwrap_or_default();
    Some(match name.strip_suffix('\r').or(line.ends_with('\r').then_some(name)) {
        Some(name) => format!(
            "its first line names the interpreter `{name}` with a carriage return behind it, a line end of Windows: save the \
             script with Unix line ends (CRLF to LF, as `dos2unix` does)"
        ),
        None => format!("its first line names the interpreter `{name}`, which is not there"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_script_that_cannot_start_is_told_from_one_that_is_missing() {
        let place = tempfile::tempdir().unwrap();
        for (text, expected) in [
            ("#!/bin/sh\r\necho\r\n", "`/bin/sh` with a carriage return"),
            ("#!/usr/bin/env python3\r\n", "`/usr/bin/env` with a carriage return"),
            ("#! /no/such/shell -e\n", "`/no/such/shell`, which is not there"),
        ] {
            let script = place.path().join("script");
            std::fs::write(&script, text).unwrap();
            let mut rights = std::fs::metadata(&script).unwrap().permissions();
            std::os::unix::fs::PermissionsExt::set_mode(&mut rights, 0o755);
            std::fs::set_permissions(&script, rights).unwrap();
            let process = Command::new(&script);
            let said = reason(&process, &io::Error::from(io::ErrorKind::NotFound));
            assert!(said.contains(expected), "{said}");
        }
        let said = reason(&Command::new("no-such-program"), &io::Error::from(io::ErrorKind::NotFound));
        assert!(said.contains("is it installed"), "{said}");
    }

    #[test]
    fn a_command_line_that_is_too_long_says_what_to_use_instead() {
        let mut process = Command::new("/bin/true");
        let error = process.arg("x".repeat(300_000)).status().unwrap_err();
        let said = reason(&process, &error);
        assert!(said.contains("too long") && said.contains("inputs.json"), "{said}");
    }
}
