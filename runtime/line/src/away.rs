//! The runner's end of a line.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use embedded_io::{ErrorType, Read, ReadReady, Write};
use sortie_core::link::{Clock, Processor};

use crate::carrier::Carrier;
use crate::datagram::{
    Head, Kind, LONGEST, LONGEST_SAID, Offer, Session, Welcome, nonce, open, seal, take,
};
use crate::key::Key;
use crate::{LineError, LineSettings};

/// Pause between two offers that nobody answers.
pub(crate) const OFFER_EVERY: Duration = Duration::from_millis(100);
/// After so long without a word of its team it offers itself anew: the team's end may be another one.
const SILENCE: Duration = Duration::from_secs(1);

/// The runner's end. Clones are the same end.
#[derive(Clone)]
pub struct Away(pub(crate) Rc<RefCell<End>>);

pub(crate) struct End {
    pub(crate) carrier: Arc<dyn Carrier>,
    key: Key,
    copies: usize,
    offer: Vec<u8>,
    /// Both parts of the session.
    pub(crate) own: u64,
    team: u64,
    session: Session,
    incoming: VecDeque<u8>,
    outgoing: Vec<u8>,
    heard: Instant,
    offered: Instant,
    /// The team's end is another one.
    is_replaced: bool,
    buffer: Vec<u8>,
}

impl Away {
    /// One that nobody has taken yet.
    pub(crate) fn open(
        LineSettings { carrier, key, copies }: LineSettings,
        offer: &Offer,
    ) -> Result<Self, LineError> {
        let failed = |source| LineError::Carrier { address: carrier.address(), source };
        let offer = postcard::to_stdvec(offer).map_err(std::io::Error::other).map_err(failed)?;
        let own = nonce().map_err(failed)?;
        let now = carrier.now();
        Ok(Self(Rc::new(RefCell::new(End {
            session: Session::new(&key, own, 0),
            carrier,
            key,
            copies,
            offer,
            own,
            team: 0,
            incoming: VecDeque::new(),
            outgoing: Vec::new(),
            heard: now,
            offered: now,
            is_replaced: false,
            buffer: vec![0; LONGEST],
        }))))
    }

    /// What waits for a packet and knows the time.
    pub fn rest(&self) -> Rest {
        let carrier = Arc::clone(&self.0.borrow().carrier);
        Rest { began: carrier.now(), carrier, until_ns: AtomicU64::new(0) }
    }

    /// Says what was written since, in one datagram, and offers the runner anew where the team has been silent for long.
    pub fn send(&self) {
        let mut end = self.0.borrow_mut();
        let said = std::mem::take(&mut end.outgoing);
        if !said.is_empty() && said.len() <= LONGEST_SAID {
            let head = end.session.next(Kind::Answered);
            end.say(head, &said);
        }
        if end.since(end.heard) > SILENCE && end.since(end.offered) > OFFER_EVERY {
            end.offer(0);
            // Who is cut off has nothing to answer. But where its first words were lost the team's end shows it nothing before it
            // has said some.
            let head = end.session.next(Kind::Answered);
            end.say(head, &[]);
        }
    }

    /// Takes in what has come; whoever reads does so, too.
    pub fn hear(&self) {
        self.0.borrow_mut().pump();
    }

    /// How long ago the team was heard last.
    pub fn silence(&self) -> Duration {
        let end = self.0.borrow();
        end.since(end.heard)
    }

    /// Whether the team's end is another one than that which took the runner: it has to be offered anew.
    pub fn is_replaced(&self) -> bool {
        self.0.borrow().is_replaced
    }
}

impl End {
    fn since(&self, then: Instant) -> Duration {
        self.carrier.now().saturating_duration_since(then)
    }

    /// The team has welcomed the runner with its part of the session.
    pub(crate) fn begin(&mut self, team: u64) {
        self.team = team;
        self.session = Session::new(&self.key, self.own, team);
        self.heard = self.carrier.now();
    }

    /// Says what the runner is, the time from which an answer counts. An answer has the same number.
    pub(crate) fn offer(&mut self, number: u64) {
        self.offered = self.carrier.now();
        let offer = self.offer.clone();
        self.say(Head { kind: Kind::Offer, session: self.own, number }, &offer);
    }

    fn say(&self, head: Head, said: &[u8]) {
        let datagram = seal(&self.key, head, said);
        for _ in 0..self.copies {
            self.carrier.send(&datagram, None);
        }
    }

    /// The next datagram of whoever has the key, if one has come.
    pub(crate) fn receive(&mut self) -> Option<(Head, Vec<u8>)> {
        loop {
            let (len, _) = self.carrier.receive(&mut self.buffer)?;
            let datagram = self.buffer.get(..len)?;
            if let Some((head, said)) = open(&self.key, datagram) {
                return Some((head, said.to_vec()));
            }
        }
    }

    /// Takes in what has come.
    fn pump(&mut self) {
        while let Some((head, said)) = self.receive() {
            match head.kind {
                Kind::Shown if self.session.takes(&head) => {
                    self.heard = self.carrier.now();
                    self.incoming.extend(said);
                }
                Kind::Welcome if head.session == self.own => {
                    let welcome = postcard::from_bytes::<Welcome>(&said);
                    self.is_replaced |= welcome.is_ok_and(|welcome| welcome.nonce != self.team);
                }
                _ => {}
            }
        }
    }
}

impl ErrorType for Away {
    type Error = Infallible;
}

impl Read for Away {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Infallible> {
        Ok(take(&mut self.0.borrow_mut().incoming, bytes))
    }
}

impl ReadReady for Away {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        let mut end = self.0.borrow_mut();
        if end.incoming.is_empty() {
            end.pump();
        }
        Ok(!end.incoming.is_empty())
    }
}

impl Write for Away {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        self.0.borrow_mut().outgoing.extend(bytes);
        Ok(bytes.len())
    }

    /// Nothing is said before [`Away::send`], then all of it at once.
    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// Sleeps until a packet comes, or a time that was stated.
pub struct Rest {
    carrier: Arc<dyn Carrier>,
    began: Instant,
    until_ns: AtomicU64,
}

impl Rest {
    /// No sleep from now on lasts longer than until this time of its clock.
    pub fn until(&self, until_ns: u64) {
        self.until_ns.store(until_ns, Ordering::Relaxed);
    }
}

impl Clock for Rest {
    fn now_ns(&self) -> u64 {
        // Of a process that runs for less than five hundred years.
        self.carrier.now().saturating_duration_since(self.began).as_nanos() as u64
    }
}

impl Processor for Rest {
    fn rest(&self) {
        let left_ns = self.until_ns.load(Ordering::Relaxed).saturating_sub(self.now_ns());
        self.carrier.wait(Duration::from_nanos(left_ns));
    }
}
