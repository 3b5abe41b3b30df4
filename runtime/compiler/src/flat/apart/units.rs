//! Activation functions whose parameters tract passes over.

use tract_onnx::pb::AttributeProto;

use super::Parts;

/// ONNX's alpha and gamma of Selu; where a node names none, tract takes them to five digits.
const SELU: [(&str, f32); 2] = [("alpha", 1.673_263_2), ("gamma", 1.050_701)];

/// Writes out what the node leaves to the specification.
pub(super) fn selu(parts: &mut Parts<'_>) -> Option<()> {
    let mut node = parts.node.clone();
    for (name, usual) in SELU {
        if parts.attribute(name).is_none() {
            node.attribute.push(float(name, usual));
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

fn float(name: &str, f: f32) -> AttributeProto {
    AttributeProto { name: name.into(), r#type: 1, f, ..AttributeProto::default() }
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
    let reduce = |parts: &mut Parts<'_>, operator: &str, x: &str| {
        if version < 18 {
            return parts.add_with(operator, &[x], vec![super::wholes("axes", &[axis])]);
        }
        let axes = parts.row(&[axis]);
        parts.add(operator, &[x, &axes])
    };
    let largest = reduce(parts, "ReduceMax", &x);
    let below = parts.add("Sub", &[&x, &largest]);
    let powers = parts.add("Exp", &[&below]);
    let sum = reduce(parts, "ReduceL1", &powers);
    let logarithm = parts.add("Log", &[&sum]);
    let found = parts.add("Sub", &[&below, &logarithm]);
    parts.give(0, &found)
}
