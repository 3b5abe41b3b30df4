//! `sortie compare`: how methods did, over several seeds each.

use std::ffi::{OsStr, OsString};
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use clap::Args;
use clap::builder::{OsStringValueParser, TypedValueParser};
use serde::Serialize;
use sortie_learn::evaluate::Score;
use sortie_learn::report::numbers::{count, duration};
use sortie_learn::report::{self, Comparison, Group, GroupSummary, Reached, RunRecord};
use sortie_learn::run::Difference;

use crate::failure::{Exit, Failure, Outcome};
use crate::output::{Common, Table, print_json, tell};

/// What a run notes of itself that says nothing of how it learns.
const CIRCUMSTANCES: [&str; 4] = ["seed", "threads", "version", "run.products"];

/// Compare training runs, several seeds to a label, as tables and pictures
///
/// Runs are finished or still learning. Those whose folders differ only in `-s<seed>` at the end of their names are one
/// label; where their settings differ in more than the seed they are refused. The folder gets `curves-steps.svg`,
/// `curves-cpu.svg`, `table.md`, `table.csv`, `table.json` and, where runs have a `result.json`, success by team in
/// `teams.svg` and `teams.csv`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie compare runs/alma-s1 runs/alma-s2 runs/random-s1 --out comparison
  sortie compare --label 'ALMA=runs/alma-s*' --label 'random allocation=runs/random-s*' --out comparison")]
pub(crate) struct CompareArguments {
    /// Folders of runs, or folders that hold runs
    #[arg(value_name = "RUN", required_unless_present = "labels")]
    runs: Vec<PathBuf>,
    /// Runs by folder or pattern, under a name of their own; may be given several times
    #[arg(long = "label", value_name = "NAME=GLOB|FOLDER", value_parser = OsStringValueParser::new().try_map(label))]
    labels: Vec<(String, PathBuf)>,
    /// Folder of the tables and pictures
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Title of the tables and pictures
    #[arg(long, default_value = "Comparison of training runs")]
    title: String,
    #[command(flatten)]
    common: Common,
}

/// The name is text, what follows may be any path.
fn label(argument: OsString) -> Result<(String, PathBuf), &'static str> {
    let mut parts = argument.as_bytes().splitn(2, |byte| *byte == b'=');
    let name = parts.next().and_then(|name| std::str::from_utf8(name).ok());
    match (name, parts.next()) {
        (Some(name), Some(pattern)) if !name.is_empty() && !pattern.is_empty() => {
            Ok((name.to_owned(), OsStr::from_bytes(pattern).into()))
        }
        _ => Err("expected NAME=FOLDER or NAME=GLOB"),
    }
}

#[derive(Serialize)]
struct Report<'a> {
    #[serde(flatten)]
    comparison: &'a Comparison,
    files: &'a [PathBuf],
}

pub(crate) fn run(arguments: &CompareArguments) -> Outcome {
    let groups = groups(arguments)?;
    let comparison = Comparison::of(&arguments.title, &groups);
    let files = report::write(&arguments.out, &groups, &comparison)?;
    if arguments.common.json {
        print_json(&Report { comparison: &comparison, files: &files });
    } else {
        print(&comparison, arguments);
    }
    Ok(())
}

/// The groups in the order in which they are named: runs first, then labels.
fn groups(arguments: &CompareArguments) -> Result<Vec<Group>, Failure> {
    let mut groups = Vec::new();
    for pattern in &arguments.runs {
        for run in runs(pattern)? {
            add(&mut groups, run.label(), run);
        }
    }
    for (name, pattern) in &arguments.labels {
        for run in runs(pattern)? {
            add(&mut groups, name.clone(), run);
        }
    }
    for group in &mut groups {
        group.runs.sort_by_key(|run| (run.seed, run.name()));
        check(group)?;
    }
    Ok(groups)
}

/// Adds a run to its group, once.
fn add(groups: &mut Vec<Group>, label: String, run: RunRecord) {
    match groups.iter_mut().find(|group| group.label == label) {
        Some(group) if group.runs.iter().any(|other| is_same(&other.folder, &run.folder)) => {}
        Some(group) => group.runs.push(run),
        None => groups.push(Group { label, runs: vec![run] }),
    }
}

/// Whether two paths lead to one folder.
fn is_same(one: &Path, other: &Path) -> bool {
    one == other || matches!((one.canonicalize(), other.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

/// Refuses to average runs that differ in more than their seeds and circumstances.
fn check(group: &Group) -> Outcome {
    let Some((first, others)) = group.runs.split_first() else { return Ok(()) };
    for run in others {
        if let Some(Difference { key, ours, theirs }) = difference(first, run) {
            let [first, run] = [first, run].map(|run| run.folder.display());
            let reason = format!(
                "runs of `{}` differ: `{key}` is {ours} in {first}, {theirs} in {run}; keep them apart with `--label \
                 NAME=FOLDER`",
                group.label
            );
            return Err(Failure::new(Exit::Usage, reason));
        }
    }
    Ok(())
}

/// The first setting in which runs differ that both say how they learn.
fn difference(one: &RunRecord, other: &RunRecord) -> Option<Difference> {
    if one.description.is_empty() || other.description.is_empty() {
        return None;
    }
    let differences = Difference::between_tables(&one.description, &other.description);
    differences.into_iter().find(|found| !CIRCUMSTANCES.contains(&found.key.as_str()))
}

/// The runs that a folder or a pattern means.
fn runs(pattern: &Path) -> Result<Vec<RunRecord>, Failure> {
    let mut folders = Vec::new();
    for place in places(pattern)? {
        if RunRecord::is_in(&place) {
            folders.push(place);
        } else {
            folders.extend(children(&place).into_iter().filter(|child| RunRecord::is_in(child)));
        }
    }
    if folders.is_empty() {
        let reason = "names no run that has been evaluated: there is no `curve.json`";
        return Err(Failure::new(Exit::Missing, format!("`{}` {reason}", pattern.display())));
    }
    Ok(folders.iter().map(|folder| RunRecord::open(folder)).collect::<Result<_, _>>()?)
}

fn places(path: &Path) -> Result<Vec<PathBuf>, Failure> {
    if path.exists() {
        return Ok(vec![path.into()]);
    }
    // Patterns are text; another name is that of a folder that is not there.
    let Some(pattern) = path.to_str() else { return Ok(Vec::new()) };
    let found = glob::glob(pattern)
        .map_err(|error| Failure::new(Exit::Usage, format!("`{pattern}`: {error}")))?;
    Ok(found.flatten().collect())
}

fn children(folder: &Path) -> Vec<PathBuf> {
    let entries = folder.read_dir().into_iter().flatten().flatten();
    let mut children: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    children.sort();
    children
}

fn print(comparison: &Comparison, arguments: &CompareArguments) {
    let levels = comparison.levels();
    let score = comparison.score;
    let mut header =
        ["label", "runs", score.name(), "sd", "range", "steps", "CPU"].map(String::from).to_vec();
    header.extend(levels.iter().map(|level| format!("CPU until {level}")));
    let header: Vec<&str> = header.iter().map(String::as_str).collect();
    let mut table = Table::new(&header);
    for group in &comparison.groups {
        table.row(cells(group, score, &levels));
    }
    table.print();
    if !arguments.common.quiet {
        for note in &comparison.notes {
            tell!("note: {note}");
        }
        tell!("tables and pictures are in {}", arguments.out.display());
    }
}

fn cells(group: &GroupSummary, score: Score, levels: &[&String]) -> Vec<String> {
    let [mean, sd, range] = group.of_score(score).map_or_else(Default::default, |spread| {
        let [min, max] = [spread.min, spread.max].map(|value| score.text(value));
        let sd = spread.sd.map_or(String::new(), |sd| score.text(sd));
        [score.text(spread.mean), sd, format!("{min} to {max}")]
    });
    let mut cells = vec![
        group.label.clone(),
        group.runs.to_string(),
        mean,
        sd,
        range,
        count(group.env_steps.mean),
        duration(group.cpu_s.mean),
    ];
    for level in levels {
        let Some(until) = group.until.get(*level) else {
            cells.push(String::new());
            continue;
        };
        let mean = until.cpu_s.map(|Reached { mean, .. }| duration(mean));
        cells.push(match mean {
            None => "never".to_owned(),
            Some(mean) if until.reached == group.runs => mean,
            Some(mean) => format!("{mean} ({} of {})", until.reached, group.runs),
        });
    }
    cells
}
