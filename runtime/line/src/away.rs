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
    Head, Kind, LONGEST, LONGEST_SAID, Offer, Session, Team, Welcome, nonce, open, seal, take,
};
use crate::key::Key;
use crate::{LineError, LineSettings};

/// Pause between two offers that nobody answers.
const OFFER_EVERY: Duration = Duration::from_millis(100);
/// After so long without a word of its team it offers itself anew: the team's end may be another one.
const SILENCE: Duration = Duration::from_secs(1);
/// Round trips whose shortest is the line's.
const ROUND_TRIPS: u64 = 8;

/// The runner's end. Clones are the same end.
#[derive(Clone)]
pub struct Away(Rc<RefCell<End>>);

struct End {
    carrier: Arc<dyn Carrier>,
    key: Key,
    copies: usize,
    offer: Vec<u8>,
    /// Both parts of the session.
    own: u64,
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

/// A team that has taken a runner.
pub struct Taken {
    /// The line to it.
    pub line: Away,
    /// What the runner has to know.
    pub team: Team,
    /// The shortest of several.
    pub round_trip: Duration,
}

impl Away {
    /// Offers a runner to the team's end, for as long as `patience` lasts and `is_stopped` does not say so.
    ///
    /// # Errors
    /// Nobody answers, or the team does not take it.
    pub fn connect(
        LineSettings { carrier, key, copies }: LineSettings,
        offer: Offer,
        patience: Duration,
        is_stopped: &dyn Fn() -> bool,
    ) -> Result<Taken, LineError> {
        let failed = |source| LineError::Carrier { address: carrier.address(), source };
        let offer = postcard::to_stdvec(&offer).map_err(std::io::Error::other).map_err(failed)?;
        let own = nonce().map_err(failed)?;
        let now = Instant::now();
        let mut end = End {
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
        };
        let (team, round_trip) = end.offer_until_taken(patience, is_stopped)?;
        Ok(Taken { line: Self(Rc::new(RefCell::new(end))), team, round_trip })
    }

    /// What waits for a packet and knows the time.
    pub fn rest(&self) -> Rest {
        let carrier = Arc::clone(&self.0.borrow().carrier);
        Rest { carrier, began: Instant::now(), until_ns: AtomicU64::new(0) }
    }

    /// Says what was written since, in one datagram, and offers the runner anew where the team has been silent for long.
    pub fn send(&self) {
        let mut end = self.0.borrow_mut();
        let said = std::mem::take(&mut end.outgoing);
        if !said.is_empty() && said.len() <= LONGEST_SAID {
            let head = end.session.next(Kind::Answered);
            end.say(head, &said);
        }
        if end.heard.elapsed() > SILENCE && end.offered.elapsed() > OFFER_EVERY {
            end.offer(0);
        }
    }

    /// How long ago the team was heard last.
    pub fn silence(&self) -> Duration {
        self.0.borrow().heard.elapsed()
    }

    /// Whether the team's end is another one than that which took the runner: it has to be offered anew.
    pub fn is_replaced(&self) -> bool {
        self.0.borrow().is_replaced
    }
}

impl End {
    fn offer_until_taken(
        &mut self,
        patience: Duration,
        is_stopped: &dyn Fn() -> bool,
    ) -> Result<(Team, Duration), LineError> {
        let address = self.carrier.address();
        let (began, mut shortest, mut number) = (Instant::now(), None::<Duration>, 0);
        let mut is_taken = false;
        loop {
            if is_stopped() {
                return Err(LineError::Interrupted);
            }
            if began.elapsed() > patience {
                return Err(match is_taken {
                    true => LineError::Busy { address },
                    false => LineError::NoAnswer { address },
                });
            }
            let said = Instant::now();
            self.offer(number);
            let Some((head, words)) = self.await_answer(number, said) else { continue };
            match head.kind {
                Kind::Welcome => {
                    let Ok(welcome) = postcard::from_bytes::<Welcome>(&words) else { continue };
                    let took = said.elapsed();
                    let round_trip = shortest.map_or(took, |shortest| shortest.min(took));
                    shortest = Some(round_trip);
                    number += 1;
                    if number == ROUND_TRIPS {
                        self.team = welcome.nonce;
                        self.session = Session::new(&self.key, self.own, self.team);
                        self.heard = Instant::now();
                        return Ok((welcome.team, round_trip));
                    }
                }
                // Another runner is there: it may leave.
                _ if words.is_empty() => {
                    is_taken = true;
                    std::thread::sleep(OFFER_EVERY);
                }
                _ => {
                    let reason = String::from_utf8_lossy(&words).into_owned();
                    return Err(LineError::Refused { address, reason });
                }
            }
        }
    }

    /// The answer to an offer of this number, if it comes soon.
    fn await_answer(&mut self, number: u64, since: Instant) -> Option<(Head, Vec<u8>)> {
        while since.elapsed() < OFFER_EVERY {
            let Some((head, words)) = self.receive() else {
                self.carrier.wait(OFFER_EVERY.saturating_sub(since.elapsed()));
                continue;
            };
            let is_answer = matches!(head.kind, Kind::Welcome | Kind::Refusal);
            if is_answer && head.session == self.own && head.number == number {
                return Some((head, words));
            }
        }
        None
    }

    fn offer(&mut self, number: u64) {
        self.offered = Instant::now();
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
    fn receive(&mut self) -> Option<(Head, Vec<u8>)> {
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
                    self.heard = Instant::now();
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
        self.began.elapsed().as_nanos() as u64
    }
}

impl Processor for Rest {
    fn rest(&self) {
        let left_ns = self.until_ns.load(Ordering::Relaxed).saturating_sub(self.now_ns());
        self.carrier.wait(Duration::from_nanos(left_ns));
    }
}
