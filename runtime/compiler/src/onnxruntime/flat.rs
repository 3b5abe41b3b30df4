//! A policy whoever exported it, run by onnxruntime.

use ort::io_binding::IoBinding;
use ort::memory::Allocator;
use ort::session::{Session, SessionInputValue};
use ort::value::{DynValue, Tensor};
use prost::Message;
use sortie_plans::{
    CompileError, FlatPolicy, InputRole, OutputRole, PolicyAnswer, PolicyFacts, PolicyInput,
    ValueType,
};

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

/// The tensors of a policy, and the binding that refers to them.
#[derive(Debug)]
struct BoundPolicy {
    binding: IoBinding,
    inputs: Vec<BoundInput>,
    /// Places of states among the inputs, and the names that they come back by.
    states: Vec<(usize, String)>,
}

/// An input's tensor, and whether the caller gives it at every step.
#[derive(Debug)]
struct BoundInput {
    tensor: TypedTensor,
    is_given: bool,
}

#[derive(Debug)]
enum TypedTensor {
    F32(Tensor<f32>),
    I64(Tensor<i64>),
    U8(Tensor<u8>),
    Bool(Tensor<bool>),
}

impl BoundPolicy {
    /// The session's own allocator makes all tensors: outputs can be bound only if it did.
    fn new(session: &Session, interface: &Interface) -> ort::Result<Self> {
        let allocator = session.allocator();
        let mut binding = session.create_binding()?;
        let mut inputs = Vec::new();
        for input in &interface.facts.inputs {
            let tensor = TypedTensor::new(allocator, input.kind, &input.shape)?;
            tensor.bind_input(&mut binding, &input.name)?;
            inputs.push(BoundInput { tensor, is_given: input.role != InputRole::State });
        }
        let outputs = interface.facts.outputs.iter().filter(|o| o.role == OutputRole::State);
        let is_state = |(_, input): &(usize, &BoundInput)| !input.is_given;
        let places = inputs.iter().enumerate().filter(is_state).map(|(place, _)| place);
        let states = places.zip(outputs.map(|output| output.name.clone())).collect();
        for output in &interface.facts.outputs {
            let tensor = TypedTensor::new(allocator, output.kind, &output.shape)?;
            tensor.bind_output(&mut binding, &output.name)?;
        }
        // Scores beside the facts' outputs are of no use here, but a bound session gives all that it has.
        for name in interface.outputs.iter().skip(interface.facts.outputs.len()) {
            binding.bind_output_to_device(name, &allocator.memory_info())?;
        }
        Ok(Self { binding, inputs, states })
    }

    /// One decision; its states are those of the next.
    fn step(&mut self, session: &mut Session, inputs: &[&[f32]]) -> Result<(), CompileError> {
        let bound = self.inputs.iter_mut().filter(|input| input.is_given);
        for (bound, numbers) in bound.zip(inputs) {
            bound.tensor.write(numbers);
        }
        let outputs = session.run_binding(&self.binding).map_err(refused)?;
        for (place, name) in &self.states {
            let next = outputs.get(name).and_then(|next| next.try_extract_tensor::<f32>().ok());
            let to = self.inputs.get_mut(*place);
            let (to, (_, next)) = to.zip(next).ok_or_else(other_values)?;
            to.tensor.write(next);
        }
        Ok(())
    }
}

impl TypedTensor {
    fn new(allocator: &Allocator, kind: ValueType, shape: &[usize]) -> ort::Result<Self> {
        let shape = shape.to_vec();
        Ok(match kind {
            ValueType::F32 => Self::F32(Tensor::new(allocator, shape)?),
            ValueType::I64 => Self::I64(Tensor::new(allocator, shape)?),
            ValueType::U8 => Self::U8(Tensor::new(allocator, shape)?),
            ValueType::Bool => Self::Bool(Tensor::new(allocator, shape)?),
            ValueType::F64 | ValueType::I32 => {
                let message = format!("no policy with values of {} is timed", kind.name());
                return Err(ort::Error::new(message));
            }
        })
    }

    fn bind_input(&self, binding: &mut IoBinding, name: &str) -> ort::Result<()> {
        match self {
            Self::F32(tensor) => binding.bind_input(name, tensor),
            Self::I64(tensor) => binding.bind_input(name, tensor),
            Self::U8(tensor) => binding.bind_input(name, tensor),
            Self::Bool(tensor) => binding.bind_input(name, tensor),
        }
    }

    fn bind_output(self, binding: &mut IoBinding, name: &str) -> ort::Result<()> {
        match self {
            Self::F32(tensor) => binding.bind_output(name, tensor),
            Self::I64(tensor) => binding.bind_output(name, tensor),
            Self::U8(tensor) => binding.bind_output(name, tensor),
            Self::Bool(tensor) => binding.bind_output(name, tensor),
        }
    }

    fn write(&mut self, numbers: &[f32]) {
        match self {
            Self::F32(tensor) => fill(tensor.extract_tensor_mut().1, numbers, |n| n),
            Self::I64(tensor) => fill(tensor.extract_tensor_mut().1, numbers, |n| n as i64),
            Self::U8(tensor) => fill(tensor.extract_tensor_mut().1, numbers, |n| n as u8),
            Self::Bool(tensor) => fill(tensor.extract_tensor_mut().1, numbers, |n| n != 0.0),
        }
    }
}

fn fill<T>(tensor: &mut [T], numbers: &[f32], typed: impl Fn(f32) -> T) {
    for (to, number) in tensor.iter_mut().zip(numbers) {
        *to = typed(*number);
    }
}
