//! A runner process.

use sortie_core::roles::{Counters, Identity, Poll, RunnerOptions, RunnerRole};
use sortie_core::wire::{Command, ControlReq, ControlStatus, Role};
use sortie_core::{Allocator, Policy, Shape};

use super::abandoned::Abandoned;
use super::children::Parent;
use super::{Controlled, Process, ProcessSettings, WORLD_PATIENCE, drive, is_named, linger};
use crate::domain::{Domain, DomainContract, Lock, Membership};
use crate::error::Error;
use crate::iox::{IoxAgent, LinkSetup};
use crate::process_info::{Ended, ProcessInfo, Registry, Reloading};
use crate::stop::Stop;

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

/// A runner that has joined its domain, and can act with one policy after the other.
pub struct RunnerProcess {
    link: IoxAgent,
    role: RunnerRole,
    parent: Option<Parent>,
    identity: Identity,
    seats: u64,
    schema: u64,
    contract: u64,
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
        let (schema, contract) = (format.schema, contract.hash);
        Ok(Self {
            link,
            role,
            parent,
            identity,
            seats,
            schema,
            contract,
            shape,
            abandoned: Abandoned::new(settings.world_patience),
            _locks: locks,
            membership,
        })
    }

    /// Acts with `policy`, in this thread, until the world ends, or until somebody has it load another model from
    /// `registry`: then this is to be called again, with that.
    ///
    /// # Errors
    /// The link failed, or a signal came.
    pub fn act(
        &mut self,
        policy: &mut dyn Policy,
        heuristic: Option<&mut dyn Allocator>,
        registry: Option<&mut dyn Registry>,
        stop: &Stop,
    ) -> Result<Ended, Error> {
        let (seats, schema) = (self.seats, self.schema);
        let (contract, shape) = (self.contract, self.shape);
        let Self { link, role, parent, identity, abandoned, membership, .. } = self;
        let mut runner = Runner {
            role,
            policy,
            heuristic,
            membership,
            parent,
            abandoned,
            identity,
            seats,
            schema,
            reloading: Reloading { registry, contract, shape, is_due: false },
            is_told_to_end: false,
        };
        drive(&mut runner, link, stop)?;
        Ok(runner.reloading.ended())
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

struct Runner<'a, 'p, 'h, 'r> {
    role: &'a mut RunnerRole,
    policy: &'p mut dyn Policy,
    heuristic: Option<&'h mut dyn Allocator>,
    membership: &'a Membership,
    parent: &'a Option<Parent>,
    abandoned: &'a mut Abandoned,
    identity: &'a mut Identity,
    seats: u64,
    schema: u64,
    reloading: Reloading<'r>,
    is_told_to_end: bool,
}

impl Process for Runner<'_, '_, '_, '_> {
    type Link = IoxAgent;

    fn poll(&mut self, link: &mut IoxAgent) -> Result<Poll, Error> {
        Ok(match &mut self.heuristic {
            Some(heuristic) => self.role.poll_with_heuristic(link, self.policy, *heuristic)?,
            None => self.role.poll(link, self.policy)?,
        })
    }

    fn leaves_loop(&self) -> bool {
        self.reloading.is_due || self.is_told_to_end
    }

    fn look_around(&mut self) -> Result<(), Error> {
        Parent::check(self.parent)?;
        self.abandoned.check(self.membership, self.role.tick())
    }
}

impl Controlled for Runner<'_, '_, '_, '_> {
    fn schema(&self) -> u64 {
        self.schema
    }

    fn tick(&self) -> u64 {
        self.role.tick()
    }

    fn info(&self) -> ProcessInfo {
        ProcessInfo { agents: self.seats, ..ProcessInfo::new(Role::Runner, self.identity) }
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
            Command::ReloadModel => match self.reloading.load(request.text()) {
                Ok(model) => {
                    self.identity.model = model;
                    self.role.change_model(model);
                    ControlStatus::Done
                }
                Err(status) => status,
            },
            _ => ControlStatus::NotMine,
        }
    }
}

/// The agents as a set.
fn seats(agents: &[u16], count: usize) -> Result<u64, Error> {
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

fn port_name(agents: &[u16]) -> String {
    match agents {
        [agent] => format!("agent/{agent}"),
        [first, ..] => format!("runner/{first}"),
        [] => "runner".to_string(),
    }
}
