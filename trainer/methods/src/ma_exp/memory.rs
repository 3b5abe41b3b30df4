//! What happened: steps of all agents, in segments that are learned from as a whole.

use serde::{Deserialize, Serialize};

/// What an agent did in a step, in one number: its row, its action, and whether it found something.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Deed(u32);

impl Deed {
    /// Packs a step.
    #[inline]
    pub fn new(row: u32, action: u16, has_found: bool) -> Self {
        Self(row << 4 | u32::from(action) << 1 | u32::from(has_found))
    }

    /// The row of its table that the agent acted in.
    #[inline]
    pub fn row(self) -> usize {
        (self.0 >> 4) as usize
    }

    /// What it did.
    #[inline]
    pub fn action(self) -> usize {
        (self.0 >> 1 & 7) as usize
    }

    /// Whether it found something.
    #[inline]
    pub fn has_found(self) -> bool {
        self.0 & 1 == 1
    }
}

/// Consecutive steps of one instance.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Segment {
    /// Place of its first step in [`Memory::deeds`]; the state that it ends in has a place behind its last step.
    pub first: u32,
    /// Steps.
    pub steps: u32,
    /// Whether the episode came to its own end.
    pub is_end: bool,
}

/// All segments of a run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Memory {
    agents: usize,
    /// `[places, agents]`
    deeds: Vec<Deed>,
    /// In the order in which they were lived through.
    pub segments: Vec<Segment>,
    /// By instances: the segment that is being lived through.
    running: Vec<Vec<Deed>>,
}

impl Memory {
    /// Nothing yet.
    pub fn new(agents: usize, instances: usize) -> Self {
        Self { agents, running: vec![Vec::new(); instances], ..Self::default() }
    }

    /// Adds a step of an instance.
    pub fn push(&mut self, instance: usize, deeds: impl Iterator<Item = Deed>) {
        self.running[instance].extend(deeds);
    }

    /// Steps of the segment that an instance lives through.
    pub fn running(&self, instance: usize) -> usize {
        self.running[instance].len() / self.agents
    }

    /// Closes the segment of an instance, which ends in these rows; returns it.
    pub fn close(&mut self, instance: usize, ends: &[u32], is_end: bool) -> Segment {
        let steps = self.running(instance) as u32;
        let first = (self.deeds.len() / self.agents) as u32;
        let segment = Segment { first, steps, is_end };
        self.deeds.append(&mut self.running[instance]);
        self.deeds.extend(ends.iter().map(|row| Deed::new(*row, 0, false)));
        self.segments.push(segment);
        segment
    }

    /// What the agents did in a step of a segment, or where they were behind its last.
    #[inline]
    pub fn deeds(&self, segment: Segment, step: u32) -> &[Deed] {
        &self.deeds[(segment.first + step) as usize * self.agents..][..self.agents]
    }
}
