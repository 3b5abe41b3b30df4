//! Inputs of a policy that were recorded: arrays `in__NAME`, one case behind the other.

use sortie_plans::{PolicyFacts, RecordedCase};

use crate::npz::{Array, Arrays};

/// What was recorded, in the order in which a policy takes it.
pub struct RecordedInputs<'a> {
    arrays: &'a Arrays,
    /// Cases, at least one.
    pub count: usize,
    given: Vec<&'a Array>,
    /// Recurrent states; none where one of them was not recorded.
    states: Option<Vec<&'a Array>>,
}

impl<'a> RecordedInputs<'a> {
    /// Finds the inputs of a policy.
    ///
    /// # Errors
    /// The message names what is missing, or is not as the policy takes it.
    pub fn of(facts: &PolicyFacts, arrays: &'a Arrays) -> Result<Self, String> {
        let first = facts.given().find_map(|input| arrays.get(&format!("in__{}", input.name)));
        let count = first.and_then(|array| array.shape.first().copied()).unwrap_or(0);
        let mut inputs = Self { arrays, count, given: Vec::new(), states: None };
        for input in facts.given() {
            let array = inputs.needed(&format!("in__{}", input.name), input.length())?;
            inputs.given.push(array);
        }
        if count == 0 {
            return Err("the first axis of every array counts the cases: there are none".to_owned());
        }
        let states = facts.states.iter();
        let states =
            states.map(|state| inputs.found(&format!("in__{}", state.input), state.length));
        inputs.states = states.collect::<Result<Option<Vec<_>>, _>>()?;
        Ok(inputs)
    }

    /// An array that need not have been recorded.
    pub fn found(&self, name: &str, length: usize) -> Result<Option<&'a Array>, String> {
        match self.arrays.get(name) {
            Some(array) => self.checked(name, array, length).map(Some),
            None => Ok(None),
        }
    }

    /// An array that must have been.
    pub fn needed(&self, name: &str, length: usize) -> Result<&'a Array, String> {
        self.found(name, length)?.ok_or_else(|| self.missing(name))
    }

    /// Says that an array is missing.
    pub fn missing(&self, name: &str) -> String {
        let names: Vec<&str> = self.arrays.keys().map(String::as_str).collect();
        format!("there is no `{name}`, only {}", names.join(", "))
    }

    /// Whether all recurrent states were recorded.
    pub fn has_states(&self) -> bool {
        self.states.is_some()
    }

    /// The numbers of a case in an array.
    pub fn numbers(&self, array: &'a Array, case: usize) -> &'a [f32] {
        let length = array.numbers.len() / self.count.max(1);
        array.numbers.get(case * length..(case + 1) * length).unwrap_or_default()
    }

    /// The inputs of a case.
    pub fn case(&self, case: usize) -> RecordedCase<'a> {
        let inputs = self.given.iter().map(|array| self.numbers(array, case)).collect();
        let states = self.states.as_ref().map(|states| {
            states.iter().flat_map(|array| self.numbers(array, case)).copied().collect()
        });
        RecordedCase { inputs, states }
    }

    /// Refuses an array that does not hold so many numbers a case, or something that is no number.
    fn checked(&self, name: &str, array: &'a Array, length: usize) -> Result<&'a Array, String> {
        let cases = array.shape.first().copied().unwrap_or(0);
        if cases.checked_mul(length) != Some(array.numbers.len()) {
            return Err(format!(
                "`{name}` has the sizes {:?}, needed are cases of {length} numbers",
                array.shape
            ));
        }
        if cases != self.count {
            return Err(format!(
                "the first axis of every array counts the cases: {} in one, {cases} in `{name}`",
                self.count
            ));
        }
        match array.numbers.iter().position(|number| number.is_nan()) {
            Some(at) => Err(format!("`{name}` holds NaN in case {}", at / length.max(1))),
            None => Ok(array),
        }
    }
}
