//! The values of all teams of a batch, outside a step.

use super::super::windows::Windows;
use super::TaskOrder;
use super::hypernetwork::MixerInput;
use super::mixer::{Mixer, MixerPass};
use super::teams::{Teams, View};
use crate::methods::alma::Conditioning;

/// The teams of all states: of every subtask, whether it has agents or not; without subtasks, everybody.
fn teams(windows: &Windows, conditioning: Conditioning) -> Teams {
    let mut teams = Teams::default();
    for state in 0..windows.shape.states() {
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
    let mut teams = teams(windows, conditioning);
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
