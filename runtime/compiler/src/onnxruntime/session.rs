//! A session of onnxruntime as an engine.

use std::collections::HashMap;

use ort::io_binding::IoBinding;
use ort::memory::Allocator;
use ort::session::Session;
use ort::tensor::TensorElementType;
use ort::value::{DynValue, Tensor, ValueType};
use sortie_plans::CompileError;

use super::{OnnxRuntime, refused};
use crate::engine::{Engine, Named, missing};

/// A file that onnxruntime runs. Inputs and outputs are bound once for every shape, so that a call writes, runs and reads.
#[derive(Debug)]
pub(crate) struct SessionEngine {
    session: Session,
    outputs: Vec<String>,
    /// What is bound, by the shapes of all inputs one behind the other.
    bound: HashMap<Vec<usize>, Bound>,
    shapes: Vec<usize>,
}

/// The tensors of some shapes, and the binding that refers to them.
#[derive(Debug)]
struct Bound {
    binding: IoBinding,
    inputs: Vec<TypedTensor>,
    /// Whether the outputs have tensors of their own: once a run has shown their shapes.
    has_outputs: bool,
}

impl SessionEngine {
    /// All outputs of a file.
    pub(crate) fn new(runtime: &OnnxRuntime, onnx: &[u8]) -> Result<Self, CompileError> {
        let session = runtime.session(onnx)?;
        let outputs = session.outputs.iter().map(|output| output.name.clone()).collect();
        Ok(Self { session, outputs, bound: HashMap::new(), shapes: Vec::new() })
    }

    fn run_bound(&mut self, given: &[&Named<'_, f32>]) -> ort::Result<Vec<Vec<f32>>> {
        let Self { session, outputs, bound, shapes } = self;
        if !bound.contains_key(shapes.as_slice()) {
            bound.insert(shapes.clone(), Bound::new(session, given, outputs)?);
        }
        let unknown = || ort::Error::new("nothing is bound for these shapes");
        let bound = bound.get_mut(shapes.as_slice()).ok_or_else(unknown)?;
        for (tensor, named) in bound.inputs.iter_mut().zip(given) {
            tensor.write(named.numbers);
        }
        let found = session.run_binding(&bound.binding)?;
        let output = |name: &String| {
            let value = found.get(name).ok_or_else(|| ort::Error::new("an output is missing"))?;
            Ok((numbers(value)?, kind(value.dtype())?))
        };
        let given = outputs.iter().map(output).collect::<ort::Result<Vec<_>>>()?;
        drop(found);
        let (given, kinds): (Vec<_>, Vec<_>) = given.into_iter().unzip();
        if !bound.has_outputs {
            bound.bind_outputs(session, outputs, kinds)?;
        }
        Ok(given)
    }
}

impl Engine for SessionEngine {
    type Number = f32;

    fn run(&mut self, given: &[Named<'_, f32>]) -> Result<Vec<Vec<f32>>, CompileError> {
        let mut found = Vec::with_capacity(given.len());
        self.shapes.clear();
        for input in &self.session.inputs {
            let named = given.iter().find(|named| named.name == input.name);
            let named = named.ok_or_else(|| missing(&input.name))?;
            self.shapes.extend_from_slice(named.shape);
            found.push(named);
        }
        self.run_bound(&found).map_err(refused)
    }
}

impl Bound {
    /// The session's own allocator makes all tensors: outputs can be bound only if it did.
    fn new(session: &Session, given: &[&Named<'_, f32>], outputs: &[String]) -> ort::Result<Self> {
        let allocator = session.allocator();
        let mut binding = session.create_binding()?;
        let mut inputs = Vec::new();
        for (input, named) in session.inputs.iter().zip(given) {
            let (kind, _) = kind(&input.input_type)?;
            let tensor = TypedTensor::new(allocator, kind, named.shape)?;
            tensor.bind_input(&mut binding, &input.name)?;
            inputs.push(tensor);
        }
        for name in outputs {
            binding.bind_output_to_device(name, &allocator.memory_info())?;
        }
        Ok(Self { binding, inputs, has_outputs: false })
    }

    fn bind_outputs(
        &mut self,
        session: &Session,
        outputs: &[String],
        kinds: Vec<(TensorElementType, Vec<usize>)>,
    ) -> ort::Result<()> {
        self.binding.clear_outputs();
        for (name, (kind, shape)) in outputs.iter().zip(kinds) {
            let tensor = TypedTensor::new(session.allocator(), kind, &shape)?;
            tensor.bind_output(&mut self.binding, name)?;
        }
        self.has_outputs = true;
        Ok(())
    }
}

/// A tensor's type and sizes.
fn kind(value: &ValueType) -> ort::Result<(TensorElementType, Vec<usize>)> {
    match value {
        ValueType::Tensor { ty, shape, .. } => {
            Ok((*ty, shape.iter().map(|size| usize::try_from(*size).unwrap_or(0)).collect()))
        }
        _ => Err(ort::Error::new("a value is no tensor")),
    }
}

/// A tensor of one of the types that networks take, for which `$work` is the same.
macro_rules! of_each_type {
    ($tensor:expr, $inner:ident => $work:expr) => {
        match $tensor {
            TypedTensor::F32($inner) => $work,
            TypedTensor::F64($inner) => $work,
            TypedTensor::I64($inner) => $work,
            TypedTensor::I32($inner) => $work,
            TypedTensor::U8($inner) => $work,
            TypedTensor::Bool($inner) => $work,
        }
    };
}

#[derive(Debug)]
enum TypedTensor {
    F32(Tensor<f32>),
    F64(Tensor<f64>),
    I64(Tensor<i64>),
    I32(Tensor<i32>),
    U8(Tensor<u8>),
    Bool(Tensor<bool>),
}

impl TypedTensor {
    fn new(allocator: &Allocator, kind: TensorElementType, shape: &[usize]) -> ort::Result<Self> {
        let shape = shape.to_vec();
        Ok(match kind {
            TensorElementType::Float32 => Self::F32(Tensor::new(allocator, shape)?),
            TensorElementType::Float64 => Self::F64(Tensor::new(allocator, shape)?),
            TensorElementType::Int64 => Self::I64(Tensor::new(allocator, shape)?),
            TensorElementType::Int32 => Self::I32(Tensor::new(allocator, shape)?),
            TensorElementType::Uint8 => Self::U8(Tensor::new(allocator, shape)?),
            TensorElementType::Bool => Self::Bool(Tensor::new(allocator, shape)?),
            other => {
                let message = format!("no network has values of type {other}");
                return Err(ort::Error::new(message));
            }
        })
    }

    fn bind_input(&self, binding: &mut IoBinding, name: &str) -> ort::Result<()> {
        of_each_type!(self, tensor => binding.bind_input(name, tensor))
    }

    fn bind_output(self, binding: &mut IoBinding, name: &str) -> ort::Result<()> {
        of_each_type!(self, tensor => binding.bind_output(name, tensor))
    }

    fn write(&mut self, numbers: &[f32]) {
        // A tensor without numbers, such as a relation of no columns, has no memory that could be borrowed.
        if numbers.is_empty() {
            return;
        }
        match self {
            Self::F32(tensor) => fill(tensor.extract_tensor_mut().1, numbers, |n| n),
            Self::F64(tensor) => fill(tensor.extract_tensor_mut().1, numbers, f64::from),
            Self::I64(tensor) => fill(tensor.extract_tensor_mut().1, numbers, |n| n as i64),
            Self::I32(tensor) => fill(tensor.extract_tensor_mut().1, numbers, |n| n as i32),
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

/// The numbers of an output, whatever their type.
fn numbers(value: &DynValue) -> ort::Result<Vec<f32>> {
    /// The numbers of a tensor of one type.
    macro_rules! of {
        ($type:ty, $number:expr) => {
            value.try_extract_tensor::<$type>()?.1.iter().map($number).collect()
        };
    }
    Ok(match kind(value.dtype())?.0 {
        TensorElementType::Float64 => of!(f64, |n| *n as f32),
        TensorElementType::Int64 => of!(i64, |n| *n as f32),
        TensorElementType::Int32 => of!(i32, |n| *n as f32),
        TensorElementType::Uint8 => of!(u8, |n| f32::from(*n)),
        TensorElementType::Bool => of!(bool, |n| crate::engine::flag(*n)),
        _ => value.try_extract_tensor::<f32>()?.1.to_vec(),
    })
}
