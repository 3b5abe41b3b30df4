//! The agents as they are deployed: a table of what to do where, and what the trainer itself answers.

use sortie_core::{DecideError, Observation};
use sortie_envs::SparseRows;
use sortie_learn::export::{DeployedAgents, DeployedNetworks, LookupTables};
use sortie_learn::networks::OwnPass;

use super::learner::Learner;
use super::table::ACTIONS;
use crate::novelty::{CELLS, Columns, PITS, Place};

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
