//! An agent's graph: rows of entities, which of them it sees, and which it is.

use sortie_core::choose::masked_argmax;
use sortie_core::{DecideError, Decision, EntityMask, NO_ACTION, Observation, Policy};
use sortie_plans::{CompileError, Rows};

use super::{Opens, Tract};
use crate::engine::{AnyEngine, Engine, Number, Tensors, flag};
use crate::graph::{Graph, Memory};
use crate::matching::aimed_at;
use crate::onnxruntime::{OnnxRuntime, SessionEngine};

/// An agent's graph in an engine.
#[derive(Debug)]
pub(crate) struct AgentGraph<E: Engine> {
    pub(super) engine: E,
    columns: AgentColumns,
    actions: usize,
    memory: Option<Memory>,
    /// The place of the utilities among the outputs.
    answer: usize,
    /// One more than the last entity that an action aims at; 0 where none does.
    aimed_at: usize,
    /// Entities, own index, mask, and the recurrent state where there is one.
    tensors: Tensors<E::Number>,
}

impl<E: Engine> AgentGraph<E> {
    pub(crate) fn new(graph: &Graph, features: usize, engine: E) -> Result<Self, CompileError> {
        let roles = graph.agent_roles()?;
        let columns = AgentColumns::new(graph.columns, features, graph.actions)?;
        let answer = graph.model.outputs.iter().position(|outlet| *outlet == graph.answer);
        let state = roles.memory.map(|memory| memory.input);
        let inputs = [roles.entities, roles.self_index, roles.visible].into_iter().chain(state);
        let tensors = Tensors::new(inputs.map(|input| graph.input_name(input)));
        let (actions, memory, answer) = (graph.actions, roles.memory, answer.unwrap_or(0));
        let aimed_at = aimed_at(graph)?;
        Ok(Self { engine, columns, actions, memory, answer, aimed_at, tensors })
    }

    /// Floats of its recurrent state.
    pub(crate) fn memory(&self) -> usize {
        self.memory.map_or(0, |memory| memory.size)
    }

    /// The utilities `[U]` and the next recurrent state `[R]`, whatever numbers these are.
    pub(crate) fn run(
        &mut self,
        seen: &Observation<'_>,
        rows: Rows,
        memory: &[f32],
    ) -> Result<[Vec<E::Number>; 2], DecideError> {
        let (want, got) = (self.memory(), memory.len());
        if want != got {
            return Err(DecideError::HiddenState { want, got });
        }
        let Self { engine, columns, tensors, .. } = self;
        let shown = columns.rows(seen, rows)?;
        // Who is aimed at is said by numbers of rows: all of them are there, zeros where nobody is or is to be shown.
        let rows = if self.aimed_at > 0 { columns.rows(seen, Rows::All)? } else { shown };
        let count = rows.len().max(self.aimed_at);
        let entities = tensors.room(0, &[count, columns.columns]).ok_or(DecideError::BadLength)?;
        for (place, row) in rows.iter().enumerate() {
            if shown.contains(row) {
                columns.push_row(seen, row, entities)?;
            } else {
                entities.resize((place + 1) * columns.columns, E::Number::from(0.0));
            }
        }
        entities.resize(count * columns.columns, E::Number::from(0.0));
        let own = rows.iter().position(|row| row == seen.self_index).unwrap_or(0);
        tensors.fill(1, &[1], [own as f32]);
        let visible = rows.iter().map(|row| flag(seen.visible.contains(row)));
        let absent = std::iter::repeat_n(flag(false), count - rows.len());
        tensors.fill(2, &[count], visible.chain(absent));
        tensors.fill(3, &[want], memory.iter().copied());
        // What engines may refuse are sizes that the graph cannot take.
        let outputs = engine.run(&tensors.named()).map_err(|_| DecideError::BadLength)?;
        let output = |place: usize| outputs.get(place).cloned().ok_or(DecideError::BadLength);
        let state = self.memory.map_or(Ok(Vec::new()), |memory| output(memory.output))?;
        let utilities = output(self.answer)?;
        let fits = utilities.len() == self.actions && state.len() == want;
        if fits { Ok([utilities, state]) } else { Err(DecideError::BadLength) }
    }
}

/// Columns of an agent's graph.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AgentColumns {
    /// Columns D of a row.
    pub(crate) columns: usize,
    /// Features d before the last action's one-hot.
    features: usize,
}

impl AgentColumns {
    /// Checks that rows are features, with or without the one-hot of `actions` behind them.
    pub(crate) fn new(
        columns: usize,
        features: usize,
        actions: usize,
    ) -> Result<Self, CompileError> {
        if columns != features && columns != features + actions {
            let what = "the input width".into();
            return Err(CompileError::Size { what, got: columns, want: features + actions });
        }
        Ok(Self { columns, features })
    }

    /// The rows that a graph gets, in rising order; the own one is always among them.
    fn rows(self, seen: &Observation<'_>, rows: Rows) -> Result<EntityMask, DecideError> {
        let count = seen.rows.len() / seen.stride.max(1);
        let mut mask = match rows {
            Rows::All => EntityMask::first(count),
            Rows::Visible => seen.visible,
        };
        mask.insert(seen.self_index);
        let exist = mask.and(&EntityMask::first(count)) == mask;
        let fits = exist && mask.contains(seen.self_index);
        if fits { Ok(mask) } else { Err(DecideError::BadLength) }
    }

    /// The features of a row.
    fn features<'a>(self, seen: &Observation<'a>, row: usize) -> Result<&'a [f32], DecideError> {
        let start = row * seen.stride;
        seen.rows.get(start..start + self.features).ok_or(DecideError::BadLength)
    }

    /// Writes the columns `[D]` of one row behind the others.
    pub(crate) fn push_row<N: Number>(
        self,
        seen: &Observation<'_>,
        row: usize,
        to: &mut Vec<N>,
    ) -> Result<(), DecideError> {
        to.extend(self.features(seen, row)?.iter().copied().map(N::from));
        let actions = self.columns - self.features;
        let last = seen.last_actions.get(row).filter(|action| **action != NO_ACTION);
        let last = last.map(|action| usize::from(*action)).filter(|_| actions > 0);
        if last.is_some_and(|action| action >= actions) {
            return Err(DecideError::BadLength);
        }
        to.extend((0..actions).map(|action| N::from(flag(last == Some(action)))));
        Ok(())
    }

    /// Refuses what plans refuse: a feature of a row in sight that is not a finite number.
    fn check_finite(self, seen: &Observation<'_>) -> Result<(), DecideError> {
        for row in self.rows(seen, Rows::Visible)?.iter() {
            check_finite(self.features(seen, row)?)?;
        }
        Ok(())
    }
}

fn check_finite(numbers: &[f32]) -> Result<(), DecideError> {
    let is_finite = numbers.iter().all(|number| number.is_finite());
    if is_finite { Ok(()) } else { Err(DecideError::NonFinite) }
}

/// A policy that runs its ONNX graph. It allocates, and takes many times as long as a plan.
#[derive(Debug)]
pub struct GraphPolicy(AgentGraph<AnyEngine>);

impl GraphPolicy {
    /// Reads an ONNX file for tract; `features` is the number d of columns before the last action's one-hot.
    ///
    /// Only visible rows and the agent's own are given to the graph.
    pub fn by_tract(onnx: &[u8], features: usize) -> Result<Self, CompileError> {
        Self::open(&Graph::read(onnx)?, features, &Tract)
    }

    /// The same for onnxruntime.
    pub fn by_onnxruntime(
        runtime: &OnnxRuntime,
        onnx: &[u8],
        features: usize,
    ) -> Result<Self, CompileError> {
        Self::open(&Graph::read(onnx)?, features, runtime)
    }

    /// Runs `variant` by onnxruntime, which has the inputs and outputs of `onnx`: the same network quantised, for
    /// example.
    pub(crate) fn of_variant(
        runtime: &OnnxRuntime,
        onnx: &[u8],
        variant: &[u8],
        features: usize,
    ) -> Result<Self, CompileError> {
        let engine: AnyEngine = Box::new(SessionEngine::new(runtime, variant)?);
        Ok(Self(AgentGraph::new(&Graph::read(onnx)?, features, engine)?))
    }

    pub(crate) fn open<O: Opens>(
        graph: &Graph,
        features: usize,
        opener: &O,
    ) -> Result<Self, CompileError>
    where
        O::Engine: Engine<Number = f32>,
    {
        graph.agent_roles()?;
        let engine: AnyEngine = Box::new(opener.open(graph)?);
        Ok(Self(AgentGraph::new(graph, features, engine)?))
    }

    /// Utilities and next state; what is no finite number is refused, as by plans.
    fn step(
        &mut self,
        seen: &Observation<'_>,
        memory: &[f32],
    ) -> Result<[Vec<f32>; 2], DecideError> {
        self.0.columns.check_finite(seen)?;
        let found = self.0.run(seen, Rows::Visible, memory)?;
        found.iter().try_for_each(|numbers| check_finite(numbers))?;
        Ok(found)
    }
}

impl Policy for GraphPolicy {
    fn actions(&self) -> usize {
        self.0.actions
    }

    fn utilities(&mut self, seen: &Observation<'_>, to: &mut [f32]) -> Result<(), DecideError> {
        self.utilities_with(seen, &mut [], to)
    }

    fn decide(&mut self, seen: &Observation<'_>) -> Result<Decision, DecideError> {
        self.decide_with(seen, &mut [])
    }

    fn hidden(&self) -> usize {
        self.0.memory()
    }

    fn utilities_with(
        &mut self,
        seen: &Observation<'_>,
        hidden: &mut [f32],
        to: &mut [f32],
    ) -> Result<(), DecideError> {
        let [utilities, state] = self.step(seen, hidden)?;
        if utilities.len() != to.len() {
            return Err(DecideError::BadLength);
        }
        to.copy_from_slice(&utilities);
        hidden.copy_from_slice(&state);
        Ok(())
    }

    fn decide_with(
        &mut self,
        seen: &Observation<'_>,
        hidden: &mut [f32],
    ) -> Result<Decision, DecideError> {
        let [utilities, state] = self.step(seen, hidden)?;
        hidden.copy_from_slice(&state);
        masked_argmax(&utilities, seen.available)
    }
}
