//! `sortie firmware --team`: one agent of a running team is an emulated board at the end of a serial line.

mod device;
mod line;
mod play;
mod report;
#[cfg(test)]
mod tests;

use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;
use std::rc::Rc;
use std::time::Duration;

use clap::Args;
use sortie_bundle::Bundle;
use sortie_cli::allocation::AllocatorChoice;
use sortie_cli::allocator::{DeployedAllocator, ProposalArguments};
use sortie_cli::deployment::domain_contract;
use sortie_cli::failure::{Exit, Failure, Outcome};
use sortie_cli::output::print_json;
use sortie_cli::policy::{Backend, DeployedPolicy};
use sortie_cli::run::world::open_world;
use sortie_cli::terminal;
use sortie_core::World;
use sortie_envs::random::{below, generator};
use sortie_ipc::{DomainContract, DomainFacts};
use sortie_plans::CompileError;

use self::device::{Device, Emulator};
use self::line::Line;
use self::play::{Cast, Setup, play};
use self::report::{Ran, Report};
use super::FirmwareArguments;
use super::numbers::words;
use super::subject::{agent_plans, plan_of_agent};
use super::toolchain::{Board, Program, Toolchain};
use line::Noise;

/// A team of which one agent is a board.
#[derive(Clone, Debug, Args)]
pub(crate) struct TeamArguments {
    /// Have the board act for one agent of a team that plays here, at the end of a serial line
    #[arg(long, conflicts_with_all = ["decisions", "table"])]
    pub(super) team: bool,
    /// Scenario set to play; default: the one that the bundle was trained on
    #[arg(long, value_name = "ENV[/SET]", requires = "team")]
    env: Option<String>,
    /// Episodes to play
    #[arg(long, default_value_t = 20, requires = "team", value_parser = clap::value_parser!(u32).range(1..))]
    episodes: u32,
    /// Change, lose or double one byte in so many on the line, in both directions [default: none]
    #[arg(long, value_name = "ONE_IN", requires = "team", value_parser = clap::value_parser!(u32).range(2..))]
    damage: Option<u32>,
    /// Tear or repeat one packet in so many, or have it come after the next, in both directions [default: none]
    #[arg(long, value_name = "ONE_IN", requires = "team", value_parser = clap::value_parser!(u32).range(2..))]
    disorder: Option<u32>,
    /// Times that the board is switched off and on in the middle of an episode
    #[arg(long, default_value_t = 0, value_name = "COUNT", requires = "team")]
    resets: u32,
}

/// Builds the program, plays, and reports.
pub(super) fn run(
    arguments: &FirmwareArguments,
    bundle: &Bundle,
    sources: &Path,
    toolchain: &Toolchain,
) -> Outcome {
    let (asked, seed) = (&arguments.team, arguments.common.seed);
    let mut world = open_world(bundle, asked.env.as_deref(), seed)?;
    let allocation = AllocatorChoice::of_bundle(bundle, None)?;
    let contract = domain_contract(bundle, allocation);
    let format = DomainFacts::new(&contract, world.shape()).format()?;
    let (agent, profile) = (usize::from(arguments.agent), arguments.profile());
    let plans = agent_plans(bundle, profile)?;
    let (_, plan) = plan_of_agent(bundle, &plans, agent)?;
    let mut arenas = plans.arenas(1).map_err(CompileError::from)?;
    let hidden = plans.policy(&mut arenas).map_err(CompileError::from)?.hidden();
    check(arguments, agent, world.shape().agents, hidden)?;
    check_unguarded(bundle)?;
    let spinner = terminal::spinner(arguments.common);
    spinner.set_message("building the firmware");
    let domain = domain(&contract, format.schema, world.shape(), agent);
    let files = [("SORTIE_PLAN", plan.as_slice().to_vec()), ("SORTIE_DOMAIN", domain)];
    let program = Program { name: "sortie-agent", features: &["team"], files: &files };
    let program = toolchain.build(&arguments.board.machine(), sources, &program)?;
    spinner.set_message("playing with the board");
    let mut emulator = switched_on(arguments, toolchain, &program)?;
    let [mut others, mut own] = [
        DeployedPolicy::open_as(bundle, Backend::Plan, profile)?,
        DeployedPolicy::open_as(bundle, Backend::Plan, profile)?,
    ];
    let (mut others, mut own) = (others.team()?, own.policy()?);
    let draws = (seed, ProposalArguments::default());
    let mut allocator = DeployedAllocator::open_for(bundle, allocation, Backend::Plan, draws)?;
    let mut allocator = allocator.as_mut().map(DeployedAllocator::allocator).transpose()?;
    let tally = Rc::clone(&world.tally);
    let mut cast = Cast {
        world: &mut world,
        others: others.as_mut(),
        own: own.as_mut(),
        allocator: match &mut allocator {
            Some(allocator) => Some(allocator.as_mut()),
            None => None,
        },
    };
    let setup = Setup { contract: &contract, format, agent, episodes: asked.episodes };
    let line = line(asked, seed, &mut emulator)?;
    let played = play(&setup, &mut cast, line)?;
    spinner.finish_and_clear();
    let ran = Ran::new(arguments, bundle, toolchain, agent);
    let report = Report::new(ran, &tally.borrow(), &played);
    if arguments.common.json {
        print_json(&report);
    } else {
        report.print();
    }
    report.verdict()
}

/// A board in a team decides by its plan alone, and would decide on what the bundle's guards refuse.
fn check_unguarded(bundle: &Bundle) -> Outcome {
    if bundle.guards().is_empty() {
        return Ok(());
    }
    let message = "the agents of this bundle are guarded, and a board in a team is not yet: take the bundle without guards";
    Err(Failure::new(Exit::Usage, message))
}

fn check(arguments: &FirmwareArguments, agent: usize, agents: usize, hidden: usize) -> Outcome {
    if arguments.board == Board::CortexM0 {
        let message = "the micro:bit has no room for a team's frames: choose another board";
        return Err(Failure::new(Exit::Usage, message));
    }
    if hidden > 0 {
        let message = "the agents of this bundle remember, and a board in a team does not yet";
        return Err(Failure::new(Exit::Usage, message));
    }
    if agent >= agents {
        let message = format!("there is no agent {agent}: the team has agents 0 to {}", agents - 1);
        return Err(Failure::new(Exit::Usage, message));
    }
    Ok(())
}

/// The board, its first UART at the pipes of this program.
fn switched_on(
    arguments: &FirmwareArguments,
    toolchain: &Toolchain,
    program: &Path,
) -> Result<Emulator, Failure> {
    let mut emulator = toolchain.emulator(&arguments.board.machine(), program);
    emulator.args(["-display", "none", "-monitor", "none"]);
    emulator.args(["-chardev", "stdio,id=line,signal=off", "-serial", "chardev:line"]);
    let again = move || {
        let mut command = Command::new(emulator.get_program());
        command.args(emulator.get_args());
        command
    };
    Emulator::start(again, Duration::from_secs(arguments.limit))
}

/// The line to a board, with the moments at which it is switched off: spread over the episodes, some steps into each.
fn line<'d>(
    asked: &TeamArguments,
    seed: u64,
    device: &'d mut dyn Device,
) -> Result<Line<'d>, Failure> {
    let noise =
        Noise { seed, bytes: asked.damage.unwrap_or(0), packets: asked.disorder.unwrap_or(0) };
    let mut random = generator(seed);
    let resets = (0..asked.resets).map(|reset| {
        let episode = u64::from(reset) * u64::from(asked.episodes) / u64::from(asked.resets);
        (episode as u32, 1 + below(&mut random, 10) as u32)
    });
    Line::new(device, noise, resets.collect::<BTreeSet<_>>())
}

/// What the program on the board knows of the team: the words of `runtime/firmware/src/domain.rs`.
fn domain(
    contract: &DomainContract,
    schema: u64,
    shape: sortie_core::Shape,
    agent: usize,
) -> Vec<u8> {
    let sizes = [shape.agents, shape.entities, shape.tasks, shape.actions, shape.features];
    let head = [schema as u32, (schema >> 32) as u32].into_iter();
    words(head.chain(sizes.map(|size| size as u32)).chain([
        contract.decision_interval,
        contract.subtasks.into(),
        contract.safe_action.map_or(u32::MAX, u32::from),
        agent as u32,
    ]))
}
