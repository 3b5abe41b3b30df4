//! The source graph itself, run by tract: the reference for plans, and a back-end for hosts.

use sortie_core::choose::masked_argmax;
use sortie_core::{DecideError, Decision, Observation, Policy};
use tract_onnx::prelude::*;

use crate::engine::AgentEngine;
use crate::graph::inputs::{AgentColumns, all_finite};
use crate::graph::{Graph, Roles, guarded};
use sortie_plans::CompileError;
use sortie_plans::Rows;

/// A policy that runs the ONNX graph with tract. It allocates, and takes about ten times as long as a plan.
#[derive(Debug)]
pub struct TractPolicy {
    state: TypedSimpleState,
    roles: Roles,
    columns: AgentColumns,
    /// The place of the utilities among the outputs.
    answer: usize,
    utilities: Vec<f32>,
}

impl TractPolicy {
    /// Reads an ONNX file; `features` is the number d of columns before the last action's one-hot.
    ///
    /// Only visible rows and the agent's own are given to the graph.
    pub fn new(onnx: &[u8], features: usize) -> Result<Self, CompileError> {
        Self::from_graph(&Graph::read(onnx)?, features)
    }

    pub(crate) fn from_graph(graph: &Graph, features: usize) -> Result<Self, CompileError> {
        let roles = graph.agent_roles()?;
        let state = graph.runnable()?;
        let columns = AgentColumns::new(graph.columns, features, graph.actions)?;
        let answer = graph.model.outputs.iter().position(|outlet| *outlet == graph.answer);
        let (answer, utilities) = (answer.unwrap_or(0), vec![0.0; graph.actions]);
        Ok(Self { state, roles, columns, answer, utilities })
    }

    /// Writes what the graph gives `[U]` and replaces the recurrent state `[R]`, whatever numbers these are.
    pub(crate) fn step(
        &mut self,
        observation: &Observation<'_>,
        rows: Rows,
        hidden: &mut [f32],
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        let (memory, answer) = (self.roles.memory, self.answer);
        let (want, got) = (memory.map_or(0, |memory| memory.size), hidden.len());
        if want != got {
            return Err(DecideError::HiddenState { want, got });
        }
        let rows = self.columns.rows(observation, rows)?;
        let (count, columns) = (rows.len(), self.columns.columns);
        let (mut entities, mut visible) = (vec![0.0; count * columns], vec![false; count]);
        let own = self.columns.write(observation, &rows, &mut entities, &mut visible)?;
        let given = Tensor::from_shape(&[want], hidden).map_err(|_| DecideError::BadLength)?;
        let run = || {
            let mut inputs: Vec<(usize, Tensor)> = vec![
                (self.roles.entities, Tensor::from_shape(&[count, columns], &entities)?),
                (self.roles.self_index, Tensor::from_shape(&[1], &[own])?),
                (self.roles.visible, Tensor::from_shape(&[count], &visible)?),
            ];
            inputs.extend(memory.map(|memory| (memory.input, given)));
            inputs.sort_by_key(|(slot, _)| *slot);
            let outputs = self.state.run(inputs.into_iter().map(|(_, t)| t.into()).collect())?;
            let output = |place: usize| -> TractResult<Vec<f32>> {
                let output = outputs.get(place).ok_or_else(|| TractError::msg("no output"))?;
                Ok(output.to_plain_array_view::<f32>()?.iter().copied().collect())
            };
            let state = memory.map_or(Ok(Vec::new()), |memory| output(memory.output))?;
            Ok((output(answer)?, state))
        };
        // What tract may refuse are sizes that the graph cannot take.
        let (computed, state) = guarded(run).map_err(|_| DecideError::BadLength)?;
        if computed.len() != utilities.len() || state.len() != want {
            return Err(DecideError::BadLength);
        }
        utilities.copy_from_slice(&computed);
        hidden.copy_from_slice(&state);
        Ok(())
    }
}

impl AgentEngine for TractPolicy {
    fn columns(&self) -> AgentColumns {
        self.columns
    }

    fn run(
        &mut self,
        observation: &Observation<'_>,
        rows: Rows,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        let mut memory = vec![0.0; self.hidden()];
        self.step(observation, rows, &mut memory, utilities)
    }
}

impl Policy for TractPolicy {
    fn actions(&self) -> usize {
        self.utilities.len()
    }

    fn utilities(
        &mut self,
        observation: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        self.utilities_with(observation, &mut [], utilities)
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        self.decide_with(observation, &mut [])
    }

    fn hidden(&self) -> usize {
        self.roles.memory.map_or(0, |memory| memory.size)
    }

    fn utilities_with(
        &mut self,
        observation: &Observation<'_>,
        hidden: &mut [f32],
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        let rows = self.columns.rows(observation, Rows::Visible)?;
        self.columns.check_finite(observation, &rows)?;
        let mut state = hidden.to_vec();
        self.step(observation, Rows::Visible, &mut state, utilities)?;
        if !(all_finite(utilities) && all_finite(&state)) {
            return Err(DecideError::NonFinite);
        }
        hidden.copy_from_slice(&state);
        Ok(())
    }

    fn decide_with(
        &mut self,
        observation: &Observation<'_>,
        hidden: &mut [f32],
    ) -> Result<Decision, DecideError> {
        let mut utilities = std::mem::take(&mut self.utilities);
        let chosen = self
            .utilities_with(observation, hidden, &mut utilities)
            .and_then(|()| masked_argmax(&utilities, observation.available));
        self.utilities = utilities;
        chosen
    }
}
