//! A runner inside the world's process, for the agents for which no other process acts.

use sortie_core::Policy;
use sortie_core::roles::{Identity, Poll, RunnerOptions, RunnerRole, WorldRole};

use crate::domain::{DomainContract, DomainFacts};
use crate::error::Error;
use crate::iox::{IoxAgent, LinkSetup};

/// What acts for agents without a process.
pub struct Fill<'a> {
    /// Decides for them.
    pub policy: &'a mut dyn Policy,
    /// First 16 bytes of its model's id.
    pub model: [u8; 16],
}

/// The runner at work. It takes no seat, so whoever joins finds it free.
pub(super) struct Filling<'a> {
    link: IoxAgent,
    role: RunnerRole,
    policy: &'a mut dyn Policy,
}

impl<'a> Filling<'a> {
    pub(super) fn open(
        fill: Fill<'a>,
        setup: &LinkSetup<'_>,
        contract: &DomainContract,
        facts: &DomainFacts,
        world: Identity,
    ) -> Result<Self, Error> {
        let link = IoxAgent::open_within(&LinkSetup { name: "world/fill", ..*setup })?;
        let role = RunnerRole::new(RunnerOptions {
            format: setup.format,
            identity: Identity { model: fill.model, ..world },
            agents: 0,
            subtasks: contract.subtasks,
            decision_interval: contract.decision_interval,
            period_ns: facts.period_ns(),
            safe_action: contract.safe_action,
        });
        Ok(Self { link, role, policy: fill.policy })
    }

    /// Acts for the free seats of the world's current frame, if there are some.
    pub(super) fn poll(&mut self, world: &WorldRole) -> Result<Poll, Error> {
        let free = world.filled();
        if free == 0 {
            return Ok(Poll::Wait { until_ns: u64::MAX });
        }
        self.role.act_for(free);
        Ok(self.role.poll(&mut self.link, self.policy)?)
    }
}

/// What two roles of one process want next.
pub(super) fn both(one: Poll, other: Poll) -> Poll {
    match (one, other) {
        (Poll::Ended, _) => Poll::Ended,
        (Poll::Wait { until_ns: one }, Poll::Wait { until_ns: other }) => {
            Poll::Wait { until_ns: one.min(other) }
        }
        // What the one has sent, the other has to receive.
        _ => Poll::Again,
    }
}
