//! How far elementary functions are from correctly rounded ones, as docs/reference/arithmetic.md says.
//!
//! Samples are spread over all numbers of f32 by their bits. `SORTIE_ULP_SAMPLES=16777216` takes more of them.

use sortie_core::internal::math;

const DOCUMENT: &str = include_str!("../../../../docs/reference/arithmetic.md");

/// A function, what it should be, and the arguments that count.
struct Function {
    name: &'static str,
    own: fn(f32) -> f32,
    exact: fn(f64) -> f64,
    from: f32,
    to: f32,
}

const FUNCTIONS: [Function; 12] = [
    Function { name: "exp", own: math::exp, exact: f64::exp, from: -87.0, to: 88.0 },
    Function {
        name: "exp - 1",
        own: math::exp_minus_one,
        exact: f64::exp_m1,
        from: -87.0,
        to: 88.0,
    },
    Function { name: "ln", own: math::ln_of_any, exact: f64::ln, from: 1e-38, to: f32::MAX },
    Function { name: "tanh", own: math::tanh, exact: f64::tanh, from: f32::MIN, to: f32::MAX },
    Function { name: "sigmoid", own: math::sigmoid, exact: sigmoid, from: -87.0, to: f32::MAX },
    Function { name: "softplus", own: math::softplus, exact: softplus, from: -80.0, to: f32::MAX },
    Function { name: "silu", own: silu, exact: exact_silu, from: -80.0, to: 1e38 },
    Function { name: "erf", own: libm::erff, exact: libm::erf, from: f32::MIN, to: f32::MAX },
    Function { name: "sine", own: math::sine, exact: f64::sin, from: f32::MIN, to: f32::MAX },
    Function { name: "cosine", own: math::cosine, exact: f64::cos, from: f32::MIN, to: f32::MAX },
    Function {
        name: "arc tangent",
        own: math::arc_tangent,
        exact: f64::atan,
        from: f32::MIN,
        to: f32::MAX,
    },
    Function { name: "sqrt", own: libm::sqrtf, exact: f64::sqrt, from: 0.0, to: f32::MAX },
];

fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

fn softplus(x: f64) -> f64 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

fn silu(x: f32) -> f32 {
    x * math::sigmoid(x)
}

fn exact_silu(x: f64) -> f64 {
    x * sigmoid(x)
}

/// The error of a number in units of the last place of the number that it should be.
fn error(got: f32, want: f64) -> f64 {
    let rounded = (want as f32).abs().max(f32::MIN_POSITIVE);
    let unit = f64::from(f32::from_bits(rounded.to_bits() + 1)) - f64::from(rounded);
    (f64::from(got) - want).abs() / unit
}

/// The largest error over samples of all numbers between both ends.
fn largest_error(function: &Function, samples: u64) -> (f64, f32) {
    let stride = (1_u64 << 32) / samples;
    let mut worst = (0.0, 0.0);
    for sample in 0..samples {
        // Not always the same last bits.
        let within = sample.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40;
        let x = f32::from_bits((sample * stride + within % stride) as u32);
        if !(function.from..=function.to).contains(&x) {
            continue;
        }
        let error = error((function.own)(x), (function.exact)(x.into()));
        if error > worst.0 || error.is_nan() {
            worst = (error, x);
        }
    }
    worst
}

/// What the document allows a function.
fn allowed(name: &str) -> f64 {
    let row = DOCUMENT.lines().find(|line| line.starts_with(&format!("| `{name}` |")));
    let cells = row.unwrap_or_else(|| panic!("no row of `{name}`")).split('|');
    let cell = cells.map(str::trim).nth(3).expect("a limit");
    cell.parse().unwrap_or_else(|_| panic!("`{name}`: {cell}"))
}

#[test]
fn functions_are_as_near_as_the_document_says() {
    let samples = std::env::var("SORTIE_ULP_SAMPLES").map_or(1 << 20, |samples| {
        samples.parse::<u64>().expect("a number of samples").next_power_of_two()
    });
    for function in &FUNCTIONS {
        let (error, x) = largest_error(function, samples);
        println!("{}: {error:.3} units at {x:e}", function.name);
        let limit = allowed(function.name);
        assert!(error <= limit, "{}: {error} units at {x:e}, {limit} allowed", function.name);
        // A limit that is far off says nothing.
        assert!(error > 0.5 * limit || limit <= 0.5, "{}: only {error}", function.name);
    }
}

#[test]
fn sines_are_as_near_where_angles_are_next_to_whole_quarters() {
    // The nearest of all numbers, and of those that need the last places of 2/π.
    for x in [0x6f79_be45, 0x7ebd_cda0].map(f32::from_bits) {
        for (name, own, exact) in [
            ("sine", math::sine as fn(f32) -> f32, f64::sin as fn(f64) -> f64),
            ("cosine", math::cosine, f64::cos),
        ] {
            let error = error(own(x), exact(x.into()));
            assert!(error <= allowed(name), "{name}: {error} units at {x:e}");
        }
    }
}
