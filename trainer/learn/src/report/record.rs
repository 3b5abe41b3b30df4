//! What a run left in its folder, as far as comparing it needs.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::Value;
use sortie_bundle::files::{MOST_BYTES, read_text};

use super::Row;
use crate::error::{LearnError, Result};
use crate::evaluate::{Score, TeamSuccess};

/// What was run.
pub(crate) const DESCRIPTION: &str = "train.toml";
/// Its evaluations.
pub(crate) const CURVE: &str = "curve.json";
/// Its measure at the end.
pub(crate) const RESULT: &str = "result.json";

/// A run as it is compared; its networks stay on the disk.
#[derive(Clone, Debug)]
pub struct RunRecord {
    /// Its folder.
    pub folder: PathBuf,
    /// How it learns, as `train.toml` has it; empty where there is no such file.
    pub description: toml::Table,
    /// Its seed, where the run or the name of its folder says so.
    pub seed: Option<u64>,
    /// Environment and scenario set, where the run says so.
    pub environment: Option<String>,
    /// What says how good it is.
    pub score: Score,
    /// One point per evaluation, steps ascending; never empty.
    pub curve: Vec<Point>,
    /// All that was written of each evaluation.
    pub rows: Vec<Row>,
    /// The final evaluation, where there is one.
    pub result: Option<FinalResult>,
}

/// One evaluation during training.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Environment steps taken.
    pub env_steps: f64,
    /// Seconds of processor time, all threads together.
    pub cpu_s: f64,
    /// Seconds since the run began, interruptions left out.
    pub wall_s: f64,
    /// Share of solved episodes.
    pub success: f64,
    /// Mean return; not a number where the run does not say so.
    pub return_mean: f64,
}

impl Point {
    /// How good the team was.
    pub fn of(&self, score: Score) -> f64 {
        score.pick(self.success, self.return_mean)
    }
}

/// The evaluation of the learned team on fresh episodes: `result.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FinalResult {
    /// Who allocated.
    pub allocation: Option<String>,
    /// Episodes played.
    pub episodes: usize,
    /// Share of episodes that were solved.
    pub success: f64,
    /// Mean of the team's return.
    pub return_mean: Option<f64>,
    /// Mean number of steps.
    pub length_mean: Option<f64>,
    /// Share of episodes that ran out of time.
    pub timeouts: Option<f64>,
    /// Failed episodes by cause.
    #[serde(default)]
    pub failures: BTreeMap<String, usize>,
    /// Success by team, its kinds as letters.
    #[serde(default)]
    pub by_team: BTreeMap<String, TeamSuccess>,
    /// What else the file says, the environment's metrics among it.
    #[serde(flatten)]
    pub others: BTreeMap<String, Value>,
}

/// Numbers of a final evaluation that are no metrics of an environment.
const NO_METRICS: [&str; 2] = ["seed", "return_sd"];

impl FinalResult {
    /// Reads an evaluation: that at the end of a run, or what `sortie eval --json` said.
    pub fn open(path: &Path) -> Result<Self> {
        let text = read_text(path, MOST_BYTES).map_err(LearnError::file(path))?;
        serde_json::from_str(&text).map_err(|error| LearnError::format(path, error))
    }

    /// Means of the environment's metrics by their names.
    pub fn metrics(&self) -> impl Iterator<Item = (&str, f64)> {
        let others = self.others.iter().filter(|(name, _)| !NO_METRICS.contains(&name.as_str()));
        others.filter_map(|(name, value)| Some((name.as_str(), value.as_f64()?)))
    }
}

impl RunRecord {
    /// Whether a folder holds a run that has been evaluated at least once.
    pub fn is_in(folder: &Path) -> bool {
        folder.join(CURVE).is_file()
    }

    /// Reads the folder of a run, finished or not.
    pub fn open(folder: &Path) -> Result<Self> {
        let rows = read_rows(&folder.join(CURVE))?;
        let curve =
            points(&rows).map_err(|reason| LearnError::format(folder.join(CURVE), reason))?;
        let description = read_description(&folder.join(DESCRIPTION))?;
        let text = |table: &toml::Table, key: &str| Some(table.get(key)?.as_str()?.to_owned());
        let environment = description.get("environment").and_then(toml::Value::as_table);
        let environment = environment
            .and_then(|table| Some(format!("{}/{}", text(table, "name")?, text(table, "set")?)));
        let seed = description.get("seed").and_then(toml::Value::as_integer);
        Ok(Self {
            seed: seed.and_then(|seed| u64::try_from(seed).ok()).or(split_seed(&name(folder)).1),
            score: environment.as_deref().map_or(Score::Success, Score::of_environment),
            environment,
            curve,
            rows,
            result: Some(folder.join(RESULT))
                .filter(|path| path.exists())
                .map(|path| FinalResult::open(&path))
                .transpose()?,
            description,
            folder: folder.to_owned(),
        })
    }

    /// The name of its folder.
    pub fn name(&self) -> String {
        name(&self.folder)
    }

    /// The name of its folder without the seed: `alma` of `runs/alma-s3`.
    pub fn label(&self) -> String {
        split_seed(&self.name()).0
    }

    /// The last evaluation during training.
    pub fn last(&self) -> Point {
        self.curve[self.curve.len() - 1]
    }

    /// Share of solved episodes: of the final evaluation, else of the last one during training.
    pub fn success(&self) -> f64 {
        self.result.as_ref().map_or(self.last().success, |result| result.success)
    }

    /// How good it is: in the final evaluation, else in the last one during training.
    pub fn final_score(&self) -> f64 {
        let returned = self.result.as_ref().and_then(|result| result.return_mean);
        self.score.pick(self.success(), returned.unwrap_or(self.last().return_mean))
    }
}

fn name(folder: &Path) -> String {
    // `.` and `..` have no name of their own.
    let whole = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    whole.file_name().map_or(String::new(), |name| name.to_string_lossy().into_owned())
}

/// Takes `-s<seed>` off the end of a name.
fn split_seed(name: &str) -> (String, Option<u64>) {
    if let Some((label, seed)) = name.rsplit_once("-s")
        && let Ok(seed) = seed.parse()
        && !label.is_empty()
    {
        return (label.to_owned(), Some(seed));
    }
    (name.to_owned(), None)
}

fn read_rows(path: &Path) -> Result<Vec<Row>> {
    let text = read_text(path, MOST_BYTES).map_err(LearnError::file(path))?;
    let row = |(index, line)| {
        Row::from_json(line)
            .map_err(|error| LearnError::format(path, format!("line {}: {error}", index + 1)))
    };
    text.lines().enumerate().map(row).collect()
}

fn points(rows: &[Row]) -> Result<Vec<Point>, String> {
    let point = |(index, row): (usize, &Row)| {
        let number = |name: &str| {
            row.number(name).ok_or_else(|| format!("line {}: `{name}` is no number", index + 1))
        };
        Ok(Point {
            env_steps: number("env_steps")?,
            cpu_s: number("cpu_s")?,
            wall_s: number("wall_s")?,
            success: number("success")?,
            return_mean: row.number("return_mean").unwrap_or(f64::NAN),
        })
    };
    let points = rows.iter().enumerate().map(point).collect::<Result<Vec<_>, String>>()?;
    if points.is_empty() {
        return Err("the run has not been evaluated yet".to_owned());
    }
    if !points.is_sorted_by(|a, b| a.env_steps < b.env_steps && a.cpu_s <= b.cpu_s) {
        return Err("steps and processor time do not ascend".to_owned());
    }
    Ok(points)
}

/// The table of `train.toml`, empty where there is none.
fn read_description(path: &Path) -> Result<toml::Table> {
    if !path.exists() {
        return Ok(toml::Table::new());
    }
    let text = read_text(path, MOST_BYTES).map_err(LearnError::file(path))?;
    text.parse().map_err(|error: toml::de::Error| LearnError::format(path, error.message()))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    const LINES: &str = "{\"env_steps\":10,\"cpu_s\":1.5,\"wall_s\":2,\"success\":0.25,\"new\":7}\n\
                         {\"env_steps\":20,\"cpu_s\":3,\"wall_s\":4,\"success\":0.5,\"new\":8}\n";

    fn run(name: &str, files: &[(&str, &str)]) -> (tempfile::TempDir, PathBuf) {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join(name);
        fs::create_dir(&folder).unwrap();
        for (name, content) in files {
            fs::write(folder.join(name), content).unwrap();
        }
        (place, folder)
    }

    #[test]
    fn a_run_is_read_with_fields_that_this_version_does_not_know() {
        let description =
            "method = \"alma\"\nseed = 4\n\n[environment]\nname = \"e\"\nset = \"s\"\n";
        let result =
            r#"{"episodes":8,"success":0.75,"by_team":{"ab":{"episodes":8,"solved":6}},"x":1}"#;
        let files = [(CURVE, LINES), (DESCRIPTION, description), (RESULT, result)];
        let (_place, folder) = run("a-b-s9", &files);
        assert!(RunRecord::is_in(&folder));
        let record = RunRecord::open(&folder).unwrap();
        assert_eq!((record.label().as_str(), record.seed), ("a-b", Some(4)));
        assert_eq!(record.environment.as_deref(), Some("e/s"));
        assert_eq!(record.last().success, 0.5);
        assert_eq!(record.success(), 0.75);
        assert_eq!(record.rows[1].number("new"), Some(8.0));
    }

    #[test]
    fn a_curve_alone_is_a_run() {
        let (_place, folder) = run("other-s12", &[(CURVE, LINES)]);
        let record = RunRecord::open(&folder).unwrap();
        assert_eq!((record.seed, record.description.len()), (Some(12), 0));
        assert_eq!(record.success(), 0.5);
    }

    #[test]
    fn broken_curves_are_refused_with_their_line() {
        let missing = "{\"env_steps\":10,\"wall_s\":2,\"success\":0.25}\n";
        let twice = LINES.to_owned() + LINES;
        for (content, reason) in [
            ("", "not been evaluated"),
            (missing, "line 1: `cpu_s`"),
            ("{\n", "line 1"),
            (twice.as_str(), "ascend"),
        ] {
            let (_place, folder) = run("run", &[(CURVE, content)]);
            let error = RunRecord::open(&folder).unwrap_err().to_string();
            assert!(error.contains(reason), "{error}");
        }
    }

    #[test]
    fn only_a_number_after_the_last_s_is_a_seed() {
        assert_eq!(split_seed("alma-fast-s3"), ("alma-fast".to_owned(), Some(3)));
        for name in ["alma", "alma-slow", "-s3", "alma-s", "alma-s3x"] {
            assert_eq!(split_seed(name), (name.to_owned(), None));
        }
    }
}
