//! Convolutions: a layer on every patch of a picture.

use sortie_core::internal::kernels::product::padded;
use sortie_core::internal::ops::{
    Combination, Convolve, Flag, Function, Linear, Op, Place, Reduction,
};
use sortie_plans::CompileError;
use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::cnn::{Conv, KernelFormat, MaxPool, PoolSpec, SumPool};
use tract_onnx::tract_core::ops::nn::DataFormat;

use super::arrange::Dimension;
use super::values::{PolicyWeights, Value, numbers};
use super::{Lowered, Lowering, WIDEST};
use crate::lower::agent::at_most;
use crate::matching::{Layer, Matrix};

/// The patches of a picture, along both of its directions.
struct Patches {
    pictures: usize,
    channels: usize,
    size: [usize; 2],
    kernel: [usize; 2],
    stride: [usize; 2],
    dilation: [usize; 2],
    /// Points outside of the picture, above it and on its left.
    before: [usize; 2],
    result: [usize; 2],
}

impl Lowering<'_> {
    pub(super) fn convolve(&mut self, node: &TypedNode, conv: &Conv) -> Lowered<()> {
        let value = self.operand(node, 0)?;
        let value = self.channels_first(node, &conv.pool_spec, value)?;
        let unsupported = |hint| self.unsupported(node, hint);
        if conv.q_params.is_some() {
            return Err(unsupported("plans convolve in f32"));
        }
        let PolicyWeights::Tiles(_) = &self.weights else {
            return Err(CompileError::NoInt8 { what: "a convolution".into() });
        };
        let patches = self.patches(node, &conv.pool_spec, &value)?;
        let groups = self.kernels(node, conv)?;
        let groups = groups.ok_or_else(|| unsupported("its kernel is no constant"))?;
        let relu = self.relu_after(node);
        let channels = patches.channels / groups.len();
        let (outputs, inputs) = (conv.pool_spec.output_channels, channels * area(patches.kernel));
        at_most("the width of a layer", inputs, WIDEST)?;
        let to = self.arena.place(patches.pictures * outputs * area(patches.result));
        let patch = self.arena.place(inputs);
        let point = self.arena.place(padded(outputs / groups.len()));
        let PolicyWeights::Tiles(weights) = &mut self.weights else { return Ok(()) };
        let layers: Vec<Linear> = groups.iter().map(|layer| weights.add_layer(layer)).collect();
        // Pictures, and groups of their channels, stand behind each other and know nothing of each other.
        let count = patches.pictures * layers.len();
        let parts = [value.place, to].map(|place| place.len / count.max(1) as u32);
        for (index, layer) in (0..count as u32).zip(layers.iter().cycle()) {
            let part = |place: Place, len: u32| Place { offset: place.offset + index * len, len };
            let whole = |sizes: [usize; 2]| sizes.map(|size| size as u32);
            self.ops.push(Op::Convolve(Convolve {
                layer: *layer,
                relu: Flag::from(relu.is_some()),
                channels: channels as u32,
                size: whole(patches.size),
                kernel: whole(patches.kernel),
                stride: whole(patches.stride),
                dilation: whole(patches.dilation),
                padding: whole(patches.before),
                result: whole(patches.result),
                from: part(value.place, parts[0]),
                patch,
                point,
                to: part(to, parts[1]),
            }));
        }
        let to = self.as_picture(node, &conv.pool_spec, &patches, outputs, to)?;
        self.give(node, 0, to)?;
        relu.map_or(Ok(()), |relu| self.give(relu, 0, to))
    }

    /// A picture with its channels before its points, as steps take it.
    fn channels_first(
        &mut self,
        node: &TypedNode,
        spec: &PoolSpec,
        value: Value,
    ) -> Lowered<Value> {
        let axes = value.shape.len();
        let first = usize::from(spec.data_format.has_n());
        if !spec.data_format.c_is_last() || axes <= first {
            return Ok(value);
        }
        let order: Vec<usize> = (0..first).chain([axes - 1]).chain(first..axes - 1).collect();
        let place = self.permuted(node, &value, &order)?;
        Ok(Value { place, shape: order.into_iter().map(|axis| value.shape[axis]).collect() })
    }

    /// A result with its channels where the graph has them.
    fn as_picture(
        &mut self,
        node: &TypedNode,
        spec: &PoolSpec,
        patches: &Patches,
        channels: usize,
        place: Place,
    ) -> Lowered<Place> {
        if !spec.data_format.c_is_last() {
            return Ok(place);
        }
        let [height, width] = patches.result;
        let value = Value { place, shape: vec![patches.pictures, channels, height, width] };
        self.permuted(node, &value, &[0, 2, 3, 1])
    }

    /// The patches that a convolution or a pool works on; the picture has its channels first.
    fn patches(&self, node: &TypedNode, spec: &PoolSpec, value: &Value) -> Lowered<Patches> {
        let format = match spec.data_format {
            DataFormat::NHWC => DataFormat::NCHW,
            DataFormat::HWC => DataFormat::CHW,
            first => first,
        };
        let shape = format.shape(value.shape.clone());
        let shape = shape.map_err(|_| self.unsupported(node, "its picture has other sizes"))?;
        if !(1..=2).contains(&shape.hw_rank()) {
            let hint = "plans take pictures of one or two dimensions";
            return Err(self.unsupported(node, hint));
        }
        let padding = spec.computed_padding(shape.hw_dims());
        // A line is a picture of one row.
        let both = |of: &dyn Fn(usize) -> usize, line: usize| match shape.hw_rank() {
            1 => [line, of(0)],
            _ => [of(0), of(1)],
        };
        Ok(Patches {
            pictures: shape.n().copied().unwrap_or(1),
            channels: *shape.c(),
            size: both(&|axis| shape.hw_dims()[axis], 1),
            kernel: both(&|axis| spec.kernel_shape[axis], 1),
            stride: both(&|axis| spec.stride(axis), 1),
            dilation: both(&|axis| spec.dilation(axis), 1),
            before: both(&|axis| padding[axis].pad_before, 0),
            result: both(&|axis| padding[axis].convoluted, 1),
        })
    }

    /// The kernel of every group as a layer on patches, channel behind channel; none where it is no constant.
    fn kernels(&self, node: &TypedNode, conv: &Conv) -> Lowered<Option<Vec<Layer>>> {
        let constant = |slot: usize| -> Lowered<Option<Vec<f32>>> {
            let tensor = self.constant(self.outlet(node, slot)?);
            Ok(tensor.and_then(|tensor| numbers(&tensor)))
        };
        let (Some(values), Some(bias)) = (constant(1)?, constant(2)?) else { return Ok(None) };
        let (groups, outputs) = (conv.group, conv.pool_spec.output_channels);
        let channels = conv.pool_spec.input_channels / groups.max(1);
        let area: usize = conv.pool_spec.kernel_shape.iter().product();
        let inputs = channels * area;
        let bias = if let [all] = bias.as_slice() { vec![*all; outputs] } else { bias };
        let is_divided = groups > 0 && outputs % groups == 0;
        // Only this order has its groups behind each other.
        let is_ordered = groups == 1 || conv.kernel_fmt == KernelFormat::OIHW;
        let has_all = outputs > 0 && values.len() == inputs * outputs && bias.len() == outputs;
        if !(is_divided && is_ordered && has_all) {
            return Ok(None);
        }
        let at = |output: usize, channel: usize, point: usize| match conv.kernel_fmt {
            KernelFormat::OIHW => (output * channels + channel) * area + point,
            KernelFormat::HWIO => (point * channels + channel) * outputs + output,
            KernelFormat::OHWI => (output * area + point) * channels + channel,
        };
        let of_group = outputs / groups;
        let layer = |group: usize| {
            let own = group * of_group..(group + 1) * of_group;
            let places =
                (0..inputs).flat_map(|input| own.clone().map(move |output| (input, output)));
            let weight = |(input, output)| values[at(output, input / area, input % area)];
            let numbers = places.map(weight).collect();
            let matrix = Matrix { inputs, outputs: of_group, values: numbers };
            Layer { matrix, bias: bias[own.clone()].to_vec(), relu: false }
        };
        Ok(Some((0..groups).map(layer).collect()))
    }
}

/// The points of a grid.
fn area([height, width]: [usize; 2]) -> usize {
    height * width
}

// Pools: one number of every patch of a picture, channel by channel.
//
// The numbers that stand beside each other in a patch are reduced first, then those that stand above each other.

impl Lowering<'_> {
    /// The largest number of every patch.
    pub(super) fn largest(&mut self, node: &TypedNode, pool: &MaxPool) -> Lowered<()> {
        if pool.with_index_outputs.is_some() {
            return Err(self.unsupported(node, "plans do not say where the largest number stands"));
        }
        let value = self.operand(node, 0)?;
        let value = self.channels_first(node, &pool.pool_spec, value)?;
        let patches = self.patches(node, &pool.pool_spec, &value)?;
        let to = self.pooled(node, &patches, &value, Reduction::Maximum, f32::MIN)?;
        let to = self.as_picture(node, &pool.pool_spec, &patches, patches.channels, to)?;
        self.give(node, 0, to)
    }

    /// The sum or the mean of every patch.
    pub(super) fn sum(&mut self, node: &TypedNode, pool: &SumPool) -> Lowered<()> {
        let value = self.operand(node, 0)?;
        let value = self.channels_first(node, &pool.pool_spec, value)?;
        let patches = self.patches(node, &pool.pool_spec, &value)?;
        let sum = self.pooled(node, &patches, &value, Reduction::Sum, 0.0)?;
        let to = if pool.normalize { self.mean(&patches, pool, sum) } else { sum };
        let to = self.as_picture(node, &pool.pool_spec, &patches, patches.channels, to)?;
        self.give(node, 0, to)
    }

    /// Divides sums by how many points they are of.
    fn mean(&mut self, patches: &Patches, pool: &SumPool, sum: Place) -> Place {
        let counts: Vec<f32> = match pool.count_include_pad {
            true => vec![area(patches.kernel) as f32],
            false => patches.counts(),
        };
        let first = counts.first().copied().unwrap_or(1.0);
        if counts.iter().all(|count| *count == first) {
            return self.map(Function::Affine, [1.0 / first, 0.0], sum);
        }
        let shares: Vec<f32> = counts.iter().map(|count| 1.0 / count.max(1.0)).collect();
        let shares = self.stored(&shares.repeat(patches.pictures * patches.channels));
        self.combine(Combination::Multiply, sum, shares)
    }

    /// What becomes of every patch; points outside of the picture are `fill`.
    fn pooled(
        &mut self,
        node: &TypedNode,
        patches: &Patches,
        value: &Value,
        reduction: Reduction,
        fill: f32,
    ) -> Lowered<Place> {
        let (from, [height, width]) = self.framed(node, patches, value, fill)?;
        let channels = patches.pictures * patches.channels;
        let ([rows, columns], [tall, wide]) = (patches.result, patches.kernel);
        let beside = self.arena.place(channels * height * columns * wide);
        let of = |size, from, to| Dimension { size, from, to };
        let dimensions = [
            of(channels * height, width, columns * wide),
            of(columns, patches.stride[1], wide),
            of(wide, patches.dilation[1], 1),
        ];
        self.arrange(node, from, beside, &dimensions)?;
        let lines = self.reduced(reduction, wide, beside);
        let above = self.arena.place(channels * rows * columns * tall);
        let dimensions = [
            of(channels, height * columns, rows * columns * tall),
            of(rows, patches.stride[0] * columns, columns * tall),
            of(columns, 1, tall),
            of(tall, patches.dilation[0] * columns, 1),
        ];
        self.arrange(node, lines, above, &dimensions)?;
        Ok(self.reduced(reduction, tall, above))
    }

    /// A picture with all points that patches reach, and its sizes.
    fn framed(
        &mut self,
        node: &TypedNode,
        patches: &Patches,
        value: &Value,
        fill: f32,
    ) -> Lowered<(Place, [usize; 2])> {
        let [height, width] = patches.size;
        let framed = [0, 1].map(|direction| {
            let last = (patches.result[direction].max(1) - 1) * patches.stride[direction];
            let reach = last + (patches.kernel[direction].max(1) - 1) * patches.dilation[direction];
            (patches.before[direction] + patches.size[direction]).max(reach + 1)
        });
        if framed == patches.size {
            return Ok((value.place, framed));
        }
        let [above, left] = patches.before;
        let channels = patches.pictures * patches.channels;
        let to = self.arena.place(channels * area(framed));
        let of = |size, from, to| Dimension { size, from, to };
        let frame = self.stored(&[fill]);
        self.arrange(node, frame, to, &[of(to.len as usize, 0, 1)])?;
        let skipped = (above * framed[1] + left) as u32;
        let inner = Place { offset: to.offset + skipped, len: to.len - skipped };
        let dimensions = [
            of(channels, height * width, area(framed)),
            of(height, width, framed[1]),
            of(width, 1, 1),
        ];
        self.arrange(node, value.place, inner, &dimensions)?;
        Ok((to, framed))
    }
}

impl Patches {
    /// The points of every patch that lie in the picture.
    fn counts(&self) -> Vec<f32> {
        let along = |direction: usize| {
            let inside = move |patch: usize, point: usize| {
                let at = patch * self.stride[direction] + point * self.dilation[direction];
                let at = at.checked_sub(self.before[direction]);
                at.is_some_and(|at| at < self.size[direction])
            };
            let points = 0..self.kernel[direction];
            let count = move |patch| points.clone().filter(|point| inside(patch, *point)).count();
            (0..self.result[direction]).map(count).collect::<Vec<usize>>()
        };
        let (rows, columns) = (along(0), along(1));
        let of_row = |row: &usize| columns.iter().map(|column| (row * column) as f32).collect();
        rows.iter().flat_map(|row| -> Vec<f32> { of_row(row) }).collect()
    }
}
