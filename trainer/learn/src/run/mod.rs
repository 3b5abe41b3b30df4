//! A run's folder: what was learned, how, and how well.
//!
//! | file | content |
//! | --- | --- |
//! | `train.toml` | method, version, seed, threads, and the complete configuration |
//! | `curve.json` | one JSON object per evaluation, see [`CurvePoint`] |
//! | `curve.csv` | the same as comma-separated values |
//! | `events.out.tfevents.*` | the same for TensorBoard, a file per session, see [`RunEvents`] |
//! | `curve.svg` | success against environment steps |
//! | `result.json` | of a finished run: greedy success on fresh episodes, see [`RunResult`] |
//! | `checkpoints/` | the newest checkpoints, see [`checkpoint`] |

pub mod chart;
pub mod checkpoint;
mod counters;
mod curve;
mod description;
mod learning;
mod progress;
mod result;
mod settings;

use std::path::{Path, PathBuf};

pub use checkpoint::{Checkpoint, Checkpoints};
pub(crate) use counters::{Counters, Level};
pub use counters::{EpisodeCounts, UpdateReport};
pub use curve::CurvePoint;
pub(crate) use description::KEYS;
pub use description::{Configuration, RunDescription};
pub(crate) use learning::{Labels, Learning, Rates, learn};
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
use crate::report::{RunEvents, csv};

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
        let (memory_unit, coach) = (&*self.memory_unit, self.coach.as_ref());
        let agents = Agents { network: &self.network, memory_unit, coach };
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

/// How the run in a folder learns.
pub(crate) fn read_description(folder: &Path) -> Result<RunDescription, LearnError> {
    RunFolder::new(folder).read_description()
}

/// The files of a run.
#[derive(Debug)]
pub(crate) struct RunFolder {
    folder: PathBuf,
    events: RunEvents,
}

impl RunFolder {
    pub(crate) fn new(folder: &Path) -> Self {
        Self { folder: folder.to_owned(), events: RunEvents::new(folder) }
    }

    /// Makes the folder; refuses one that holds a run.
    pub(crate) fn create<C: Configuration>(
        folder: &Path,
        description: &RunDescription<C>,
    ) -> Result<Self, LearnError> {
        let run = Self::new(folder);
        if run.description_path().exists() {
            let reason = "holds a run already; resume it, or choose another folder";
            return Err(LearnError::format(folder, reason));
        }
        std::fs::create_dir_all(folder).map_err(LearnError::file(folder))?;
        write_whole(&run.description_path(), description.to_toml()?.as_bytes())?;
        Ok(run)
    }

    pub(crate) fn read_description<C: Configuration>(
        &self,
    ) -> Result<RunDescription<C>, LearnError> {
        let path = self.description_path();
        let text = std::fs::read_to_string(&path).map_err(LearnError::file(&path))?;
        RunDescription::from_toml(&text).map_err(|error| LearnError::format(path, error))
    }

    pub(crate) fn checkpoints(&self) -> Checkpoints {
        Checkpoints::new(&self.folder.join("checkpoints"))
    }

    /// Replaces `curve.json`, `curve.csv` and `curve.svg`, and tells TensorBoard of the newest point.
    pub(crate) fn write_curve(
        &mut self,
        title: &str,
        curve: &[CurvePoint],
    ) -> Result<(), LearnError> {
        let path = self.curve_path();
        let text = curve::to_lines(curve).map_err(|error| LearnError::format(&path, error))?;
        write_whole(&path, text.as_bytes())?;
        let path = self.folder.join("curve.csv");
        let text = csv::to_csv(curve).map_err(|error| LearnError::format(&path, error))?;
        write_whole(&path, text.as_bytes())?;
        self.events.add(curve)?;
        let path = self.folder.join("curve.svg");
        let svg =
            chart::success_curve(title, curve).map_err(|error| LearnError::format(&path, error))?;
        write_whole(&path, svg.as_bytes())
    }

    /// Writes `result.json`.
    pub(crate) fn write_result(&self, result: &RunResult) -> Result<(), LearnError> {
        let path = self.folder.join("result.json");
        let text = serde_json::to_string_pretty(result);
        let text = text.map_err(|error| LearnError::format(&path, error))?;
        write_whole(&path, text.as_bytes())
    }

    fn read_curve(&self) -> Result<Vec<CurvePoint>, LearnError> {
        let path = self.curve_path();
        if !path.exists() {
            return Ok(Vec::new());
        }
        let text = std::fs::read_to_string(&path).map_err(LearnError::file(&path))?;
        curve::from_lines(&text).map_err(|error| LearnError::format(path, error))
    }

    fn description_path(&self) -> PathBuf {
        self.folder.join("train.toml")
    }

    fn curve_path(&self) -> PathBuf {
        self.folder.join("curve.json")
    }
}

/// Replaces a file as a whole: whoever reads it sees the old or the new content, even after a crash.
pub(crate) fn write_whole(path: &Path, content: &[u8]) -> Result<(), LearnError> {
    use std::io::Write;
    let temporary = path.with_extension("tmp");
    let mut file = std::fs::File::create(&temporary).map_err(LearnError::file(&temporary))?;
    file.write_all(content).map_err(LearnError::file(&temporary))?;
    file.sync_all().map_err(LearnError::file(&temporary))?;
    std::fs::rename(&temporary, path).map_err(LearnError::file(path))?;
    sync_folder(path.parent().unwrap_or(Path::new(".")))
}

/// Makes renames in a folder durable.
pub(crate) fn sync_folder(folder: &Path) -> Result<(), LearnError> {
    let handle = std::fs::File::open(folder).map_err(LearnError::file(folder))?;
    handle.sync_all().map_err(LearnError::file(folder))
}
