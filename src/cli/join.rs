//! `sortie join`: acts for agents of a team that is up on another host.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use sortie_bundle::{Bundle, SubtaskConditioning};
use sortie_core::link::{FrameBlock, LinkError, Serial, packet_bytes};
use sortie_core::roles::{Identity, RunnerOptions, RunnerRole};
use sortie_core::wire::{ABI, FrameFormat};
use sortie_core::{Allocator, Policy};
use sortie_ipc::{BUILD, DomainContract, DomainFacts, Error, HostProcess, Stop, allocator_offer};
use sortie_line::{Away, FarAllocator, FarPoll, FarRunner, LineSettings, Offer, Taken};

use crate::allocation::AllocatorChoice;
use crate::allocator::{DeployedAllocator, ProposalArguments};
use crate::deployment::{domain_contract, model_id};
use crate::failure::{Exit, Failure, Outcome};
use crate::line::{LineArguments, LineEnd, Place};
use crate::output::{plural, tell};
use crate::policy::{Backend, DeployedPolicy};
use crate::terminal::stop_on_signals;
use crate::trust::TrustArguments;

/// How long a team is looked for at first.
const PATIENCE: Duration = Duration::from_secs(10);
const CUT_OFF: &str = "warning: cut off: nothing is heard of the team, and nothing is done";
const HEARD: &str = "the team is heard again";
/// The share of a period that a round trip may take: the rest is for deciding.
const SHARE_OF_PERIOD: f64 = 0.8;
/// The same of an allocator, which has to answer while its agents have time left.
const SHARE_OF_ALLOCATOR: f64 = 0.3;

/// Act for agents of a team that is up on another host, or allocate for it
///
/// The team's host holds their seats and sends what they see, this one decides, by the same bundle and with the same bits as a
/// process there would. A datagram a tick each way, with a session, a number and a checksum made with the key of both: nothing old
/// or of anybody else is acted upon. Where the line is cut the team plays its fallback, this end stops acting and says so, and goes on
/// with the first frame that comes.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  sortie up models/save-the-city --rate 100 --away 3,4 --listen 192.168.1.5:7447 --key line.key    # on the first host
  sortie join 192.168.1.5:7447 models/save-the-city --agents 3,4 --key line.key                    # on the second one
  sortie join zenoh/tcp/192.168.1.5:7447 models/save-the-city --agents 3,4 --key line.key          # through zenoh
  sortie join 192.168.1.5:7448 models/save-the-city --allocator --key line.key     # of `sortie up --allocator-listen ...:7448`")]
pub(crate) struct JoinArguments {
    /// Where the team listens: HOST:PORT, or through zenoh `zenoh/tcp/HOST:PORT`
    #[arg(value_name = "ADDRESS")]
    address: Place,
    /// Folder of the bundle, the same as the team's
    bundle: PathBuf,
    /// Agents to act for: all that the team left to this line
    #[arg(long, value_delimiter = ',', required_unless_present = "allocator")]
    agents: Vec<u16>,
    /// Allocate instead: a candidate beside those on the team's host, which lead while this one is not heard
    #[arg(long, conflicts_with = "agents")]
    allocator: bool,
    /// Who assigns agents to subtasks, the same as the team's [default: learned where the bundle has it, else coordinated]
    #[arg(long, value_enum, requires = "allocator")]
    allocation: Option<AllocatorChoice>,
    #[command(flatten)]
    proposals: ProposalArguments,
    /// Seed of the team, where its allocator draws
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    line: LineArguments,
    /// Through zenoh: the team's domain, by which teams at one router are told apart
    #[arg(long, env = "SORTIE_DOMAIN", default_value = "default")]
    domain: String,
    /// What executes the networks
    #[arg(long, value_enum, default_value_t = Backend::Plan)]
    backend: Backend,
    #[command(flatten)]
    trust: TrustArguments,
}

/// Why a runner acts no more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum End {
    /// The world has ended.
    Over,
    /// Another end of the team is there, which has to be asked anew.
    Replaced,
    Interrupted,
}

pub(crate) fn run(arguments: &JoinArguments) -> Outcome {
    let stop = stop_on_signals()?;
    let JoinArguments { address, domain, agents, line, .. } = arguments;
    line.check(address)?;
    // Before the bundle is opened: another program may go on from here.
    let end = LineEnd { is_home: false, place: address, domain, agents };
    let settings = line.settings(&end)?;
    let bundle = arguments.trust.open_bundle(&arguments.bundle)?;
    if arguments.allocator {
        return allocate(arguments, &settings, &bundle, &stop);
    }
    let mut policy = DeployedPolicy::open(&bundle, arguments.backend)?;
    let offer = Offer {
        abi: ABI,
        contract: bundle.contract().hash(),
        model: model_id(&bundle),
        agents: seats(agents)?,
    };
    let mut play = |taken: Taken| act(&bundle, policy.team()?.as_mut(), &taken, offer, &stop);
    join(arguments, &settings, offer, &stop, &mut play)
}

/// Joins, and anew for as long as another end of the team is there.
fn join(
    arguments: &JoinArguments,
    settings: &LineSettings,
    offer: Offer,
    stop: &Stop,
    play: &mut dyn FnMut(Taken) -> Result<End, Failure>,
) -> Outcome {
    let mut patience = PATIENCE;
    loop {
        let taken = connect(arguments, settings.clone(), offer, patience, stop)?;
        // Who was there once may come again.
        patience = Duration::MAX;
        match play(taken)? {
            End::Over => return Ok(()),
            End::Replaced => {
                tell!("the team's end of the line is another one: joining anew");
            }
            End::Interrupted => return Err(Failure::new(Exit::Interrupted, "interrupted")),
        }
    }
}

fn connect(
    arguments: &JoinArguments,
    settings: LineSettings,
    offer: Offer,
    patience: Duration,
    stop: &Stop,
) -> Result<Taken, Failure> {
    let JoinArguments { address, agents, .. } = arguments;
    let taken = Away::connect(settings, offer, patience, &|| stop.is_set());
    let taken = taken.map_err(|error| Failure::from(Error::from(error)))?;
    let period = Duration::from_nanos(taken.team.period_ns);
    let share = if arguments.allocator { SHARE_OF_ALLOCATOR } else { SHARE_OF_PERIOD };
    if !period.is_zero() && taken.round_trip > period.mul_f64(share) {
        let message = format!(
            "a round trip to {address} takes {}, of a period of {}: the team would have to be slower (--rate)",
            milliseconds(taken.round_trip),
            milliseconds(period)
        );
        return Err(Failure::new(Exit::Mismatch, message));
    }
    let what = match arguments.allocator {
        true => "allocating".to_owned(),
        false => {
            let agents = agents.iter().map(u16::to_string).collect::<Vec<_>>().join(", ");
            format!("acting for agents {agents}")
        }
    };
    tell!("{what}; a round trip takes {}", milliseconds(taken.round_trip));
    Ok(taken)
}

/// Allocates for a team until it ends.
fn allocate(
    arguments: &JoinArguments,
    settings: &LineSettings,
    bundle: &Bundle,
    stop: &Stop,
) -> Outcome {
    let JoinArguments { allocation, backend, seed, proposals, .. } = *arguments;
    let Some(choice) = AllocatorChoice::of_bundle(bundle, allocation)? else {
        let message = format!("`{}` knows of no subtasks", arguments.bundle.display());
        return Err(Failure::new(Exit::Usage, message));
    };
    let mut memory = DeployedAllocator::open(bundle, choice, backend, seed, proposals)?;
    let draws = Some(proposals.draws(seed));
    let contract = DomainContract { draws, ..domain_contract(bundle, Some(choice)) };
    let offer = allocator_offer(&contract, model_id(bundle));
    let mut play = |taken: Taken| Ok(answer(memory.allocator()?.as_mut(), taken.line, stop));
    join(arguments, settings, offer, stop, &mut play)
}

fn answer(allocator: &mut dyn Allocator, line: Away, stop: &Stop) -> End {
    let mut far = FarAllocator::new(line);
    while !stop.is_set() {
        match far.poll(allocator) {
            FarPoll::Again => {}
            FarPoll::Wait { until_ns } => far.wait(until_ns),
            FarPoll::CutOff => tell!("{CUT_OFF}"),
            FarPoll::Heard => tell!("{HEARD}"),
            FarPoll::Replaced => return End::Replaced,
            FarPoll::Ended => return End::Over,
        }
    }
    End::Interrupted
}

/// Acts until the team ends, another one is there, or the user is.
fn act(
    bundle: &Bundle,
    policy: &mut dyn Policy,
    Taken { line, team, .. }: &Taken,
    offer: Offer,
    stop: &Stop,
) -> Result<End, Failure> {
    let facts = DomainFacts::new(&domain_contract(bundle, None), team.shape());
    let format = facts.format()?;
    let rest = line.rest();
    let mut memory = vec![FrameBlock::zeroed(); FrameBlock::for_serial(team.shape())];
    let mut packet = vec![0; packet_bytes(team.shape())];
    let pid = HostProcess { host: team.host, pid: std::process::id() }.id();
    let role = RunnerRole::new(options(bundle, format, team.period_ns, (pid, offer)));
    let failed = |error| Failure::from(Error::from(error));
    let link =
        Serial::new(line.clone(), &rest, format, &mut memory, &mut packet).map_err(failed)?;
    let runner = FarRunner::join(role, link, (line.clone(), &rest), team.period_ns);
    let mut runner = runner.map_err(failed)?;
    let ended = play(&mut runner, policy, stop);
    tell!("{} decided", plural(runner.role().counters().ticks as usize, "tick"));
    ended.map_err(failed)
}

fn options(
    bundle: &Bundle,
    format: FrameFormat,
    period_ns: u64,
    (pid, offer): (u32, Offer),
) -> RunnerOptions {
    let contract = bundle.contract();
    RunnerOptions {
        format,
        identity: Identity { model: offer.model, build: BUILD, ..Identity::new(pid, "away") },
        agents: offer.agents,
        subtasks: contract.subtask_conditioning == SubtaskConditioning::Mask,
        decision_interval: contract.decision_interval,
        period_ns,
        safe_action: contract.safe_action,
    }
}

fn play(
    runner: &mut FarRunner<'_, Serial<'_, Away>>,
    policy: &mut dyn Policy,
    stop: &Stop,
) -> Result<End, LinkError> {
    while !stop.is_set() {
        match runner.poll(policy)? {
            FarPoll::Again => {}
            FarPoll::Wait { until_ns } => runner.wait(until_ns),
            FarPoll::CutOff => tell!("{CUT_OFF}"),
            FarPoll::Heard => tell!("{HEARD}"),
            FarPoll::Replaced => return Ok(End::Replaced),
            FarPoll::Ended => return Ok(End::Over),
        }
    }
    runner.leave()?;
    Ok(End::Interrupted)
}

fn seats(agents: &[u16]) -> Result<u64, Failure> {
    let seat = |agent: &u16| 1_u64.checked_shl((*agent).into());
    let seats = agents.iter().map(seat).try_fold(0, |seats, seat| Some(seats | seat?));
    seats.ok_or_else(|| Failure::new(Exit::Usage, "a team has agents 0 to 63 at most"))
}

fn milliseconds(time: Duration) -> String {
    format!("{:.2} ms", time.as_secs_f64() * 1e3)
}
