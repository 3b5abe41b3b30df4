//! A run's folder: what was learned, how, and how well.
//!
//! | file | content |
//! | --- | --- |
//! | `train.toml` | method, version, seed, threads, and the complete configuration |
//! | `curve.json` | one JSON object per evaluation, see [`CurvePoint`] |
//! | `curve.csv` | the same as comma-separated values |
//! | `events.out.tfevents.*` | the same for TensorBoard, and how training goes in between, a file per session, see [`RunEvents`](crate::report::RunEvents) |
//! | `curve.svg` | success against environment steps |
//! | `lock` | the number of the process that learns here; held by the kernel as long as it lives |
//! | `result.json` | of a finished run: greedy success on fresh episodes, see [`RunResult`] |
//! | `checkpoints/` | the newest checkpoints, see [`checkpoint`] |

pub mod chart;
pub mod checkpoint;
mod config;
mod counters;
mod curve;
mod description;
mod difference;
mod folder;
mod learning;
mod meter;
mod products;
mod progress;
mod result;
mod settings;

use std::path::Path;

pub use checkpoint::{Checkpoint, Checkpoints};
pub use config::RunConfig;
pub(crate) use counters::{Counters, Level};
pub use counters::{EpisodeCounts, Reports, UpdateReport};
pub use curve::CurvePoint;
pub(crate) use description::KEYS;
pub use description::{Configuration, RunDescription};
pub use difference::{Difference, keys_in};
pub(crate) use folder::RunFolder;
pub use learning::Rates;
pub(crate) use learning::{Labels, Learning, learn};
pub use meter::TrainingPoint;
pub use products::replace_products;
pub(crate) use progress::Clock;
pub use progress::{Observer, Outcome, Progress};
pub use result::RunResult;
pub use settings::Settings;

use crate::error::LearnError;
use crate::evaluate::{Agents, Allocate, NetworkTeam};
use crate::methods::alma::UtilityNetwork;
use crate::methods::alma::team_value::TeamValueAllocator;
use crate::methods::paper::allocation::{AllocationCritic, AllocationNetworks, AllocationPolicy};
use crate::methods::paper::low_level::coach::Coach;
use crate::methods::paper::{self, ProposalAllocator};

/// A learned allocator.
#[derive(Clone, Debug, PartialEq)]
pub enum RunAllocator {
    /// The averaged weights of a team-value network.
    TeamValue(UtilityNetwork),
    /// A policy that proposes allocations, and the critic that chooses among them.
    Proposals {
        /// Proposes.
        policy: AllocationPolicy,
        /// Chooses.
        critic: AllocationCritic,
    },
}

/// A finished or running run, opened to use what it learned.
#[derive(Clone, Debug)]
pub struct Run {
    /// How it learns.
    pub description: RunDescription,
    /// Evaluations up to now.
    pub curve: Vec<CurvePoint>,
    /// The agents' weights of the newest sound checkpoint; averaged ones where the run averages.
    pub network: UtilityNetwork,
    /// The recurrent unit of the agents' memory; empty where they have none.
    pub memory_unit: Vec<f32>,
    /// What tells the agents their strategies, if the run learns that.
    pub coach: Option<Coach>,
    /// What the run has learned to allocate with, if it learns that.
    pub allocator: Option<RunAllocator>,
    /// Environment steps at that checkpoint.
    pub env_steps: u64,
    /// Why newer checkpoints were passed over.
    pub refused: Vec<String>,
}

impl Run {
    /// The agents as a team that can be measured.
    pub fn team(&self) -> NetworkTeam<'_> {
        let agents = Agents {
            network: &self.network,
            memory_unit: &self.memory_unit,
            coach: self.coach.as_ref(),
        };
        NetworkTeam::conditioned(agents, self.description.config.subtask())
    }

    /// What the run has learned to allocate with, if it learns that, as something to be measured.
    ///
    /// One that proposes chooses among so many proposals, of which the first is the most probable.
    pub fn learned_allocator(&self, proposals: usize) -> Option<Box<dyn Allocate + '_>> {
        Some(match (self.allocator.as_ref()?, &self.description.config) {
            (RunAllocator::TeamValue(network), Settings::Records(config)) => {
                Box::new(TeamValueAllocator::new(network, config.allocation.team_max))
            }
            (RunAllocator::Proposals { policy, critic }, Settings::Windows(_)) => {
                let networks = AllocationNetworks { policy, critic };
                Box::new(ProposalAllocator::new(networks, proposals).greedy_first())
            }
            _ => return None,
        })
    }

    /// Reads the folder of a run.
    pub fn open(folder: &Path) -> Result<Self, LearnError> {
        let folder = RunFolder::new(folder);
        let description = folder.read_description()?;
        let curve = folder.read_curve()?;
        let found = folder.checkpoints().newest(checkpoint::OpenFor::Use)?;
        let (network, memory_unit, coach, allocator) = match &description.config {
            Settings::Records(_) => {
                let average = |network| found.checkpoint.network(network, "average");
                let allocator = found.checkpoint.has("allocator").then(|| average("allocator"));
                let allocator = allocator.transpose()?.map(RunAllocator::TeamValue);
                (average("agents")?, Vec::new(), None, allocator)
            }
            Settings::Windows(config) => (
                found.checkpoint.network("agents", "online")?,
                paper::saved_memory_unit(&found.checkpoint, config)?,
                paper::saved_coach(&found.checkpoint, config)?,
                paper::saved_allocator(&found.checkpoint, config)?,
            ),
        };
        Ok(Self {
            description,
            curve,
            network,
            memory_unit,
            coach,
            allocator,
            env_steps: found.checkpoint.env_steps(),
            refused: found.refused,
        })
    }
}

/// The evaluations of the run in a folder.
pub fn read_curve(folder: &Path) -> Result<Vec<CurvePoint>, LearnError> {
    RunFolder::new(folder).read_curve()
}

/// The name of the method that the run in a folder learns by.
pub fn method_of(folder: &Path) -> Result<String, LearnError> {
    let path = folder.join("train.toml");
    let text = std::fs::read_to_string(&path).map_err(LearnError::file(&path))?;
    let table =
        crate::configuration::parsed(&text).map_err(|error| LearnError::format(&path, error))?;
    let method = table.get("method").and_then(toml::Value::as_str);
    method.map(str::to_owned).ok_or_else(|| LearnError::format(path, "no `method`"))
}

/// How the run in a folder learns.
pub fn read_description<C: Configuration>(folder: &Path) -> Result<RunDescription<C>, LearnError> {
    RunFolder::new(folder).read_description()
}

/// Has the run in a folder learn for so many environment steps: more than it was configured for.
///
/// Nothing else of its configuration changes; its result is void, and it is to be resumed.
pub fn prolong<C: Configuration>(folder: &Path, steps: u64) -> Result<(), LearnError> {
    let files = RunFolder::claim(folder)?;
    let mut description: RunDescription<C> = files.read_description()?;
    let before = std::mem::replace(&mut description.config.run_mut().steps, steps);
    if steps < before {
        let reason = format!("`run.steps` is {before} already: a run can only be made longer");
        return Err(LearnError::taken(folder, reason));
    }
    description.config.check()?;
    if steps > before { files.rewrite_description(&description) } else { Ok(()) }
}
