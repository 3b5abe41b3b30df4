//! Operators that compute nothing: they say where each number of their output stands in their inputs.

use super::tensor::{Failure, Numbers, Tensor, axis_of, common_shape, count, places, strides};
use super::{Call, Found, around, one};

pub(super) fn evaluate(call: &Call<'_>) -> Found {
    match call.operator() {
        "Constant" => constant(call),
        "ConstantOfShape" => constant_of_shape(call),
        "Shape" => shape(call),
        "Size" => one(Tensor::whole(Vec::new(), vec![call.input(0)?.len() as i64])),
        "Reshape" => reshape(call),
        "Flatten" => flatten(call),
        "Squeeze" => squeeze(call),
        "Unsqueeze" => unsqueeze(call),
        "Transpose" => transpose(call),
        "Expand" => {
            let input = call.input(0)?;
            let wanted = sizes(call.input(1)?.wholes()?)?;
            one(input.spread(&common_shape(&input.shape, &wanted)?)?)
        }
        "Tile" => tile(call),
        "Slice" => slice(call),
        "Split" => split(call),
        "Concat" => {
            let parts: Vec<&Tensor> =
                (0..call.inputs.len()).map(|index| call.input(index)).collect::<Result<_, _>>()?;
            one(joined(&parts, call.int("axis", 1))?)
        }
        "Pad" => pad(call),
        "Range" => range(call),
        "OneHot" => one_hot(call),
        "EyeLike" => eye_like(call),
        "Trilu" => trilu(call),
        "NonZero" => non_zero(call),
        "DepthToSpace" | "SpaceToDepth" => space_and_depth(call),
        _ => Ok(None),
    }
}

/// What stands at one place along an axis.
pub(super) fn row(tensor: &Tensor, axis: usize, at: usize) -> Result<Tensor, Failure> {
    if tensor.shape.get(axis).is_none_or(|size| at >= *size) {
        return Err(
            format!("has nothing at {at} along the axis {axis} of {:?}", tensor.shape).into()
        );
    }
    let along = strides(&tensor.shape);
    let mut shape = tensor.shape.clone();
    shape[axis] = 1;
    let mut found = tensor.at(shape.clone(), &places(&shape, &along, at as isize * along[axis]));
    found.shape.remove(axis);
    Ok(found)
}

/// Tensors of one shape along a new axis.
pub(super) fn stacked(parts: &[&Tensor], axis: usize) -> Result<Tensor, Failure> {
    let with_axis = |part: &&Tensor| {
        let mut shape = part.shape.clone();
        shape.insert(axis.min(shape.len()), 1);
        Tensor::clone(part).reshaped(shape)
    };
    let parts: Vec<Tensor> = parts.iter().map(with_axis).collect::<Result<_, _>>()?;
    joined(&parts.iter().collect::<Vec<_>>(), axis as i64)
}

/// Tensors one behind the other along an axis.
pub(super) fn joined(parts: &[&Tensor], axis: i64) -> Result<Tensor, Failure> {
    let [first, ..] = parts else { return Err("needs an input".into()) };
    let axis = first.axis(axis)?;
    let mut shape = first.shape.clone();
    shape[axis] = 0;
    for part in parts {
        let other = |(at, size): (usize, &usize)| at != axis && *size != first.shape[at];
        if part.rank() != first.rank() || part.shape.iter().enumerate().any(other) {
            return Err(format!("cannot join {:?} and {:?}", first.shape, part.shape).into());
        }
        shape[axis] += part.shape[axis];
    }
    let mut from = Vec::with_capacity(count(&shape));
    for outer in 0..count(&shape[..axis]) {
        for (index, part) in parts.iter().enumerate() {
            let run = count(&part.shape[axis..]);
            from.extend((outer * run..(outer + 1) * run).map(|at| (index, at)));
        }
    }
    Tensor::of_parts(shape, parts, &from)
}

fn sizes(numbers: &[i64]) -> Result<Vec<usize>, Failure> {
    let size = |size: &i64| usize::try_from(*size).map_err(|_| "has a negative size".into());
    numbers.iter().map(size).collect()
}

fn constant(call: &Call<'_>) -> Found {
    if let Some(tensor) = call.attribute("value").and_then(|value| value.t.as_ref()) {
        return one(Tensor::read(tensor)?);
    }
    let list = |name: &str| call.attribute(name);
    one(if let Some(value) = list("value_float") {
        Tensor::real(Vec::new(), vec![value.f.into()])
    } else if let Some(value) = list("value_int") {
        Tensor::whole(Vec::new(), vec![value.i])
    } else if let Some(value) = list("value_floats") {
        Tensor::real(vec![value.floats.len()], value.floats.iter().map(|x| f64::from(*x)).collect())
    } else if let Some(value) = list("value_ints") {
        Tensor::whole(vec![value.ints.len()], value.ints.clone())
    } else {
        return Err("holds no numbers".into());
    })
}

fn constant_of_shape(call: &Call<'_>) -> Found {
    let shape = sizes(call.input(0)?.wholes()?)?;
    let value = call.attribute("value").and_then(|value| value.t.as_ref());
    let value = value.map_or_else(|| Ok(Tensor::real(vec![1], vec![0.0])), Tensor::read)?;
    let places = vec![0; count(&shape)];
    one(value.at(shape, &places))
}

fn shape(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    let rank = input.rank() as i64;
    let bound = |name: &str, usual: i64| {
        let at = call.int(name, usual);
        (if at < 0 { at + rank } else { at }).clamp(0, rank) as usize
    };
    let (start, end) = (bound("start", 0), bound("end", rank));
    let found: Vec<i64> = input.shape.iter().map(|size| *size as i64).collect();
    let found = found.get(start..end).unwrap_or_default().to_vec();
    one(Tensor::whole(vec![found.len()], found))
}

fn reshape(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    let wanted = call.listed("shape", 1)?.ok_or("has no shape")?;
    let keeps_zero = call.int("allowzero", 0) == 1;
    let known = |(axis, size): (usize, &i64)| match *size {
        0 if !keeps_zero => input.shape.get(axis).copied().unwrap_or(0),
        -1 => 1,
        size => size.unsigned_abs() as usize,
    };
    let mut shape: Vec<usize> = wanted.iter().enumerate().map(known).collect();
    if let Some(open) = wanted.iter().position(|size| *size == -1) {
        shape[open] = input.len() / count(&shape).max(1);
    }
    one(input.clone().reshaped(shape)?)
}

fn flatten(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    let axis = call.int("axis", 1);
    let axis =
        (if axis < 0 { axis + input.rank() as i64 } else { axis }).clamp(0, input.rank() as i64);
    let (rows, columns) = input.shape.split_at(axis as usize);
    let shape = vec![count(rows), count(columns)];
    one(input.clone().reshaped(shape)?)
}

fn squeeze(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    let axes = match call.listed("axes", 1)? {
        Some(axes) => axes.iter().map(|axis| input.axis(*axis)).collect::<Result<_, _>>()?,
        None => (0..input.rank()).filter(|axis| input.shape[*axis] == 1).collect::<Vec<_>>(),
    };
    let kept = (0..input.rank()).filter(|axis| !axes.contains(axis));
    let shape = kept.map(|axis| input.shape[axis]).collect();
    one(input.clone().reshaped(shape)?)
}

fn unsqueeze(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    let axes = call.listed("axes", 1)?.ok_or("has no axes")?;
    let rank = input.rank() + axes.len();
    let axes: Vec<usize> =
        axes.iter().map(|axis| axis_of(*axis, rank)).collect::<Result<_, _>>()?;
    let mut own = input.shape.iter();
    let size = |axis: usize| {
        if axes.contains(&axis) { Some(1) } else { own.next().copied() }
    };
    let shape: Option<Vec<usize>> = (0..rank).map(size).collect();
    one(input.clone().reshaped(shape.ok_or("names an axis twice")?)?)
}

fn transpose(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    let turned: Vec<usize> = match call.ints("perm") {
        Some(order) => order.iter().map(|axis| input.axis(*axis)).collect::<Result<_, _>>()?,
        None => (0..input.rank()).rev().collect(),
    };
    one(transposed(input, &turned))
}

/// A tensor whose axis k is the given one's `turned[k]`.
pub(super) fn transposed(input: &Tensor, turned: &[usize]) -> Tensor {
    let own = strides(&input.shape);
    let shape: Vec<usize> = turned.iter().map(|axis| input.shape[*axis]).collect();
    let along: Vec<isize> = turned.iter().map(|axis| own[*axis]).collect();
    let places = places(&shape, &along, 0);
    input.at(shape, &places)
}

fn tile(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    let mut found = input.clone();
    for (axis, repeats) in sizes(call.input(1)?.wholes()?)?.into_iter().enumerate() {
        if repeats == 0 {
            return Err("repeats nothing".into());
        }
        found = joined(&vec![&found; repeats], axis as i64)?;
    }
    one(found)
}

fn slice(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    let starts = call.listed("starts", 1)?.ok_or("has no starts")?;
    let ends = call.listed("ends", 2)?.ok_or("has no ends")?;
    let axes = call.listed("axes", 3)?.unwrap_or_else(|| (0..starts.len() as i64).collect());
    let steps = call.given(4).map(|steps| steps.wholes().map(<[_]>::to_vec)).transpose()?;
    let (mut shape, mut along, mut first) = (input.shape.clone(), strides(&input.shape), 0);
    for (index, axis) in axes.iter().enumerate() {
        let axis = input.axis(*axis)?;
        let size = input.shape[axis] as i64;
        let step = steps.as_ref().and_then(|steps| steps.get(index)).copied().unwrap_or(1);
        // Forwards a walk begins at most behind the end, backwards at most at the last.
        let (least, most) = if step > 0 { (0, size) } else { (-1, size - 1) };
        let bound = |at: Option<&i64>| {
            let at = at.copied().unwrap_or(0);
            (if at < 0 { at.saturating_add(size) } else { at }).clamp(least, most)
        };
        let (start, end) = (bound(starts.get(index)).max(0), bound(ends.get(index)));
        let (way, pace) =
            if step > 0 { (end - start, step) } else { (start - end, step.saturating_neg()) };
        if step == 0 {
            return Err("has a step of zero".into());
        }
        shape[axis] = (way.max(0) as u64).div_ceil(pace as u64) as usize;
        first += start as isize * along[axis];
        along[axis] *= step as isize;
    }
    let places = if count(&shape) == 0 { Vec::new() } else { places(&shape, &along, first) };
    one(input.at(shape, &places))
}

fn split(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    let axis = input.axis(call.int("axis", 0))?;
    let size = input.shape[axis];
    let parts = call.int("num_outputs", call.node.output.len() as i64).max(1) as usize;
    let lengths = match call.listed("split", 1)? {
        Some(lengths) => sizes(&lengths)?,
        // The last part may be shorter.
        None => {
            let usual = size.div_ceil(parts);
            (0..parts).map(|part| usual.min(size.saturating_sub(part * usual))).collect()
        }
    };
    if lengths.iter().sum::<usize>() != size {
        return Err(format!("splits {size} into {lengths:?}").into());
    }
    let own = strides(&input.shape);
    let mut first = 0;
    let part = |length: usize| {
        let mut shape = input.shape.clone();
        shape[axis] = length;
        let places = places(&shape, &own, first as isize * own[axis]);
        first += length;
        input.at(shape, &places)
    };
    Ok(Some(lengths.into_iter().map(part).collect()))
}

fn pad(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    let pads = call.listed("pads", 1)?.ok_or("has no pads")?;
    let axes: Vec<usize> = match call.given(3) {
        Some(axes) => axes.wholes()?.iter().map(|a| input.axis(*a)).collect::<Result<_, _>>()?,
        None => (0..input.rank()).collect(),
    };
    let mut found = input.clone();
    let value = match call.given(2) {
        Some(value) => value.clone(),
        None if matches!(input.numbers, Numbers::Real(_)) => {
            Tensor::real(vec![1], vec![call.float("value", 0.0)])
        }
        None => Tensor::whole(vec![1], vec![0]),
    };
    for (index, axis) in axes.iter().enumerate() {
        let (before, behind) = (pads.get(index), pads.get(index + axes.len()));
        let (Some(before), Some(behind)) = (before, behind) else {
            return Err("has too few pads".into());
        };
        found = padded(&found, *axis, [*before, *behind], call.text("mode", "constant"), &value)?;
    }
    one(found)
}

/// A tensor with room before and behind along an axis; negative room takes away.
fn padded(
    input: &Tensor,
    axis: usize,
    [before, behind]: [i64; 2],
    mode: &str,
    value: &Tensor,
) -> Result<Tensor, Failure> {
    let [outer, size, inner] = around(&input.shape, axis);
    let own = size as i64;
    let source = |at: i64| -> Option<usize> {
        let within = match mode {
            "edge" => at.clamp(0, own - 1),
            "wrap" => at.rem_euclid(own),
            // There and back again, the ends once each.
            "reflect" if own > 1 => {
                let turned = at.rem_euclid(2 * (own - 1));
                turned.min(2 * (own - 1) - turned)
            }
            "reflect" => 0,
            _ => at,
        };
        usize::try_from(within).ok().filter(|within| *within < size)
    };
    let rows: Vec<Option<usize>> = (-before..own + behind).map(source).collect();
    let mut from = Vec::new();
    for outer in 0..outer {
        for row in &rows {
            from.extend((0..inner).map(|at| match row {
                Some(row) => (0, (outer * size + row) * inner + at),
                None => (1, 0),
            }));
        }
    }
    let mut shape = input.shape.clone();
    shape[axis] = rows.len();
    Tensor::of_parts(shape, &[input, value], &from)
}

fn range(call: &Call<'_>) -> Found {
    let is_whole = matches!(call.input(0)?.numbers, Numbers::Whole(_));
    let [start, limit, step] = [0, 1, 2].map(|index| call.input(index).and_then(Tensor::single));
    let (start, limit, step) = (start?, limit?, step?);
    let steps = ((limit - start) / step).ceil().max(0.0) as usize;
    let numbers: Vec<f64> = (0..steps).map(|index| start + index as f64 * step).collect();
    let found = Tensor::real(vec![steps], numbers);
    one(if is_whole { Tensor::whole(vec![steps], found.to_wholes()) } else { found })
}

fn one_hot(call: &Call<'_>) -> Found {
    let (indices, values) = (call.input(0)?, call.input(2)?);
    let depth = call.input(1)?.single()? as usize;
    let axis = axis_of(call.int("axis", -1), indices.rank() + 1)?;
    let mut shape = indices.shape.clone();
    shape.insert(axis, depth);
    let inner = count(&indices.shape[axis..]);
    let wanted = indices.to_wholes();
    let place = |at: usize| {
        let (outer, column, inner_at) = (at / (depth * inner), at / inner % depth, at % inner);
        let hot = wanted[outer * inner + inner_at];
        let hot = if hot < 0 { hot + depth as i64 } else { hot };
        usize::from(hot == column as i64)
    };
    let places: Vec<usize> = (0..count(&shape)).map(place).collect();
    one(values.at(shape, &places))
}

fn eye_like(call: &Call<'_>) -> Found {
    let [rows, columns] = call.input(0)?.shape[..] else { return Err("needs a matrix".into()) };
    let shift = call.int("k", 0);
    let is_one = |at: usize| (at % columns) as i64 == (at / columns) as i64 + shift;
    let numbers: Vec<bool> = (0..rows * columns).map(is_one).collect();
    let found = Tensor::truth(vec![rows, columns], numbers);
    one(match call.input(0)?.numbers {
        Numbers::Whole(_) => Tensor::whole(found.shape.clone(), found.to_wholes()),
        _ => Tensor::real(found.shape.clone(), found.to_reals()),
    })
}

fn trilu(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    let [.., rows, columns] = input.shape[..] else { return Err("needs matrices".into()) };
    let shift = call.given(1).map_or(Ok(0), |shift| shift.wholes().map(|shift| shift[0]))?;
    let is_upper = call.int("upper", 1) == 1;
    let zero = match input.numbers {
        Numbers::Real(_) => Tensor::real(vec![1], vec![0.0]),
        Numbers::Whole(_) => Tensor::whole(vec![1], vec![0]),
        Numbers::Truth(_) => Tensor::truth(vec![1], vec![false]),
    };
    let from = (0..input.len()).map(|at| {
        let beyond = (at % columns) as i64 - (at / columns % rows) as i64 - shift;
        let is_kept = if is_upper { beyond >= 0 } else { beyond <= 0 };
        if is_kept { (0, at) } else { (1, 0) }
    });
    one(Tensor::of_parts(input.shape.clone(), &[input, &zero], &from.collect::<Vec<_>>())?)
}

fn non_zero(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    let numbers = input.to_reals();
    let found: Vec<usize> = (0..numbers.len()).filter(|at| numbers[*at] != 0.0).collect();
    let axes = (0..input.rank()).flat_map(|axis| {
        let [_, size, inner] = around(&input.shape, axis);
        found.iter().map(move |at| (at / inner % size) as i64)
    });
    one(Tensor::whole(vec![input.rank(), found.len()], axes.collect()))
}

/// Channels as blocks of pixels, or blocks of pixels as channels.
fn space_and_depth(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    let [batch, channels, height, width] = input.shape[..] else {
        return Err("needs pictures".into());
    };
    let block = call.int("blocksize", 1).max(1) as usize;
    let (parted, turned, shape) = if call.operator() == "SpaceToDepth" {
        let (rows, columns) = (height / block, width / block);
        (
            vec![batch, channels, rows, block, columns, block],
            [0, 3, 5, 1, 2, 4],
            vec![batch, channels * block * block, rows, columns],
        )
    } else {
        let depth = channels / (block * block);
        let shape = vec![batch, depth, height * block, width * block];
        if call.text("mode", "DCR") == "CRD" {
            (vec![batch, depth, block, block, height, width], [0, 1, 4, 2, 5, 3], shape)
        } else {
            (vec![batch, block, block, depth, height, width], [0, 3, 4, 1, 5, 2], shape)
        }
    };
    one(transposed(&input.clone().reshaped(parted)?, &turned).reshaped(shape)?)
}
