//! Every build gives the sums that convolutions and pools are defined by, and the same bits.

use std::vec;
use std::vec::Vec;

use super::*;
use crate::kernels::Kernels;
use crate::kernels::arithmetic::{Exact, Fused};
use crate::kernels::build::{Build, Work};
use crate::kernels::int8::{Int8PatchLayer, Reach, Row, STRIP};

/// A convolution of a picture, each size down and to the right.
#[derive(Clone, Copy, Debug)]
struct Case {
    channels: usize,
    outputs: usize,
    size: [usize; 2],
    kernel: [usize; 2],
    stride: [usize; 2],
    dilation: [usize; 2],
    /// Whether the channels of a point stand side by side.
    has_points: bool,
    /// Numbers between what is made of a patch and of the next.
    gap: usize,
}

const PLAIN: Case = Case {
    channels: 3,
    outputs: 5,
    size: [6, 7],
    kernel: [3, 2],
    stride: [1, 1],
    dilation: [1, 1],
    has_points: true,
    gap: 0,
};

/// Numbers of patches on both sides of all that are worked on at once, channels and outputs that fill tiles or do not.
fn cases() -> Vec<Case> {
    let mut cases = vec![
        PLAIN,
        Case { gap: 4, ..PLAIN },
        Case { stride: [2, 3], ..PLAIN },
        Case { dilation: [2, 3], ..PLAIN },
        Case { dilation: [2, 1], stride: [1, 2], has_points: false, ..PLAIN },
        Case { has_points: false, gap: 1, ..PLAIN },
        Case { channels: 1, kernel: [5, 5], outputs: 33, ..PLAIN },
        Case { channels: 17, outputs: 16, kernel: [1, 1], ..PLAIN },
        Case { channels: 16, outputs: 48, kernel: [3, 3], size: [9, 9], ..PLAIN },
        Case { channels: 4, outputs: 32, kernel: [8, 8], stride: [4, 4], size: [20, 24], ..PLAIN },
        Case { size: [6, 2], kernel: [6, 2], ..PLAIN },
    ];
    cases.extend((1..=30).map(|width| Case { size: [1, width + 2], kernel: [1, 3], ..PLAIN }));
    cases
}

impl Case {
    fn inputs(&self) -> usize {
        self.channels * self.kernel[0] * self.kernel[1]
    }

    /// From a channel, a row and a column to the next.
    fn steps(&self) -> [usize; 3] {
        let [height, width] = self.size;
        match self.has_points {
            true => [1, width * self.channels, self.channels],
            false => [height * width, width, 1],
        }
    }

    fn result(&self) -> [usize; 2] {
        [0, 1].map(|way| {
            (self.size[way] - (self.kernel[way] - 1) * self.dilation[way] - 1) / self.stride[way]
                + 1
        })
    }

    /// The patches, each point of which is a run if `by_points`.
    fn patches(&self, outputs: usize) -> Patches {
        let [plane, row, column] = self.steps();
        let [down, right] = [row * self.dilation[0], column * self.dilation[1]];
        let whole = |numbers: [usize; 2]| numbers.map(|number| number as u32);
        let (runs, run_steps, run) = if self.has_points {
            (self.kernel, [down, right], self.channels)
        } else {
            ([self.channels, self.kernel[0]], [plane, down], self.kernel[1])
        };
        let each = outputs + self.gap;
        Patches {
            count: whole(self.result()),
            steps: whole([self.stride[0] * row, self.stride[1] * column]),
            runs: whole(runs),
            run_steps: whole(run_steps),
            run: run as u32,
            to_steps: whole([self.result()[1] * each + 3, each]),
        }
    }

    /// Where the numbers of a patch stand, in the order in which they are added up, and whose weight each is: its channel and its
    /// point.
    fn patch(&self, [row, column]: [usize; 2]) -> Vec<usize> {
        let [plane, down, right] = self.steps();
        let at = |channel: usize, k: usize, l: usize| {
            let y = row * self.stride[0] + k * self.dilation[0];
            let x = column * self.stride[1] + l * self.dilation[1];
            channel * plane + y * down + x * right
        };
        let ([rows, columns], channels) = (self.kernel, self.channels);
        let all = (0..self.inputs()).map(|input| match self.has_points {
            true => at(input % channels, input / channels / columns, input / channels % columns),
            false => at(input / (rows * columns), input / columns % rows, input % columns),
        });
        all.collect()
    }

    /// Rows, columns and places of all results.
    fn places(&self, outputs: usize) -> Vec<([usize; 2], usize)> {
        let [down, right] = self.patches(outputs).to_steps.map(|step| step as usize);
        let [rows, columns] = self.result();
        let all = (0..rows).flat_map(|row| (0..columns).map(move |column| [row, column]));
        all.map(|[row, column]| ([row, column], row * down + column * right)).collect()
    }

    fn picture(&self) -> Vec<f32> {
        numbers(self.channels * self.size[0] * self.size[1], 1)
    }
}

/// Any numbers of both signs.
fn numbers(count: usize, seed: usize) -> Vec<f32> {
    let number = |index: usize| ((index + seed) * 2_654_435_761) >> 7 & 0xffff;
    (0..count).map(|index| number(index) as f32 / 32_768.0 - 1.0).collect()
}

/// Rows of so many columns in tiles.
fn tiles(rows: &[f32], columns: usize) -> Vec<f32> {
    let tile = |first: usize| {
        let number = move |row: &[f32], lane: usize| row.get(first + lane).copied().unwrap_or(0.0);
        rows.chunks(columns).flat_map(move |row| (0..PART).map(move |lane| number(row, lane)))
    };
    (0..columns).step_by(PART).flat_map(tile).collect()
}

/// What stands between results.
const UNTOUCHED: f32 = 77.0;

enum Kind {
    Convolution,
    Fold(Fold),
}

/// Runs a layer whose weights are [`numbers`] of the seed 2 and bias those of the seed 3.
struct OnPatches<'c>(&'c Case, Kind);

impl Work for OnPatches<'_> {
    type Output = Vec<f32>;

    fn run(self, kernels: impl Kernels) -> Vec<f32> {
        let Self(case, kind) = self;
        let (rows, outputs) = match kind {
            Kind::Convolution => (case.inputs(), case.outputs),
            Kind::Fold(_) => (case.inputs() / case.channels, case.channels),
        };
        let patches = &case.patches(outputs);
        let weights = tiles(&numbers(rows * outputs, 2), outputs);
        let bias = tiles(&numbers(outputs, 3), outputs);
        let around = Around { bias: Some(&bias), relu: case.stride[0] > 1 };
        let mut layer = PatchLayer { patches, weights: &weights, around, outputs };
        let mut to = vec![UNTOUCHED; patches.result_reach(outputs as u32) as usize];
        match kind {
            Kind::Convolution => kernels.convolve(&layer, &case.picture(), &mut to),
            Kind::Fold(fold) => {
                if fold == Fold::Maximum {
                    layer.weights = &[];
                    layer.around.bias = None;
                }
                kernels.fold(&layer, fold, &case.picture(), &mut to);
            }
        }
        to
    }
}

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|value| value.to_bits()).collect()
}

/// The same bits of all builds, in both profiles, and what one of them gives.
fn on_all_builds(case: &Case, kind: impl Fn() -> Kind) -> Vec<f32> {
    let got = Build::PORTABLE.run::<Exact, _>(OnPatches(case, kind()));
    for build in Build::all() {
        let own = build.run::<Exact, _>(OnPatches(case, kind()));
        assert_eq!(bits(&own), bits(&got), "{build:?}, {case:?}");
    }
    let fused = Build::PORTABLE.run::<Fused, _>(OnPatches(case, kind()));
    for build in Build::all().filter(|build| build.fuses()) {
        let own = build.run::<Fused, _>(OnPatches(case, kind()));
        assert_eq!(bits(&own), bits(&fused), "{build:?}, fused, {case:?}");
    }
    got
}

/// Compares results with what a function of patch and output says, and what lies between them with nothing.
fn assert_results(case: &Case, outputs: usize, got: &[f32], want: impl Fn(&[usize], usize) -> f64) {
    let relu = case.stride[0] > 1;
    let mut rest = got.to_vec();
    for (at, place) in case.places(outputs) {
        let patch = case.patch(at);
        for output in 0..outputs {
            let want = want(&patch, output);
            let want = if relu { want.max(0.0) } else { want };
            let got = f64::from(got[place + output]);
            assert!((got - want).abs() < 1e-5, "{at:?}, {output}: {got}, want {want}; {case:?}");
            rest[place + output] = UNTOUCHED;
        }
    }
    assert!(rest.iter().all(|number| *number == UNTOUCHED), "{case:?}");
}

#[test]
fn convolutions_are_sums_over_patches() {
    for case in cases() {
        let got = on_all_builds(&case, || Kind::Convolution);
        let (picture, outputs) = (case.picture(), case.outputs);
        let (weights, bias) = (numbers(case.inputs() * outputs, 2), numbers(outputs, 3));
        assert_results(&case, outputs, &got, |patch, output| {
            let terms = patch.iter().enumerate().map(|(input, place)| {
                f64::from(picture[*place]) * f64::from(weights[input * outputs + output])
            });
            f64::from(bias[output]) + terms.sum::<f64>()
        });
    }
}

#[test]
fn folds_are_those_of_every_channel() {
    for case in cases().into_iter().filter(|case| case.has_points) {
        let (picture, channels) = (case.picture(), case.channels);
        let (weights, bias) = (numbers(case.inputs(), 2), numbers(channels, 3));
        let own = |patch: &[usize], channel: usize| -> Vec<f64> {
            let places = patch.iter().skip(channel).step_by(channels);
            places.map(|place| f64::from(picture[*place])).collect()
        };
        let got = on_all_builds(&case, || Kind::Fold(Fold::Sum));
        assert_results(&case, channels, &got, |patch, channel| {
            let weights = weights.iter().skip(channel).step_by(channels);
            let terms = own(patch, channel).into_iter().zip(weights);
            f64::from(bias[channel]) + terms.map(|(x, w)| x * f64::from(*w)).sum::<f64>()
        });
        let got = on_all_builds(&case, || Kind::Fold(Fold::Maximum));
        assert_results(&case, channels, &got, |patch, channel| {
            own(patch, channel).into_iter().fold(f64::NEG_INFINITY, f64::max)
        });
    }
}

/// Runs a layer of int8 weights, whose inputs are the picture's numbers as integers.
struct OnIntegers<'c>(&'c Case, &'c [Row]);

impl Work for OnIntegers<'_> {
    type Output = (Vec<f32>, Vec<i16>, f32);

    fn run(self, kernels: impl Kernels) -> Self::Output {
        let Self(case, rows) = self;
        let (patches, outputs) = (&case.patches(case.outputs), case.outputs);
        let [steps, bias] = [4, 5].map(|seed| tiles(&numbers(outputs, seed), outputs));
        let relu = case.stride[0] > 1;
        let layer = Int8PatchLayer { patches, rows, steps: &steps, bias: &bias, relu, outputs };
        let picture = case.picture();
        let mut integers = vec![7; (picture.len() + 1).next_multiple_of(32)];
        let reach = Reach::of_inputs(2 * case.inputs());
        let scale = kernels.quantise(&picture, reach, &mut integers).expect("finite numbers");
        let mut to = vec![UNTOUCHED; patches.result_reach(outputs as u32) as usize];
        kernels.int8_convolve(&layer, &integers, scale.step, &mut to);
        (to, integers, scale.step)
    }
}

#[test]
fn convolutions_of_integers_are_exact_sums() {
    for case in cases() {
        let weight = |input: usize, output: usize| (input * 37 + output * 11) as i8;
        let run = case.patches(1).run as usize;
        // A row for every pair of every run, behind an odd one a zero.
        let runs = (0..case.inputs()).step_by(run);
        let pairs = runs.flat_map(|start| (0..run).step_by(2).map(move |at| (start, at)));
        let pairs: Vec<_> = pairs.collect();
        let strips = (0..case.outputs).step_by(STRIP);
        let places = strips.flat_map(|first| pairs.iter().map(move |pair| (first, *pair)));
        let row = |(first, (start, at)): (usize, (usize, usize))| -> Row {
            std::array::from_fn(|byte| {
                let (output, at) = (first + byte / 2, at + byte % 2);
                if at < run && output < case.outputs { weight(start + at, output) } else { 0 }
            })
        };
        let rows: Vec<Row> = places.map(row).collect();
        let (got, integers, step) = Build::PORTABLE.run::<Exact, _>(OnIntegers(&case, &rows));
        for build in Build::all() {
            let (own, ..) = build.run::<Exact, _>(OnIntegers(&case, &rows));
            assert_eq!(bits(&own), bits(&got), "{build:?}, {case:?}");
        }
        let [steps, bias] = [4, 5].map(|seed| numbers(case.outputs, seed));
        assert_results(&case, case.outputs, &got, |patch, output| {
            let terms = patch.iter().enumerate().map(|(input, place)| {
                i64::from(integers[*place]) * i64::from(weight(input, output))
            });
            let sum = terms.sum::<i64>() as f32 * (step * steps[output]);
            f64::from(sum + bias[output])
        });
    }
}
