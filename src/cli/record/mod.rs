//! `sortie record`: what a team says while it works, in a file.

mod bundles;
mod files;
mod flight;
mod log;
mod ticks;

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use sortie_ipc::{Domain, Heard, Stop};

use crate::failure::{Failure, Outcome};
use crate::listener::{Listener, wall_clock_ahead_ns};
use crate::output::{Common, plural};
use crate::quantities::{size, time};
use crate::terminal::{spinner, stop_on_signals};
use bundles::Bundles;
use files::{Division, Files, Written, finish_alone};
use flight::{Event, Flight};
use log::Log;

/// The longest sleep between two looks.
const LOOK_EVERY: Duration = Duration::from_millis(100);

/// Write down all that a running team says: frames, actions, allocations, who is there
///
/// The file is MCAP, which Foxglove and others open: /tick is for people, in JSON; /frame, /action, /allocation and /status are
/// the messages as they were, byte for byte. Nobody in the team waits for who records. The file is readable at any time,
/// whatever ends the recording, but for the last tick; where it ends well it is compressed and gets an index.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie record                                   # until the team ends, or Ctrl-C
  sortie record models/save-the-city --output monday.mcap --domain north
  sortie record --ticks 10000 --json
  sortie record --split 500MB --keep 10           # for weeks: run-1.mcap, run-2.mcap, ...
  sortie record --last 60s --on fallback,death    # the minute before something happens, when it does
  sortie record --finish monday.mcap              # after its recorder was killed")]
pub(crate) struct RecordArguments {
    /// Folder of the bundle that the team runs: the record then brings it along, and those that the team changes to
    bundle: Option<PathBuf>,
    /// File to write; `run-1.mcap`, `run-2.mcap` and so on where there may be several
    #[arg(short, long, value_name = "FILE", default_value = "run.mcap")]
    output: PathBuf,
    /// Domain of the team
    #[arg(long, env = "SORTIE_DOMAIN", default_value = "default")]
    domain: String,
    /// End after so many ticks
    #[arg(long, value_name = "COUNT")]
    ticks: Option<u64>,
    /// Begin another file where one has become so large: 500MB, 1GB
    #[arg(long, value_name = "SIZE", value_parser = size, conflicts_with = "last")]
    split: Option<u64>,
    /// Keep so much of the past in memory, 60s or 5min, and write it when something happens, or on SIGUSR1
    #[arg(long, value_name = "TIME", value_parser = time)]
    last: Option<u64>,
    /// What is written for with --last
    #[arg(
        long,
        value_name = "EVENTS",
        value_enum,
        value_delimiter = ',',
        requires = "last",
        default_value = "fallback,late,death"
    )]
    on: Vec<Event>,
    /// Keep the newest files only, so many of them
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u64).range(1..))]
    keep: Option<u64>,
    /// Compress and index a record instead, and cut off what was written in part
    #[arg(long, value_name = "FILE", conflicts_with_all = ["bundle", "output", "ticks", "split", "last", "keep"])]
    finish: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

/// Where a record goes.
enum Output {
    Files(Written),
    Memory(Box<Flight>),
}

impl Output {
    fn open(arguments: &RecordArguments) -> Result<Self, Failure> {
        let RecordArguments { output, split, last, on, keep, common, .. } = arguments;
        let division = Division {
            path: output.clone(),
            is_numbered: split.is_some() || last.is_some(),
            keep: keep.map(|keep| keep as usize),
        };
        let files = Files::new(division, *common);
        Ok(match last {
            Some(span_ns) => Self::Memory(Box::new(Flight::new(files, *span_ns, on.clone())?)),
            None => Self::Files(Written::new(files, *split)?),
        })
    }

    fn hear(&mut self, heard: Heard<'_>, now_ns: u64) {
        if let Self::Memory(flight) = self {
            flight.hear(heard, now_ns);
        }
    }

    /// Writes or keeps what was added.
    fn look(&mut self, log: &mut Log, now_ns: u64) -> Outcome {
        match self {
            Self::Files(files) => files.look(log),
            Self::Memory(flight) => flight.look(log, now_ns),
        }
    }

    fn end(self, log: &mut Log) -> Outcome {
        match self {
            Self::Files(files) => files.end(log),
            Self::Memory(flight) => flight.end(log),
        }
    }
}

pub(crate) fn run(arguments: &RecordArguments) -> Outcome {
    if let Some(file) = &arguments.finish {
        return finish_alone(file, arguments.common);
    }
    let stop = stop_on_signals()?;
    let domain = Domain::new(&arguments.domain)?;
    let listener = Listener::enter(&domain, "recorder")?;
    let facts = listener.facts();
    let mut log = Log::new(facts, wall_clock_ahead_ns())?;
    let bundles = arguments.bundle.as_ref();
    let bundles = bundles.map(|folder| Bundles::open(&domain, folder, facts, &mut log));
    let bundles = bundles.transpose()?;
    let mut output = Output::open(arguments)?;
    let ended = record(listener, bundles, (&mut log, &mut output), &stop, arguments);
    // What was written before a failure is as good as ever.
    output.end(&mut log).and(ended)
}

/// Records until the team ends or the user does.
fn record(
    mut listener: Listener,
    mut bundles: Option<Bundles<'_>>,
    (log, output): (&mut Log, &mut Output),
    stop: &Stop,
    arguments: &RecordArguments,
) -> Outcome {
    let spinner = spinner(arguments.common);
    let (mut told_ns, mut is_over, mut generation) = (0, false, None);
    while !is_over {
        listener.look(&mut |heard, now_ns| {
            if let Heard::Frame(header, _) = heard {
                generation = Some(header.generation);
            }
            output.hear(heard, now_ns);
            is_over |= log.add(heard, now_ns);
        })?;
        let now_ns = listener.looked_ns();
        if let (Some(bundles), Some(generation)) = (&mut bundles, generation) {
            bundles.look(generation, log)?;
        }
        output.look(log, now_ns)?;
        if now_ns - told_ns > LOOK_EVERY.as_nanos() as u64 {
            told_ns = now_ns;
            spinner.set_message(plural(log.ticks() as usize, "tick"));
        }
        is_over |= arguments.ticks.is_some_and(|most| log.ticks() >= most);
        is_over |= stop.is_set() || listener.is_alone();
        if !is_over {
            listener.wait(LOOK_EVERY);
        }
    }
    spinner.finish_and_clear();
    bundles.into_iter().for_each(|mut bundles| bundles.end(log));
    Ok(())
}
