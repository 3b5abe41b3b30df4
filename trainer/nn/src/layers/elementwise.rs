//! What happens to every number by itself: activations, sums and products, and losses against targets.
//!
//! Backward passes take the output of the forward pass; [`Store`] says whether they replace or add.

use sortie_core::internal::math;

use super::matrix::Store;
use super::vectors::{self, run_widest};

/// A function of one number whose slope follows from its value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Activation {
    /// `max(0, x)`
    Relu,
    /// `x` where it is positive, else so many times `x`.
    LeakyRelu(f32),
    /// The hyperbolic tangent.
    Tanh,
    /// `1 / (1 + exp(-x))`
    Sigmoid,
    /// `x` where it is positive, else `exp(x) - 1`.
    Elu,
    /// `exp(x)`
    Exp,
    /// The square root.
    Root,
    /// The nearest number between two bounds.
    Clamp(f32, f32),
}

/// Writes the activation of every number.
pub fn activate(activation: Activation, x: &[f32], y: &mut [f32]) {
    match activation {
        Activation::Relu => map(x, y, |x| x.max(0.0)),
        Activation::LeakyRelu(slope) => map(x, y, move |x| if x > 0.0 { x } else { slope * x }),
        Activation::Tanh => map(x, y, math::tanh),
        Activation::Sigmoid => map(x, y, math::sigmoid),
        Activation::Elu => map(x, y, |x| if x > 0.0 { x } else { math::exp(x) - 1.0 }),
        Activation::Exp => map(x, y, math::exp),
        Activation::Root => map(x, y, f32::sqrt),
        Activation::Clamp(least, most) => map(x, y, move |x| x.clamp(least, most)),
    }
}

/// Takes the slopes by the outputs `y` to slopes by the inputs.
pub fn activate_backward(
    activation: Activation,
    y: &[f32],
    d_y: &[f32],
    store: Store,
    d_x: &mut [f32],
) {
    match activation {
        Activation::Relu => join(y, d_y, store, d_x, |y, d| if y > 0.0 { d } else { 0.0 }),
        Activation::LeakyRelu(slope) => {
            join(y, d_y, store, d_x, move |y, d| if y > 0.0 { d } else { slope * d });
        }
        Activation::Tanh => join(y, d_y, store, d_x, |y, d| d * (1.0 - y * y)),
        Activation::Sigmoid => join(y, d_y, store, d_x, |y, d| d * (y * (1.0 - y))),
        Activation::Elu => {
            join(y, d_y, store, d_x, |y, d| if y > 0.0 { d } else { d * (y + 1.0) });
        }
        Activation::Exp => multiply(y, d_y, store, d_x),
        Activation::Root => join(y, d_y, store, d_x, |y, d| 0.5 * d / y),
        Activation::Clamp(least, most) => {
            let within = move |y: f32| y > least && y < most;
            join(y, d_y, store, d_x, move |y, d| if within(y) { d } else { 0.0 });
        }
    }
}

/// Replaces numbers below zero by zero.
pub fn rectify(values: &mut [f32]) {
    run_widest(
        #[inline(always)]
        || values.iter_mut().for_each(|value| *value = value.max(0.0)),
    );
}

/// Zeroes the slopes where what was rectified is zero.
pub fn rectify_backward(rectified: &[f32], slopes: &mut [f32]) {
    run_widest(
        #[inline(always)]
        || {
            for (value, slope) in rectified.iter().zip(slopes) {
                *slope = if *value > 0.0 { *slope } else { 0.0 };
            }
        },
    );
}

/// Writes the absolute value of every number.
pub fn absolute(x: &[f32], y: &mut [f32]) {
    map(x, y, f32::abs);
}

/// Takes the slopes by absolute values to slopes by the numbers `x`.
pub fn absolute_backward(x: &[f32], d_y: &[f32], store: Store, d_x: &mut [f32]) {
    join(x, d_y, store, d_x, |x, d| if x < 0.0 { -d } else { d });
}

/// Writes or adds `factor` times `x`.
pub fn scale(factor: f32, x: &[f32], store: Store, y: &mut [f32]) {
    match store {
        Store::Replace => map(x, y, move |x| factor * x),
        Store::Add => run_widest(
            #[inline(always)]
            || vectors::add_scaled(y, factor, x),
        ),
    }
}

/// Writes or adds the products of pairs.
pub fn multiply(a: &[f32], b: &[f32], store: Store, y: &mut [f32]) {
    join(a, b, store, y, |a, b| a * b);
}

/// Writes the sums of pairs.
pub fn add(a: &[f32], b: &[f32], y: &mut [f32]) {
    join(a, b, Store::Replace, y, |a, b| a + b);
}

/// The dot product of two vectors.
pub fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut sum = [0.0];
    run_widest(
        #[inline(always)]
        || vectors::dots(a, b, &mut sum),
    );
    sum[0]
}

fn map(x: &[f32], y: &mut [f32], function: impl Fn(f32) -> f32) {
    run_widest(
        #[inline(always)]
        || y.iter_mut().zip(x).for_each(|(y, x)| *y = function(*x)),
    );
}

fn join(a: &[f32], b: &[f32], store: Store, y: &mut [f32], function: impl Fn(f32, f32) -> f32) {
    run_widest(
        #[inline(always)]
        || {
            let terms = y.iter_mut().zip(a.iter().zip(b));
            match store {
                Store::Replace => terms.for_each(|(y, (a, b))| *y = function(*a, *b)),
                Store::Add => terms.for_each(|(y, (a, b))| *y += function(*a, *b)),
            }
        },
    );
}

/// `factor` times the sum of squares of distances.
pub fn squared_error(x: &[f32], target: &[f32], factor: f32) -> f32 {
    sum(x, target, factor, |distance| distance * distance)
}

/// `factor` times the sum of Huber's losses: `d^2 / 2` within `bound`, from there a line as steep.
pub fn huber(x: &[f32], target: &[f32], factor: f32, bound: f32) -> f32 {
    sum(x, target, factor, |distance| {
        let distance = distance.abs();
        if distance <= bound { 0.5 * distance * distance } else { bound * (distance - 0.5 * bound) }
    })
}

/// Summed in f64.
fn sum(x: &[f32], target: &[f32], factor: f32, loss: impl Fn(f32) -> f32) -> f32 {
    let terms = x.iter().zip(target).map(|(x, target)| f64::from(loss(x - target)));
    (f64::from(factor) * terms.sum::<f64>()) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn positive_numbers_and_their_slopes_only_are_passed_on() {
        let mut values = [-1.0, 0.0, 2.0];
        rectify(&mut values);
        assert_eq!(values, [0.0, 0.0, 2.0]);
        let mut slopes = [5.0, 6.0, 7.0];
        rectify_backward(&values, &mut slopes);
        assert_eq!(slopes, [0.0, 0.0, 7.0]);
    }

    /// The loss itself, which a constant too much would change and no slope would show.
    #[test]
    fn hubers_loss_is_half_a_square_up_to_its_bound_and_a_line_from_there() {
        let loss = |distance: f32| huber(&[1.0 + distance], &[1.0], 4.0, 0.5);
        let losses = [0.25, 0.5, 0.75, 2.0, -0.25, -0.5, -2.0].map(loss);
        assert_eq!(losses, [0.125, 0.5, 1.0, 3.5, 0.125, 0.5, 3.5]);
    }
}
