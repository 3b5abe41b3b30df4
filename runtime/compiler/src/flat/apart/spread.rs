//! Transposed convolutions as convolutions of a picture whose points stand apart.

use super::{Parts, whole, wholes};

pub(super) fn write(parts: &mut Parts<'_>) -> Option<()> {
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
