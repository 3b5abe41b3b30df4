//! Convolutions: a layer on every patch of a picture.

use sortie_core::internal::kernels::product::padded;
use sortie_core::internal::ops::{Convolve, Flag, Op};
use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::cnn::{Conv, KernelFormat};

use super::values::numbers;
use super::weights::PolicyWeights;
use super::{Lowered, Lowering};
use crate::lower::agent::at_most;
use crate::matching::{Layer, Matrix};
use sortie_plans::CompileError;

impl Lowering<'_> {
    pub(super) fn convolve(&mut self, node: &TypedNode, conv: &Conv) -> Lowered<()> {
        let value = self.operand(node, 0)?;
        let unsupported = |hint| self.unsupported(node, hint);
        if conv.group != 1 || conv.q_params.is_some() {
            return Err(unsupported("plans convolve all channels at once, in f32"));
        }
        let PolicyWeights::Tiles(_) = &self.weights else {
            return Err(CompileError::NoInt8 { what: "a convolution".into() });
        };
        let spec = &conv.pool_spec;
        let shape = spec.data_format.shape(value.shape.clone());
        let shape = shape.map_err(|_| unsupported("its picture has other sizes"))?;
        let is_one = shape.n().is_none_or(|batch| *batch == 1);
        if !is_one || spec.data_format.c_is_last() || !(1..=2).contains(&shape.hw_rank()) {
            return Err(unsupported(
                "plans convolve one picture of one or two dimensions, channels first",
            ));
        }
        let layer = self.kernel(node, conv)?;
        let mut layer = layer.ok_or_else(|| unsupported("its kernel is no constant"))?;
        let relu = self.relu_after(node);
        layer.relu = relu.is_some();
        at_most("the width of a layer", layer.matrix.inputs, usize::from(u16::MAX) / 8)?;
        let padding = spec.computed_padding(shape.hw_dims());
        // A line is a picture of one row.
        let both = |of: &dyn Fn(usize) -> usize, line: u32| match shape.hw_rank() {
            1 => [line, of(0) as u32],
            _ => [of(0) as u32, of(1) as u32],
        };
        let size = both(&|axis| shape.hw_dims()[axis], 1);
        let kernel = both(&|axis| spec.kernel_shape[axis], 1);
        let stride = both(&|axis| spec.stride(axis), 1);
        let dilation = both(&|axis| spec.dilation(axis), 1);
        let before = both(&|axis| padding[axis].pad_before, 0);
        let result = both(&|axis| padding[axis].convoluted, 1);
        let (inputs, outputs) = (layer.matrix.inputs, layer.matrix.outputs);
        let [height, width] = result.map(|size| size as usize);
        let to = self.arena.place(outputs * height * width);
        let patch = self.arena.place(inputs);
        let point = self.arena.place(padded(outputs));
        let PolicyWeights::Tiles(weights) = &mut self.weights else { return Ok(()) };
        self.ops.push(Op::Convolve(Convolve {
            layer: weights.add_layer(&layer),
            relu: Flag::from(layer.relu),
            channels: *shape.c() as u32,
            size,
            kernel,
            stride,
            dilation,
            padding: before,
            result,
            from: value.place,
            patch,
            point,
            to,
        }));
        self.give(node, 0, to)?;
        relu.map_or(Ok(()), |relu| self.give(relu, 0, to))
    }

    /// The kernel as a layer on patches, channel behind channel; none where it is no constant.
    fn kernel(&self, node: &TypedNode, conv: &Conv) -> Lowered<Option<Layer>> {
        let constant = |slot: usize| -> Lowered<Option<Vec<f32>>> {
            let tensor = self.constant(self.outlet(node, slot)?);
            Ok(tensor.and_then(|tensor| numbers(&tensor)))
        };
        let (Some(values), Some(bias)) = (constant(1)?, constant(2)?) else { return Ok(None) };
        let outputs = conv.pool_spec.output_channels;
        let channels = conv.pool_spec.input_channels;
        let area: usize = conv.pool_spec.kernel_shape.iter().product();
        let inputs = channels * area;
        if outputs == 0 || values.len() != inputs * outputs {
            return Ok(None);
        }
        let at = |output: usize, channel: usize, point: usize| match conv.kernel_fmt {
            KernelFormat::OIHW => (output * channels + channel) * area + point,
            KernelFormat::HWIO => (point * channels + channel) * outputs + output,
            KernelFormat::OHWI => (output * area + point) * channels + channel,
        };
        let weight = |input: usize, output: usize| values[at(output, input / area, input % area)];
        let values = (0..inputs).flat_map(|input| (0..outputs).map(move |output| (input, output)));
        let values = values.map(|(input, output)| weight(input, output)).collect();
        let bias = match bias.as_slice() {
            [all] => vec![*all; outputs],
            _ => bias,
        };
        if bias.len() != outputs {
            return Ok(None);
        }
        Ok(Some(Layer { matrix: Matrix { inputs, outputs, values }, bias, relu: false }))
    }
}
