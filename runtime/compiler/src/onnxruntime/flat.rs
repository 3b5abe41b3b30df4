//! A policy whoever exported it, run by onnxruntime.

use ort::session::{Session, SessionInputValue};
use ort::value::{DynValue, Tensor};
use prost::Message;
use sortie_plans::{CompileError, FlatPolicy, PolicyAnswer, PolicyFacts, PolicyInput, ValueType};

use super::bound_flat::BoundPolicy;
use super::{OnnxRuntime, refused};
use crate::flat::{FlatGraph, Interface, other_values};

/// A policy that runs the needed part of its file with onnxruntime.
#[derive(Debug)]
pub(crate) struct OnnxRuntimeFlatPolicy {
    session: Session,
    interface: Interface,
    /// The tensors of [`FlatPolicy::step`], made by its first.
    bound: Option<BoundPolicy>,
}

impl OnnxRuntimeFlatPolicy {
    pub(crate) fn from_graph(
        runtime: &OnnxRuntime,
        graph: FlatGraph,
    ) -> Result<Self, CompileError> {
        let session = runtime.session(&graph.file.encode_to_vec())?;
        Ok(Self { session, interface: graph.interface, bound: None })
    }
}

impl FlatPolicy for OnnxRuntimeFlatPolicy {
    fn facts(&self) -> &PolicyFacts {
        &self.interface.facts
    }

    fn run(
        &mut self,
        inputs: &[&[f32]],
        states: &mut [f32],
    ) -> Result<Vec<PolicyAnswer>, CompileError> {
        let Self { session, interface, .. } = self;
        let arranged = interface.arranged(inputs, states)?;
        let named = |(input, numbers): (&PolicyInput, &[f32])| -> ort::Result<_> {
            Ok((input.name.clone(), SessionInputValue::from(tensor(input, numbers)?)))
        };
        let inputs = arranged.into_iter().map(named).collect::<ort::Result<Vec<_>>>();
        let outputs = session.run(inputs.map_err(refused)?).map_err(refused)?;
        let mut given = Vec::new();
        for name in &interface.outputs {
            let reason = || format!("onnxruntime gave no numbers for `{name}`");
            let numbers = outputs.get(name).and_then(numbers);
            given.push(numbers.ok_or_else(|| CompileError::Run { reason: reason() })?);
        }
        interface.answers(&given, states)
    }

    fn step(&mut self, inputs: &[&[f32]]) -> Result<(), CompileError> {
        let Self { session, interface, bound } = self;
        if bound.is_none() {
            *bound = Some(BoundPolicy::new(session, interface).map_err(refused)?);
        }
        let bound = bound.as_mut().ok_or_else(other_values)?;
        bound.step(session, inputs)
    }
}

fn tensor(input: &PolicyInput, numbers: &[f32]) -> ort::Result<DynValue> {
    let shape = input.shape.clone();
    let numbers = numbers.iter().copied();
    Ok(match input.kind {
        ValueType::F32 => Tensor::from_array((shape, numbers.collect::<Vec<f32>>()))?.into_dyn(),
        ValueType::F64 => {
            Tensor::from_array((shape, numbers.map(f64::from).collect::<Vec<_>>()))?.into_dyn()
        }
        ValueType::I64 => {
            Tensor::from_array((shape, numbers.map(|n| n as i64).collect::<Vec<_>>()))?.into_dyn()
        }
        ValueType::I32 => {
            Tensor::from_array((shape, numbers.map(|n| n as i32).collect::<Vec<_>>()))?.into_dyn()
        }
        ValueType::U8 => {
            Tensor::from_array((shape, numbers.map(|n| n as u8).collect::<Vec<_>>()))?.into_dyn()
        }
        ValueType::Bool => {
            Tensor::from_array((shape, numbers.map(|n| n != 0.0).collect::<Vec<_>>()))?.into_dyn()
        }
    })
}

/// The numbers of an output, whatever their type.
fn numbers(value: &DynValue) -> Option<Vec<f32>> {
    let f32s = || value.try_extract_tensor::<f32>().ok().map(|(_, n)| n.to_vec());
    let f64s = || {
        value.try_extract_tensor::<f64>().ok().map(|(_, n)| n.iter().map(|n| *n as f32).collect())
    };
    let i64s = || {
        value.try_extract_tensor::<i64>().ok().map(|(_, n)| n.iter().map(|n| *n as f32).collect())
    };
    let i32s = || {
        value.try_extract_tensor::<i32>().ok().map(|(_, n)| n.iter().map(|n| *n as f32).collect())
    };
    let u8s = || {
        value
            .try_extract_tensor::<u8>()
            .ok()
            .map(|(_, n)| n.iter().map(|n| f32::from(*n)).collect())
    };
    let bools = || {
        value
            .try_extract_tensor::<bool>()
            .ok()
            .map(|(_, n)| n.iter().map(|n| f32::from(u8::from(*n))).collect())
    };
    f32s().or_else(f64s).or_else(i64s).or_else(i32s).or_else(u8s).or_else(bools)
}
