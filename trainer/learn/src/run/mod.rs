//! A run's folder: what was learned, how, and how well.
//!
//! | file | content |
//! | --- | --- |
//! | `train.toml` | method, version, seed, threads, and the complete configuration |
//! | `curve.json` | one JSON object per evaluation, see [`CurvePoint`] |
//! | `curve.csv` | the same as comma-separated values |
//! | `events.out.tfevents.*` | the same for TensorBoard, and how training goes in between, a file per session |
//! | `curve.svg` | success against environment steps |
//! | `lock` | the number of the process that learns here; held by the kernel as long as it lives |
//! | `result.json` | of a finished run: greedy success on fresh episodes, see [`RunResult`] |
//! | `checkpoints/` | the newest checkpoints, see [`checkpoint`] |

pub mod checkpoint;
mod counters;
mod curve;
mod folder;
mod progress;
mod setup;

use std::path::Path;

use sortie_bundle::files::{MOST_BYTES, MOST_TEXT_BYTES, read_text};
use sortie_nn::layers::products::Products;

use crate::error::{LearnError, Result};
use crate::report::{CURVE, DESCRIPTION};

pub use crate::configuration::RunConfig;
pub use checkpoint::{Checkpoint, Checkpoints};
pub(crate) use counters::{Clock, Counters};
pub use counters::{EpisodeCounts, Level, Rates, Reports, UpdateReport};
pub use curve::{CurvePoint, RunResult};
pub use folder::RunFolder;
pub(crate) use progress::Meter;
pub use progress::{Now, Observer, Outcome, TrainingPoint};
pub use setup::{Difference, EnvironmentChoice, RunDescription, Setup, keys_in};
pub(crate) use setup::{rename_older, renamed};

/// The evaluations of the run in a folder.
pub fn read_curve(folder: &Path) -> Result<Vec<CurvePoint>> {
    let path = folder.join(CURVE);
    if !path.exists() {
        return Ok(Vec::new());
    }
    let text = read_text(&path, MOST_BYTES).map_err(LearnError::file(&path))?;
    curve::from_lines(&text).map_err(|error| LearnError::format(path, error))
}

/// The name of the method that the run in a folder learns by.
pub fn method_of(folder: &Path) -> Result<String> {
    let path = folder.join(DESCRIPTION);
    let text = read_text(&path, MOST_TEXT_BYTES).map_err(LearnError::file(&path))?;
    let table =
        crate::configuration::parsed(&text).map_err(|error| LearnError::format(&path, error))?;
    let method = table.get("method").and_then(toml::Value::as_str);
    method.map(str::to_owned).ok_or_else(|| LearnError::format(path, "no `method`"))
}

/// How the run in a folder learns.
pub fn read_description(folder: &Path) -> Result<RunDescription> {
    RunFolder::new(folder).read_description()
}

/// Has the run in a folder learn for so many environment steps: more than it was configured for.
///
/// Nothing else of its configuration changes; its result is void, and it is to be resumed.
pub fn prolong(folder: &Path, steps: u64) -> Result<()> {
    let files = RunFolder::claim(folder)?;
    let mut description = files.read_description()?;
    let before = std::mem::replace(&mut description.config.run.steps, steps);
    if steps < before {
        let reason = format!("`run.steps` is {before} already: a run can only be made longer");
        return Err(LearnError::taken(folder, reason));
    }
    description.config.check()?;
    if steps > before { files.rewrite_description(&description) } else { Ok(()) }
}

/// Has the run in a folder go on with the widest products of this processor where it lacks those that the run
/// learns with; says which it takes instead.
pub fn replace_products(folder: &Path) -> Result<Option<String>> {
    let files = RunFolder::claim(folder)?;
    let mut description = files.read_description()?;
    let run = &mut description.config.run;
    if run.settled_products().is_ok() {
        return Ok(None);
    }
    run.products = Products::widest().to_string();
    let products = run.products.clone();
    files.rewrite_description(&description)?;
    Ok(Some(products))
}
