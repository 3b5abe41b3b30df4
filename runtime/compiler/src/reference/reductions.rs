//! Operators that make one number of many, and those that set numbers beside the others of their row.

use std::cmp::Ordering;

use super::elementwise::larger;
use super::moves::transposed;
use super::tensor::{Failure, Numbers, Tensor, count};
use super::{Call, Found, around, one};

pub(super) fn evaluate(call: &Call<'_>) -> Found {
    match call.operator() {
        "ReduceSum" => reduce(call, |row| row.iter().sum()),
        "ReduceMean" => reduce(call, mean),
        "ReduceMax" => reduce(call, |row| row.iter().copied().fold(f64::NEG_INFINITY, larger)),
        "ReduceMin" => reduce(call, |row| -row.iter().map(|x| -x).fold(f64::NEG_INFINITY, larger)),
        "ReduceProd" => reduce(call, |row| row.iter().product()),
        "ReduceL1" => reduce(call, |row| row.iter().map(|x| x.abs()).sum()),
        "ReduceL2" => reduce(call, |row| square_sum(row).sqrt()),
        "ReduceSumSquare" => reduce(call, square_sum),
        "ReduceLogSum" => reduce(call, |row| row.iter().sum::<f64>().ln()),
        "ReduceLogSumExp" => reduce(call, log_sum_exp),
        "GlobalAveragePool" => global(call, mean),
        "GlobalMaxPool" => global(call, |row| row.iter().copied().fold(f64::NEG_INFINITY, larger)),
        "Softmax" | "LogSoftmax" | "Hardmax" => by_rows(call),
        "ArgMax" | "ArgMin" => chosen(call),
        "TopK" => top(call),
        "CumSum" => running_sum(call),
        "LayerNormalization" | "RMSNormalization" => layer_norm(call),
        "BatchNormalization" => batch_norm(call),
        "InstanceNormalization" | "GroupNormalization" => group_norm(call),
        "LpNormalization" | "Normalizer" => lp_norm(call),
        "MeanVarianceNormalization" => mean_variance(call),
        "Resize" | "Upsample" => resize(call),
        _ => Ok(None),
    }
}

fn mean(row: &[f64]) -> f64 {
    row.iter().sum::<f64>() / row.len() as f64
}

fn square_sum(row: &[f64]) -> f64 {
    row.iter().map(|x| x * x).sum()
}

fn log_sum_exp(row: &[f64]) -> f64 {
    let largest = row.iter().copied().fold(f64::NEG_INFINITY, larger);
    if largest.is_infinite() {
        return largest;
    }
    largest + row.iter().map(|x| (x - largest).exp()).sum::<f64>().ln()
}

/// Turns a row to its softmax.
pub(super) fn softmax(row: &mut [f64]) {
    let largest = row.iter().copied().fold(f64::NEG_INFINITY, larger);
    row.iter_mut().for_each(|x| *x = (*x - largest).exp());
    let sum: f64 = row.iter().sum();
    row.iter_mut().for_each(|x| *x /= sum);
}

/// A tensor with some axes moved behind the others: rows to be reduced.
fn axes_last(input: &Tensor, axes: &[usize]) -> Tensor {
    let others = (0..input.rank()).filter(|axis| !axes.contains(axis));
    transposed(input, &others.chain(axes.iter().copied()).collect::<Vec<_>>())
}

fn reduce(call: &Call<'_>, function: impl Fn(&[f64]) -> f64) -> Found {
    let input = call.input(0)?;
    let mut axes: Vec<usize> = match call.listed("axes", 1)? {
        Some(axes) => axes.iter().map(|axis| input.axis(*axis)).collect::<Result<_, _>>()?,
        None => Vec::new(),
    };
    if axes.is_empty() {
        if call.int("noop_with_empty_axes", 0) == 1 {
            return one(input.clone());
        }
        axes = (0..input.rank()).collect();
    }
    let keeps = call.int("keepdims", 1) == 1;
    let size = |axis: usize| {
        if !axes.contains(&axis) { Some(input.shape[axis]) } else { keeps.then_some(1) }
    };
    let shape: Vec<usize> = (0..input.rank()).filter_map(size).collect();
    let rows = axes_last(input, &axes).to_reals();
    let length = axes.iter().map(|axis| input.shape[*axis]).product::<usize>();
    let found = (0..count(&shape)).map(|row| function(&rows[row * length..(row + 1) * length]));
    let found = Tensor::real(shape, found.collect());
    let is_whole = matches!(input.numbers, Numbers::Whole(_));
    one(if is_whole { Tensor::whole(found.shape.clone(), found.to_wholes()) } else { found })
}

fn global(call: &Call<'_>, function: impl Fn(&[f64]) -> f64) -> Found {
    let input = call.input(0)?;
    let [batch, channels, sizes @ ..] = &input.shape[..] else {
        return Err("needs pictures".into());
    };
    let shape = [&[*batch, *channels], &vec![1; sizes.len()][..]].concat();
    let found = input.reals()?.chunks(count(sizes).max(1)).map(function).collect();
    one(Tensor::real(shape, found))
}

/// Applies a function to every row along an axis.
fn along(
    input: &Tensor,
    axis: usize,
    mut function: impl FnMut(&mut [f64]),
) -> Result<Tensor, Failure> {
    let [outer, size, inner] = around(&input.shape, axis);
    let mut numbers = input.to_reals();
    let mut row = vec![0.0; size];
    for first in (0..outer).flat_map(|outer| (0..inner).map(move |at| outer * size * inner + at)) {
        row.iter_mut().enumerate().for_each(|(at, x)| *x = numbers[first + at * inner]);
        function(&mut row);
        row.iter().enumerate().for_each(|(at, x)| numbers[first + at * inner] = *x);
    }
    Ok(Tensor::real(input.shape.clone(), numbers))
}

fn by_rows(call: &Call<'_>) -> Found {
    let function: fn(&mut [f64]) = match call.operator() {
        "Softmax" => softmax,
        "LogSoftmax" => |row| {
            let sum = log_sum_exp(row);
            row.iter_mut().for_each(|x| *x -= sum);
        },
        _ => |row| {
            let best = best_of(row, false, f64::gt);
            row.iter_mut().enumerate().for_each(|(at, x)| *x = f64::from(at == best));
        },
    };
    let input = call.input(0)?;
    // Before version 13 all axes from the given one on are a row together.
    if call.version < 13 {
        let axis = input.axis(call.int("axis", 1))?;
        let (rows, row) = input.shape.split_at(axis);
        let flat = input.clone().reshaped(vec![count(rows), count(row)])?;
        return one(along(&flat, 1, function)?.reshaped(input.shape.clone())?);
    }
    one(along(input, input.axis(call.int("axis", -1))?, function)?)
}

/// The place of the best number: the first of equal ones, or the last.
fn best_of(row: &[f64], is_last: bool, is_better: fn(&f64, &f64) -> bool) -> usize {
    let mut best = 0;
    for (at, x) in row.iter().enumerate() {
        if is_better(x, &row[best]) || is_last && *x == row[best] {
            best = at;
        }
    }
    best
}

fn chosen(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    let axis = input.axis(call.int("axis", 0))?;
    let is_last = call.int("select_last_index", 0) == 1;
    let is_better = if call.operator() == "ArgMax" { f64::gt } else { f64::lt };
    let mut shape = input.shape.clone();
    let length = shape[axis];
    if call.int("keepdims", 1) == 1 {
        shape[axis] = 1;
    } else {
        shape.remove(axis);
    }
    let rows = axes_last(input, &[axis]).to_reals();
    let best = rows.chunks(length.max(1)).map(|row| best_of(row, is_last, is_better) as i64);
    one(Tensor::whole(shape, best.collect()))
}

fn top(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    let axis = input.axis(call.int("axis", -1))?;
    let k = match call.given(1) {
        Some(k) => k.single()? as usize,
        None => call.int("k", 1) as usize,
    };
    let is_largest = call.int("largest", 1) == 1;
    let [outer, size, inner] = around(&input.shape, axis);
    if k > size {
        return Err(format!("takes the best {k} of {size}").into());
    }
    let numbers = input.to_reals();
    let mut places = vec![0; outer * k * inner];
    let mut ranks = vec![0; outer * k * inner];
    for outer in 0..outer {
        for at in 0..inner {
            let place = |rank: usize| (outer * size + rank) * inner + at;
            let mut order: Vec<usize> = (0..size).collect();
            let by = |a: &usize, b: &usize| {
                let order =
                    numbers[place(*a)].partial_cmp(&numbers[place(*b)]).unwrap_or(Ordering::Equal);
                if is_largest { order.reverse() } else { order }
            };
            order.sort_by(by);
            for (rank, from) in order.into_iter().take(k).enumerate() {
                let to = (outer * k + rank) * inner + at;
                (places[to], ranks[to]) = (place(from), from as i64);
            }
        }
    }
    let mut shape = input.shape.clone();
    shape[axis] = k;
    Ok(Some(vec![input.at(shape.clone(), &places), Tensor::whole(shape, ranks)]))
}

fn running_sum(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    let axis = input.axis(call.input(1)?.single()? as i64)?;
    let [excludes, reverses] = ["exclusive", "reverse"].map(|name| call.int(name, 0) == 1);
    let found = along(input, axis, |row| {
        if reverses {
            row.reverse();
        }
        let mut sum = 0.0;
        for x in row.iter_mut() {
            let before = sum;
            sum += *x;
            *x = if excludes { before } else { sum };
        }
        if reverses {
            row.reverse();
        }
    })?;
    let is_whole = matches!(input.numbers, Numbers::Whole(_));
    one(if is_whole { Tensor::whole(found.shape.clone(), found.to_wholes()) } else { found })
}

/// Makes a row's mean 0, unless it is kept, and its variance 1.
fn normalise(row: &mut [f64], epsilon: f64, keeps_mean: bool) {
    let middle = if keeps_mean { 0.0 } else { mean(row) };
    row.iter_mut().for_each(|x| *x -= middle);
    let deviation = (square_sum(row) / row.len() as f64 + epsilon).sqrt();
    row.iter_mut().for_each(|x| *x /= deviation);
}

/// Numbers times a scale, and a bias added, both repeated to them.
fn scaled(tensor: Tensor, scale: &Tensor, bias: Option<&Tensor>) -> Result<Tensor, Failure> {
    let scale = scale.spread(&tensor.shape)?.to_reals();
    let bias = bias.map(|bias| bias.spread(&tensor.shape)).transpose()?;
    let bias = bias.map_or_else(|| vec![0.0; tensor.len()], |bias| bias.to_reals());
    let numbers = tensor.to_reals().into_iter().zip(scale).zip(bias);
    let numbers = numbers.map(|((x, scale), bias)| x * scale + bias).collect();
    Ok(Tensor::real(tensor.shape, numbers))
}

fn layer_norm(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    let axis = input.axis(call.int("axis", -1))?;
    let epsilon = call.float("epsilon", 1e-5);
    let keeps_mean = call.operator() == "RMSNormalization";
    let mut numbers = input.to_reals();
    let row = count(&input.shape[axis..]).max(1);
    numbers.chunks_mut(row).for_each(|row| normalise(row, epsilon, keeps_mean));
    one(scaled(Tensor::real(input.shape.clone(), numbers), call.input(1)?, call.given(2))?)
}

/// Numbers of a channel as a shape that is repeated over pictures.
fn by_channel(tensor: &Tensor, rank: usize) -> Result<Tensor, Failure> {
    let mut shape = vec![1; rank.saturating_sub(1)];
    if let Some(first) = shape.first_mut() {
        *first = tensor.len();
    }
    tensor.clone().reshaped(shape)
}

fn batch_norm(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    if call.int("training_mode", 0) == 1 {
        return Err("uses the means of training".into());
    }
    let parameter = |index: usize| -> Result<Vec<f64>, Failure> {
        Ok(by_channel(call.input(index)?, input.rank())?.spread(&input.shape)?.to_reals())
    };
    let [scale, bias, middle, variance] = [1, 2, 3, 4].map(parameter);
    let (scale, bias, middle, variance) = (scale?, bias?, middle?, variance?);
    let epsilon = call.float("epsilon", 1e-5);
    let number = |(at, x): (usize, &f64)| {
        scale[at] * (x - middle[at]) / (variance[at] + epsilon).sqrt() + bias[at]
    };
    one(Tensor::real(input.shape.clone(), input.reals()?.iter().enumerate().map(number).collect()))
}

fn group_norm(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    let [batch, channels, sizes @ ..] = &input.shape[..] else {
        return Err("needs pictures".into());
    };
    let (channels, is_group) = (*channels, call.operator() == "GroupNormalization");
    let groups = if is_group { call.int("num_groups", 1).max(1) as usize } else { channels };
    let epsilon = call.float("epsilon", 1e-5);
    let row = channels / groups * count(sizes);
    let mut numbers = input.to_reals();
    numbers
        .chunks_mut(row.max(1))
        .take(batch * groups)
        .for_each(|row| normalise(row, epsilon, false));
    // Before version 21 a group has one scale for all of its channels.
    let parameter = |index: usize| -> Result<Tensor, Failure> {
        let given = call.input(index)?;
        if given.len() == channels {
            return by_channel(given, input.rank());
        }
        let places: Vec<usize> =
            (0..channels).map(|channel| channel * given.len() / channels).collect();
        by_channel(&given.at(vec![channels], &places), input.rank())
    };
    one(scaled(Tensor::real(input.shape.clone(), numbers), &parameter(1)?, Some(&parameter(2)?))?)
}

fn lp_norm(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    let axis = input.axis(call.int("axis", -1))?;
    let kind = match (call.operator(), call.text("norm", "MAX"), call.int("p", 2)) {
        ("Normalizer", kind, _) => kind,
        (_, _, 1) => "L1",
        _ => "L2",
    };
    one(along(input, axis, |row| {
        let norm = match kind {
            "L1" => row.iter().map(|x| x.abs()).sum::<f64>(),
            "L2" => square_sum(row).sqrt(),
            _ => row.iter().map(|x| x.abs()).fold(0.0, larger),
        };
        // A row of zeros stays one.
        if norm != 0.0 {
            row.iter_mut().for_each(|x| *x /= norm);
        }
    })?)
}

fn mean_variance(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    let axes = call.ints("axes").unwrap_or(&[0, 2, 3]);
    let axes: Vec<usize> = axes.iter().map(|axis| input.axis(*axis)).collect::<Result<_, _>>()?;
    let others: Vec<usize> = (0..input.rank()).filter(|axis| !axes.contains(axis)).collect();
    let order: Vec<usize> = others.iter().chain(&axes).copied().collect();
    let turned = transposed(input, &order);
    let row = axes.iter().map(|axis| input.shape[*axis]).product::<usize>();
    let mut numbers = turned.to_reals();
    numbers.chunks_mut(row.max(1)).for_each(|row| normalise(row, 1e-9, false));
    let back: Vec<usize> = (0..order.len())
        .map(|axis| order.iter().position(|from| *from == axis).unwrap_or(0))
        .collect();
    one(transposed(&Tensor::real(turned.shape, numbers), &back))
}

/// Pictures of another size, each pixel from the nearest or from those around it.
fn resize(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    let is_old = call.operator() == "Upsample" || call.version < 11;
    let scales = match (is_old, call.attribute("scales")) {
        (true, Some(scales)) => Some(scales.floats.iter().map(|x| f64::from(*x)).collect()),
        (true, None) => call.given(1).map(Tensor::to_reals),
        (false, _) => call.given(2).map(Tensor::to_reals).filter(|scales| !scales.is_empty()),
    };
    let wanted = call.given(3).map(Tensor::to_wholes);
    let axes: Vec<usize> = match call.ints("axes") {
        Some(axes) => axes.iter().map(|axis| input.axis(*axis)).collect::<Result<_, _>>()?,
        None => (0..input.rank()).collect(),
    };
    let mode = call.text("mode", "nearest");
    let how = if is_old {
        "asymmetric"
    } else {
        call.text("coordinate_transformation_mode", "half_pixel")
    };
    let nearest = if is_old { "floor" } else { call.text("nearest_mode", "round_prefer_floor") };
    let mut found = input.clone();
    for (index, axis) in axes.iter().enumerate() {
        let size = input.shape[*axis];
        let (length, scale) = match (&scales, &wanted) {
            (Some(scales), _) => {
                let scale = *scales.get(index).ok_or("has too few scales")?;
                ((size as f64 * scale).floor() as usize, scale)
            }
            (None, Some(wanted)) => {
                let length = *wanted.get(index).ok_or("has too few sizes")? as usize;
                (length, length as f64 / size as f64)
            }
            _ => return Err("has neither scales nor sizes".into()),
        };
        let from = |at: usize| {
            let at = at as f64;
            match how {
                "asymmetric" => at / scale,
                "align_corners" if length > 1 => at * (size as f64 - 1.0) / (length as f64 - 1.0),
                "align_corners" => 0.0,
                "pytorch_half_pixel" if length <= 1 => 0.0,
                _ => (at + 0.5) / scale - 0.5,
            }
        };
        if length == size && scale == 1.0 {
            continue;
        }
        if !["asymmetric", "align_corners", "pytorch_half_pixel", "half_pixel"].contains(&how) {
            return Err(format!("has the coordinates {how}").into());
        }
        found = resized(&found, *axis, length, mode, nearest, from)?;
    }
    one(found)
}

fn resized(
    input: &Tensor,
    axis: usize,
    length: usize,
    mode: &str,
    nearest: &str,
    from: impl Fn(usize) -> f64,
) -> Result<Tensor, Failure> {
    let [outer, size, inner] = around(&input.shape, axis);
    let numbers = input.to_reals();
    let within = |at: f64| at.clamp(0.0, size as f64 - 1.0) as usize;
    let mut found = Vec::with_capacity(outer * length * inner);
    for outer in 0..outer {
        for at in 0..length {
            let place = from(at);
            let (low, high, share) = match mode {
                "nearest" => {
                    let place = match nearest {
                        "floor" => place.floor(),
                        "ceil" => place.ceil(),
                        "round_prefer_ceil" => (place + 0.5).floor(),
                        _ => (place - 0.5).ceil(),
                    };
                    (within(place), within(place), 0.0)
                }
                "linear" | "bilinear" => {
                    let place = place.clamp(0.0, size as f64 - 1.0);
                    (within(place.floor()), within(place.floor() + 1.0), place.fract())
                }
                other => return Err(format!("has the mode {other}").into()),
            };
            for at in 0..inner {
                let number = |row: usize| numbers[(outer * size + row) * inner + at];
                found.push(number(low) * (1.0 - share) + number(high) * share);
            }
        }
    }
    let mut shape = input.shape.clone();
    shape[axis] = length;
    Ok(Tensor::real(shape, found))
}
