//! The tape computes what passes written by hand compute, to the bit.

use sortie_learn::random::{Purpose, generator};
use sortie_methods::alma::agents::{UtilityInput, UtilityNetwork, UtilityPass, UtilityShape};
use sortie_methods::alma::coach::{
    Coach, CoachPass, CoachShape, Recognition, RecognitionPass, RecognitionShape,
};
use sortie_nn::gradient_check::random;
use sortie_nn::layers::attention::AttentionShape;
use sortie_nn::layers::linear::LinearShape;
use sortie_nn::tape::{Linear, Pass, Tape, Var};

const AGENTS: usize = 20;
const ROWS: usize = 26;

/// Agents of two teams and a few more entities: too many queries for them to absorb their keys.
fn input(columns: usize) -> UtilityInput {
    let mut input = UtilityInput::default();
    for (row, value) in random(1, ROWS).into_iter().enumerate() {
        for column in [row % columns, (7 * row + 3) % columns, columns - 1] {
            input.rows.push(column, value + 0.1 * column as f32);
        }
        input.rows.end_row();
    }
    for agent in 0..AGENTS {
        (agent % 2..ROWS).step_by(2).for_each(|row| input.visible.push(row));
        input.visible.end_list();
    }
    input
}

/// Layers one behind the other in a vector.
struct Layers(usize);

impl Layers {
    fn next(&mut self, input: usize, output: usize, has_bias: bool) -> Linear {
        let weight = self.0;
        let bias = weight + input * output;
        self.0 = if has_bias { bias + output } else { bias };
        Linear { shape: LinearShape { input, output }, weight, bias: has_bias.then_some(bias) }
    }
}

/// Entities embedded and looked at, and what agents make of it: with `queries` and all behind them, tensors in
/// the order of utility networks and coaches.
fn trunk(
    t: &mut Pass<'_>,
    layers: &mut Layers,
    input: &UtilityInput,
    columns: usize,
    AttentionShape { width, heads }: AttentionShape,
) -> Var {
    let fc1 = layers.next(columns, width, true);
    let queries = layers.next(width, width, false);
    let keys_values = layers.next(width, 2 * width, false);
    let out = layers.next(width, width, true);
    let entities = t.sparse_linear(&input.rows, fc1);
    let entities = t.relu(entities);
    let agents = t.rows(entities, 0..AGENTS);
    let queries = t.linear(agents, queries);
    let keys_values = t.linear(entities, keys_values);
    let attended = t.attention(queries, keys_values, &input.visible, heads);
    t.linear_rectified(attended, out)
}

fn bits(numbers: &[f32]) -> Vec<u32> {
    numbers.iter().map(|number| number.to_bits()).collect()
}

/// What a network gives, and the gradient of a loss with these slopes by it.
fn on_tape(
    parameters: &[f32],
    slopes: &[f32],
    network: impl Fn(&mut Pass<'_>) -> Var,
) -> [Vec<u32>; 2] {
    let mut tape = Tape::default();
    let mut gradient = vec![0.0; parameters.len()];
    // The second pass finds the memory of the first.
    let mut given = Vec::new();
    for _ in 0..2 {
        gradient.fill(0.0);
        let mut t = tape.begin(parameters);
        let y = network(&mut t);
        given = bits(t.values(y));
        let y = t.reshape(y, slopes.len());
        let slopes = t.input(slopes.len(), slopes);
        let terms = t.multiply(y, slopes);
        let loss = t.sum_columns(terms);
        t.backward(loss, &mut gradient);
    }
    [given, bits(&gradient)]
}

#[test]
fn the_utility_network_has_equal_bits() {
    for (width, heads) in [(64, 4), (32, 4), (12, 3)] {
        let shape = UtilityShape { input: 30, width, heads, base: 48, actions: 7, skip: false };
        let network =
            UtilityNetwork::initialise(shape, 3.0, &mut generator(1, Purpose::Weights, 0));
        let (input, slopes) = (input(shape.input), random(2, AGENTS * shape.actions));
        let mut pass = UtilityPass::new(shape);
        let utilities = bits(pass.forward(&network, &input));
        let mut gradient = vec![0.0; shape.parameters()];
        pass.backward(&network, &input, &slopes, &mut gradient);

        let [given, own_gradient] = on_tape(network.parameters(), &slopes, |t| {
            let layers = &mut Layers(0);
            let attention = AttentionShape { width, heads };
            let looked = trunk(t, layers, &input, shape.input, attention);
            let base = t.linear_rectified(looked, layers.next(width, shape.base, true));
            t.linear(base, layers.next(shape.base, shape.actions, true))
        });
        assert_eq!(given, utilities);
        assert_eq!(own_gradient, bits(&gradient));
    }
}

const COACH: CoachShape = CoachShape { features: 20, marks: 5, width: 32, heads: 4, strategy: 9 };

/// Parameters with logarithms of variances that no bound changes.
fn within_bounds(mut parameters: Vec<f32>) -> Vec<f32> {
    let end = parameters.len();
    parameters[end - COACH.strategy..].fill(-4.0);
    parameters
}

#[test]
fn the_coach_has_equal_bits() {
    let drawn = Coach::initialise(COACH, &mut generator(1, Purpose::Weights, 0));
    let coach = Coach::from_parameters(COACH, within_bounds(drawn.parameters().to_vec()));
    let coach = coach.expect("as many parameters");
    let columns = COACH.features + COACH.marks;
    let (input, mut slopes) = (input(columns), random(2, AGENTS * 2 * COACH.strategy));
    let mut pass = CoachPass::default();
    let rows = bits(pass.forward(&coach, &input));
    let mut gradient = vec![0.0; coach.parameters().len()];
    pass.backward(&coach, &input, &mut slopes, &mut gradient);

    let [given, own_gradient] = on_tape(coach.parameters(), &slopes, |t| {
        let layers = &mut Layers(0);
        let attention = AttentionShape { width: COACH.width, heads: COACH.heads };
        let looked = trunk(t, layers, &input, columns, attention);
        t.linear(looked, layers.next(COACH.width, 2 * COACH.strategy, true))
    });
    assert_eq!(given, rows);
    assert_eq!(own_gradient, bits(&gradient));
}

#[test]
fn the_recognition_network_agrees() {
    let shape = RecognitionShape { coach: COACH, actions: 6 };
    let drawn = Recognition::initialise(shape, &mut generator(1, Purpose::Weights, 0));
    let parameters = within_bounds(drawn.parameters().to_vec());
    let network = Recognition::from_parameters(shape, parameters).expect("as many parameters");
    let columns = COACH.features + COACH.marks + shape.actions;
    let (input, mut slopes) = (input(columns), random(2, AGENTS * 2 * COACH.strategy));
    let mut pass = RecognitionPass::default();
    let rows = pass.forward(&network, &input).to_vec();
    let mut gradient = vec![0.0; network.parameters().len()];
    pass.backward(&network, &input, &mut slopes, &mut gradient);

    let (width, strategy) = (COACH.width, COACH.strategy);
    let [given, own_gradient] = on_tape(network.parameters(), &slopes, |t| {
        let layers = &mut Layers(0);
        let looked =
            trunk(t, layers, &input, columns, AttentionShape { width, heads: COACH.heads });
        let hidden = t.linear_rectified(looked, layers.next(width, 2 * width, true));
        let mut last = [0, 1].map(|_| layers.next(width, strategy, false));
        last.iter_mut().enumerate().for_each(|(i, last)| last.bias = Some(layers.0 + i * strategy));
        let halves = [0, 1].map(|half| {
            let hidden = t.columns(hidden, half * width..(half + 1) * width);
            t.linear(hidden, last[half])
        });
        t.concat(&halves)
    });
    // By hand the offsets stand there before the product is added, which rounds otherwise.
    let close = |given: &[u32], want: &[f32]| {
        assert_eq!(given.len(), want.len());
        for (given, want) in given.iter().map(|bits| f32::from_bits(*bits)).zip(want) {
            assert!((given - want).abs() < 1e-5 * want.abs().max(1.0), "{given} against {want}");
        }
    };
    close(&given, &rows);
    close(&own_gradient, &gradient);
}
