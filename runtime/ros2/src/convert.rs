//! What a team says, as messages of ROS.

use sortie_core::NO_ACTION;
use sortie_core::wire::{ActionMsg, AllocMsg, FrameView};

use crate::messages::{Action, Allocation, Header, Observation, Time};

/// Of whom a message is, and when it was sent.
fn header(stamp: Time, agent: u16) -> Header {
    Header { stamp, frame_id: format!("agent_{agent}") }
}

impl Observation {
    /// What `agent` sees of a frame whose rows have `features` numbers that count; `None` for an agent that is not there.
    ///
    /// Nothing of what the agent does not see is in it. It takes one pass over what it sees.
    pub fn of_frame(
        view: &FrameView<'_>,
        agent: u16,
        features: usize,
        stamp: Time,
    ) -> Option<Self> {
        let own = usize::from(agent);
        let is_told = own < view.agents() && view.owner().is_none();
        if !is_told || !view.present().contains(own) {
            return None;
        }
        let seen = view.observable(own).and(&view.present());
        let shown: Vec<usize> = std::iter::once(own).chain(seen.iter()).collect();
        let row = |entity: &usize| {
            let first = entity.saturating_mul(view.stride());
            view.rows().get(first..first.saturating_add(features)).unwrap_or_default().iter()
        };
        let last_action =
            |entity: &usize| view.last_actions().get(*entity).copied().unwrap_or(NO_ACTION);
        let tasks = |entity: &usize| view.entity_task().get(*entity).copied().unwrap_or(0);
        let frame = view.header();
        Some(Self {
            header: header(stamp, agent),
            tick: frame.tick,
            episode: frame.episode,
            step: view.step(),
            agent,
            flags: frame.flags,
            // A domain has 128 entities at most.
            entities: shown.iter().map(|entity| *entity as u16).collect(),
            features: u32::try_from(features).unwrap_or(u32::MAX),
            rows: shown.iter().flat_map(row).copied().collect(),
            last_actions: shown.iter().map(last_action).collect(),
            tasks: shown.iter().map(tasks).collect(),
            open_tasks: view.open_tasks(),
            available: view.available(own).to_vec(),
        })
    }
}

impl Action {
    /// What a runner answered; `None` where it only leaves its seat, which is no action.
    pub fn of_message(message: &ActionMsg, stamp: Time) -> Option<Self> {
        if message.has(ActionMsg::BYE) {
            return None;
        }
        Some(Self {
            header: header(stamp, message.agent),
            tick: message.tick,
            agent: message.agent,
            action: message.action,
            task: message.task,
            flags: message.flags,
            utility: message.q,
            decide_ns: message.decide_ns,
            alloc_term: message.alloc_term,
            alloc_epoch: message.alloc_epoch,
            runner: message.runner,
        })
    }
}

impl Allocation {
    /// What an allocator said.
    pub fn of_message(message: &AllocMsg, stamp: Time) -> Self {
        let AllocMsg { tick, valid_until, term, epoch, flags, n_agents, .. } = *message;
        Self {
            header: Header { stamp, frame_id: String::new() },
            tick,
            valid_until,
            term,
            epoch,
            flags,
            tasks: message.task.iter().take(usize::from(n_agents)).copied().collect(),
        }
    }
}
