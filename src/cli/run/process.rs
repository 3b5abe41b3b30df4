//! A process of a team: what `run` and `up` start.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use sortie_bundle::{Bundle, FallbackAllocation};
use sortie_core::Allocator;
use sortie_core::roles::Counters;
use sortie_core::wire::ControlStatus;
use sortie_ipc::{
    AllocatorProcess, Domain, DomainContract, Ended, LoadedModel, ProcessSettings, Registry,
    RunnerProcess, Stop,
};

use super::team::Scheduling;
use super::world::{Playing, WorldOfTeam, play};
use crate::allocation::{Allocation, AllocatorChoice};
use crate::allocator::{DeployedAllocator, ProposalArguments};
use crate::deployment::{domain_contract, model_id};
use crate::environment::entry_of;
use crate::failure::{Exit, Failure, Outcome};
use crate::output::tell;
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
}

pub(crate) fn run(arguments: &ProcessArguments) -> Outcome {
    let stop = stop_on_signals()?;
    let bundle = arguments.trust.open_bundle(&arguments.bundle)?;
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
        Bundles::beside(arguments, |bundle: &Bundle| DeployedPolicy::open(bundle, backend));
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
pub(crate) fn fallback(bundle: &Bundle) -> Result<Option<RuleAllocator>, Failure> {
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
    let mut bundles = Bundles::beside(arguments, open);
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

/// Most bytes of a key on the wire.
const KEY_BYTES: usize = 32;

/// Whether a text names a bundle of a registry: a folder, never a path.
pub(crate) fn is_key(text: &str) -> bool {
    let is_letter = |byte: u8| byte.is_ascii_alphanumeric() || b"._-".contains(&byte);
    (1..=KEY_BYTES).contains(&text.len()) && !text.starts_with('.') && text.bytes().all(is_letter)
}

/// The folder of bundles, and what one of them was loaded to.
struct Bundles<'a, M, L> {
    folder: PathBuf,
    trust: &'a TrustArguments,
    load: L,
    loaded: Option<M>,
}

impl<'a, M, L: FnMut(&Bundle) -> Result<M, Failure>> Bundles<'a, M, L> {
    /// The bundles beside that of a process, which take the same signatures; `load` makes of one what it works with.
    fn beside(process: &'a ProcessArguments, load: L) -> Self {
        let parent = process.bundle.parent().filter(|parent| !parent.as_os_str().is_empty());
        let folder = parent.unwrap_or(Path::new(".")).to_path_buf();
        Self { folder, trust: &process.trust, load, loaded: None }
    }

    /// What was loaded last, once.
    fn take(&mut self) -> Option<M> {
        self.loaded.take()
    }
}

impl<M, L: FnMut(&Bundle) -> Result<M, Failure>> Registry for Bundles<'_, M, L> {
    fn load(&mut self, key: &str) -> Result<LoadedModel, ControlStatus> {
        let refused = |failure: Failure| {
            tell!("warning: `{key}` is not loaded: {}", failure.message);
            ControlStatus::BadArgument
        };
        if !is_key(key) {
            return Err(ControlStatus::BadArgument);
        }
        let bundle = self.trust.open_bundle(&self.folder.join(key)).map_err(refused)?;
        self.loaded = Some((self.load)(&bundle).map_err(refused)?);
        let limits = &bundle.manifest().limits;
        Ok(LoadedModel {
            contract: bundle.contract().hash(),
            id: model_id(&bundle),
            entities_max: limits.n_max.into(),
            tasks_max: limits.t_max.into(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_a_name_and_no_path() {
        for key in ["a-team", "v1.2_b", &"x".repeat(32)] {
            assert!(is_key(key), "{key}");
        }
        for path in ["", ".", "..", "a/b", "/a", "..\\a", "a b", &"x".repeat(33)] {
            assert!(!is_key(path), "{path}");
        }
    }
}
