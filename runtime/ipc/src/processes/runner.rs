//! A runner process.

use sortie_core::roles::{Counters, Identity, Poll, RunnerOptions, RunnerRole};
use sortie_core::wire::{Command, ControlStatus, Role};
use sortie_core::{Allocator, Policy};

use super::control::Controlled;
use super::parent::Parent;
use super::{Process, ProcessSettings, WORLD_PATIENCE, drive};
use crate::control::ProcessInfo;
use crate::domain::{Domain, DomainContract};
use crate::error::Error;
use crate::iox::{IoxAgent, LinkSetup};
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

fn act<'a>(
    domain: &Domain,
    contract: &DomainContract,
    agents: &[u16],
    (policy, heuristic): (&'a mut dyn Policy, Option<&'a mut dyn Allocator>),
    settings: &ProcessSettings,
    stop: &Stop,
) -> Result<Counters, Error> {
    let parent = Parent::follow(settings.parent)?;
    let membership = domain.enter()?;
    let facts = membership.await_facts(contract, WORLD_PATIENCE, stop)?;
    let shape = facts.shape();
    settings.check_limits(shape)?;
    let seats = seats(agents, shape.agents)?;
    facts.check_frames(domain, settings.private)?;
    let owner = owner(agents, settings.private)?;
    let _locks =
        agents.iter().map(|&agent| membership.take_seat(agent)).collect::<Result<Vec<_>, _>>()?;
    let format = facts.format()?;
    let name = port_name(agents);
    let mut link: IoxAgent = {
        let _starting = membership.lock_start()?;
        let (bell, spin) = (facts.bell(), settings.spin);
        let setup = LinkSetup { domain, format, name: &name, bell, spin };
        match owner {
            Some(agent) => IoxAgent::open_private(&setup, agent)?,
            None => IoxAgent::open(&setup)?,
        }
    };
    let format = owner.map_or(Ok(format), |agent| facts.private_format(agent))?;
    let identity = settings.identity(&name);
    let mut role = RunnerRole::new(RunnerOptions {
        format,
        identity,
        agents: seats,
        subtasks: contract.subtasks,
        decision_interval: contract.decision_interval,
        period_ns: facts.period_ns(),
        safe_action: contract.safe_action,
    });
    role.join(&mut link)?;
    let schema = format.schema;
    let mut runner = Runner { role, policy, heuristic, parent, identity, seats, schema };
    settings.real_time.claim()?;
    let ended = drive(&mut runner, &mut link, stop);
    let left = runner.role.leave(&mut link).map_err(Error::from);
    ended.and(left).map(|()| *runner.role.counters())
}

/// A runner at work.
struct Runner<'a> {
    role: RunnerRole,
    policy: &'a mut dyn Policy,
    heuristic: Option<&'a mut dyn Allocator>,
    parent: Option<Parent>,
    identity: Identity,
    seats: u64,
    schema: u64,
}

impl Process for Runner<'_> {
    type Link = IoxAgent;

    fn poll(&mut self, link: &mut IoxAgent) -> Result<Poll, Error> {
        Ok(match &mut self.heuristic {
            Some(heuristic) => self.role.poll_with_heuristic(link, self.policy, heuristic)?,
            None => self.role.poll(link, self.policy)?,
        })
    }

    fn look_around(&mut self) -> Result<(), Error> {
        Parent::check(&self.parent)
    }
}

impl Controlled for Runner<'_> {
    fn schema(&self) -> u64 {
        self.schema
    }

    fn tick(&self) -> u64 {
        self.role.tick()
    }

    fn info(&self) -> ProcessInfo {
        ProcessInfo { agents: self.seats, ..ProcessInfo::new(Role::Runner, &self.identity) }
    }

    fn counters_mut(&mut self) -> &mut Counters {
        self.role.counters_mut()
    }

    fn obey(&mut self, command: Command) -> ControlStatus {
        match command {
            // It has no registry to load from: whoever starts it gives it the policy.
            Command::ReloadModel => ControlStatus::NotSupported,
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
