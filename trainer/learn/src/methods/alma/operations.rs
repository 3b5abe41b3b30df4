//! How many floating-point operations a pass of the utility network takes.
//!
//! A multiplication and an addition count as two. Counted over the rows, agents and pairs that are
//! really there: matrix products, the sparse first layer, attention's scores and weighted sums. Not
//! counted, and small: softmax, rectifiers, biases.

use super::utility::UtilityShape;
use super::utility_pass::UtilityInput;
use crate::layers::linear::LinearShape;

/// Operations of a forward pass.
pub(super) fn forward(shape: UtilityShape, input: &UtilityInput) -> u64 {
    first_layer(shape, input) + attention(shape, input) + products(shape, input)
}

/// Operations of a backward pass: each product has two gradients, features have none.
pub(super) fn backward(shape: UtilityShape, input: &UtilityInput) -> u64 {
    first_layer(shape, input) + 2 * attention(shape, input) + 2 * products(shape, input)
}

fn first_layer(shape: UtilityShape, input: &UtilityInput) -> u64 {
    2 * (input.rows.entries() * shape.width) as u64
}

/// A score and a weighted value for each pair, over all heads.
fn attention(shape: UtilityShape, input: &UtilityInput) -> u64 {
    4 * (input.visible.pairs() * shape.width) as u64
}

fn products(shape: UtilityShape, input: &UtilityInput) -> u64 {
    let product = |rows: usize, layer: LinearShape| 2 * (rows * layer.input * layer.output) as u64;
    let (rows, queries) = (input.rows.len(), input.visible.queries());
    let of_rows = product(rows, shape.keys_values());
    // The attention's output layer has the shape of its queries.
    let of_queries = [shape.queries(), shape.queries(), shape.fc2(), shape.head()];
    of_rows + of_queries.into_iter().map(|layer| product(queries, layer)).sum::<u64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_there_counts() {
        let shape = UtilityShape { input: 9, width: 4, heads: 2, base: 3, actions: 5 };
        let mut input = UtilityInput::default();
        input.rows.push_dense(&[0.0, 1.0, 2.0]);
        input.rows.push_dense(&[3.0]);
        input.visible.push(0);
        input.visible.push(1);
        input.visible.end_list();
        // Three features; two rows with keys and values; one query with two pairs.
        let (first, attention) = (2 * 3 * 4, 2 * 2 * 2 * 4);
        let products = 2 * (2 * 4 * 8 + 4 * 4 + 4 * 4 + 4 * 3 + 3 * 5);
        assert_eq!(forward(shape, &input), first + attention + products);
        assert_eq!(backward(shape, &input), first + 2 * attention + 2 * products);
    }
}
