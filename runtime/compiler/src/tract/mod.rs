//! The source graph run by tract: the reference for plans, and a back-end for hosts.

mod proposals;

use sortie_core::allocate::{TeamQuery, TeamValueNetwork};
use sortie_core::choose::masked_argmax;
use sortie_core::{AllocateError, DecideError, Decision, Entities, Observation, Policy};
use sortie_plans::{
    CompileError, FlatPolicy, OutputRole, PolicyAnswer, PolicyFacts, PolicyInput, Rows, ValueType,
};
use tract_onnx::prelude::*;

use crate::flat::{FlatGraph, Interface, other_values};
use crate::graph::inputs::{AgentColumns, AgentEngine, TeamValueEngine, all_finite, checked_value};
use crate::graph::{EntityRoles, Graph, Roles, TeamRoles, guarded};

pub(crate) use proposals::TractProposals;

/// Inputs, each with its place, in the order of the graph.
fn ordered(mut inputs: Vec<(usize, Tensor)>) -> TVec<TValue> {
    inputs.sort_by_key(|(place, _)| *place);
    inputs.into_iter().map(|(_, tensor)| tensor.into()).collect()
}

fn numbers(value: &TValue) -> TractResult<Vec<f32>> {
    Ok(value.to_plain_array_view::<f32>()?.iter().copied().collect())
}

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
            let outputs = self.state.run(ordered(inputs))?;
            let output = |place: usize| {
                numbers(outputs.get(place).ok_or_else(|| TractError::msg("no output"))?)
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

/// A network over all entities that runs the ONNX graph with tract. It allocates.
#[derive(Debug)]
pub(crate) struct TractEntities {
    state: TypedSimpleState,
    roles: EntityRoles,
    features: usize,
}

impl TractEntities {
    pub(crate) fn from_graph(graph: &Graph) -> Result<Self, CompileError> {
        let (roles, features) = (graph.entity_roles()?, graph.columns);
        Ok(Self { state: graph.runnable()?, roles, features })
    }

    /// The values of every output, in the graph's order. All rows are given to the graph.
    pub(crate) fn run(&mut self, entities: &Entities<'_>) -> Result<Vec<Vec<f32>>, CompileError> {
        let Self { roles, features, .. } = *self;
        let count = entities.groups.len();
        let rows = entities.rows.chunks(entities.stride.max(1)).take(count);
        let features_of = |row: &[f32]| row.iter().take(features).copied().collect::<Vec<_>>();
        let rows: Vec<f32> = rows.flat_map(features_of).collect();
        let mask = |holds: &dyn Fn(usize) -> bool| (0..count).map(holds).collect::<Vec<bool>>();
        let groups = roles.group_count;
        let belongs = entities.groups.iter().flat_map(|bits| {
            (0..groups as u32).map(|group| bits.checked_shr(group).unwrap_or(0) & 1 == 1)
        });
        let belongs: Vec<bool> = belongs.collect();
        let present = mask(&|entity| entities.present.contains(entity));
        let agents = mask(&|entity| entities.agents.contains(entity));
        let run = || {
            let mut inputs: Vec<(usize, Tensor)> = vec![
                (roles.entities, Tensor::from_shape(&[count, features], &rows)?),
                (roles.present, Tensor::from_shape(&[count], &present)?),
            ];
            if let Some(place) = roles.is_agent {
                inputs.push((place, Tensor::from_shape(&[count], &agents)?));
            }
            if let Some(place) = roles.groups {
                inputs.push((place, Tensor::from_shape(&[count, groups], &belongs)?));
            }
            self.state.run(ordered(inputs))?.iter().map(numbers).collect()
        };
        guarded(run).map_err(|reason| CompileError::Run { reason })
    }
}

/// A team-value network that runs the ONNX graph with tract, a team at a time. It allocates.
#[derive(Debug)]
pub struct TractTeamValue {
    state: TypedSimpleState,
    roles: TeamRoles,
}

impl TractTeamValue {
    /// Reads an ONNX file. Only the rows that the query attends to, and its own, are given to the graph.
    pub fn new(onnx: &[u8]) -> Result<Self, CompileError> {
        Self::from_graph(&Graph::read(onnx)?)
    }

    pub(crate) fn from_graph(graph: &Graph) -> Result<Self, CompileError> {
        Ok(Self { roles: graph.team_roles()?, state: graph.runnable()? })
    }

    /// Features d of an entity and columns F of its relation.
    pub fn columns(&self) -> (usize, usize) {
        (self.roles.features, self.roles.relations)
    }
}

impl TeamValueEngine for TractTeamValue {
    fn roles(&self) -> TeamRoles {
        self.roles
    }

    fn run(&mut self, query: &TeamQuery<'_>, rows: Rows) -> Result<f32, AllocateError> {
        let roles = self.roles;
        let rows = roles.rows(query, rows)?;
        let count = rows.len();
        let mut features = vec![0.0; count * roles.features];
        let mut relation = vec![0.0; count * roles.relations];
        let mut masks: [Vec<bool>; 5] = std::array::from_fn(|_| vec![false; count]);
        let slices = masks.each_mut().map(Vec::as_mut_slice);
        roles.write(query, &rows, &mut features, &mut relation, slices)?;
        let run = || {
            let mut inputs: Vec<(usize, Tensor)> = vec![
                (roles.entities, Tensor::from_shape(&[count, roles.features], &features)?),
                (roles.relation, Tensor::from_shape(&[count, roles.relations], &relation)?),
            ];
            for (slot, mask) in roles.masks().into_iter().zip(&masks) {
                inputs.push((slot, Tensor::from_shape(&[count], mask)?));
            }
            let outputs = self.state.run(ordered(inputs))?;
            let last = outputs.last().ok_or_else(|| TractError::msg("no output"))?;
            Ok(last.to_plain_array_view::<f32>()?.first().copied().unwrap_or(f32::NAN))
        };
        // What tract may refuse are sizes that the graph cannot take.
        guarded(run).map_err(|_| AllocateError::BadLength)
    }
}

impl TeamValueNetwork for TractTeamValue {
    fn value(&mut self, query: &TeamQuery<'_>) -> Result<f32, AllocateError> {
        checked_value(self, query)
    }
}

/// A policy that runs its graph with tract. It allocates, and promises nothing about bits or time.
#[derive(Debug)]
pub(crate) struct TractFlatPolicy {
    state: TypedSimpleState,
    interface: Interface,
    /// The states of [`FlatPolicy::step`].
    states: Vec<f32>,
}

impl TractFlatPolicy {
    pub(crate) fn from_graph(graph: FlatGraph) -> Result<Self, CompileError> {
        let FlatGraph { model, interface, .. } = graph;
        let state = guarded(|| model.into_optimized()?.into_runnable()?.spawn());
        let state = state.map_err(|reason| CompileError::Run { reason })?;
        let states = vec![0.0; interface.facts.state_length()];
        Ok(Self { state, interface, states })
    }
}

impl FlatPolicy for TractFlatPolicy {
    fn facts(&self) -> &PolicyFacts {
        &self.interface.facts
    }

    fn run(
        &mut self,
        inputs: &[&[f32]],
        states: &mut [f32],
    ) -> Result<Vec<PolicyAnswer>, CompileError> {
        let Self { state, interface, .. } = self;
        let arranged = interface.arranged(inputs, states)?;
        let run = || {
            let inputs = arranged.into_iter().map(|(input, numbers)| tensor(input, numbers));
            let outputs = state.run(inputs.collect::<TractResult<_>>()?)?;
            let numbers = |output: &TValue| -> TractResult<Vec<f32>> {
                let output = output.cast_to::<f32>()?;
                Ok(output.to_plain_array_view::<f32>()?.iter().copied().collect())
            };
            outputs.iter().map(numbers).collect::<TractResult<Vec<_>>>()
        };
        let given = guarded(run).map_err(|reason| CompileError::Run { reason })?;
        interface.answers(&given, states)
    }

    fn step(&mut self, inputs: &[&[f32]]) -> Result<(), CompileError> {
        let Self { state, interface, states } = self;
        let arranged = interface.arranged(inputs, states)?;
        let run = || {
            let inputs = arranged.into_iter().map(|(input, numbers)| tensor(input, numbers));
            state.run(inputs.collect::<TractResult<_>>()?)
        };
        let given = guarded(run).map_err(|reason| CompileError::Run { reason })?;
        let next = interface.facts.outputs.iter().zip(&given);
        let next = next.filter(|(output, _)| output.role == OutputRole::State);
        let mut rest = states.as_mut_slice();
        for (output, numbers) in next {
            let view = numbers.to_plain_array_view::<f32>();
            let view = view.map_err(|error| CompileError::Run { reason: error.to_string() })?;
            let (to, from) = (rest.split_off_mut(..output.length()), view.as_slice());
            let (to, from) = to.zip(from).ok_or_else(other_values)?;
            to.copy_from_slice(from);
        }
        Ok(())
    }
}

fn tensor(input: &PolicyInput, numbers: &[f32]) -> TractResult<TValue> {
    let kind = match input.kind {
        ValueType::F32 => DatumType::F32,
        ValueType::F64 => DatumType::F64,
        ValueType::I64 => DatumType::I64,
        ValueType::I32 => DatumType::I32,
        ValueType::U8 => DatumType::U8,
        ValueType::Bool => DatumType::Bool,
    };
    let numbers = Tensor::from_shape(&input.shape, numbers)?;
    Ok(numbers.cast_to_dt(kind)?.into_owned().into_tvalue())
}
