//! The team's end of a line.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::net::SocketAddr;
use std::rc::Rc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use embedded_io::{ErrorType, Read, ReadReady, Write};

use crate::carrier::{Carrier, Hear};
use crate::datagram::{
    Head, Kind, LONGEST, LONGEST_SAID, Offer, Session, Team, Welcome, nonce, open, seal, take,
};
use crate::key::Key;
use crate::{LineError, LineSettings};

/// A runner that has not been heard for so long gives way to another one.
const PATIENCE: Duration = Duration::from_secs(1);
/// Longest wait for a datagram, so that the end is noticed.
const HEARTBEAT: Duration = Duration::from_millis(100);
/// How often last words are said: of a tenth lost, one in ten million times none of them arrives.
const LAST_WORDS: usize = 7;
/// Most runners that were welcomed and have not said anything yet.
const WELCOMED: usize = 16;
/// Most bytes that wait to be read; what is older was of ticks that are over.
const WAITING: usize = 1 << 20;

/// Who may be taken: what a runner has to know, or why it is not.
type Judge = Box<dyn Fn(&Offer) -> Result<Team, String> + Send + Sync>;

/// The team's end: a thread hears, of its own or of the carrier, whoever has it says.
pub struct Home {
    shared: Arc<Shared>,
    outgoing: Rc<RefCell<Vec<u8>>>,
    hearing: Option<JoinHandle<()>>,
}

struct Shared {
    carrier: Arc<dyn Carrier>,
    key: Key,
    /// How often everything is said.
    copies: usize,
    state: Mutex<State>,
    is_over: AtomicBool,
}

#[derive(Default)]
struct State {
    /// Who acts, as far as the team knows.
    runner: Option<Runner>,
    /// Who was welcomed, and has not said anything yet, the newest last. Whoever repeats an offer of another one never does, and
    /// keeps nobody from it.
    welcomed: VecDeque<Runner>,
    incoming: VecDeque<u8>,
    heard: Option<Instant>,
}

struct Runner {
    /// Both parts of its session.
    own: u64,
    team: u64,
    session: Session,
    /// Where it was heard from last, as far as the carrier tells.
    address: Option<SocketAddr>,
}

impl Runner {
    /// The head of what it is shown next, and where it is.
    fn next(&mut self) -> (Head, Option<SocketAddr>) {
        (self.session.next(Kind::Shown), self.address)
    }
}

impl Home {
    /// Listens for a runner that `judge` takes; `wake` is called whenever there is something to read.
    ///
    /// # Errors
    /// The system gives no thread that hears.
    pub fn open(
        LineSettings { carrier, key, copies }: LineSettings,
        judge: impl Fn(&Offer) -> Result<Team, String> + Send + Sync + 'static,
        wake: impl Fn() + Send + Sync + 'static,
    ) -> Result<Self, LineError> {
        let (state, is_over) = (Mutex::default(), AtomicBool::new(false));
        let shared = Arc::new(Shared { carrier, key, copies, state, is_over });
        let judge: Judge = Box::new(judge);
        // The carrier may have it for longer than there is somebody to hear.
        let listener = Arc::downgrade(&shared);
        let hear: Hear = Box::new(move |datagram, from| {
            if let Some(listener) = listener.upgrade() {
                listener.hear(datagram, from, &judge, &wake);
            }
        });
        let hearing = match shared.carrier.call(hear) {
            Ok(()) => None,
            Err(hear) => Some(shared.listen(hear)?),
        };
        Ok(Self { shared, outgoing: Rc::default(), hearing })
    }

    /// What a relay reads and writes.
    pub fn port(&self) -> HomePort {
        HomePort { shared: Arc::clone(&self.shared), outgoing: Rc::clone(&self.outgoing) }
    }

    /// Says what was written since, in one datagram. To nobody, where nobody is there.
    pub fn send(&self) {
        let said = self.outgoing.take();
        let addressed = self.shared.state().runner.as_mut().map(Runner::next);
        if let Some(to) = addressed {
            self.shared.show(&said, to, self.shared.copies);
        }
    }

    /// The same for the last words of a team: so often that whoever is there hears them, and who was welcomed a moment ago, too.
    pub fn send_last(&self) {
        let said = self.outgoing.take();
        let addressed: Vec<_> = {
            let State { runner, welcomed, .. } = &mut *self.shared.state();
            runner.iter_mut().chain(welcomed).map(Runner::next).collect()
        };
        addressed.into_iter().for_each(|to| self.shared.show(&said, to, LAST_WORDS));
    }

    /// How long ago the runner was heard last; none: never.
    pub fn silence(&self) -> Option<Duration> {
        let now = self.shared.carrier.now();
        self.shared.state().heard.map(|heard| now.saturating_duration_since(heard))
    }
}

impl Drop for Home {
    fn drop(&mut self) {
        self.shared.is_over.store(true, Ordering::Relaxed);
        // It has nothing to tell.
        let _ = self.hearing.take().map(JoinHandle::join);
    }
}

impl Shared {
    /// What is behind the lock is whole at any time.
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn say(&self, head: Head, said: &[u8], address: Option<SocketAddr>, copies: usize) {
        let datagram = seal(&self.key, head, said);
        for _ in 0..copies {
            self.carrier.send(&datagram, address);
        }
    }

    fn show(&self, said: &[u8], (head, address): (Head, Option<SocketAddr>), copies: usize) {
        if !said.is_empty() && said.len() <= LONGEST_SAID {
            self.say(head, said, address, copies);
        }
    }

    /// Begins to receive in a thread, which ends when this is over.
    fn listen(self: &Arc<Self>, hear: Hear) -> Result<JoinHandle<()>, LineError> {
        let shared = Arc::clone(self);
        let listen = move || {
            let mut buffer = vec![0; LONGEST];
            while !shared.is_over.load(Ordering::Relaxed) {
                match shared.carrier.receive(&mut buffer) {
                    Some((len, from)) => hear(buffer.get(..len).unwrap_or_default(), from),
                    None => shared.carrier.wait(HEARTBEAT),
                }
            }
        };
        let thread = std::thread::Builder::new().name("line".to_owned()).spawn(listen);
        let address = || self.carrier.address();
        thread.map_err(|source| LineError::Carrier { address: address(), source })
    }

    fn hear(&self, datagram: &[u8], from: Option<SocketAddr>, judge: &Judge, wake: &dyn Fn()) {
        let Some((head, said)) = open(&self.key, datagram) else { return };
        match head.kind {
            Kind::Offer => self.answer(head, said, from, judge),
            Kind::Answered if self.state().takes(head, said, (from, self.carrier.now())) => wake(),
            Kind::Answered | Kind::Welcome | Kind::Refusal | Kind::Shown => {}
        }
    }

    fn answer(&self, head: Head, said: &[u8], from: Option<SocketAddr>, judge: &Judge) {
        let judged = match postcard::from_bytes(said) {
            Ok(offer) => judge(&offer),
            Err(_) => Err("its version of the line is another one".to_owned()),
        };
        let welcomed = judged.map(|team| {
            let part = self.state().welcome(head.session, (from, self.carrier.now()), &self.key);
            part.map(|nonce| Welcome { nonce, team })
        });
        let (kind, words) = match welcomed {
            Ok(Some(welcome)) => (Kind::Welcome, postcard::to_stdvec(&welcome)),
            // Somebody else is there: no words, it may ask again.
            Ok(None) => (Kind::Refusal, Ok(Vec::new())),
            Err(reason) => (Kind::Refusal, Ok(reason.into_bytes())),
        };
        if let Ok(words) = words {
            self.say(Head { kind, ..head }, &words, from, self.copies);
        }
    }
}

/// Where a datagram came from, and when.
type From = (Option<SocketAddr>, Instant);

impl State {
    /// The team's part of a session with this runner; none while another one acts.
    fn welcome(&mut self, own: u64, (address, now): From, key: &Key) -> Option<u64> {
        let mut known = self.runner.iter().chain(&self.welcomed);
        if let Some(known) = known.find(|known| known.own == own) {
            return Some(known.team);
        }
        if self.heard.is_some_and(|heard| now.saturating_duration_since(heard) < PATIENCE) {
            return None;
        }
        let team = nonce().ok()?;
        let session = Session::new(key, own, team);
        if self.welcomed.len() == WELCOMED {
            self.welcomed.pop_front();
        }
        self.welcomed.push_back(Runner { own, team, session, address });
        Some(team)
    }

    /// Whether it is news of the runner, which then waits to be read.
    fn takes(&mut self, head: Head, said: &[u8], (address, now): From) -> bool {
        // With the first words of a session it begins, and an earlier one is over, as is every other that was to begin.
        if let Some(next) = self.welcomed.iter().position(|next| next.session.is_of(&head)) {
            self.runner = self.welcomed.remove(next);
            self.welcomed.clear();
        }
        let Some(runner) = &mut self.runner else { return false };
        if !runner.session.takes(&head) {
            return false;
        }
        runner.address = address;
        self.heard = Some(now);
        if self.incoming.len() + said.len() > WAITING {
            self.incoming.clear();
        }
        self.incoming.extend(said);
        true
    }
}

/// What a relay reads and writes: bytes in their order, as far as they came.
pub struct HomePort {
    shared: Arc<Shared>,
    outgoing: Rc<RefCell<Vec<u8>>>,
}

impl ErrorType for HomePort {
    type Error = Infallible;
}

impl Read for HomePort {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Infallible> {
        Ok(take(&mut self.shared.state().incoming, bytes))
    }
}

impl ReadReady for HomePort {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(!self.shared.state().incoming.is_empty())
    }
}

impl Write for HomePort {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        self.outgoing.borrow_mut().extend(bytes);
        Ok(bytes.len())
    }

    /// Nothing is said before [`Home::send`], then all of it at once.
    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}
