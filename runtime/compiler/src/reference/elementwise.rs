//! Operators that compute every number by itself.

use super::tensor::{Failure, Numbers, Tensor, common_shape};
use super::{Call, Found, one};

pub(super) fn evaluate(call: &Call<'_>) -> Found {
    if let Some(function) = function_of_one(call) {
        let input = call.input(0)?;
        return one(Tensor::real(
            input.shape.clone(),
            input.reals()?.iter().map(|x| function(*x)).collect(),
        ));
    }
    match call.operator() {
        "Add" => arithmetic(call, |a, b| a + b, i64::wrapping_add),
        "Sub" => arithmetic(call, |a, b| a - b, i64::wrapping_sub),
        "Mul" => arithmetic(call, |a, b| a * b, i64::wrapping_mul),
        "Div" => arithmetic(call, |a, b| a / b, |a, b| a.checked_div(b).unwrap_or(0)),
        "Pow" => power(call),
        "Mod" if call.int("fmod", 0) == 1 => {
            arithmetic(call, |a, b| a % b, |a, b| a.checked_rem(b).unwrap_or(0))
        }
        // The sign is the divisor's.
        "Mod" => arithmetic(
            call,
            |a, b| {
                let rest = a % b;
                if rest != 0.0 && (rest < 0.0) != (b < 0.0) { rest + b } else { rest }
            },
            |a, b| {
                a.checked_rem(b).map_or(0, |rest| {
                    if rest != 0 && (rest < 0) != (b < 0) { rest + b } else { rest }
                })
            },
        ),
        "Max" => arithmetic(call, larger, i64::max),
        "Min" => arithmetic(call, |a, b| -larger(-a, -b), i64::min),
        "Sum" | "Mean" => sum(call),
        "PRelu" => {
            let slope = call.input(1)?;
            arithmetic_of(
                call.input(0)?,
                slope,
                |x, slope| if x < 0.0 { slope * x } else { x },
                |x, _| x,
            )
        }
        "Abs" | "Neg" | "Sign" | "Ceil" | "Floor" | "Round" => whole_or_real(call),
        "Clip" => clip(call),
        "Cast" | "CastLike" => cast(call),
        "Equal" => compare(call, |a, b| a == b),
        "Greater" => compare(call, |a, b| a > b),
        "GreaterOrEqual" => compare(call, |a, b| a >= b),
        "Less" => compare(call, |a, b| a < b),
        "LessOrEqual" => compare(call, |a, b| a <= b),
        "And" => logic(call, |a, b| a & b),
        "Or" => logic(call, |a, b| a | b),
        "Xor" => logic(call, |a, b| a ^ b),
        "Not" => {
            let input = call.input(0)?;
            one(Tensor::truth(input.shape.clone(), input.truths()?.iter().map(|t| !t).collect()))
        }
        "IsNaN" => test(call, f64::is_nan),
        "IsInf" => {
            let [below, above] =
                ["detect_negative", "detect_positive"].map(|sign| call.int(sign, 1) == 1);
            test(call, |x| x.is_infinite() && if x < 0.0 { below } else { above })
        }
        "Where" => choose(call),
        // Nothing is left out where nobody trains.
        "Identity" | "Dropout" => one(call.input(0)?.clone()),
        "Scaler" => scaler(call),
        _ => Ok(None),
    }
}

/// A function of one float.
type Function = Box<dyn Fn(f64) -> f64>;

/// A function of one float, by its name and the attributes of a node.
fn function_of_one(call: &Call<'_>) -> Option<Function> {
    let alpha = |usual: f32| call.float("alpha", usual);
    let function: Function = match call.operator() {
        "Relu" => Box::new(|x| if x < 0.0 { 0.0 } else { x }),
        "Sigmoid" => Box::new(sigmoid),
        "Tanh" => Box::new(f64::tanh),
        "Exp" => Box::new(f64::exp),
        "Log" => Box::new(f64::ln),
        "Sqrt" => Box::new(f64::sqrt),
        "Reciprocal" => Box::new(|x| 1.0 / x),
        "Sin" => Box::new(f64::sin),
        "Cos" => Box::new(f64::cos),
        "Tan" => Box::new(f64::tan),
        "Asin" => Box::new(f64::asin),
        "Acos" => Box::new(f64::acos),
        "Atan" => Box::new(f64::atan),
        "Sinh" => Box::new(f64::sinh),
        "Cosh" => Box::new(f64::cosh),
        "Asinh" => Box::new(f64::asinh),
        "Acosh" => Box::new(f64::acosh),
        "Atanh" => Box::new(f64::atanh),
        "Erf" => Box::new(libm::erf),
        "Softplus" => Box::new(softplus),
        "Softsign" => Box::new(|x| x / (1.0 + x.abs())),
        "Mish" => Box::new(|x| x * softplus(x).tanh()),
        "HardSwish" => Box::new(|x| x * (x / 6.0 + 0.5).clamp(0.0, 1.0)),
        "LeakyRelu" => {
            let alpha = alpha(0.01);
            Box::new(move |x| if x < 0.0 { alpha * x } else { x })
        }
        "Elu" => {
            let alpha = alpha(1.0);
            Box::new(move |x| if x < 0.0 { alpha * x.exp_m1() } else { x })
        }
        "Celu" => {
            let alpha = alpha(1.0);
            Box::new(move |x| x.max(0.0) + (alpha * (x / alpha).exp_m1()).min(0.0))
        }
        "Selu" => {
            // The specification's own digits, which f32 rounds.
            let (alpha, gamma) = (alpha(1.673_263_2), call.float("gamma", 1.050_701));
            Box::new(move |x| gamma * if x > 0.0 { x } else { alpha * x.exp_m1() })
        }
        "ThresholdedRelu" => {
            let alpha = alpha(1.0);
            Box::new(move |x| if x > alpha { x } else { 0.0 })
        }
        "HardSigmoid" => {
            let (alpha, beta) = (alpha(0.2), call.float("beta", 0.5));
            Box::new(move |x| (alpha * x + beta).clamp(0.0, 1.0))
        }
        "Gelu" if call.text("approximate", "none") == "tanh" => Box::new(|x| {
            let inner = (2.0 / std::f64::consts::PI).sqrt() * (x + 0.044_715 * x.powi(3));
            0.5 * x * (1.0 + inner.tanh())
        }),
        "Gelu" => Box::new(|x| 0.5 * x * (1.0 + libm::erf(x / std::f64::consts::SQRT_2))),
        "Swish" => {
            let alpha = alpha(1.0);
            Box::new(move |x| x * sigmoid(alpha * x))
        }
        "Shrink" => {
            let (bias, lambd) = (call.float("bias", 0.0), call.float("lambd", 0.5));
            Box::new(move |x| match x {
                x if x < -lambd => x + bias,
                x if x > lambd => x - bias,
                _ => 0.0,
            })
        }
        _ => return None,
    };
    Some(function)
}

pub(super) fn sigmoid(x: f64) -> f64 {
    if x < 0.0 { x.exp() / (1.0 + x.exp()) } else { 1.0 / (1.0 + (-x).exp()) }
}

fn softplus(x: f64) -> f64 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

/// The larger of two numbers; what is no number stays none.
pub(super) fn larger(a: f64, b: f64) -> f64 {
    if a.is_nan() || a > b { a } else { b }
}

/// Two inputs or more, one after the other.
fn arithmetic(
    call: &Call<'_>,
    real: impl Fn(f64, f64) -> f64,
    whole: impl Fn(i64, i64) -> i64,
) -> Found {
    let mut so_far = call.input(0)?.clone();
    for index in 1..call.inputs.len() {
        so_far = computed(&so_far, call.input(index)?, &real, &whole)?;
    }
    one(so_far)
}

fn arithmetic_of(
    a: &Tensor,
    b: &Tensor,
    real: impl Fn(f64, f64) -> f64,
    whole: impl Fn(i64, i64) -> i64,
) -> Found {
    one(computed(a, b, real, whole)?)
}

fn computed(
    a: &Tensor,
    b: &Tensor,
    real: impl Fn(f64, f64) -> f64,
    whole: impl Fn(i64, i64) -> i64,
) -> Result<Tensor, Failure> {
    let shape = common_shape(&a.shape, &b.shape)?;
    let (a, b) = (a.spread(&shape)?, b.spread(&shape)?);
    Ok(match (&a.numbers, &b.numbers) {
        (Numbers::Real(a), Numbers::Real(b)) => {
            Tensor::real(shape, a.iter().zip(b).map(|(a, b)| real(*a, *b)).collect())
        }
        (Numbers::Whole(a), Numbers::Whole(b)) => {
            Tensor::whole(shape, a.iter().zip(b).map(|(a, b)| whole(*a, *b)).collect())
        }
        _ => return Err("needs numbers of one type".into()),
    })
}

/// A power; the exponent's type may be another.
fn power(call: &Call<'_>) -> Found {
    let (base, exponent) = (call.input(0)?, call.input(1)?);
    let is_whole = matches!(base.numbers, Numbers::Whole(_));
    let reals = |tensor: &Tensor| Tensor::real(tensor.shape.clone(), tensor.to_reals());
    let found = computed(&reals(base), &reals(exponent), f64::powf, |a, _| a)?;
    one(if is_whole { Tensor::whole(found.shape.clone(), found.to_wholes()) } else { found })
}

fn sum(call: &Call<'_>) -> Found {
    let sum = arithmetic(call, |a, b| a + b, i64::wrapping_add)?;
    let parts = if call.operator() == "Mean" { call.inputs.len() as f64 } else { 1.0 };
    let mean = |tensor: Tensor| -> Result<Tensor, Failure> {
        let numbers = tensor.reals()?.iter().map(|x| x / parts).collect();
        Ok(Tensor::real(tensor.shape, numbers))
    };
    sum.map(|tensors| tensors.into_iter().map(mean).collect()).transpose()
}

fn whole_or_real(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    type Both = (fn(f64) -> f64, fn(i64) -> i64);
    let (real, whole): Both = match call.operator() {
        "Abs" => (f64::abs, i64::wrapping_abs),
        "Neg" => (|x| -x, i64::wrapping_neg),
        "Sign" => (|x| if x == 0.0 || x.is_nan() { x } else { x.signum() }, i64::signum),
        "Ceil" => (f64::ceil, |x| x),
        "Floor" => (f64::floor, |x| x),
        _ => (f64::round_ties_even, |x| x),
    };
    one(match &input.numbers {
        Numbers::Whole(numbers) => {
            Tensor::whole(input.shape.clone(), numbers.iter().map(|x| whole(*x)).collect())
        }
        _ => Tensor::real(input.shape.clone(), input.reals()?.iter().map(|x| real(*x)).collect()),
    })
}

fn clip(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    let limit = |index: usize, name: &str, usual: f64| match call.given(index) {
        Some(limit) => limit.single(),
        None => Ok(call.attribute(name).map_or(usual, |attribute| f64::from(attribute.f))),
    };
    let least = limit(1, "min", f64::NEG_INFINITY)?;
    let most = limit(2, "max", f64::INFINITY)?;
    one(match &input.numbers {
        Numbers::Whole(numbers) => {
            let clip = |x: &i64| (*x).max(least as i64).min(most as i64);
            Tensor::whole(input.shape.clone(), numbers.iter().map(clip).collect())
        }
        // A least that is above the most gives the most.
        _ => {
            let clip = |x: &f64| if x.is_nan() { *x } else { x.max(least).min(most) };
            Tensor::real(input.shape.clone(), input.reals()?.iter().map(clip).collect())
        }
    })
}

fn cast(call: &Call<'_>) -> Found {
    use tract_onnx::pb::tensor_proto::DataType;
    let input = call.input(0)?;
    let shape = input.shape.clone();
    if call.operator() == "CastLike" {
        return one(match call.input(1)?.numbers {
            Numbers::Real(_) => Tensor::real(shape, input.to_reals()),
            Numbers::Whole(_) => Tensor::whole(shape, input.to_wholes()),
            Numbers::Truth(_) => {
                Tensor::truth(shape, input.to_reals().iter().map(|x| *x != 0.0).collect())
            }
        });
    }
    let kind = DataType::try_from(call.int("to", 0) as i32).unwrap_or(DataType::Undefined);
    one(match kind {
        DataType::Float | DataType::Double | DataType::Float16 | DataType::Bfloat16 => {
            Tensor::real(shape, input.to_reals())
        }
        DataType::Bool => {
            Tensor::truth(shape, input.to_reals().iter().map(|x| *x != 0.0).collect())
        }
        DataType::Int8 => {
            Tensor::whole(shape, input.to_wholes().iter().map(|x| i64::from(*x as i8)).collect())
        }
        DataType::Uint8 => {
            Tensor::whole(shape, input.to_wholes().iter().map(|x| i64::from(*x as u8)).collect())
        }
        DataType::Int32
        | DataType::Int64
        | DataType::Uint32
        | DataType::Int16
        | DataType::Uint16 => Tensor::whole(shape, input.to_wholes()),
        other => return Err(format!("casts to {other:?}").into()),
    })
}

fn compare(call: &Call<'_>, holds: impl Fn(f64, f64) -> bool) -> Found {
    let (a, b) = (call.input(0)?, call.input(1)?);
    let shape = common_shape(&a.shape, &b.shape)?;
    let (a, b) = (a.spread(&shape)?.to_reals(), b.spread(&shape)?.to_reals());
    one(Tensor::truth(shape, a.iter().zip(&b).map(|(a, b)| holds(*a, *b)).collect()))
}

fn logic(call: &Call<'_>, holds: impl Fn(bool, bool) -> bool) -> Found {
    let (a, b) = (call.input(0)?, call.input(1)?);
    let shape = common_shape(&a.shape, &b.shape)?;
    let (a, b) = (a.spread(&shape)?, b.spread(&shape)?);
    let both = a.truths()?.iter().zip(b.truths()?);
    one(Tensor::truth(shape, both.map(|(a, b)| holds(*a, *b)).collect()))
}

fn test(call: &Call<'_>, holds: impl Fn(f64) -> bool) -> Found {
    let input = call.input(0)?;
    one(Tensor::truth(input.shape.clone(), input.reals()?.iter().map(|x| holds(*x)).collect()))
}

fn choose(call: &Call<'_>) -> Found {
    let (holds, yes, no) = (call.input(0)?, call.input(1)?, call.input(2)?);
    let shape = common_shape(&common_shape(&holds.shape, &yes.shape)?, &no.shape)?;
    let holds = holds.spread(&shape)?;
    let parts = [&yes.spread(&shape)?, &no.spread(&shape)?];
    let places = holds.truths()?.iter().enumerate();
    let places: Vec<_> = places.map(|(at, holds)| (usize::from(!holds), at)).collect();
    one(Tensor::of_parts(shape, &parts, &places)?)
}

/// `(x - offset) * scale` along the last size, of ONNX's operators for classical learning.
fn scaler(call: &Call<'_>) -> Found {
    let input = call.input(0)?;
    let columns = input.shape.last().copied().unwrap_or(1).max(1);
    let floats = |name: &str, usual: f32| {
        let given = call.attribute(name).map_or(&[][..], |attribute| &attribute.floats);
        let number = |column: usize| given.get(column).or(given.first()).copied().unwrap_or(usual);
        (0..columns).map(|column| f64::from(number(column))).collect::<Vec<_>>()
    };
    let (offset, scale) = (floats("offset", 0.0), floats("scale", 1.0));
    let numbers = input.to_reals().into_iter().enumerate();
    let numbers = numbers.map(|(at, x)| (x - offset[at % columns]) * scale[at % columns]);
    one(Tensor::real(input.shape.clone(), numbers.collect()))
}
