//! How the agents of some teams look at their states, and what gradients that gives.

use super::super::batch::Windows;
use super::coaching::Held;
use super::recurrent::{Recurrent, RecurrentPass};
use super::scene::Marks;
use super::teams::{Teams, View};
use crate::alma::agents::{Conditioning, UtilityInput, UtilityPass, UtilityShape};
use crate::alma::coach::PlayerPass;

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

    /// Floating-point operations up to now.
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
