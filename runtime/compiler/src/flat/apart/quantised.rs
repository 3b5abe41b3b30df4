//! Operators of quantised files, whole numbers on a scale and their products, as the floats that they stand for; and
//! transposed convolutions as convolutions of a picture whose points stand apart.

use tract_onnx::pb::tensor_proto::DataType::{Float, Int8, Uint8};

use super::{Parts, whole, wholes};

/// Writes floats, rounded where the file rounds, in the place of whole numbers on a scale. Sums of their products are
/// exact as far as 2^24.
pub(super) fn write(parts: &mut Parts<'_>) -> Option<()> {
    let inputs: Vec<Option<String>> = (0..8).map(|slot| parts.input(slot)).collect();
    let given = |slot: usize| inputs[slot].as_deref();
    if parts.attribute("block_size").is_some() {
        return None;
    }
    let result = match parts.node.op_type.as_str() {
        "QuantizeLinear" => rounded(parts, given(0)?, given(1)?, given(2))?,
        "DequantizeLinear" => scaled(parts, given(0)?, given(1)?, given(2))?,
        "DynamicQuantizeLinear" => return rounded_anew(parts, given(0)?),
        "QLinearMatMul" => {
            let left = scaled(parts, given(0)?, given(1)?, given(2))?;
            let right = scaled(parts, given(3)?, given(4)?, given(5))?;
            let sums = parts.add("MatMul", &[&left, &right]);
            rounded(parts, &sums, given(6)?, given(7))?
        }
        _ => {
            let operator = if parts.node.op_type == "ConvInteger" { "Conv" } else { "MatMul" };
            let left = apart(parts, given(0)?, given(2));
            let right = apart(parts, given(1)?, given(3));
            parts.add_with(operator, &[&left, &right], parts.node.attribute.clone())
        }
    };
    parts.give(0, &result)
}

/// The least and the largest number of a type that this constant has; of none, of bytes.
fn limits(parts: &Parts<'_>, zero: Option<&str>) -> Option<[f32; 2]> {
    let kind = zero.map_or(Some(Uint8 as i32), |zero| Some(parts.constant(zero)?.data_type))?;
    match kind {
        kind if kind == Uint8 as i32 => Some([0.0, 255.0]),
        kind if kind == Int8 as i32 => Some([-128.0, 127.0]),
        _ => None,
    }
}

/// `round(x / scale) + zero`, within the type of `zero`.
fn rounded(parts: &mut Parts<'_>, x: &str, scale: &str, zero: Option<&str>) -> Option<String> {
    let limits = limits(parts, zero)?;
    let [scale, zero] = along(parts, x, scale, zero)?;
    let steps = parts.add("Div", &[x, &scale?]);
    let mut whole = parts.add("Round", &[&steps]);
    if let Some(zero) = zero {
        whole = parts.add("Add", &[&whole, &zero]);
    }
    Some(within(parts, &whole, limits))
}

/// `(x - zero) scale`
fn scaled(parts: &mut Parts<'_>, x: &str, scale: &str, zero: Option<&str>) -> Option<String> {
    let [scale, zero] = along(parts, x, scale, zero)?;
    let mut x = float(parts, x);
    if let Some(zero) = zero {
        x = parts.add("Sub", &[&x, &zero]);
    }
    Some(parts.add("Mul", &[&x, &scale?]))
}

/// Numbers on the scale of 256 steps that all of them and zero fit, the scale, and where zero stands on it.
fn rounded_anew(parts: &mut Parts<'_>, x: &str) -> Option<()> {
    let [nothing, one, last] = [0.0, 1.0, 255.0].map(|number| parts.number(number));
    let keepdims = || vec![whole("keepdims", 0)];
    let largest = parts.add_with("ReduceMax", &[x], keepdims());
    let largest = parts.add("Max", &[&largest, &nothing]);
    let smallest = parts.add_with("ReduceMin", &[x], keepdims());
    let smallest = parts.add("Min", &[&smallest, &nothing]);
    let range = parts.add("Sub", &[&largest, &smallest]);
    let scale = parts.add("Div", &[&range, &last]);
    // Where all are zero, any scale fits.
    let is_flat = parts.add("Equal", &[&range, &nothing]);
    let scale = parts.add("Where", &[&is_flat, &one, &scale]);
    let below = parts.add("Div", &[&smallest, &scale]);
    let zero = parts.add("Neg", &[&below]);
    let zero = within(parts, &zero, [0.0, 255.0]);
    let zero = parts.add("Round", &[&zero]);
    let steps = parts.add("Div", &[x, &scale]);
    let steps = parts.add("Round", &[&steps]);
    let steps = parts.add("Add", &[&steps, &zero]);
    let steps = within(parts, &steps, [0.0, 255.0]);
    [steps, scale, zero].iter().enumerate().try_for_each(|(slot, from)| parts.give(slot, from))
}

/// A scale and a zero as floats that stand along the axis of `x` that they are for.
fn along(
    parts: &mut Parts<'_>,
    x: &str,
    scale: &str,
    zero: Option<&str>,
) -> Option<[Option<String>; 2]> {
    let sizes = parts.constant(scale).map_or(&[][..], |scale| &scale.dims[..]);
    let scales = sizes.iter().try_fold(1_i64, |count, size| count.checked_mul(*size))?;
    let mut both = [Some(scale), zero].map(|name| name.map(|name| float(parts, name)));
    if scales > 1 {
        let axes = parts.constant(x)?.dims.len() as i64;
        let axis = parts.attribute("axis").map_or(1, |axis| axis.i).rem_euclid(axes.max(1));
        let sizes: Vec<i64> = std::iter::once(scales).chain((axis + 1..axes).map(|_| 1)).collect();
        let sizes = parts.row(&sizes);
        both = both.map(|name| name.map(|name| parts.add("Reshape", &[&name, &sizes])));
    }
    Some(both)
}

fn apart(parts: &mut Parts<'_>, x: &str, zero: Option<&str>) -> String {
    let x = float(parts, x);
    let Some(zero) = zero else { return x };
    let zero = float(parts, zero);
    parts.add("Sub", &[&x, &zero])
}

fn within(parts: &mut Parts<'_>, x: &str, limits: [f32; 2]) -> String {
    let [least, most] = limits.map(|limit| parts.number(limit));
    let x = parts.add("Max", &[x, &least]);
    parts.add("Min", &[&x, &most])
}

fn float(parts: &mut Parts<'_>, x: &str) -> String {
    parts.add_with("Cast", &[x], vec![whole("to", Float as i64)])
}

/// Writes a convolution of a picture whose points stand apart in the place of a transposed one.
pub(super) fn spread(parts: &mut Parts<'_>) -> Option<()> {
    let (x, kernel) = (parts.input(0)?, parts.input(1)?);
    let (sizes, kernels) = (parts.fact(&x)?.1, parts.fact(&kernel)?.1);
    let ([batch, channels, points @ ..], [_, _, kernel_points @ ..]) = (&*sizes, &*kernels) else {
        return None;
    };
    let axes = points.len();
    let strides = parts.wholes("strides", axes, 1);
    let dilations = parts.wholes("dilations", axes, 1);
    let extra = parts.wholes("output_padding", axes, 0);
    let widths: Vec<i64> = kernel_points
        .iter()
        .zip(&dilations)
        .map(|(size, dilation)| (size - 1) * dilation)
        .collect();
    let whole_sizes: Vec<i64> = (0..axes)
        .map(|axis| strides[axis] * (points[axis] - 1) + extra[axis] + widths[axis] + 1)
        .collect();
    let cut = cut(parts, points, &strides, &whole_sizes)?;
    // Zeros between the points: behind each, along an axis of its own.
    let mut x = x;
    if strides.iter().any(|stride| *stride != 1) {
        let pairs = points.iter().flat_map(|size| [*size, 1]);
        let apart: Vec<i64> = [*batch, *channels].into_iter().chain(pairs).collect();
        x = parts.reshaped(&x, &apart);
        let behind = strides.iter().flat_map(|stride| [0, stride - 1]);
        let pads: Vec<i64> = std::iter::repeat_n(0, apart.len() + 2).chain(behind).collect();
        x = padded(parts, &x, &pads);
        let together = points.iter().zip(&strides).map(|(size, stride)| size * stride);
        let together: Vec<i64> = [*batch, *channels].into_iter().chain(together).collect();
        x = parts.reshaped(&x, &together);
    }
    let before: Vec<i64> = (0..axes).map(|axis| widths[axis] - cut[axis][0]).collect();
    let behind: Vec<i64> = (0..axes)
        .map(|axis| widths[axis] - cut[axis][1] + extra[axis] - (strides[axis] - 1))
        .collect();
    let x = moved(parts, &x, &before, &behind, points, &strides);
    let groups = parts.attribute("group").map_or(1, |group| group.i);
    let kernel = turned(parts, &kernel, &kernels, groups)?;
    let mut inputs = vec![x, kernel];
    inputs.extend(parts.input(2));
    let inputs: Vec<&str> = inputs.iter().map(String::as_str).collect();
    let attributes = vec![whole("group", groups), wholes("dilations", &dilations)];
    let result = parts.add_with("Conv", &inputs, attributes);
    parts.give(0, &result)
}

/// How many points are cut off before and behind, along every axis.
fn cut(parts: &Parts<'_>, points: &[i64], strides: &[i64], sizes: &[i64]) -> Option<Vec<[i64; 2]>> {
    let axes = points.len();
    let auto = parts.attribute("auto_pad").map_or(&b"NOTSET"[..], |auto| &auto.s);
    let shape = parts.attribute("output_shape").map(|shape| shape.ints.clone());
    let wanted: Option<Vec<i64>> = match (shape, auto) {
        (Some(shape), _) => Some(shape.get(shape.len().checked_sub(axes)?..)?.to_vec()),
        (None, b"SAME_UPPER" | b"SAME_LOWER") => {
            Some(points.iter().zip(strides).map(|(size, stride)| size * stride).collect())
        }
        _ => None,
    };
    let Some(wanted) = wanted else {
        let pads = parts.wholes("pads", 2 * axes, 0);
        return Some((0..axes).map(|axis| [pads[axis], pads[axis + axes]]).collect());
    };
    let part = |(size, wanted): (&i64, &i64)| {
        let all = (size - wanted).max(0);
        let half = all / 2;
        if auto == b"SAME_UPPER" { [half, all - half] } else { [all - half, half] }
    };
    Some(sizes.iter().zip(&wanted).map(part).collect())
}

/// A picture with so many zeros before and behind along every axis, or so many points less.
fn moved(
    parts: &mut Parts<'_>,
    x: &str,
    before: &[i64],
    behind: &[i64],
    points: &[i64],
    strides: &[i64],
) -> String {
    let axes = points.len();
    let mut x = x.to_owned();
    if before.iter().chain(behind).any(|count| *count < 0) {
        let starts: Vec<i64> = before.iter().map(|count| -count.min(&0)).collect();
        let size = |axis: usize| points[axis] * strides[axis] + behind[axis].min(0);
        let ends: Vec<i64> = (0..axes).map(size).collect();
        let along: Vec<i64> = (2..2 + axes as i64).collect();
        let [starts, ends, along] = [starts, ends, along].map(|numbers| parts.row(&numbers));
        x = parts.add("Slice", &[&x, &starts, &ends, &along]);
    }
    let zeros = |counts: &[i64]| {
        [0, 0].into_iter().chain(counts.iter().map(|count| *count.max(&0))).collect::<Vec<i64>>()
    };
    let pads = [zeros(before), zeros(behind)].concat();
    if pads.iter().all(|count| *count == 0) { x } else { padded(parts, &x, &pads) }
}

fn padded(parts: &mut Parts<'_>, x: &str, pads: &[i64]) -> String {
    let pads = parts.row(pads);
    parts.add("Pad", &[x, &pads])
}

/// A kernel turned round, outputs first.
fn turned(parts: &mut Parts<'_>, kernel: &str, sizes: &[i64], groups: i64) -> Option<String> {
    let [inputs, outputs, points @ ..] = sizes else { return None };
    let own = inputs.checked_div(groups)?;
    let apart = [&[groups, own, *outputs], points].concat();
    let x = parts.reshaped(kernel, &apart);
    let order: Vec<i64> = [0, 2, 1].into_iter().chain(3..apart.len() as i64).collect();
    let x = parts.transposed(&x, &order);
    let x = parts.reshaped(&x, &[&[groups * outputs, own], points].concat());
    let axes = 2..sizes.len() as i64;
    Some(axes.fold(x, |x, axis| parts.backwards(&x, axis)))
}
