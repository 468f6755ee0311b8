//! Shell completions and man pages, generated from the definition of the command line, so that they are always up to date.

use std::io;

use clap::{Args, Command, ValueEnum};
use clap_complete::Shell;

use crate::cli::Extensions;

#[derive(Debug, Args)]
pub(in crate::cli) struct CompletionsArgs {
    /// The shell
    #[arg(value_enum)]
    pub shell: ShellName,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(in crate::cli) enum ShellName {
    Bash,
    Elvish,
    Fish,
    #[value(name = "powershell")]
    PowerShell,
    Zsh,
}

impl From<ShellName> for Shell {
    fn from(name: ShellName) -> Self {
        match name {
            ShellName::Bash => Self::Bash,
            ShellName::Elvish => Self::Elvish,
            ShellName::Fish => Self::Fish,
            ShellName::PowerShell => Self::PowerShell,
            ShellName::Zsh => Self::Zsh,
        }
    }
}

#[derive(Debug, Args)]
pub(in crate::cli) struct ManArgs {
    /// Write the man pages of all commands to this folder [default: print the page of the program]
    #[arg(short, long, value_name = "DIR")]
    pub out: Option<std::path::PathBuf>,
}

/// The completion script for a shell.
pub(in crate::cli) fn completions(shell: ShellName, extensions: &Extensions<'_>) -> Vec<u8> {
    let mut script = Vec::new();
    clap_complete::generate(
        Shell::from(shell),
        &mut super::command(extensions, false),
        "dril-pipe",
        &mut script,
    );
    match (shell, String::from_utf8(script)) {
        // clap_complete 4.6 gives the cases of a program whose name has a `-` another name than its loop looks for, so that
        // nothing is completed after the first word (github.com/clap-rs/clap/issues/6421).
        (ShellName::Bash, Ok(text)) => text.replace("dril__subcmd__pipe", "dril__pipe").into_bytes(),
        (_, Ok(text)) => text.into_bytes(),
        (_, Err(error)) => error.into_bytes(),
    }
}

/// The man pages with their file names, the program's first.
///
/// # Errors
/// A page cannot be rendered.
pub(in crate::cli) fn pages(extensions: &Extensions<'_>) -> io::Result<Vec<(String, Vec<u8>)>> {
    let mut command = super::command(extensions, false).disable_help_subcommand(true);
    command.build();
    let mut all = Vec::new();
    page(&command, &mut all)?;
    Ok(all)
}

fn page(command: &Command, all: &mut Vec<(String, Vec<u8>)>) -> io::Result<()> {
    let man = clap_mangen::Man::new(command.clone());
    let mut text = Vec::new();
    man.render(&mut text)?;
    all.push((man.get_filename(), text));
    command.get_subcommands().filter(|below| !below.is_hide_set()).try_for_each(|below| page(below, all))
}
