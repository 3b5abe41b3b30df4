//! Attention of opset 23 and later as products and a softmax.

use tract_onnx::prelude::*;

use super::{Parts, whole};

/// The axes of heads and of places exchanged.
const HEADS_FIRST: [i64; 4] = [0, 2, 1, 3];

pub(super) fn write(parts: &mut Parts<'_>) -> Option<()> {
    let softcap = parts.attribute("softcap").map_or(0.0, |softcap| softcap.f);
    let past = [4, 5].map(|slot| parts.input(slot));
    let is_causal = parts.whole("is_causal") != 0;
    let is_continued = past.iter().any(Option::is_some);
    if softcap != 0.0 || parts.is_wanted(3) || parts.input(6).is_some() || is_causal && is_continued
    {
        return None;
    }
    let [query, key, value] = [(0, "q_num_heads"), (1, "kv_num_heads"), (2, "kv_num_heads")]
        .map(|(slot, heads)| heads_first(parts, slot, heads));
    let ((query, queries), (key, keys), (value, values)) = (query?, key?, value?);
    let (key, rows) = continued(parts, key, keys[2], past[0].as_deref(), 1)?;
    let (value, _) = continued(parts, value, values[2], past[1].as_deref(), 2)?;
    let key = repeated(parts, key, [keys[0], keys[1], rows, keys[3]], queries[1])?;
    let value = repeated(parts, value, [values[0], values[1], rows, values[3]], queries[1])?;
    let key = parts.transposed(&key, &[0, 1, 3, 2]);
    let scores = parts.add("MatMul", &[&query, &key]);
    let scale = parts.attribute("scale").map(|scale| scale.f);
    let scale = parts.number(scale.unwrap_or_else(|| (queries[3] as f32).sqrt().recip()));
    let mut scores = parts.add("Mul", &[&scores, &scale]);
    let mut visible = None;
    if is_causal {
        let before = (0..queries[2]).flat_map(|query| (0..rows).map(move |row| row <= query));
        visible = Some(parts.truths(vec![queries[2], rows], before));
    }
    if let Some(mask) = parts.input(3) {
        let (kind, sizes) = parts.fact(&mask)?;
        // A mask that is shorter than the rows would leave out the others.
        sizes.last().filter(|size| **size == rows)?;
        if kind == DatumType::Bool {
            visible = Some(match visible {
                Some(before) => parts.add("And", &[&mask, &before]),
                None => mask,
            });
        } else {
            scores = parts.add("Add", &[&scores, &mask]);
        }
    }
    let shares = shares(parts, &scores, visible.as_deref());
    let mut result = parts.add("MatMul", &[&shares, &value]);
    if parts.attribute("q_num_heads").is_some() {
        let behind = parts.transposed(&result, &HEADS_FIRST);
        result = parts.reshaped(&behind, &[queries[0], queries[2], -1]);
    }
    parts.give(0, &result)
}

/// An input as rows of every head, and its four sizes.
fn heads_first(parts: &mut Parts<'_>, slot: usize, heads: &str) -> Option<(String, [i64; 4])> {
    let x = parts.input(slot)?;
    match *parts.fact(&x)?.1 {
        [batch, heads, rows, width] => Some((x, [batch, heads, rows, width])),
        [batch, rows, width] => {
            let heads = parts.attribute(heads)?.i;
            let x = parts.reshaped(&x, &[batch, rows, heads, width.checked_div(heads)?]);
            Some((parts.transposed(&x, &HEADS_FIRST), [batch, heads, rows, width / heads]))
        }
        _ => None,
    }
}

/// Rows behind those of earlier steps, which are an output too; and how many there are.
fn continued(
    parts: &mut Parts<'_>,
    x: String,
    rows: i64,
    past: Option<&str>,
    slot: usize,
) -> Option<(String, i64)> {
    let Some(past) = past else {
        parts.give(slot, &x)?;
        return Some((x, rows));
    };
    let before = *parts.fact(past)?.1.get(2)?;
    let all = parts.add_with("Concat", &[past, &x], vec![whole("axis", 2)]);
    parts.give(slot, &all)?;
    Some((all, before + rows))
}

/// Heads that several queries share, once for each.
fn repeated(parts: &mut Parts<'_>, x: String, sizes: [i64; 4], heads: i64) -> Option<String> {
    let [batch, own, rows, width] = sizes;
    let times = heads.checked_div(own)?;
    if times == 1 {
        return Some(x);
    }
    let apart = parts.reshaped(&x, &[batch, own, 1, rows, width]);
    let sizes = parts.row(&[batch, own, times, rows, width]);
    let all = parts.add("Expand", &[&apart, &sizes]);
    Some(parts.reshaped(&all, &[batch, heads, rows, width]))
}

/// What every row is weighed by; a query that sees no row weighs none.
fn shares(parts: &mut Parts<'_>, scores: &str, visible: Option<&str>) -> String {
    let axis = || vec![whole("axis", -1)];
    let Some(visible) = visible else { return parts.add_with("Softmax", &[scores], axis()) };
    let [least, none] = [f32::MIN, 0.0].map(|number| parts.number(number));
    let scores = parts.add("Where", &[visible, scores, &least]);
    let shares = parts.add_with("Softmax", &[&scores], axis());
    parts.add("Where", &[visible, &shares, &none])
}
