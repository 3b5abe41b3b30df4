//! The process that serves a policy.

use std::time::Duration;

use serde::Serialize;
use sortie_core::link::Clock;
use sortie_core::plan::{Guards, Plan, Trip};
use sortie_core::roles::{Counters, Identity, Presence};
use sortie_core::wire::{
    AnswerHead, AnswerStatus, Command, ControlReq, ControlStatus, ObservationHead, ObservationView,
    Reason, Role, ServedFormat, StatMsg,
};

use super::decider::{Decider, Engine, PlanEngine};
use super::guarding::{Guarding, Last, Undecided};
use super::schema::ServedFacts;
use super::{Fallback, PolicySchema};
use crate::domain::{Domain, Lock, Membership};
use crate::error::Error;
use crate::iox::{ControlRx, ServedLink, ServedPresence, ServedSetup, served_bytes};
use crate::process_info::{BUILD, ProcessInfo};
use crate::processes::{Caretaker, Controlled, HEARTBEAT_NS, LINGER, answer};
use crate::real_time::RealTime;
use crate::stop::{MonotonicClock, Stop};

/// What a server is started with, beside its plan.
#[derive(Clone, Copy, Debug)]
pub struct ServeSettings {
    /// How long clients wait for an answer, unless they say otherwise themselves.
    pub deadline: Duration,
    /// What is done where the policy does not answer.
    pub fallback: Fallback,
    /// Draws actions from the softmax of their scores by numbers of this seed; `None` = takes the best.
    pub draw: Option<u64>,
    /// How long waits linger before they sleep; `None` = 100 us.
    pub linger: Option<Duration>,
    /// What the deciding thread asks the system for.
    pub real_time: RealTime,
}

/// A policy's place in a domain, whose services are open.
pub struct PolicyServer {
    presence: ServedPresence,
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
    /// The settings ask for a choice among actions where the policy has none, another process serves a policy in this
    /// domain, a client of another policy is in it, or shared memory cannot be used.
    pub fn open(
        domain: &Domain,
        schema: PolicySchema,
        settings: &ServeSettings,
    ) -> Result<Self, Error> {
        schema.check_fallback(settings.fallback)?;
        schema.check_draw(settings.draw)?;
        let format = schema.format()?;
        let membership = domain.enter()?;
        let lock = membership.take_end("policy.lock", "the policy", served_bytes(&format))?;
        let (link, presence) = {
            let _starting = membership.lock_start()?;
            let linger = settings.linger.unwrap_or(LINGER);
            let setup = ServedSetup { domain, format, linger };
            let link = ServedLink::server(&setup)?;
            let presence = link.presence(&setup)?;
            (link, presence)
        };
        ServedFacts::new(schema.clone(), settings.deadline, settings.fallback).write(domain)?;
        Ok(Self {
            presence,
            link,
            schema,
            format,
            settings: *settings,
            _caretaker: Caretaker::start(domain)?,
            _lock: lock,
            _membership: membership,
        })
    }

    /// Answers observations with `plan`, in this thread, until it is stopped. `observe` sees each of them. The guards are
    /// those of the plan's bytes ([`Guards::of_plan`]), which nobody else reads: where it has some, none is no choice.
    ///
    /// # Errors
    /// The plan is not that of the schema, the guards are not about what it takes and gives, the system refuses what the
    /// settings ask for, or shared memory fails.
    pub fn serve(
        &mut self,
        plan: &Plan<'_>,
        guards: Option<Guards<'_>>,
        observe: &mut dyn FnMut(&Served),
        stop: &Stop,
    ) -> Result<ServeCounters, Error> {
        if PolicySchema::of_plan(plan)? != self.schema.clone().unnamed() {
            let problem = "the plan is not that of the schema".to_owned();
            return Err(Error::NotServed { problem });
        }
        self.serve_with(&mut PlanEngine::new(plan), guards, observe, stop)
    }

    /// The same with an engine that gives what the schema says.
    ///
    /// # Errors
    /// The guards are not about what the schema says, the system refuses what the settings ask for, or shared memory fails.
    pub fn serve_with(
        &mut self,
        engine: &mut dyn Engine,
        guards: Option<Guards<'_>>,
        observe: &mut dyn FnMut(&Served),
        stop: &Stop,
    ) -> Result<ServeCounters, Error> {
        let guarding = Guarding::new(guards, &self.format)?;
        let mut told = ServerPresence::new(engine, self.format.schema());
        let mut decider = Decider::new(engine, &self.schema, self.settings.draw);
        decider.warm();
        self.settings.real_time.claim()?;
        stop.wakes(self.link.waker());
        let mut serving = Serving {
            clock: MonotonicClock,
            decider,
            guarding,
            format: self.format,
            fallback: self.settings.fallback,
            client: None,
            outputs: vec![0.0; self.format.outputs()],
            action: None,
            next: vec![0.0; self.format.outputs()],
            counters: ServeCounters::default(),
        };
        self.tell(&mut told, &serving.counters, StatMsg::HELLO);
        let ended = self.answer_until(&mut serving, &mut told, observe, stop);
        self.tell(&mut told, &serving.counters, StatMsg::BYE);
        ended.map(|()| serving.counters)
    }

    fn answer_until(
        &mut self,
        serving: &mut Serving<'_>,
        told: &mut ServerPresence,
        observe: &mut dyn FnMut(&Served),
        stop: &Stop,
    ) -> Result<(), Error> {
        let mut kept_house_ns = MonotonicClock.now_ns();
        while !stop.is_set() && !told.is_over {
            let token = self.link.token();
            let mut newest = None;
            while let Some(message) = self.link.receive()? {
                let order = order_of(message.bytes());
                if newest.as_ref().is_none_or(|(last, _)| *last <= order) {
                    newest = Some((order, message));
                }
            }
            if let Some((_, message)) = newest {
                if let Some(served) = serving.answer(&self.link, message.bytes()) {
                    told.note(&served);
                    observe(&served);
                }
                continue;
            }
            if self.presence.answer_requests(&mut |request| answer(told, request)) {
                continue;
            }
            let now_ns = MonotonicClock.now_ns();
            if now_ns.saturating_sub(kept_house_ns) >= HEARTBEAT_NS {
                self.link.housekeep();
                self.tell(told, &serving.counters, 0);
                kept_house_ns = now_ns;
            }
            self.link.wait(token, now_ns.saturating_add(HEARTBEAT_NS));
        }
        Ok(())
    }

    fn tell(&self, told: &mut ServerPresence, met: &ServeCounters, flags: u32) {
        self.presence.tell(&told.tell(met, flags, MonotonicClock.now_ns()));
    }
}

/// Of messages that wait the last one by this is answered: what was received last can be what a client left behind that was
/// killed, while the one after it waits for its answer. Sessions are numbered by their starts.
fn order_of(message: &[u8]) -> Option<(u64, u64)> {
    ObservationHead::of(message).map(|head| (head.session, head.seq))
}

/// Whose observation came last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Client {
    session: u64,
    episode: u32,
    seq: u64,
}

/// What the policy says, as far as guards let it through.
struct Decided {
    action: Option<u16>,
    /// The guard that brought outputs back to their limits.
    clamped: Option<Trip>,
}

struct Serving<'e, C = MonotonicClock> {
    clock: C,
    decider: Decider<'e>,
    guarding: Guarding<'e>,
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

impl<C: Clock> Serving<'_, C> {
    /// Answers one message. Whoever sent it may be gone.
    fn answer(&mut self, link: &ServedLink, bytes: &[u8]) -> Option<Served> {
        let woken_ns = self.clock.now_ns();
        let (head, served) = match self.format.read_observation(bytes) {
            Ok(observation) => self.decide(&observation, woken_ns),
            Err(error) => {
                self.counters.refused += 1;
                let ObservationHead { session, seq, t_ns, .. } = *ObservationHead::of(bytes)?;
                let status = AnswerStatus::Refused;
                let head = AnswerHead { session, seq, ..head(status, Reason::from(error), None) };
                let wake_ns = woken_ns.saturating_sub(t_ns);
                (head, Served { seq, status, trip: None, wake_ns, decide_ns: 0 })
            }
        };
        let head = AnswerHead { t_ns: self.clock.now_ns(), ..head };
        let Self { format, outputs, counters, .. } = self;
        let sent = link.send(|to| format.write_answer(&head, outputs, to));
        counters.failed_sends += u64::from(sent.is_err());
        Some(served)
    }

    fn decide(&mut self, observation: &ObservationView<'_>, woken_ns: u64) -> (AnswerHead, Served) {
        let ObservationView { head: asked, available, .. } = *observation;
        let mut flags = self.meet(asked);
        let wake_ns = woken_ns.saturating_sub(asked.t_ns);
        let (status, reason, trip) = match self.try_to_decide(observation, wake_ns) {
            Ok(Decided { action, clamped }) => {
                self.action = action;
                std::mem::swap(&mut self.outputs, &mut self.next);
                self.counters.answered += 1;
                self.counters.clamped += u64::from(clamped.is_some());
                flags |= if clamped.is_some() { AnswerHead::CLAMPED } else { 0 };
                (AnswerStatus::Answered, Reason::None, clamped)
            }
            Err(undecided) => {
                let last = Last { outputs: &mut self.outputs, action: self.action, available };
                self.action = self.guarding.fall_back(&undecided, self.fallback, last);
                self.counters.fallbacks += 1;
                let trip = undecided.trip();
                self.counters.guarded += u64::from(trip.is_some());
                (AnswerStatus::Fallback, undecided.reason(), trip)
            }
        };
        let now_ns = self.clock.now_ns();
        let is_late = status == AnswerStatus::Answered && now_ns > asked.deadline_ns;
        self.counters.late += u64::from(is_late);
        let status = if is_late { AnswerStatus::Late } else { status };
        let decide_ns = now_ns.saturating_sub(woken_ns);
        let ObservationHead { session, seq, .. } = *asked;
        let answer = AnswerHead {
            session,
            seq,
            flags,
            guard: trip.map_or(0, Trip::number),
            decide_ns: u32::try_from(decide_ns).unwrap_or(u32::MAX),
            ..head(status, reason, self.action)
        };
        (answer, Served { seq, status, trip, wake_ns, decide_ns })
    }

    /// The policy's outputs in `next`, within what the guards let through.
    fn try_to_decide(
        &mut self,
        observation: &ObservationView<'_>,
        age_ns: u64,
    ) -> Result<Decided, Undecided> {
        let ObservationView { inputs, available, .. } = *observation;
        self.guarding.check_inputs(inputs, age_ns)?;
        let action = self.decider.decide(inputs, available, &mut self.next)?;
        let clamped = self.guarding.check_outputs(&mut self.next)?;
        Ok(Decided { action, clamped })
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
            self.guarding.begin();
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

/// A server as others see it.
struct ServerPresence {
    presence: Presence,
    identity: Identity,
    schema: u64,
    /// Number of the newest observation, in its session.
    newest: u64,
    /// Of requests: what is counted of observations stands elsewhere.
    counters: Counters,
    /// It was told to end.
    is_over: bool,
}

impl ServerPresence {
    fn new(engine: &dyn Engine, schema: u64) -> Self {
        let identity = Identity {
            model: engine.model(),
            is_graph: engine.is_graph(),
            build: BUILD,
            ..Identity::new(std::process::id(), "policy")
        };
        Self {
            presence: Presence::default(),
            identity,
            schema,
            newest: 0,
            counters: Counters::default(),
            is_over: false,
        }
    }

    fn note(&mut self, served: &Served) {
        self.newest = served.seq;
        self.presence.note(served.wake_ns, served.decide_ns);
    }

    /// The next status, with `flags`.
    fn tell(&mut self, met: &ServeCounters, flags: u32, now_ns: u64) -> StatMsg {
        let counters = Counters {
            ticks: met.answered + met.fallbacks,
            frame_gaps: met.missed,
            late: met.late,
            fallbacks: met.fallbacks,
            schema_rejects: met.refused + self.counters.schema_rejects,
            // The first one took nobody's place.
            restarts_seen: met.sessions.saturating_sub(1),
            ..self.counters
        };
        let domain = (self.schema, Role::Runner);
        let told = self.presence.tell(&self.identity, domain, &counters, flags, now_ns);
        StatMsg { last_tick: self.newest, ..told }
    }
}

impl Controlled for ServerPresence {
    fn schema(&self) -> u64 {
        self.schema
    }

    fn tick(&self) -> u64 {
        self.newest
    }

    fn info(&self) -> ProcessInfo {
        ProcessInfo { serves: true, ..ProcessInfo::new(Role::Runner, &self.identity) }
    }

    fn counters_mut(&mut self) -> &mut Counters {
        &mut self.counters
    }

    fn obey(&mut self, command: Command, _: &ControlReq) -> ControlStatus {
        match command {
            Command::ShutDown => {
                self.is_over = true;
                ControlStatus::Done
            }
            // Another policy takes or gives something else: its server is started instead.
            Command::PrepareBundle => ControlStatus::NotSupported,
            _ => ControlStatus::NotMine,
        }
    }
}

/// What a server did since its start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ServeCounters {
    /// Answers of the policy, late ones among them.
    pub answered: u64,
    /// Answers of the policy after the deadline.
    pub late: u64,
    /// Observations that were answered by the fallback.
    pub fallbacks: u64,
    /// Those of them where a guard tripped, or was held.
    pub guarded: u64,
    /// Answers of the policy that were brought back to their limits.
    pub clamped: u64,
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
    /// Its number in the session, from 1.
    pub seq: u64,
    /// What became of it.
    pub status: AnswerStatus,
    /// The guard that tripped.
    pub trip: Option<Trip>,
    /// From its sending to this process running.
    pub wake_ns: u64,
    /// The decision alone.
    pub decide_ns: u64,
}

#[cfg(test)]
mod tests;
