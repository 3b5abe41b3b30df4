//! The reference evaluator as an engine: a network's file once exactly, and eight times with the noise of f32.

use sortie_plans::CompileError;
use tract_onnx::pb::tensor_proto::DataType;
use tract_onnx::pb::{ModelProto, ValueInfoProto, type_proto};
use tract_onnx::prelude::TractError;

use super::{Engine, Named};
use crate::graph::guarded;
use crate::reference::{Noise, Reference, Tensor};

/// A file in double precision.
#[derive(Debug)]
pub(crate) struct ReferenceEngine {
    reference: Reference,
    inputs: Vec<(String, DataType)>,
    outputs: Vec<String>,
    noise: Option<Noise>,
}

impl ReferenceEngine {
    /// Some outputs of a file.
    pub(crate) fn new(file: &ModelProto, outputs: Vec<String>) -> Result<Self, CompileError> {
        let read = || Reference::new(file).map_err(TractError::msg);
        let reference = guarded(read).map_err(|reason| CompileError::Run { reason })?;
        let graph = file.graph.as_ref();
        let is_stored = |name: &str| {
            graph.is_some_and(|graph| graph.initializer.iter().any(|stored| stored.name == name))
        };
        let declared = graph.into_iter().flat_map(|graph| &graph.input);
        let declared = declared.filter(|input| !is_stored(&input.name));
        let inputs = declared.map(|input| (input.name.clone(), kind(input))).collect();
        Ok(Self { reference, inputs, outputs, noise: None })
    }

    /// Says what comes next: run 0 of an input is exact, every later one has noise of its own, drawn by the seed.
    pub(crate) fn begin(&mut self, run: usize, seed: u64) {
        let drawn = seed ^ run as u64;
        match (run, &mut self.noise) {
            (0, noise) => *noise = None,
            (_, Some(noise)) => noise.again(drawn),
            (_, noise) => *noise = Some(Noise::new(drawn)),
        }
    }
}

impl Engine for ReferenceEngine {
    type Number = f64;

    fn run(&mut self, given: &[Named<'_, f64>]) -> Result<Vec<Vec<f64>>, CompileError> {
        let Self { reference, inputs, outputs, noise } = self;
        let mut tensors = Vec::new();
        for (name, kind) in inputs.iter() {
            let named = given.iter().find(|named| named.name == name);
            // What nothing that is asked for needs, nobody gives.
            tensors.extend(named.map(|named| (name.clone(), tensor(*kind, named))));
        }
        let run = || {
            let found = reference.run(tensors, outputs, noise.as_mut()).map_err(TractError::msg)?;
            Ok(found.iter().map(Tensor::to_reals).collect())
        };
        guarded(run).map_err(|reason| CompileError::Run { reason })
    }
}

/// The type that a file gives an input.
fn kind(input: &ValueInfoProto) -> DataType {
    let kind = input.r#type.as_ref().and_then(|kind| kind.value.as_ref());
    let Some(type_proto::Value::TensorType(tensor)) = kind else { return DataType::Float };
    DataType::try_from(tensor.elem_type).unwrap_or(DataType::Float)
}

fn tensor(kind: DataType, named: &Named<'_, f64>) -> Tensor {
    let (shape, numbers) = (named.shape.to_vec(), named.numbers);
    match kind {
        DataType::Bool => Tensor::truth(shape, numbers.iter().map(|x| *x != 0.0).collect()),
        DataType::Float | DataType::Double | DataType::Float16 | DataType::Bfloat16 => {
            Tensor::real(shape, numbers.to_vec())
        }
        _ => Tensor::whole(shape, numbers.iter().map(|x| *x as i64).collect()),
    }
}
