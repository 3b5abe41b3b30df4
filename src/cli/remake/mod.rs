//! `sortie remake`: the decisions of a record made again, from the record alone.

mod comparison;
mod contents;
mod observed;
mod playback;
mod reasons;
mod roles;
mod shadow;
pub(crate) mod why;

pub use observed::read_observations;
pub(crate) use shadow::{Shadowed, shadow, shadow_team};

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde::Serialize;
use sortie_bundle::Bundle;
use sortie_core::{Allocator, Policy};

use crate::allocation::AllocatorChoice;
use crate::allocator::{DeployedAllocator, ProposalArguments};
use crate::deployment::model_id;
use crate::failure::{Exit, Failure, Outcome};
use crate::output::{Common, plural, print_json, say};
use crate::policy::{Backend, DeployedPolicy};
use comparison::{Comparison, Difference};
use contents::Contents;
use roles::{Made, Roles, Team};

/// Make every decision of a record again, and name the first that comes out otherwise
///
/// Each action and allocation of a team that was recorded is decided anew, from the frames and by the bundles that the record
/// brings along: the same to the last bit of its utility, whatever machine it was recorded on. Decisions of bundles that it does
/// not bring, of a network that ran in an engine, or about frames that the record lacks, are counted and not made. Exit code 1
/// where one differs.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie remake run.mcap
  sortie remake run.mcap --bundle models/save-the-city --json")]
pub(crate) struct RemakeArguments {
    /// The record, as `sortie record` writes it
    record: PathBuf,
    /// Bundle that decided [default: those that the record brings along]
    #[arg(long, value_name = "FOLDER")]
    bundle: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

/// What came of it, for scripts.
#[derive(Serialize)]
struct Remade<'a> {
    record: &'a Path,
    frames: u64,
    /// Where the record was cut off, if it was.
    torn_at: Option<u64>,
    different: u64,
    #[serde(flatten)]
    made: Made,
    first_difference: Option<&'a Difference>,
}

pub(crate) fn run(arguments: &RemakeArguments) -> Outcome {
    let contents = Contents::read(&arguments.record)?;
    let bundles = contents.bundles(arguments.bundle.as_deref())?;
    let draws = contents.draws();
    let deployed = bundles.iter().map(|bundle| Deployed::open(&contents, bundle, draws));
    let mut deployed = deployed.collect::<Result<Vec<_>, _>>()?;
    let teams = deployed.iter_mut().map(Deployed::team).collect::<Result<_, _>>()?;
    let mut comparison = Comparison::default();
    let mut roles = Roles::new(&contents, &bundles[0], teams, &mut comparison)?;
    contents.replay(&mut |message| roles.hear(message))?;
    let made = roles.end();
    report(arguments, &contents, made, &comparison)
}

/// A bundle that decided in a team, opened once more.
struct Deployed {
    model: u32,
    /// One for each runner, in the order of their numbers.
    policies: Vec<DeployedPolicy>,
    allocator: Option<DeployedAllocator>,
}

impl Deployed {
    /// Agents and allocator, which draws as it is told.
    fn open(
        contents: &Contents,
        bundle: &Bundle,
        draws: (u64, ProposalArguments),
    ) -> Result<Self, Failure> {
        let choice = contents.facts.allocation().map(choice).transpose()?;
        let allocator = DeployedAllocator::open_for(bundle, choice, Backend::Plan, draws)?;
        Ok(Self { allocator, ..Self::open_agents(contents, bundle)? })
    }

    /// Nobody but the agents.
    fn open_agents(contents: &Contents, bundle: &Bundle) -> Result<Self, Failure> {
        contents.check(bundle)?;
        let policies = contents.runners.iter().map(|_| DeployedPolicy::open(bundle, Backend::Plan));
        let policies = policies.collect::<Result<_, _>>()?;
        Ok(Self { model: short_id(bundle), policies, allocator: None })
    }

    fn team(&mut self) -> Result<Team<'_>, Failure> {
        let Self { model, policies, allocator } = self;
        // They stay in this thread, and what hears them out need not leave it.
        let team = |policy| DeployedPolicy::team(policy).map(|policy| policy as Box<dyn Policy>);
        let allocator = allocator.as_mut().map(DeployedAllocator::allocator).transpose()?;
        Ok(Team {
            model: Some(*model),
            policies: policies.iter_mut().map(team).collect::<Result<_, _>>()?,
            allocator: allocator.map(|allocator| allocator as Box<dyn Allocator>),
        })
    }
}

/// A bundle as answers name it: by the first bytes of its id.
fn short_id(bundle: &Bundle) -> u32 {
    let [a, b, c, d, ..] = model_id(bundle);
    u32::from_le_bytes([a, b, c, d])
}

fn choice(name: &str) -> Result<AllocatorChoice, Failure> {
    AllocatorChoice::from_str(name, false).map_err(|_| {
        Failure::new(
            Exit::BadData,
            format!("the record's domain allocates by `{name}`, which is unknown here"),
        )
    })
}

fn report(
    arguments: &RemakeArguments,
    contents: &Contents,
    made: Made,
    comparison: &Comparison,
) -> Outcome {
    let Comparison { different, first_difference, .. } = comparison;
    if arguments.common.json {
        let Contents { frames, torn_at, .. } = *contents;
        let record = &*arguments.record;
        let (different, first_difference) = (*different, first_difference.as_ref());
        print_json(&Remade { record, frames, torn_at, different, made, first_difference });
    } else {
        let [actions, allocations] = [(made.actions, "action"), (made.allocations, "allocation")]
            .map(|(count, what)| plural(count as usize, what));
        say!("{actions} and {allocations} made again, {different} of them otherwise");
        for (count, why) in [
            (made.before_record, "are about a frame or an allocation that the record lacks"),
            (made.of_others, "were decided by another bundle"),
            (made.of_engines, "were decided by a network in an engine"),
            (made.without_memory, "depend on what was remembered before the record began"),
        ] {
            if count > 0 {
                say!("{count} {why}: not made again");
            }
        }
        if let Some(at) = contents.torn_at {
            say!("the record was cut off at byte {at}");
        }
    }
    match first_difference {
        None if made.actions + made.allocations == 0 => {
            Err(Failure::new(Exit::BadData, "there was nothing to make again"))
        }
        None => Ok(()),
        Some(first) => Err(Failure::difference(first.to_string())),
    }
}
