//! The utilities of the agents of some teams, on a tape; with a memory or without.
//!
//! A memory is a gated recurrent unit before the head, through the steps of a window. The public code announces this head
//! without a working version; dissertation figure 5.2 draws it. A memory is empty at the first step of a window and behind
//! the last state of an episode; who is absent has none.

use sortie_nn::random::Generator;
use sortie_nn::tape::{Gru, Parameters, Pass, Var};

use super::teams::{Look, Teams};
use crate::alma::agents::{UtilityInput, UtilityLayers};
use crate::alma::windows::WindowShape;
use crate::alma::windows::config::LowLevelConfig;

/// Utility network and, where agents have a memory, its recurrent unit.
#[derive(Clone, Copy, Debug)]
pub(super) struct AgentLayers {
    pub(super) network: UtilityLayers,
    pub(super) unit: Option<Gru>,
}

impl AgentLayers {
    /// Adds the first tensors, drawn uniformly in `±1/sqrt(inputs of the layer)`, as PyTorch does, of the embedding's
    /// first layer as configured; marks are a layer of their own.
    pub(super) fn new(
        config: &LowLevelConfig,
        sizes: WindowShape,
        p: &mut Parameters,
        random: &mut Generator,
    ) -> Self {
        let shape = config.shape(sizes);
        let features = sizes.features + sizes.actions;
        let active =
            if config.active_inputs > 0.0 { config.active_inputs } else { features as f32 };
        shape.draw(p, active, random);
        let factor = (active / (shape.input - features).max(1) as f32).sqrt();
        let marks = &mut p.values[features * shape.width..shape.input * shape.width];
        marks.iter_mut().for_each(|weight| *weight *= factor);
        let unit = config.recurrent.then(|| p.gru("memory", shape.base, random));
        Self { network: UtilityLayers::of(shape), unit }
    }

    /// The utilities `[agents, U]` of the agents of some teams, those with a memory all of one window. What agents have
    /// been told, `[agents, R]`, is added before the head.
    pub(super) fn utilities(
        self,
        t: &mut Pass<'_>,
        look: Look<'_>,
        teams: &mut Teams,
        told: Option<Var>,
    ) -> Var {
        if let Some(unit) = self.unit {
            return self.remembering(t, unit, look, teams);
        }
        let mut input = UtilityInput::default();
        teams.write_agents(look, &mut input);
        let mut looked = self.network.look(t, input.view());
        if let Some(told) = told {
            looked.base = t.add(looked.base, told);
        }
        self.network.head(t, looked, input.aims.all())
    }

    /// The utilities of agents with a memory: all agents go through all steps of the window.
    fn remembering(self, t: &mut Pass<'_>, unit: Gru, look: Look<'_>, wanted: &Teams) -> Var {
        let (windows, slots) = (look.windows, look.windows.shape.agents);
        let steps = windows.shape.steps;
        let mut sequence = look;
        sequence.view = look.view.sequence();
        let ahead = sequence.view.ahead();
        let first = wanted.each().next().map_or(0, |team| team.state / steps * steps);
        let count = steps - ahead;
        let (mut everybody, mut carry) = (Teams::default(), Vec::with_capacity(count * slots));
        for state in first..first + count {
            let scene = sequence.view.of(windows, state);
            everybody.push(scene, state, None);
            let seen = state + ahead;
            let last = seen > first && windows.reset[seen - 1];
            carry.extend((0..slots).map(|agent| !last && scene.present(agent)));
        }
        let mut input = UtilityInput::default();
        everybody.write_agents(sequence, &mut input);
        let mut looked = self.network.look(t, input.view());
        let place = |(state, agent): (usize, usize)| ((state - first) * slots + agent) as u32;
        let places: Vec<u32> = everybody.agents().map(place).collect();
        let inputs = t.scatter(looked.base, &places, count * slots);
        let memories = t.gru(inputs, unit, &carry, &mut vec![0.0; slots * unit.width]);

        let ahead = look.view.ahead() - ahead;
        // Heads that point do so at the rows of all who look.
        looked.base = t.gather(memories, &places);
        let utilities = self.network.head(t, looked, input.aims.all());
        let utilities = t.scatter(utilities, &places, count * slots);
        let wanted = wanted.agents().map(|(state, agent)| place((state + ahead, agent)));
        t.gather(utilities, &wanted.collect::<Vec<_>>())
    }
}
