//! What a plan needs on a board, and the table that it is compared with.

use std::collections::BTreeMap;
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use serde::Serialize;
use sortie_cli::failure::{Exit, Failure};

use super::toolchain::started;
use crate::document::{Columns, Document, Row};

/// What a plan needed on a board, and what it came to. Sizes are bytes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Figures {
    pub(crate) board: String,
    pub(crate) bundle: String,
    pub(crate) profile: &'static str,
    /// The compiler's version, on which figures depend.
    pub(crate) compiler: String,
    pub(crate) decisions: u64,
    /// FNV-1a over the bits of all utilities, of the board and of this machine.
    pub(crate) hash: String,
    pub(crate) host_hash: String,
    pub(crate) instructions: Instructions,
    pub(crate) flash: Flash,
    pub(crate) ram: Ram,
}

/// Instructions of a decision, which are not cycles.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Instructions {
    pub(crate) most: u64,
    /// Entities that were visible in that decision.
    pub(crate) most_visible: u64,
    pub(crate) mean: u64,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Flash {
    /// Code and constants, without what reads observations and prints.
    pub(crate) code: u64,
    /// The plan, nearly all of it weights.
    pub(crate) plan: u64,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Ram {
    /// All of the following together, but for the stack of loading, which is over when decisions begin.
    pub(crate) all: u64,
    pub(crate) arena: u64,
    /// What one agent remembers.
    pub(crate) states: u64,
    /// What is known of the loaded plan.
    pub(crate) loaded: u64,
    /// The deepest stack of a decision.
    pub(crate) stack: u64,
    pub(crate) loading_stack: u64,
}

impl Instructions {
    pub(crate) fn told(told: &Told) -> Result<Self, Failure> {
        let ticks = told.number("ticks-of-100000")?.max(1);
        let count = |name| Ok::<_, Failure>(told.number(name)? * 100_000 / ticks);
        let mean = count("ticks")? / told.number("decisions")?.max(1);
        Ok(Self { most: count("most-ticks")?, most_visible: told.number("most-visible")?, mean })
    }
}

impl Flash {
    pub(crate) fn told(told: &Told) -> Result<Self, Failure> {
        let (all, plan) = (told.number("flash")?, told.number("plan")?);
        Ok(Self { code: all.saturating_sub(plan + told.number("harness")?), plan })
    }
}

impl Ram {
    pub(crate) fn told(told: &Told) -> Result<Self, Failure> {
        let number = |name| told.number(name);
        let (arena, states) = (number("arena")?, number("states")?);
        let (loaded, stack) = (number("loaded")?, number("stack")?);
        let all = arena + states + loaded + stack;
        Ok(Self { all, arena, states, loaded, stack, loading_stack: number("stack-of-loading")? })
    }
}

/// The columns of the table.
pub(crate) const COLUMNS: Columns = Columns {
    names: &[
        "board",
        "bundle",
        "profile",
        "compiler",
        "instructions, most",
        "mean",
        "code",
        "plan",
        "RAM",
        "of it stack",
        "hash",
    ],
    keys: KEYS,
};
/// Columns that say what a row is of.
const KEYS: usize = 3;
/// Columns of instructions, and of bytes, with the percentage that they may grow by.
const HELD: [(std::ops::Range<usize>, u64); 2] = [(4..6, 1), (6..10, 3)];
/// The same where another compiler built the program.
const OF_ANOTHER_COMPILER: u64 = 10;

/// A Markdown document with a table of figures.
pub(crate) struct Recorded(pub(crate) Document);

/// What a table says about figures.
#[derive(Debug, PartialEq)]
pub(crate) enum Verdict {
    /// They are not larger than is allowed.
    Held,
    /// The table has none of these.
    New,
    /// Another compiler built what it has, and some are much larger.
    Larger(String),
    /// They are too large, or the bits are others.
    Broken(String),
}

impl Figures {
    fn row(&self) -> Row {
        let Self { instructions, flash, ram, .. } = self;
        let numbers =
            [instructions.most, instructions.mean, flash.code, flash.plan, ram.all, ram.stack];
        let names = [&self.board, &self.bundle, self.profile, &self.compiler].map(str::to_owned);
        let numbers = numbers.iter().map(ToString::to_string);
        names.into_iter().chain(numbers).chain([self.hash.clone()]).collect()
    }
}

impl Recorded {
    /// Puts figures in the place of those of the same plan on the same board.
    pub(crate) fn put(&mut self, figures: &Figures) {
        self.0.put(figures.row());
    }

    /// Compares figures with the recorded ones.
    pub(crate) fn judge(&self, figures: &Figures) -> Verdict {
        let row = figures.row();
        let Some(recorded) = self.0.same(&row) else {
            return Verdict::New;
        };
        let is_same_compiler = recorded.get(KEYS) == row.get(KEYS);
        for (columns, percent) in HELD {
            let percent = if is_same_compiler { percent } else { OF_ANOTHER_COMPILER };
            for column in columns {
                let number = |row: &Row| row.get(column).and_then(|cell| cell.parse::<u64>().ok());
                let (Some(was), Some(is)) = (number(recorded), number(&row)) else { continue };
                if 100 * is > (100 + percent) * was {
                    let name = COLUMNS.names.get(column).copied().unwrap_or_default();
                    let said = format!("{name}: {is}, recorded {was}, more than {percent} % above");
                    return if is_same_compiler {
                        Verdict::Broken(said)
                    } else {
                        Verdict::Larger(said)
                    };
                }
            }
        }
        match (recorded.last(), row.last()) {
            (Some(was), Some(is)) if was != is => {
                Verdict::Broken(format!("hash: {is}, recorded {was}"))
            }
            _ => Verdict::Held,
        }
    }
}

/// How often an emulator is asked whether it has ended.
const PAUSE: Duration = Duration::from_millis(10);

/// The numbers that a program told, by name.
pub(crate) struct Told(BTreeMap<String, u64>);

impl Told {
    /// Runs an emulator to its end, `limit` at most.
    pub(crate) fn by(mut emulator: Command, limit: Duration) -> Result<Self, Failure> {
        let name = emulator.get_program().to_string_lossy().into_owned();
        emulator.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = emulator.spawn().map_err(|error| started(&name, &error))?;
        let failed = |error: std::io::Error| started(&name, &error);
        let begun = Instant::now();
        while child.try_wait().map_err(failed)?.is_none() {
            if begun.elapsed() > limit {
                child.kill().map_err(failed)?;
                child.wait().map_err(failed)?;
                let message = format!("the board did not end within {} s", limit.as_secs());
                return Err(Failure::new(Exit::NotRunning, message));
            }
            sleep(PAUSE);
        }
        let output = child.wait_with_output().map_err(failed)?;
        // Where the console is depends on the emulator.
        let said = [output.stdout, output.stderr].concat();
        let said = String::from_utf8_lossy(&said);
        if output.status.success() {
            return Ok(Self::read(&said));
        }
        let last = said.lines().rfind(|line| !line.is_empty()).unwrap_or("nothing was said");
        Err(Failure::difference(format!("the program on the board failed: {last}")))
    }

    /// Reads lines of a name and a number in hexadecimal digits; others are somebody else's.
    fn read(said: &str) -> Self {
        let line = |line: &str| {
            let (name, number) = line.split_once(' ')?;
            let number = u64::from_str_radix(number, 16).ok().filter(|_| number.len() == 16)?;
            Some((name.to_owned(), number))
        };
        Self(said.lines().filter_map(line).collect())
    }

    pub(crate) fn number(&self, name: &str) -> Result<u64, Failure> {
        let missing =
            || Failure::new(Exit::Bug, format!("the board told no `{name}`; please report this"));
        self.0.get(name).copied().ok_or_else(missing)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn figures() -> Figures {
        Figures {
            board: "cortex-m0".to_owned(),
            bundle: "team".to_owned(),
            profile: "int8",
            compiler: "1.96.0".to_owned(),
            decisions: 64,
            hash: "00ff".to_owned(),
            host_hash: "00ff".to_owned(),
            instructions: Instructions { most: 2000, most_visible: 9, mean: 1000 },
            flash: Flash { code: 1000, plan: 5000 },
            ram: Ram {
                all: 1000,
                arena: 700,
                states: 0,
                loaded: 100,
                stack: 200,
                loading_stack: 300,
            },
        }
    }

    fn read(document: &str) -> Recorded {
        Recorded(Document::read(document, COLUMNS))
    }

    #[test]
    fn a_table_is_read_as_it_was_written() {
        let mut recorded = read("# Figures\n\ntext\n");
        assert_eq!(recorded.judge(&figures()), Verdict::New);
        recorded.put(&Figures { board: "rv32imc".to_owned(), ..figures() });
        recorded.put(&Figures { hash: "1".to_owned(), ..figures() });
        recorded.put(&figures());
        let document = recorded.0.write() + "\nmore text\n";
        let again = read(&document);
        assert_eq!(again.0.write(), document.clone());
        assert!(document.starts_with("# Figures\n\ntext\n| board | bundle |"), "{document}");
        assert!(document.contains("| cortex-m0 | team | int8 | 1.96.0 | 2000 | 1000 | 1000 | 5000 | 1000 | 200 | 00ff |\n| rv32imc |"));
        assert_eq!(again.judge(&figures()), Verdict::Held);
    }

    #[test]
    fn figures_are_held_to_what_was_recorded() {
        let mut recorded = read("");
        recorded.put(&figures());
        let instructions = |most, mean| Figures {
            instructions: Instructions { most, most_visible: 9, mean },
            ..figures()
        };
        assert_eq!(recorded.judge(&instructions(2020, 1010)), Verdict::Held);
        assert_eq!(recorded.judge(&instructions(100, 100)), Verdict::Held);
        assert_eq!(recorded.judge(&code_of(1030)), Verdict::Held);
        let broken = [
            instructions(2021, 1000),
            instructions(2000, 1011),
            code_of(1031),
            Figures { flash: Flash { code: 1000, plan: 5151 }, ..figures() },
            Figures { ram: Ram { all: 1031, ..figures().ram }, ..figures() },
            Figures { ram: Ram { stack: 207, ..figures().ram }, ..figures() },
            Figures { hash: "1".to_owned(), ..figures() },
        ];
        for figures in broken {
            let verdict = recorded.judge(&figures);
            assert!(matches!(verdict, Verdict::Broken(_)), "{figures:?}: {verdict:?}");
        }
        let other = |code| Figures { compiler: "1.97.0".to_owned(), ..code_of(code) };
        assert_eq!(recorded.judge(&other(1100)), Verdict::Held);
        assert!(matches!(recorded.judge(&other(1101)), Verdict::Larger(_)));
    }

    fn code_of(code: u64) -> Figures {
        Figures { flash: Flash { code, plan: 5000 }, ..figures() }
    }

    fn shell(line: &str) -> Command {
        let mut shell = Command::new("sh");
        shell.args(["-c", line]);
        shell
    }

    #[test]
    fn a_program_tells_numbers_and_why_it_failed() {
        let limit = Duration::from_secs(60);
        let told =
            Told::by(shell("echo hash 00000000000000ff; echo qemu: note 12"), limit).unwrap();
        assert_eq!(told.number("hash").unwrap(), 255);
        assert_eq!(told.number("qemu:").map_err(|failure| failure.exit), Err(Exit::Bug));
        let failed = Told::by(shell("echo the plan is refused; echo; exit 3"), limit).map(drop);
        let failed = failed.unwrap_err();
        assert_eq!(failed.exit, Exit::Difference);
        assert!(failed.message.ends_with(": the plan is refused"), "{}", failed.message);
    }

    #[test]
    fn a_program_that_hangs_is_ended() {
        let failed = Told::by(shell("exec sleep 600"), Duration::from_millis(50)).map(drop);
        assert_eq!(failed.unwrap_err().exit, Exit::NotRunning);
    }
}
