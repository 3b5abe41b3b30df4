//! The tape computes what the utility network's own passes compute, to the bit.

use sortie_learn::random::{Purpose, generator};
use sortie_methods::alma::agents::{
    UtilityInput, UtilityLayers, UtilityNetwork, UtilityPass, UtilityShape,
};
use sortie_nn::gradient_check::random;
use sortie_nn::tape::{Places, Tape};

const AGENTS: usize = 20;

/// Agents of two teams and a few more entities; in a world of so many others, queries absorb their keys.
fn input(columns: usize, others: usize) -> UtilityInput {
    let mut input = UtilityInput::default();
    let rows = AGENTS + others;
    for (row, value) in random(1, rows).into_iter().enumerate() {
        for column in [row % columns, (7 * row + 3) % columns, columns - 1] {
            input.rows.push(column, value + 0.1 * column as f32);
        }
        input.rows.end_row();
    }
    for agent in 0..AGENTS {
        // Each team sees its own, and each agent a part of the others.
        (agent % 2..AGENTS + 6).step_by(2).for_each(|row| input.visible.push(row));
        (AGENTS + 6..rows).skip(agent).step_by(AGENTS).for_each(|row| input.visible.push(row));
        input.visible.end_list();
    }
    input
}

fn bits(numbers: &[f32]) -> Vec<u32> {
    numbers.iter().map(|number| number.to_bits()).collect()
}

#[test]
fn the_utility_network_has_equal_bits() {
    for (width, heads, others, skip) in [
        (64, 4, 6, false),
        (32, 4, 6, false),
        (12, 3, 6, false),
        (64, 4, 200, false),
        (32, 4, 6, true),
    ] {
        let shape = UtilityShape { input: 30, width, heads, base: 48, actions: 7, skip };
        let network =
            UtilityNetwork::initialise(shape, 3.0, &mut generator(1, Purpose::Weights, 0));
        let input = input(shape.input, others);
        let slopes = random(2, AGENTS * shape.actions);
        let mut pass = UtilityPass::new(shape);
        let utilities = bits(pass.forward(&network, &input));
        let mut gradient = vec![0.0; shape.parameters()];
        pass.backward(&network, &input, &slopes, &mut gradient);

        let mut tape = Tape::default();
        let places = &mut Places::default();
        let layers = UtilityLayers::of(shape, places);
        assert_eq!(places.end, shape.parameters());
        // The second pass finds the memory of the first.
        for _ in 0..2 {
            let mut own_gradient = vec![0.0; shape.parameters()];
            let mut t = tape.begin(network.parameters());
            let base = layers.base(&mut t, &input);
            let y = layers.head(&mut t, base);
            assert_eq!(bits(t.values(y)), utilities);
            let loss = t.weighted_sum(y, &slopes);
            t.backward(loss, &mut own_gradient);
            if !skip {
                assert_eq!(bits(&own_gradient), bits(&gradient));
            }
            // A skip's slopes come to the embeddings first here, last there.
            for (own, want) in own_gradient.iter().zip(&gradient) {
                assert!((own - want).abs() < 1e-5, "{own} against {want}");
            }
        }
    }
}
