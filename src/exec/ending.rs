//! How a process ended, in words, and whether that is a failure.

use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;

use super::failure::Failure;
use super::runner::Exit;
use super::stage::EXIT_STOPPED;

/// How a process ended; `asked` where this run asked it to stop, `failure` the error that the stage reported.
pub(super) fn exit(status: ExitStatus, asked: bool, failure: Option<String>) -> Result<Exit, Failure> {
    let failed = match (status.code(), status.signal()) {
        (Some(0), _) => return Ok(Exit::Done),
        (Some(code), _) if asked && code == i32::from(EXIT_STOPPED) => return Ok(Exit::Stopped),
        (None, Some(_)) if asked => return Ok(Exit::Stopped),
        (Some(code), _) if code == i32::from(EXIT_STOPPED) => "another process asked it to stop".to_owned(),
        (_, Some(signal)) => format!("it was killed by {}", signal_name(signal)),
        (Some(127), _) if failure.is_none() => {
            "its program could not be loaded: a shared library is missing on this machine, or is another version; see the log"
                .to_owned()
        }
        (Some(101), _) if failure.is_none() => "it panicked; see the log".to_owned(),
        (Some(code), _) => {
            failure.unwrap_or_else(|| format!("it ended with exit code {code} and reported no error"))
        }
        (None, None) => format!("it ended with {status}"),
    };
    Err(Failure::Stage(failed))
}

fn signal_name(signal: i32) -> String {
    let name = match signal {
        1 => "SIGHUP",
        2 => "SIGINT",
        3 => "SIGQUIT",
        4 => "SIGILL (an instruction that this processor does not support)",
        6 => "SIGABRT (it aborted; see the log)",
        7 => "SIGBUS",
        8 => "SIGFPE",
        9 => "SIGKILL (by a user, or by the system when it ran out of memory)",
        11 => "SIGSEGV (invalid memory access)",
        15 => "SIGTERM",
        24 => "SIGXCPU (CPU time limit)",
        25 => "SIGXFSZ (file size limit)",
        _ => return format!("signal {signal}"),
    };
    name.to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_way_a_process_ends_has_a_description() {
        let exit = |raw, asked, failure: Option<&str>| {
            exit(ExitStatus::from_raw(raw), asked, failure.map(str::to_owned))
                .map_err(|failure| failure.to_string())
        };
        assert_eq!(exit(0, false, None), Ok(Exit::Done));
        assert_eq!(exit(0, true, None), Ok(Exit::Done));
        assert_eq!(exit(75 << 8, true, None), Ok(Exit::Stopped));
        assert_eq!(exit(9, true, None), Ok(Exit::Stopped));
        assert_eq!(exit(1 << 8, true, Some("no")), Err("no".to_owned()));
        let reported_nothing = "it ended with exit code 7 and reported no error".to_owned();
        assert_eq!(exit(7 << 8, false, None), Err(reported_nothing));
        let text = exit(127 << 8, false, None).unwrap_err();
        assert!(text.contains("shared library"), "{text}");
        let text = exit(9, false, None).unwrap_err();
        assert!(text.contains("SIGKILL") && text.contains("memory"), "{text}");
        assert!(exit(75 << 8, false, None).is_err());
    }
}
