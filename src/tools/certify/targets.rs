//! Where decisions are taken: this machine, by every build of its kernels, and emulated boards.

use std::time::Duration;

use clap::ValueEnum;
use clap::builder::PossibleValue;
use sortie_cli::failure::{Exit, Failure, Outcome};
use sortie_core::internal::kernels::build::Build;
use sortie_stage::UtilityHash;

use super::CertifyArguments;
use super::report::{Hashed, NotRun, Report};
use super::wasm;
use crate::firmware::{Bench, Board, Subject, Toolchain, measure, sources};

/// Boards that are tried where none is named: with vectors, with a floating-point unit alone and without.
const USUAL: [Board; 4] = [Board::CortexM4f, Board::Rv32imc, Board::Rv32imafc, Board::Aarch64];

const HOST: &str = "this machine";
const WASM: &str = "wasm";

/// What `--on` names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Target {
    Host,
    Board(Board),
    /// The program of pages, by the engine that Chromium has.
    Wasm,
}

impl ValueEnum for Target {
    fn value_variants<'a>() -> &'a [Self] {
        const {
            &[
                Self::Host,
                Self::Board(Board::CortexM4f),
                Self::Board(Board::CortexM7),
                Self::Board(Board::CortexM3),
                Self::Board(Board::CortexM0),
                Self::Board(Board::Rv32imc),
                Self::Board(Board::Rv32imafc),
                Self::Board(Board::Aarch64),
                Self::Wasm,
            ]
        }
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        match self {
            Self::Host => Some(PossibleValue::new("host").help("This machine alone")),
            Self::Board(board) => board.to_possible_value(),
            Self::Wasm => Some(PossibleValue::new(WASM).help("The program of pages, in Node.js")),
        }
    }
}

/// The targets of one command.
pub(super) struct Targets<'a> {
    arguments: &'a CertifyArguments,
    boards: Vec<Board>,
    /// Whether the program of pages is tried.
    wasm: bool,
    /// Whether a board that cannot be run fails the command.
    asked: bool,
}

impl<'a> Targets<'a> {
    pub(super) fn new(arguments: &'a CertifyArguments) -> Self {
        let board = |target: &Target| match target {
            Target::Host | Target::Wasm => None,
            Target::Board(board) => Some(*board),
        };
        let asked = !arguments.on.is_empty();
        let named = arguments.on.iter().filter_map(board).collect();
        let wasm = !asked || arguments.on.contains(&Target::Wasm);
        Self { arguments, boards: if asked { named } else { USUAL.to_vec() }, wasm, asked }
    }

    /// This machine, by the kernels that it decides by first, then by the others that it can run.
    pub(super) fn host(&self, parts: &[Subject]) -> Result<(Vec<Hashed>, Vec<NotRun>), Failure> {
        let widest = Build::widest();
        let decisions = parts.iter().map(|part| part.decisions as u64).sum();
        let hashed = |build: Build, hash| Hashed {
            target: HOST.to_owned(),
            by: format!("kernels {}", build.name()),
            decisions,
            hash,
            equal: true,
        };
        let mut found = vec![hashed(widest, joined(parts.iter().map(|part| part.hash)))];
        let mut not_run = Vec::new();
        for build in Build::all().filter(|build| *build != widest) {
            let hashes = parts.iter().map(|part| part.hash_on(build));
            let hashes: Option<Vec<u64>> = hashes.collect::<Result<_, _>>()?;
            match hashes {
                Some(hashes) => found.push(hashed(build, joined(hashes))),
                None => not_run.push(NotRun {
                    target: format!("{HOST}, kernels {}", build.name()),
                    missing:
                        "the three plans of an agent that runs options take the widest kernels"
                            .to_owned(),
                    exit: None,
                }),
            }
        }
        Ok((found, not_run))
    }

    /// The program of pages, or why it cannot be run here.
    pub(super) fn wasm(&self, parts: &[Subject], report: &mut Report) -> Outcome {
        if !self.wasm {
            return Ok(());
        }
        match wasm::hashes(parts) {
            Ok((by, hashes)) => {
                let decisions = parts.iter().map(|part| part.decisions as u64).sum();
                let (target, hash) = (WASM.to_owned(), joined(hashes));
                report.targets.push(Hashed { target, by, decisions, hash, equal: true });
            }
            Err(Failure { exit: exit @ (Exit::NotRunning | Exit::Usage), message, .. }) => {
                let exit = self.asked.then_some(exit);
                report.not_run.push(NotRun { target: WASM.to_owned(), missing: message, exit });
            }
            Err(failure) => return Err(failure.within(WASM)),
        }
        Ok(())
    }

    /// Every board, or why it cannot be run here.
    pub(super) fn boards(&self, parts: &[Subject], report: &mut Report) -> Result<(), Failure> {
        let arguments = self.arguments;
        let sources = sources(arguments.sources.as_deref());
        for board in &self.boards {
            let missing = |failure: &Failure| NotRun {
                target: board.name(),
                missing: failure.message.clone(),
                exit: self.asked.then_some(failure.exit),
            };
            let found = match &sources {
                Ok(sources) => Toolchain::find(&board.machine(), &arguments.rustc)
                    .map(|toolchain| (sources, toolchain)),
                Err(failure) => Err(Failure::new(failure.exit, failure.message.clone())),
            };
            let (sources, toolchain) = match found {
                Ok(found) => found,
                Err(failure) => {
                    report.not_run.push(missing(&failure));
                    continue;
                }
            };
            let limit = Duration::from_secs(arguments.limit);
            let bench = Bench { board: *board, sources, toolchain: &toolchain, limit };
            match self.on_board(&bench, parts) {
                Ok(hashed) => report.targets.push(hashed),
                // What does not fit a board cannot be run there.
                Err(failure) if failure.exit == Exit::Mismatch => {
                    report.not_run.push(missing(&failure));
                }
                Err(failure) => return Err(failure.within(board.name())),
            }
        }
        Ok(())
    }

    /// All networks on one board.
    fn on_board(&self, bench: &Bench<'_>, parts: &[Subject]) -> Result<Hashed, Failure> {
        let (mut hashes, mut decisions, mut compiler) = (Vec::new(), 0, String::new());
        for part in parts {
            // One program for all plans is built once; the micro:bit has no RAM for a plan.
            let reads = part.can_be_read() && bench.board != Board::CortexM0;
            let read = if reads { Some(part.clone().read()?) } else { None };
            let figures = measure(bench, read.as_ref().unwrap_or(part), self.arguments.common)?;
            hashes.push(u64::from_str_radix(&figures.hash, 16).map_err(Failure::bug)?);
            decisions += figures.decisions;
            compiler = figures.compiler;
        }
        let (target, by) =
            (format!("{} (emulated)", bench.board.name()), format!("rustc {compiler}"));
        Ok(Hashed { target, by, decisions, hash: joined(hashes), equal: true })
    }
}

/// One hash of several networks' hashes; that of a single network as it is.
fn joined(hashes: impl IntoIterator<Item = u64>) -> String {
    let hashes: Vec<u64> = hashes.into_iter().collect();
    let joined = match hashes[..] {
        [hash] => hash,
        _ => {
            let mut joined = UtilityHash::default();
            for hash in hashes {
                // The hash is of bits, whatever numbers they are.
                joined.add(&[hash as u32, (hash >> 32) as u32].map(f32::from_bits));
            }
            joined.value()
        }
    };
    format!("{joined:016x}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_board_can_be_named() {
        let boards = Board::value_variants().iter().map(|board| Target::Board(*board));
        let all = [Target::Host].into_iter().chain(boards).chain([Target::Wasm]);
        let all: Vec<Target> = all.collect();
        assert_eq!(Target::value_variants(), all);
    }

    #[test]
    fn several_networks_have_one_hash_that_depends_on_each_and_their_order() {
        assert_eq!(joined([0x1f]), "000000000000001f");
        let of = |hashes: &[u64]| joined(hashes.iter().copied());
        assert_ne!(of(&[1, 2]), of(&[2, 1]));
        assert_ne!(of(&[1, 2]), of(&[1, 3]));
        assert_ne!(of(&[1, 0x7f80_0001_0000_0000]), of(&[1, 0x7fc0_0001_0000_0000]));
    }
}
