//! Engines: whatever runs a file takes tensors by their names, and gives the numbers of its outputs.
//!
//! There are three: tract, on the simplified graph; onnxruntime, on the file; and the reference evaluator, on the file's
//! nodes in double precision. What a network's tensors mean is the business of [`crate::networks`].

pub(crate) mod reference;
pub(crate) mod tract;

use std::fmt::Debug;

use sortie_plans::{CompileError, PolicyInput};

/// What an engine counts in: f32, or f64 where the truth is asked for.
pub(crate) trait Number: Copy + Debug + Default + From<f32> + Into<f64> + 'static {}

impl Number for f32 {}
impl Number for f64 {}

/// A tensor for an input of a file. Its numbers become the type that the file gives the input: masks are 0 and 1, and
/// whole numbers are exact as far as 2^24.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Named<'a, N> {
    pub(crate) name: &'a str,
    pub(crate) shape: &'a [usize],
    pub(crate) numbers: &'a [N],
}

impl<'a, N> From<(&'a PolicyInput, &'a [N])> for Named<'a, N> {
    fn from((input, numbers): (&'a PolicyInput, &'a [N])) -> Self {
        Self { name: &input.name, shape: &input.shape, numbers }
    }
}

/// What runs a file.
pub(crate) trait Engine: Debug + Send {
    /// What it counts in.
    type Number: Number;

    /// The numbers of all outputs that it was opened for, in their order, whatever numbers these are.
    fn run(
        &mut self,
        inputs: &[Named<'_, Self::Number>],
    ) -> Result<Vec<Vec<Self::Number>>, CompileError>;
}

/// An engine that is chosen at run time.
pub(crate) type AnyEngine = Box<dyn Engine<Number = f32>>;

impl<E: Engine + ?Sized> Engine for Box<E> {
    type Number = E::Number;

    fn run(
        &mut self,
        inputs: &[Named<'_, E::Number>],
    ) -> Result<Vec<Vec<E::Number>>, CompileError> {
        (**self).run(inputs)
    }
}

/// The tensors of a file's inputs, filled anew for every question.
#[derive(Clone, Debug)]
pub(crate) struct Tensors<N>(Vec<Tensor<N>>);

#[derive(Clone, Debug)]
struct Tensor<N> {
    name: String,
    shape: Vec<usize>,
    numbers: Vec<N>,
}

impl<N: Number> Tensors<N> {
    /// A tensor for each name.
    pub(crate) fn new(names: impl IntoIterator<Item = impl Into<String>>) -> Self {
        let empty = |name: String| Tensor { name, shape: Vec::new(), numbers: Vec::new() };
        Self(names.into_iter().map(|name| empty(name.into())).collect())
    }

    /// Fills the tensor at a place.
    pub(crate) fn fill(
        &mut self,
        place: usize,
        shape: &[usize],
        numbers: impl IntoIterator<Item = f32>,
    ) {
        let Some(tensor) = self.room(place, shape) else { return };
        tensor.extend(numbers.into_iter().map(N::from));
    }

    /// Fills the tensor at a place with an engine's own numbers.
    pub(crate) fn copy(&mut self, place: usize, shape: &[usize], numbers: &[N]) {
        if let Some(tensor) = self.room(place, shape) {
            tensor.extend_from_slice(numbers);
        }
    }

    /// The room for the numbers of the tensor at a place, which it becomes empty for.
    pub(crate) fn room(&mut self, place: usize, shape: &[usize]) -> Option<&mut Vec<N>> {
        let tensor = self.0.get_mut(place)?;
        tensor.shape.clear();
        tensor.shape.extend_from_slice(shape);
        tensor.numbers.clear();
        Some(&mut tensor.numbers)
    }

    /// All of them, as engines take them.
    pub(crate) fn named(&self) -> Vec<Named<'_, N>> {
        self.0.iter().map(Tensor::named).collect()
    }
}

impl<N> Tensor<N> {
    fn named(&self) -> Named<'_, N> {
        let Self { name, shape, numbers } = self;
        Named { name, shape, numbers }
    }
}

/// What a mask holds for what it shows, and for what it does not.
pub(crate) fn flag(is_set: bool) -> f32 {
    f32::from(u8::from(is_set))
}

/// An engine was not given what its file takes.
pub(crate) fn missing(name: &str) -> CompileError {
    CompileError::Run { reason: format!("nothing is given for its input `{name}`") }
}
