//! A process of a team: what `run` and `up` start.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use sortie_bundle::FallbackAllocation;
use sortie_envs::save_the_city::AllocationRule;
use sortie_ipc::{
    Domain, ProcessSettings, allocator_process, runner_process, runner_process_with_heuristic,
};

use super::scheduling::Scheduling;
use super::world::{Playing, WorldOfTeam, play};
use crate::allocator::DeployedAllocator;
use crate::arguments::AllocatorChoice;
use crate::deployment::{domain_contract, model_id, open_bundle};
use crate::failure::{Exit, Failure, Outcome};
use crate::policy::{Backend, DeployedPolicy};
use crate::proposals::ProposalArguments;
use crate::signals::stop_on_signals;
use crate::worlds::save_the_city::CityAllocator;

/// Run one process of a team: what `run` and `up` start, and what a person may start in its place
#[derive(Debug, Args)]
pub(crate) struct ProcessArguments {
    #[arg(value_enum)]
    role: Role,
    bundle: PathBuf,
    #[arg(long, env = "SORTIE_DOMAIN", default_value = "default")]
    domain: String,
    /// Agents that a runner acts for
    #[arg(long, value_delimiter = ',')]
    agents: Vec<u16>,
    #[arg(long, value_enum, default_value = "coordinated")]
    allocation: AllocatorChoice,
    #[arg(long, value_enum, default_value_t = Backend::Plan)]
    backend: Backend,
    #[command(flatten)]
    proposals: ProposalArguments,
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    scheduling: Scheduling,
    /// Core that it stays on
    #[arg(long)]
    core: Option<usize>,
    /// What a world plays
    #[command(flatten)]
    playing: Playing,
    #[arg(long)]
    json: bool,
    #[arg(long)]
    quiet: bool,
    /// Process with which this one ends
    #[arg(long)]
    parent: Option<u32>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Role {
    World,
    Runner,
    Allocator,
}

pub(crate) fn run(arguments: &ProcessArguments) -> Outcome {
    let stop = stop_on_signals()?;
    let bundle = open_bundle(&arguments.bundle)?;
    let domain = Domain::new(&arguments.domain)?;
    let contract = domain_contract(&bundle);
    let limits = &bundle.manifest().limits;
    let settings = ProcessSettings {
        model: model_id(&bundle),
        entities_max: Some(limits.n_max.into()),
        tasks_max: Some(limits.t_max.into()),
        parent: arguments.parent,
        spin: arguments.scheduling.spin(),
        real_time: arguments.scheduling.real_time(arguments.core),
    };
    let ended = match arguments.role {
        Role::World => {
            let ProcessArguments { allocation, backend, seed, json, quiet, .. } = *arguments;
            let (spin, real_time) = (settings.spin, settings.real_time);
            let world = WorldOfTeam {
                bundle: &bundle,
                allocation,
                backend,
                seed,
                json,
                quiet,
                spin,
                real_time,
            };
            return play(&world, &arguments.playing, &domain, &stop);
        }
        Role::Runner => {
            let mut policy = DeployedPolicy::open(&bundle, arguments.backend)?;
            let mut policy = policy.policy()?;
            let (agents, policy) = (&arguments.agents, policy.as_mut());
            match bundle.contract().fallback_allocation {
                FallbackAllocation::Unallocated => {
                    runner_process(&domain, &contract, agents, policy, &settings, &stop)
                }
                FallbackAllocation::Heuristic => {
                    // A rule that draws nothing: every runner finds the same.
                    let mut rule = CityAllocator::new(AllocationRule::Heuristic, 0);
                    runner_process_with_heuristic(
                        &domain, &contract, agents, policy, &mut rule, &settings, &stop,
                    )
                }
            }
        }
        Role::Allocator => {
            let ProcessArguments { allocation, backend, seed, proposals, .. } = *arguments;
            let mut memory =
                DeployedAllocator::open(&bundle, allocation, backend, seed, proposals)?;
            let mut allocator = memory.allocator()?;
            allocator_process(&domain, &contract, allocator.as_mut(), &settings, &stop)
        }
    };
    match ended {
        Ok(_) => Ok(()),
        // The world tells the person; one line is enough.
        Err(sortie_ipc::Error::Interrupted) => Err(Failure::new(Exit::Interrupted, "")),
        Err(error) => Err(error.into()),
    }
}
