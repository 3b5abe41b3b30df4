//! Quantised files: whole numbers on a scale, and their products, as the floats that they stand for.

use tract_onnx::pb::tensor_proto::DataType::{Float, Int8, Uint8};

use super::{Parts, whole};

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
