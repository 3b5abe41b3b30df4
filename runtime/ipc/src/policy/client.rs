//! The robot's side: asks the server of its domain, and acts by the fallback where no answer comes.

use std::time::Duration;

use sortie_core::link::{Clock, Wake};
use sortie_core::wire::{AnswerHead, AnswerStatus, ObservationHead, Reason, ServedFormat};

use super::schema::ServedFacts;
use super::{Expected, Fallback, PolicySchema};
use crate::domain::{Domain, Lock, Membership, nanoseconds};
use crate::error::Error;
use crate::iox::{AnyThread, InterProcess, LinkService, ServedLink, ServedSetup, served_bytes};
use crate::processes::{HEARTBEAT_NS, LINGER};
use crate::stop::MonotonicClock;

/// Pause between two looks for a server.
const LOOK_EVERY: Duration = Duration::from_millis(10);

/// How a robot's program asks.
#[derive(Clone, Copy, Debug)]
pub struct ClientSettings {
    /// How long an answer is waited for; `None` = as the server says.
    pub deadline: Option<Duration>,
    /// What is done where none comes; `None` = as the server says.
    pub fallback: Option<Fallback>,
    /// How long a server is waited for at the start.
    pub patience: Duration,
    /// How long waits linger before they sleep; `None` = 100 us.
    pub linger: Option<Duration>,
}

impl Default for ClientSettings {
    /// The server's deadline and fallback; ten seconds for a server to start.
    fn default() -> Self {
        Self { deadline: None, fallback: None, patience: Duration::from_secs(10), linger: None }
    }
}

/// What a client met since its start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ClientCounters {
    /// Answers of the policy, late ones among them.
    pub answered: u64,
    /// Answers of the policy that were sent after the deadline and still waited for.
    pub late: u64,
    /// Fallbacks, the server's and its own.
    pub fallbacks: u64,
    /// Observations without any answer in time.
    pub silent: u64,
    /// Answers to earlier observations: they came too late.
    pub overdue: u64,
    /// Messages that are no answers of this policy.
    pub foreign: u64,
    /// Times that the server has lost the recurrent state within an episode.
    pub lost_states: u64,
}

/// What a robot is to do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Action<'a> {
    /// Whether it is the policy's, or the fallback.
    pub status: AnswerStatus,
    /// Why it is the fallback.
    pub reason: Reason,
    /// The action; `None` where the policy does not choose, or none is available.
    pub action: Option<u16>,
    /// All outputs, one behind the other.
    pub outputs: &'a [f32],
    /// The server began within the episode with a new recurrent state: it was started anew. Said once, also where its
    /// first answer came too late.
    pub lost_state: bool,
}

/// A connection to the server of a domain. It outlives servers: while there is none, every decision is the
/// fallback, and the next server goes on with the episode from a new recurrent state.
///
/// It stays on the thread that made it; one over [`AnyThread`] may go from thread to thread.
pub struct PolicyClient<S: LinkService = InterProcess> {
    link: ServedLink<S>,
    schema: PolicySchema,
    format: ServedFormat,
    deadline_ns: u64,
    fallback: Fallback,
    session: u64,
    seq: u64,
    episode: u32,
    /// The episode's first observation.
    first_seq: u64,
    /// Whether the policy has answered in this episode.
    is_remembered: bool,
    /// Whether it has then lost the episode's state, which is not told yet.
    lost_state: bool,
    /// What was done last.
    outputs: Vec<f32>,
    action: Option<u16>,
    counters: ClientCounters,
    _seat: Lock,
    /// Dropped last.
    _membership: Membership,
}

impl PolicyClient {
    /// Waits for a server, and checks that its policy takes and gives what is expected.
    ///
    /// # Errors
    /// No server in time, another policy, another client in this domain, or shared memory cannot be used.
    pub fn connect(
        domain: &Domain,
        expected: &Expected<'_>,
        settings: &ClientSettings,
    ) -> Result<Self, Error> {
        Self::open(domain, Some(expected), settings)
    }
}

impl PolicyClient<AnyThread> {
    /// As [`PolicyClient::connect`], for a client that goes from thread to thread, and to whatever policy is served:
    /// [`Self::schema`] says what it takes and gives, [`PolicySchema::check`] whether that is what is expected.
    ///
    /// # Errors
    /// As [`PolicyClient::connect`].
    pub fn connect_for_threads(domain: &Domain, settings: &ClientSettings) -> Result<Self, Error> {
        Self::open(domain, None, settings)
    }
}

impl<S: LinkService> PolicyClient<S> {
    fn open(
        domain: &Domain,
        expected: Option<&Expected<'_>>,
        settings: &ClientSettings,
    ) -> Result<Self, Error> {
        let membership = domain.enter()?;
        let facts = await_facts(domain, settings.patience)?;
        facts.check(domain, expected)?;
        let fallback = settings.fallback.unwrap_or(facts.fallback);
        facts.schema.check_fallback(fallback)?;
        let format = facts.schema.format()?;
        let seat = membership.take_end("client.lock", "the robot", served_bytes(&format))?;
        let link = {
            let _starting = membership.lock_start()?;
            let linger = settings.linger.unwrap_or(LINGER);
            ServedLink::client(&ServedSetup { domain, format, linger })?
        };
        let deadline = settings.deadline.unwrap_or_else(|| facts.deadline());
        Ok(Self {
            link,
            format,
            deadline_ns: nanoseconds(deadline),
            fallback,
            // One client after the other: no two of them start at the same time.
            session: MonotonicClock.now_ns(),
            seq: 0,
            episode: 0,
            first_seq: 1,
            is_remembered: false,
            lost_state: false,
            outputs: vec![0.0; format.outputs()],
            action: None,
            counters: ClientCounters::default(),
            schema: facts.schema,
            _seat: seat,
            _membership: membership,
        })
    }

    /// What the policy takes and gives.
    pub fn schema(&self) -> &PolicySchema {
        &self.schema
    }

    /// What happened since the start.
    pub fn counters(&self) -> ClientCounters {
        self.counters
    }

    /// Waits so long for every answer from now on.
    pub fn set_deadline(&mut self, deadline: Duration) {
        self.deadline_ns = nanoseconds(deadline);
    }

    /// The next observation begins an episode: the recurrent state starts anew.
    pub fn begin_episode(&mut self) {
        self.episode = self.episode.wrapping_add(1);
        self.first_seq = self.seq + 1;
        self.is_remembered = false;
        self.lost_state = false;
    }

    /// What to do on these inputs, in the order of the schema; `available` `[U]` has 0 for actions that are not
    /// available, and is empty where the policy does not choose. Returns at the deadline at the latest.
    ///
    /// # Errors
    /// [`Error::BadObservation`]: the lengths are not the policy's, and nothing was sent. Whatever the server does
    /// is no error, but the fallback.
    pub fn decide(&mut self, inputs: &[&[f32]], available: &[u16]) -> Result<Action<'_>, Error> {
        self.decide_while(inputs, available, &mut || true)
    }

    /// As [`Self::decide`], for callers with a patience of their own: `goes_on` is asked about every 100 ms while there
    /// is no answer.
    ///
    /// # Errors
    /// As [`Self::decide`]; [`Error::Interrupted`] where `goes_on` says no, and the observation may still reach the
    /// policy.
    pub fn decide_while(
        &mut self,
        inputs: &[&[f32]],
        available: &[u16],
        goes_on: &mut dyn FnMut() -> bool,
    ) -> Result<Action<'_>, Error> {
        self.check(inputs, available)?;
        self.seq += 1;
        let t_ns = MonotonicClock.now_ns();
        let deadline_ns = t_ns.saturating_add(self.deadline_ns);
        let Self { session, seq, episode, format, .. } = *self;
        let head =
            ObservationHead { session, seq, t_ns, deadline_ns, episode, ..Default::default() };
        let sent = self.link.send(|to| format.write_observation(&head, inputs, available, to));
        let answer = match sent {
            Ok(()) => self.await_answer(deadline_ns, goes_on)?,
            Err(_) => None,
        };
        let (status, reason) = match answer {
            Some(answer) => self.take(&answer, available),
            None => {
                self.counters.silent += 1;
                self.fall_back(Reason::Silence, available)
            }
        };
        let lost_state = std::mem::take(&mut self.lost_state);
        Ok(Action { status, reason, action: self.action, outputs: &self.outputs, lost_state })
    }

    fn check(&self, inputs: &[&[f32]], available: &[u16]) -> Result<(), Error> {
        let PolicySchema { actions, inputs: ports, .. } = &self.schema;
        let wanted = || ports.iter().map(|port| port.length);
        let given = || inputs.iter().map(|input| input.len());
        let problem = if !wanted().eq(given()) {
            let [given, wanted]: [Vec<_>; 2] = [given().collect(), wanted().collect()];
            format!("its inputs have {given:?} numbers, the policy's {wanted:?}")
        } else if available.len() != *actions {
            format!("its mask is about {} actions, the policy's {actions}", available.len())
        } else {
            return Ok(());
        };
        Err(Error::BadObservation { problem })
    }

    /// Waits for the answer to the newest observation, and copies its outputs.
    fn await_answer(
        &mut self,
        deadline_ns: u64,
        goes_on: &mut dyn FnMut() -> bool,
    ) -> Result<Option<AnswerHead>, Error> {
        loop {
            let token = self.link.token();
            if let Some(answer) = self.look() {
                return Ok(Some(answer));
            }
            let now_ns = MonotonicClock.now_ns();
            if now_ns >= deadline_ns {
                return Ok(None);
            }
            let heartbeat_ns = now_ns.saturating_add(HEARTBEAT_NS);
            let woken = self.link.wait(token, deadline_ns.min(heartbeat_ns));
            if woken == Wake::Timeout && heartbeat_ns < deadline_ns && !goes_on() {
                return Err(Error::Interrupted);
            }
        }
    }

    fn look(&mut self) -> Option<AnswerHead> {
        // A topic that fails is silent.
        while let Some(message) = self.link.receive().ok().flatten() {
            let Ok(answer) = self.format.read_answer(message.payload()) else {
                self.counters.foreign += 1;
                continue;
            };
            let AnswerHead { session, seq, .. } = *answer.head;
            if session == self.session && seq >= self.first_seq {
                let lost_state = self.is_remembered && answer.head.has(AnswerHead::STATE_RESET);
                self.lost_state |= lost_state;
                self.counters.lost_states += u64::from(lost_state);
                self.is_remembered = true;
            }
            if (session, seq) != (self.session, self.seq) {
                self.counters.overdue += 1;
                continue;
            }
            if answer.head.status != AnswerStatus::Refused as u16 {
                self.outputs.copy_from_slice(answer.outputs);
            }
            return Some(*answer.head);
        }
        None
    }

    /// Does what the server says; what it refuses, or says in numbers that mean nothing, is the fallback.
    fn take(&mut self, answer: &AnswerHead, available: &[u16]) -> (AnswerStatus, Reason) {
        let reason = Reason::from_number(answer.reason).unwrap_or(Reason::Policy);
        match AnswerStatus::from_number(answer.status) {
            Some(AnswerStatus::Refused) | None => self.fall_back(reason, available),
            Some(_) if !is_available(answer.action, available) => {
                self.fall_back(Reason::Policy, available)
            }
            Some(status) => {
                let is_fallback = status == AnswerStatus::Fallback;
                self.counters.fallbacks += u64::from(is_fallback);
                self.counters.answered += u64::from(!is_fallback);
                self.counters.late += u64::from(status == AnswerStatus::Late);
                self.action = u16::try_from(answer.action).ok();
                (status, reason)
            }
        }
    }

    fn fall_back(&mut self, reason: Reason, available: &[u16]) -> (AnswerStatus, Reason) {
        self.counters.fallbacks += 1;
        self.action = self.fallback.apply(&mut self.outputs, self.action, available);
        (AnswerStatus::Fallback, reason)
    }
}

/// Whether an action may be taken; -1 where none may.
fn is_available(action: i32, available: &[u16]) -> bool {
    match usize::try_from(action) {
        Ok(action) => available.get(action).is_some_and(|&code| code != 0),
        Err(_) => action == -1 && available.iter().all(|&code| code == 0),
    }
}

fn await_facts(domain: &Domain, patience: Duration) -> Result<ServedFacts, Error> {
    let until_ns = MonotonicClock.now_ns().saturating_add(nanoseconds(patience));
    loop {
        if let Some(facts) = ServedFacts::read(domain)? {
            return Ok(facts);
        }
        if MonotonicClock.now_ns() >= until_ns {
            return Err(Error::NoServer { domain: domain.id().to_string() });
        }
        std::thread::sleep(LOOK_EVERY);
    }
}
