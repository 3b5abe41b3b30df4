//! A world process.

use std::time::Duration;

use sortie_core::roles::{
    Counters, Identity, Poll, RunnerOptions, RunnerRole, WorldError, WorldObserver, WorldOptions,
    WorldRole,
};
use sortie_core::wire::{Command, ControlReq, ControlStatus, FrameFormat, Role};
use sortie_core::{Policy, World};

use super::bundles::Bundles;
use super::children::Caretaker;
use super::models::{Held, Models, Registry};
use super::runner::{SwappedPolicy, Unready, follow};
use super::{Children, Controlled, Process, drive, linger};
use crate::domain::{BellKind, Domain, DomainContract, DomainFacts, Membership, nanoseconds};
use crate::error::Error;
use crate::iox::{IoxAgent, IoxWorld, LinkSetup, worst_case_bytes};
use crate::process_info::{BUILD, Candidate, ProcessInfo};
use crate::real_time::RealTime;
use crate::stop::{Stop, Wakeable};

/// How long the processes of the team may take to leave.
const GOODBYE_PATIENCE: Duration = Duration::from_secs(2);
/// An agent for which nobody acts in so many ticks in a row is absent.
const ABSENT_AFTER: u32 = 3;

/// How a world treats its team.
#[derive(Clone, Copy, Debug)]
pub struct WorldSettings {
    /// Bit a: agent a must be acted for by a process; others play the fallback action meanwhile.
    pub required: u64,
    /// Bit a: agent a is absent from the first tick on, until a process acts for it: it is not waited for, and
    /// allocators leave it out. In one process, nobody acts for it.
    pub absent: u64,
    /// Whether an allocator is waited for and asked.
    pub allocator: bool,
    /// Longest wait for the required seats and the allocator before the first episode.
    pub join_patience: Duration,
    /// Longest wait for actions; for allocations half of it. Zero = no limit.
    pub patience: Duration,
    /// Episodes to run; `None` = until stopped.
    pub episodes: Option<u32>,
    /// Whether a process that is missing, or misses its time, ends the world; otherwise nothing does, and
    /// agents for which nobody acts play the fallback action.
    pub strict: bool,
    /// Time from frame to frame, of which agents have 80 % to act; zero = as long as the team takes.
    pub period: Duration,
    /// Shortest time between two frames, for onlookers; zero = as fast as the team acts.
    pub tick_interval: Duration,
    /// Whether every agent gets its own frame, with the rows of what it sees, instead of one frame for all: a
    /// runner, which acts for one agent then, never holds what its agent may not see. Only the allocator, if there
    /// is one, gets whole frames. This keeps policies honest; it guards against nobody, since whoever has the same
    /// user id may open any service.
    pub private: bool,
    /// How the processes of the domain wake each other.
    pub bell: BellKind,
    /// How long waits for answers linger before they sleep; with doorbells only. `None` = 100 us, or not at all
    /// with a period or a time between frames.
    pub linger: Option<Duration>,
    /// What the world's thread asks the system for.
    pub real_time: RealTime,
}

impl Default for WorldSettings {
    /// All agents required, strictly, none absent; no allocator, 10 s to join, 2 s to act, no end, no period, no pause.
    fn default() -> Self {
        Self {
            required: u64::MAX,
            absent: 0,
            allocator: false,
            join_patience: Duration::from_secs(10),
            patience: Duration::from_secs(2),
            episodes: None,
            strict: true,
            period: Duration::ZERO,
            tick_interval: Duration::ZERO,
            private: false,
            bell: BellKind::default(),
            linger: None,
            real_time: RealTime::default(),
        }
    }
}

impl WorldSettings {
    fn is_paced(&self) -> bool {
        !self.period.is_zero() || !self.tick_interval.is_zero()
    }

    pub(crate) fn options(
        &self,
        contract: &DomainContract,
        format: FrameFormat,
        term: u32,
    ) -> WorldOptions {
        WorldOptions {
            format,
            identity: Identity { build: BUILD, ..Identity::new(std::process::id(), "world") },
            term,
            required: self.required & format.layout.every_agent(),
            allocator: self.allocator,
            strict: self.strict,
            pipelined: false,
            period_ns: nanoseconds(self.period),
            absent_after: ABSENT_AFTER,
            absent: self.absent,
            join_patience_ns: nanoseconds(self.join_patience),
            patience_ns: nanoseconds(self.patience),
            decision_interval: contract.decision_interval,
            safe_action: contract.safe_action,
            episodes: self.episodes,
            tick_interval_ns: nanoseconds(self.tick_interval),
        }
    }
}

/// Runs `world` as the world of `domain`, in this thread, until its episodes are done.
///
/// `start_team` is called once, as soon as the domain is this world's: it may start runner and
/// allocator processes, which end with this call. They may as well be started by hand.
///
/// # Errors
/// Another world runs, the team does not come or act in time, a process of it fails, or a signal
/// came. Runners and allocator are told to end in any case.
pub fn world_process(
    domain: &Domain,
    contract: &DomainContract,
    world: &mut dyn World,
    settings: &WorldSettings,
    start_team: impl FnOnce(&mut Children) -> Result<(), Error>,
    observer: &mut dyn WorldObserver,
    stop: &Stop,
) -> Result<Counters, Error> {
    play(domain, contract, (world, None), settings, Box::new(start_team), observer, stop)
}

/// As [`world_process`]; the agents for which no process acts are acted for in this one, with `fill`, until one joins
/// for them, and again from the tick on that finds it gone. No agent is required then, and the first episode waits for
/// an allocator only.
///
/// # Errors
/// As [`world_process`], but no seat is missed.
pub fn world_process_with_fill(
    domain: &Domain,
    contract: &DomainContract,
    (world, fill): (&mut dyn World, Fill<'_>),
    settings: &WorldSettings,
    start_team: impl FnOnce(&mut Children) -> Result<(), Error>,
    observer: &mut dyn WorldObserver,
    stop: &Stop,
) -> Result<Counters, Error> {
    play(domain, contract, (world, Some(fill)), settings, Box::new(start_team), observer, stop)
}

/// Starts the processes of a team. Boxed, so that the whole of a world is compiled here and not in every crate that runs one.
type StartTeam<'a> = Box<dyn FnOnce(&mut Children) -> Result<(), Error> + 'a>;

fn play(
    domain: &Domain,
    contract: &DomainContract,
    (world, fill): (&mut dyn World, Option<Fill<'_>>),
    settings: &WorldSettings,
    start_team: StartTeam<'_>,
    observer: &mut dyn WorldObserver,
    stop: &Stop,
) -> Result<Counters, Error> {
    let facts = DomainFacts::new(contract, world.shape())
        .with_bell(settings.bell)
        .with_private_frames(settings.private)
        .with_period(settings.period);
    let format = facts.format()?;
    let membership = domain.enter()?;
    let bytes = worst_case_bytes(&facts)?;
    let lock = membership.lead_world(contract, &facts, bytes)?;
    // Before the first port, whose descriptors children would inherit.
    let mut children = Children::default();
    start_team(&mut children)?;
    let options = settings.options(contract, format, lock.term());
    let mut role = WorldRole::new(options);
    // A world before this one may have changed the bundle.
    let bundles = Bundles::new(membership.facts()?.unwrap_or_else(|| facts.clone()));
    role.begin_with_generation(bundles.generation());
    let (mut link, filling) = {
        let _starting = membership.lock_start()?;
        let (bell, linger) = (facts.bell(), linger(settings.linger, settings.is_paced()));
        let setup = LinkSetup { domain, format, name: "world", bell, linger };
        let link: IoxWorld = match settings.private {
            // What fills seats reads whole frames as well, in this very process.
            true => IoxWorld::open_private(&setup, settings.allocator || fill.is_some())?,
            false => IoxWorld::open(&setup)?,
        };
        let open = |fill| Filling::open(fill, &setup, contract, &membership, options.identity);
        (link, fill.map(open).transpose()?)
    };
    if filling.is_some() {
        role.fill_free_seats();
    }
    let _caretaker = Caretaker::start(domain)?;
    let membership = &membership;
    let mut playing =
        Playing { role, options, world, filling, observer, children, bundles, membership };
    settings.real_time.claim()?;
    let ended = drive(&mut playing, &mut link, stop);
    let Playing { mut role, world, mut children, .. } = playing;
    // A process that failed says more than that its agents no longer act.
    let ended = match ended {
        Err(Error::World(error)) => children.check().and(Err(Error::World(error))),
        other => other,
    };
    let told = role.shut_down(&mut link, world).map_err(into_error);
    if ended.is_err() {
        children.terminate();
    }
    children.finish(GOODBYE_PATIENCE);
    ended.and(told).map(|()| *role.counters())
}

struct Playing<'a, 'f> {
    role: WorldRole,
    options: WorldOptions,
    world: &'a mut dyn World,
    filling: Option<Filling<'f>>,
    observer: &'a mut dyn WorldObserver,
    children: Children,
    bundles: Bundles,
    membership: &'a Membership,
}

impl Process for Playing<'_, '_> {
    type Link = IoxWorld;

    fn poll(&mut self, link: &mut IoxWorld) -> Result<Poll, Error> {
        let Self { role, world, observer, bundles, membership, .. } = self;
        bundles.look(role, membership);
        let mut observer = bundles.watching(role, &mut **observer);
        let polled = role.poll(link, &mut **world, &mut observer).map_err(into_error)?;
        if let Some(leader) = self.role.take_silent_leader() {
            link.ask_to_step_down(leader)?;
        }
        match &mut self.filling {
            Some(filling) => Ok(both(polled, filling.poll(&self.role)?)),
            None => Ok(polled),
        }
    }

    fn look_around(&mut self) -> Result<(), Error> {
        self.children.check()
    }
}

impl Playing<'_, '_> {
    fn prepare(&mut self, request: &ControlReq) -> ControlStatus {
        let status = self.bundles.prepare(request, &self.role, self.membership);
        match &mut self.filling {
            Some(filling) if status == ControlStatus::Done => {
                filling.models.prepare(request.text(), self.bundles.generation())
            }
            _ => status,
        }
    }

    /// The tick after which the first of the absent agents became so.
    fn absent_since(&self) -> u64 {
        let agents = 0..sortie_core::limits::AGENTS;
        agents.filter_map(|agent| self.role.absent_since(agent)).min().unwrap_or(0)
    }
}

impl Controlled for Playing<'_, '_> {
    fn schema(&self) -> u64 {
        self.options.format.schema
    }

    fn tick(&self) -> u64 {
        self.role.tick()
    }

    fn info(&self) -> ProcessInfo {
        let filling = self.filling.as_ref();
        ProcessInfo {
            agents: self.role.joined(),
            absent: self.role.absent(),
            absent_since: self.absent_since(),
            term: Some(self.options.term),
            is_paused: self.role.is_paused(),
            is_degraded: self.role.is_degraded(),
            generation: self.role.generation(),
            candidate: filling.map_or(Candidate::None, |filling| filling.models.candidate()),
            ..ProcessInfo::new(Role::World, &self.options.identity)
        }
    }

    fn counters_mut(&mut self) -> &mut Counters {
        self.role.counters_mut()
    }

    fn obey(&mut self, command: Command, request: &ControlReq) -> ControlStatus {
        match command {
            Command::Pause => self.role.pause(),
            Command::Resume => self.role.resume(),
            Command::ResetEpisode => self.role.reset_episode(),
            Command::ShutDown => self.role.end(),
            Command::PrepareBundle => return self.prepare(request),
            Command::SwapBundle => {
                return self.bundles.change(request, &mut self.role, self.membership);
            }
            _ => return ControlStatus::NotMine,
        }
        ControlStatus::Done
    }
}

pub(crate) fn into_error(error: WorldError) -> Error {
    match error {
        WorldError::Link(error) => Error::Link(error),
        other => Error::World(other),
    }
}

/// What acts for agents without a process.
pub struct Fill<'a> {
    /// Decides for them.
    pub policy: &'a mut dyn Policy,
    /// First 16 bytes of its model's id.
    pub model: [u8; 16],
    /// Opens the models that the team may change to.
    pub registry: Option<Registry<SwappedPolicy>>,
}

/// The runner at work. It takes no seat, so whoever joins finds it free.
struct Filling<'a> {
    link: IoxAgent,
    role: RunnerRole,
    identity: Identity,
    models: Models<Box<dyn Policy + 'a>, SwappedPolicy>,
}

impl<'a> Filling<'a> {
    fn open(
        fill: Fill<'a>,
        setup: &LinkSetup<'_>,
        contract: &DomainContract,
        membership: &Membership,
        world: Identity,
    ) -> Result<Self, Error> {
        let link = IoxAgent::open_within(&LinkSetup { name: "world/fill", ..*setup })?;
        let identity = Identity { model: fill.model, ..world };
        let own = Held { id: fill.model, model: Box::new(fill.policy) as Box<dyn Policy + 'a> };
        let kept: fn(SwappedPolicy) -> Box<dyn Policy + 'a> = |policy| policy;
        let domain = (contract.hash, setup.format.layout.shape());
        let mut models = Models::new(own, fill.registry, kept, domain, link.waker());
        let facts = membership.facts()?;
        if let Some(facts) = &facts {
            models.join(facts.bundles(), contract.mixes_teams);
        }
        let role = RunnerRole::new(RunnerOptions {
            format: setup.format,
            identity,
            agents: 0,
            subtasks: contract.subtasks,
            decision_interval: contract.decision_interval,
            period_ns: facts.map_or(0, |facts| facts.period_ns()),
            safe_action: contract.safe_action,
        });
        Ok(Self { link, role, identity, models })
    }

    /// Acts for the free seats of the world's current frame, if there are some.
    fn poll(&mut self, world: &WorldRole) -> Result<Poll, Error> {
        let free = world.filled();
        self.models.look();
        if free == 0 {
            return Ok(Poll::Wait { until_ns: u64::MAX });
        }
        let Self { link, role, models, identity } = self;
        role.act_for(free);
        role.receive(link)?;
        follow(role, models, link, identity);
        let policy: &mut dyn Policy = match models.in_use() {
            Some(policy) => policy.as_mut(),
            None => &mut Unready,
        };
        Ok(role.answer(link, policy, None)?)
    }
}

/// What two roles of one process want next.
fn both(one: Poll, other: Poll) -> Poll {
    match (one, other) {
        (Poll::Ended, _) => Poll::Ended,
        (Poll::Wait { until_ns: one }, Poll::Wait { until_ns: other }) => {
            Poll::Wait { until_ns: one.min(other) }
        }
        // What the one has sent, the other has to receive.
        _ => Poll::Again,
    }
}
