//! Learning from segments, backwards: all heads of all agents at once.

use serde::{Deserialize, Serialize};

use super::counts::Counts;
use super::intrinsic::Intrinsic;
use super::memory::{Memory, Segment};
use super::table::{ACTIONS, ALL, HEADS, Lanes, Table, Values};

/// How values follow what happens.
#[derive(Clone, Debug, PartialEq)]
pub struct Rules {
    /// By heads: what they explore for; a head without one is after the team's reward alone.
    pub heads: Vec<Option<Intrinsic>>,
    /// Discounts of extrinsic and intrinsic rewards.
    pub discounts: [f32; 2],
    /// How far targets look ahead, as long as actions are the best ones.
    pub trace: f32,
    /// First values.
    pub starts: [f32; 2],
    /// What intrinsic values count in the choice of actions.
    pub weight: f32,
}

impl Rules {
    /// By heads: what intrinsic values count.
    pub fn weights(&self) -> Lanes {
        let mut weights = [0.0; HEADS];
        for (weight, head) in weights.iter_mut().zip(&self.heads) {
            *weight = if head.is_some() { self.weight } else { 0.0 };
        }
        weights
    }
}

/// What of the team's reward an agent's find and its steps are worth: the least squares of all steps so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Shares {
    steps: f64,
    finds: f64,
    squares: f64,
    rewards: f64,
    products: f64,
}

impl Shares {
    /// Adds a step in which so many agents found something.
    pub fn add(&mut self, finds: usize, reward: f64) {
        let finds = finds as f64;
        self.steps += 1.0;
        self.finds += finds;
        self.squares += finds * finds;
        self.rewards += reward;
        self.products += finds * reward;
    }

    /// What a find adds for whoever made it, and what is left for each of so many agents in every step.
    pub fn of(&self, agents: usize) -> [f32; 2] {
        let spread = self.steps * self.squares - self.finds * self.finds;
        let slope = self.steps * self.products - self.finds * self.rewards;
        let find = if spread > 0.0 { slope / spread } else { 0.0 };
        let rest = (self.rewards - find * self.finds) / self.steps.max(1.0);
        [find as f32, (rest / agents as f64) as f32]
    }
}

/// The tables of all agents.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Learner {
    /// By agents.
    pub tables: Vec<Table>,
    /// Where everybody has been.
    pub counts: Counts,
    /// How the team's reward is shared out.
    pub shares: Shares,
}

impl Learner {
    /// Tables without rows.
    pub fn new(rules: &Rules, agents: usize, treasures: usize, cells: usize) -> Self {
        let [extrinsic, intrinsic] = rules.starts;
        let start = Values {
            extrinsic: [[extrinsic; HEADS]; ACTIONS],
            intrinsic: [[intrinsic; HEADS]; ACTIONS],
        };
        let joint = rules.heads.contains(&Some(Intrinsic::Centralized));
        Self {
            tables: vec![Table::new(treasures, start); agents],
            counts: Counts::new(agents, cells, joint),
            shares: Shares::default(),
        }
    }

    /// Learns from a segment with such a step size. `allowed` says which actions count in a row of an agent's table.
    pub fn sweep(
        &mut self,
        rules: &Rules,
        memory: &Memory,
        segment: Segment,
        rate: f32,
        allowed: impl Fn(usize, usize) -> u8,
    ) {
        let Self { tables, counts, shares } = self;
        let [find, rest] = shares.of(tables.len());
        let weights = rules.weights();
        let [extrinsic_discount, intrinsic_discount] = rules.discounts;
        let (mut novelties, mut cells) = (vec![0.0; tables.len()], vec![0; tables.len()]);
        for agent in 0..tables.len() {
            let end = memory.deeds(segment, segment.steps)[agent];
            let mut row = end.row();
            let mut best = tables[agent].values[row].best(&weights, allowed(agent, row));
            // What the next state is worth to each head.
            let (mut extrinsic, mut intrinsic) = (best.extrinsic, best.intrinsic);
            if segment.is_end {
                (extrinsic, intrinsic) = ([0.0; HEADS], [0.0; HEADS]);
            }
            for step in (0..segment.steps).rev() {
                let deed = memory.deeds(segment, step)[agent];
                let cell = tables[agent].places[row].cell;
                counts.novelties(cell, &mut novelties);
                let mut team = 0.0;
                if rules.heads.contains(&Some(Intrinsic::Centralized)) {
                    let next = memory.deeds(segment, step + 1);
                    for (cell, (table, deed)) in cells.iter_mut().zip(tables.iter().zip(next)) {
                        *cell = table.places[deed.row()].cell;
                    }
                    team = counts.team_novelty(&cells);
                }
                let mut paid = [0.0; HEADS];
                for (paid, head) in paid.iter_mut().zip(&rules.heads) {
                    *paid = head.map_or(0.0, |head| head.reward(&novelties, team, agent));
                }
                let reward = rest + if deed.has_found() { find } else { 0.0 };
                row = deed.row();
                let action = deed.action();
                let values = &mut tables[agent].values[row];
                let (old_extrinsic, old_intrinsic) =
                    (&mut values.extrinsic[action], &mut values.intrinsic[action]);
                for head in 0..HEADS {
                    extrinsic[head] = reward + extrinsic_discount * extrinsic[head];
                    intrinsic[head] = paid[head] + intrinsic_discount * intrinsic[head];
                    old_extrinsic[head] += rate * (extrinsic[head] - old_extrinsic[head]);
                    old_intrinsic[head] += rate * (intrinsic[head] - old_intrinsic[head]);
                }
                best = values.best(&weights, allowed(agent, row));
                for head in 0..HEADS {
                    let is_best = best.action[head] == action as u32;
                    let trace = if is_best { rules.trace } else { 0.0 };
                    let (target, value) = (extrinsic[head], best.extrinsic[head]);
                    extrinsic[head] = value + trace * (target - value);
                    let (target, value) = (intrinsic[head], best.intrinsic[head]);
                    intrinsic[head] = value + trace * (target - value);
                }
            }
        }
    }
}

/// Every action counts.
pub fn all(_: usize, _: usize) -> u8 {
    ALL
}
