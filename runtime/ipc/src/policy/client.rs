//! The robot's side: asks the server of its domain, and acts by the fallback where no answer comes.

use std::time::Duration;

use sortie_core::link::{Clock, Wake};
use sortie_core::wire::MessageError;

use super::asking::{Action, Asking, ClientCounters, Line};
use super::schema::ServedFacts;
use super::{Expected, Fallback, PolicySchema};
use crate::domain::{Domain, Lock, Membership, nanoseconds};
use crate::error::Error;
use crate::iox::{AnyThread, InterProcess, LinkService, ServedLink, ServedSetup, served_bytes};
use crate::processes::LINGER;
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

/// A connection to the server of a domain. It outlives servers: while there is none, every decision is the
/// fallback, and the next server goes on with the episode from a new recurrent state.
///
/// It stays on the thread that made it; one over [`AnyThread`] may go from thread to thread.
pub struct PolicyClient<S: LinkService = InterProcess> {
    link: ServedLink<S>,
    schema: PolicySchema,
    asking: Asking,
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
        // One client after the other: no two of them start at the same time.
        let session = MonotonicClock.now_ns();
        Ok(Self {
            link,
            asking: Asking::new(format, deadline, fallback, session),
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
        self.asking.counters()
    }

    /// Waits so long for every answer from now on.
    pub fn set_deadline(&mut self, deadline: Duration) {
        self.asking.set_deadline(deadline);
    }

    /// The next observation begins an episode: the recurrent state starts anew.
    pub fn begin_episode(&mut self) {
        self.asking.begin_episode();
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
        self.asking.decide(&self.link, inputs, available, goes_on)
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
}

impl<S: LinkService> Clock for ServedLink<S> {
    fn now_ns(&self) -> u64 {
        MonotonicClock.now_ns()
    }
}

impl<S: LinkService> Line for ServedLink<S> {
    fn send(&self, write: impl FnOnce(&mut [u8]) -> Result<(), MessageError>) -> Result<(), Error> {
        self.send(write)
    }

    fn receive<T>(&self, read: impl FnOnce(&[u8]) -> T) -> Option<T> {
        // A topic that fails is silent.
        let message = self.receive().ok().flatten()?;
        Some(read(message.bytes()))
    }

    fn token(&self) -> u32 {
        self.token()
    }

    fn wait(&self, token: u32, until_ns: u64) -> Wake {
        self.wait(token, until_ns)
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
