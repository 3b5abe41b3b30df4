//! `sortie completions` and `sortie man`: the grammar of the command line for shells and readers.

use std::fs;
use std::path::PathBuf;

use clap::{Args, Command};
use clap_complete::{Shell, generate};

use crate::failure::{Failure, Outcome};
use crate::output::say;
use crate::tools::prefer_tools;

/// Print the completion script of a shell
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie completions bash > ~/.local/share/bash-completion/completions/sortie
  sortie completions zsh > ~/.zfunc/_sortie
  sortie completions fish > ~/.config/fish/completions/sortie.fish")]
pub(crate) struct CompletionsArguments {
    /// The shell
    #[arg(value_enum)]
    shell: Shell,
}

/// Write a manual page for every verb into a folder
#[derive(Debug, Args)]
#[command(after_help = "Example:
  sortie man ~/.local/share/man/man1    # then: man sortie-train")]
pub(crate) struct ManArguments {
    /// The folder; it is made where it is missing
    folder: PathBuf,
}

// The whole grammar is the other program's, where it is there.
pub(crate) fn complete(
    arguments: &CompletionsArguments,
    grammar: impl FnOnce() -> Command,
) -> Outcome {
    prefer_tools()?;
    let mut script = Vec::new();
    generate(arguments.shell, &mut grammar(), "sortie", &mut script);
    say!("{}", String::from_utf8_lossy(&script).trim_end());
    Ok(())
}

pub(crate) fn run(arguments: &ManArguments, grammar: impl FnOnce() -> Command) -> Outcome {
    prefer_tools()?;
    let folder = &arguments.folder;
    fs::create_dir_all(folder).map_err(|error| Failure::file(folder, &error))?;
    clap_mangen::generate_to(grammar(), folder).map_err(|error| Failure::file(folder, &error))
}
