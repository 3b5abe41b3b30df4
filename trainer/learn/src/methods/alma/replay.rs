//! What was seen, kept as compact states: a record is a step of one building's team.
//!
//! Features are rebuilt when a record is used. Because the subtask mask hides everything else, a
//! record is a complete training sample.

use serde::{Deserialize, Serialize};
use sortie_envs::save_the_city::{AgentState, BuildingState};

use super::learner::Samples;

/// One agent of a team, at the step of a record and some steps later.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TeamMember {
    /// The agent when it acted.
    pub agent: AgentState,
    /// What it had done before.
    pub last_action: u8,
    /// What it did.
    pub action: u8,
    /// The agent in the state to bootstrap from.
    pub next: AgentState,
    /// What it had done before that.
    pub next_last_action: u8,
}

/// A building with the rewards that its team of one step earned over the next steps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// The building when the team acted.
    pub building: BuildingState,
    /// The building in the state to bootstrap from.
    pub next_building: BuildingState,
    /// Discounted sum of the task's rewards in between.
    pub reward: f32,
    /// Factor of the bootstrapped value; 0 where there is nothing to bootstrap from.
    pub discount: f32,
    /// Agents in the team, at least one.
    pub size: u8,
}

/// A ring of records: the newest replaces the oldest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Replay {
    capacity: usize,
    team_max: usize,
    records: Vec<Record>,
    /// `[records, team_max]`
    members: Vec<TeamMember>,
    next: usize,
}

impl Replay {
    /// Room for `capacity` records of teams of at most `team_max` agents.
    pub fn new(capacity: usize, team_max: usize) -> Self {
        Self {
            capacity,
            team_max,
            records: Vec::with_capacity(capacity),
            members: Vec::with_capacity(capacity * team_max),
            next: 0,
        }
    }

    /// Stores a record with its team. Panics if the team is empty or too large.
    pub fn push(&mut self, record: Record, team: impl IntoIterator<Item = TeamMember>) {
        let start = self.next * self.team_max;
        let mut size = 0;
        for member in team {
            assert!(size < self.team_max, "team of more than {} agents", self.team_max);
            match self.members.get_mut(start + size) {
                Some(place) => *place = member,
                None => self.members.push(member),
            }
            size += 1;
        }
        assert!(size > 0, "a record needs a team");
        while self.members.len() < start + self.team_max {
            self.members.push(self.members[start]);
        }
        let record = Record { size: size as u8, ..record };
        match self.records.get_mut(self.next) {
            Some(place) => *place = record,
            None => self.records.push(record),
        }
        self.next = (self.next + 1) % self.capacity;
    }

    /// Number of records.
    pub fn len(&self) -> usize {
        self.records.len()
    }

    /// Whether there is no record.
    pub fn is_empty(&self) -> bool {
        self.records.is_empty()
    }

    /// A record and its team.
    pub fn get(&self, index: usize) -> (&Record, &[TeamMember]) {
        let record = &self.records[index];
        (record, &self.members[index * self.team_max..][..usize::from(record.size)])
    }

    /// Whether this is a replay of that size whose parts fit together, as one from a file should be.
    pub fn fits(&self, capacity: usize, team_max: usize) -> bool {
        (self.capacity, self.team_max) == (capacity, team_max)
            && self.records.len() <= self.capacity
            && self.next < self.capacity.max(1)
            && self.members.len() == self.records.len() * self.team_max
            && self.records.iter().all(|r| (1..=self.team_max).contains(&usize::from(r.size)))
    }
}

impl Samples for Replay {
    fn count(&self) -> usize {
        self.len()
    }
}
