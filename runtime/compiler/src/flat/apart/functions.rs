//! Functions of numbers and of rows that tract reads otherwise than the specification says, or not at all.

use tract_onnx::pb::AttributeProto;

use super::{Parts, wholes};

/// ONNX's alpha and gamma of Selu; where a node names none, tract takes them to five digits.
const SELU: [(&str, f32); 2] = [("alpha", 1.673_263_2), ("gamma", 1.050_701)];

/// Writes out what the node leaves to the specification.
pub(super) fn selu(parts: &mut Parts<'_>) -> Option<()> {
    let mut node = parts.node.clone();
    for (name, usual) in SELU {
        if parts.attribute(name).is_none() {
            node.attribute.push(attribute_of(name, usual));
        }
    }
    parts.nodes.push(node);
    Some(())
}

/// max(0, x) + min(0, α (e^(x/α) - 1)), which for α above zero is α times the Elu of x/α.
pub(super) fn celu(parts: &mut Parts<'_>) -> Option<()> {
    let alpha = parts.attribute("alpha").map_or(1.0, |attribute| attribute.f);
    if alpha.is_nan() || alpha <= 0.0 {
        return None;
    }
    let x = parts.input(0)?;
    let size = parts.number(alpha);
    let part = parts.add("Div", &[&x, &size]);
    let bent = parts.add("Elu", &[&part]);
    let whole = parts.add("Mul", &[&bent, &size]);
    parts.give(0, &whole)
}

/// The logarithm of a sum of powers, its largest taken out: the powers alone would end where 32 bits do.
pub(super) fn log_sum_exp(parts: &mut Parts<'_>) -> Option<()> {
    let x = parts.input(0)?;
    let others: Vec<String> = parts.node.input.iter().skip(1).cloned().collect();
    let own = parts.node.attribute.clone();
    let kept: Vec<AttributeProto> =
        own.iter().filter(|attribute| attribute.name != "keepdims").cloned().collect();
    // All of these operators are told their axes alike, whatever the version.
    let reduce = |parts: &mut Parts<'_>, operator: &str, x: &str, how: &[AttributeProto]| {
        let inputs: Vec<&str> =
            std::iter::once(x).chain(others.iter().map(String::as_str)).collect();
        parts.add_with(operator, &inputs, how.to_vec())
    };
    let largest = reduce(parts, "ReduceMax", &x, &kept);
    let below = parts.add("Sub", &[&x, &largest]);
    let powers = parts.add("Exp", &[&below]);
    let sum = reduce(parts, "ReduceL1", &powers, &kept);
    let logarithm = parts.add("Log", &[&sum]);
    let whole = parts.add("Add", &[&logarithm, &largest]);
    // Nothing is left to reduce, but sizes of one go where they are not kept.
    let found = reduce(parts, "ReduceMax", &whole, &own);
    parts.give(0, &found)
}

/// The logarithm of a softmax without the softmax, whose smallest numbers 32 bits do not hold.
pub(super) fn log_softmax(parts: &mut Parts<'_>) -> Option<()> {
    let x = parts.input(0)?;
    let version = parts.version();
    let rank = parts.fact(&x)?.1.len() as i64;
    let axis = parts.attribute("axis").map_or(if version < 13 { 1 } else { -1 }, |axis| axis.i);
    let axis = if axis < 0 { axis + rank } else { axis };
    // Before version 13 all sizes from the axis on are one row.
    if version < 13 && axis != rank - 1 {
        return None;
    }
    let largest = reduced(parts, "ReduceMax", &x, axis);
    let below = parts.add("Sub", &[&x, &largest]);
    let powers = parts.add("Exp", &[&below]);
    let sum = reduced(parts, "ReduceL1", &powers, axis);
    let logarithm = parts.add("Log", &[&sum]);
    let found = parts.add("Sub", &[&below, &logarithm]);
    parts.give(0, &found)
}

/// `(x - offset) * scale` along the last size, as files of scikit-learn have it.
pub(super) fn scaler(parts: &mut Parts<'_>) -> Option<()> {
    let x = float(parts, 0)?;
    let [offset, scale] = ["offset", "scale"].map(|name| {
        let floats = parts.attribute(name).map(|attribute| attribute.floats.clone());
        floats.filter(|floats| !floats.is_empty())
    });
    let mut found = x;
    for (operator, numbers) in [("Sub", offset), ("Mul", scale)] {
        if let Some(numbers) = numbers {
            let row = parts.floats(numbers);
            found = parts.add(operator, &[&found, &row]);
        }
    }
    parts.give(0, &found)
}

/// Rows divided by their largest size, by the sum of their sizes or by their length; rows of zeros stay.
pub(super) fn normalizer(parts: &mut Parts<'_>) -> Option<()> {
    let x = float(parts, 0)?;
    let axis = parts.fact(&x)?.1.len() as i64 - 1;
    let norm = parts.attribute("norm").map(|attribute| attribute.s.clone());
    let length = match norm.as_deref() {
        Some(b"L1") => reduced(parts, "ReduceL1", &x, axis),
        Some(b"L2") => reduced(parts, "ReduceL2", &x, axis),
        _ => {
            let sizes = parts.add("Abs", &[&x]);
            reduced(parts, "ReduceMax", &sizes, axis)
        }
    };
    let [nothing, one] = [0.0, 1.0].map(|number| parts.number(number));
    let is_nothing = parts.add("Equal", &[&length, &nothing]);
    let length = parts.add("Where", &[&is_nothing, &one, &length]);
    let found = parts.add("Div", &[&x, &length]);
    parts.give(0, &found)
}

/// A normalisation whose means and deviations are computed, which tract reads of constants alone.
pub(super) fn batch_norm(parts: &mut Parts<'_>) -> Option<()> {
    let names: Vec<String> = (1..5).map(|slot| parts.input(slot)).collect::<Option<_>>()?;
    if names.iter().all(|name| parts.constant(name).is_some()) {
        return None;
    }
    let x = parts.input(0)?;
    let rank = parts.fact(&x)?.1.len();
    // A number for each channel, which is the second size.
    let sizes: Vec<i64> = std::iter::once(-1).chain((2..rank).map(|_| 1)).collect();
    let [scale, bias, mean, variance] = &names[..] else { return None };
    let [scale, bias, mean, variance] =
        [scale, bias, mean, variance].map(|name| parts.reshaped(name, &sizes));
    let epsilon = parts.attribute("epsilon").map_or(1.0e-5, |attribute| attribute.f);
    let epsilon = parts.number(epsilon);
    let variance = parts.add("Add", &[&variance, &epsilon]);
    let deviation = parts.add("Sqrt", &[&variance]);
    let centred = parts.add("Sub", &[&x, &mean]);
    let normal = parts.add("Div", &[&centred, &deviation]);
    let scaled = parts.add("Mul", &[&normal, &scale]);
    let found = parts.add("Add", &[&scaled, &bias]);
    parts.give(0, &found)
}

/// Copies of a row that are written out.
const MOST_COPIES: usize = 256;

/// What is repeated to stand beside other rows, copied: tract loses its size where the product behind is taken apart.
pub(super) fn joined(parts: &mut Parts<'_>) -> Option<()> {
    let mut node = parts.node.clone();
    let mut is_changed = false;
    for slot in 0..node.input.len() {
        let Some(from) = parts.expanded(&node.input[slot]) else { continue };
        let (_, sizes) = parts.fact(&from)?;
        let (_, wanted) = parts.fact(&node.input[slot])?;
        let front = wanted.len().checked_sub(sizes.len())?;
        let sizes: Vec<i64> = std::iter::repeat_n(1, front).chain(sizes).collect();
        let mut found = if front > 0 { parts.reshaped(&from, &sizes) } else { from };
        for (axis, (to, from)) in
            wanted.iter().zip(&sizes).enumerate().filter(|(_, (to, from))| to != from)
        {
            let times =
                usize::try_from(to / from.max(&1)).ok().filter(|times| *times <= MOST_COPIES)?;
            let along = vec![super::whole("axis", axis as i64)];
            found = parts.add_with("Concat", &vec![found.as_str(); times], along);
        }
        node.input[slot] = found;
        is_changed = true;
    }
    is_changed.then(|| parts.nodes.push(node))
}

/// A reduction of one size, which stays as a size of one. Operators that are told their axes alike in all versions.
fn reduced(parts: &mut Parts<'_>, operator: &str, x: &str, axis: i64) -> String {
    if parts.version() < 18 {
        return parts.add_with(operator, &[x], vec![wholes("axes", &[axis])]);
    }
    let axes = parts.row(&[axis]);
    parts.add(operator, &[x, &axes])
}

/// An input as floats, whatever numbers it has.
fn float(parts: &mut Parts<'_>, slot: usize) -> Option<String> {
    let x = parts.input(slot)?;
    let to = AttributeProto { name: "to".into(), r#type: 2, i: 1, ..AttributeProto::default() };
    Some(parts.add_with("Cast", &[&x], vec![to]))
}

fn attribute_of(name: &str, f: f32) -> AttributeProto {
    AttributeProto { name: name.into(), r#type: 1, f, ..AttributeProto::default() }
}
