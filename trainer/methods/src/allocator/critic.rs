//! What values allocations: the network that proposes once more, with weights of its own, whose vector makes a number.

use sortie_learn::LearnError;
use sortie_nn::random::Generator;
use sortie_nn::tape::{Linear, Parameters, Pass, Var};

use super::NetworkConfig;
use super::network::{Decisions, Network};

/// A critic.
#[derive(Clone, Debug)]
pub(super) struct Critic {
    pub(super) network: Network,
    value: Linear,
}

impl Critic {
    /// Draws the first weights, as [`Network::new`] does.
    pub(super) fn new(
        config: &NetworkConfig,
        columns: [usize; 2],
        random: &mut Generator,
    ) -> Result<(Self, Parameters), LearnError> {
        let (network, mut parameters) = Network::new(config, columns, random)?;
        let value = parameters.linear("value", config.width, 1, random);
        Ok((Self { network, value }, parameters))
    }

    /// `[situations, 1]`: what is still to be earned.
    pub(super) fn values(&self, pass: &mut Pass<'_>, tables: Var, situations: &Decisions) -> Var {
        let vectors = self.network.query(pass, tables, situations);
        let vectors = pass.tanh(vectors);
        pass.linear(vectors, self.value)
    }
}
