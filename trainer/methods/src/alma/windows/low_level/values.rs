//! The utilities of all agents and the values of all teams of a batch, outside a step.

use std::ops::Range;

use super::super::batch::{WindowShape, Windows};
use super::hypernetwork::MixerInput;
use super::looking::LookingPass;
use super::mixer::{Mixer, MixerPass};
use super::recurrent::Recurrent;
use super::teams::{Teams, View};
use crate::alma::agents::{Conditioning, TaskOrder};
use crate::alma::teams::Agents;

/// The utilities `[W S, A, U]` in all states as the learner computes them, zeros for absent agents.
/// Memories are empty at the begin of a window.
pub fn agent_utilities(
    agents: Agents<'_>,
    windows: &Windows,
    conditioning: Conditioning,
    order: &TaskOrder,
) -> Vec<f32> {
    let marks = (conditioning == Conditioning::Input).then_some(&*order.0);
    let recurrent = Recurrent { network: agents.network, gru: agents.memory_unit };
    let mut pass = LookingPass::new(agents.network.shape());
    let (look, conditioning) = ((windows, View::NOW), (conditioning, marks));
    let WindowShape { windows: count, steps, agents, actions, .. } = windows.shape;
    let mut utilities = vec![0.0; windows.shape.states() * agents * actions];
    for window in 0..count {
        let states = window * steps..(window + 1) * steps;
        let mut teams = teams(windows, states, Conditioning::None);
        let rows = pass.forward((recurrent, None), look, conditioning, &mut teams);
        for (row, (state, agent)) in rows.chunks_exact(actions).zip(teams.agents()) {
            utilities[(state * agents + agent) * actions..][..actions].copy_from_slice(row);
        }
    }
    utilities
}

/// The teams of some states: of every subtask, whether it has agents or not; without subtasks, everybody.
fn teams(windows: &Windows, states: Range<usize>, conditioning: Conditioning) -> Teams {
    let mut teams = Teams::default();
    for state in states {
        let scene = View::NOW.of(windows, state);
        if conditioning.has_subtasks() {
            (0..windows.shape.tasks).for_each(|task| teams.push(scene, state, Some(task)));
        } else {
            teams.push(scene, state, None);
        }
    }
    teams
}

/// What a mixer sees of all teams of all states, and state and number of every agent in its order.
pub fn team_input(
    windows: &Windows,
    conditioning: Conditioning,
) -> (MixerInput, Vec<(usize, usize)>) {
    let mut teams = teams(windows, 0..windows.shape.states(), conditioning);
    let order = TaskOrder::identity(windows.shape.tasks);
    let marks = (conditioning == Conditioning::Input).then_some(&*order.0);
    let mut input = MixerInput::default();
    teams.write_mixer((windows, View::NOW), (conditioning, marks), &mut input);
    (input, teams.agents().collect())
}

/// The values `[W S, T]` of all teams in normalised units, without subtasks `[W S]`, from the utilities
/// `[W S, A]` of what the agents do.
pub fn team_values(
    mixer: &Mixer,
    windows: &Windows,
    conditioning: Conditioning,
    utilities: &[f32],
) -> Vec<f32> {
    let (input, agents) = team_input(windows, conditioning);
    let own = agents.iter().map(|(state, agent)| utilities[state * windows.shape.agents + agent]);
    let mut pass = MixerPass::default();
    let values = pass.forward(mixer, &mixer.merge(), &input, &own.collect::<Vec<f32>>()).to_vec();
    let (weights, biases) = mixer.head();
    let heads = weights.iter().zip(biases).cycle();
    values.iter().zip(heads).map(|(value, (weight, bias))| weight * value + bias).collect()
}
