//! A runner process.

use sortie_core::Policy;
use sortie_core::roles::{Counters, Identity, RunnerOptions, RunnerRole};

use super::parent::Parent;
use super::{ProcessSettings, WORLD_PATIENCE, Waits, drive};
use crate::domain::{Domain, DomainContract};
use crate::error::Error;
use crate::iox::{IoxAgent, LinkSetup};
use crate::stop::Stop;

/// Acts for `agents` of `domain` with `policy`, in this thread, until the world ends.
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
    let parent = Parent::follow(settings.parent)?;
    let membership = domain.enter()?;
    let facts = membership.await_facts(contract, WORLD_PATIENCE, stop)?;
    let shape = facts.shape();
    settings.check_limits(shape)?;
    let seats = seats(agents, shape.agents)?;
    let _locks =
        agents.iter().map(|&agent| membership.take_seat(agent)).collect::<Result<Vec<_>, _>>()?;
    let format = facts.format()?;
    let name = port_name(agents);
    let mut link: IoxAgent = {
        let _starting = membership.lock_start()?;
        let (bell, spin) = (facts.bell(), settings.spin);
        IoxAgent::open(&LinkSetup { domain, format, name: &name, bell, spin })?
    };
    let mut role = RunnerRole::new(RunnerOptions {
        format,
        identity: Identity { model: settings.model, ..Identity::new(std::process::id(), &name) },
        agents: seats,
        subtasks: contract.subtasks,
        decision_interval: contract.decision_interval,
        period_ns: facts.period_ns(),
        safe_action: contract.safe_action,
    });
    role.join(&mut link)?;
    let mut waits = Waits::default();
    settings.real_time.claim()?;
    let poll = |link: &mut IoxAgent| Ok(role.poll(link, policy)?);
    let ended = drive(&mut link, stop, &mut waits, poll, || Parent::check(&parent));
    let left = role.leave(&mut link).map_err(Error::from);
    ended.and(left).map(|()| waits.add_to(*role.counters()))
}

/// The agents as a set.
fn seats(agents: &[u16], count: usize) -> Result<u64, Error> {
    let exists = |agent: &u16| usize::from(*agent) < count;
    if agents.is_empty() || !agents.iter().all(exists) {
        return Err(Error::NoSuchAgent { agents: agents.to_vec(), count });
    }
    Ok(agents.iter().fold(0, |seats, agent| seats | 1 << agent))
}

fn port_name(agents: &[u16]) -> String {
    match agents {
        [agent] => format!("agent/{agent}"),
        [first, ..] => format!("runner/{first}"),
        [] => "runner".to_string(),
    }
}
