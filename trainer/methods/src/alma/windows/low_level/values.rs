//! The agents' utility network as the learner uses it (dissertation section 7.3), and what it makes of a batch outside a
//! step: the utilities of all agents and the values of all teams.
//!
//! With the subtask mask an agent sees its team only; without it ("no mask") it sees everything, and a
//! subtask's embedding is added to what `fc1` gives for an entity: further rows of `fc1` for one-hot marks
//! behind the features. Which mark stands for which subtask is shuffled before each pass, so that no
//! subtask is special; spare marks let one network serve more subtasks than it was trained with.

use std::ops::Range;

use sortie_learn::networks::{AimedHead, Targets};
use sortie_nn::tape::Tape;

use super::agents::AgentLayers;
use super::mixer::{HypernetworkShape, Mixer, MixerInput, MixerShape};
use super::teams::{Look, Teams, View};
use crate::alma::agents::{Conditioning, TaskOrder, UtilityShape};
use crate::alma::coach::CoachShape;
use crate::alma::teams::Agents;
use crate::alma::windows::config::LowLevelConfig;
use crate::alma::windows::{WindowShape, Windows};

impl LowLevelConfig {
    /// What the head points at in an environment of these sizes.
    pub fn targets(&self, sizes: WindowShape) -> Targets {
        if self.head == AimedHead::Pointing { sizes.targets } else { Targets::NONE }
    }

    /// The sizes of the agents' network in an environment of these sizes.
    pub fn shape(&self, sizes: WindowShape) -> UtilityShape {
        let marks = self.conditioning.task_columns(sizes.tasks + self.extra_tasks);
        UtilityShape {
            input: sizes.features + sizes.actions + marks,
            width: self.width,
            heads: self.heads,
            base: self.base,
            actions: sizes.actions,
            skip: self.skip,
            targets: self.targets(sizes),
        }
    }

    /// The sizes of a coach in an environment of these sizes: as wide as its players.
    pub fn coach(&self, sizes: WindowShape) -> CoachShape {
        CoachShape {
            features: sizes.features,
            marks: sizes.tasks + self.extra_tasks,
            width: self.width,
            heads: self.heads,
            strategy: self.base,
        }
    }

    /// The sizes of the mixer in an environment of these sizes.
    pub fn mixer(&self, sizes: WindowShape) -> MixerShape {
        let tasks = if self.conditioning.has_subtasks() { sizes.tasks } else { 1 };
        let marks = self.conditioning.task_columns(sizes.tasks);
        MixerShape {
            hypernetwork: HypernetworkShape {
                input: sizes.features + sizes.actions + marks,
                width: self.hypernetwork_width,
                heads: self.hypernetwork_heads,
                mixing: self.mixing,
            },
            slots: sizes.agents,
            outputs: if self.popart_per_task { tasks } else { 1 },
            nonnegative: self.nonnegative,
            bias_nonnegative: self.bias_nonnegative,
        }
    }
}

/// The utilities `[W S, A, U]` in all states as the learner computes them, zeros for absent agents.
/// Memories are empty at the begin of a window.
pub fn agent_utilities(
    agents: Agents<'_>,
    windows: &Windows,
    conditioning: Conditioning,
    order: &TaskOrder,
) -> Vec<f32> {
    let (parameters, layers) = (agents.network.parameters, AgentLayers::of(agents));
    let look = Look::new((windows, View::NOW), (conditioning, order), agents.network.shape.targets);
    let WindowShape { windows: count, steps, agents, actions, .. } = windows.shape;
    let mut utilities = vec![0.0; windows.shape.states() * agents * actions];
    let mut tape = Tape::default();
    for window in 0..count {
        let states = window * steps..(window + 1) * steps;
        let mut teams = teams(windows, states, Conditioning::None);
        let mut t = tape.begin(parameters);
        let rows = layers.utilities(&mut t, look, &mut teams, None);
        for (row, (state, agent)) in t.values(rows).chunks_exact(actions).zip(teams.agents()) {
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
    let mut input = MixerInput::default();
    let look = Look::new((windows, View::NOW), (conditioning, &order), windows.shape.targets);
    teams.write_mixer(look, &mut input);
    (input, teams.agents().collect())
}

/// The values `[W S, T]` of all teams in normalised units, without subtasks `[W S]`, from the utilities
/// `[W S, A]` of what the agents do; `parameters` are those among which the mixer's are.
pub fn team_values(
    mixer: Mixer,
    parameters: &[f32],
    windows: &Windows,
    conditioning: Conditioning,
    utilities: &[f32],
) -> Vec<f32> {
    let (input, agents) = team_input(windows, conditioning);
    let own = agents.iter().map(|(state, agent)| utilities[state * windows.shape.agents + agent]);
    let own: Vec<f32> = own.collect();
    let (mut tape, mut all) = (Tape::default(), parameters.to_vec());
    mixer.append_merged(&mut tape, &mut all);
    let mut t = tape.begin(&all);
    let utilities = t.input(1, &own);
    let values = mixer.mix(&mut t, parameters.len(), &input, utilities);
    let outputs = (0..mixer.shape.outputs as u32).cycle().take(input.teams.teams());
    let values = mixer.head(&mut t, values, &outputs.collect::<Vec<_>>());
    t.values(values).to_vec()
}
