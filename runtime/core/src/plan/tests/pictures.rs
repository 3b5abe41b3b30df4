//! Steps on pictures as plans hold them.

use std::vec;
use std::vec::Vec;

use super::Random;
use super::drafts::{Draft, assert_close, numbers};
use crate::ops::{
    ConvolvePatches, Flag, Fold, FoldPatches, Input, Int8ConvolvePatches, Meaning, Op, Patches,
    Place, quantised_picture,
};
use crate::plan::PlanError;

/// Two by two patches of a picture of two channels and 4 x 5 points, side by side.
const PATCHES: Patches = Patches {
    count: [3, 4],
    steps: [10, 2],
    runs: [2, 1],
    run_steps: [10, 0],
    run: 4,
    to_steps: [12, 3],
};

#[test]
fn a_convolution_and_a_pool_are_steps_of_a_plan() {
    let mut random = Random(11);
    let (x, weights) = (numbers(&mut random, 40), numbers(&mut random, 8 * 16));
    let mut draft = Draft::default();
    let places = [draft.weights(&weights), draft.weights(&[0.5; 16])];
    let from = draft.input(x.len());
    let (between, to) = (draft.place(36), draft.place(3));
    let [weights_at, bias] = places;
    draft.push(Op::ConvolvePatches(ConvolvePatches {
        weights: weights_at,
        bias,
        outputs: 3,
        relu: Flag::No,
        patches: PATCHES,
        from,
        to: between,
    }));
    // One patch: the whole picture.
    let patches = Patches { count: [1, 1], runs: [3, 4], run_steps: [12, 3], run: 3, ..PATCHES };
    let (fold, relu) = (Fold::Maximum, Flag::No);
    draft.push(Op::FoldPatches(FoldPatches {
        fold,
        weights: 0,
        bias: 0,
        relu,
        patches,
        from: between,
        to,
    }));
    draft.output(to);
    let got = draft.respond(&[&x], 3).unwrap();
    let mut want = vec![f64::NEG_INFINITY; 3];
    for (row, column) in (0..3).flat_map(|row| (0..4).map(move |column| (row, column))) {
        for (output, want) in want.iter_mut().enumerate() {
            let place = |input: usize| row * 10 + column * 2 + input / 4 * 10 + input % 4;
            let terms = (0..8)
                .map(|input| f64::from(x[place(input)]) * f64::from(weights[input * 16 + output]));
            *want = want.max(0.5 + terms.sum::<f64>());
        }
    }
    assert_close(&got, &want, "the largest of a convolution");
}

#[test]
fn steps_on_pictures_stay_inside_their_places() {
    let place = |offset, len| Place { offset, len };
    let (from, to) = (place(0, 40), place(64, 36));
    let plain = ConvolvePatches {
        weights: 0,
        bias: 128,
        outputs: 3,
        relu: Flag::No,
        patches: PATCHES,
        from,
        to,
    };
    let fold = |fold, weights, patches, to| {
        let (bias, relu) = (128, Flag::No);
        Op::FoldPatches(FoldPatches { fold, weights, bias, relu, patches, from, to })
    };
    let far = u32::MAX;
    let mut wrong: Vec<Op> = [
        Patches { count: [0, 4], ..PATCHES },
        Patches { count: [4, 4], ..PATCHES },
        Patches { count: [far, far], steps: [0; 2], to_steps: [0; 2], ..PATCHES },
        Patches { steps: [11, 2], ..PATCHES },
        Patches { steps: [far, far], ..PATCHES },
        Patches { runs: [3, 1], ..PATCHES },
        Patches { runs: [0, 1], ..PATCHES },
        Patches { runs: [2, far], ..PATCHES },
        Patches { run_steps: [11, 0], ..PATCHES },
        Patches { run_steps: [far, far], ..PATCHES },
        Patches { run: 0, ..PATCHES },
        Patches { run: 5, ..PATCHES },
        Patches { run: far, runs: [far, far], ..PATCHES },
        Patches { to_steps: [13, 3], ..PATCHES },
        Patches { to_steps: [far, far], ..PATCHES },
    ]
    .map(|patches| Op::ConvolvePatches(ConvolvePatches { patches, ..plain }))
    .into();
    wrong.extend(
        [
            ConvolvePatches { outputs: 0, ..plain },
            ConvolvePatches { outputs: 4, ..plain },
            ConvolvePatches { outputs: far, ..plain },
            ConvolvePatches { weights: 17, ..plain },
            ConvolvePatches { bias: 129, ..plain },
            ConvolvePatches { weights: far, ..plain },
            ConvolvePatches { from: place(0, 39), ..plain },
            ConvolvePatches { to: place(64, 35), ..plain },
            ConvolvePatches { to: place(39, 36), ..plain },
            ConvolvePatches { to: place(190, 36), ..plain },
        ]
        .map(Op::ConvolvePatches),
    );
    let channels = Patches { runs: [2, 2], run_steps: [10, 2], run: 2, ..PATCHES };
    wrong.extend([
        fold(Fold::Sum, 81, channels, to),
        fold(Fold::Sum, 0, channels, place(64, 34)),
        fold(Fold::Sum, 0, Patches { run: 3, ..channels }, place(64, 40)),
        fold(Fold::Maximum, 0, Patches { runs: [far, 2], run_steps: [0; 2], ..channels }, to),
        fold(Fold::Maximum, 0, Patches { runs: [2, 3], ..channels }, to),
        fold(Fold::Maximum, 0, channels, place(30, 36)),
    ]);
    let load = |op| {
        let mut draft = Draft { weights: vec![0.0; 144], ..Draft::default() };
        draft.program.floats = 200;
        let (index, meaning) = (0, Meaning::None);
        draft.push(Op::Input(Input { index, meaning, to: place(0, 64) }));
        draft.push(op);
        draft.output(place(0, 8));
        draft.refused()
    };
    for op in wrong {
        assert_eq!(load(op), Some(PlanError::ShapeMismatch { op: 1 }), "{op:?}");
    }
    let right = [
        Op::ConvolvePatches(plain),
        fold(Fold::Sum, 64, channels, to),
        fold(Fold::Maximum, 0, channels, to),
    ];
    for op in right {
        assert_eq!(load(op), None, "{op:?}");
    }
}

#[test]
fn int8_convolutions_stay_inside_their_places() {
    let place = |offset, len| Place { offset, len };
    let plain = Int8ConvolvePatches {
        weights: 0,
        steps: 32,
        bias: 48,
        outputs: 3,
        relu: Flag::No,
        patches: PATCHES,
        from: place(0, 40),
        to: place(64, 36),
        quantised: place(112, quantised_picture(40) as u32),
    };
    let odd = Patches { run: 3, ..PATCHES };
    let wrong = [
        Int8ConvolvePatches { outputs: 4, ..plain },
        Int8ConvolvePatches { weights: 33, ..plain },
        Int8ConvolvePatches { steps: 49, ..plain },
        Int8ConvolvePatches { bias: 49, ..plain },
        Int8ConvolvePatches { patches: Patches { run: 5, ..PATCHES }, ..plain },
        Int8ConvolvePatches { patches: Patches { runs: [2, 3], ..PATCHES }, ..plain },
        Int8ConvolvePatches { quantised: place(112, 31), ..plain },
        Int8ConvolvePatches { quantised: place(96, 32), ..plain },
        Int8ConvolvePatches { to: place(30, 36), ..plain },
    ];
    let load = |step, int8| {
        let mut draft = Draft { weights: vec![0.0; 64], int8, ..Draft::default() };
        draft.program.floats = 200;
        let (index, meaning) = (0, Meaning::None);
        draft.push(Op::Input(Input { index, meaning, to: place(0, 64) }));
        draft.push(Op::Int8ConvolvePatches(step));
        draft.output(place(0, 8));
        draft.refused()
    };
    let refused = Some(PlanError::ShapeMismatch { op: 1 });
    for step in wrong {
        assert_eq!(load(step, true), refused, "{step:?}");
    }
    assert_eq!(load(plain, false), refused);
    for patches in [PATCHES, odd] {
        assert_eq!(load(Int8ConvolvePatches { patches, ..plain }, true), None, "{patches:?}");
    }
}
