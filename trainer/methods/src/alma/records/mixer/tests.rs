use sortie_nn::gradient_check::{assert_gradient, random};

use super::*;
use sortie_learn::random::{Purpose, generator};

const SIZES: [usize; 3] = [2, 1, 3];
const COLUMNS: usize = 9;

/// Three teams, each with one building; everybody sees the own team and building.
fn input() -> UtilityInput {
    let mut input = UtilityInput::default();
    for row in random(1, 9 * COLUMNS).chunks(COLUMNS) {
        input.rows.push_dense(row);
    }
    let mut first = 0;
    for (building, size) in SIZES.iter().enumerate() {
        for _ in 0..*size {
            (first..first + size).for_each(|row| input.visible.push(row));
            input.visible.push(6 + building);
            input.visible.end_list();
        }
        first += size;
    }
    input
}

fn mixer(kind: MixerKind) -> Mixer {
    let shape = MixerShape { kind, input: COLUMNS, width: 8, heads: 2, mixing: 4 };
    Mixer::initialise(shape, 3.0, &mut generator(2, Purpose::Weights, 0))
}

fn values(mixer: &Mixer, utilities: &[f32]) -> Vec<f32> {
    let input = input();
    let teams = Teams { input: &input, sizes: &SIZES, utilities };
    MixerPass::default().forward(mixer, teams).to_vec()
}

/// Slopes of `values . d_values` by utilities and parameters.
fn slopes(mixer: &Mixer, utilities: &[f32], d_values: &[f32]) -> (Vec<f32>, Vec<f32>) {
    let input = input();
    let teams = Teams { input: &input, sizes: &SIZES, utilities };
    let mut pass = MixerPass::default();
    pass.forward(mixer, teams);
    let mut d_utilities = vec![f32::NAN; utilities.len()];
    let mut gradient = vec![0.0; mixer.shape().parameters()];
    pass.backward(mixer, teams, d_values, &mut d_utilities, &mut gradient);
    (d_utilities, gradient)
}

#[test]
fn gradients_agree_with_finite_differences() {
    for kind in [MixerKind::Sum, MixerKind::Linear, MixerKind::Qmix] {
        let (mixer, utilities, d_values) = (mixer(kind), random(3, 6), random(4, 3));
        let (d_utilities, gradient) = slopes(&mixer, &utilities, &d_values);
        let loss = |mixer: &Mixer, utilities: &[f32]| {
            let values = values(mixer, utilities);
            values.iter().zip(&d_values).map(|(v, d)| f64::from(*v) * f64::from(*d)).sum()
        };
        assert_gradient("utilities", &utilities, &d_utilities, |moved| loss(&mixer, moved));
        for tensor in mixer.shape().tensors() {
            let at = &mixer.parameters()[tensor.range.clone()];
            assert_gradient(tensor.name, at, &gradient[tensor.range.clone()], |moved| {
                let mut mixer = mixer.clone();
                mixer.parameters_mut()[tensor.range.clone()].copy_from_slice(moved);
                loss(&mixer, &utilities)
            });
        }
    }
}

#[test]
fn a_better_utility_never_makes_a_team_worse() {
    for kind in [MixerKind::Sum, MixerKind::Linear, MixerKind::Qmix] {
        for scale in [0.1, 1.0, 10.0] {
            let utilities: Vec<f32> = random(5, 6).iter().map(|q| scale * q).collect();
            let (d_utilities, _) = slopes(&mixer(kind), &utilities, &[1.0; 3]);
            assert!(d_utilities.iter().all(|slope| *slope > 0.0), "{kind:?} {d_utilities:?}");
        }
    }
}

#[test]
fn a_sum_adds_up_and_linear_weights_add_up_to_one() {
    assert_eq!(values(&mixer(MixerKind::Sum), &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]), [3.0, 3.0, 15.0]);
    assert_eq!(mixer(MixerKind::Sum).shape().parameters(), 0);
    let linear = mixer(MixerKind::Linear);
    let (low, high) = (values(&linear, &[0.0; 6]), values(&linear, &[2.0; 6]));
    for (low, high) in low.iter().zip(&high) {
        assert!((high - low - 2.0).abs() < 1e-5, "{low} {high}");
    }
}

#[test]
fn the_order_of_a_team_does_not_matter() {
    // The last team's rows are turned by one.
    let turned = {
        let whole = input();
        let mut rows = sortie_nn::layers::SparseRows::default();
        for row in [0, 1, 2, 4, 5, 3, 6, 7, 8] {
            whole.rows.row(row).for_each(|(column, value)| rows.push(column, value));
            rows.end_row();
        }
        UtilityInput { rows, visible: whole.visible }
    };
    for kind in [MixerKind::Linear, MixerKind::Qmix] {
        let want = values(&mixer(kind), &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        let utilities = [1.0, 2.0, 3.0, 5.0, 6.0, 4.0];
        let teams = Teams { input: &turned, sizes: &SIZES, utilities: &utilities };
        let mut pass = MixerPass::default();
        for (got, want) in pass.forward(&mixer(kind), teams).iter().zip(&want) {
            assert!((got - want).abs() < 1e-5, "{kind:?}: {got} against {want}");
        }
    }
}
