//! Players: a utility network with a strategy added before its head.

use crate::alma::agents::{UtilityInput, UtilityNetwork, UtilityPass};

/// Buffers of one worker for passes of players, beside those of their network.
#[derive(Clone, Debug, Default)]
pub struct PlayerPass {
    /// What stands before the head, `[agents, R]`.
    rows: Vec<f32>,
    d_rows: Vec<f32>,
    d_strategies: Vec<f32>,
}

impl PlayerPass {
    /// Computes the utilities `[agents, U]`, given every agent's strategy `[R]` in turn, if it has
    /// been told one.
    pub fn forward<'u, 's>(
        &mut self,
        network: &UtilityNetwork,
        utility: &'u mut UtilityPass,
        input: &UtilityInput,
        strategies: impl Iterator<Item = Option<&'s [f32]>>,
    ) -> &'u [f32] {
        let width = network.shape().base;
        let base = utility.forward_base(network, input);
        self.rows.clear();
        for (base, strategy) in base.chunks_exact(width).zip(strategies) {
            match strategy {
                Some(told) => self.rows.extend(base.iter().zip(told).map(|(x, z)| x + z)),
                None => self.rows.extend_from_slice(base),
            }
        }
        utility.forward_head(network, &self.rows)
    }

    /// Adds the gradient of a loss whose slope by the utilities of the last forward pass is given; returns
    /// its slope by the strategies, `[agents, R]`.
    pub fn backward(
        &mut self,
        network: &UtilityNetwork,
        utility: &mut UtilityPass,
        input: &UtilityInput,
        d_utilities: &[f32],
        gradient: &mut [f32],
    ) -> &[f32] {
        let Self { rows, d_rows, d_strategies } = self;
        d_rows.resize(rows.len(), 0.0);
        utility.backward_head(network, rows, d_utilities, d_rows, gradient);
        // The base is rectified, strategies are not.
        d_strategies.clone_from(d_rows);
        utility.backward_base(network, input, d_rows, gradient);
        d_strategies
    }
}
