//! The tables of a team, and all that their values are made of. Which frozen policy is deployed: the one of several that
//! returned most when it was played as it is. The agents are deployed as a table of what to do where.

use serde::{Deserialize, Serialize};
use sortie_core::{DecideError, Observation};
use sortie_envs::SparseRows;
use sortie_learn::export::{DeployedAgents, DeployedNetworks, LookupTables};
use sortie_learn::networks::OwnPass;

use super::table::{ACTIONS, HEADS, Lanes, Row, Table, Terms, Version, Worth};
use crate::novelty::{CELLS, Columns, Counts, Intrinsic, PITS, Place};

/// How a team learns.
#[derive(Clone, Debug, PartialEq)]
pub struct Rules {
    /// By heads: what they explore for. The last explores for nothing: it exploits.
    pub heads: Vec<Option<Intrinsic>>,
    /// By heads: what intrinsic values count in the choice of actions.
    pub weights: Lanes,
    /// Discounts of extrinsic and intrinsic rewards.
    pub discounts: [f32; 2],
    /// Tries of an action that count in what is known of it.
    pub memory: f32,
}

/// A step of the team.
#[derive(Clone, Copy, Debug)]
pub struct Deed<'a> {
    /// `[agents]`: the rows in which they acted.
    pub rows: &'a [u32],
    /// `[agents]`: what they did.
    pub actions: &'a [u16],
    /// `[agents]`: where they came to.
    pub next: &'a [Place],
    /// Whether the episode came to its own end.
    pub is_end: bool,
}

/// The tables of a team.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Learner {
    exploits: usize,
    /// By agents.
    pub tables: Vec<Table>,
    /// Where everybody has been.
    pub counts: Counts,
    /// How the team's reward is shared out.
    pub shares: Shares,
    /// Frozen policies that are tried out.
    pub audition: Audition,
}

impl Learner {
    /// Tables without rows, whose actions are worth so much in rewards of the team and in exploring until they are tried.
    pub fn new(
        rules: &Rules,
        agents: usize,
        treasures: usize,
        [extrinsic, intrinsic]: [f32; 2],
    ) -> Self {
        let start = Worth { extrinsic: [extrinsic; HEADS], intrinsic: [intrinsic; HEADS] };
        let joint = rules.heads.contains(&Some(Intrinsic::Centralized));
        Self {
            exploits: rules.heads.len() - 1,
            tables: vec![Table::new(treasures, start); agents],
            counts: Counts::new(agents, CELLS, joint),
            shares: Shares::default(),
            audition: Audition::default(),
        }
    }

    /// The agents came to these places.
    pub fn visit(&mut self, places: &[Place]) {
        self.counts.visit(places.iter().map(|place| place.cell));
    }

    /// Adds what came of a step.
    pub fn remember(&mut self, rules: &Rules, deed: &Deed<'_>, reward: f64) {
        self.visit(deed.next);
        let team = self.counts.team_novelty(deed.next.iter().map(|place| place.cell));
        let mut finds = 0;
        for (agent, table) in self.tables.iter_mut().enumerate() {
            let next = table.row_of(deed.next[agent]);
            table.rows[next as usize].team_novelty = team;
            let (row, action) = (deed.rows[agent] as usize, usize::from(deed.actions[agent]));
            let has_found = table.rows[row].place.found != deed.next[agent].found;
            let outcome = &mut table.rows[row].outcomes[action];
            outcome.add((!deed.is_end).then_some(next), has_found, rules.memory);
            finds += usize::from(has_found);
        }
        self.shares.add(finds, reward);
    }

    fn terms(&self, rules: &Rules) -> Terms {
        let shares = self.shares.of(self.tables.len());
        Terms { weights: rules.weights, discounts: rules.discounts, shares }
    }

    /// What each head pays an agent for coming to a row's place, by where everybody has been until now.
    pub fn paid(&self, rules: &Rules, agent: usize, row: &Row) -> Lanes {
        let novelties = self.counts.novelties(row.place.cell);
        let mut paid = [0.0; HEADS];
        for (paid, head) in paid.iter_mut().zip(&rules.heads) {
            *paid = head.map_or(0.0, |head| head.reward(novelties, row.team_novelty, agent));
        }
        paid
    }

    /// Backs up rows `[steps, agents]` of a team, the last first.
    pub fn back_up(&mut self, rules: &Rules, trail: &[u32]) {
        let terms = self.terms(rules);
        for rows in trail.chunks_exact(self.tables.len()).rev() {
            for (agent, row) in rows.iter().enumerate() {
                let row = *row as usize;
                let paid = self.paid(rules, agent, &self.tables[agent].rows[row]);
                self.tables[agent].back_up(row, &terms, &paid);
            }
        }
    }

    /// Backs up all rows of all agents, those met last first.
    pub fn back_up_all(&mut self, rules: &Rules) {
        let terms = self.terms(rules);
        for agent in 0..self.tables.len() {
            for row in (0..self.tables[agent].rows.len()).rev() {
                let paid = self.paid(rules, agent, &self.tables[agent].rows[row]);
                self.tables[agent].back_up(row, &terms, &paid);
            }
        }
    }

    /// Goes on to the next policy that is tried out: what is known now.
    pub fn audition_next(&mut self) {
        let is_best = self.audition.go_on();
        for row in self.tables.iter_mut().flat_map(|table| &mut table.rows) {
            if is_best {
                row.keep();
            }
            row.freeze(self.exploits);
        }
    }

    /// What is deployed.
    pub fn deployed(&self) -> Version {
        if self.audition.best.is_some() { Version::Best } else { Version::Now }
    }

    /// What an agent's actions are worth to the team where it is: `[actions]`. Where it was never, it goes by the same
    /// cell with a pit that is less likely to open; where there is none such, it stays.
    pub fn utilities(
        &self,
        agent: usize,
        place: Option<Place>,
        version: Version,
    ) -> [f32; ACTIONS] {
        let known = |place: Place| {
            let at = |pit| self.tables[agent].find(Place { pit, ..place });
            (0..=place.pit).rev().find_map(|pit| at(pit)?.utilities(self.exploits, version))
        };
        place.and_then(known).unwrap_or(STAYS)
    }

    /// What an agent does where it is: what is worth most to the team, the first of equal ones.
    pub fn best_action(&self, agent: usize, place: Place, version: Version) -> u16 {
        let utilities = self.utilities(agent, Some(place), version);
        let better = |one: &usize, other: &usize| utilities[*one].total_cmp(&utilities[*other]);
        (0..ACTIONS).rev().max_by(better).unwrap_or_default() as u16
    }
}

/// What actions are worth where nothing is known: the last one is to stay.
const STAYS: [f32; ACTIONS] = [0.0, 0.0, 0.0, 0.0, 1.0];

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

/// Policies that are tried out one after the other while others go on learning.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Audition {
    /// Number of the policy that is tried out, from 1; 0 before the first.
    pub number: u32,
    episodes: u32,
    returns: f64,
    /// The mean return of the best so far.
    pub best: Option<f64>,
}

impl Audition {
    /// An episode of the policy of a number ended. Those of earlier ones do not count.
    pub fn add(&mut self, number: u32, episode_return: f64) {
        if number == self.number && number > 0 {
            self.episodes += 1;
            self.returns += episode_return;
        }
    }

    /// Whether the next policy is to be tried out, after so many episodes of one.
    pub fn is_over(&self, episodes: u32) -> bool {
        self.number == 0 || self.episodes >= episodes
    }

    /// Goes on to the next policy; returns whether the one before is the best so far.
    pub fn go_on(&mut self) -> bool {
        let mean = self.returns / f64::from(self.episodes);
        let is_best = self.episodes > 0 && self.best.is_none_or(|best| mean > best);
        if is_best {
            self.best = Some(mean);
        }
        *self = Self { number: self.number + 1, episodes: 0, returns: 0.0, best: self.best };
        is_best
    }
}

/// The agents of a team that has learned so much.
pub(super) fn deployed<'a>(learner: &'a Learner, columns: &'a Columns) -> DeployedAgents<'a> {
    let mut rows = SparseRows::default();
    let utilities = move |seen: &Observation<'_>, _: &mut [f32]| {
        let agent = seen.self_index;
        let row = seen.rows.get(agent * seen.stride..).and_then(|rows| rows.get(..seen.stride));
        let row = row.filter(|_| agent < learner.tables.len());
        rows.clear();
        rows.push_dense(row.ok_or(DecideError::BadLength)?);
        let place = columns.place(&rows, 0);
        Ok(learner.utilities(agent, Some(place), learner.deployed()).to_vec())
    };
    let networks = DeployedNetworks::Lookup(tables(learner, columns));
    DeployedAgents {
        networks,
        policy: Box::new(OwnPass { actions: ACTIONS, memory: 0, utilities }),
    }
}

/// All that the agents know, without places and finds that none of them met.
fn tables(learner: &Learner, columns: &Columns) -> LookupTables {
    let met = || learner.tables.iter().flat_map(|table| &table.rows).map(|row| row.place);
    let kinds = PITS.len() + 1;
    let mut cells = vec![false; kinds * CELLS];
    let mut finds = vec![false; 1 << columns.treasures()];
    for place in met() {
        cells[usize::from(place.pit) * CELLS + usize::from(place.cell)] = true;
        finds[usize::from(place.found)] = true;
    }
    let (mut places, mut answered) = (vec![0; kinds * CELLS], vec![None]);
    for number in 0..places.len() {
        if cells[number] {
            places[number] = answered.len() as u32;
            answered.push(Some([number % CELLS, number / CELLS]));
        } else if number >= CELLS {
            // A pit that is less likely to open is the nearest that is known.
            places[number] = places[number - CELLS];
        }
    }
    let (mut holdings, mut held) = (vec![0; finds.len()], vec![None]);
    for found in (0..finds.len()).filter(|found| finds[*found]) {
        holdings[found] = held.len() as u32;
        held.push(Some(found as u8));
    }
    let mut answers = Vec::new();
    for agent in 0..learner.tables.len() {
        for found in &held {
            for place in &answered {
                let place = found.zip(*place).map(|(found, [cell, pit])| Place {
                    cell: cell as u16,
                    pit: pit as u8,
                    found,
                });
                answers.extend(learner.utilities(agent, place, learner.deployed()));
            }
        }
    }
    let [cell, level, held] = columns.weights();
    LookupTables {
        cell,
        level,
        levels: PITS.to_vec(),
        held,
        places,
        holdings,
        answers,
        agents: learner.tables.len(),
        actions: ACTIONS,
    }
}
