//! A policy over inputs of fixed sizes as an agent of a team, whichever engine runs it.

use sortie_core::choose::masked_argmax;
use sortie_core::internal::ops::Meaning;
use sortie_core::{DecideError, Decision, Observation, Policy};

use crate::error::CompileError;
use crate::policy::FlatPolicy;
use crate::team_sizes::TeamSizes;

/// A policy whose inputs are what an agent observes.
pub struct TeamPolicy {
    policy: Box<dyn FlatPolicy>,
    team: TeamSizes,
    inputs: Vec<(Meaning, Vec<f32>)>,
    states: usize,
}

impl TeamPolicy {
    /// Binds a policy to what agents of a team observe.
    ///
    /// # Errors
    /// See [`TeamSizes::meanings`].
    pub fn new(policy: Box<dyn FlatPolicy>, team: TeamSizes) -> Result<Self, CompileError> {
        let facts = policy.facts();
        let lengths = facts.given().map(|input| vec![0.0; input.length()]);
        let inputs = team.meanings(facts)?.into_iter().zip(lengths).collect();
        let states = facts.state_length();
        Ok(Self { policy, team, inputs, states })
    }

    fn run(&mut self, seen: &Observation<'_>, states: &mut [f32]) -> Result<Vec<f32>, DecideError> {
        if states.len() != self.states {
            return Err(DecideError::HiddenState { want: self.states, got: states.len() });
        }
        for (meaning, numbers) in &mut self.inputs {
            *numbers = self.team.observed(*meaning, seen, numbers.len())?;
            check_finite(numbers)?;
        }
        let inputs: Vec<&[f32]> = self.inputs.iter().map(|(_, numbers)| &numbers[..]).collect();
        let mut next = states.to_vec();
        let answers = self.policy.run(&inputs, &mut next).map_err(|_| DecideError::NonFinite)?;
        let answer = answers.into_iter().next().ok_or(DecideError::BadLength)?;
        let scores = if answer.scores.is_empty() { answer.numbers } else { answer.scores };
        check_finite(&scores)?;
        check_finite(&next)?;
        states.copy_from_slice(&next);
        Ok(scores)
    }
}

impl TeamSizes {
    /// The numbers of an input for what an agent sees.
    fn observed(
        &self,
        meaning: Meaning,
        seen: &Observation<'_>,
        length: usize,
    ) -> Result<Vec<f32>, DecideError> {
        let numbers = match meaning {
            Meaning::OwnRow => self.row_of(seen, seen.self_index)?,
            Meaning::Available => {
                seen.available.iter().map(|code| f32::from(u8::from(*code != 0))).collect()
            }
            Meaning::Rows | Meaning::RowsOwnFirst => {
                let shown = |entity: usize| {
                    let is_shown = entity == seen.self_index || seen.visible.contains(entity);
                    if is_shown { self.row_of(seen, entity) } else { Ok(vec![0.0; self.row()]) }
                };
                let entities = order(seen, length / self.row().max(1), meaning)?;
                entities.into_iter().map(shown).collect::<Result<Vec<_>, _>>()?.concat()
            }
            Meaning::Visible | Meaning::VisibleOwnFirst => order(seen, length, meaning)?
                .into_iter()
                .map(|entity| f32::from(u8::from(seen.visible.contains(entity))))
                .collect(),
            Meaning::Blocked | Meaning::BlockedOwnFirst => order(seen, length, meaning)?
                .into_iter()
                .map(|entity| f32::from(u8::from(!seen.visible.contains(entity))))
                .collect(),
            Meaning::OwnIndex => vec![seen.self_index as f32],
            Meaning::None => Vec::new(),
        };
        if numbers.len() == length { Ok(numbers) } else { Err(DecideError::BadLength) }
    }

    /// An entity's features, and the one-hot of its last action where that is part of a row.
    fn row_of(&self, seen: &Observation<'_>, entity: usize) -> Result<Vec<f32>, DecideError> {
        let row = seen.rows.chunks(seen.stride.max(1)).nth(entity);
        let features = row.and_then(|row| row.get(..self.features));
        let last = seen.last_actions.get(entity).map(|action| usize::from(*action));
        let one_hot =
            (0..self.row() - self.features).map(|action| f32::from(u8::from(last == Some(action))));
        let features = features.ok_or(DecideError::BadLength)?.iter().copied();
        Ok(features.chain(one_hot).collect())
    }
}

/// The entities in the places of an input.
fn order(seen: &Observation<'_>, max: usize, meaning: Meaning) -> Result<Vec<usize>, DecideError> {
    let last = seen.visible.iter().chain([seen.self_index]).max().unwrap_or(0);
    if last >= max {
        return Err(DecideError::TooManyEntities { max, got: last + 1 });
    }
    let mut entities: Vec<usize> = (0..max).collect();
    let own_first = [Meaning::RowsOwnFirst, Meaning::VisibleOwnFirst, Meaning::BlockedOwnFirst];
    if own_first.contains(&meaning) {
        entities.remove(seen.self_index);
        entities.insert(0, seen.self_index);
    }
    Ok(entities)
}

fn check_finite(numbers: &[f32]) -> Result<(), DecideError> {
    let finite = numbers.iter().all(|number| number.is_finite());
    if finite { Ok(()) } else { Err(DecideError::NonFinite) }
}

impl Policy for TeamPolicy {
    fn actions(&self) -> usize {
        self.team.actions
    }

    fn utilities(
        &mut self,
        observation: &Observation<'_>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        self.utilities_with(observation, &mut [], utilities)
    }

    fn decide(&mut self, observation: &Observation<'_>) -> Result<Decision, DecideError> {
        self.decide_with(observation, &mut [])
    }

    fn hidden(&self) -> usize {
        self.states
    }

    fn utilities_with(
        &mut self,
        observation: &Observation<'_>,
        hidden: &mut [f32],
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        let scores = self.run(observation, hidden)?;
        if scores.len() != utilities.len() {
            return Err(DecideError::BadLength);
        }
        utilities.copy_from_slice(&scores);
        Ok(())
    }

    fn decide_with(
        &mut self,
        observation: &Observation<'_>,
        hidden: &mut [f32],
    ) -> Result<Decision, DecideError> {
        masked_argmax(&self.run(observation, hidden)?, observation.available)
    }
}
