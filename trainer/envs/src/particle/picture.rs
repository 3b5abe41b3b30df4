//! What there is to draw of a state, whatever the scenario.

use alloc::vec::Vec;

use super::plane::Point;

/// A state as it is drawn.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Picture {
    /// All agents in their order.
    pub agents: Vec<Drawn>,
    /// Treasures or landmarks.
    pub things: Vec<Thing>,
}

/// One agent as it is drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Drawn {
    /// Where it is; towers are nowhere.
    pub disc: Option<Disc>,
    /// The kind of treasure that it takes, as a bank.
    pub takes: Option<u8>,
    /// The kind of treasure that it holds.
    pub holds: Option<u8>,
    /// What it said in the last step.
    pub says: Option<u8>,
    /// The agent that it leads, or that leads it.
    pub partner: Option<usize>,
    /// The landmark that it, or the agent that it leads, should be at.
    pub goal: Option<usize>,
}

/// Something that lies on the plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Thing {
    /// Where it is; a treasure that was just taken is nowhere.
    pub disc: Option<Disc>,
    /// The kind of a treasure.
    pub kind: Option<u8>,
}

/// A place and how far it reaches, in half sides of the square.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Disc {
    /// Its middle.
    pub place: Point,
    /// Its radius.
    pub radius: f64,
}
