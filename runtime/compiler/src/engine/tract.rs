//! tract on the simplified graph: the back-end of hosts, beside which plans are shown. It allocates, and promises nothing
//! about bits or time.

use sortie_plans::CompileError;
use tract_onnx::prelude::*;

use super::{Engine, Named, missing};
use crate::graph::guarded;

/// tract with a graph.
#[derive(Debug)]
pub(crate) struct TractEngine {
    state: TypedSimpleState,
    inputs: Vec<(String, DatumType)>,
}

impl TractEngine {
    /// All outputs of a simplified graph.
    pub(crate) fn new(model: &TypedModel) -> Result<Self, CompileError> {
        let open = || {
            let input = |outlet: &OutletId| {
                let name = model.node(outlet.node).name.clone();
                Ok((name, model.outlet_fact(*outlet)?.datum_type))
            };
            let inputs = model.inputs.iter().map(input).collect::<TractResult<_>>()?;
            let state = model.clone().into_optimized()?.into_runnable()?.spawn()?;
            Ok(Self { state, inputs })
        };
        guarded(open).map_err(|reason| CompileError::Run { reason })
    }
}

impl TractEngine {
    /// The same with other names of its inputs, in the graph's order.
    pub(crate) fn with_inputs(mut self, names: impl IntoIterator<Item = String>) -> Self {
        for ((own, _), name) in self.inputs.iter_mut().zip(names) {
            *own = name;
        }
        self
    }
}

impl Engine for TractEngine {
    type Number = f32;

    fn run(&mut self, given: &[Named<'_, f32>]) -> Result<Vec<Vec<f32>>, CompileError> {
        let Self { state, inputs } = self;
        let mut found = Vec::new();
        for (name, kind) in inputs.iter() {
            let named = given.iter().find(|named| named.name == name);
            found.push((*kind, named.ok_or_else(|| missing(name))?));
        }
        let run = || {
            let tensor = |(kind, named): (DatumType, &Named<'_, f32>)| {
                let numbers = Tensor::from_shape(named.shape, named.numbers)?;
                Ok(numbers.cast_to_dt(kind)?.into_owned().into_tvalue())
            };
            let inputs = found.into_iter().map(tensor).collect::<TractResult<TVec<_>>>()?;
            let numbers = |output: &TValue| -> TractResult<Vec<f32>> {
                let output = output.cast_to::<f32>()?;
                Ok(output.to_plain_array_view::<f32>()?.iter().copied().collect())
            };
            state.run(inputs)?.iter().map(numbers).collect()
        };
        guarded(run).map_err(|reason| CompileError::Run { reason })
    }
}
