//! `dril-pipe schema`, `completions` and `man`: support for editors, shells and `man`.

use std::process::ExitCode;

use dril_stage_api::Registry;

use crate::cli::Extensions;
use crate::cli::args::{CompletionsArgs, ManArgs, shell};
use crate::cli::terminal::{count, print, shown};
use crate::error::{Error, ErrorKind};
use crate::{fsx, spec};

/// The JSON Schema of pipeline files.
pub(in crate::cli) fn schema(registry: &Registry) -> Result<ExitCode, Error> {
    print(&format!("{:#}\n", spec::schema(registry)))?;
    Ok(ExitCode::SUCCESS)
}

pub(in crate::cli) fn completions(
    args: &CompletionsArgs,
    extensions: &Extensions<'_>,
) -> Result<ExitCode, Error> {
    print(&String::from_utf8_lossy(&shell::completions(args.shell, extensions)))?;
    Ok(ExitCode::SUCCESS)
}

pub(in crate::cli) fn man(args: &ManArgs, extensions: &Extensions<'_>) -> Result<ExitCode, Error> {
    let pages = shell::pages(extensions)
        .map_err(|error| Error::new(ErrorKind::Io, format!("cannot generate the man pages: {error}")))?;
    match (&args.out, pages.first()) {
        (Some(folder), _) => {
            fsx::create_dir_all(folder)?;
            for (name, text) in &pages {
                fsx::write_atomic(&folder.join(name), text)?;
            }
            print(&format!("{} in {}\n", count(pages.len(), "page"), shown(folder)))?;
        }
        (None, Some((_, text))) => print(&String::from_utf8_lossy(text))?,
        (None, None) => {}
    }
    Ok(ExitCode::SUCCESS)
}
