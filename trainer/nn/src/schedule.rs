//! Numbers that change with the environment steps taken.

/// Goes in a straight line from `start` to `end` over `length` steps, then stays.
#[inline]
pub fn linear(start: f32, end: f32, length: u64, step: u64) -> f32 {
    if step >= length {
        return end;
    }
    start + (end - start) * (step as f64 / length as f64) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_begin_and_end_where_they_should() {
        assert_eq!(linear(1.0, 0.05, 100, 0), 1.0);
        assert!((linear(1.0, 0.0, 100, 25) - 0.75).abs() < 1e-6);
        assert_eq!(linear(1.0, 0.05, 100, 1000), 0.05);
        assert_eq!(linear(1.0, 0.05, 0, 0), 0.05);
    }
}
