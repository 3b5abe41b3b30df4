//! The rectifier `max(0, x)`, in place.

use super::wide::{Work, run_widest};

/// Replaces negative values by zero.
pub fn forward(values: &mut [f32]) {
    run_widest(Forward(values));
}

struct Forward<'a>(&'a mut [f32]);

impl Work for Forward<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        for value in self.0 {
            *value = value.max(0.0);
        }
    }
}

/// Zeroes the gradient where the rectified `output` is zero.
pub fn backward(output: &[f32], gradient: &mut [f32]) {
    run_widest(Backward { output, gradient });
}

struct Backward<'a> {
    output: &'a [f32],
    gradient: &'a mut [f32],
}

impl Work for Backward<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        for (output, gradient) in self.output.iter().zip(self.gradient) {
            *gradient = if *output > 0.0 { *gradient } else { 0.0 };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn passes_positive_values_and_their_gradients_only() {
        let mut values = [-1.0, 0.0, 2.0];
        forward(&mut values);
        assert_eq!(values, [0.0, 0.0, 2.0]);
        let mut gradient = [5.0, 6.0, 7.0];
        backward(&values, &mut gradient);
        assert_eq!(gradient, [0.0, 0.0, 7.0]);
    }
}
