//! A session of zenoh as what carries a line.

use std::borrow::Cow;
use std::collections::VecDeque;
use std::net::SocketAddr;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

use sortie_line::{Carrier, Hear};
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::{CongestionControl, Priority};
use zenoh::{Session, Wait};

use crate::configuration::{End, ZenohError, ZenohSettings};

/// Most datagrams that wait to be received; the oldest of more are lost, as on the way.
const WAITING: usize = 1024;

/// How long a session goes on after what was said last: its end goes before all that still waits to be sent, and that is lost.
const FAREWELL: Duration = Duration::from_millis(50);

/// One end of a line through zenoh: it publishes what it says, and subscribes to what the other end says.
pub struct ZenohCarrier {
    address: String,
    arrivals: Arc<Arrivals>,
    publisher: Publisher<'static>,
    /// They end with this.
    _subscriber: Subscriber<()>,
    _session: Session,
}

/// What comes: it is told, or waits to be received.
#[derive(Default)]
struct Arrivals {
    hear: OnceLock<Hear>,
    waiting: Mutex<VecDeque<Vec<u8>>>,
    came: Condvar,
}

impl ZenohCarrier {
    /// Opens one end. Whether the other one is there does not matter: it is looked for until it is, and again whenever it is lost.
    ///
    /// # Errors
    /// The configuration or the locator is none of zenoh's, or nobody can listen there.
    pub fn open(settings: &ZenohSettings<'_>) -> Result<Self, ZenohError> {
        let address = settings.address();
        let failed = |error: zenoh::Error| {
            let (address, reason) = (address.clone(), error.to_string());
            ZenohError::Session { address, reason }
        };
        let other = match settings.end {
            End::Home => End::Away,
            End::Away => End::Home,
        };
        let session = zenoh::open(settings.configuration()?).wait().map_err(failed)?;
        let arrivals = Arc::<Arrivals>::default();
        let arriving = Arc::clone(&arrivals);
        let subscriber = session
            .declare_subscriber(settings.key(other))
            .callback(move |sample| arriving.take(sample.payload().to_bytes()))
            .wait()
            .map_err(failed)?;
        // Blocked, a `put` waits for seconds and a world with it; in a batch, for others that it could go with.
        let publisher = session
            .declare_publisher(settings.key(settings.end))
            .congestion_control(CongestionControl::Drop)
            .priority(Priority::RealTime)
            .express(true)
            .wait()
            .map_err(failed)?;
        Ok(Self { address, arrivals, publisher, _subscriber: subscriber, _session: session })
    }
}

impl Drop for ZenohCarrier {
    fn drop(&mut self) {
        std::thread::sleep(FAREWELL);
    }
}

impl Arrivals {
    /// What is behind the lock is whole at any time.
    fn waiting(&self) -> MutexGuard<'_, VecDeque<Vec<u8>>> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn take(&self, datagram: Cow<'_, [u8]>) {
        if let Some(hear) = self.hear.get() {
            return hear(&datagram, None);
        }
        let mut waiting = self.waiting();
        if waiting.len() == WAITING {
            waiting.pop_front();
        }
        waiting.push_back(datagram.into_owned());
        drop(waiting);
        self.came.notify_one();
    }
}

impl Carrier for ZenohCarrier {
    /// All that have joined under this key get it: their sessions tell them what is theirs.
    fn send(&self, datagram: &[u8], _: Option<SocketAddr>) {
        let _ = self.publisher.put(datagram).wait();
    }

    fn receive(&self, room: &mut [u8]) -> Option<(usize, Option<SocketAddr>)> {
        loop {
            let datagram = self.arrivals.waiting().pop_front()?;
            // One that is longer than any of a line is none.
            if let Some(room) = room.get_mut(..datagram.len()) {
                room.copy_from_slice(&datagram);
                return Some((datagram.len(), None));
            }
        }
    }

    fn wait(&self, most: Duration) {
        let waiting = self.arrivals.waiting();
        drop(self.arrivals.came.wait_timeout_while(waiting, most, |waiting| waiting.is_empty()));
    }

    fn address(&self) -> String {
        self.address.clone()
    }

    /// A thread of zenoh's hears: another one would have to be woken first.
    fn call(&self, hear: Hear) -> Result<(), Hear> {
        self.arrivals.hear.set(hear)
    }
}
