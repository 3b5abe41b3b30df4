//! The rectifier `max(0, x)`, in place.

/// Replaces negative values by zero.
pub fn forward(values: &mut [f32]) {
    for value in values {
        *value = value.max(0.0);
    }
}

/// Zeroes the gradient where the rectified `output` is zero.
pub fn backward(output: &[f32], gradient: &mut [f32]) {
    for (output, gradient) in output.iter().zip(gradient) {
        *gradient = if *output > 0.0 { *gradient } else { 0.0 };
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
