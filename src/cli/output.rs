//! How verbs print: JSON for scripts, plain tables for people. Nothing here panics where nobody can read it.

use std::fmt;
use std::io::{self, ErrorKind, Write};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

use clap::Args;
use serde::Serialize;

use crate::failure::{Exit, Failure, Outcome};

/// The first failure to write standard output. What would follow is dropped.
static LOST: OnceLock<io::Error> = OnceLock::new();
/// Whether lost output is no failure.
static MAY_BE_LOST: AtomicBool = AtomicBool::new(false);

/// Prints a line on standard output, as `println!` does, but never panics: where it cannot be written,
/// [`check`](crate::output::check) ends the program in the end.
#[macro_export]
macro_rules! say {
    () => { $crate::output::say_line(format_args!("")) };
    ($($line:tt)*) => { $crate::output::say_line(format_args!($($line)*)) };
}

/// Tells a person a line on standard error, as `eprintln!` does, but never panics: whoever read it may be
/// gone, which is no reason to end.
#[macro_export]
macro_rules! tell {
    ($($line:tt)*) => { $crate::output::tell_line(format_args!($($line)*)) };
}

pub use crate::{say, tell};

pub fn say_line(line: fmt::Arguments<'_>) {
    if LOST.get().is_none() {
        remember(writeln!(io::stdout(), "{line}"));
    }
}

pub fn tell_line(line: fmt::Arguments<'_>) {
    // At once: others write there as well, and a line is theirs or ours.
    let _ = io::stderr().write_all(format!("{line}\n").as_bytes());
}

fn remember(written: io::Result<()>) {
    if let Err(error) = written {
        // Only the first counts.
        let _ = LOST.set(error);
    }
}

/// Says that this program's work is in files, and its words are extras: lost output is no failure then. A verb that
/// must not waste hours, as `train`, calls it before its first word, and plays on to its end.
pub fn may_be_lost() {
    MAY_BE_LOST.store(true, Ordering::Relaxed);
}

/// What a verb comes to whose product is its output: a failure if some of it was lost. Without a word where the
/// reader has gone, as in `sortie … | head`.
pub fn check() -> Outcome {
    match LOST.get() {
        Some(_) if MAY_BE_LOST.load(Ordering::Relaxed) => Ok(()),
        Some(error) if error.kind() == ErrorKind::BrokenPipe => {
            Err(Failure::new(Exit::NobodyReads, ""))
        }
        Some(error) => Err(Failure::new(Exit::InputOutput, format!("standard output: {error}"))),
        None => Ok(()),
    }
}

/// Prints help, the version, or what is wrong with a command line.
pub fn explain(parsed: &clap::Error) -> Outcome {
    let printed = parsed.print();
    if parsed.use_stderr() {
        return Err(Failure::new(Exit::Usage, ""));
    }
    remember(printed);
    Ok(())
}

/// Prints one JSON object on a line of its own.
pub fn print_json(value: &impl Serialize) {
    say!("{}", serde_json::to_string(value).expect("reports have string keys only"));
}

/// Warns of checkpoints that were passed over.
pub fn warn_of_refused(reasons: &[String]) {
    for reason in reasons {
        tell!("warning: {reason}; an earlier checkpoint is used");
    }
}

/// `1 file`, `2 files`, `3 processes`.
pub fn plural(count: usize, noun: &str) -> String {
    let ending = match count {
        1 => "",
        _ if noun.ends_with('s') => "es",
        _ => "s",
    };
    format!("{count} {noun}{ending}")
}

/// A table with its header, columns aligned: text to the left, figures to the right.
pub struct Table {
    header: Vec<String>,
    rows: Vec<Vec<String>>,
    /// Columns from the left that are text.
    texts: usize,
}

impl Table {
    /// The first column is text, the others are figures.
    pub fn new(header: &[&str]) -> Self {
        let header = header.iter().map(ToString::to_string).collect();
        Self { header, rows: Vec::new(), texts: 1 }
    }

    /// All columns are text.
    pub fn of_text(header: &[&str]) -> Self {
        Self { texts: header.len(), ..Self::new(header) }
    }

    pub fn row(&mut self, cells: impl IntoIterator<Item = String>) {
        self.rows.push(cells.into_iter().collect());
    }

    /// The same with so many columns of text from the left.
    pub fn with_texts(self, texts: usize) -> Self {
        Self { texts, ..self }
    }

    pub fn print(&self) {
        self.lines().iter().for_each(|line| say!("{line}"));
    }

    pub fn lines(&self) -> Vec<String> {
        let lines = || std::iter::once(&self.header).chain(&self.rows);
        let width = |column: usize| {
            lines().filter_map(|row| row.get(column)).map(|cell| cell.chars().count()).max()
        };
        let widths: Vec<usize> = (0..).map_while(width).collect();
        lines().map(|line| self.line(line, &widths).trim_end().to_owned()).collect()
    }

    fn line(&self, cells: &[String], widths: &[usize]) -> String {
        let mut line = String::new();
        for (column, (cell, width)) in cells.iter().zip(widths).enumerate() {
            let gap = if column == 0 { "" } else { "  " };
            line.push_str(gap);
            line.push_str(&match column < self.texts {
                true => format!("{cell:<width$}"),
                false => format!("{cell:>width$}"),
            });
        }
        line
    }
}

/// Joins words to lines of at most so many characters; a longer word has a line of its own.
pub fn wrapped(words: impl IntoIterator<Item = String>, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in words {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= width => {
                line.push(' ');
                line.push_str(&word);
            }
            _ => lines.push(word),
        }
    }
    lines
}

/// What every verb takes.
#[derive(Clone, Copy, Debug, Args)]
pub struct Common {
    /// Print JSON for scripts instead of text
    #[arg(long)]
    pub json: bool,
    /// Seed of every random choice
    #[arg(long, default_value_t = 1, value_parser = whole_number)]
    pub seed: u64,
    /// No progress, no notes: the result alone
    #[arg(short, long)]
    pub quiet: bool,
}

/// A value of a flag.
pub fn whole_number(text: &str) -> Result<u64, String> {
    text.parse().map_err(|_| format!("expected a whole number from 0 to {}", u64::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_as_full_as_they_may_be() {
        let words = |text: &str| text.split(' ').map(str::to_owned).collect::<Vec<_>>();
        assert_eq!(wrapped(words("ab cd ef"), 5), ["ab cd", "ef"]);
        assert_eq!(wrapped(words("abcdefg h"), 3), ["abcdefg", "h"]);
        assert!(wrapped(Vec::new(), 3).is_empty());
    }
}
