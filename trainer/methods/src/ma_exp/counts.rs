//! How often agents stood where: what is rare is worth a visit.

use std::collections::HashMap;

use serde::{Deserialize, Serialize};

/// How fast novelty fades with visits.
pub const DECAY: f32 = 0.7;

/// How novel a place is that was visited so often.
pub fn novelty(visits: u32) -> f32 {
    (visits.max(1) as f32).powf(-DECAY)
}

/// Visits of each agent to each cell, over all instances and the whole run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Counts {
    agents: usize,
    /// `[agents, cells]`
    visits: Vec<u32>,
    /// `[agents, cells]`: how novel each cell is to each agent.
    novelty: Vec<f32>,
    /// Visits of the whole team to cells, where they are counted.
    joint: Option<HashMap<u64, u32>>,
}

impl Counts {
    /// Nobody has been anywhere; `joint` says whether teams are counted too.
    pub fn new(agents: usize, cells: usize, joint: bool) -> Self {
        let size = agents * cells;
        let joint = joint.then(HashMap::new);
        Self { agents, visits: vec![0; size], novelty: vec![1.0; size], joint }
    }

    /// Cells of one agent.
    fn cells(&self) -> usize {
        self.visits.len() / self.agents
    }

    /// The agents stand in these cells.
    pub fn visit(&mut self, cells: &[u16]) {
        let stride = self.cells();
        for (agent, cell) in cells.iter().enumerate() {
            let place = agent * stride + usize::from(*cell);
            self.visits[place] = self.visits[place].saturating_add(1);
            self.novelty[place] = novelty(self.visits[place]);
        }
        let key = self.team(cells);
        if let Some(joint) = &mut self.joint {
            let visits = joint.entry(key).or_default();
            *visits = visits.saturating_add(1);
        }
    }

    /// Visits of an agent to a cell.
    pub fn visits(&self, agent: usize, cell: usize) -> u32 {
        self.visits[agent * self.cells() + cell]
    }

    /// Writes `[agents]` how novel a cell is to each agent.
    #[inline]
    pub fn novelties(&self, cell: u16, novelties: &mut [f32]) {
        let cells = self.cells();
        for (agent, novelty) in novelties.iter_mut().enumerate() {
            *novelty = self.novelty[agent * cells + usize::from(cell)];
        }
    }

    /// How novel it is that the team stands in these cells; 0 where teams are not counted.
    pub fn team_novelty(&self, cells: &[u16]) -> f32 {
        let Some(joint) = &self.joint else { return 0.0 };
        novelty(joint.get(&self.team(cells)).copied().unwrap_or(0))
    }

    fn team(&self, cells: &[u16]) -> u64 {
        let stride = self.cells() as u64;
        cells.iter().fold(0, |key, cell| key * stride + u64::from(*cell))
    }
}
