//! How many floating-point operations a pass of the utility network takes.
//!
//! A multiplication and an addition count as two. Counted over the rows, agents and pairs that are
//! really there: matrix products, the sparse first layer, attention's scores and weighted sums. Not
//! counted, and small: softmax, rectifiers, biases.

use super::entity_attention::absorbs;
use super::utility::UtilityShape;
use super::utility_input::UtilityInput;

/// Operations of a forward pass.
pub(super) fn forward(shape: UtilityShape, input: &UtilityInput) -> u64 {
    2 * (first_layer(shape, input) + attention(shape, input) + head(shape, input)) as u64
}

/// Operations of a backward pass: each product has two gradients, features have none.
pub(super) fn backward(shape: UtilityShape, input: &UtilityInput) -> u64 {
    2 * (first_layer(shape, input) + 2 * attention(shape, input) + 2 * head(shape, input)) as u64
}

/// Multiplications of the first layer.
fn first_layer(shape: UtilityShape, input: &UtilityInput) -> usize {
    input.rows.entries() * shape.width
}

/// Multiplications of the attention: queries, then keys and values or what stands in for them, then a
/// score and a weighted row for each pair.
fn attention(shape: UtilityShape, input: &UtilityInput) -> usize {
    let UtilityShape { width, heads, .. } = shape;
    let (rows, queries, pairs) = (input.rows.len(), input.visible.queries(), input.visible.pairs());
    let matrix = width * width;
    queries * matrix
        + if absorbs(shape.attention(), input) {
            2 * queries * matrix + 2 * pairs * heads * width
        } else {
            2 * rows * matrix + 2 * pairs * width
        }
}

/// Multiplications of the three layers behind the attention, and of the skip beside it.
fn head(shape: UtilityShape, input: &UtilityInput) -> usize {
    let UtilityShape { width, base, actions, skip, .. } = shape;
    let looked = if skip { 2 * width * width } else { width * width };
    input.visible.queries() * (looked + width * base + base * actions)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHAPE: UtilityShape =
        UtilityShape { input: 9, width: 4, heads: 2, base: 3, actions: 5, skip: false };

    /// One query that sees itself and so many others, each with two features.
    fn input(others: usize) -> UtilityInput {
        let mut input = UtilityInput::default();
        for row in 0..=others {
            input.rows.push_dense(&[0.0, 1.0, 2.0]);
            input.visible.push(row);
        }
        input.visible.end_list();
        input
    }

    #[test]
    fn only_what_is_there_counts() {
        // Keys and values of two rows are fewer multiplications than what absorbs them.
        let (first, attention) = (4 * 4, 16 + 2 * 2 * 16 + 2 * 2 * 4);
        let head = 16 + 12 + 15;
        assert_eq!(forward(SHAPE, &input(1)), 2 * (first + attention + head));
        assert_eq!(backward(SHAPE, &input(1)), 2 * (first + 2 * attention + 2 * head));
        let skipping = UtilityShape { skip: true, ..SHAPE };
        assert_eq!(forward(skipping, &input(1)), forward(SHAPE, &input(1)) + 2 * 16);
        assert_eq!(backward(skipping, &input(1)), backward(SHAPE, &input(1)) + 2 * 2 * 16);
    }

    #[test]
    fn absorbed_keys_count_per_query() {
        let shape = UtilityShape { width: 64, heads: 1, ..SHAPE };
        let (queries, pairs) = (64 * 64, 10 * 64);
        let first = 20 * 64;
        let head = 64 * 64 + 64 * 3 + 15;
        let attention = queries + 2 * queries + 2 * pairs;
        assert_eq!(forward(shape, &input(9)), 2 * (first + attention + head));
    }
}
