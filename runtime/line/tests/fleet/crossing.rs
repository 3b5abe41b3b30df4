//! What crosses between hosts: who speaks for which agent, and whether it is news.

use std::collections::{BTreeMap, BTreeSet};

use sortie_core::wire::ActionMsg;

use super::oracle::Invariant;
use super::setup::MILLISECOND;

/// A runner that is cut off says so within this time of the last word: three ticks or 300 ms, and two heartbeats.
const SAYS_SO_NS: u64 = 510 * MILLISECOND;

/// A session of a runner that is away, in the order in which they began.
type Session = u64;

/// A fault, by name.
pub(crate) type Fault = (Invariant, String);

#[derive(Default)]
pub(crate) struct Crossing {
    sessions: Session,
    /// That of each runner that is away.
    current: BTreeMap<u32, Session>,
    /// The runners that have said that they are cut off.
    cut: BTreeSet<u32>,
    /// In which session what was said: by runner, agent, tick and number.
    said: BTreeMap<(u32, u16, u64, u64), Session>,
    /// Who speaks for each agent, and the number of what was passed on last.
    speakers: BTreeMap<u16, (Session, u64)>,
    /// Sessions after which others spoke for the same agent.
    over: BTreeSet<Session>,
    /// Processes that stand in at home.
    stand_ins: BTreeSet<u32>,
}

impl Crossing {
    /// A process stands in for agents: what an earlier one was told it was not.
    pub(crate) fn stands_in(&mut self, pid: u32, agents: u64) {
        self.stand_ins.insert(pid);
        for (agent, (session, _)) in &self.speakers {
            if agents >> agent & 1 == 1 {
                self.over.insert(*session);
            }
        }
    }

    pub(crate) fn is_stand_in(&self, pid: u32) -> bool {
        self.stand_ins.contains(&pid)
    }

    pub(crate) fn begins(&mut self, pid: u32) -> Session {
        self.sessions += 1;
        self.current.insert(pid, self.sessions);
        self.cut.remove(&pid);
        self.sessions
    }

    pub(crate) fn cut_off(&mut self, pid: u32) {
        self.cut.insert(pid);
    }

    /// The runner takes itself for heard: it last was at `heard_ns`.
    pub(crate) fn believes_heard(&mut self, now_ns: u64, heard_ns: u64, pid: u32) -> Option<Fault> {
        self.cut.remove(&pid);
        let detail = || format!("runner {pid} has heard nothing for long, and does not say so");
        (now_ns > heard_ns + SAYS_SO_NS).then(|| (Invariant::SaysSo, detail()))
    }

    /// A runner that is away answers.
    pub(crate) fn said(&mut self, pid: u32, action: &ActionMsg) -> Option<Fault> {
        let session = *self.current.get(&pid)?;
        let ActionMsg { agent, tick, seq, .. } = *action;
        self.said.insert((pid, agent, tick, seq), session);
        let is_mute = self.cut.contains(&pid) && !action.has(ActionMsg::BYE);
        is_mute.then(|| (Invariant::SaysSo, format!("runner {pid} is cut off, and acts")))
    }

    /// Who stands in passes on an answer.
    pub(crate) fn passed_on(&mut self, action: &ActionMsg) -> Option<Fault> {
        let ActionMsg { agent, tick, seq, runner, .. } = *action;
        let Some(session) = self.said.get(&(runner, agent, tick, seq)).copied() else {
            let detail = format!("agent {agent}: runner {runner} has never said number {seq}");
            return Some((Invariant::NothingOld, detail));
        };
        if self.over.contains(&session) {
            let detail = format!("agent {agent}: runner {runner} speaks, whose session is over");
            return Some((Invariant::OneSeat, detail));
        }
        let before = self.speakers.insert(agent, (session, seq));
        let (speaker, newest) = before?;
        if speaker != session {
            self.over.insert(speaker);
            return None;
        }
        let detail = || format!("agent {agent}: number {seq} comes after {newest}");
        (seq <= newest).then(|| (Invariant::NothingOld, detail()))
    }
}
