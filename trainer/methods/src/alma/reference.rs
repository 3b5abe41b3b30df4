//! The page of the documentation about all keys.

use sortie_learn::LearnError;
use sortie_learn::configuration::tables;

use super::configuration::{FAST, PAPER};
use super::{records, windows};

/// The page `docs/configuration.md`.
pub fn reference() -> Result<String, LearnError> {
    let mut page = String::from(HEAD);
    page += &tables("Preset `fast`", FAST, &records::Config::default())?;
    page += &tables("Preset `paper`", PAPER, &windows::Config::default())?;
    Ok(page)
}

const HEAD: &str = "\
# The configuration, key by key

`sortie train METHOD --print-config` prints the configuration that a command would learn by, with all of this as comments; it
takes `--preset`, `--config`, `--set` and the other flags. What it prints is a file for `--config`, which may leave out what it
does not change. `--set replay.batch=256` changes one value. A value outside its range, or a key that does not exist, is
refused with exit code 2, by key, value and range, in files also by line. `train.toml` in a run's folder holds the values
that the run learns by; `sortie train METHOD --resume DIR --steps N` changes `run.steps` and nothing else.

In the preset `fast`, runs of less than 600,000 steps shrink `exploration.steps`, `allocator.learns_from` and
`allocator.decides_from` in proportion, unless they are set.

This page is written by the program; a test compares them.
";
