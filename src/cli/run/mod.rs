//! `sortie run`: deploys a bundle's team in a built-in world.

mod figures;
mod onlooker;
mod picture;
pub(crate) mod process;
mod registry;
mod report;
mod team;
pub(crate) mod up;
pub mod world;

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use console::Term;
use sortie_bundle::Bundle;
use sortie_core::Allocator;
use sortie_ipc::{
    Children, Domain, DomainContract, InProcess, Stop, WorldSettings, group_agents, run_in_process,
    world_process,
};

use self::onlooker::{Display, Onlooker};
use self::report::{Manner, Setup, report};
use self::team::{Absentees, Team};
use self::world::open_world;
use crate::allocation::{AllocatorChoice, name_of};
use crate::allocator::{DeployedAllocator, ProposalArguments};
use crate::deployment::domain_contract;
use crate::failure::{Exit, Outcome};
use crate::output::Common;
use crate::policy::{Backend, DeployedPolicy};
use crate::terminal::{self, stop_on_signals};
use crate::trust::TrustArguments;
use crate::worlds::world::EnvironmentWorld;

/// Ticks a second at which a person can follow.
const WATCHABLE_HZ: f64 = 10.0;

/// Deploy a bundle's team in its world: world, runners and allocator as processes over shared memory
///
/// Plays episodes, shows them live on a terminal, and ends with success and latency. Ctrl-C ends every
/// process and leaves nothing in shared memory.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie run models/save-the-city
  sortie run models/save-the-city --isolate --episodes 200 --rate 0
  sortie run models/save-the-city --in-process --json")]
pub struct RunArguments {
    /// Folder of the bundle
    bundle: PathBuf,
    /// Scenario set to play; default: the one that the bundle was trained on
    #[arg(long, value_name = "ENV[/SET]")]
    env: Option<String>,
    /// Episodes to play
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..))]
    episodes: u32,
    /// Who assigns agents to subtasks [default: learned where the bundle has it, else coordinated]
    #[arg(long, value_enum)]
    allocation: Option<AllocatorChoice>,
    #[command(flatten)]
    proposals: ProposalArguments,
    /// What executes the networks
    #[arg(long, value_enum, default_value_t = Backend::Plan)]
    backend: Backend,
    /// Seconds to wait for a runner's actions before giving up; for allocations half of it
    #[arg(long, default_value_t = 2.0, value_name = "S", value_parser = positive_seconds)]
    patience: f64,
    /// World, agents and allocator in this process, without shared memory
    #[arg(long, conflicts_with = "isolate")]
    in_process: bool,
    /// One process per agent
    #[arg(long)]
    isolate: bool,
    #[command(flatten)]
    absentees: Absentees,
    /// Ticks a second, 0 for as fast as the team acts; default: 10 on a terminal, else 0
    #[arg(long, value_name = "HZ", value_parser = rate)]
    rate: Option<f64>,
    /// Name that keeps this deployment apart from others on the host
    #[arg(long, env = "SORTIE_DOMAIN", default_value = "default")]
    domain: String,
    #[command(flatten)]
    trust: TrustArguments,
    #[command(flatten)]
    common: Common,
}

fn positive_seconds(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(seconds) if seconds > 0.0 && seconds <= 3600.0 => Ok(seconds),
        _ => Err("expected seconds above 0 and up to 3600".to_string()),
    }
}

fn rate(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(hz) if hz == 0.0 || (0.001..=1e6).contains(&hz) => Ok(hz),
        _ => Err("expected 0, or ticks a second from 0.001 to 1000000".to_string()),
    }
}

pub(crate) fn run(arguments: &RunArguments) -> Outcome {
    arguments.backend.prepare()?;
    let stop = stop_on_signals()?;
    let bundle = arguments.trust.open_bundle(&arguments.bundle)?;
    let seed = arguments.common.seed;
    let mut world = open_world(&bundle, arguments.env.as_deref(), seed)?;
    arguments.absentees.check(sortie_core::World::shape(&world).agents)?;
    let allocation = AllocatorChoice::of_bundle(&bundle, arguments.allocation)?;
    // Opened here even where another process allocates: errors show at once, and plans are compiled.
    let draws = (seed, arguments.proposals);
    let mut allocator = DeployedAllocator::open_for(&bundle, allocation, arguments.backend, draws)?;
    let mut onlooker =
        Onlooker::new(display(arguments), Some(arguments.episodes as usize), &world, None);
    onlooker.listen(&stop);
    let ended = if arguments.in_process {
        let allocator = allocator.as_mut();
        play_in_process(arguments, &bundle, &mut world, allocator, &mut onlooker, &stop)
    } else {
        play_as_processes(arguments, &bundle, &mut world, allocation, &mut onlooker, &stop)
    };
    let ended = match ended {
        // What the view offers is no failure.
        Err(failure) if failure.exit == Exit::Interrupted && onlooker.has_quit() => Ok(()),
        other => other,
    };
    onlooker.restore_terminal();
    let setup = Setup {
        allocation: name_of(allocation).to_string(),
        backend: arguments.backend.name().to_string(),
        rate_hz: pace(arguments),
    };
    let manner = if arguments.common.json { Manner::Json } else { Manner::Tables };
    let spec = world.environment.borrow().spec().clone();
    report(&world.tally.borrow(), &spec, &onlooker, setup, manner, ended.is_ok());
    ended
}

fn display(arguments: &RunArguments) -> Display {
    if arguments.common.json || arguments.common.quiet {
        Display::Silent
    } else if terminal::redraws(&Term::stdout()) {
        Display::Live
    } else {
        Display::Lines
    }
}

/// Ticks a second that the run is held to.
fn pace(arguments: &RunArguments) -> Option<f64> {
    let watched = display(arguments) == Display::Live;
    let rate = arguments.rate.unwrap_or(if watched { WATCHABLE_HZ } else { 0.0 });
    (rate > 0.0).then_some(rate)
}

fn settings(arguments: &RunArguments, allocation: Option<AllocatorChoice>) -> WorldSettings {
    WorldSettings {
        allocator: allocation.is_some(),
        absent: arguments.absentees.seats(),
        patience: Duration::from_secs_f64(arguments.patience),
        episodes: Some(arguments.episodes),
        tick_interval: pace(arguments)
            .map_or(Duration::ZERO, |hz| Duration::from_secs_f64(1.0 / hz)),
        ..WorldSettings::default()
    }
}

fn play_in_process(
    arguments: &RunArguments,
    bundle: &Bundle,
    world: &mut EnvironmentWorld,
    allocator: Option<&mut DeployedAllocator>,
    onlooker: &mut Onlooker,
    stop: &Stop,
) -> Outcome {
    let mut policy = DeployedPolicy::open(bundle, arguments.backend)?;
    let mut policy = policy.team()?;
    let mut allocator = allocator.map(DeployedAllocator::allocator).transpose()?;
    let allocator = allocator.as_mut().map(|allocator| allocator.as_mut() as &mut dyn Allocator);
    let team = InProcess { world, policy: policy.as_mut(), allocator };
    let contract = domain_contract(bundle, None);
    run_in_process(team, &contract, &settings(arguments, None), onlooker, stop)?;
    Ok(())
}

fn play_as_processes(
    arguments: &RunArguments,
    bundle: &Bundle,
    world: &mut EnvironmentWorld,
    allocation: Option<AllocatorChoice>,
    onlooker: &mut Onlooker,
    stop: &Stop,
) -> Outcome {
    // Compiled once here, so that the runners find the plan.
    DeployedPolicy::open(bundle, arguments.backend)?;
    let domain = Domain::new(&arguments.domain)?;
    let agents = sortie_core::World::shape(world).agents;
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let groups = group_agents(agents, cores, arguments.isolate);
    let groups = arguments.absentees.leave_out(groups);
    let team = Team {
        bundle: &arguments.bundle,
        domain: &arguments.domain,
        allocation,
        backend: arguments.backend,
        proposals: arguments.proposals,
        seed: arguments.common.seed,
        private: false,
        mixes_teams: false,
        trust: arguments.trust.keys(),
        parent: Some(std::process::id()),
    };
    let start_team = |children: &mut Children| {
        let runners = groups.iter().map(|group| team.runner(group));
        for mut charge in runners.chain(team.allocator("the allocator".to_string())) {
            children.spawn(charge.name, &mut charge.command)?;
        }
        Ok(())
    };
    let draws = allocation.map(|_| team.proposals.draws(team.seed));
    let contract = DomainContract { draws, ..domain_contract(bundle, allocation) };
    world_process(
        &domain,
        &contract,
        world,
        &settings(arguments, allocation),
        start_team,
        onlooker,
        stop,
    )?;
    Ok(())
}
