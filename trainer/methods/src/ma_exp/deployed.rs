//! The agents as they are deployed: a table of what to do where, and what the trainer itself answers.

use sortie_core::choose::masked_argmax;
use sortie_core::{DecideError, Decision, Observation, Policy};
use sortie_envs::SparseRows;
use sortie_learn::export::{DeployedAgents, DeployedNetworks, LookupTables};

use super::learner::Learner;
use super::table::ACTIONS;
use crate::novelty::{CELLS, Columns, PITS, Place};

/// The agents of a team that has learned so much.
pub(super) fn deployed<'a>(learner: &'a Learner, columns: &'a Columns) -> DeployedAgents<'a> {
    DeployedAgents {
        networks: DeployedNetworks::Lookup(tables(learner, columns)),
        policy: Box::new(OwnTables { learner, columns, rows: SparseRows::default() }),
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

/// Decides by the trainer's own tables: what golden observations expect of every engine.
struct OwnTables<'a> {
    learner: &'a Learner,
    columns: &'a Columns,
    rows: SparseRows,
}

impl Policy for OwnTables<'_> {
    fn actions(&self) -> usize {
        ACTIONS
    }

    fn utilities(
        &mut self,
        observation: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        let agent = observation.self_index;
        let Observation { rows, stride, .. } = observation;
        let row = rows.get(agent * stride..).and_then(|rows| rows.get(..*stride));
        let row = row.filter(|_| agent < self.learner.tables.len());
        self.rows.clear();
        self.rows.push_dense(row.ok_or(DecideError::BadLength)?);
        let place = self.columns.place(&self.rows, 0);
        let known = utilities.get_mut(..ACTIONS).ok_or(DecideError::BadLength)?;
        let version = self.learner.deployed();
        known.copy_from_slice(&self.learner.utilities(agent, Some(place), version));
        Ok(())
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        let mut utilities = [0.0; ACTIONS];
        self.utilities(observation, &mut utilities)?;
        masked_argmax(&utilities, observation.available)
    }
}
