//! How runs are watched and compared.
//!
//! While a run learns: its curve as CSV ([`to_csv`]) and for TensorBoard. Afterwards, or beside:
//! [`RunRecord`] reads what a run wrote, [`Group`] gathers the seeds of one method, and
//! [`Comparison`] says how methods did, as tables and as pictures ([`chart`]).

pub mod chart;
mod comparison;
mod group;
pub mod numbers;
mod record;
mod row;
mod table;
mod tensorboard;

use std::fs;
use std::path::{Path, PathBuf};

use sortie_bundle::files::{Durability, replace_file};

use crate::error::{LearnError, Result};

use comparison::TeamSummary;
pub use comparison::{Comparison, GroupSummary, Reached, Until};
pub use group::{Axis, Group, Spread};
pub(crate) use record::{CURVE, DESCRIPTION, RESULT};
pub use record::{FinalResult, Point, RunRecord};
pub use row::{Row, to_csv};
pub(crate) use tensorboard::RunEvents;

/// Writes the tables and pictures of a comparison into a folder and returns its files.
///
/// | file | content |
/// | --- | --- |
/// | `curves-steps.svg` | success against environment steps |
/// | `curves-cpu.svg` | success against processor time |
/// | `teams.svg`, `teams.csv` | success by team, where there are final evaluations |
/// | `table.md`, `table.csv`, `table.json` | the figures of [`Comparison`] |
pub fn write(folder: &Path, groups: &[Group], comparison: &Comparison) -> Result<Vec<PathBuf>> {
    let title = &comparison.title;
    let bad = |error: serde_json::Error| LearnError::format(folder, error);
    let mut files = vec![
        ("curves-steps.svg", chart::curves(title, groups, Axis::Steps)?),
        ("curves-cpu.svg", chart::curves(title, groups, Axis::Cpu)?),
        ("table.md", comparison.markdown()),
        ("table.csv", to_csv(&comparison.groups).map_err(bad)?),
        ("table.json", serde_json::to_string_pretty(comparison).map_err(bad)? + "\n"),
    ];
    if let Some(svg) = chart::teams(&format!("{title}: success by team"), comparison)? {
        files.push(("teams.svg", svg));
        files.push(("teams.csv", to_csv(&comparison.teams).map_err(bad)?));
    }
    fs::create_dir_all(folder).map_err(LearnError::file(folder))?;
    let write = |(name, content): &(&str, String)| {
        let path = folder.join(name);
        let written = replace_file(&path, content.as_bytes(), Durability::Cached);
        written.map_err(LearnError::file(&path)).map(|()| path)
    };
    files.iter().map(write).collect()
}

#[cfg(test)]
mod tests {
    use super::comparison::tests::evaluated;
    use super::group::tests::{group, run};
    use super::*;

    fn names(groups: &[Group]) -> Vec<String> {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("new");
        let files = write(&folder, groups, &Comparison::of("t", groups)).unwrap();
        let name = |path: &PathBuf| path.file_name().unwrap().to_string_lossy().into_owned();
        assert!(files.iter().all(|path| fs::metadata(path).unwrap().len() > 0));
        assert_eq!(fs::read_dir(&folder).unwrap().count(), files.len(), "nothing else is left");
        files.iter().map(name).collect()
    }

    #[test]
    fn success_by_team_needs_final_evaluations() {
        let always = ["curves-steps.svg", "curves-cpu.svg", "table.md", "table.csv", "table.json"];
        assert_eq!(names(&[group("a", vec![run(1, &[(10.0, 0.5)])])]), always);
        let with_teams = names(&[group("a", vec![evaluated(1, 0.5, &[("ab", 5)])])]);
        assert_eq!(with_teams[5..], ["teams.svg", "teams.csv"]);
    }
}
