//! `sortie record`: what a team says while it works, in a file.

mod log;
mod ticks;

use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use clap::Args;
use serde::Serialize;
use sortie_core::link::Clock;
use sortie_ipc::{Domain, DomainFacts, MonotonicClock};
use sortie_record::{Finished, RecordError, finish};

use crate::deployment::{model_id, model_text, open_bundle};
use crate::failure::{Exit, Failure, Outcome};
use crate::listener::Listener;
use crate::output::{Common, plural, print_json, say};
use crate::terminal::{spinner, stop_on_signals};
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
  sortie record --finish monday.mcap              # after its recorder was killed")]
pub(crate) struct RecordArguments {
    /// Folder of the bundle that the team runs, which the record then brings along
    bundle: Option<PathBuf>,
    /// File to write
    #[arg(short, long, value_name = "FILE", default_value = "run.mcap")]
    output: PathBuf,
    /// Domain of the team
    #[arg(long, env = "SORTIE_DOMAIN", default_value = "default")]
    domain: String,
    /// End after so many ticks
    #[arg(long, value_name = "COUNT")]
    ticks: Option<u64>,
    /// Compress and index a record instead, and cut off what was written in part
    #[arg(long, value_name = "FILE", conflicts_with_all = ["bundle", "output", "ticks"])]
    finish: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

/// What became of a record, for scripts.
#[derive(Serialize)]
struct Became<'a> {
    file: &'a Path,
    ticks: u64,
    messages: u64,
    /// Messages that came and went before they were read, by their numbers.
    missed: u64,
    bytes_running: u64,
    bytes: u64,
    /// Where it had been cut off, if it was.
    torn_at: Option<u64>,
}

pub(crate) fn run(arguments: &RecordArguments) -> Outcome {
    if let Some(file) = &arguments.finish {
        return finish_alone(file, arguments.common);
    }
    let log = record(arguments)?;
    let (ticks, missed) = (log.ticks(), log.missed());
    log.end().map_err(|error| Failure::file(&arguments.output, &error))?;
    let finished = finished(&arguments.output)?;
    tell(&arguments.output, (ticks, missed), finished, arguments.common);
    Ok(())
}

/// Records until the team ends or the user does.
fn record(arguments: &RecordArguments) -> Result<Log<File>, Failure> {
    let stop = stop_on_signals()?;
    let domain = Domain::new(&arguments.domain)?;
    let mut listener = Listener::enter(&domain, "recorder")?;
    let facts = listener.facts();
    let mut log = Log::new(create(&arguments.output)?, facts, wall_clock_ahead_ns())?;
    if let Some(folder) = &arguments.bundle {
        attach(&mut log, folder, facts)?;
    }
    let spinner = spinner(arguments.common);
    let mut is_over = false;
    while !is_over {
        listener.look(&mut |heard, now_ns| is_over |= log.add(heard, now_ns))?;
        log.flush().map_err(|error| full(&arguments.output, &error, log.ticks()))?;
        spinner.set_message(plural(log.ticks() as usize, "tick"));
        is_over |= arguments.ticks.is_some_and(|most| log.ticks() >= most);
        is_over |= stop.is_set() || listener.is_alone();
        if !is_over {
            listener.wait(LOOK_EVERY);
        }
    }
    spinner.finish_and_clear();
    Ok(log)
}

fn create(path: &Path) -> Result<File, Failure> {
    File::create_new(path).map_err(|error| match error.kind() {
        ErrorKind::AlreadyExists => {
            let there = format!("{} is there already", path.display());
            Failure::new(Exit::Usage, format!("{there}: name another file by --output"))
        }
        _ => Failure::file(path, &error),
    })
}

/// How much more the time since 1970 is than that of the domain's clock.
fn wall_clock_ahead_ns() -> u64 {
    let since_1970 = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    (since_1970.as_nanos() as u64).saturating_sub(MonotonicClock.now_ns())
}

/// Has the record bring along the bundle of the team.
fn attach(log: &mut Log<File>, folder: &Path, facts: &DomainFacts) -> Outcome {
    let bundle = open_bundle(folder)?;
    let model = model_text(model_id(&bundle));
    if model != facts.model() {
        let message = format!(
            "{} is not the team's bundle: {model}, which has {}",
            folder.display(),
            facts.model()
        );
        return Err(Failure::new(Exit::Mismatch, message));
    }
    let failed = |error| Failure::file(folder, &error);
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        paths.push(entry.map_err(failed)?.path());
    }
    paths.sort();
    for path in paths.iter().filter(|path| path.is_file()) {
        let data = std::fs::read(path).map_err(|error| Failure::file(path, &error))?;
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        log.attach(&format!("bundle/{name}"), &data);
    }
    Ok(())
}

/// A record that cannot go on: the team does, and what was written before can be read.
fn full(path: &Path, error: &std::io::Error, ticks: u64) -> Failure {
    let message = format!(
        "{}: {error}; it holds {}, to be finished where there is room: sortie record --finish {}",
        path.display(),
        plural(ticks as usize, "tick"),
        path.display()
    );
    Failure::new(Exit::InputOutput, message)
}

fn finish_alone(file: &Path, common: Common) -> Outcome {
    let finished = finished(file)?;
    if finished.was_finished && !common.json {
        say!("{} is finished", file.display());
        return Ok(());
    }
    tell(file, (0, 0), finished, common);
    Ok(())
}

fn finished(file: &Path) -> Result<Finished, Failure> {
    finish(file).map_err(|error| match error {
        RecordError::Io(error) => Failure::file(file, &error),
        other => Failure::new(Exit::BadData, format!("{}: {other}", file.display())),
    })
}

fn tell(file: &Path, (ticks, missed): (u64, u64), finished: Finished, common: Common) {
    let Finished { messages, bytes_before, bytes, torn_at, .. } = finished;
    if common.json {
        let bytes_running = bytes_before;
        print_json(&Became { file, ticks, messages, missed, bytes_running, bytes, torn_at });
        return;
    }
    let megabytes = |bytes: u64| bytes as f64 / 1e6;
    let sizes = format!("{:.1} MB, {:.1} before", megabytes(bytes), megabytes(bytes_before));
    say!("{}: {}, {sizes}", file.display(), plural(messages as usize, "message"));
    if let Some(at) = torn_at {
        say!("it had been cut off at byte {at}");
    }
    if missed > 0 {
        say!("{} came and went before they were read", plural(missed as usize, "message"));
    }
}
