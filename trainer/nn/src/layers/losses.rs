//! Losses of numbers against targets, and their slopes.

/// `factor` times the sum of squares of distances.
pub fn squared_error(x: &[f32], target: &[f32], factor: f32) -> f32 {
    sum(x, target, factor, |distance| distance * distance)
}

/// The slope of `factor` times the square of a distance.
pub fn squared_error_slope(distance: f32, factor: f32) -> f32 {
    2.0 * factor * distance
}

/// `factor` times the sum of Huber's losses: `d^2 / 2` within `bound`, from there a line as steep.
pub fn huber(x: &[f32], target: &[f32], factor: f32, bound: f32) -> f32 {
    sum(x, target, factor, |distance| {
        let distance = distance.abs();
        if distance <= bound { 0.5 * distance * distance } else { bound * (distance - 0.5 * bound) }
    })
}

/// The slope of `factor` times Huber's loss of a distance.
pub fn huber_slope(distance: f32, factor: f32, bound: f32) -> f32 {
    factor * distance.clamp(-bound, bound)
}

/// Summed in f64.
fn sum(x: &[f32], target: &[f32], factor: f32, loss: impl Fn(f32) -> f32) -> f32 {
    let terms = x.iter().zip(target).map(|(x, target)| f64::from(loss(x - target)));
    (f64::from(factor) * terms.sum::<f64>()) as f32
}
