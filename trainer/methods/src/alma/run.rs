//! A run of ALMA, opened to use what it learned.

use std::path::Path;

use sortie_bundle::TRAINING;
use sortie_envs::Spec;
use sortie_learn::LearnError;
use sortie_learn::run::{Checkpoint, CurvePoint, RunDescription, RunFolder, checkpoint};
use sortie_nn::layers::gru::lengths;

use super::Config;
use super::agents::{Learned, UtilityNetwork, network_of};
use super::coach::Coach;
use super::records::team_value::TeamValueAllocator;
use super::teams::{Agents, Allocate, NetworkTeam};
use super::windows::allocation::{AllocationCritic, AllocationNetworks, AllocationPolicy};
use super::windows::{self, PopArt, ProposalAllocator, WindowShape};

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
    /// What it learns by.
    pub config: Config,
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
        NetworkTeam::conditioned(agents, self.config.subtask())
    }

    /// What the run has learned to allocate with, if it learns that, as something to be measured.
    ///
    /// One that proposes chooses among so many proposals, of which the first is the most probable.
    pub fn learned_allocator(&self, proposals: usize) -> Option<Box<dyn Allocate + '_>> {
        Some(match (self.allocator.as_ref()?, &self.config) {
            (RunAllocator::TeamValue(network), Config::Records(config)) => {
                Box::new(TeamValueAllocator::new(network, config.allocation.team_max))
            }
            (RunAllocator::Proposals { policy, critic }, Config::Windows(_)) => {
                let networks = AllocationNetworks { policy, critic };
                Box::new(ProposalAllocator::new(networks, proposals).greedy_first())
            }
            _ => return None,
        })
    }

    /// Reads the folder of a run that learned in such an environment.
    ///
    /// # Errors
    /// There is no sound checkpoint, or its networks are others than its configuration says.
    pub fn open(folder: &Path, spec: &Spec) -> Result<Self, LearnError> {
        let files = RunFolder::new(folder);
        let description = files.read_description()?;
        let config = Config::of(&description.config)
            .map_err(|error| LearnError::format(folder.join(TRAINING), error))?;
        let curve = files.read_curve()?;
        let found = files.checkpoints().newest(checkpoint::OpenFor::Use)?;
        let (network, memory_unit, coach, allocator) = match &config {
            Config::Records(config) => {
                let average = |name, shape| network_of(&found.checkpoint, name, shape);
                let agents = average("agents/average", config.network.shape(spec))?;
                let learns = config.learns_allocator();
                let shape = config.allocator.shape(spec);
                let allocator = learns.then(|| average("allocator/average", shape)).transpose()?;
                (agents, Vec::new(), None, allocator.map(RunAllocator::TeamValue))
            }
            Config::Windows(config) => windows_networks(&found.checkpoint, config, spec)?,
        };
        Ok(Self {
            description,
            config,
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

/// What the run in a folder has learned, as far as another takes it over.
///
/// # Errors
/// There is no sound checkpoint.
pub fn learned(folder: &Path, spec: &Spec) -> Result<Learned, LearnError> {
    let Run { network, memory_unit, allocator, .. } = Run::open(folder, spec)?;
    let team_values = match allocator {
        Some(RunAllocator::TeamValue(network)) => Some(network),
        Some(RunAllocator::Proposals { .. }) | None => None,
    };
    Ok(Learned { network, memory_unit, team_values })
}

/// Agents, the recurrent unit of their memory, what tells them strategies, and what allocates them.
type Networks = (UtilityNetwork, Vec<f32>, Option<Coach>, Option<RunAllocator>);

/// What a run has learned from windows.
fn windows_networks(
    checkpoint: &Checkpoint,
    config: &windows::Config,
    spec: &Spec,
) -> Result<Networks, LearnError> {
    let sizes = WindowShape::of(spec.shape);
    let whole = |name: &str, count: usize| checkpoint.whole_vector(name, count);
    let shape = config.low_level.shape(sizes);
    let agents = network_of(checkpoint, "agents/online", shape)?;
    let memory_unit = match config.low_level.recurrent {
        true => whole("memory/online", lengths(config.low_level.base).iter().sum())?,
        false => Vec::new(),
    };
    let coach = match config.coach.enabled {
        true => {
            let shape = config.low_level.coach(sizes);
            Coach::from_parameters(shape, whole("coach/online", shape.parameters())?)
        }
        false => None,
    };
    if !config.learns_allocator() {
        return Ok((agents, memory_unit, coach, None));
    }
    let shape = config.allocation_learning(sizes).shape;
    let misfit = || LearnError::format(checkpoint.place(), "its allocator does not fit train.toml");
    let critic = whole("critic/online", AllocationCritic::count(shape))?;
    let policy = whole("policy/online", AllocationPolicy::count(shape))?;
    // Which of two allocations is better does not depend on the units of their values.
    let critic = AllocationCritic::from_parameters(shape, critic, PopArt::default());
    let policy = AllocationPolicy::from_parameters(shape, policy);
    let (critic, policy) = (critic.ok_or_else(misfit)?, policy.ok_or_else(misfit)?);
    Ok((agents, memory_unit, coach, Some(RunAllocator::Proposals { policy, critic })))
}
