//! Convolutions: layers on every patch of a picture.

use sortie_core::internal::kernels::several::PART;
use sortie_core::internal::ops::{
    ConvolvePatches, Flag, Int8ConvolvePatches, Op, Patches, Place, quantised_picture,
};
use tract_onnx::prelude::*;
use tract_onnx::tract_core::ops::cnn::{Conv, KernelFormat, PoolSpec};

use super::products::key;
use super::values::{PolicyWeights, numbers};
use super::windows::{Source, Target, Windows, area, part};
use super::{Lowered, Lowering, WIDEST};
use crate::lower::agent::at_most;
use crate::lower::rounding::Rounded;
use crate::matching::{Layer, Matrix};

/// The layers of a convolution.
struct Layers<'a> {
    /// The layer of every group of channels.
    groups: &'a [Layer],
    relu: Flag,
}

/// A layer on patches among the weights.
#[derive(Clone, Copy)]
pub(super) enum StoredTiles {
    Floats {
        weights: u32,
        bias: u32,
    },
    /// Weights, steps and bias.
    Integers([u32; 3]),
}

impl Lowering<'_> {
    pub(super) fn convolve(&mut self, node: &TypedNode, conv: &Conv) -> Lowered<()> {
        if conv.q_params.is_some() {
            return Err(self.unsupported(node, "plans convolve numbers that are not scaled"));
        }
        let spec = &conv.pool_spec;
        let windows = self.windows(node, spec)?;
        let mut source = self.source(node, spec, &windows)?;
        let groups = self.kernels(node, conv)?;
        let groups = groups.ok_or_else(|| self.unsupported(node, "its kernel is no constant"))?;
        let outputs = spec.output_channels;
        let inputs = windows.channels / groups.len() * area(windows.kernel);
        at_most("the width of a layer", inputs.max(outputs), WIDEST)?;
        let is_depthwise = groups.len() > 1 && [windows.channels, outputs] == [groups.len(); 2];
        // Of channels behind each other runs are read along rows.
        let is_dilated = windows.kernel[1] > 1 && windows.dilation[1] > 1;
        if is_depthwise || is_dilated {
            source = self.as_points(node, &windows, source)?;
        }
        let source = self.framed(node, &windows, source, 0.0)?;
        let relu = self.relu_after(node);
        let last = relu.unwrap_or(node);
        let layers = Layers { groups: &groups, relu: Flag::from(relu.is_some()) };
        let target = self.target(last, &windows, spec, outputs)?;
        if is_depthwise {
            self.layer_on_channels(&windows, source, &layers, target);
        } else {
            self.layers_on_patches(&windows, source, &layers, target);
        }
        if self.values.framed((last.id, 0).into()).is_some() {
            return Ok(());
        }
        let picture = windows.picture(target.place, outputs);
        self.give_picture(node, spec, picture)?;
        relu.map_or(Ok(()), |relu| self.give_picture(relu, spec, picture))
    }

    /// Room for a result; with a border of zeros, if nothing reads it but a convolution that wants one.
    fn target(
        &mut self,
        node: &TypedNode,
        windows: &Windows,
        spec: &PoolSpec,
        outputs: usize,
    ) -> Lowered<Target> {
        let readers = &node.outputs[0].successors;
        let reader = match readers.as_slice() {
            [reader] if reader.slot == 0 && !self.model.outputs.contains(&(node.id, 0).into()) => {
                Some(self.model.node(reader.node))
            }
            _ => None,
        };
        let next = reader.and_then(|reader| Some((reader, reader.op_as::<Conv>()?)));
        let next = next.filter(|(_, next)| next.pool_spec.data_format == spec.data_format);
        let next = next.map(|(reader, next)| self.windows(reader, &next.pool_spec)).transpose()?;
        if let Some(next) = next.filter(|next| next.framed() != next.size) {
            let whole = Windows { size: next.framed(), ..next };
            let source = whole.points(self.arena.place(next.pictures * outputs * area(whole.size)));
            self.filled(node, source.place, 0.0)?;
            self.values.insert_framed((node.id, 0).into(), source.place);
            let first = next.before[0] * source.steps[1] + next.before[1] * outputs;
            return Ok(Target {
                place: source.place,
                first,
                row: source.steps[1],
                each: source.each,
            });
        }
        let place = self.arena.place(windows.pictures * outputs * area(windows.result));
        Ok(windows.target(place, outputs))
    }

    /// A layer on the patches of every picture and group of channels.
    fn layers_on_patches(
        &mut self,
        windows: &Windows,
        source: Source,
        layers: &Layers<'_>,
        target: Target,
    ) {
        let channels = windows.channels / layers.groups.len();
        let mut patches = windows.patches(source, channels);
        let mut first_output = 0;
        let all: usize = layers.groups.iter().map(|layer| layer.matrix.outputs).sum();
        patches.to_steps = [target.row as u32, all as u32];
        // Runs without gaps between them are one.
        let [outer, inner] = patches.runs;
        if inner > 1 && patches.run_steps[1] == patches.run {
            patches = Patches { runs: [outer, 1], run: inner * patches.run, ..patches };
        }
        for (group, layer) in layers.groups.iter().enumerate() {
            let layer = windows.ordered(layer, source.has_points());
            let outputs = layer.matrix.outputs as u32;
            let stored = self.stored_tiles(&layer, patches.run);
            for picture in 0..windows.pictures {
                let from = source.each * picture + source.steps[0] * channels * group;
                let from = part(source.place, from, patches.reach());
                let first = target.first + target.each * picture + first_output;
                let to = part(target.place, first, patches.result_reach(outputs));
                let relu = layers.relu;
                let (weights, bias) = (0, 0);
                let step = ConvolvePatches { weights, bias, outputs, relu, patches, from, to };
                self.push_patches(stored, step);
            }
            first_output += layer.matrix.outputs;
        }
    }

    /// A layer on rows that stand behind each other: each is a patch of one run.
    pub(super) fn layer_on_rows(&mut self, layer: &Layer, rows: usize, from: Place) -> Place {
        let (inputs, outputs) = (layer.matrix.inputs, layer.matrix.outputs);
        let to = self.arena.place(rows * outputs);
        let stored = self.stored_tiles(layer, inputs as u32);
        let patches = Patches {
            count: [rows as u32, 1],
            steps: [inputs as u32, 0],
            runs: [1, 1],
            run_steps: [0; 2],
            run: inputs as u32,
            to_steps: [outputs as u32, 0],
        };
        let relu = Flag::from(layer.relu);
        self.push_patches(
            stored,
            ConvolvePatches {
                weights: 0,
                bias: 0,
                outputs: outputs as u32,
                relu,
                patches,
                from,
                to,
            },
        );
        to
    }

    /// Adds a step whose weights are stored.
    fn push_patches(&mut self, stored: StoredTiles, step: ConvolvePatches) {
        let ConvolvePatches { outputs, relu, patches, from, to, .. } = step;
        self.ops.push(match stored {
            StoredTiles::Floats { weights, bias } => {
                Op::ConvolvePatches(ConvolvePatches { weights, bias, ..step })
            }
            StoredTiles::Integers([weights, steps, bias]) => {
                let quantised = self.arena.place(quantised_picture(from.len as usize));
                Op::Int8ConvolvePatches(Int8ConvolvePatches {
                    weights,
                    steps,
                    bias,
                    outputs,
                    relu,
                    patches,
                    from,
                    to,
                    quantised,
                })
            }
        });
    }

    /// Adds a layer on patches of runs of so many numbers to the weights; one that stands there already stands there once.
    fn stored_tiles(&mut self, layer: &Layer, run: u32) -> StoredTiles {
        let key = key(layer, [run as usize, 0]);
        if let Some(stored) = self.tiles.get(&key) {
            return *stored;
        }
        let outputs = layer.matrix.outputs;
        let stored = match &mut self.weights {
            PolicyWeights::Tiles(weights) => {
                let mut add = |values: &[f32]| weights.add_numbers(&tiles(values, outputs));
                StoredTiles::Floats { weights: add(&layer.matrix.values), bias: add(&layer.bias) }
            }
            PolicyWeights::Int8(weights, _) => {
                StoredTiles::Integers(weights.add_patches(&Rounded::nearest(layer), run as usize))
            }
        };
        self.tiles.insert(key, stored);
        stored
    }

    /// A layer on each channel by itself.
    fn layer_on_channels(
        &mut self,
        windows: &Windows,
        source: Source,
        layers: &Layers<'_>,
        target: Target,
    ) {
        let of_each = layers.groups.iter().map(|layer| layer.matrix.values.as_slice());
        let of_each: Vec<&[f32]> = of_each.collect();
        let points = 0..area(windows.kernel);
        let weights: Vec<f32> =
            points.flat_map(|point| of_each.iter().map(move |weights| weights[point])).collect();
        let bias: Vec<f32> = layers.groups.iter().flat_map(|layer| layer.bias.clone()).collect();
        self.fold(windows, source, (&weights, &bias), layers.relu, target);
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

/// Rows of numbers in tiles of columns: the rows of one tile, then those of the next, zeros behind the last column.
pub(super) fn tiles(values: &[f32], columns: usize) -> Vec<f32> {
    let tile = |first: usize| {
        let row = move |row: &[f32]| {
            let mut own = row[first..columns.min(first + PART)].to_vec();
            own.resize(PART, 0.0);
            own
        };
        values.chunks_exact(columns).flat_map(row)
    };
    (0..columns).step_by(PART).flat_map(tile).collect()
}

impl Windows {
    /// A layer whose inputs stand as patches do; given, they stand channel behind channel.
    fn ordered(&self, layer: &Layer, has_points: bool) -> Layer {
        let Matrix { inputs, outputs, values } = &layer.matrix;
        let (area, channels) = (area(self.kernel), inputs / area(self.kernel).max(1));
        let from = |input: usize| match has_points {
            true => input % channels * area + input / channels,
            false => input,
        };
        let values = (0..*inputs).flat_map(|input| &values[from(input) * outputs..][..*outputs]);
        let matrix = Matrix { values: values.copied().collect(), ..layer.matrix };
        Layer { matrix, bias: layer.bias.clone(), relu: layer.relu }
    }
}
