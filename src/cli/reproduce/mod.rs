//! `sortie reproduce`: figures and tables of the dissertation, learned and measured anew.

mod recipe;
mod solvers;

use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;
use sortie_bundle::files::{MOST_TEXT_BYTES, read_text};
use sortie_ipc::Stop;
use sortie_learn::report::chart::{self, Bar, Bars};
use sortie_learn::report::{self, Comparison, Group, RunRecord, Spread};
use sortie_learn::session::Setup;

use crate::eval::evaluated;
use crate::failure::{Exit, Failure, Outcome};
use crate::files::write_output;
use crate::output::{Common, Table, plural, print_json, say, tell};
use crate::seeds::SeedRange;
use crate::terminal::{bar, stop_on_signals};
use crate::train::{Sweep, check_stop, learn_all, run_folder, suffixed};
use recipe::{Came, Case, Figure, Measured, Method, OWN, Recipes, Row, slug};

/// Redo a figure or table of the dissertation: learn what is missing, and lay it beside what was published
///
/// Runs are those of `sortie train`, one for each case, method and seed, as many at a time as there are cores. What is
/// finished is only read; the same command again goes on with what was stopped. The folder gets `table.md`, `table.json`,
/// `picture.svg`, and for every case what `sortie compare` writes.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie reproduce --list
  sortie reproduce table-4.1
  sortie reproduce figure-7.4 --out runs/again --seeds 1..5
  sortie reproduce table-4.1 --seeds 1..1 --json
  sortie reproduce mine --recipes mine.toml")]
pub(crate) struct ReproduceArguments {
    /// Figure or table, as --list names it
    #[arg(value_name = "FIGURE", required_unless_present = "list")]
    figure: Option<String>,
    /// Say of every figure and table of chapters 3 to 7 whether it can be redone, and why not
    #[arg(long, conflicts_with_all = ["figure", "seeds"])]
    list: bool,
    /// Folder of the runs and of what they come to: DIR/FIGURE
    #[arg(long, value_name = "DIR", default_value = "runs/reproduce")]
    out: PathBuf,
    /// Seeds of the runs, A and B included [default: as the recipe says]
    #[arg(long, value_name = "A..B")]
    seeds: Option<SeedRange>,
    /// Recipes of your own, a file like docs/evidence/reproduce.toml
    #[arg(long, value_name = "FILE")]
    recipes: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

pub(crate) fn run(arguments: &ReproduceArguments) -> Outcome {
    let recipes = match &arguments.recipes {
        None => Recipes::from_text(OWN, "docs/evidence/reproduce.toml")?,
        Some(path) => {
            let text =
                read_text(path, MOST_TEXT_BYTES).map_err(|error| Failure::file(path, &error))?;
            Recipes::from_text(&text, &path.display().to_string())?
        }
    };
    match &arguments.figure {
        Some(name) => reproduce(recipes.find(name)?, arguments),
        None => list(&recipes, arguments),
    }
}

/// What is said of a figure in a list.
#[derive(Serialize)]
struct Listed<'a> {
    figure: &'a str,
    about: &'a str,
    state: recipe::State,
    why: &'a str,
    /// Runs that it takes, and those that are finished.
    runs: usize,
    finished: usize,
}

fn list(recipes: &Recipes, arguments: &ReproduceArguments) -> Outcome {
    let mut table = Table::of_text(&["figure", "state", "runs", "what"]);
    for figure in &recipes.figures {
        let folder = arguments.out.join(&figure.name);
        let mut ended = Vec::new();
        for (case, method) in figure.pairs() {
            let out = folder_of(&folder, case, method);
            let runs = figure.seeds(method, None)?.into_iter().map(|seed| run_folder(&out, seed));
            ended.extend(runs.map(|run| run.join("result.json").exists()));
        }
        let finished = ended.iter().filter(|ended| **ended).count();
        let Figure { name, about, state, why, .. } = figure;
        if arguments.common.json {
            let (state, runs) = (*state, ended.len());
            print_json(&Listed { figure: name, about, state, why, runs, finished });
        }
        let runs =
            if ended.is_empty() { String::new() } else { format!("{finished} of {}", ended.len()) };
        table.row([name.clone(), state.name().to_owned(), runs, about.clone()]);
        if !arguments.common.quiet {
            table.row(["".into(), "".into(), "".into(), format!("  {why}")]);
        }
    }
    if !arguments.common.json {
        table.print();
    }
    Ok(())
}

/// Where the runs of a case and a method lie, but for their seeds.
fn folder_of(folder: &Path, case: &Case, method: &Method) -> PathBuf {
    folder.join(slug(&case.name)).join(slug(&method.name))
}

/// Runs of a case and a method that differ in nothing but their seeds.
struct Part<'a> {
    case: &'a Case,
    method: &'a Method,
    setup: Setup,
    seeds: Vec<u64>,
    out: PathBuf,
    configuration: PathBuf,
}

impl Part<'_> {
    fn sweep(&self, common: Common) -> Sweep<'_> {
        Sweep::new(&self.setup, 1, [&self.out, &self.configuration], common)
    }

    /// Its runs, which have ended.
    fn records(&self) -> Result<Vec<RunRecord>, Failure> {
        let record = |seed: &u64| RunRecord::open(&run_folder(&self.out, *seed));
        Ok(self.seeds.iter().map(record).collect::<Result<_, _>>()?)
    }
}

/// All that is learned for a figure, in the order of its rows.
fn parts<'a>(
    figure: &'a Figure,
    asked: Option<SeedRange>,
    folder: &Path,
) -> Result<Vec<Part<'a>>, Failure> {
    let mut parts = Vec::new();
    for (case, method) in figure.pairs() {
        let seeds = figure.seeds(method, asked)?;
        let out = folder_of(folder, case, method);
        let differs = figure.differs_by_seed(case, method);
        for seeds in seeds.chunks(if differs { 1 } else { seeds.len() }) {
            let name = if differs { format!("-s{}.toml", seeds[0]) } else { ".toml".to_owned() };
            parts.push(Part {
                case,
                method,
                setup: figure.setup(case, method, seeds[0])?,
                seeds: seeds.to_vec(),
                configuration: suffixed(&out, &name),
                out: out.clone(),
            });
        }
    }
    Ok(parts)
}

fn reproduce(figure: &Figure, arguments: &ReproduceArguments) -> Outcome {
    if !figure.has_runs() {
        let (name, state) = (&figure.name, figure.state.name());
        let reason = format!("`{name}` ({state}) takes no runs: {}", figure.why);
        return Err(Failure::new(Exit::Usage, reason));
    }
    let folder = arguments.out.join(&figure.name);
    let parts = parts(figure, arguments.seeds, &folder)?;
    let stop = stop_on_signals()?;
    learn(&parts, &stop, arguments.common)?;
    measure_again(figure, &parts, &stop, arguments.common)?;
    let groups = groups(figure, &parts)?;
    let mut came = came(figure, arguments.seeds, &groups)?;
    came.solvers = solvers::beside(&figure.solvers, &folder, arguments.common)?;
    let files = write(figure, &folder, &came, &groups)?;
    if arguments.common.json {
        print_json(&came);
        return Ok(());
    }
    print(&came);
    if !arguments.common.quiet {
        say!();
        say!("{}", figure.why);
        tell!("{} in {}", plural(files, "file"), folder.display());
    }
    Ok(())
}

/// Learns what is missing.
fn learn(parts: &[Part<'_>], stop: &Stop, common: Common) -> Outcome {
    let quiet = Common { quiet: true, json: false, ..common };
    let sweeps: Vec<Sweep<'_>> = parts.iter().map(|part| part.sweep(quiet)).collect();
    let seeds = || {
        sweeps
            .iter()
            .zip(parts)
            .flat_map(|(sweep, part)| part.seeds.iter().map(move |seed| (sweep, *seed)))
    };
    for (sweep, seed) in seeds() {
        sweep.check(seed)?;
    }
    for sweep in &sweeps {
        sweep.write_configuration()?;
    }
    let jobs: Vec<_> = seeds().collect();
    let bar = bar(common, jobs.len() as u64, "runs");
    learn_all(&jobs, 1, stop, || bar.inc(1))?;
    bar.finish_and_clear();
    Ok(())
}

/// Plays what measures ask for beside the evaluation that ended a run, where that was not done yet.
fn measure_again(figure: &Figure, parts: &[Part<'_>], stop: &Stop, common: Common) -> Outcome {
    let runs = parts
        .iter()
        .flat_map(|part| part.seeds.iter().map(|seed| run_folder(&part.out, *seed)))
        .flat_map(|run| figure.measures.iter().map(move |measure| measure.again(&run)));
    let asked = runs.collect::<Result<Vec<_>, _>>()?;
    let missing: Vec<_> = asked.into_iter().flatten().filter(|(_, file)| !file.exists()).collect();
    let bar = bar(common, missing.len() as u64, "evaluations");
    for (evaluation, file) in missing {
        check_stop(stop)?;
        let (_, report) = evaluated(&evaluation)?;
        write_output(&file, &serde_json::to_vec(&report).map_err(Failure::bug)?)?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(())
}

/// The runs of every case and method, of all seeds, in the order of [`Figure::pairs`].
fn groups(figure: &Figure, parts: &[Part<'_>]) -> Result<Vec<Group>, Failure> {
    let group = |(case, method): (&Case, &Method)| {
        let is_one =
            |part: &&Part<'_>| part.case.name == case.name && part.method.name == method.name;
        let runs = parts.iter().filter(is_one).map(Part::records).collect::<Result<Vec<_>, _>>()?;
        Ok(Group { label: method.name.clone(), runs: runs.into_iter().flatten().collect() })
    };
    figure.pairs().map(group).collect()
}

/// What the runs came to, row by row.
fn came<'a>(
    figure: &'a Figure,
    asked: Option<SeedRange>,
    groups: &[Group],
) -> Result<Came<'a>, Failure> {
    let mut rows = Vec::new();
    for ((case, method), Group { runs, .. }) in figure.pairs().zip(groups) {
        let measured = figure.measures.iter().map(|measure| Measured::of(measure, runs));
        let cpu_s = Spread::of(runs.iter().map(|run| run.last().cpu_s));
        rows.push(Row {
            case: &case.name,
            method: &method.name,
            command: figure.words(case, method, "SEED") + " --seed SEED --threads 1",
            seeds: figure.seeds(method, asked)?,
            measures: measured.collect::<Result<_, _>>()?,
            published: method.published.get(&case.name).map(String::as_str),
            cpu_s: cpu_s.ok_or_else(|| Failure::new(Exit::Usage, "there are no seeds"))?,
        });
    }
    let cpu_s = rows.iter().map(|row| row.cpu_s.mean * row.seeds.len() as f64).sum();
    let Figure { name, about, why, .. } = figure;
    Ok(Came { figure: name, about, why, rows, solvers: Vec::new(), cpu_s })
}

/// Writes table and pictures; how many files.
fn write(
    figure: &Figure,
    folder: &Path,
    came: &Came<'_>,
    groups: &[Group],
) -> Result<usize, Failure> {
    let mut files = 3;
    for (case, groups) in figure.cases.iter().zip(groups.chunks(figure.methods.len())) {
        let title = format!("{}: {}", came.figure, case.name);
        let comparison = Comparison::of(&title, groups);
        let place = folder.join(slug(&case.name)).join("comparison");
        files += report::write(&place, groups, &comparison)?.len();
    }
    write_output(&folder.join("picture.svg"), drawn(figure, came)?.as_bytes())?;
    let json = serde_json::to_string_pretty(came).map_err(Failure::bug)? + "\n";
    write_output(&folder.join("table.json"), json.as_bytes())?;
    write_output(&folder.join("table.md"), came.markdown().as_bytes())?;
    Ok(files)
}

/// A picture: a group of bars for each case, by the first measure; for each measure where there is but one case.
fn drawn(figure: &Figure, came: &Came<'_>) -> Result<String, Failure> {
    let labels: Vec<&str> = figure.methods.iter().map(|method| &*method.name).collect();
    let by_measures = figure.cases.len() == 1 && figure.measures.len() > 1;
    let shown = came.rows.first().map_or(0, |row| row.measures.len());
    let shown = if by_measures { shown } else { 1 };
    // Group by group: of several measures one after the other, each of all methods.
    let all = (0..shown).flat_map(|measure| came.rows.iter().map(move |row| (row, measure)));
    let bars = all.filter_map(|(row, measure)| {
        let measured = row.measures.get(measure)?;
        let label = labels.iter().position(|label| *label == row.method)?;
        let group = if by_measures { measured.name } else { row.case };
        Some(Bar { group, label, spread: measured.spread })
    });
    let bars: Vec<Bar<'_>> = bars.collect();
    let (about, ends) = match figure.measures.first() {
        Some(measure) if measure.key == "success" => ("share of solved episodes", [0.0, 1.0]),
        measure => {
            let name = measure.map_or("", |measure| &*measure.name);
            let about = if by_measures { &*figure.about } else { name };
            (about, chart::ends(bars.iter().map(|bar| &bar.spread)))
        }
    };
    let title = format!("{}: {about}", came.figure);
    Ok(chart::draw_bars(&title, &Bars { about, labels, bars, ends })?)
}

fn print(came: &Came<'_>) {
    let names = came.rows.first().map_or(&[][..], |row| &row.measures[..]);
    let mut header = vec!["case", "method"];
    header.extend(names.iter().map(|measure| measure.name));
    header.extend(["CPU s", "published"]);
    let mut table = Table::of_text(&header);
    for row in &came.rows {
        let mut cells = vec![row.case.to_owned(), row.method.to_owned()];
        cells.extend(row.measures.iter().map(Measured::text));
        cells.extend([
            format!("{:.2}", row.cpu_s.mean),
            row.published.unwrap_or_default().to_owned(),
        ]);
        table.row(cells);
    }
    table.print();
    let mut solvers = Table::of_text(&["solver", "by the shortest", "ms an instance", "unsolved"]);
    for it in &came.solvers {
        solvers.row([
            it.solver.clone(),
            format!("{:.4} ± {:.4}", it.over_optimum, it.ci95),
            format!("{:.1}", it.milliseconds),
            it.unsolved.to_string(),
        ]);
    }
    if !came.solvers.is_empty() {
        solvers.print();
    }
    say!("{:.0} seconds of processor time in all runs", came.cpu_s);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_measure_of_a_single_case_is_one_group_of_bars() {
        let text = r#"
            [[figure]]
            name = "f"
            about = "two numbers"
            state = "done"
            why = ""
            seeds = "1..1"
            cases = [{ name = "case", words = "" }]
            measures = [{ name = "early", key = "a" }, { name = "late", key = "b" }]
            methods = [{ name = "one", words = "" }, { name = "other", words = "" }]
        "#;
        let recipes = Recipes::from_text(text, "").expect("a recipe");
        let figure = &recipes.figures[0];
        let spread = |mean: f64| Spread::of([mean]).expect("a number");
        let measured =
            |name, mean| Measured { name, seeds: vec![mean], spread: spread(mean), digits: 2 };
        let row = |method: &'static str| Row {
            case: "case",
            method,
            command: String::new(),
            seeds: vec![1],
            measures: vec![measured("early", 1.0), measured("late", 2.0)],
            published: None,
            cpu_s: spread(1.0),
        };
        let rows = vec![row("one"), row("other")];
        let came = Came {
            figure: "f",
            about: "two numbers",
            why: "",
            rows,
            solvers: Vec::new(),
            cpu_s: 2.0,
        };
        let picture = drawn(figure, &came).expect("a picture");
        for name in ["early", "late"] {
            assert_eq!(picture.matches(name).count(), 1, "{name}");
        }
    }

    #[test]
    fn solvers_that_were_measured_stand_beside_what_was_learned() {
        let folder = tempfile::tempdir().expect("a folder");
        let common = Common { json: false, seed: 1, quiet: true };
        let line = r#"{"solver": "pyvrp 10 ms", "customers": "5-15", "over_optimum": 1.0001, "ci95": 0.0002, "milliseconds": 12.0, "p99": 13.0, "unsolved": 3}"#;
        let file = folder.path().join("solvers.json");
        std::fs::write(&file, format!("{line}\n")).expect("there is room");
        let beside = |words| solvers::beside(words, folder.path(), common);
        assert!(beside("").expect("none were asked for").is_empty());
        let solvers = beside("--sizes 5-15").expect("they were measured");
        let (figure, about, why) = ("f", "two numbers", "because.");
        let came = Came { figure, about, why, rows: Vec::new(), solvers, cpu_s: 2.0 };
        let row = "| pyvrp 10 ms | 1.0001 ± 0.0002 | 12.0 | 3 |";
        assert!(came.markdown().contains(row), "{}", came.markdown());
        std::fs::write(&file, "{").expect("there is room");
        assert!(beside("--sizes 5-15").expect_err("cut").message.contains("solvers.json"));
    }
}
