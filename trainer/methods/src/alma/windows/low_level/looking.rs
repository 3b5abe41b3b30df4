//! How the agents of some teams look at their states, and what gradients that gives; with a memory or without.
//!
//! A memory is a gated recurrent unit before the head, through the steps of a window. The public code announces this head
//! without a working version; dissertation figure 5.2 draws it. A memory is empty at the first step of a window and behind
//! the last state of an episode; who is absent has none.

use sortie_nn::layers::gru::{GruPass, GruShape, lengths};
use sortie_nn::random::{Generator, signed_unit};

use super::coaching::Held;
use super::teams::{Marks, Teams, View};
use crate::alma::agents::{Conditioning, UtilityInput, UtilityNetwork, UtilityPass, UtilityShape};
use crate::alma::coach::PlayerPass;
use crate::alma::windows::Windows;

/// Draws a unit uniformly in `±1/sqrt(width)`, as PyTorch does.
pub(super) fn initialise_unit(width: usize, generator: &mut Generator) -> Vec<f32> {
    let bound = 1.0 / (width as f32).sqrt();
    let length = lengths(width).iter().sum::<usize>();
    (0..length).map(|_| bound * signed_unit(generator)).collect()
}

/// Utility network and recurrent unit.
#[derive(Clone, Copy)]
pub(super) struct Recurrent<'a> {
    pub(super) network: &'a UtilityNetwork,
    /// Empty where agents have no memory.
    pub(super) gru: &'a [f32],
}

/// Buffers of one worker.
#[derive(Clone, Debug, Default)]
struct RecurrentPass {
    teams: Teams,
    input: UtilityInput,
    gru: GruPass,
    shape: Option<GruShape>,
    carry: Vec<bool>,
    /// Where the rows of the utility network stand among `[S, A]`.
    places: Vec<usize>,
    /// Where the rows that were asked for stand.
    wanted: Vec<usize>,
    /// `[S, A, R]`
    inputs: Vec<f32>,
    outputs: Vec<f32>,
    d_inputs: Vec<f32>,
    d_outputs: Vec<f32>,
    memory: Vec<f32>,
    /// `[wanted, R]`
    rows: Vec<f32>,
    d_rows: Vec<f32>,
}

impl RecurrentPass {
    /// Computes the utilities of the agents of some teams, all of one window, in a view of their states.
    pub(super) fn forward<'u>(
        &mut self,
        agents: Recurrent<'_>,
        utility: &'u mut UtilityPass,
        (windows, view): (&Windows, View),
        conditioning: (Conditioning, Marks<'_>),
        wanted: &Teams,
    ) -> &'u [f32] {
        let (slots, steps) = (windows.shape.agents, windows.shape.steps);
        let Some(window) = wanted.each().next().map(|team| team.state / steps) else {
            return &[];
        };
        let sequence = view.sequence();
        let (first, count) = (window * steps, steps - sequence.ahead());
        self.teams.clear();
        self.carry.clear();
        for state in first..first + count {
            let scene = sequence.of(windows, state);
            self.teams.push(scene, state, None);
            let seen = state + sequence.ahead();
            let last = seen > first && windows.reset[seen - 1];
            self.carry.extend((0..slots).map(|agent| !last && scene.present(agent)));
        }
        self.teams.write_agents((windows, sequence), conditioning, &mut self.input);
        let width = agents.network.shape().base;
        let shape = GruShape { width, slots };
        self.shape = Some(shape);
        let base = utility.forward_base(agents.network, &self.input);

        let place = |(state, agent): (usize, usize)| (state - first) * slots + agent;
        self.places.clear();
        self.places.extend(self.teams.agents().map(place));
        scatter(base, width, &self.places, count * slots, &mut self.inputs);
        self.memory.clear();
        self.memory.resize(slots * width, 0.0);
        self.outputs.resize(self.inputs.len(), 0.0);
        let input = (&*self.inputs, &*self.carry);
        self.gru.forward(shape, agents.gru, input, &mut self.memory, &mut self.outputs);

        let ahead = view.ahead() - sequence.ahead();
        self.wanted.clear();
        self.wanted.extend(wanted.agents().map(|(state, agent)| place((state + ahead, agent))));
        gather(&self.outputs, width, &self.wanted, &mut self.rows);
        utility.forward_head(agents.network, &self.rows)
    }

    /// Adds the gradients of network and unit, one behind the other, of a loss whose slope by the
    /// utilities of the last forward pass is `d_utilities`.
    pub(super) fn backward(
        &mut self,
        agents: Recurrent<'_>,
        utility: &mut UtilityPass,
        d_utilities: &[f32],
        gradient: &mut [f32],
    ) {
        let Some(shape) = self.shape else { return };
        let width = shape.width;
        let (of_network, of_gru) = gradient.split_at_mut(agents.network.parameters().len());
        self.d_rows.resize(self.rows.len(), 0.0);
        let (rows, d_rows) = (&self.rows, &mut self.d_rows);
        utility.backward_head(agents.network, rows, d_utilities, d_rows, of_network);
        let all = self.outputs.len() / width;
        scatter(&self.d_rows, width, &self.wanted, all, &mut self.d_outputs);
        self.d_inputs.resize(self.inputs.len(), 0.0);
        let input = (&*self.inputs, &*self.carry);
        let slopes = (&*self.d_outputs, &mut *self.d_inputs);
        self.gru.backward(shape, agents.gru, input, slopes, of_gru);
        gather(&self.d_inputs, width, &self.places, &mut self.d_rows);
        utility.backward_base(agents.network, &self.input, &mut self.d_rows, of_network);
    }
}

/// Puts rows at their places among so many, the others being zeros.
fn scatter(rows: &[f32], width: usize, places: &[usize], all: usize, out: &mut Vec<f32>) {
    out.clear();
    out.resize(all * width, 0.0);
    for (row, place) in rows.chunks_exact(width).zip(places) {
        out[place * width..][..width].copy_from_slice(row);
    }
}

/// Takes rows from their places.
fn gather(all: &[f32], width: usize, places: &[usize], rows: &mut Vec<f32>) {
    rows.clear();
    places.iter().for_each(|place| rows.extend_from_slice(&all[place * width..][..width]));
}

/// Passes of the agents of some teams: as they are, with a memory, or with a coach.
#[derive(Clone, Debug)]
pub(super) struct LookingPass {
    input: UtilityInput,
    utility: UtilityPass,
    recurrent: RecurrentPass,
    players: PlayerPass,
}

impl LookingPass {
    /// Empty buffers for networks of a shape.
    pub(super) fn new(shape: UtilityShape) -> Self {
        Self {
            input: UtilityInput::default(),
            utility: UtilityPass::new(shape),
            recurrent: RecurrentPass::default(),
            players: PlayerPass::default(),
        }
    }

    pub(super) fn operations(&self) -> u64 {
        self.utility.operations()
    }

    /// Computes the utilities of the agents of some teams in a view of their states.
    pub(super) fn forward(
        &mut self,
        (agents, told): (Recurrent<'_>, Option<Held<'_>>),
        look: (&Windows, View),
        conditioning: (Conditioning, Marks<'_>),
        teams: &mut Teams,
    ) -> &[f32] {
        if agents.gru.is_empty() {
            teams.write_agents(look, conditioning, &mut self.input);
            let Some(told) = told else {
                return self.utility.forward(agents.network, &self.input);
            };
            let ahead = look.1.ahead();
            let strategies = teams.agents().map(|(state, agent)| told.of(state + ahead, agent));
            let Self { input, utility, players, .. } = self;
            return players.forward(agents.network, utility, input, strategies);
        }
        self.recurrent.forward(agents, &mut self.utility, look, conditioning, teams)
    }

    /// Adds the gradients of network and memory, after [`forward`](Self::forward).
    pub(super) fn backward(
        &mut self,
        agents: Recurrent<'_>,
        d_utilities: &[f32],
        gradient: &mut [f32],
    ) {
        if agents.gru.is_empty() {
            self.utility.backward(agents.network, &self.input, d_utilities, gradient);
        } else {
            self.recurrent.backward(agents, &mut self.utility, d_utilities, gradient);
        }
    }

    /// The same for agents with a coach; returns the slopes by what they were told.
    pub(super) fn backward_told(
        &mut self,
        agents: Recurrent<'_>,
        d_utilities: &[f32],
        gradient: &mut [f32],
    ) -> &[f32] {
        let Self { input, utility, players, .. } = self;
        players.backward(agents.network, utility, input, d_utilities, gradient)
    }
}
