//! The quality of service that a token tells of.
//!
//! As rmw_zenoh writes it: `reliability:durability:history,depth:deadline:lifespan:liveliness`, numbers of ROS's own lists and
//! times as `seconds,nanoseconds`, with nothing where it is what rmw_zenoh takes by default.

use std::fmt;

/// Why a text is no quality of service: which part of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("its quality of service has no {0} that is known")]
pub struct QosError(pub &'static str);

/// Whether what is lost is sent again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reliability {
    /// It is.
    Reliable = 1,
    /// It is not.
    BestEffort = 2,
    /// As the other end has it.
    BestAvailable = 4,
}

/// Whether who comes late is sent what was said before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Durability {
    /// It is: the publisher keeps it.
    TransientLocal = 1,
    /// It is not.
    Volatile = 2,
    /// As the other end has it.
    BestAvailable = 4,
}

/// What is kept for who is slow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum History {
    /// The newest.
    KeepLast = 1,
    /// All.
    KeepAll = 2,
}

/// Who says that a publisher is alive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Liveliness {
    /// Its node.
    Automatic = 1,
    /// Itself.
    ManualByTopic = 3,
    /// As the other end has it.
    BestAvailable = 5,
}

/// A span of time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span {
    /// Whole seconds.
    pub seconds: u64,
    /// Nanoseconds of the next.
    pub nanoseconds: u64,
}

impl Span {
    /// ROS's number for without end.
    pub const INFINITE: Self = Self { seconds: 9_223_372_036, nanoseconds: 854_775_807 };
}

/// How messages of a publisher or a subscription are treated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Qos {
    /// Whether what is lost is sent again.
    pub reliability: Reliability,
    /// Whether who comes late is sent what was said before.
    pub durability: Durability,
    /// What is kept for who is slow.
    pub history: History,
    /// How many of the newest.
    pub depth: u64,
    /// Most time between two.
    pub deadline: Span,
    /// How long one is worth sending.
    pub lifespan: Span,
    /// Who says that a publisher is alive.
    pub liveliness: Liveliness,
    /// How often.
    pub lease: Span,
}

/// What rmw_zenoh takes where nothing is said, and so does not say.
const UNSAID: Qos = Qos { depth: 42, ..Qos::TOPIC };

impl Qos {
    /// What ROS's own publishers have unless they are told otherwise: reliable, the newest ten.
    pub const TOPIC: Self = Self {
        reliability: Reliability::Reliable,
        durability: Durability::Volatile,
        history: History::KeepLast,
        depth: 10,
        deadline: Span::INFINITE,
        lifespan: Span::INFINITE,
        liveliness: Liveliness::Automatic,
        lease: Span::INFINITE,
    };

    /// What ROS has for sensors: the newest five, and what is lost is lost.
    pub const SENSOR: Self = Self { reliability: Reliability::BestEffort, depth: 5, ..Self::TOPIC };

    /// Of its text.
    ///
    /// # Errors
    /// The first part that is missing, no number, or of no meaning.
    pub fn parse(text: &str) -> Result<Self, QosError> {
        let mut parts = text.split(':');
        let mut part = |name| parts.next().ok_or(QosError(name));
        let reliability = part("reliability")?;
        let durability = part("durability")?;
        let history = part("history")?;
        let deadline = part("deadline")?;
        let lifespan = part("lifespan")?;
        let liveliness = part("liveliness")?;
        let (history, depth) = history.split_once(',').ok_or(QosError("history"))?;
        let (liveliness, lease) = liveliness.split_once(',').ok_or(QosError("liveliness"))?;
        let reliabilities =
            [Reliability::Reliable, Reliability::BestEffort, Reliability::BestAvailable];
        let durabilities =
            [Durability::TransientLocal, Durability::Volatile, Durability::BestAvailable];
        let histories = [History::KeepLast, History::KeepAll];
        let livelinesses =
            [Liveliness::Automatic, Liveliness::ManualByTopic, Liveliness::BestAvailable];
        Ok(Self {
            reliability: one_of(reliabilities, reliability, UNSAID.reliability)
                .ok_or(QosError("reliability"))?,
            durability: one_of(durabilities, durability, UNSAID.durability)
                .ok_or(QosError("durability"))?,
            history: one_of(histories, history, UNSAID.history).ok_or(QosError("history"))?,
            depth: number(depth, UNSAID.depth).ok_or(QosError("depth"))?,
            deadline: span(deadline, UNSAID.deadline).ok_or(QosError("deadline"))?,
            lifespan: span(lifespan, UNSAID.lifespan).ok_or(QosError("lifespan"))?,
            liveliness: one_of(livelinesses, liveliness, UNSAID.liveliness)
                .ok_or(QosError("liveliness"))?,
            lease: span(lease, UNSAID.lease).ok_or(QosError("lease"))?,
        })
    }
}

/// What has the number that the text says.
fn one_of<T: Numbered, const N: usize>(all: [T; N], text: &str, unsaid: T) -> Option<T> {
    let wanted = number(text, unsaid.number())?;
    all.into_iter().find(|one| one.number() == wanted)
}

fn number(text: &str, unsaid: u64) -> Option<u64> {
    match text {
        "" => Some(unsaid),
        // No sign, which the language's own parser would take.
        _ if text.bytes().all(|digit| digit.is_ascii_digit()) => text.parse().ok(),
        _ => None,
    }
}

fn span(text: &str, unsaid: Span) -> Option<Span> {
    let (seconds, nanoseconds) = text.split_once(',')?;
    Some(Span {
        seconds: number(seconds, unsaid.seconds)?,
        nanoseconds: number(nanoseconds, unsaid.nanoseconds)?,
    })
}

/// What has a number in ROS's lists.
trait Numbered: Copy {
    fn number(self) -> u64;
}

macro_rules! numbered {
    ($($list:ident),+) => {
        $(impl Numbered for $list {
            fn number(self) -> u64 {
                self as u64
            }
        })+
    };
}
numbered!(Reliability, Durability, History, Liveliness);

/// A number, or nothing where nobody needs to say it.
struct Said(u64, u64);

impl fmt::Display for Said {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(number, unsaid) = self;
        if number == unsaid { Ok(()) } else { write!(f, "{number}") }
    }
}

impl fmt::Display for Qos {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let said = |number: fn(&Self) -> u64| Said(number(self), number(&UNSAID));
        write!(f, "{}:", said(|qos| qos.reliability.number()))?;
        write!(f, "{}:", said(|qos| qos.durability.number()))?;
        write!(f, "{},{}:", said(|qos| qos.history.number()), said(|qos| qos.depth))?;
        let span = |span: fn(&Self) -> Span| {
            let (own, unsaid) = (span(self), span(&UNSAID));
            (Said(own.seconds, unsaid.seconds), Said(own.nanoseconds, unsaid.nanoseconds))
        };
        let (seconds, nanoseconds) = span(|qos| qos.deadline);
        write!(f, "{seconds},{nanoseconds}:")?;
        let (seconds, nanoseconds) = span(|qos| qos.lifespan);
        write!(f, "{seconds},{nanoseconds}:")?;
        let (seconds, nanoseconds) = span(|qos| qos.lease);
        write!(f, "{},{seconds},{nanoseconds}", said(|qos| qos.liveliness.number()))
    }
}
