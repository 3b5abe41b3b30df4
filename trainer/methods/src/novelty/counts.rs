//! How often agents stood where: what is rare is worth a visit.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// How fast novelty fades with visits.
pub(crate) const DECAY: f32 = 0.7;

/// How novel a place is that was visited so often.
pub fn novelty(visits: u32) -> f32 {
    (visits.max(1) as f32).powf(-DECAY)
}

/// Visits of each agent to each cell, over all instances and the whole run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Counts {
    agents: usize,
    /// `[cells, agents]`
    visits: Vec<u32>,
    /// `[cells, agents]`: how novel each cell is to each agent.
    novelty: Vec<f32>,
    /// Visits of the whole team to its cells, where they are counted.
    joint: Option<BTreeMap<u64, u32>>,
}

impl Counts {
    /// Nobody has been anywhere; `joint` says whether teams are counted too.
    pub fn new(agents: usize, cells: usize, joint: bool) -> Self {
        let size = agents * cells;
        let joint = joint.then(BTreeMap::new);
        Self { agents, visits: vec![0; size], novelty: vec![1.0; size], joint }
    }

    /// The agents stand in these cells.
    pub fn visit(&mut self, cells: impl Iterator<Item = u16> + Clone) {
        for (agent, cell) in cells.clone().enumerate() {
            let place = usize::from(cell) * self.agents + agent;
            self.visits[place] = self.visits[place].saturating_add(1);
            self.novelty[place] = novelty(self.visits[place]);
        }
        if let Some(joint) = &mut self.joint {
            let visits = joint.entry(team(cells)).or_default();
            *visits = visits.saturating_add(1);
        }
    }

    /// Visits of an agent to a cell.
    pub fn visits(&self, agent: usize, cell: u16) -> u32 {
        self.visits[usize::from(cell) * self.agents + agent]
    }

    /// `[agents, cells]`: visits of each agent to each cell.
    pub fn all(&self) -> Vec<Vec<u32>> {
        let of = |agent| self.visits.iter().skip(agent).step_by(self.agents).copied().collect();
        (0..self.agents).map(of).collect()
    }

    /// `[agents]`: how novel a cell is to each agent.
    #[inline]
    pub fn novelties(&self, cell: u16) -> &[f32] {
        &self.novelty[usize::from(cell) * self.agents..][..self.agents]
    }

    /// How novel it is that the team stands in these cells; 0 where teams are not counted.
    pub fn team_novelty(&self, cells: impl Iterator<Item = u16>) -> f32 {
        let visits = |joint: &BTreeMap<u64, u32>| joint.get(&team(cells)).copied().unwrap_or(0);
        self.joint.as_ref().map_or(0.0, |joint| novelty(visits(joint)))
    }
}

/// The cells of a team as one number.
fn team(cells: impl Iterator<Item = u16>) -> u64 {
    cells.fold(0, |key, cell| key << 16 | u64::from(cell))
}
