//! What was seen, kept as compact states: a record is a step of one team.
//!
//! Features are rebuilt when a record is used. A record holds everything that its team may see, so that
//! it is a complete training sample: with the subtask mask that is the team and its building, otherwise
//! the whole city.

use serde::{Deserialize, Serialize};
use sortie_envs::save_the_city::{AgentState, BuildingState, ScenarioSet};

use super::conditioning::Conditioning;
use super::learner::Samples;

/// One agent at the step of a record and some steps later.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct AgentStep {
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
    /// Its subtask when it acted, which is held fixed for the bootstrap.
    pub task: u8,
}

/// One building at the step of a record and in the state to bootstrap from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BuildingStep {
    /// The building when the team acted.
    pub building: BuildingState,
    /// The building later.
    pub next: BuildingState,
}

/// The rewards that the team of one step earned over the next steps.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Discounted sum of the team's rewards until the state to bootstrap from.
    pub reward: f32,
    /// Factor of the bootstrapped value; 0 where there is nothing to bootstrap from.
    pub discount: f32,
    /// Agents in the team, at least one.
    pub size: u8,
    agents: u8,
    buildings: u8,
}

impl Record {
    /// A record of a team of so many agents.
    pub fn new(reward: f32, discount: f32, size: usize) -> Self {
        Self { reward, discount, size: size as u8, agents: 0, buildings: 0 }
    }
}

/// A record with what its team sees.
#[derive(Clone, Copy, Debug)]
pub struct Sample<'a> {
    /// Rewards and discount.
    pub record: &'a Record,
    /// The team, then the other agents in sight.
    pub agents: &'a [AgentStep],
    /// The buildings in sight: all in the order of their subtasks, or the team's own.
    pub buildings: &'a [BuildingStep],
}

impl<'a> Sample<'a> {
    /// The agents that earned the reward, then the others.
    pub fn split_team(&self) -> (&'a [AgentStep], &'a [AgentStep]) {
        self.agents.split_at(self.record.size.into())
    }
}

/// The most that one record can hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordLayout {
    /// Agents in sight.
    pub agents: usize,
    /// Buildings in sight.
    pub buildings: usize,
}

impl RecordLayout {
    /// What a team may see in a scenario set.
    pub fn new(conditioning: Conditioning, set: &ScenarioSet) -> Self {
        let masked = conditioning == Conditioning::Mask;
        Self { agents: set.max_agents, buildings: if masked { 1 } else { set.max_buildings } }
    }
}

/// A ring of records: the newest replaces the oldest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Replay {
    capacity: usize,
    layout: RecordLayout,
    records: Vec<Record>,
    /// `[records, layout.agents]`
    agents: Vec<AgentStep>,
    /// `[records, layout.buildings]`
    buildings: Vec<BuildingStep>,
    next: usize,
}

impl Replay {
    /// Room for `capacity` records.
    pub fn new(capacity: usize, layout: RecordLayout) -> Self {
        Self {
            capacity,
            layout,
            records: Vec::with_capacity(capacity),
            agents: Vec::with_capacity(capacity * layout.agents),
            buildings: Vec::with_capacity(capacity * layout.buildings),
            next: 0,
        }
    }

    /// Stores a record with what its team sees, the team first.
    ///
    /// Panics if the team or the buildings are none, or more than the layout has room for.
    pub fn push(
        &mut self,
        record: Record,
        agents: impl IntoIterator<Item = AgentStep>,
        buildings: impl IntoIterator<Item = BuildingStep>,
    ) {
        let agents = place(&mut self.agents, self.next, self.layout.agents, agents);
        let buildings = place(&mut self.buildings, self.next, self.layout.buildings, buildings);
        assert!((1..=agents).contains(&record.size), "a record needs a team");
        let record = Record { agents, buildings, ..record };
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

    /// A record and what its team sees.
    pub fn get(&self, index: usize) -> Sample<'_> {
        let record = &self.records[index];
        Sample {
            record,
            agents: &self.agents[index * self.layout.agents..][..usize::from(record.agents)],
            buildings: &self.buildings[index * self.layout.buildings..]
                [..usize::from(record.buildings)],
        }
    }

    /// Reads a little of each of these records, so that all are on their way from memory at the same time.
    pub fn fetch(&self, indices: impl Iterator<Item = usize>) {
        let RecordLayout { agents, buildings } = self.layout;
        let read = indices.map(|index| {
            let place = index * agents;
            let (first, last) = (&self.agents[place], &self.agents[place + agents - 1]);
            let building = &self.buildings[index * buildings];
            self.records[index].size ^ first.task ^ last.task ^ building.next.x
        });
        // What was read is not needed, which the compiler must not know.
        std::hint::black_box(read.fold(0, |sum, read| sum ^ read));
    }

    /// Whether this is a replay of that size whose parts fit together, as one from a file should be.
    pub fn fits(&self, capacity: usize, layout: RecordLayout) -> bool {
        let Self { records, .. } = self;
        (self.capacity, self.layout) == (capacity, layout)
            && records.len() <= self.capacity
            && self.next < self.capacity.max(1)
            && self.agents.len() == records.len() * layout.agents
            && self.buildings.len() == records.len() * layout.buildings
            && records.iter().all(|r| (1..=r.agents).contains(&r.size))
            && records.iter().all(|r| usize::from(r.agents) <= layout.agents)
            && records.iter().all(|r| (1..=layout.buildings).contains(&r.buildings.into()))
    }
}

impl Samples for Replay {
    fn count(&self) -> usize {
        self.len()
    }
}

/// Writes the rows of one record, fills up its room in a ring that still grows, and returns their number.
fn place<T: Copy>(
    rows: &mut Vec<T>,
    record: usize,
    room: usize,
    items: impl IntoIterator<Item = T>,
) -> u8 {
    let start = record * room;
    let mut count = 0;
    for item in items {
        assert!(count < room, "a record with room for {room} rows");
        match rows.get_mut(start + count) {
            Some(place) => *place = item,
            None => rows.push(item),
        }
        count += 1;
    }
    assert!(count > 0, "a record without rows");
    while rows.len() < start + room {
        rows.push(rows[start]);
    }
    count as u8
}
