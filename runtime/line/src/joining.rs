//! How a runner becomes its team's: it offers itself until the team's end takes it.

use std::time::{Duration, Instant};

use crate::away::{Away, OFFER_EVERY};
use crate::datagram::{Head, Kind, Offer, Team, Welcome};
use crate::{LineError, LineSettings};

/// Round trips whose shortest is the line's.
const ROUND_TRIPS: u64 = 8;

/// A team that has taken a runner.
pub struct Taken {
    /// The line to it.
    pub line: Away,
    /// What the runner has to know.
    pub team: Team,
    /// The shortest of several.
    pub round_trip: Duration,
}

/// A runner that offers itself to a team, for whoever has other things to do meanwhile; [`Away::connect`] waits.
pub struct Joining {
    line: Away,
    /// The offer that waits for its answer, and when it was made.
    number: u64,
    said: Option<Instant>,
    shortest: Option<Duration>,
    /// Another runner is there.
    is_busy: bool,
}

impl Joining {
    /// Nothing is said before the first [`Self::poll`].
    ///
    /// # Errors
    /// The system gives no random numbers.
    pub fn new(settings: LineSettings, offer: &Offer) -> Result<Self, LineError> {
        let line = Away::open(settings, offer)?;
        Ok(Self { line, number: 0, said: None, shortest: None, is_busy: false })
    }

    /// Takes in what has come, and offers the runner where that is due. `None`: the team has not taken it yet; to be called
    /// again when something comes, and after [`Self::due`].
    ///
    /// # Errors
    /// The team does not take it.
    pub fn poll(&mut self) -> Result<Option<Taken>, LineError> {
        loop {
            if self.due().is_zero() {
                self.offer();
            }
            let Some((head, words)) = self.line.0.borrow_mut().receive() else { return Ok(None) };
            if !self.is_answer(&head) {
                continue;
            }
            match head.kind {
                Kind::Welcome => {
                    if let Some(taken) = self.welcome(&words) {
                        return Ok(Some(taken));
                    }
                }
                // Another runner is there: it may leave before the next offer.
                _ if words.is_empty() => self.is_busy = true,
                _ => {
                    let reason = String::from_utf8_lossy(&words).into_owned();
                    return Err(LineError::Refused { address: self.address(), reason });
                }
            }
        }
    }

    /// How long an answer is still waited for before the next offer.
    pub fn due(&self) -> Duration {
        let past = self.said.map(|said| self.now().saturating_duration_since(said));
        past.map_or(Duration::ZERO, |past| OFFER_EVERY.saturating_sub(past))
    }

    fn is_answer(&self, head: &Head) -> bool {
        let is_kind = matches!(head.kind, Kind::Welcome | Kind::Refusal);
        is_kind && head.session == self.line.0.borrow().own && head.number == self.number
    }

    /// The last of several welcomes begins the session.
    fn welcome(&mut self, words: &[u8]) -> Option<Taken> {
        let Welcome { nonce, team } = postcard::from_bytes(words).ok()?;
        let took = self.now().saturating_duration_since(self.said?);
        let round_trip = self.shortest.map_or(took, |shortest| shortest.min(took));
        self.shortest = Some(round_trip);
        self.number += 1;
        if self.number < ROUND_TRIPS {
            self.offer();
            return None;
        }
        self.line.0.borrow_mut().begin(nonce);
        Some(Taken { line: self.line.clone(), team, round_trip })
    }

    fn offer(&mut self) {
        self.said = Some(self.now());
        self.line.0.borrow_mut().offer(self.number);
    }

    fn now(&self) -> Instant {
        self.line.0.borrow().carrier.now()
    }

    fn address(&self) -> String {
        self.line.0.borrow().carrier.address()
    }
}

impl Away {
    /// Offers a runner to the team's end, for as long as `patience` lasts and `is_stopped` does not say so.
    ///
    /// # Errors
    /// Nobody answers, or the team does not take it.
    pub fn connect(
        settings: LineSettings,
        offer: Offer,
        patience: Duration,
        is_stopped: &dyn Fn() -> bool,
    ) -> Result<Taken, LineError> {
        let carrier = settings.carrier.clone();
        let began = carrier.now();
        let mut joining = Joining::new(settings, &offer)?;
        loop {
            if is_stopped() {
                return Err(LineError::Interrupted);
            }
            if let Some(taken) = joining.poll()? {
                return Ok(taken);
            }
            if carrier.now().saturating_duration_since(began) > patience {
                let address = carrier.address();
                return Err(match joining.is_busy {
                    true => LineError::Busy { address },
                    false => LineError::NoAnswer { address },
                });
            }
            carrier.wait(joining.due());
        }
    }
}
