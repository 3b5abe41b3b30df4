//! `sortie up`: a team as supervised processes that go on whatever dies.

use std::path::PathBuf;
use std::process::{Command, Stdio};

use clap::{Args, ValueEnum};
use sortie_core::World;
use sortie_core::wire::Role;
use sortie_ipc::{
    Charge, Domain, DomainContract, DomainFacts, Error, RestartPolicy, SupervisorEvent,
    group_agents, supervise,
};

use super::team::{Scheduling, Team, check_cores, without};
use super::world::{Playing, open_world};
use crate::allocation::AllocatorChoice;
use crate::allocator::{DeployedAllocator, ProposalArguments};
use crate::deployment::domain_contract;
use crate::failure::{Exit, Failure, Outcome};
use crate::line::{LineArguments, Place};
use crate::output::{Common, tell, wrapped};
use crate::policy::{Backend, DeployedPolicy};
use crate::terminal::{line_width, stop_on_signals};
use crate::trust::TrustArguments;

/// Keep a bundle's team running: world, runners, a leading allocator and its standbys, supervised
///
/// Any process may be killed at any time: agents without a runner play the fallback action, a standby takes
/// over from the allocator, and whoever died is started again. Ctrl-C ends all and leaves nothing in shared
/// memory.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie up models/save-the-city
  sortie up models/save-the-city --isolate --episodes 100 --rate 200
  sortie up models/save-the-city --private
  sortie up models/better --trust keys/
  sortie up models/save-the-city --rate 100 --away 3,4 --listen 192.168.1.5:7447 --key line.key
  sortie up models/save-the-city --rate 100 --allocator-listen 192.168.1.5:7448 --key line.key
  sortie up models/save-the-city --domain north --standbys 2 --restart never")]
pub(crate) struct UpArguments {
    /// Folder of the bundle
    bundle: PathBuf,
    #[command(flatten)]
    playing: Playing,
    /// Who assigns agents to subtasks [default: learned where the bundle has it, else coordinated]
    #[arg(long, value_enum)]
    allocation: Option<AllocatorChoice>,
    #[command(flatten)]
    proposals: ProposalArguments,
    /// What executes the networks
    #[arg(long, value_enum, default_value_t = Backend::Plan)]
    backend: Backend,
    /// One process per agent
    #[arg(long)]
    isolate: bool,
    /// One process per agent, each of which gets only what its agent sees
    #[arg(long)]
    private: bool,
    /// Agents for which `sortie join` acts on another host, in one process
    #[arg(long, value_delimiter = ',', value_name = "AGENTS", conflicts_with = "private")]
    away: Vec<u16>,
    /// Where that host finds this one: IP:PORT, or through zenoh `zenoh/tcp/IP:PORT`
    #[arg(long, value_name = "ADDRESS", default_value_t = Place::loopback())]
    listen: Place,
    /// Where another host's allocator, a candidate like those here, finds this one: `sortie join --allocator`
    #[arg(long, value_name = "ADDRESS")]
    allocator_listen: Option<Place>,
    #[command(flatten)]
    line: LineArguments,
    /// The world acts, by the bundle's policy, for agents whose process is missing
    #[arg(long, conflicts_with = "absent")]
    fill: bool,
    #[command(flatten)]
    scheduling: Scheduling,
    /// World and runners each on a core of their own
    #[arg(long)]
    pin: bool,
    /// Allocators that stand by, ready to take over
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(0..=2))]
    standbys: u32,
    /// Whether a process that died is started again
    #[arg(long, value_enum, default_value_t = Restart::OnFailure)]
    restart: Restart,
    /// Join the domain although its team has another bundle or allocation rule: otherwise that is refused
    #[arg(long)]
    mix_teams: bool,
    #[command(flatten)]
    trust: TrustArguments,
    /// Name that keeps this deployment apart from others on the host
    #[arg(long, env = "SORTIE_DOMAIN", default_value = "default")]
    domain: String,
    #[command(flatten)]
    common: Common,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Restart {
    /// Always, but for one that dies at once again and again
    OnFailure,
    /// The others carry on without it
    Never,
}

pub(crate) fn run(arguments: &UpArguments) -> Outcome {
    arguments.backend.prepare()?;
    let stop = stop_on_signals()?;
    let bundle = arguments.trust.open_bundle(&arguments.bundle)?;
    let seed = arguments.common.seed;
    // Opened here although others will: errors show once, and plans are compiled.
    let world = open_world(&bundle, arguments.playing.env.as_deref(), seed)?;
    arguments.playing.absentees.check(world.shape().agents)?;
    check_away(arguments, world.shape().agents)?;
    let allocation = AllocatorChoice::of_bundle(&bundle, arguments.allocation)?;
    DeployedPolicy::open(&bundle, arguments.backend)?;
    let draws = (seed, arguments.proposals);
    DeployedAllocator::open_for(&bundle, allocation, arguments.backend, draws)?;
    let domain = Domain::new(&arguments.domain)?;
    let team = Team {
        bundle: &arguments.bundle,
        domain: &arguments.domain,
        allocation,
        backend: arguments.backend,
        proposals: arguments.proposals,
        seed,
        private: arguments.private,
        mixes_teams: arguments.mix_teams,
        trust: arguments.trust.keys(),
        parent: None,
    };
    let membership = domain.enter()?;
    let contract =
        DomainContract { mixes_teams: arguments.mix_teams, ..domain_contract(&bundle, allocation) };
    let facts = DomainFacts::new(&contract, world.shape())
        .with_private_frames(arguments.private)
        .with_period(arguments.playing.period());
    membership.check_world(&contract, &facts)?;
    let charges = charges(arguments, &team, world.shape().agents)?;
    let is_told = !arguments.common.quiet && !arguments.common.json;
    if is_told {
        tell!(
            "domain `{}`; by hand, each of these takes the place of a process that is missing:",
            domain.id()
        );
        charges.iter().for_each(|charge| tell!("{}", by_hand(&charge.command)));
    }
    let policy =
        RestartPolicy { never: arguments.restart == Restart::Never, ..RestartPolicy::default() };
    let mut tell = |event: &SupervisorEvent<'_>| {
        if is_told {
            tell!("{event}");
        }
    };
    match supervise(&domain, charges, &policy, &mut tell, &stop) {
        Ok(_) => Ok(()),
        Err(Error::Interrupted) => Err(Failure::new(Exit::Interrupted, "interrupted")),
        // A process that ended by itself has said why.
        Err(error @ Error::Child { status, .. }) if status.code().is_some() => {
            Err(Failure { message: String::new(), ..error.into() })
        }
        Err(error) => Err(error.into()),
    }
}

fn charges(
    arguments: &UpArguments,
    team: &Team<'_>,
    agents: usize,
) -> Result<Vec<Charge>, Failure> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let groups = group_agents(agents, cores, arguments.isolate || arguments.private);
    let groups = without(arguments.playing.absentees.leave_out(groups), &arguments.away);
    if arguments.pin {
        check_cores(1 + groups.len(), cores)?;
    }
    let scheduling = arguments.scheduling;
    let with_flags = |mut charge: Charge, core: Option<usize>| {
        charge.command.args(scheduling.flags(core));
        charge
    };
    let own_core = |index: usize| arguments.pin.then_some(index);
    // Allocators have time: they run wherever there is room.
    let allocators = (0..=arguments.standbys)
        .filter_map(|index| team.allocator(format!("allocator {index}")))
        .map(|charge| with_flags(charge, None));
    let runners =
        (1..).zip(&groups).map(|(index, group)| with_flags(team.runner(group), own_core(index)));
    let world = with_flags(world(arguments, team), own_core(0));
    let stand_in = (!arguments.away.is_empty()).then(|| stand_in(arguments, team));
    let asking =
        arguments.allocator_listen.as_ref().map(|place| stand_in_allocator(arguments, team, place));
    let asking = asking.flatten();
    Ok([world].into_iter().chain(allocators).chain(runners).chain(stand_in).chain(asking).collect())
}

/// Refuses agents that are nobody's to leave to another host, and makes the secret of the lines to others.
fn check_away(arguments: &UpArguments, agents: usize) -> Outcome {
    let UpArguments { away, listen, allocator_listen, playing, line, .. } = arguments;
    let places = (!away.is_empty()).then_some(listen).into_iter().chain(allocator_listen);
    if places.clone().next().is_none() {
        return Ok(());
    }
    let is_absent = |agent: u16| playing.absentees.seats() >> agent & 1 == 1;
    if let Some(agent) =
        away.iter().find(|agent| usize::from(**agent) >= agents || is_absent(**agent))
    {
        let message = format!("there is no agent {agent} to be away, or it is absent");
        return Err(Failure::new(Exit::Usage, message));
    }
    places.clone().try_for_each(|place| line.check(place))?;
    line.key_or_new().map(drop)
}

/// Who stands for the runner on another host.
fn stand_in(arguments: &UpArguments, team: &Team<'_>) -> Charge {
    at_home(arguments, team.stand_in(&arguments.away), &arguments.listen)
}

/// Who stands in for the allocator on another host; none for a team that knows of no subtasks.
fn stand_in_allocator(arguments: &UpArguments, team: &Team<'_>, place: &Place) -> Option<Charge> {
    let mut charge = team.allocator("the stand-in of an allocator".to_owned())?;
    charge.command.arg("--away");
    Some(at_home(arguments, charge, place))
}

/// With what the team's end of a line is told.
fn at_home(arguments: &UpArguments, mut charge: Charge, place: &Place) -> Charge {
    charge.command.arg("--listen").arg(place.to_string());
    arguments.line.put(&mut charge.command);
    charge.command.args(arguments.scheduling.flags(None));
    charge
}

/// The world, which prints the report.
fn world(arguments: &UpArguments, team: &Team<'_>) -> Charge {
    let mut command = team.command("world");
    let Playing { env, episodes, rate, patience, absentees } = &arguments.playing;
    if let Some(env) = env {
        command.arg("--env").arg(env);
    }
    if let Some(episodes) = episodes {
        command.arg("--episodes").arg(episodes.to_string());
    }
    command.arg("--rate").arg(rate.to_string());
    command.arg("--patience").arg(patience.to_string());
    command.args(absentees.flag());
    for (flag, is_set) in [("--json", arguments.common.json), ("--quiet", arguments.common.quiet)] {
        if is_set {
            command.arg(flag);
        }
    }
    if arguments.fill {
        command.arg("--fill");
    }
    command.stdout(Stdio::inherit());
    Charge { name: "the world".to_string(), role: Role::World, agents: 0, command }
}

/// A command as a person types it, over as many lines as it needs.
fn by_hand(command: &Command) -> String {
    const INDENT: &str = "      ";
    const CONTINUED: &str = " \\";
    let program = std::env::args_os().next().unwrap_or_default();
    let words = [program.as_os_str()].into_iter().chain(command.get_args());
    let mut parts: Vec<String> = Vec::new();
    for word in words.map(|word| word.to_string_lossy()) {
        match parts.last_mut() {
            // A flag and its value stay together.
            Some(flag) if flag.starts_with("--") && !word.starts_with("--") => {
                flag.push(' ');
                flag.push_str(&word);
            }
            _ => parts.push(word.into_owned()),
        }
    }
    let lines = wrapped(parts, line_width() - INDENT.len() - CONTINUED.len());
    format!("  {}", lines.join(&format!("{CONTINUED}\n{INDENT}")))
}
