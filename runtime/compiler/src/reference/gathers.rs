//! Operators that take numbers from places which other inputs name, or put them there.

use super::tensor::{Failure, Numbers, Tensor, count, places, strides};
use super::{Call, Found, around, one};

pub(super) fn evaluate(call: &Call<'_>) -> Found {
    match call.operator() {
        "Gather" => gather(call),
        "GatherElements" => gather_elements(call),
        "GatherND" => gather_nd(call),
        "ScatterElements" | "Scatter" => scatter_elements(call),
        "ScatterND" => scatter_nd(call),
        _ => Ok(None),
    }
}

/// A place along an axis, counted from the end where it is negative.
fn place_of(at: i64, size: usize) -> Result<usize, Failure> {
    let from_front = if at < 0 { at + size as i64 } else { at };
    let place = usize::try_from(from_front).ok().filter(|place| *place < size);
    place.ok_or_else(|| format!("takes place {at} of {size}").into())
}

fn gather(call: &Call<'_>) -> Found {
    let (input, wanted) = (call.input(0)?, call.input(1)?);
    let axis = input.axis(call.int("axis", 0))?;
    let [outer, size, inner] = around(&input.shape, axis);
    let rows = wanted.wholes()?.iter().map(|at| place_of(*at, size));
    let rows: Vec<usize> = rows.collect::<Result<_, _>>()?;
    let mut places = Vec::new();
    for outer in 0..outer {
        for row in &rows {
            let first = (outer * size + row) * inner;
            places.extend(first..first + inner);
        }
    }
    let shape = [&input.shape[..axis], &wanted.shape, &input.shape[axis + 1..]].concat();
    one(input.at(shape, &places))
}

/// For every number of `indices` its place in a tensor of the given sizes, the axis' own place replaced.
fn element_places(shape: &[usize], axis: usize, indices: &Tensor) -> Result<Vec<usize>, Failure> {
    let mut along = strides(shape);
    let stride = std::mem::replace(&mut along[axis], 0) as usize;
    let bases = places(&indices.shape, &along, 0).into_iter();
    let place = |(base, at): (usize, &i64)| Ok(base + stride * place_of(*at, shape[axis])?);
    bases.zip(indices.wholes()?).map(place).collect()
}

fn gather_elements(call: &Call<'_>) -> Found {
    let (input, indices) = (call.input(0)?, call.input(1)?);
    let axis = input.axis(call.int("axis", 0))?;
    one(input.at(indices.shape.clone(), &element_places(&input.shape, axis, indices)?))
}

/// For every row of `indices` the place where what it names begins, and how much it is.
fn nd_places(
    input: &Tensor,
    indices: &Tensor,
    batch: usize,
) -> Result<(Vec<usize>, usize), Failure> {
    let depth = indices.shape.last().copied().ok_or("has no indices")?;
    let named = batch..batch + depth;
    if named.end > input.rank() {
        return Err("names more axes than there are".into());
    }
    let inner = count(&input.shape[named.end..]);
    let in_batch = count(&input.shape[batch..]);
    let rows = count(&indices.shape[..indices.rank() - 1]);
    let per_batch = rows / count(&input.shape[..batch]).max(1);
    let along = strides(&input.shape);
    let numbers = indices.wholes()?;
    let begin = |row: usize| {
        let mut place = row / per_batch.max(1) * in_batch;
        for (axis, at) in named.clone().zip(&numbers[row * depth..]) {
            place += along[axis] as usize * place_of(*at, input.shape[axis])?;
        }
        Ok(place)
    };
    Ok(((0..rows).map(begin).collect::<Result<_, Failure>>()?, inner))
}

fn gather_nd(call: &Call<'_>) -> Found {
    let (input, indices) = (call.input(0)?, call.input(1)?);
    let batch = call.int("batch_dims", 0) as usize;
    let (begins, inner) = nd_places(input, indices, batch)?;
    let places: Vec<usize> = begins.iter().flat_map(|begin| *begin..begin + inner).collect();
    let depth = indices.shape.last().copied().unwrap_or(0);
    let rows = &indices.shape[..indices.rank() - 1];
    one(input.at([rows, &input.shape[batch + depth..]].concat(), &places))
}

fn scatter_elements(call: &Call<'_>) -> Found {
    let (input, indices, updates) = (call.input(0)?, call.input(1)?, call.input(2)?);
    let axis = input.axis(call.int("axis", 0))?;
    let places = element_places(&input.shape, axis, indices)?;
    scattered(call, input, updates, &places)
}

fn scatter_nd(call: &Call<'_>) -> Found {
    let (input, indices, updates) = (call.input(0)?, call.input(1)?, call.input(2)?);
    let (begins, inner) = nd_places(input, indices, 0)?;
    let places: Vec<usize> = begins.iter().flat_map(|begin| *begin..begin + inner).collect();
    scattered(call, input, updates, &places)
}

fn scattered(call: &Call<'_>, input: &Tensor, updates: &Tensor, places: &[usize]) -> Found {
    if updates.len() != places.len() {
        return Err("has not as many updates as places".into());
    }
    let reduction = call.text("reduction", "none");
    if let ("none", shape) = (reduction, &input.shape) {
        let mut from: Vec<(usize, usize)> = (0..input.len()).map(|at| (0, at)).collect();
        for (at, place) in places.iter().enumerate() {
            from[*place] = (1, at);
        }
        return one(Tensor::of_parts(shape.clone(), &[input, updates], &from)?);
    }
    let together: fn(f64, f64) -> f64 = match reduction {
        "add" => |a, b| a + b,
        "mul" => |a, b| a * b,
        "max" => f64::max,
        "min" => f64::min,
        other => return Err(format!("has the reduction {other}").into()),
    };
    let mut numbers = input.to_reals();
    for (place, update) in places.iter().zip(updates.to_reals()) {
        numbers[*place] = together(numbers[*place], update);
    }
    let found = Tensor::real(input.shape.clone(), numbers);
    let is_whole = matches!(input.numbers, Numbers::Whole(_));
    one(if is_whole { Tensor::whole(found.shape.clone(), found.to_wholes()) } else { found })
}
