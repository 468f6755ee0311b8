//! Explains why a program could not be started. The system's own errors mislead: a script whose interpreter is missing "does
//! not exist", and a command line that is too long is blamed on the program.

use std::io::{self, Read};
use std::path::PathBuf;
use std::process::Command;

use crate::fsx;

/// Why `process` could not be started, and what to do.
pub(super) fn reason(process: &Command, error: &io::Error) -> String {
    let program = process.get_program().to_string_lossy();
    let why = match error.kind() {
        io::ErrorKind::ArgumentListTooLong => {
            let bytes: usize = process.get_args().map(|word| word.len() + 1).sum();
            return format!(
                "cannot start `{program}`: its command line is too long for this system ({bytes} bytes): let the program \
                 read the list of its inputs from `inputs.json` (see the variable DRIL_INPUTS), or pass the folder that \
                 contains them"
            );
        }
        io::ErrorKind::NotFound => match interpreter(process) {
            Some(said) => said,
            None => "is it installed and on the PATH?".to_owned(),
        },
        io::ErrorKind::PermissionDenied => {
            "it is not executable: use `chmod +x` where it is created, or call its interpreter, as in `[python3, \
             \"{inputs.script}\"]`"
                .to_owned()
        }
        // "Exec format error"
        _ if error.raw_os_error() == Some(libc::ENOEXEC) => {
            "it is not an executable for this system; a script needs `#!` and its interpreter in the first line".to_owned()
        }
        _ => "can this system run it?".to_owned(),
    };
    format!("cannot start `{program}`: {error}; {why}")
}

/// Why a script that exists is still "not found".
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
        return Some("the file exists, but its loader does not: was it built for another system?".to_owned());
    };
    let line = line.split(|byte| *byte == b'\n').next().unwrap_or_default();
    let line = String::from_utf8_lossy(line);
    let name = line.trim_start().split([' ', '\t']).next().unwrap_or_default();
    Some(match name.strip_suffix('\r').or(line.ends_with('\r').then_some(name)) {
        Some(name) => format!(
            "its first line names the interpreter `{name}` with a carriage return (a Windows line end): save the script with \
             Unix line ends (`dos2unix` does that)"
        ),
        None => format!("its first line names the interpreter `{name}`, which does not exist"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_script_without_interpreter_is_distinguished_from_a_missing_one() {
        let place = tempfile::tempdir().unwrap();
        for (text, expected) in [
            ("#!/bin/sh\r\necho\r\n", "`/bin/sh` with a carriage return"),
            ("#!/usr/bin/env python3\r\n", "`/usr/bin/env` with a carriage return"),
            ("#! /no/such/shell -e\n", "`/no/such/shell`, which does not exist"),
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
    fn an_error_about_a_long_command_line_names_the_alternative() {
        let mut process = Command::new("/bin/true");
        let error = process.arg("x".repeat(300_000)).status().unwrap_err();
        let said = reason(&process, &error);
        assert!(said.contains("too long") && said.contains("inputs.json"), "{said}");
    }
}
