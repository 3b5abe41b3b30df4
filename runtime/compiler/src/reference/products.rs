//! Operators that add up products: matrices, convolutions and attention; and pools, which walk as convolutions do.

use std::borrow::Cow;

use super::elementwise::larger;
use super::tensor::{Failure, Tensor, common_shape, count, places, spread_strides, strides};
use super::{Call, Found, one};

pub(super) fn evaluate(call: &Call<'_>) -> Found {
    match call.operator() {
        "MatMul" => one(product(call.input(0)?, call.input(1)?)?),
        "Gemm" => gemm(call),
        "Einsum" => einsum(call),
        "Conv" => one(convolution(call, call.input(0)?, call.input(1)?, call.given(2))?),
        "ConvTranspose" => convolve_transposed(call),
        "MaxPool" | "AveragePool" | "LpPool" => pool(call),
        "Attention" => attention(call),
        _ => Ok(None),
    }
}

/// The product of matrices, whose leading sizes are repeated to each other; a vector is a row in front, a column behind.
pub(super) fn product(a: &Tensor, b: &Tensor) -> Result<Tensor, Failure> {
    let (is_row, is_column) = (a.rank() == 1, b.rank() == 1);
    let (a, b) = (as_matrix(a, vec![1, a.len()])?, as_matrix(b, vec![b.len(), 1])?);
    let ([a_lead @ .., m, k], [b_lead @ .., rows, n]) = (&a.shape[..], &b.shape[..]) else {
        return Err("needs matrices".into());
    };
    let (m, k, n) = (*m, *k, *n);
    if k != *rows {
        return Err(format!("multiplies {:?} by {:?}", a.shape, b.shape).into());
    }
    let lead = common_shape(a_lead, b_lead)?;
    // Where the matrices of both begin, which are repeated to each other.
    let begins = |own: &[usize], size: usize| -> Result<Vec<usize>, Failure> {
        let along = spread_strides(own, &lead)?;
        Ok(places(&lead, &along, 0).iter().map(|matrix| matrix * size).collect())
    };
    let begins = begins(a_lead, m * k)?.into_iter().zip(begins(b_lead, k * n)?);
    let (a, b) = (a.reals()?, b.reals()?);
    let mut numbers = vec![0.0; count(&lead) * m * n];
    for ((a_begin, b_begin), product) in begins.zip(numbers.chunks_mut((m * n).max(1))) {
        let (a, b) = (&a[a_begin..][..m * k], &b[b_begin..][..k * n]);
        for (row, sums) in a.chunks(k.max(1)).zip(product.chunks_mut(n.max(1))) {
            for (factor, others) in row.iter().zip(b.chunks(n.max(1))) {
                sums.iter_mut().zip(others).for_each(|(sum, other)| *sum += factor * other);
            }
        }
    }
    let mut shape = lead;
    shape.extend((!is_row).then_some(m));
    shape.extend((!is_column).then_some(n));
    Ok(Tensor::real(shape, numbers))
}

fn as_matrix(tensor: &Tensor, shape: Vec<usize>) -> Result<Cow<'_, Tensor>, Failure> {
    match tensor.rank() {
        1 => tensor.clone().reshaped(shape).map(Cow::Owned),
        _ => Ok(Cow::Borrowed(tensor)),
    }
}

/// The same with rows and columns of the last two sizes exchanged.
fn turned(tensor: &Tensor, is_turned: bool) -> Tensor {
    if !is_turned {
        return tensor.clone();
    }
    let mut order: Vec<usize> = (0..tensor.rank()).collect();
    order.swap(tensor.rank() - 2, tensor.rank() - 1);
    super::moves::transposed(tensor, &order)
}

fn gemm(call: &Call<'_>) -> Found {
    let (a, b) = (call.input(0)?, call.input(1)?);
    if (a.rank(), b.rank()) != (2, 2) {
        return Err("needs matrices".into());
    }
    let a = turned(a, call.int("transA", 0) != 0);
    let b = turned(b, call.int("transB", 0) != 0);
    let (alpha, beta) = (call.float("alpha", 1.0), call.float("beta", 1.0));
    let mut found = product(&a, &b)?;
    let bias = call.given(2).map(|bias| bias.spread(&found.shape)).transpose()?;
    let bias = bias.map_or_else(|| vec![0.0; found.len()], |bias| bias.to_reals());
    let sums = found.to_reals().into_iter().zip(bias);
    found = Tensor::real(found.shape, sums.map(|(sum, bias)| alpha * sum + beta * bias).collect());
    one(found)
}

fn einsum(call: &Call<'_>) -> Found {
    let equation: String = call.text("equation", "").chars().filter(|c| *c != ' ').collect();
    let (left, right) = match equation.split_once("->") {
        Some((left, right)) => (left.to_owned(), right.to_owned()),
        // Without an output the letters that stand once, in their order.
        None => {
            let once = |letter: &char| equation.matches(*letter).count() == 1;
            let mut letters: Vec<char> =
                equation.chars().filter(|c| c.is_alphabetic()).filter(once).collect();
            letters.sort_unstable();
            (equation.clone(), letters.into_iter().collect())
        }
    };
    if equation.contains('.') {
        return Err("has an ellipsis in its equation".into());
    }
    let terms: Vec<Vec<char>> = left.split(',').map(|term| term.chars().collect()).collect();
    let wanted: Vec<char> = right.chars().collect();
    let mut letters = wanted.clone();
    for letter in terms.iter().flatten() {
        if !letters.contains(letter) {
            letters.push(*letter);
        }
    }
    let mut shape = vec![1; letters.len()];
    let mut factors = Vec::new();
    for (index, term) in terms.iter().enumerate() {
        let input = call.input(index)?;
        if term.len() != input.rank() {
            return Err(format!("its equation does not fit {:?}", input.shape).into());
        }
        let mut along = vec![0; letters.len()];
        for ((letter, size), stride) in term.iter().zip(&input.shape).zip(strides(&input.shape)) {
            let axis = letters.iter().position(|other| other == letter).unwrap_or(0);
            // A letter twice in a term is a diagonal.
            along[axis] += if *size == 1 { 0 } else { stride };
            shape[axis] = shape[axis].max(*size);
        }
        factors.push((input.to_reals(), along));
    }
    let all: Vec<Vec<f64>> = factors
        .iter()
        .map(|(numbers, along)| places(&shape, along, 0).iter().map(|at| numbers[*at]).collect())
        .collect();
    let (kept, summed) = shape.split_at(wanted.len());
    let inner = count(summed);
    let term = |at: usize| all.iter().map(|factor| factor[at]).product::<f64>();
    let sum = |row: usize| (row * inner..(row + 1) * inner).map(term).sum();
    one(Tensor::real(kept.to_vec(), (0..count(kept)).map(sum).collect()))
}

/// How a window walks over a picture of any number of sizes.
struct Walk {
    kernel: Vec<usize>,
    strides: Vec<usize>,
    dilations: Vec<usize>,
    /// Room before each size; what is behind follows from the output.
    before: Vec<i64>,
    input: Vec<usize>,
    output: Vec<usize>,
}

impl Walk {
    fn of(call: &Call<'_>, input: &[usize], kernel: &[usize]) -> Result<Self, Failure> {
        let rank = input.len();
        let numbers = |name: &str, usual: i64| {
            let given = call.ints(name).unwrap_or_default();
            (0..rank)
                .map(|axis| given.get(axis).copied().unwrap_or(usual).max(1) as usize)
                .collect()
        };
        let (strides, dilations): (Vec<usize>, Vec<usize>) =
            (numbers("strides", 1), numbers("dilations", 1));
        let given = call.ints("pads").unwrap_or_default();
        let pad = |index: usize| given.get(index).copied().unwrap_or(0);
        let ceil = call.int("ceil_mode", 0) == 1;
        let automatic = call.text("auto_pad", "NOTSET");
        let (mut before, mut output) = (Vec::new(), Vec::new());
        for axis in 0..rank {
            let reach = (dilations[axis] * (kernel[axis] - 1) + 1) as i64;
            let (size, stride) = (input[axis] as i64, strides[axis] as i64);
            let (front, steps) = match automatic {
                "SAME_UPPER" | "SAME_LOWER" => {
                    let steps = (size + stride - 1) / stride;
                    let room = ((steps - 1) * stride + reach - size).max(0);
                    (if automatic == "SAME_UPPER" { room / 2 } else { (room + 1) / 2 }, steps)
                }
                _ => {
                    let valid = automatic == "VALID";
                    let [front, back] = if valid { [0, 0] } else { [pad(axis), pad(axis + rank)] };
                    let room = size + front + back - reach;
                    let mut steps =
                        if ceil { (room + stride - 1) / stride } else { room / stride } + 1;
                    // A window that would begin behind the picture and its room in front is none.
                    if ceil && (steps - 1) * stride >= size + front {
                        steps -= 1;
                    }
                    (front, steps)
                }
            };
            before.push(front);
            output
                .push(usize::try_from(steps).map_err(|_| "has a window larger than its picture")?);
        }
        let kernel = kernel.to_vec();
        Ok(Self { kernel, strides, dilations, before, input: input.to_vec(), output })
    }

    /// The places of a window in the picture, none where it is outside.
    fn window(&self, step: usize) -> Vec<Option<usize>> {
        let step = digits(step, &self.output);
        let place = |at: usize| {
            let at = digits(at, &self.kernel);
            let mut place = 0;
            for axis in 0..self.input.len() {
                let within = (step[axis] * self.strides[axis] + at[axis] * self.dilations[axis])
                    as i64
                    - self.before[axis];
                let within = usize::try_from(within).ok().filter(|at| *at < self.input[axis])?;
                place = place * self.input[axis] + within;
            }
            Some(place)
        };
        (0..count(&self.kernel)).map(place).collect()
    }
}

/// A flat place as a place along each size.
fn digits(mut at: usize, sizes: &[usize]) -> Vec<usize> {
    let mut digits = vec![0; sizes.len()];
    for (digit, size) in digits.iter_mut().zip(sizes).rev() {
        (*digit, at) = (at % size, at / size);
    }
    digits
}

/// Sizes of pictures: how many, channels, and how large.
fn picture(input: &Tensor) -> Result<(usize, usize, &[usize]), Failure> {
    match &input.shape[..] {
        [batch, channels, sizes @ ..] => Ok((*batch, *channels, sizes)),
        _ => Err("needs pictures".into()),
    }
}

/// Windows of pictures times filters, group by group.
pub(super) fn convolution(
    call: &Call<'_>,
    input: &Tensor,
    weights: &Tensor,
    bias: Option<&Tensor>,
) -> Result<Tensor, Failure> {
    let (batch, channels, sizes) = picture(input)?;
    let (filters, group_channels, kernel) = picture(weights)?;
    let groups = call.int("group", 1).max(1) as usize;
    if kernel.len() != sizes.len() || channels != groups * group_channels || filters % groups != 0 {
        return Err(format!("convolves {:?} with {:?}", input.shape, weights.shape).into());
    }
    let walk = Walk::of(call, sizes, kernel)?;
    let (pixels, steps, taps) = (count(sizes), count(&walk.output), count(kernel));
    let (numbers, weights) = (input.reals()?, weights.reals()?);
    let bias = bias.map(|bias| bias.reals()).transpose()?;
    let mut found = vec![0.0; batch * filters * steps];
    let (group_filters, length) = (filters / groups, group_channels * taps);
    for step in 0..steps {
        let window = walk.window(step);
        for (picture, group) in (0..batch).flat_map(|at| (0..groups).map(move |group| (at, group)))
        {
            let first = (picture * groups + group) * group_channels * pixels;
            let planes = numbers[first..][..group_channels * pixels].chunks(pixels.max(1));
            let tap =
                |plane: &[f64], place: &Option<usize>| place.map_or(0.0, |place| plane[place]);
            let patch: Vec<f64> = planes
                .flat_map(|plane| window.iter().map(move |place| tap(plane, place)))
                .collect();
            for filter in group * group_filters..(group + 1) * group_filters {
                let weights = &weights[filter * length..][..length];
                let sum: f64 = patch.iter().zip(weights).map(|(x, weight)| x * weight).sum();
                let bias = bias.map_or(0.0, |bias| bias[filter]);
                found[(picture * filters + filter) * steps + step] = sum + bias;
            }
        }
    }
    Ok(Tensor::real([&[batch, filters], &walk.output[..]].concat(), found))
}

/// Every pixel spreads its window over the output.
fn convolve_transposed(call: &Call<'_>) -> Found {
    let (input, weights) = (call.input(0)?, call.input(1)?);
    let (batch, channels, sizes) = picture(input)?;
    let (_, group_filters, kernel) = picture(weights)?;
    let groups = call.int("group", 1).max(1) as usize;
    let rank = sizes.len();
    let numbers = |name: &str, usual: i64, index: usize| {
        call.ints(name).and_then(|given| given.get(index)).copied().unwrap_or(usual)
    };
    let (mut output, mut before) = (Vec::new(), Vec::new());
    for axis in 0..rank {
        let (stride, dilation) = (numbers("strides", 1, axis), numbers("dilations", 1, axis));
        let reach = dilation * (kernel[axis] as i64 - 1) + 1;
        let full = stride * (sizes[axis] as i64 - 1) + numbers("output_padding", 0, axis) + reach;
        let [mut front, mut back] = [axis, axis + rank].map(|index| numbers("pads", 0, index));
        let automatic = call.text("auto_pad", "NOTSET");
        let asked = call
            .ints("output_shape")
            .and_then(|given| given.get(given.len().wrapping_sub(rank) + axis).copied());
        let asked =
            asked.or_else(|| automatic.starts_with("SAME").then(|| sizes[axis] as i64 * stride));
        if let Some(asked) = asked {
            let room = (full - asked).max(0);
            front = if automatic == "SAME_UPPER" { room / 2 } else { room - room / 2 };
            back = full - asked - front;
        }
        before.push(front);
        output.push((full - front - back).max(0) as usize);
    }
    let filters = groups * group_filters;
    let (pixels, steps, taps) = (count(sizes), count(&output), count(kernel));
    let (given, weights) = (input.reals()?, weights.reals()?);
    let bias = call.given(2).map(|bias| bias.reals()).transpose()?;
    let mut found: Vec<f64> = (0..batch * filters * steps)
        .map(|at| bias.map_or(0.0, |bias| bias[at / steps % filters]))
        .collect();
    for pixel in 0..pixels {
        let from = digits(pixel, sizes);
        for tap in 0..taps {
            let at = digits(tap, kernel);
            let mut place = Some(0);
            for axis in 0..rank {
                let along = from[axis] as i64 * numbers("strides", 1, axis)
                    + at[axis] as i64 * numbers("dilations", 1, axis)
                    - before[axis];
                let along = usize::try_from(along).ok().filter(|along| *along < output[axis]);
                place = place.zip(along).map(|(place, along)| place * output[axis] + along);
            }
            let Some(place) = place else { continue };
            for picture in 0..batch {
                for channel in 0..channels {
                    let number = given[(picture * channels + channel) * pixels + pixel];
                    let group = channel / (channels / groups);
                    for filter in 0..group_filters {
                        let weight = weights[(channel * group_filters + filter) * taps + tap];
                        let filter = group * group_filters + filter;
                        found[(picture * filters + filter) * steps + place] += number * weight;
                    }
                }
            }
        }
    }
    one(Tensor::real([&[batch, filters], &output[..]].concat(), found))
}

fn pool(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    let (batch, channels, sizes) = picture(input)?;
    let kernel = call.ints("kernel_shape").ok_or("has no kernel_shape")?;
    let kernel: Vec<usize> = kernel.iter().map(|size| (*size).max(1) as usize).collect();
    if kernel.len() != sizes.len() {
        return Err(format!("has a kernel of {kernel:?} for {:?}", input.shape).into());
    }
    if call.node.output.get(1).is_some_and(|name| !name.is_empty()) {
        return Err("says where its largest numbers stand".into());
    }
    let walk = Walk::of(call, sizes, &kernel)?;
    let (pixels, steps) = (count(sizes), count(&walk.output));
    let numbers = input.to_reals();
    let counts_room = call.int("count_include_pad", 0) == 1;
    let power = call.int("p", 2) as f64;
    let mut found = vec![0.0; batch * channels * steps];
    for step in 0..steps {
        let window = walk.window(step);
        let inside = window.iter().flatten().count();
        let all = if counts_room { padded_taps(&walk, step, call) } else { inside };
        for plane in 0..batch * channels {
            let numbers = &numbers[plane * pixels..][..pixels];
            let inside = || window.iter().flatten().map(|place| numbers[*place]);
            found[plane * steps + step] = match call.operator() {
                "MaxPool" => inside().fold(f64::NEG_INFINITY, larger),
                "AveragePool" => inside().sum::<f64>() / all as f64,
                _ => inside().map(|x| x.abs().powf(power)).sum::<f64>().powf(1.0 / power),
            };
        }
    }
    one(Tensor::real([&[batch, channels], &walk.output[..]].concat(), found))
}

/// Numbers of a window that lie in the picture or in its room; what rounding up adds behind that does not count.
fn padded_taps(walk: &Walk, step: usize, call: &Call<'_>) -> usize {
    let rank = walk.input.len();
    let back = |axis: usize| {
        call.ints("pads").and_then(|pads| pads.get(axis + rank)).copied().unwrap_or(0)
    };
    let step = digits(step, &walk.output);
    let along = |axis: usize| {
        let end = walk.input[axis] as i64 + walk.before[axis] + back(axis);
        let taps = 0..walk.kernel[axis];
        let inside = taps.filter(|tap| {
            ((step[axis] * walk.strides[axis] + tap * walk.dilations[axis]) as i64) < end
        });
        inside.count()
    };
    (0..rank).map(along).product()
}

/// Scaled dot products, softmax, and the values mixed by it; heads may share keys and values.
fn attention(call: &Call<'_>) -> Found {
    let heads = |name: &str, tensor: &Tensor| -> Result<Tensor, Failure> {
        match tensor.shape[..] {
            [_, _, _, _] => Ok(tensor.clone()),
            [batch, rows, columns] => {
                let heads = call.int(name, 0).max(1) as usize;
                let parted = tensor.clone().reshaped(vec![batch, rows, heads, columns / heads])?;
                Ok(super::moves::transposed(&parted, &[0, 2, 1, 3]))
            }
            _ => Err("needs queries, keys and values of rank 3 or 4".into()),
        }
    };
    let (query, key) = (call.input(0)?, call.input(1)?);
    let is_flat = query.rank() == 3;
    let query = heads("q_num_heads", query)?;
    let mut key = heads("kv_num_heads", key)?;
    let mut value = heads("kv_num_heads", call.input(2)?)?;
    if let (Some(past_key), Some(past_value)) = (call.given(4), call.given(5)) {
        key = super::moves::joined(&[past_key, &key], 2)?;
        value = super::moves::joined(&[past_value, &value], 2)?;
    }
    let (present_key, present_value) = (key.clone(), value.clone());
    let (query_heads, shared) = (query.shape[1], query.shape[1] / key.shape[1].max(1));
    if shared > 1 {
        let repeated = |tensor: &Tensor| -> Result<Tensor, Failure> {
            let [batch, heads, rows, columns] = tensor.shape[..] else {
                return Err("needs heads".into());
            };
            let wide = tensor.clone().reshaped(vec![batch, heads, 1, rows, columns])?;
            wide.spread(&[batch, heads, shared, rows, columns])?.reshaped(vec![
                batch,
                query_heads,
                rows,
                columns,
            ])
        };
        (key, value) = (repeated(&key)?, repeated(&value)?);
    }
    let scale = call.attribute("scale").map(|scale| f64::from(scale.f));
    let scale = scale.unwrap_or_else(|| 1.0 / (query.shape[3] as f64).sqrt());
    let scores = product(&query, &super::moves::transposed(&key, &[0, 1, 3, 2]))?;
    let [_, _, rows, columns] = scores.shape[..] else { return Err("needs heads".into()) };
    let mut numbers: Vec<f64> = scores.to_reals().iter().map(|score| score * scale).collect();
    let cap = call.float("softcap", 0.0);
    if cap > 0.0 {
        numbers.iter_mut().for_each(|score| *score = cap * (*score / cap).tanh());
    }
    if let Some(mask) = call.given(3) {
        let is_truth = mask.truths().is_ok();
        let mask = mask.spread(&scores.shape)?.to_reals();
        for (score, mask) in numbers.iter_mut().zip(mask) {
            let added = if !is_truth {
                mask
            } else if mask == 0.0 {
                f64::NEG_INFINITY
            } else {
                0.0
            };
            *score += added;
        }
    }
    if call.int("is_causal", 0) == 1 {
        let past = columns - rows.min(columns);
        let past = if call.given(4).is_some() { past } else { 0 };
        for (at, score) in numbers.iter_mut().enumerate() {
            if at % columns > at / columns % rows + past {
                *score = f64::NEG_INFINITY;
            }
        }
    }
    // A row to which everything is masked attends to nothing.
    for row in numbers.chunks_mut(columns.max(1)) {
        match row.iter().all(|score| *score == f64::NEG_INFINITY) {
            true => row.fill(0.0),
            false => super::reductions::softmax(row),
        }
    }
    let mut found = product(&Tensor::real(scores.shape, numbers), &value)?;
    if is_flat {
        let [batch, heads, rows, columns] = found.shape[..] else {
            return Err("needs heads".into());
        };
        found = super::moves::transposed(&found, &[0, 2, 1, 3]).reshaped(vec![
            batch,
            rows,
            heads * columns,
        ])?;
    }
    Ok(Some(vec![found, present_key, present_value]))
}
