//! The process that serves a policy.

use std::time::Duration;

use sortie_core::link::Clock;
use sortie_core::plan::Plan;
use sortie_core::wire::{
    AnswerHead, AnswerStatus, ObservationHead, ObservationView, Reason, ServedFormat,
};

use super::decider::Decider;
use super::schema::ServedFacts;
use super::{Fallback, PolicySchema};
use crate::clock::MonotonicClock;
use crate::domain::{Domain, Lock, Membership};
use crate::error::Error;
use crate::iox::{ServedLink, ServedSetup, served_bytes};
use crate::processes::{Caretaker, HEARTBEAT_NS, LINGER};
use crate::real_time::RealTime;
use crate::stop::Stop;

/// What a server is started with, beside its plan.
#[derive(Clone, Copy, Debug)]
pub struct ServeSettings {
    /// How long clients wait for an answer, unless they say otherwise themselves.
    pub deadline: Duration,
    /// What is done where the policy does not answer.
    pub fallback: Fallback,
    /// How long waits linger before they sleep; `None` = 100 us.
    pub linger: Option<Duration>,
    /// What the deciding thread asks the system for.
    pub real_time: RealTime,
}

/// What a server did since its start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ServeCounters {
    /// Answers of the policy, late ones among them.
    pub answered: u64,
    /// Answers of the policy after the deadline.
    pub late: u64,
    /// Observations on which it could not decide.
    pub fallbacks: u64,
    /// Messages that are no observations of this policy.
    pub refused: u64,
    /// Observations that newer ones overtook.
    pub missed: u64,
    /// Clients that came.
    pub sessions: u64,
    /// Times that the recurrent state began anew.
    pub resets: u64,
    /// Answers that could not be sent.
    pub failed_sends: u64,
}

/// One observation that was answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Served {
    /// What became of it.
    pub status: AnswerStatus,
    /// From its sending to this process running.
    pub wake_ns: u64,
    /// The decision alone.
    pub decide_ns: u64,
}

/// A policy's place in a domain, whose services are open.
pub struct PolicyServer {
    link: ServedLink,
    schema: PolicySchema,
    format: ServedFormat,
    settings: ServeSettings,
    _caretaker: Caretaker,
    _lock: Lock,
    /// Dropped last.
    _membership: Membership,
}

impl PolicyServer {
    /// Takes the domain for a policy that takes and gives what `schema` says. Clients find it from now on.
    ///
    /// # Errors
    /// Another process serves a policy in this domain, a client of another policy is in it, or shared memory cannot
    /// be used.
    pub fn open(
        domain: &Domain,
        schema: PolicySchema,
        settings: &ServeSettings,
    ) -> Result<Self, Error> {
        check_fallback(&schema, settings.fallback)?;
        let format = schema.format()?;
        let membership = domain.enter()?;
        let lock = membership.take_end("policy.lock", "the policy", served_bytes(&format))?;
        let link = {
            let _starting = membership.lock_start()?;
            let linger = settings.linger.unwrap_or(LINGER);
            ServedLink::server(&ServedSetup { domain, format, linger })?
        };
        ServedFacts::new(schema.clone(), settings.deadline, settings.fallback).write(domain)?;
        Ok(Self {
            link,
            schema,
            format,
            settings: *settings,
            _caretaker: Caretaker::start(domain)?,
            _lock: lock,
            _membership: membership,
        })
    }

    /// Answers observations with `plan`, in this thread, until it is stopped. `observe` sees each of them.
    ///
    /// # Errors
    /// The plan is not that of the schema, the system refuses what the settings ask for, or shared memory fails.
    pub fn serve(
        &mut self,
        plan: &Plan<'_>,
        observe: &mut dyn FnMut(&Served),
        stop: &Stop,
    ) -> Result<ServeCounters, Error> {
        if PolicySchema::of_plan(plan)? != self.schema.clone().unnamed() {
            let problem = "the plan is not that of the schema".to_owned();
            return Err(Error::NotServed { problem });
        }
        let mut decider = Decider::new(plan, &self.schema);
        decider.warm();
        self.settings.real_time.claim()?;
        stop.wakes(self.link.waker());
        let mut serving = Serving {
            decider,
            format: self.format,
            fallback: self.settings.fallback,
            client: None,
            outputs: vec![0.0; self.format.outputs()],
            action: None,
            next: vec![0.0; self.format.outputs()],
            counters: ServeCounters::default(),
        };
        self.answer_until(&mut serving, observe, stop)?;
        Ok(serving.counters)
    }

    fn answer_until(
        &self,
        serving: &mut Serving<'_>,
        observe: &mut dyn FnMut(&Served),
        stop: &Stop,
    ) -> Result<(), Error> {
        let mut kept_house_ns = MonotonicClock.now_ns();
        while !stop.is_set() {
            let token = self.link.token();
            let mut newest = None;
            while let Some(message) = self.link.receive()? {
                newest = Some(message);
            }
            if let Some(message) = newest {
                if let Some(served) = serving.answer(&self.link, message.payload()) {
                    observe(&served);
                }
                continue;
            }
            let now_ns = MonotonicClock.now_ns();
            if now_ns.saturating_sub(kept_house_ns) >= HEARTBEAT_NS {
                self.link.housekeep();
                kept_house_ns = now_ns;
            }
            self.link.wait(token, now_ns.saturating_add(HEARTBEAT_NS));
        }
        Ok(())
    }
}

/// Checks that a fallback action is one.
fn check_fallback(schema: &PolicySchema, fallback: Fallback) -> Result<(), Error> {
    let problem = match fallback {
        Fallback::Action(action) if usize::from(action) >= schema.actions => match schema.actions {
            0 => "it does not choose among actions: its fallback is `hold` or `zero`".to_owned(),
            actions => format!("its actions are 0 to {}, the fallback is {action}", actions - 1),
        },
        _ => return Ok(()),
    };
    Err(Error::NotServed { problem })
}

/// Whose observation came last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Client {
    session: u64,
    episode: u32,
    seq: u64,
}

struct Serving<'p> {
    decider: Decider<'p>,
    format: ServedFormat,
    fallback: Fallback,
    client: Option<Client>,
    /// What was answered last.
    outputs: Vec<f32>,
    action: Option<u16>,
    /// Where the next answer is computed.
    next: Vec<f32>,
    counters: ServeCounters,
}

impl Serving<'_> {
    /// Answers one message. Whoever sent it may be gone.
    fn answer(&mut self, link: &ServedLink, bytes: &[u8]) -> Option<Served> {
        let woken_ns = MonotonicClock.now_ns();
        let (head, served) = match self.format.read_observation(bytes) {
            Ok(observation) => self.decide(&observation, woken_ns),
            Err(error) => {
                self.counters.refused += 1;
                let ObservationHead { session, seq, t_ns, .. } = *ObservationHead::of(bytes)?;
                let status = AnswerStatus::Refused;
                let head = AnswerHead { session, seq, ..head(status, Reason::from(error), None) };
                let wake_ns = woken_ns.saturating_sub(t_ns);
                (head, Served { status, wake_ns, decide_ns: 0 })
            }
        };
        let Self { format, outputs, counters, .. } = self;
        let head = AnswerHead { t_ns: MonotonicClock.now_ns(), ..head };
        let sent = link.send(|to| format.write_answer(&head, outputs, to));
        counters.failed_sends += u64::from(sent.is_err());
        Some(served)
    }

    fn decide(&mut self, observation: &ObservationView<'_>, woken_ns: u64) -> (AnswerHead, Served) {
        let ObservationView { head: asked, inputs, available } = *observation;
        let flags = self.meet(asked);
        let decided = self.decider.decide(inputs, available, &mut self.next);
        let (status, reason) = match decided {
            Ok(action) => {
                self.action = action;
                std::mem::swap(&mut self.outputs, &mut self.next);
                self.counters.answered += 1;
                (AnswerStatus::Answered, Reason::None)
            }
            Err(error) => {
                self.action = self.fallback.apply(&mut self.outputs, self.action, available);
                self.counters.fallbacks += 1;
                (AnswerStatus::Fallback, Reason::from(error))
            }
        };
        let now_ns = MonotonicClock.now_ns();
        let is_late = status == AnswerStatus::Answered && now_ns > asked.deadline_ns;
        self.counters.late += u64::from(is_late);
        let status = if is_late { AnswerStatus::Late } else { status };
        let decide_ns = now_ns.saturating_sub(woken_ns);
        let wake_ns = woken_ns.saturating_sub(asked.t_ns);
        let ObservationHead { session, seq, .. } = *asked;
        let answer = AnswerHead {
            session,
            seq,
            flags,
            decide_ns: u32::try_from(decide_ns).unwrap_or(u32::MAX),
            ..head(status, reason, self.action)
        };
        (answer, Served { status, wake_ns, decide_ns })
    }

    /// Begins what is new: a client, or an episode.
    fn meet(&mut self, asked: &ObservationHead) -> u16 {
        let ObservationHead { session, episode, seq, .. } = *asked;
        let last = self.client.replace(Client { session, episode, seq });
        let mut flags = 0;
        if last.map(|client| client.session) != Some(session) {
            self.counters.sessions += 1;
            self.outputs.fill(0.0);
            self.action = None;
        } else if let Some(steps @ 2..) = last.and_then(|client| seq.checked_sub(client.seq)) {
            self.counters.missed = self.counters.missed.saturating_add(steps - 1);
            flags |= AnswerHead::GAP;
        }
        if last.map(|client| (client.session, client.episode)) != Some((session, episode)) {
            self.decider.forget();
            self.counters.resets += 1;
            flags |= AnswerHead::STATE_RESET;
        }
        flags
    }
}

fn head(status: AnswerStatus, reason: Reason, action: Option<u16>) -> AnswerHead {
    AnswerHead {
        status: status as u16,
        reason: reason as u16,
        action: action.map_or(-1, i32::from),
        server: std::process::id(),
        ..AnswerHead::default()
    }
}
