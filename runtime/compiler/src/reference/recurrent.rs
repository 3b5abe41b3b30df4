//! Recurrent units: RNN, GRU and LSTM, in both directions.

use super::elementwise::sigmoid;
use super::moves::transposed;
use super::tensor::{Failure, Tensor};
use super::{Call, Found};

/// A function of a gate.
type Function = fn(f64) -> f64;

pub(super) fn evaluate(call: &Call<'_>) -> Found {
    let (gates, usual): (usize, &[&str]) = match call.operator() {
        "RNN" => (1, &["Tanh"]),
        "GRU" => (3, &["Sigmoid", "Tanh"]),
        "LSTM" => (4, &["Sigmoid", "Tanh", "Tanh"]),
        _ => return Ok(None),
    };
    let is_batch_first = call.int("layout", 0) == 1;
    let input = call.input(0)?;
    let input = if is_batch_first { transposed(input, &[1, 0, 2]) } else { input.clone() };
    let [turns, batch, width] = input.shape[..] else { return Err("needs histories".into()) };
    let hidden = call.int("hidden_size", 0).max(1) as usize;
    let directions: &[bool] = match call.text("direction", "forward") {
        "reverse" => &[true],
        "bidirectional" => &[false, true],
        _ => &[false],
    };
    if call.attribute("clip").is_some() || call.int("input_forget", 0) != 0 {
        return Err("clips its gates or couples them".into());
    }
    let lengths = match call.given(4) {
        Some(lengths) => lengths.to_wholes().iter().map(|length| *length as usize).collect(),
        None => vec![turns; batch],
    };
    let functions = functions(call, usual, directions.len())?;
    let state = |index: usize| -> Result<Vec<f64>, Failure> {
        let Some(state) = call.given(index) else {
            return Ok(vec![0.0; directions.len() * batch * hidden]);
        };
        Ok(if is_batch_first { transposed(state, &[1, 0, 2]) } else { state.clone() }.to_reals())
    };
    let (mut states, mut cells) = (state(5)?, state(6)?);
    let mut history = vec![0.0; turns * directions.len() * batch * hidden];
    for (direction, is_reverse) in directions.iter().enumerate() {
        let unit = Unit::of(call, direction, [gates, hidden, width], &functions[direction])?;
        for row in 0..batch {
            let place = (direction * batch + row) * hidden;
            let (state, cell) = (&mut states[place..][..hidden], &mut cells[place..][..hidden]);
            let length = lengths.get(row).copied().unwrap_or(turns).min(turns);
            for turn in 0..length {
                let turn = if *is_reverse { length - 1 - turn } else { turn };
                let x = &input.reals()?[(turn * batch + row) * width..][..width];
                unit.step(x, state, cell);
                let to = ((turn * directions.len() + direction) * batch + row) * hidden;
                history[to..to + hidden].copy_from_slice(state);
            }
        }
    }
    let history = Tensor::real(vec![turns, directions.len(), batch, hidden], history);
    let last = |numbers| Tensor::real(vec![directions.len(), batch, hidden], numbers);
    let mut found = vec![history, last(states), last(cells)];
    if is_batch_first {
        found = vec![
            transposed(&found[0], &[2, 0, 1, 3]),
            transposed(&found[1], &[1, 0, 2]),
            transposed(&found[2], &[1, 0, 2]),
        ];
    }
    Ok(Some(found))
}

/// The functions of every direction's gates.
fn functions(
    call: &Call<'_>,
    usual: &[&str],
    directions: usize,
) -> Result<Vec<Vec<Function>>, Failure> {
    let named = call.attribute("activations").map(|attribute| {
        attribute.strings.iter().map(|name| String::from_utf8_lossy(name).into_owned()).collect()
    });
    let names: Vec<String> = named.unwrap_or_else(|| {
        usual.iter().cycle().take(usual.len() * directions).map(|name| (*name).to_owned()).collect()
    });
    let function = |name: &String| -> Result<Function, Failure> {
        Ok(match name.as_str() {
            "Sigmoid" => sigmoid,
            "Tanh" => f64::tanh,
            "Relu" => |x| x.max(0.0),
            "HardSigmoid" => |x| (0.2 * x + 0.5).clamp(0.0, 1.0),
            "Softsign" => |x| x / (1.0 + x.abs()),
            other => return Err(format!("has the function {other}").into()),
        })
    };
    let all: Vec<Function> = names.iter().map(function).collect::<Result<_, _>>()?;
    if all.len() != usual.len() * directions {
        return Err("names too few functions".into());
    }
    Ok(all.chunks(usual.len()).map(<[Function]>::to_vec).collect())
}

/// The weights of one direction.
struct Unit<'a> {
    of_input: &'a [f64],
    of_state: &'a [f64],
    input_bias: Vec<f64>,
    state_bias: Vec<f64>,
    /// Of the input, forget and output gates, by which an LSTM's cells are looked at.
    peepholes: Option<&'a [f64]>,
    functions: &'a [Function],
    gates: usize,
    hidden: usize,
    /// Whether a GRU's reset gate acts behind the product with the state.
    resets_product: bool,
}

impl<'a> Unit<'a> {
    fn of(
        call: &'a Call<'_>,
        direction: usize,
        [gates, hidden, width]: [usize; 3],
        functions: &'a [Function],
    ) -> Result<Self, Failure> {
        let part = |tensor: &'a Tensor, length: usize| -> Result<&'a [f64], Failure> {
            let part = tensor.reals()?.get(direction * length..(direction + 1) * length);
            part.ok_or_else(|| "has weights of other sizes".into())
        };
        let rows = gates * hidden;
        let biases = call.given(3).map(|biases| part(biases, 2 * rows)).transpose()?;
        let bias = |which: usize| {
            biases.map_or_else(|| vec![0.0; rows], |biases| biases[which * rows..][..rows].to_vec())
        };
        let peepholes = call.given(7).map(|peepholes| part(peepholes, 3 * hidden)).transpose()?;
        Ok(Self {
            of_input: part(call.input(1)?, rows * width)?,
            of_state: part(call.input(2)?, rows * hidden)?,
            input_bias: bias(0),
            state_bias: bias(1),
            peepholes,
            functions,
            gates,
            hidden,
            resets_product: call.int("linear_before_reset", 0) != 0,
        })
    }

    /// The next state, and an LSTM's next cells.
    fn step(&self, x: &[f64], state: &mut [f64], cell: &mut [f64]) {
        let hidden = self.hidden;
        let from_input = sums(self.of_input, x, &self.input_bias);
        let from_state = sums(self.of_state, state, &self.state_bias);
        // The gates of one hidden unit stand `hidden` rows apart.
        let gate = |gate: usize, unit: usize| {
            from_input[gate * hidden + unit] + from_state[gate * hidden + unit]
        };
        let f = |index: usize, x: f64| self.functions[index](x);
        match self.gates {
            1 => (0..hidden).for_each(|unit| state[unit] = f(0, gate(0, unit))),
            3 => {
                let reset: Vec<f64> = (0..hidden).map(|unit| f(0, gate(1, unit))).collect();
                let kept: Vec<f64> = reset.iter().zip(&*state).map(|(r, h)| r * h).collect();
                let last = 2 * hidden;
                let of_kept =
                    sums(&self.of_state[last * hidden..], &kept, &self.state_bias[last..]);
                for unit in 0..hidden {
                    let from_state = match self.resets_product {
                        true => reset[unit] * from_state[last + unit],
                        false => of_kept[unit],
                    };
                    let update = f(0, gate(0, unit));
                    let fresh = f(1, from_input[last + unit] + from_state);
                    state[unit] = (1.0 - update) * fresh + update * state[unit];
                }
            }
            // Input, output, forget and cell gates.
            _ => {
                for unit in 0..hidden {
                    let look = |which: usize, cell: f64| {
                        self.peepholes.map_or(0.0, |all| all[which * hidden + unit] * cell)
                    };
                    let enter = f(0, gate(0, unit) + look(0, cell[unit]));
                    let forget = f(0, gate(2, unit) + look(2, cell[unit]));
                    cell[unit] = forget * cell[unit] + enter * f(1, gate(3, unit));
                    let leave = f(0, gate(1, unit) + look(1, cell[unit]));
                    state[unit] = leave * f(2, cell[unit]);
                }
            }
        }
    }
}

/// A matrix, row by row, times a vector, and a bias.
fn sums(matrix: &[f64], vector: &[f64], bias: &[f64]) -> Vec<f64> {
    let rows = matrix.chunks(vector.len().max(1));
    let dot = |(row, bias): (&[f64], &f64)| {
        bias + row.iter().zip(vector).map(|(weight, x)| weight * x).sum::<f64>()
    };
    rows.zip(bias).map(dot).collect()
}
