//! A runner process.

use sortie_core::link::AgentLink;
use sortie_core::roles::{Counters, Identity, Poll, RunnerOptions, RunnerRole};
use sortie_core::wire::{Command, ControlReq, ControlStatus, Role};
use sortie_core::{Allocator, DecideError, Decision, Observation, Policy, Shape};

use super::abandoned::Abandoned;
use super::children::Parent;
use super::models::{Held, Models, Registry};
use super::{Controlled, Process, ProcessSettings, WORLD_PATIENCE, drive, is_named, linger};
use crate::domain::{Domain, DomainContract, Lock, Membership};
use crate::error::Error;
use crate::iox::{IoxAgent, LinkSetup};
use crate::process_info::ProcessInfo;
use crate::stop::{Stop, Wakeable};

/// Acts for `agents` of `domain` with `policy`, in this thread, until the world ends. Without a usable
/// allocation they take the safe action.
///
/// # Errors
/// No world comes, it runs another contract, another process acts for one of the agents, or a
/// signal came.
pub fn runner_process(
    domain: &Domain,
    contract: &DomainContract,
    agents: &[u16],
    policy: &mut dyn Policy,
    settings: &ProcessSettings,
    stop: &Stop,
) -> Result<Counters, Error> {
    act(domain, contract, agents, (policy, None), settings, stop)
}

/// As [`runner_process`]; without a usable allocation the agents act on that of `heuristic`, a
/// [`CostAllocator`](sortie_core::allocate::CostAllocator) for example. It has to give the same one to every
/// runner, so it may depend on nothing but the state. A runner with private frames does not see that state: its
/// agent takes the safe action.
///
/// # Errors
/// As [`runner_process`].
pub fn runner_process_with_heuristic(
    domain: &Domain,
    contract: &DomainContract,
    agents: &[u16],
    policy: &mut dyn Policy,
    heuristic: &mut dyn Allocator,
    settings: &ProcessSettings,
    stop: &Stop,
) -> Result<Counters, Error> {
    act(domain, contract, agents, (policy, Some(heuristic)), settings, stop)
}

fn act(
    domain: &Domain,
    contract: &DomainContract,
    agents: &[u16],
    (policy, heuristic): (&mut dyn Policy, Option<&mut dyn Allocator>),
    settings: &ProcessSettings,
    stop: &Stop,
) -> Result<Counters, Error> {
    let mut process = RunnerProcess::join(domain, contract, agents, settings, stop)?;
    let ended = process.act(policy, heuristic, None, stop);
    let left = process.leave();
    ended.and(left)
}

/// A policy that a team changes to: whole, and ready to decide.
pub type SwappedPolicy = Box<dyn Policy + Send>;

/// A runner that has joined its domain.
pub struct RunnerProcess {
    link: IoxAgent,
    role: RunnerRole,
    parent: Option<Parent>,
    identity: Identity,
    seats: u64,
    schema: u64,
    contract: u64,
    mixes_teams: bool,
    shape: Shape,
    abandoned: Abandoned,
    _locks: Vec<Lock>,
    /// Dropped last.
    membership: Membership,
}

impl RunnerProcess {
    /// Takes the seats of `agents`.
    ///
    /// # Errors
    /// No world comes, it runs another contract, another process acts for one of the agents, or a signal came.
    pub fn join(
        domain: &Domain,
        contract: &DomainContract,
        agents: &[u16],
        settings: &ProcessSettings,
        stop: &Stop,
    ) -> Result<Self, Error> {
        let parent = Parent::follow(settings.parent)?;
        let membership = domain.enter()?;
        let facts = membership.await_facts(contract, WORLD_PATIENCE, stop)?;
        let shape = facts.shape();
        settings.check_limits(shape)?;
        let seats = seats(agents, shape.agents)?;
        facts.check_frames(domain, settings.private)?;
        let owner = owner(agents, settings.private)?;
        let locks = agents.iter().map(|&agent| membership.take_seat(agent));
        let locks = locks.collect::<Result<Vec<_>, _>>()?;
        let format = facts.format()?;
        let name = port_name(agents);
        let mut link: IoxAgent = {
            let _starting = membership.lock_start()?;
            let linger = linger(settings.linger, facts.period_ns() != 0);
            let bell = facts.bell();
            let setup = LinkSetup { domain, format, name: &name, bell, linger };
            match owner {
                Some(agent) => IoxAgent::open_private(&setup, agent)?,
                None => IoxAgent::open(&setup)?,
            }
        };
        let identity = settings.identity(&name);
        let mut role = RunnerRole::new(RunnerOptions {
            format: owner.map_or(Ok(format), |agent| facts.private_format(agent))?,
            identity,
            agents: seats,
            subtasks: contract.subtasks,
            decision_interval: contract.decision_interval,
            period_ns: facts.period_ns(),
            safe_action: contract.safe_action,
        });
        role.join(&mut link)?;
        settings.real_time.claim()?;
        let (schema, mixes_teams) = (format.schema, contract.mixes_teams);
        let contract = contract.hash;
        Ok(Self {
            link,
            role,
            parent,
            identity,
            seats,
            schema,
            contract,
            mixes_teams,
            shape,
            abandoned: Abandoned::new(settings.world_patience),
            _locks: locks,
            membership,
        })
    }

    /// Acts with `policy`, in this thread, until the world ends; and with those that the team changes to, which `registry`
    /// opens.
    ///
    /// # Errors
    /// The link failed, or a signal came.
    pub fn act(
        &mut self,
        policy: &mut dyn Policy,
        heuristic: Option<&mut dyn Allocator>,
        registry: Option<Registry<SwappedPolicy>>,
        stop: &Stop,
    ) -> Result<(), Error> {
        let (seats, schema) = (self.seats, self.schema);
        let Self { link, role, parent, identity, abandoned, membership, .. } = self;
        let own = Held { id: identity.model, model: Box::new(policy) as Box<dyn Policy + '_> };
        let domain = (self.contract, self.shape);
        let mut models = Models::new(own, registry, |policy| policy, domain, link.waker());
        if let Some(facts) = membership.facts()? {
            models.join(facts.bundles(), self.mixes_teams);
        }
        let mut runner = Runner {
            role,
            models,
            heuristic,
            membership,
            parent,
            abandoned,
            identity,
            seats,
            schema,
            is_told_to_end: false,
        };
        drive(&mut runner, link, stop)
    }

    /// Says goodbye.
    ///
    /// # Errors
    /// The link failed.
    pub fn leave(mut self) -> Result<Counters, Error> {
        self.role.leave(&mut self.link)?;
        Ok(*self.role.counters())
    }
}

struct Runner<'a, 'p, 'h> {
    role: &'a mut RunnerRole,
    models: Models<Box<dyn Policy + 'p>, SwappedPolicy>,
    heuristic: Option<&'h mut dyn Allocator>,
    membership: &'a Membership,
    parent: &'a Option<Parent>,
    abandoned: &'a mut Abandoned,
    identity: &'a mut Identity,
    seats: u64,
    schema: u64,
    is_told_to_end: bool,
}

/// Acts for agents while the bundle that a frame asks for is being opened: it refuses, so that their fallback acts.
pub(super) struct Unready;

impl Policy for Unready {
    fn actions(&self) -> usize {
        0
    }

    fn utilities(&mut self, _: &Observation<'_>, _: &mut [f32]) -> Result<(), DecideError> {
        Err(DecideError::BadLength)
    }

    fn decide(&mut self, _: &Observation<'_>) -> Result<Decision, DecideError> {
        Err(DecideError::BadLength)
    }
}

impl Process for Runner<'_, '_, '_> {
    type Link = IoxAgent;

    fn poll(&mut self, link: &mut IoxAgent) -> Result<Poll, Error> {
        let Self { role, models, heuristic, identity, .. } = self;
        role.receive(link)?;
        follow(role, models, link, identity);
        let policy: &mut dyn Policy = match models.in_use() {
            Some(policy) => policy.as_mut(),
            None => &mut Unready,
        };
        let heuristic = heuristic.as_mut().map(|heuristic| &mut **heuristic as &mut dyn Allocator);
        Ok(role.answer(link, policy, heuristic)?)
    }

    fn leaves_loop(&self) -> bool {
        self.is_told_to_end
    }

    fn look_around(&mut self) -> Result<(), Error> {
        Parent::check(self.parent)?;
        self.models.catch_up(self.membership)?;
        self.abandoned.check(self.membership, self.role.tick())
    }
}

impl Controlled for Runner<'_, '_, '_> {
    fn schema(&self) -> u64 {
        self.schema
    }

    fn tick(&self) -> u64 {
        self.role.tick()
    }

    fn info(&self) -> ProcessInfo {
        let (generation, candidate) = (self.models.generation(), self.models.candidate());
        let info = ProcessInfo::new(Role::Runner, self.identity);
        ProcessInfo { agents: self.seats, generation, candidate, ..info }
    }

    fn counters_mut(&mut self) -> &mut Counters {
        self.role.counters_mut()
    }

    fn obey(&mut self, command: Command, request: &ControlReq) -> ControlStatus {
        match command {
            Command::ShutDown if is_named(request) => {
                self.is_told_to_end = true;
                ControlStatus::Done
            }
            Command::PrepareBundle => self.models.prepare(request.text(), request.arg64 as u16),
            _ => ControlStatus::NotMine,
        }
    }
}

/// Has a role decide by the bundle that its newest frame asks for.
pub(super) fn follow<M, L>(
    role: &mut RunnerRole,
    models: &mut Models<M, L>,
    link: &impl AgentLink,
    identity: &mut Identity,
) {
    if let Some(model) = models.follow(role.asked_generation(link), identity) {
        role.change_model(model);
    }
}

/// The agents as a set.
pub(super) fn seats(agents: &[u16], count: usize) -> Result<u64, Error> {
    let exists = |agent: &u16| usize::from(*agent) < count;
    if agents.is_empty() || !agents.iter().all(exists) {
        return Err(Error::NoSuchAgent { agents: agents.to_vec(), count });
    }
    Ok(agents.iter().fold(0, |seats, agent| seats | 1 << agent))
}

/// The agent whose private frames the runner gets, if it gets such.
fn owner(agents: &[u16], private: bool) -> Result<Option<usize>, Error> {
    match agents {
        _ if !private => Ok(None),
        [agent] => Ok(Some((*agent).into())),
        _ => Err(Error::NotOneAgent { agents: agents.to_vec() }),
    }
}

pub(super) fn port_name(agents: &[u16]) -> String {
    match agents {
        [agent] => format!("agent/{agent}"),
        [first, ..] => format!("runner/{first}"),
        [] => "runner".to_string(),
    }
}
