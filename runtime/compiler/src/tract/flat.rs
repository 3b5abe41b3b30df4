//! A policy whoever exported it, run by tract.

use sortie_plans::{
    CompileError, FlatPolicy, OutputRole, PolicyAnswer, PolicyFacts, PolicyInput, ValueType,
};
use tract_onnx::prelude::*;

use crate::flat::{FlatGraph, Interface, other_values};
use crate::graph::guarded;

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
