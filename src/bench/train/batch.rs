//! Batches of records as dense tensors, for a peer that knows nothing of ours.

use std::collections::HashMap;
use std::path::Path;

use sortie_envs::save_the_city::{
    ACTIONS, AgentState, BuildingState, FEATURES, Symmetry, write_agent_row, write_building_row,
};
use sortie_methods::alma::records::{
    INPUT_COLUMNS, Knowledge, NO_ACTION, Pick, Replay, UtilityNetwork, UtilityShape,
};

use super::learning::{Learning, gradient};
use super::program::Expected;
use super::tensors::Tensors;
use crate::failure::Failure;

/// Batches that the peer learns from in turn.
const BATCHES: usize = 8;

impl Tensors {
    /// All weights in PyTorch's layout.
    fn network(&mut self, of: &str, network: &UtilityNetwork) {
        let UtilityShape { input, width, base, actions, skip, .. } = network.shape();
        let w = network.weights();
        for (name, shape, values) in [
            ("fc1.weight", &[width, input][..], &w.fc1_weight),
            ("fc1.bias", &[width], &w.fc1_bias),
            ("attention.in.weight", &[3 * width, width], &w.attention_in_weight),
            ("attention.out.weight", &[width, width], &w.attention_out_weight),
            ("attention.out.bias", &[width], &w.attention_out_bias),
            ("fc2.weight", &[base, width], &w.fc2_weight),
            ("fc2.bias", &[base], &w.fc2_bias),
            ("head.weight", &[actions, base], &w.head_weight),
            ("head.bias", &[actions], &w.head_bias),
        ] {
            self.floats(format!("{of}.{name}"), shape, values);
        }
        if skip {
            self.floats(format!("{of}.skip.weight"), &[width, width], &w.skip_weight);
        }
    }

    /// A batch, its teams padded to its largest.
    fn batch(&mut self, number: usize, replay: &Replay, picks: &[Pick], team: usize) {
        let mut dense = Dense::default();
        for pick in picks {
            dense.push(replay, *pick, team);
        }
        let count = picks.len();
        let name = |part: &str| format!("batch{number}.{part}");
        let rows = [count, team + 1, INPUT_COLUMNS];
        self.floats(name("rows"), &rows, &dense.rows);
        self.floats(name("next_rows"), &rows, &dense.next_rows);
        self.flags(name("present"), &[count, team], &dense.present);
        self.integers(name("actions"), &[count, team], &dense.actions);
        self.flags(name("next_available"), &[count, team, ACTIONS], &dense.next_available);
        self.floats(name("reward"), &[count], &dense.reward);
        self.floats(name("discount"), &[count], &dense.discount);
    }
}

/// Rows `[records, team + 1, columns]` of agents and building, and what belongs to them.
#[derive(Default)]
struct Dense {
    rows: Vec<f32>,
    next_rows: Vec<f32>,
    present: Vec<bool>,
    actions: Vec<i64>,
    next_available: Vec<bool>,
    reward: Vec<f32>,
    discount: Vec<f32>,
}

impl Dense {
    /// Adds a record, turned as it was picked.
    fn push(&mut self, replay: &Replay, pick: Pick, team: usize) {
        let turn = Symmetry::ALL[usize::from(pick.symmetry)];
        let turned = |action: u8| turn.action(action.into()) as u8;
        let sample = replay.get(pick.sample as usize);
        let (record, building) = (sample.record, &sample.buildings[0]);
        let (members, _) = sample.split_team();
        for place in 0..team {
            let member = members.get(place);
            self.present.push(member.is_some());
            self.actions.push(member.map_or(0, |member| turned(member.action).into()));
            let now = member.map(|m| (turn.agent(&m.agent), turned(m.last_action)));
            let next = member.map(|m| (turn.agent(&m.next), turned(m.next_last_action)));
            let available = next.map_or(0, |(agent, _)| agent.available);
            self.next_available.extend((0..ACTIONS).map(|action| available >> action & 1 == 1));
            push_agent(&mut self.rows, now);
            push_agent(&mut self.next_rows, next);
        }
        push_building(&mut self.rows, &turn.building(&building.building));
        push_building(&mut self.next_rows, &turn.building(&building.next));
        self.reward.push(record.reward);
        self.discount.push(record.discount);
    }
}

/// Adds the row of an agent with its last action, or of none.
fn push_agent(rows: &mut Vec<f32>, agent: Option<(AgentState, u8)>) {
    let mut row = [0.0; INPUT_COLUMNS];
    if let Some((agent, last_action)) = agent {
        write_agent_row(&agent, &mut row[..FEATURES]);
        if last_action != NO_ACTION {
            row[FEATURES + usize::from(last_action)] = 1.0;
        }
    }
    rows.extend(row);
}

fn push_building(rows: &mut Vec<f32>, building: &BuildingState) {
    let mut row = [0.0; INPUT_COLUMNS];
    write_building_row(building, &mut row[..FEATURES]);
    rows.extend(row);
}

/// Writes networks, batches and, for the first batch, our gradient.
pub(super) fn write(learning: &mut Learning, path: &Path) -> Result<Expected, Failure> {
    let mut tensors = Tensors::default();
    let mut expected = Expected { loss: f64::NAN, gradient_norm: f64::NAN };
    for number in 0..BATCHES {
        let mut chunk = learning.chunk();
        let (loss, slopes) = gradient(&mut learning.method.agents, &mut chunk, &mut learning.picks);
        let knowledge = learning.method.agents.knowledge();
        let Knowledge { online, target, replay, .. } = &*knowledge;
        let sizes =
            knowledge.picks().iter().map(|pick| replay.get(pick.sample as usize).record.size);
        let team = sizes.max().map_or(1, usize::from);
        tensors.batch(number, replay, knowledge.picks(), team);
        if number == 0 {
            let norm = slopes.iter().map(|slope| f64::from(*slope).powi(2)).sum::<f64>().sqrt();
            expected = Expected { loss, gradient_norm: norm };
            tensors.network("online", &online.utility);
            tensors.network("target", &target.utility);
            let slopes = UtilityNetwork::from_parameters(online.utility.shape(), slopes);
            slopes.iter().for_each(|slopes| tensors.network("gradient", slopes));
        }
    }
    tensors.write(settings(learning), path).map_err(Failure::bug)?;
    Ok(expected)
}

/// The numbers of the update, as the file's metadata.
fn settings(learning: &Learning) -> HashMap<String, String> {
    let optimiser = &learning.config.optimiser;
    let settings = [
        ("batches", BATCHES as f64),
        ("heads", learning.config.network.heads as f64),
        ("learning_rate", optimiser.learning_rate.into()),
        ("epsilon", optimiser.epsilon.into()),
        ("clip", optimiser.clip.into()),
        ("target_rate", optimiser.target_rate.into()),
        ("average_rate", optimiser.average_rate.into()),
    ];
    settings.map(|(name, value)| (name.to_string(), value.to_string())).into()
}
