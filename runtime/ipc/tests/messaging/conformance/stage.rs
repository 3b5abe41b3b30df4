//! What the laws share: frames, a policy that notes what it is shown, allocations.

use std::borrow::BorrowMut;

use sortie_core::link::{ActionRx, AllocTx, Clock, FrameTx, LinkError};
use sortie_core::roles::{Identity, Poll, RunnerOptions, RunnerRole};
use sortie_core::wire::{ABI, ActionMsg, AllocMsg, FrameHeader, FrameKind, FrameMut};
use sortie_core::{DecideError, Decision, EntityMask, Observation, Policy, UNASSIGNED};

use super::Transport;
use crate::toy::SHAPE;

pub(super) const TERM: u64 = 7 << 32;
pub(super) const ALL: u64 = 0b111;
/// A patience that no test outlasts.
pub(super) const LONG: u64 = 3_600_000_000_000;
/// A patience that is over at once.
pub(super) const OVER: u64 = 1;

/// A frame in which everybody is present, sees everything and may do all but action 0.
#[derive(Clone, Copy)]
pub(super) struct Sent {
    pub(super) tick: u64,
    pub(super) step: u32,
    pub(super) decision_tick: u64,
    pub(super) present: u64,
    pub(super) absent: u64,
    pub(super) flags: u16,
    pub(super) kind: FrameKind,
    pub(super) patience: u64,
    pub(super) header: FrameHeader,
}

pub(super) fn frame(count: u64) -> Sent {
    Sent {
        tick: TERM + count,
        step: count as u32,
        decision_tick: 0,
        present: 0b11_1111,
        absent: 0,
        flags: 0,
        kind: FrameKind::World,
        patience: LONG,
        header: FrameHeader::default(),
    }
}

impl Sent {
    pub(super) fn send<T: Transport>(self, team: &mut T) {
        let format = team.format();
        let mut guard = team.world();
        let link = guard.borrow_mut();
        let now = link.now_ns();
        let header = FrameHeader {
            magic: FrameHeader::MAGIC,
            abi: self.header.abi + ABI,
            kind: self.kind as u16,
            schema: self.header.schema ^ format.schema,
            seq: self.tick,
            tick: self.tick,
            t_ns: now,
            deadline_ns: now + self.patience,
            len: format.layout.payload_bytes() as u32,
            flags: self.flags,
            generation: 0,
            world_term: (self.tick >> 32) as u32,
            episode: self.header.episode,
        };
        link.send_frame(&mut |payload| {
            let mut frame = FrameMut::new(payload, format.layout).map_err(LinkError::Frame)?;
            frame.set_present(&EntityMask::from_words(&[self.present]));
            frame.set_open_tasks(0b11);
            frame.set_progress(self.step, self.decision_tick, self.absent);
            for agent in 0..SHAPE.agents {
                frame.set_observable(agent, &EntityMask::first(SHAPE.entities));
                frame.available_mut(agent)[1..].fill(1);
            }
            for entity in SHAPE.agents..SHAPE.entities {
                frame.set_entity_task(entity, 1 << (entity % SHAPE.tasks));
            }
            Ok(header)
        })
        .unwrap();
    }
}

/// Always takes action 2, or refuses; notes what each agent was shown.
#[derive(Default)]
pub(super) struct Probe {
    pub(super) refuses: Option<DecideError>,
    pub(super) shown: Vec<(usize, Vec<usize>)>,
}

impl Policy for Probe {
    fn actions(&self) -> usize {
        SHAPE.actions
    }

    fn utilities(&mut self, _: &Observation<'_>, _: &mut [f32]) -> Result<(), DecideError> {
        Err(DecideError::BadLength)
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        self.shown.push((observation.self_index, observation.visible.iter().collect()));
        self.refuses.map_or(Ok(Decision { action: 2, utility: 0.5 }), Err)
    }
}

pub(super) fn runner<T: Transport>(
    team: &mut T,
    index: usize,
    agents: u64,
    subtasks: bool,
) -> RunnerRole {
    let role = RunnerRole::new(RunnerOptions {
        format: team.format(),
        identity: Identity::new(100 + index as u32, "runner"),
        agents,
        subtasks,
        decision_interval: 4,
        period_ns: 0,
        safe_action: Some(3),
    });
    drop(team.agent(index));
    role
}

pub(super) fn poll<T: Transport>(
    team: &mut T,
    index: usize,
    role: &mut RunnerRole,
    probe: &mut Probe,
) -> Poll {
    role.poll(team.agent(index).borrow_mut(), probe).unwrap()
}

/// Sends a frame, lets the runner answer it, and returns the answers.
pub(super) fn answers<T: Transport>(
    team: &mut T,
    role: &mut RunnerRole,
    probe: &mut Probe,
    sent: Sent,
) -> Vec<ActionMsg> {
    sent.send(team);
    poll(team, 0, role, probe);
    received(team)
}

pub(super) fn received<T: Transport>(team: &mut T) -> Vec<ActionMsg> {
    let mut received = Vec::new();
    let mut guard = team.world();
    guard.borrow_mut().receive_actions(&mut |action| received.push(*action)).unwrap();
    received
}

/// An allocation of agents 0 to 2 to subtasks 1, none, 0.
pub(super) fn allocation<T: Transport>(team: &T, count: u64, term: u32, epoch: u32) -> AllocMsg {
    let mut task = [UNASSIGNED; 64];
    (task[0], task[2]) = (1, 0);
    AllocMsg {
        schema: team.format().schema,
        seq: epoch.into(),
        tick: TERM + count,
        t_ns: 0,
        valid_until: TERM + count + 4,
        term,
        epoch,
        model: 0,
        decide_ns: 0,
        n_agents: SHAPE.agents as u16,
        n_tasks: SHAPE.tasks as u8,
        abi: 3,
        flags: 0,
        task,
    }
}

pub(super) fn allocate<T: Transport>(team: &mut T, index: usize, allocation: AllocMsg) {
    team.allocator(index).borrow_mut().send_allocation(&allocation).unwrap();
}

pub(super) fn tasks(answers: &[ActionMsg]) -> Vec<u8> {
    answers.iter().map(|answer| answer.task).collect()
}
