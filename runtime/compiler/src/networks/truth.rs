//! A network's truth: the same tensors for its file in double precision.

use sortie_plans::{CompileError, NetworkInput, Rows, TrueAnswers, TrueNumber};

use super::{DoublePrecision, GraphNetwork, Graphs};
use crate::engine::reference::ReferenceEngine;
use crate::reference::{RUNS, Runs, truth};

/// A network whose truth is known.
#[derive(Debug)]
pub(crate) struct TrueNetwork {
    network: GraphNetwork<ReferenceEngine>,
    seed: u64,
}

impl TrueNetwork {
    /// Of graphs; an agent's rows have so many features before the last action's one-hot.
    pub(crate) fn new(graphs: &Graphs, features: usize, seed: u64) -> Result<Self, CompileError> {
        Ok(Self { network: graphs.open(&DoublePrecision, features)?, seed })
    }
}

impl TrueAnswers for TrueNetwork {
    fn answer(
        &mut self,
        input: &NetworkInput,
        rows: Rows,
    ) -> Result<Vec<Vec<TrueNumber>>, CompileError> {
        let Self { network, seed } = self;
        let run = |run: usize| {
            network.engines().into_iter().for_each(|engine| engine.begin(run, *seed));
            network.outputs(input, rows)
        };
        let runs: Runs = (0..RUNS).map(run).collect::<Result<_, _>>()?;
        truth(&runs).map_err(|reason| CompileError::Run { reason })
    }
}
