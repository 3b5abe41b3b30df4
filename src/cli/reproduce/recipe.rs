//! What can be redone of the dissertation: a figure or table, the runs that it is made of, and what they came to beside it.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::Parser;
use serde::{Deserialize, Serialize};
use sortie_learn::report::{FinalResult, RunRecord, Spread};
use sortie_learn::session::Setup;

use super::solvers::Solver;
use crate::eval::EvalArguments;
use crate::failure::{Exit, Failure};
use crate::seeds::SeedRange;
use crate::train::{TrainArguments, checked};

/// The recipes that this program brings along.
pub(super) const OWN: &str = include_str!("../../../docs/evidence/reproduce.toml");
/// What stands for the seed in words of a command line.
const SEED: &str = "{seed}";

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Recipes {
    #[serde(rename = "figure")]
    pub(super) figures: Vec<Figure>,
}

/// A figure or table of the dissertation.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Figure {
    pub(super) name: String,
    /// What it shows.
    pub(super) about: String,
    pub(super) state: State,
    /// Why it is not done, or what a reader must know.
    pub(super) why: String,
    /// Seeds of the runs of each case and method.
    #[serde(default)]
    seeds: Option<String>,
    /// Words of all command lines.
    #[serde(default)]
    words: String,
    #[serde(default)]
    pub(super) cases: Vec<Case>,
    #[serde(default)]
    pub(super) measures: Vec<Measure>,
    #[serde(default)]
    pub(super) methods: Vec<Method>,
    /// Words of `benches/routes.py`, which measures solvers of others; none: there are none beside this figure.
    #[serde(default)]
    pub(super) solvers: String,
}

/// How much of it can be redone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum State {
    #[serde(rename = "done")]
    Done,
    #[serde(rename = "partly")]
    Partly,
    #[serde(rename = "not yet")]
    NotYet,
}

impl State {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Done => "done",
            Self::Partly => "partly",
            Self::NotYet => "not yet",
        }
    }
}

/// Where methods are compared.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Case {
    pub(super) name: String,
    words: String,
}

/// What is compared.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Method {
    pub(super) name: String,
    words: String,
    /// Seeds of its runs, where they are not the figure's.
    #[serde(default)]
    seeds: Option<String>,
    /// By cases: what the dissertation says.
    #[serde(default)]
    pub(super) published: BTreeMap<String, String>,
}

/// A number of each run.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Measure {
    pub(super) name: String,
    /// Its name in the files of a run.
    pub(super) key: String,
    #[serde(default = "one")]
    factor: f64,
    #[serde(default = "two")]
    pub(super) digits: usize,
    /// Words of `sortie eval` that say how the run is measured again; none: the evaluation that ended it counts.
    #[serde(default)]
    eval: String,
}

fn one() -> f64 {
    1.0
}

fn two() -> usize {
    2
}

/// A command line of `sortie train` without its program and verb.
#[derive(Debug, Parser)]
#[command(name = "sortie train")]
struct Line {
    #[command(flatten)]
    train: TrainArguments,
}

/// A command line of `sortie eval` without its program and verb.
#[derive(Debug, Parser)]
#[command(name = "sortie eval")]
struct EvalLine {
    #[command(flatten)]
    eval: EvalArguments,
}

impl Measure {
    /// Where a run is measured again: how, and the file in its folder that keeps what came of it.
    pub(super) fn again(&self, run: &Path) -> Result<Option<(EvalArguments, PathBuf)>, Failure> {
        if self.eval.is_empty() {
            return Ok(None);
        }
        let subject = run.display().to_string();
        let all = ["sortie eval", "-q", &subject].into_iter().chain(self.eval.split_whitespace());
        let line = EvalLine::try_parse_from(all).map_err(|error| refused(&self.eval, &error))?;
        Ok(Some((line.eval, self.file(run))))
    }

    fn file(&self, run: &Path) -> PathBuf {
        run.join(format!("eval-{}.json", slug(&self.eval)))
    }
}

fn refused(words: &str, error: &clap::Error) -> Failure {
    let reason = error.to_string();
    Failure::new(Exit::BadData, format!("`{words}`: {}", reason.lines().next().unwrap_or_default()))
}

impl Recipes {
    /// Reads a file, whose seeds and measures have to be sound.
    pub(super) fn from_text(text: &str, place: &str) -> Result<Self, Failure> {
        let recipes: Self = toml::from_str(text).map_err(|error| {
            let reason = error.to_string().trim_end().replace('\n', " ");
            Failure::new(Exit::BadData, format!("{place}: {reason}"))
        })?;
        for figure in &recipes.figures {
            for (_, method) in figure.pairs() {
                figure.seeds(method, None).map_err(|failure| failure.within(place))?;
            }
        }
        Ok(recipes)
    }

    /// The figure of a name.
    pub(super) fn find(&self, name: &str) -> Result<&Figure, Failure> {
        let found = self.figures.iter().find(|figure| figure.name == name);
        found.ok_or_else(|| {
            let runs = self.figures.iter().filter(|figure| figure.has_runs());
            let names: Vec<&str> = runs.map(|figure| figure.name.as_str()).collect();
            let reason = format!("no figure `{name}`; with runs there are {}", names.join(", "));
            Failure::new(Exit::Usage, reason)
        })
    }
}

impl Figure {
    /// Whether anything is learned for it.
    pub(super) fn has_runs(&self) -> bool {
        !self.methods.is_empty() && !self.cases.is_empty()
    }

    /// Cases and methods, a case at a time.
    pub(super) fn pairs(&self) -> impl Iterator<Item = (&Case, &Method)> {
        self.cases.iter().flat_map(|case| self.methods.iter().map(move |method| (case, method)))
    }

    /// Seeds of a method's runs: those that were asked for, else its own, else the figure's.
    pub(super) fn seeds(
        &self,
        method: &Method,
        asked: Option<SeedRange>,
    ) -> Result<Vec<u64>, Failure> {
        let refused = |reason: String| {
            Failure::new(Exit::BadData, format!("figure `{}`: {reason}", self.name))
        };
        let own = method.seeds.as_ref().or(self.seeds.as_ref());
        let own = own.map(|text| text.parse::<SeedRange>()).transpose().map_err(refused)?;
        let none = || refused(format!("method `{}` has no seeds", method.name));
        Ok(asked.or(own).ok_or_else(none)?.iter().collect())
    }

    /// What `sortie train` is told for a case, a method and a seed, but where to.
    pub(super) fn words(&self, case: &Case, method: &Method, seed: &str) -> String {
        let parts = [&method.words, &case.words, &self.words];
        let parts: Vec<&str> = parts.into_iter().map(|part| part.trim()).collect();
        parts.join(" ").trim_end().replace(SEED, seed)
    }

    /// Whether runs of other seeds differ in more than their seeds.
    pub(super) fn differs_by_seed(&self, case: &Case, method: &Method) -> bool {
        self.words(case, method, SEED).contains(SEED)
    }

    /// How runs of a case, a method and a seed learn.
    pub(super) fn setup(&self, case: &Case, method: &Method, seed: u64) -> Result<Setup, Failure> {
        let words = self.words(case, method, &seed.to_string());
        let all = ["sortie train", "--out", "run"].into_iter().chain(words.split_whitespace());
        let place = format!("figure `{}`", self.name);
        let line =
            Line::try_parse_from(all).map_err(|error| refused(&words, &error).within(&place))?;
        let mut setup = checked(&line.train)?;
        setup.run.settle_products()?;
        Ok(setup)
    }
}

/// A name as part of a path.
pub(super) fn slug(name: &str) -> String {
    let letter = |letter: char| if letter.is_alphanumeric() { letter } else { '-' };
    let text: String = name.to_lowercase().chars().map(letter).collect();
    let parts: Vec<&str> = text.split('-').filter(|part| !part.is_empty()).collect();
    parts.join("-")
}

/// A figure's numbers.
#[derive(Debug, Serialize)]
pub(super) struct Came<'a> {
    pub(super) figure: &'a str,
    pub(super) about: &'a str,
    pub(super) why: &'a str,
    pub(super) rows: Vec<Row<'a>>,
    pub(super) solvers: Vec<Solver>,
    /// Processor time of all runs, their evaluations while learning included.
    pub(super) cpu_s: f64,
}

/// A method in a case.
#[derive(Debug, Serialize)]
pub(super) struct Row<'a> {
    pub(super) case: &'a str,
    pub(super) method: &'a str,
    /// What `sortie train` was told.
    pub(super) command: String,
    pub(super) seeds: Vec<u64>,
    pub(super) measures: Vec<Measured<'a>>,
    /// What the dissertation says.
    pub(super) published: Option<&'a str>,
    pub(super) cpu_s: Spread,
}

/// A number over the seeds.
#[derive(Debug, Serialize)]
pub(super) struct Measured<'a> {
    pub(super) name: &'a str,
    pub(super) seeds: Vec<f64>,
    #[serde(flatten)]
    pub(super) spread: Spread,
    #[serde(skip)]
    pub(super) digits: usize,
}

impl Measured<'_> {
    /// `1.99 ± 0.01 (1.97 to 2.00)`
    pub(super) fn text(&self) -> String {
        let (Spread { mean, sd, min, max }, digits) = (self.spread, self.digits);
        match sd {
            Some(sd) => {
                format!("{mean:.digits$} ± {sd:.digits$} ({min:.digits$} to {max:.digits$})")
            }
            None => format!("{mean:.digits$}"),
        }
    }
}

impl<'a> Measured<'a> {
    /// A number of runs that have ended.
    pub(super) fn of(measure: &'a Measure, runs: &[RunRecord]) -> Result<Self, Failure> {
        let value = |run| Ok(measure.factor * measure.number(run)?);
        let seeds = runs.iter().map(value).collect::<Result<Vec<f64>, Failure>>()?;
        let none = || Failure::new(Exit::Bug, "a row without runs; please report this");
        let spread = Spread::of(seeds.iter().copied()).ok_or_else(none)?;
        Ok(Self { name: &measure.name, seeds, spread, digits: measure.digits })
    }
}

impl Measure {
    /// A number of a run: of its last point where it tells of training, else of its final evaluation, or of another one.
    fn number(&self, run: &RunRecord) -> Result<f64, Failure> {
        let found = if self.key.starts_with("training_") {
            run.rows.last().and_then(|row| row.number(&self.key))
        } else if self.eval.is_empty() {
            run.result.as_ref().and_then(|result| self.measured(result))
        } else {
            self.measured(&FinalResult::open(&self.file(&run.folder))?)
        };
        found.ok_or_else(|| missing(&run.folder, &self.key))
    }

    fn measured(&self, result: &FinalResult) -> Option<f64> {
        match &*self.key {
            "success" => Some(result.success),
            "return_mean" => result.return_mean,
            "length_mean" => result.length_mean,
            key => result.metrics().find(|(name, _)| *name == key).map(|(_, value)| value),
        }
    }
}

fn missing(folder: &Path, key: &str) -> Failure {
    let reason = format!("{}: no `{key}` in its files", folder.display());
    Failure::new(Exit::BadData, format!("{reason}: learn it again, or correct the recipe"))
}

impl Row<'_> {
    /// `101 to 103`
    fn seeds(&self) -> String {
        match &self.seeds[..] {
            [first, .., last] => format!("{first} to {last}"),
            seeds => seeds.first().map(u64::to_string).unwrap_or_default(),
        }
    }
}

impl Came<'_> {
    /// A document: the table, what a reader must know, and the command of every row.
    pub(super) fn markdown(&self) -> String {
        let mut text = format!("# {}\n\n{}\n\n", self.figure, self.about);
        let names = self.rows.first().map_or(&[][..], |row| &row.measures[..]);
        let names: Vec<&str> = names.iter().map(|measure| measure.name).collect();
        text += &format!(
            "| case | method | seeds | {} | CPU s a run | published |\n",
            names.join(" | ")
        );
        text += &format!("{}|\n", "| --- ".repeat(names.len() + 5));
        for row in &self.rows {
            let measures: Vec<String> = row.measures.iter().map(Measured::text).collect();
            let (seconds, published) = (row.cpu_s.mean, row.published.unwrap_or_default());
            let measures = measures.join(" | ");
            let [case, method, seeds] = [row.case, row.method, &*row.seeds()];
            text += &format!(
                "| {case} | {method} | {seeds} | {measures} | {seconds:.2} | {published} |\n"
            );
        }
        text += &format!(
            "\nMean ± standard deviation over the seeds, and their range in brackets; {:.0} seconds of processor time. {}\n\n",
            self.cpu_s, self.why
        );
        if !self.solvers.is_empty() {
            text += "| solver | length by the shortest | ms an instance | unsolved |\n| --- | --- | --- | --- |\n";
        }
        for it in &self.solvers {
            let Solver { solver, over_optimum, ci95, milliseconds, unsolved } = it;
            text += &format!(
                "| {solver} | {over_optimum:.4} ± {ci95:.4} | {milliseconds:.1} | {unsolved} |\n"
            );
        }
        if !self.solvers.is_empty() {
            text += "\nSolvers of others on one core, from Python: the mean and its 95 % interval, and the median time.\n\n";
        }
        text += "```sh\n";
        for row in &self.rows {
            text += &format!("sortie train {}\n", row.command);
        }
        text + "```\n"
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_recipe_can_be_learned_and_every_gap_has_its_reason() {
        let recipes = Recipes::from_text(OWN, "docs/evidence/reproduce.toml").unwrap();
        let mut names: Vec<&str> = recipes.figures.iter().map(|it| it.name.as_str()).collect();
        names.sort_unstable();
        assert!(names.is_sorted_by(|a, b| a < b), "twice: {names:?}");
        for figure in &recipes.figures {
            assert!(figure.why.ends_with('.'), "{}", figure.name);
            let is_missing = figure.state == State::NotYet;
            assert!(!(is_missing && figure.has_runs()), "{}", figure.name);
            assert_eq!(figure.has_runs(), !figure.measures.is_empty(), "{}", figure.name);
            for measure in &figure.measures {
                assert!(measure.again(Path::new("run")).is_ok(), "{}", measure.name);
            }
            for (case, method) in figure.pairs() {
                figure.setup(case, method, 1).unwrap_or_else(|error| panic!("{}", error.message));
            }
            for method in &figure.methods {
                let is_case = |name: &String| figure.cases.iter().any(|case| case.name == *name);
                assert!(method.published.keys().all(is_case), "{} {}", figure.name, method.name);
            }
        }
    }

    #[test]
    fn words_of_a_seed_are_those_of_method_case_and_figure() {
        let recipes = Recipes::from_text(OWN, "").unwrap();
        let figure = recipes.find("table-4.1").unwrap();
        let [task, .., flip] = &figure.cases[..] else { panic!("four cases") };
        let multi = figure.methods.iter().find(|method| method.name == "multi").unwrap();
        assert!(figure.differs_by_seed(flip, multi) && !figure.differs_by_seed(task, multi));
        let setup = figure.setup(flip, multi, 103).unwrap();
        assert_eq!(setup.environment.to_string(), "gridworld/flip-2");
        assert_eq!(format!("{:?}", setup.environment.settings["map_seed"]), "Whole(103)");
        assert_eq!((setup.run.steps, setup.run.final_episodes), (1_000_000, 200));
        assert_eq!(figure.setup(task, multi, 103).unwrap().run.steps, 300_000);
    }

    #[test]
    fn a_method_may_have_seeds_of_its_own() {
        let recipes = Recipes::from_text(OWN, "").unwrap();
        let figure = recipes.find("figure-7.3").unwrap();
        let seeds = |name: &str, asked| {
            let method = figure.methods.iter().find(|method| method.name == name).unwrap();
            figure.seeds(method, asked).unwrap()
        };
        assert_eq!(seeds("together", None), [101]);
        assert_eq!(seeds("AQL, after-state critic", None), [201, 202, 203]);
        let asked = Some(SeedRange { first: 7, last: 8 });
        assert_eq!(seeds("AQL, after-state critic", asked), [7, 8]);
    }

    #[test]
    fn broken_recipes_are_refused_with_their_reason() {
        let figure = "[[figure]]\nname = \"f\"\nabout = \"\"\nstate = \"done\"\nwhy = \"\"\n";
        let runs = "cases = [{ name = \"c\", words = \"\" }]\nmethods = [{ name = \"m\", words = \"no-method\" }]\n";
        let seeds = "seeds = \"1..2\"\n";
        for (text, reason) in [
            (figure.replace("done", "soon"), "unknown variant"),
            (figure.to_owned() + "colour = 1\n", "unknown field"),
            (figure.to_owned() + runs, "method `m` has no seeds"),
            (figure.to_owned() + "seeds = \"2..1\"\n" + runs, "no range"),
        ] {
            let failure = Recipes::from_text(&text, "mine.toml").unwrap_err();
            assert!(failure.message.starts_with("mine.toml: "), "{}", failure.message);
            assert!(failure.message.contains(reason), "{}", failure.message);
        }
        let recipes = Recipes::from_text(&(figure.to_owned() + seeds + runs), "").unwrap();
        let [figure] = &recipes.figures[..] else { panic!("one") };
        let failure = figure.setup(&figure.cases[0], &figure.methods[0], 1).unwrap_err();
        assert!(failure.message.contains("no-method"), "{}", failure.message);
    }

    #[test]
    fn names_become_parts_of_paths() {
        for (name, path) in [
            ("task 1", "task-1"),
            ("REFIL (Fixed Oracle)", "refil-fixed-oracle"),
            ("MADDPG+SAC", "maddpg-sac"),
        ] {
            assert_eq!(slug(name), path);
        }
    }
}
