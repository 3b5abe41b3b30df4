//! What was found: for people, for scripts, as a page, and whether it is good enough.

use serde::Serialize;
use sortie_cli::failure::{Exit, Failure, Outcome};
use sortie_cli::output::{Table, say};
use sortie_plans::{Comparison, MOST_DISTANCE};

use crate::document::{Columns, Row, line};

/// The columns of a table of hashes.
pub(super) const COLUMNS: Columns =
    Columns { names: &["bundle", "profile", "decisions", "hash"], keys: 3 };

/// What a target came to.
#[derive(Serialize)]
pub(super) struct Hashed {
    pub(super) target: String,
    /// The kernels of this machine, or the compiler of a board's program.
    pub(super) by: String,
    pub(super) decisions: u64,
    pub(super) hash: String,
    pub(super) equal: bool,
}

/// A target that cannot be run here.
#[derive(Serialize)]
pub(super) struct NotRun {
    pub(super) target: String,
    pub(super) missing: String,
    /// How the command ends, where it was asked for.
    #[serde(skip)]
    pub(super) exit: Option<Exit>,
}

/// How far an engine is from the truth.
#[derive(Serialize)]
pub(super) struct Engine {
    engine: &'static str,
    inputs: usize,
    /// In what 32 bits make right engines err.
    max_distance: Option<f64>,
    max_rel_error: f32,
    action_mismatches: usize,
    refusals_differ: usize,
    #[serde(skip)]
    agrees: bool,
}

#[derive(Serialize)]
pub(super) struct Report {
    name: String,
    profile: &'static str,
    /// What was decided on.
    pub(super) observations: String,
    decisions: u64,
    /// By the kernels that this machine decides by.
    pub(super) hash: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    expected: Option<String>,
    pub(super) targets: Vec<Hashed>,
    pub(super) not_run: Vec<NotRun>,
    pub(super) engines: Vec<Engine>,
    /// Engines that were not found.
    pub(super) not_compared: Vec<&'static str>,
    /// Why no engine is compared with the truth.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) unjudged: Option<String>,
}

impl Engine {
    pub(super) fn new(engine: &'static str, found: Comparison) -> Self {
        Self {
            engine,
            inputs: found.inputs,
            max_distance: found.max_distance,
            max_rel_error: found.max_rel_error,
            action_mismatches: found.action_mismatches,
            refusals_differ: found.refusals_differ,
            agrees: found.agrees(),
        }
    }
}

impl Report {
    /// Of this machine's hashes, the first of which all others are held to.
    pub(super) fn new(name: String, profile: &'static str, host: Vec<Hashed>) -> Self {
        let first = host.first();
        Self {
            name,
            profile,
            observations: String::new(),
            decisions: first.map_or(0, |first| first.decisions),
            hash: first.map_or_else(String::new, |first| first.hash.clone()),
            expected: None,
            targets: host,
            not_run: Vec::new(),
            engines: Vec::new(),
            not_compared: Vec::new(),
            unjudged: None,
        }
    }

    /// Holds all targets to this machine's hash, or to one that is known.
    pub(super) fn expect(&mut self, expected: Option<u64>) {
        self.expected = expected.map(|hash| format!("{hash:016x}"));
        let wanted = self.expected.as_ref().unwrap_or(&self.hash);
        for target in &mut self.targets {
            target.equal = target.hash == *wanted;
        }
    }

    pub(super) fn row(&self) -> Row {
        vec![
            self.name.clone(),
            self.profile.to_owned(),
            self.decisions.to_string(),
            self.hash.clone(),
        ]
    }

    fn target_rows(&self) -> impl Iterator<Item = Row> {
        self.targets.iter().map(|it| {
            let equal = if it.equal { "equal" } else { "OTHER" };
            let cells = [&it.target, &it.decisions.to_string(), &it.hash, equal, &it.by];
            cells.map(str::to_owned).to_vec()
        })
    }

    fn engine_rows(&self) -> impl Iterator<Item = Row> {
        self.engines.iter().map(|it| {
            let rounding = it.max_distance.map_or("-".to_owned(), |most| format!("{most:.1}"));
            vec![
                it.engine.to_owned(),
                it.inputs.to_string(),
                rounding,
                format!("{:.1e}", it.max_rel_error),
                it.action_mismatches.to_string(),
            ]
        })
    }

    /// What is not in the tables.
    fn remarks(&self) -> Vec<String> {
        let not_run = self.not_run.iter();
        let mut remarks: Vec<String> =
            not_run.map(|it| format!("Not run: {}: {}.", it.target, it.missing)).collect();
        match &self.unjudged {
            Some(why) => remarks.push(format!("No engine is compared with the truth: {why}.")),
            None => remarks.push(format!(
                "Rounding: the largest difference from the network in double precision, in what 32 bits make right engines err; \
                 at most {MOST_DISTANCE} for an exact plan. Error: the largest relative one. Other: another action."
            )),
        }
        let missing = self.not_compared.iter().filter(|_| self.unjudged.is_none());
        remarks.extend(
            missing.map(|engine| format!("Not compared, since it is not found: {engine}.")),
        );
        remarks
    }

    pub(super) fn print(&self) {
        let Self { name, profile, observations, decisions, hash, .. } = self;
        say!("{name}, {profile}: {decisions} decisions on {observations}, hash {hash}");
        let mut table = Table::of_text(&TARGETS);
        self.target_rows().for_each(|row| table.row(row));
        table.print();
        if !self.engines.is_empty() {
            say!();
            let mut table = Table::new(&ENGINES);
            self.engine_rows().for_each(|row| table.row(row));
            table.print();
        }
        self.remarks().iter().for_each(|remark| say!("{remark}"));
    }

    /// The same as a page.
    pub(super) fn page(&self) -> String {
        let Self { name, profile, observations, decisions, hash, .. } = self;
        let mut page = format!(
            "# Decisions of {name}\n\nProfile {profile}, {decisions} decisions on {observations}, hash `{hash}`. \
             A target is `equal` where all bits of what it decides are the expected ones.\n\n"
        );
        let mut table = |columns: &[&str], rows: &mut dyn Iterator<Item = Row>| {
            page.push_str(&line(columns));
            page.push_str(&line(&vec!["---"; columns.len()]));
            rows.for_each(|row| page.push_str(&line(&row)));
            page.push('\n');
        };
        table(&TARGETS, &mut self.target_rows());
        if !self.engines.is_empty() {
            table(&ENGINES, &mut self.engine_rows());
        }
        page + &self.remarks().join("\n\n") + "\n"
    }

    /// A target with another hash and an exact plan that is too far from the truth are differences; then comes what was asked
    /// for and could not be run.
    pub(super) fn judge(&self) -> Outcome {
        let wanted = match &self.expected {
            Some(expected) => format!("{expected} is expected"),
            None => format!("this machine has {}", self.hash),
        };
        let others = self.targets.iter().filter(|target| !target.equal);
        let others: Vec<String> =
            others.map(|it| format!("{}, {}: hash {}", it.target, it.by, it.hash)).collect();
        if !others.is_empty() {
            return Err(Failure::difference(format!("{}; {wanted}", others.join("; "))));
        }
        let plan = self.engines.iter().find(|it| it.engine == "plan" && self.profile == "exact");
        if let Some(plan) = plan.filter(|plan| !plan.agrees) {
            let message = format!(
                "the plan is {:.0} times what rounding accounts for from the truth (limit {MOST_DISTANCE}), {} inputs that only one answers",
                plan.max_distance.unwrap_or_default(),
                plan.refusals_differ
            );
            return Err(Failure::difference(message));
        }
        let asked = self.not_run.iter().find_map(|it| Some((it.exit?, it)));
        asked.map_or(Ok(()), |(exit, it)| {
            Err(Failure::new(exit, format!("{}: {}", it.target, it.missing)))
        })
    }
}

const TARGETS: [&str; 5] = ["target", "decisions", "hash", "bits", "by"];
const ENGINES: [&str; 5] = ["engine", "cases", "rounding", "error", "other"];
