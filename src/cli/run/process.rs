//! A process of a team: what `run` and `up` start.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use sortie_bundle::{Bundle, FallbackAllocation};
use sortie_core::Allocator;
use sortie_core::roles::Counters;
use sortie_ipc::{
    AllocatorProcess, Domain, DomainContract, Ended, ProcessSettings, RunnerProcess, Stop,
};

use super::registry::Bundles;
use super::scheduling::Scheduling;
use super::world::{Playing, WorldOfTeam, play};
use crate::allocation::{Allocation, AllocatorChoice};
use crate::allocator::DeployedAllocator;
use crate::deployment::{domain_contract, model_id, open_bundle};
use crate::environment::entry_of;
use crate::failure::{Exit, Failure, Outcome};
use crate::policy::{Backend, DeployedPolicy};
use crate::proposals::ProposalArguments;
use crate::signals::stop_on_signals;
use crate::worlds::rules::{RuleAllocator, rule_allocator};

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
    #[arg(long, value_enum)]
    allocation: Option<AllocatorChoice>,
    #[arg(long, value_enum, default_value_t = Backend::Plan)]
    backend: Backend,
    #[command(flatten)]
    proposals: ProposalArguments,
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// World: every agent gets its own frame; runner: it gets that of its agent
    #[arg(long)]
    private: bool,
    /// World: it acts for agents without a runner
    #[arg(long)]
    fill: bool,
    /// Join a team of another bundle or allocation rule
    #[arg(long)]
    mix_teams: bool,
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
    // A runner acts on whatever allocation comes.
    let allocation = match arguments.role {
        Role::Runner => None,
        _ => AllocatorChoice::of_bundle(&bundle, arguments.allocation)?,
    };
    let mixes_teams = arguments.mix_teams;
    let contract = DomainContract { mixes_teams, ..domain_contract(&bundle, allocation) };
    // Rules run none.
    let runs_network =
        arguments.role == Role::Runner || allocation == Some(AllocatorChoice::Learned);
    let limits = &bundle.manifest().limits;
    let settings = ProcessSettings {
        model: model_id(&bundle),
        is_graph: arguments.backend == Backend::Tract && runs_network,
        entities_max: Some(limits.n_max.into()),
        tasks_max: Some(limits.t_max.into()),
        private: arguments.private,
        parent: arguments.parent,
        linger: arguments.scheduling.linger(),
        real_time: arguments.scheduling.real_time(arguments.core),
    };
    match arguments.role {
        Role::World => {
            let ProcessArguments { backend, seed, json, quiet, fill, .. } = *arguments;
            let ProcessSettings { private, linger, real_time, .. } = settings;
            let world = WorldOfTeam {
                bundle: &bundle,
                contract: &contract,
                allocation,
                backend,
                seed,
                json,
                quiet,
                private,
                fill,
                linger,
                real_time,
            };
            play(&world, &arguments.playing, &domain, &stop)
        }
        Role::Runner => act(arguments, (&bundle, &contract), &domain, &settings, &stop),
        Role::Allocator => {
            allocate(arguments, allocation, (&bundle, &contract), &domain, &settings, &stop)
        }
    }
}

/// A runner: with the bundle that it was started with, then with those that it is told to load.
fn act(
    arguments: &ProcessArguments,
    (bundle, contract): (&Bundle, &DomainContract),
    domain: &Domain,
    settings: &ProcessSettings,
    stop: &Stop,
) -> Outcome {
    let backend = arguments.backend;
    let mut memory = DeployedPolicy::open(bundle, backend)?;
    let mut bundles =
        Bundles::beside(&arguments.bundle, |bundle: &Bundle| DeployedPolicy::open(bundle, backend));
    let mut rule = fallback(bundle)?;
    let mut process = RunnerProcess::join(domain, contract, &arguments.agents, settings, stop)?;
    let ended = loop {
        let mut policy = memory.team()?;
        let rule = rule.as_mut().map(|rule| rule as &mut dyn Allocator);
        let ended = process.act(policy.as_mut(), rule, Some(&mut bundles), stop);
        drop(policy);
        match (ended, bundles.take()) {
            (Ok(Ended::ForNextModel), Some(loaded)) => memory = loaded,
            (ended, _) => break ended,
        }
    };
    let left = process.leave();
    outcome(ended.and(left))
}

/// The rule that every runner falls back to, where the contract says so. It draws nothing: all find the same.
fn fallback(bundle: &Bundle) -> Result<Option<RuleAllocator>, Failure> {
    if bundle.contract().fallback_allocation != FallbackAllocation::Heuristic {
        return Ok(None);
    }
    let rule = Allocation::named("heuristic")?;
    rule_allocator(entry_of(bundle)?, rule, 0).map(Some)
}

/// An allocator: with the bundle that it was started with, then with those that it is told to load.
fn allocate(
    arguments: &ProcessArguments,
    allocation: Option<AllocatorChoice>,
    (bundle, contract): (&Bundle, &DomainContract),
    domain: &Domain,
    settings: &ProcessSettings,
    stop: &Stop,
) -> Outcome {
    let ProcessArguments { backend, seed, proposals, .. } = *arguments;
    let Some(allocation) = allocation else {
        let name = arguments.bundle.display();
        let message = format!("`{name}` knows of no subtasks: there is nothing to allocate");
        return Err(Failure::new(Exit::Usage, message));
    };
    let open =
        |bundle: &Bundle| DeployedAllocator::open(bundle, allocation, backend, seed, proposals);
    let mut memory = open(bundle)?;
    let mut bundles = Bundles::beside(&arguments.bundle, open);
    let mut process = AllocatorProcess::join(domain, contract, settings, stop)?;
    let ended = loop {
        let mut allocator = memory.allocator()?;
        let ended = process.allocate(allocator.as_mut(), Some(&mut bundles), stop);
        drop(allocator);
        match (ended, bundles.take()) {
            (Ok(Ended::ForNextModel), Some(loaded)) => memory = loaded,
            (ended, _) => break ended,
        }
    };
    let left = process.leave();
    outcome(ended.and(left))
}

fn outcome(ended: Result<Counters, sortie_ipc::Error>) -> Outcome {
    match ended {
        Ok(_) => Ok(()),
        // The world tells the person; one line is enough.
        Err(sortie_ipc::Error::Interrupted) => Err(Failure::new(Exit::Interrupted, "")),
        Err(error) => Err(error.into()),
    }
}
