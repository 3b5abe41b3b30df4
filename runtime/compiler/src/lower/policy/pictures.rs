//! Pictures as steps on patches leave them, whatever order the graph has.

use sortie_core::internal::ops::Place;
use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::binary::TypedBinOp;
use tract_onnx::tract_core::ops::cast::Cast;
use tract_onnx::tract_core::ops::element_wise::ElementWiseOp;
use tract_onnx::tract_core::ops::logic::Iff;

use super::{Dimension, Lowered, Lowering};
use crate::matching::Matrix;

/// Pictures of the graph, channel behind channel, that stand point behind point, the channels of a point side by side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Picture {
    pub(super) place: Place,
    /// Pictures behind each other.
    pub(super) count: usize,
    /// Points of a picture.
    pub(super) points: usize,
    pub(super) channels: usize,
}

impl Picture {
    /// A matrix on one picture whose rows stand as its numbers do; given, they stand as in the graph.
    pub(super) fn ordered(&self, matrix: &Matrix) -> Matrix {
        let Matrix { inputs, outputs, values } = matrix;
        let from = |input: usize| input % self.channels * self.points + input / self.channels;
        let rows = (0..*inputs).map(|input| &values[from(input) * outputs..][..*outputs]);
        Matrix { inputs: *inputs, outputs: *outputs, values: rows.flatten().copied().collect() }
    }

    /// Whether the numbers of both stand in the same order.
    pub(super) fn is_like(&self, other: &Self) -> bool {
        let sizes = |picture: &Self| [picture.count, picture.points, picture.channels];
        sizes(self) == sizes(other)
    }

    /// The steps between neighbours along every axis of a shape whose axes are the picture's; none where axes join others.
    pub(super) fn strides(&self, shape: &[usize]) -> Option<Vec<usize>> {
        let whole = [self.count, self.channels, self.points];
        let mut strides = vec![0; shape.len()];
        let mut axes = shape.iter().zip(&mut strides).peekable();
        for (size, step) in whole.iter().zip([self.channels * self.points, 1, self.channels]) {
            // The axes of this size, from the slowest to the fastest.
            let (mut rest, mut own) = (*size, Vec::new());
            while let Some((size, stride)) =
                axes.next_if(|(size, _)| rest % **size == 0 && (rest > 1 || **size == 1))
            {
                rest /= size;
                own.push((*size, stride));
            }
            if rest != 1 {
                return None;
            }
            let mut step = step;
            for (size, stride) in own.into_iter().rev() {
                *stride = step;
                step *= size;
            }
        }
        axes.next().is_none().then_some(strides)
    }
}

impl Lowering<'_> {
    /// A picture in the order of the graph.
    pub(super) fn channels_first(&mut self, node: &TypedNode, picture: Picture) -> Lowered<Place> {
        let Picture { place, count, points, channels } = picture;
        if points == 1 || channels == 1 {
            return Ok(place);
        }
        let to = self.arena.place(place.len as usize);
        let of = |size, from, to| Dimension { size, from, to };
        let each = channels * points;
        let dimensions = [of(count, each, each), of(channels, 1, points), of(points, channels, 1)];
        self.arrange(node, place, to, &dimensions)?;
        Ok(to)
    }

    /// The picture in whose order a function of every number works: an input's. What else goes in is brought into it.
    pub(super) fn as_picture(&self, node: &TypedNode) -> Option<Picture> {
        let op = &node.op;
        let is_of_numbers =
            op.is::<ElementWiseOp>() || op.is::<TypedBinOp>() || op.is::<Iff>() || op.is::<Cast>();
        let shape = self.shape(node, 0).ok()?;
        let numbers: usize = shape.iter().product();
        let is_whole =
            |picture: &Picture| picture.count * picture.points * picture.channels == numbers;
        let mut pictures = node.inputs.iter().filter_map(|outlet| self.values.picture(*outlet));
        let first = pictures.find(is_whole).filter(|first| first.strides(&shape).is_some())?;
        is_of_numbers.then_some(first)
    }
}
