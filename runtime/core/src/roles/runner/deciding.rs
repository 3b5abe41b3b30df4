//! How a runner decides for its agents on one frame.

use heapless::Vec;

use super::RunnerRole;
use super::in_force::{Freshness, InForce, subtasks};
use crate::allocator::UNASSIGNED;
use crate::limits;
use crate::link::Clock;
use crate::policy::{DecideError, Decision, NO_ACTION, Observation, Policy, visible};
use crate::roles::fallback::{fallback_action, guarded_action, safe_action};
use crate::roles::feasible::is_open;
use crate::wire::{ActionMsg, FrameView};

impl RunnerRole {
    pub(super) fn decide<P: Policy + ?Sized>(
        &mut self,
        view: &FrameView<'_>,
        policy: &mut P,
        in_force: &InForce,
        (running_ns, clock): (u64, &impl Clock),
        answers: &mut Vec<ActionMsg, { limits::AGENTS }>,
    ) {
        let flags = self.flags(view, in_force.freshness, running_ns);
        let agents = self.options.format.layout.shape().agents;
        let subtasks = self.options.subtasks.then(|| subtasks(view, agents, in_force));
        let present = view.present();
        let mut seen: Vec<Observation<'_>, { limits::AGENTS }> = Vec::new();
        let mut deciding = 0_u64;
        for agent in self.agents().filter(|&agent| present.contains(agent)) {
            let mut answer = self.message(agent, view.header().tick);
            let task = in_force.task_of(agent);
            answer.flags = flags | self.finished(view, in_force.freshness, task);
            let sees = match &subtasks {
                Some(subtasks) => visible(view.observable(agent), present, subtasks, task),
                None => view.observable(agent).and(&present),
            };
            // There is room for every agent: one answer and one observation at most.
            if self.options.subtasks && task.is_none() {
                answer.action = safe_action(self.options.safe_action, view.available(agent));
            } else if seen.push(view.observation(agent, &sees)).is_ok() {
                deciding |= 1 << agent;
            }
            answer.task = task.unwrap_or(UNASSIGNED);
            (answer.alloc_term, answer.alloc_epoch) = in_force.order;
            let _ = answers.push(answer);
        }
        let mut decisions = [Err(DecideError::BadLength); limits::AGENTS];
        let started = clock.now_ns();
        policy.decide_batch(&seen, &mut decisions);
        // Agents decide together; each is told its share of the time.
        let share = clock.now_ns().saturating_sub(started).checked_div(seen.len() as u64);
        let share = u32::try_from(share.unwrap_or(0)).unwrap_or(u32::MAX);
        let acting =
            answers.iter_mut().filter(|answer: &&mut ActionMsg| deciding >> answer.agent & 1 == 1);
        for ((answer, observation), decision) in acting.zip(&seen).zip(decisions) {
            self.act(answer, decision, observation);
            answer.decide_ns = share;
        }
    }

    fn act(
        &mut self,
        answer: &mut ActionMsg,
        decision: Result<Decision, DecideError>,
        observation: &Observation<'_>,
    ) {
        match decision {
            Ok(decision) => {
                answer.action = decision.action;
                answer.q = decision.utility;
            }
            Err(DecideError::NoAvailableAction) => answer.action = NO_ACTION,
            Err(error) => {
                let is_guarded = matches!(error, DecideError::BeyondGuards { .. });
                let instead = if is_guarded { guarded_action } else { fallback_action };
                let last = observation.last_actions.get(observation.self_index);
                let last = last.copied().unwrap_or(NO_ACTION);
                answer.action = instead(last, self.options.safe_action, observation.available);
                answer.flags |= ActionMsg::FALLBACK;
                if is_guarded {
                    answer.flags |= ActionMsg::GUARD;
                }
                self.counters.fallbacks += 1;
            }
        }
    }

    /// The flag of an agent whose subtask has been finished since it was allocated: it is kept for now.
    fn finished(&mut self, view: &FrameView<'_>, freshness: Freshness, task: Option<u8>) -> u16 {
        let is_finished = task.is_some_and(|task| !is_open(view, task));
        if self.options.subtasks && freshness == Freshness::Fresh && is_finished {
            self.counters.stale_allocations += 1;
            return ActionMsg::STALE_ALLOC;
        }
        0
    }

    fn flags(&mut self, view: &FrameView<'_>, freshness: Freshness, now: u64) -> u16 {
        let mut flags = 0;
        match freshness {
            _ if !self.options.subtasks => {}
            Freshness::Fresh => {}
            Freshness::Stale => {
                flags |= ActionMsg::STALE_ALLOC;
                self.counters.stale_allocations += 1;
            }
            Freshness::None => {
                flags |= ActionMsg::NO_ALLOC;
                self.counters.no_allocations += 1;
            }
        }
        if self.counters.frame_gaps > self.gaps_told {
            flags |= ActionMsg::TICK_GAP;
            self.gaps_told = self.counters.frame_gaps;
        }
        let deadline = view.header().deadline_ns;
        if deadline != 0 && now > deadline {
            flags |= ActionMsg::LATE;
        }
        flags
    }
}
