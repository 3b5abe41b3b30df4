//! The one place where answers are compared: with the truth, with those of other engines, and with recorded ones.

use sortie_core::limits;

use crate::comparison::{Comparison, TOLERANCE, TrueNumber, relative_error};
use crate::families::{Family, Standard};
use crate::network::{Answer, NetworkInput};

/// The true outputs for an input.
pub type True = Vec<Vec<TrueNumber>>;

/// Compares what two gave for the inputs of a family, in scatters where the truth is known, else by their error.
pub fn compare(
    family: &Family<NetworkInput>,
    got: &[Option<Answer>],
    want: &[Option<Answer>],
    truths: &[Option<True>],
) -> Comparison {
    let mut comparison = family.comparison();
    for (index, (got, want)) in got.iter().zip(want).enumerate() {
        let want = want.as_ref().filter(|want| want.is_finite());
        if family.standard == Standard::Refusal {
            comparison.add_no_number(got.is_none(), want.is_some());
            continue;
        }
        let (Some(got), Some(want)) = (got, want) else {
            comparison.add_refusal(got.is_none() == want.is_none());
            continue;
        };
        let truth = truths.get(index).and_then(Option::as_ref);
        let truth = truth.filter(|truth| truth.iter().flatten().all(|number| number.is_finite()));
        let (error, same) = (error(got, want), got.action == want.action);
        match truth {
            Some(truth) => {
                let numbers = rows(&got.outputs, &want.outputs, truth);
                let numbers = numbers.map(|((got, want), truth)| truth.between(*got, *want));
                let choice = choice(truth, got.action, want.action);
                comparison.add_distance(furthest(numbers.chain([choice])), error, same);
            }
            None => comparison.add_error(error, same),
        }
        note_unchosen(&mut comparison, family.inputs.get(index), got.action, want.action);
    }
    comparison
}

/// Compares what an engine gave for the inputs of a family with the truth, as far as it is known.
pub fn compare_with_truth(
    family: &Family<NetworkInput>,
    got: &[Option<Answer>],
    truths: &[Option<True>],
) -> Comparison {
    let mut comparison = family.comparison();
    if family.standard == Standard::Refusal {
        got.iter().for_each(|got| comparison.add_no_number(got.is_none(), false));
        return comparison;
    }
    for (index, (got, truth)) in got.iter().zip(truths).enumerate() {
        let (Some(truth), Some(input)) = (truth, family.inputs.get(index)) else { continue };
        if !truth.iter().flatten().all(|number| number.is_sure()) {
            // Right engines answer or not, as their rounding falls.
            comparison.add_refusal(true);
            continue;
        }
        let has_answer =
            !truth.is_empty() && truth.iter().flatten().all(|number| number.is_finite());
        let Some(got) = got.as_ref().filter(|_| has_answer) else {
            comparison.add_refusal(got.is_some() == has_answer);
            continue;
        };
        let values = |output: &Vec<TrueNumber>| output.iter().map(|n| n.value as f32).collect();
        let want = truth.iter().map(values).collect();
        let want = Answer { outputs: want, action: best(truth, input) };
        let outputs = got.outputs.iter().zip(truth);
        let numbers = outputs.flat_map(|(got, truth)| got.iter().zip(truth));
        let numbers = numbers.map(|(got, truth)| truth.distance(*got));
        let choice = choice(truth, got.action, want.action);
        let distance = furthest(numbers.chain([choice]));
        comparison.add_distance(distance, error(got, &want), got.action == want.action);
        note_unchosen(&mut comparison, Some(input), got.action, want.action);
    }
    comparison
}

/// Whether only the truth tells if the difference of two answers is one.
pub fn needs_truth(got: &Option<Answer>, want: &Option<Answer>) -> bool {
    match (got, want.as_ref().filter(|want| want.is_finite())) {
        (Some(got), Some(want)) => error(got, want) > TOLERANCE || got.action != want.action,
        (got, want) => got.is_some() != want.is_some(),
    }
}

/// The largest error of any output, each on its own scale.
fn error(got: &Answer, want: &Answer) -> f32 {
    let outputs = got.outputs.iter().zip(&want.outputs);
    outputs.map(|(got, want)| relative_error(got, want)).fold(0.0, f32::max)
}

/// The numbers of two answers, output by output, each with its truth.
fn rows<'a>(
    got: &'a [Vec<f32>],
    want: &'a [Vec<f32>],
    truth: &'a [Vec<TrueNumber>],
) -> impl Iterator<Item = ((&'a f32, &'a f32), &'a TrueNumber)> {
    let outputs = got.iter().zip(want).zip(truth);
    outputs.flat_map(|((got, want), truth)| got.iter().zip(want).zip(truth))
}

/// How far the true utilities of two actions are apart, which others may choose between.
fn choice(truth: &[Vec<TrueNumber>], got: Option<u16>, want: Option<u16>) -> f64 {
    let score = |action: u16| truth.first()?.get(usize::from(action)).copied();
    match (got, want) {
        (Some(got), Some(want)) if got != want => match (score(got), score(want)) {
            (Some(got), Some(want)) => got.apart(want),
            _ => f64::INFINITY,
        },
        _ => 0.0,
    }
}

/// The available action whose true utility is largest, the first of several.
fn best(truth: &[Vec<TrueNumber>], input: &NetworkInput) -> Option<u16> {
    let (NetworkInput::Agent { seen, .. }, Some(utilities)) = (input, truth.first()) else {
        return None;
    };
    let open = utilities.iter().zip(&seen.available).zip(0..limits::ACTIONS as u16);
    let open = open.filter(|((_, available), _)| **available != 0);
    let mut best: Option<(f64, u16)> = None;
    for ((utility, _), action) in open {
        if best.is_none_or(|(largest, _)| utility.value > largest) {
            best = Some((utility.value, action));
        }
    }
    best.map(|(_, action)| action)
}

/// The largest of some distances; what is no number is further than any.
pub(crate) fn furthest(distances: impl Iterator<Item = f64>) -> f64 {
    distances.fold(0.0, |most, next| if next > most || next.is_nan() { next } else { most })
}

/// Counts an agent's input to which no action was given, by both or by one.
fn note_unchosen(
    comparison: &mut Comparison,
    input: Option<&NetworkInput>,
    got: Option<u16>,
    want: Option<u16>,
) {
    if matches!(input, Some(NetworkInput::Agent { .. })) && (got.is_none() || want.is_none()) {
        comparison.add_unchosen(got.is_none() && want.is_none());
    }
}
