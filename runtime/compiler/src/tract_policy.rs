//! The source graph itself, run by tract: the reference for plans, and a back-end for hosts.

use sortie_core::choose::masked_argmax;
use sortie_core::{DecideError, Decision, NO_ACTION, Observation, Policy};
use tract_onnx::prelude::*;

use crate::error::CompileError;
use crate::graph::{Graph, Roles, guarded};

/// A policy that runs the ONNX graph with tract. It allocates, and takes about ten times as long as a plan.
#[derive(Debug)]
pub struct TractPolicy {
    state: TypedSimpleState,
    roles: Roles,
    columns: usize,
    features: usize,
    actions: usize,
    /// The place of the utilities among the outputs.
    answer: usize,
    compact: bool,
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
        let (columns, actions) = (graph.columns, graph.actions);
        if columns != features && columns != features + actions {
            let what = "the input width";
            return Err(CompileError::Size { what, got: columns, want: features + actions });
        }
        let utilities = vec![0.0; actions];
        let answer = graph.model.outputs.iter().position(|outlet| *outlet == graph.answer);
        let answer = answer.unwrap_or(0);
        Ok(Self { state, roles, columns, features, actions, answer, compact: true, utilities })
    }

    /// Gives all rows to the graph and leaves masking to it, as a check of the graph needs it.
    pub(crate) fn with_all_rows(mut self) -> Self {
        self.compact = false;
        self
    }

    /// The rows that the graph gets, in order.
    fn rows(&self, observation: &Observation<'_>) -> Vec<usize> {
        if self.compact {
            let mut rows = observation.visible;
            rows.insert(observation.self_index);
            rows.iter().collect()
        } else {
            (0..observation.rows.len() / observation.stride.max(1)).collect()
        }
    }

    /// The utilities; `hidden` is replaced.
    fn run(
        &mut self,
        observation: &Observation<'_>,
        hidden: &mut [f32],
    ) -> Result<Vec<f32>, DecideError> {
        let (want, got) = (self.hidden(), hidden.len());
        if want != got {
            return Err(DecideError::HiddenState { want, got });
        }
        let rows = self.rows(observation);
        let own = rows.iter().position(|&row| row == observation.self_index);
        let own = own.ok_or(DecideError::BadLength)? as i64;
        let visible: Vec<bool> =
            rows.iter().map(|&row| observation.visible.contains(row)).collect();
        let mut entities = vec![0.0; rows.len() * self.columns];
        for (to, &row) in entities.chunks_exact_mut(self.columns).zip(&rows) {
            self.fill_row(row, observation, to)?;
        }
        let (count, answer, memory) = (rows.len(), self.answer, self.roles.memory);
        let given = Tensor::from_shape(&[want], hidden).map_err(|_| DecideError::BadLength)?;
        let run = || {
            let mut inputs: Vec<(usize, Tensor)> = vec![
                (self.roles.entities, Tensor::from_shape(&[count, self.columns], &entities)?),
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
        let (utilities, state) = guarded(run).map_err(|_| DecideError::BadLength)?;
        if utilities.iter().chain(&state).any(|value| !value.is_finite()) {
            return Err(DecideError::NonFinite);
        }
        if state.len() != want {
            return Err(DecideError::BadLength);
        }
        hidden.copy_from_slice(&state);
        Ok(utilities)
    }

    fn fill_row(
        &self,
        row: usize,
        observation: &Observation<'_>,
        to: &mut [f32],
    ) -> Result<(), DecideError> {
        let start = row * observation.stride;
        let from = observation.rows.get(start..start + self.features);
        let from = from.ok_or(DecideError::BadLength)?;
        if from.iter().any(|value| !value.is_finite()) {
            return Err(DecideError::NonFinite);
        }
        let (features, one_hot) = to.split_at_mut(self.features);
        features.copy_from_slice(from);
        match observation.last_actions.get(row) {
            Some(&action) if !one_hot.is_empty() && action != NO_ACTION => {
                let slot = one_hot.get_mut(usize::from(action)).ok_or(DecideError::BadLength)?;
                *slot = 1.0;
            }
            _ => {}
        }
        Ok(())
    }
}

impl Policy for TractPolicy {
    fn actions(&self) -> usize {
        self.actions
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
        let computed = self.run(observation, hidden)?;
        if computed.len() != utilities.len() {
            return Err(DecideError::BadLength);
        }
        utilities.copy_from_slice(&computed);
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
