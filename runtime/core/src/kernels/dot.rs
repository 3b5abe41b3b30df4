//! Sums and dot products in 16 lanes that a fixed tree joins.

/// Lanes of a sum: element i goes to lane i mod 16.
pub const LANES: usize = 16;

/// The dot product of two vectors of equal length.
#[inline(always)]
pub fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut lanes = [0.0; LANES];
    let (chunks_a, rest_a) = a.as_chunks::<LANES>();
    let (chunks_b, rest_b) = b.as_chunks::<LANES>();
    for (chunk_a, chunk_b) in chunks_a.iter().zip(chunks_b) {
        for ((lane, a), b) in lanes.iter_mut().zip(chunk_a).zip(chunk_b) {
            *lane += a * b;
        }
    }
    for ((lane, a), b) in lanes.iter_mut().zip(rest_a).zip(rest_b) {
        *lane += a * b;
    }
    join(lanes)
}

/// The sum of all values.
#[inline(always)]
pub fn sum(values: &[f32]) -> f32 {
    let mut lanes = [0.0; LANES];
    let (chunks, rest) = values.as_chunks::<LANES>();
    for chunk in chunks {
        for (lane, value) in lanes.iter_mut().zip(chunk) {
            *lane += value;
        }
    }
    for (lane, value) in lanes.iter_mut().zip(rest) {
        *lane += value;
    }
    join(lanes)
}

/// Adds lanes j and j + 8, then neighbours, then neighbours again, then the two halves.
#[inline(always)]
fn join(lanes: [f32; LANES]) -> f32 {
    // Hides the tree from the loops before it: else the compiler permutes their lanes to suit it.
    let lanes = core::hint::black_box(lanes);
    let [a0, a1, a2, a3, a4, a5, a6, a7, b0, b1, b2, b3, b4, b5, b6, b7] = lanes;
    let low = ((a0 + b0) + (a1 + b1)) + ((a2 + b2) + (a3 + b3));
    let high = ((a4 + b4) + (a5 + b5)) + ((a6 + b6) + (a7 + b7));
    low + high
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn covers_whole_chunks_and_the_rest() {
        for len in [0, 1, 8, 15, 16, 24, 40, 128] {
            let values: std::vec::Vec<f32> = (1..=len).map(|i| i as f32).collect();
            let ones = std::vec![1.0; len];
            let want = (len * (len + 1) / 2) as f32;
            assert_eq!(dot(&values, &ones), want);
            assert_eq!(sum(&values), want);
        }
    }
}
