//! Whether two engines give the same answers.

use serde::Serialize;
use sortie_core::plan::Proof;

use crate::error::CompileError;

/// Largest error of an f32 plan where the truth is not known, see [`Comparison::max_rel_error`].
pub const TOLERANCE: f32 = 1.0e-5;

/// So many times its scatter a right engine's number may be from the truth: the worst of the right ones measured was six, a
/// weight matrix in 16 bits moves some number by twenty and more.
pub const MOST_DISTANCE: f64 = 16.0;

/// So large the root mean square of an output number's distances may be; right engines stay below one.
pub const MOST_MEAN_DISTANCE: f64 = 3.0;

/// A number of an answer in double precision, and how far from it right engines of 32 bits are found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrueNumber {
    /// The number.
    pub value: f64,
    /// The root mean square of right engines' distances from it.
    pub scatter: f64,
}

impl TrueNumber {
    /// How far an engine's number is from it, in scatters.
    pub fn distance(self, number: f32) -> f64 {
        let number = f64::from(number);
        if number == self.value { 0.0 } else { (number - self.value).abs() / self.scatter }
    }

    /// How far two engines' numbers are from each other, both of which may scatter.
    pub fn between(self, one: f32, other: f32) -> f64 {
        let apart = (f64::from(one) - f64::from(other)).abs();
        if one == other { 0.0 } else { apart / (2.0 * self.scatter) }
    }

    /// How far it is from another number, both of which scatter: what another choice is judged by.
    pub fn apart(self, other: Self) -> f64 {
        (self.value - other.value).abs() / (self.scatter + other.scatter)
    }

    /// Whether 32 bits hold the number, and no right engine may find it to be none.
    pub fn is_finite(self) -> bool {
        fits(self.value) && self.scatter.is_finite()
    }

    /// Whether right engines agree that there is a number, or that there is none.
    pub fn is_sure(self) -> bool {
        self.scatter.is_finite()
    }
}

/// Whether it is a number, and 32 bits hold it.
pub fn fits(number: f64) -> bool {
    number.abs() <= f64::from(f32::MAX)
}

/// How far an engine is from the expected answers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// What was compared, for example `plan against tract`.
    pub name: String,
    /// Observations.
    pub inputs: usize,
    /// Largest |a - b| / (1 + m) of any utility, with m the largest |b| of its observation.
    ///
    /// Rounding grows with the largest numbers of a sum, not with its result: a small utility beside
    /// large ones carries their error, in the source graph as well.
    pub max_rel_error: f32,
    /// Largest distance of a number from the truth, or of two engines' numbers from each other, in what right engines
    /// are found from the truth there; none where the truth is not known. It judges its inputs in the place of the error.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_distance: Option<f64>,
    /// Largest error of the inputs whose truth is not known: what judges them.
    #[serde(skip)]
    pub max_judged_error: f32,
    /// Observations for which another action, or another allocation, was chosen.
    pub action_mismatches: usize,
    /// Inputs without an answer, as it should be: an engine refuses, its numbers are not finite, or no
    /// action is available.
    pub refused: usize,
    /// Inputs for which only one of both gave an answer, and inputs that should have been refused.
    pub refusals_differ: usize,
    /// Inputs that are no numbers, rightly refused, to which the other engine gave finite numbers.
    pub swallowed: usize,
    /// Whether differences count: not where products leave the range of f32 in any engine.
    pub judged: bool,
    /// The observation with the largest error.
    #[serde(skip)]
    pub worst_input: usize,
}

impl Comparison {
    /// Nothing compared yet.
    pub fn new(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            inputs: 0,
            max_rel_error: 0.0,
            max_distance: None,
            max_judged_error: 0.0,
            action_mismatches: 0,
            refused: 0,
            refusals_differ: 0,
            swallowed: 0,
            judged: true,
            worst_input: 0,
        }
    }

    /// Adds an input that one engine did not answer, or both.
    pub fn add_refusal(&mut self, agreed: bool) {
        self.inputs += 1;
        self.refused += usize::from(agreed);
        self.refusals_differ += usize::from(!agreed);
    }

    /// Adds an input that must be refused, whatever the other engine makes of it.
    pub fn add_no_number(&mut self, refused: bool, other_answers: bool) {
        self.add_refusal(refused);
        self.swallowed += usize::from(refused && other_answers);
    }

    /// Whether nothing counts as a difference, but for other choices: within the tolerance they are near ties.
    pub fn agrees(&self) -> bool {
        let is_near = self.max_judged_error <= TOLERANCE
            && self.max_distance.is_none_or(|distance| distance <= MOST_DISTANCE);
        !self.judged || is_near && self.refusals_differ == 0
    }

    /// What a plan that was compared with the truth says of itself.
    pub fn proof(&self) -> Proof {
        let max_distance = self.max_distance.unwrap_or(0.0) as f32;
        Proof::Distance { max_distance, inputs: u16::try_from(self.inputs).unwrap_or(u16::MAX) }
    }

    /// Adds an input by how far its numbers are, in scatters, beside their error. What is no number is further than any.
    pub fn add_distance(&mut self, distance: f64, error: f32, same_action: bool) {
        let distance = if distance.is_nan() { f64::INFINITY } else { distance };
        self.max_distance = Some(self.max_distance.map_or(distance, |most| most.max(distance)));
        self.note(error, same_action);
    }

    /// Notes that no action was chosen from the numbers that were added last, by both or by one.
    pub fn add_unchosen(&mut self, by_both: bool) {
        self.refused += usize::from(by_both);
        self.refusals_differ += usize::from(!by_both);
    }

    /// Adds an input with its largest error.
    pub fn add_error(&mut self, error: f32, same_action: bool) {
        self.max_judged_error = self.max_judged_error.max(error);
        self.note(error, same_action);
    }

    fn note(&mut self, error: f32, same_action: bool) {
        if error > self.max_rel_error {
            (self.max_rel_error, self.worst_input) = (error, self.inputs);
        }
        self.inputs += 1;
        self.action_mismatches += usize::from(!same_action);
    }
}

/// The largest |a - b| / (1 + m), with m the largest |b|; infinite where only one of both is a number.
///
/// Rounding grows with the largest numbers of a sum, not with its result.
pub fn relative_error(got: &[f32], want: &[f32]) -> f32 {
    let largest = want.iter().fold(0.0, |largest: f32, value| largest.max(value.abs()));
    let error = |(got, want): (&f32, &f32)| match (got - want).abs() / (1.0 + largest) {
        _ if got == want => 0.0,
        error if error.is_nan() => f32::INFINITY,
        error => error,
    };
    let lengths = if got.len() == want.len() { 0.0 } else { f32::INFINITY };
    got.iter().zip(want).map(error).fold(lengths, f32::max)
}

/// How far an engine's numbers are from the truth: whether rounding accounts for them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Distances {
    /// The furthest of all.
    pub worst: Option<Worst>,
    /// Sums of squares of every output number, over how many inputs.
    squares: Vec<(f64, usize)>,
}

/// The number that is furthest from the truth.
#[derive(Clone, Debug, PartialEq)]
pub struct Worst {
    /// How far, in scatters.
    pub distance: f64,
    /// The input.
    pub input: usize,
    /// The engine's number.
    pub number: f32,
    /// What it should be.
    pub value: f64,
}

impl Distances {
    /// Adds numbers for an input; `place` says which output number each is an instance of.
    pub fn add(
        &mut self,
        input: usize,
        numbers: &[f32],
        truths: &[TrueNumber],
        place: impl Fn(usize) -> usize,
    ) {
        for (at, (number, truth)) in numbers.iter().zip(truths).enumerate() {
            let place = place(at);
            if self.squares.len() <= place {
                self.squares.resize(place + 1, (0.0, 0));
            }
            if !truth.is_finite() {
                continue;
            }
            let distance = truth.distance(*number);
            if let Some((square, count)) = self.squares.get_mut(place) {
                *square += distance * distance;
                *count += 1;
            }
            let is_worse = |worst: &Worst| distance.is_nan() || distance > worst.distance;
            if self.worst.as_ref().is_none_or(is_worse) {
                self.worst = Some(Worst { distance, input, number: *number, value: truth.value });
            }
        }
    }

    /// The largest of all; 0 where there is none.
    pub fn largest(&self) -> f64 {
        self.worst.as_ref().map_or(0.0, |worst| worst.distance)
    }

    /// The largest root mean square of any output number's distances.
    pub fn mean(&self) -> f64 {
        let mean = |(square, count): &(f64, usize)| (square / (*count).max(1) as f64).sqrt();
        self.squares.iter().map(mean).fold(0.0, f64::max)
    }

    /// Whether a right engine may be so far.
    pub fn is_right(&self) -> bool {
        self.largest() <= MOST_DISTANCE && self.mean() <= MOST_MEAN_DISTANCE
    }

    /// What is wrong with a plan that is too far, on inputs of a seed.
    pub fn error(&self, seed: u64) -> CompileError {
        let none = Worst { distance: 0.0, input: 0, number: 0.0, value: 0.0 };
        let Worst { distance, input, number, value } = self.worst.clone().unwrap_or(none);
        CompileError::Wrong {
            number,
            truth: value,
            distance,
            limit: MOST_DISTANCE,
            mean: self.mean(),
            mean_limit: MOST_MEAN_DISTANCE,
            input,
            seed,
        }
    }
}

/// Why an engine gave no answer.
pub fn cannot_run(error: impl std::fmt::Display) -> CompileError {
    CompileError::Run { reason: error.to_string() }
}
