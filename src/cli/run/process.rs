//! A process of a team: what `run` and `up` start.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use sortie_bundle::{Bundle, FallbackAllocation};
use sortie_core::Allocator;
use sortie_ipc::{
    AllocatorProcess, Domain, DomainContract, ProcessSettings, RunnerProcess, Stop,
    stand_in_allocator_process, stand_in_process,
};
use sortie_line::LineSettings;

use super::registry::{allocators, policies};
use super::team::Scheduling;
use super::world::{Playing, WorldOfTeam, play};
use crate::allocation::{Allocation, AllocatorChoice};
use crate::allocator::{DeployedAllocator, ProposalArguments};
use crate::deployment::{beside, bundle_name, domain_contract, is_bundle_name, model_id};
use crate::environment::entry_of;
use crate::failure::{Exit, Failure, Outcome};
use crate::line::{LineArguments, LineEnd, Place};
use crate::policy::{Backend, DeployedPolicy};
use crate::terminal::stop_on_signals;
use crate::trust::TrustArguments;
use crate::worlds::{RuleAllocator, rule_allocator};

/// Run one process of a team: what `run` and `up` start, and what a person may start in its place
#[derive(Debug, Args)]
pub(crate) struct ProcessArguments {
    #[arg(value_enum)]
    role: Role,
    bundle: PathBuf,
    #[arg(long, env = "SORTIE_DOMAIN", default_value = "default")]
    domain: String,
    /// Stands in for an allocator on another host
    #[arg(long)]
    away: bool,
    /// Agents that a runner acts for, or that a stand-in stands for
    #[arg(long, value_delimiter = ',')]
    agents: Vec<u16>,
    /// Where a stand-in listens for the other host
    #[arg(long, value_name = "ADDRESS", default_value_t = Place::loopback())]
    listen: Place,
    #[command(flatten)]
    line: LineArguments,
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
    #[arg(long, conflicts_with = "absent")]
    fill: bool,
    /// Join a team of another bundle or allocation rule
    #[arg(long)]
    mix_teams: bool,
    #[command(flatten)]
    trust: TrustArguments,
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
    StandIn,
}

pub(crate) fn run(arguments: &ProcessArguments) -> Outcome {
    let stop = stop_on_signals()?;
    let domain = Domain::new(&arguments.domain)?;
    let folder = in_use(&domain, &arguments.bundle, arguments.mix_teams)?;
    let bundle = arguments.trust.open_bundle(&folder)?;
    // A runner acts on whatever allocation comes.
    let allocation = match arguments.role {
        Role::Runner | Role::StandIn => None,
        _ => AllocatorChoice::of_bundle(&bundle, arguments.allocation)?,
    };
    let mixes_teams = arguments.mix_teams;
    let draws = allocation.map(|_| arguments.proposals.draws(arguments.seed));
    let contract = DomainContract { mixes_teams, draws, ..domain_contract(&bundle, allocation) };
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
        world_patience: None,
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
                trust: &arguments.trust,
                linger,
                real_time,
            };
            play(&world, &arguments.playing, &domain, &stop)
        }
        Role::StandIn => {
            let (agents, line) = (&arguments.agents, home_line(arguments)?);
            outcome(stand_in_process(&domain, &contract, agents, line, &settings, &stop))
        }
        Role::Runner => act(arguments, (&bundle, &contract), &domain, &settings, &stop),
        Role::Allocator if arguments.away => {
            let line = home_line(arguments)?;
            outcome(stand_in_allocator_process(&domain, &contract, line, &settings, &stop))
        }
        Role::Allocator => {
            allocate(arguments, allocation, (&bundle, &contract), &domain, &settings, &stop)
        }
    }
}

/// The team's end of the line to another host; of an allocator there it has no agents.
fn home_line(arguments: &ProcessArguments) -> Result<LineSettings, Failure> {
    let ProcessArguments { agents, listen: place, domain, line, .. } = arguments;
    line.settings(&LineEnd { is_home: true, place, domain, agents })
}

/// A runner: with the bundle that it was started with, then with those that its team changes to.
fn act(
    arguments: &ProcessArguments,
    (bundle, contract): (&Bundle, &DomainContract),
    domain: &Domain,
    settings: &ProcessSettings,
    stop: &Stop,
) -> Outcome {
    let backend = arguments.backend;
    let mut memory = DeployedPolicy::open(bundle, backend)?;
    let registry = policies(bundle.folder(), &arguments.trust, backend)?;
    let mut rule = fallback(bundle)?;
    let mut process = RunnerProcess::join(domain, contract, &arguments.agents, settings, stop)?;
    let mut policy = memory.team()?;
    let rule = rule.as_mut().map(|rule| rule as &mut dyn Allocator);
    let ended = process.act(policy.as_mut(), rule, Some(registry), stop);
    let left = process.leave();
    outcome(ended.and(left))
}

/// The rule that every runner falls back to, where the contract says so. It draws nothing: all find the same.
pub(crate) fn fallback(bundle: &Bundle) -> Result<Option<RuleAllocator>, Failure> {
    if bundle.contract().fallback_allocation != FallbackAllocation::Heuristic {
        return Ok(None);
    }
    let rule = Allocation::named("heuristic")?;
    rule_allocator(entry_of(bundle)?, rule, 0).map(Some)
}

/// An allocator: with the bundle that it was started with, then with those that its team changes to.
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
    let open = move |bundle: &Bundle| {
        DeployedAllocator::open(bundle, allocation, backend, seed, proposals)
    };
    let mut memory = open(bundle)?;
    let registry = allocators(bundle.folder(), &arguments.trust, open)?;
    let mut process = AllocatorProcess::join(domain, contract, settings, stop)?;
    let mut allocator = memory.allocator()?;
    let ended = process.allocate(allocator.as_mut(), Some(registry), stop);
    let left = process.leave();
    outcome(ended.and(left))
}

fn outcome<T>(ended: Result<T, sortie_ipc::Error>) -> Outcome {
    match ended {
        Ok(_) => Ok(()),
        // The world tells the person; one line is enough.
        Err(sortie_ipc::Error::Interrupted) => Err(Failure::new(Exit::Interrupted, "")),
        Err(error) => Err(error.into()),
    }
}

/// The bundle that a team decides by: the one named, or the one beside it that a running team has changed to.
fn in_use(domain: &Domain, named: &Path, mixes_teams: bool) -> Result<PathBuf, Failure> {
    let facts = if mixes_teams { None } else { domain.facts()? };
    let name = facts.map(|facts| facts.bundles().in_use().name.clone());
    let changed =
        name.filter(|name| is_bundle_name(name) && bundle_name(named).as_ref() != Some(name));
    Ok(changed.map_or_else(|| named.to_path_buf(), |name| beside(named, &name)))
}
