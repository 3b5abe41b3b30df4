//! A plan's guards as files and messages have them.

use std::format;
use std::string::{String, ToString};
use std::vec::Vec;

use serde::{Deserialize, Serialize};

use super::guards::{FORM, GuardFallback, Guards, MAGIC, checksum};
use super::trip::GuardError;

/// Guards of a policy. Lists have one number for all inputs or outputs, or one for each of their numbers, in the plan's
/// order; empty ones guard nothing, and an infinite number is no limit.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GuardFacts {
    /// Further decisions for which the fallback stays in force after a trip.
    pub hold: u32,
    /// What is given out where a guard tripped; none = what the caller does without an answer.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fallback: Option<GuardedOutputs>,
    /// The oldest that an observation may be, in milliseconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub age_ms: Option<f64>,
    /// What is let in.
    #[serde(skip_serializing_if = "InputGuards::is_empty")]
    pub inputs: InputGuards,
    /// What is let out.
    #[serde(skip_serializing_if = "OutputGuards::is_empty")]
    pub outputs: OutputGuards,
}

/// What is given out where a guard tripped: `"hold"`, `"zero"`, or numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected `hold`, `zero`, or a list of numbers")]
pub enum GuardedOutputs {
    /// By name.
    Named(GuardedBy),
    /// These: one for all outputs, or one for each.
    Numbers(Vec<f32>),
}

/// What is given out that has a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum GuardedBy {
    /// The last outputs once more; zeros before the first.
    Hold,
    /// Zeros.
    Zero,
}

/// The range of inputs.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InputGuards {
    /// Lowest values.
    pub lowest: Vec<f32>,
    /// Highest values.
    pub highest: Vec<f32>,
}

/// The limits of outputs.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OutputGuards {
    /// Lowest values.
    pub lowest: Vec<f32>,
    /// Highest values.
    pub highest: Vec<f32>,
    /// Largest changes from one decision to the next.
    pub change: Vec<f32>,
    /// What is done with outputs beyond their limits.
    pub beyond: Beyond,
}

/// What is done with outputs beyond their limits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Beyond {
    /// The fallback is given out.
    #[default]
    Fallback,
    /// They are brought back to their limits, and that is told.
    Clamp,
}

/// What a plan has that guards are about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GuardedSizes {
    /// Numbers of all inputs.
    pub inputs: usize,
    /// Numbers of all outputs.
    pub outputs: usize,
    /// Whether the policy chooses among actions: then its outputs are scores, and not guarded.
    pub chooses: bool,
}

impl InputGuards {
    /// A range for so many inputs in which nothing was seen yet.
    pub fn unseen(inputs: usize) -> Self {
        Self {
            lowest: std::vec![f32::INFINITY; inputs],
            highest: std::vec![f32::NEG_INFINITY; inputs],
        }
    }

    /// Widens the range to hold an observation, all inputs one behind the other.
    pub fn see<'a>(&mut self, inputs: impl IntoIterator<Item = &'a f32>) {
        let ranges = self.lowest.iter_mut().zip(&mut self.highest);
        for ((lowest, highest), input) in ranges.zip(inputs) {
            (*lowest, *highest) = (lowest.min(*input), highest.max(*input));
        }
    }

    /// Widens the range of each input by `margin` times its width, on either side.
    pub fn widen(&mut self, margin: f32) {
        for (lowest, highest) in self.lowest.iter_mut().zip(&mut self.highest) {
            let more = margin * (*highest - *lowest);
            (*lowest, *highest) = (*lowest - more, *highest + more);
        }
    }

    /// Whether nothing is guarded.
    pub fn is_empty(&self) -> bool {
        self.lowest.is_empty() && self.highest.is_empty()
    }
}

impl OutputGuards {
    /// Whether nothing is guarded.
    pub fn is_empty(&self) -> bool {
        self.lowest.is_empty() && self.highest.is_empty() && self.change.is_empty()
    }
}

impl GuardFacts {
    /// Those of a plan's bytes, where there are any.
    ///
    /// # Errors
    /// As [`Guards::of_plan`].
    pub fn of_plan(plan: &[u8]) -> Result<Option<Self>, GuardError> {
        Ok(Guards::of_plan(plan)?.map(Self::from))
    }

    /// The first thing for which they cannot be a plan's guards, in words.
    pub fn flaw(&self, sizes: &GuardedSizes) -> Option<String> {
        let GuardedSizes { inputs, outputs, chooses } = *sizes;
        let of_outputs = !self.outputs.is_empty() || self.safe().is_some();
        if chooses && of_outputs {
            let words = "the policy chooses among actions: its outputs are scores and are not guarded, leave `outputs` and \
                         numbers of `fallback` out";
            return Some(words.to_string());
        }
        if self.inputs.is_empty() && self.outputs.is_empty() && self.age_ms.is_none() {
            return Some("nothing is guarded: name `inputs`, `outputs` or `age_ms`".to_string());
        }
        if self.age_ms.is_some_and(|ms| !(ms > 0.0 && ms <= 1.0e9)) {
            return Some("`age_ms` is not above 0 and up to 1000000000".to_string());
        }
        let OutputGuards { lowest, highest, change, .. } = &self.outputs;
        let lists = [
            ("inputs.lowest", self.inputs.lowest.as_slice(), inputs),
            ("inputs.highest", self.inputs.highest.as_slice(), inputs),
            ("outputs.lowest", lowest.as_slice(), outputs),
            ("outputs.highest", highest.as_slice(), outputs),
            ("outputs.change", change.as_slice(), outputs),
            ("fallback", self.safe().unwrap_or_default(), outputs),
        ]
        .map(|(name, list, wanted)| Guarded { name, list, wanted });
        if let Some(flaw) = lists.iter().find_map(Guarded::flaw) {
            return Some(flaw);
        }
        let [in_lowest, in_highest, lowest, highest, change, safe] = &lists;
        if let Some(at) = change.each(0.0).position(|change| change < 0.0) {
            return Some(format!("`outputs.change` is negative at {at}"));
        }
        if let Some(at) = safe.each(0.0).position(|number| !number.is_finite()) {
            return Some(format!("`fallback` is no finite number at {at}"));
        }
        in_lowest.above(in_highest).or_else(|| lowest.above(highest)).or_else(|| {
            let is_named = self.safe().is_some();
            is_named.then(|| lowest.above(safe).or_else(|| safe.above(highest))).flatten()
        })
    }

    /// Writes them behind all that stands in a plan of these sizes, which has none.
    ///
    /// # Errors
    /// The [flaw](Self::flaw).
    pub fn append_to(&self, plan: &mut Vec<u8>, sizes: &GuardedSizes) -> Result<(), String> {
        if let Some(flaw) = self.flaw(sizes) {
            return Err(flaw);
        }
        let fallback = match &self.fallback {
            None => GuardFallback::Unsaid,
            Some(GuardedOutputs::Named(GuardedBy::Hold)) => GuardFallback::Hold,
            Some(GuardedOutputs::Named(GuardedBy::Zero)) => GuardFallback::Zero,
            Some(GuardedOutputs::Numbers(_)) => GuardFallback::Safe,
        };
        let kind = GuardFallback::ALL.iter().position(|kind| *kind == fallback).unwrap_or(0);
        let clamps = self.outputs.beyond == Beyond::Clamp;
        let age_ns = self.age_ms.map_or(u64::MAX, |ms| (ms * 1.0e6).round() as u64);
        let counted = |is_empty: bool, count: usize| if is_empty { 0 } else { count };
        let inputs = counted(self.inputs.is_empty(), sizes.inputs);
        let outputs = counted(self.outputs.is_empty(), sizes.outputs);
        let mut body = Vec::from([FORM, kind as u8, u8::from(clamps), 0]);
        body.extend(self.hold.to_le_bytes());
        body.extend(age_ns.to_le_bytes());
        body.extend([inputs, outputs].iter().flat_map(|count| (*count as u32).to_le_bytes()));
        // A number that is no limit is the largest there is: what is infinite then lies beyond it.
        let finite = |number: f32| number.clamp(f32::MIN, f32::MAX);
        let lowest = each(&self.inputs.lowest, f32::MIN, inputs);
        for (lowest, highest) in lowest.zip(each(&self.inputs.highest, f32::MAX, inputs)) {
            body.extend([lowest, highest].iter().flat_map(|limit| finite(*limit).to_le_bytes()));
        }
        let OutputGuards { lowest, highest, change, .. } = &self.outputs;
        let lowest = each(lowest, f32::MIN, outputs).zip(each(highest, f32::MAX, outputs));
        for ((lowest, highest), change) in lowest.zip(each(change, f32::INFINITY, outputs)) {
            let limits = [finite(lowest), finite(highest), change];
            body.extend(limits.iter().flat_map(|limit| limit.to_le_bytes()));
        }
        if let Some(safe) = self.safe() {
            body.extend(each(safe, 0.0, sizes.outputs).flat_map(f32::to_le_bytes));
        }
        let length = (body.len() as u32).to_le_bytes();
        plan.extend_from_slice(&MAGIC);
        plan.extend_from_slice(&length);
        plan.extend_from_slice(&checksum(&MAGIC, &length, &body).to_le_bytes());
        plan.append(&mut body);
        Ok(())
    }

    /// The safe outputs, where numbers are named.
    fn safe(&self) -> Option<&[f32]> {
        match &self.fallback {
            Some(GuardedOutputs::Numbers(numbers)) => Some(numbers.as_slice()),
            _ => None,
        }
    }
}

/// A list as somebody wrote it, and how many numbers it is about.
struct Guarded<'a> {
    name: &'static str,
    list: &'a [f32],
    wanted: usize,
}

impl Guarded<'_> {
    /// What is wrong with it alone.
    fn flaw(&self) -> Option<String> {
        let Self { name, list, wanted } = self;
        let count = list.len();
        if count > 1 && count != *wanted {
            return Some(format!("`{name}` has {count} numbers, needed are 1 or {wanted}"));
        }
        let at = list.iter().position(|number| number.is_nan())?;
        Some(format!("`{name}` is NaN at {at}"))
    }

    /// One for each; `otherwise` where nothing is said.
    fn each(&self, otherwise: f32) -> impl Iterator<Item = f32> + use<> {
        each(self.list, otherwise, self.wanted)
    }

    /// Says where this list is above another, whose numbers it must not exceed.
    fn above(&self, other: &Self) -> Option<String> {
        let mut pairs = self.each(f32::NEG_INFINITY).zip(other.each(f32::INFINITY));
        let at = pairs.position(|(lowest, highest)| lowest > highest)?;
        Some(format!("`{}` is above `{}` at {at}", self.name, other.name))
    }
}

/// One for each of so many; `otherwise` where nothing is said.
fn each(list: &[f32], otherwise: f32, count: usize) -> impl Iterator<Item = f32> + use<> {
    let one = if list.is_empty() { Vec::from([otherwise]) } else { list.to_vec() };
    one.into_iter().cycle().take(count)
}

impl From<Guards<'_>> for GuardFacts {
    /// Lists in which nothing is a limit are empty, those of equal numbers have one.
    fn from(guards: Guards<'_>) -> Self {
        let inputs = guards.input_limits().iter().map(super::guards::InputLimits::range);
        let outputs = guards.output_limits().iter().map(super::guards::OutputLimits::all);
        let (inputs, outputs): (Vec<_>, Vec<_>) = (inputs.collect(), outputs.collect());
        let of_inputs = |at: usize| short(inputs.iter().filter_map(|range| range.get(at)));
        let of_outputs = |at: usize| short(outputs.iter().filter_map(|limits| limits.get(at)));
        let beyond = if guards.clamps() { Beyond::Clamp } else { Beyond::Fallback };
        Self {
            hold: guards.hold(),
            fallback: match guards.fallback() {
                GuardFallback::Unsaid => None,
                GuardFallback::Hold => Some(GuardedOutputs::Named(GuardedBy::Hold)),
                GuardFallback::Zero => Some(GuardedOutputs::Named(GuardedBy::Zero)),
                GuardFallback::Safe => {
                    Some(GuardedOutputs::Numbers(guards.safe_outputs().collect()))
                }
            },
            age_ms: guards.age_ns_max().map(|ns| ns as f64 / 1.0e6),
            inputs: InputGuards { lowest: of_inputs(0), highest: of_inputs(1) },
            outputs: OutputGuards {
                lowest: of_outputs(0),
                highest: of_outputs(1),
                change: of_outputs(2),
                beyond,
            },
        }
    }
}

/// A list as short as it can be said.
fn short<'a>(numbers: impl Iterator<Item = &'a f32>) -> Vec<f32> {
    let said = |number: &f32| {
        if number.abs() == f32::MAX { f32::INFINITY.copysign(*number) } else { *number }
    };
    let numbers: Vec<f32> = numbers.map(said).collect();
    match numbers.first() {
        Some(first) if numbers.iter().all(|number| number == first) => {
            if first.is_infinite() {
                Vec::new()
            } else {
                Vec::from([*first])
            }
        }
        _ => numbers,
    }
}
