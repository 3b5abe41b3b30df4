//! A policy over inputs of fixed sizes as an agent of a team, whichever engine runs it.

use serde::{Deserialize, Serialize};
use sortie_bundle::{AgentGraph, Bundle, ContractV1};
use sortie_core::choose::masked_argmax;
use sortie_core::internal::ops::Meaning;
use sortie_core::{DecideError, Decision, Observation, Policy};

use crate::comparison::cannot_run;
use crate::error::CompileError;
use crate::policy::{FlatPolicy, InputRole, OutputRole, PolicyFacts, PolicyInput};

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
    /// What a policy's inputs are for what an agent sees.
    ///
    /// # Errors
    /// See [`Self::meanings`]; the observation is of other sizes.
    pub fn shown(
        &self,
        facts: &PolicyFacts,
        seen: &Observation<'_>,
    ) -> Result<Vec<Vec<f32>>, CompileError> {
        let lengths = facts.given().map(PolicyInput::length);
        let inputs = self.meanings(facts)?.into_iter().zip(lengths);
        let shown = |(meaning, length)| self.observed(meaning, seen, length).map_err(cannot_run);
        inputs.map(shown).collect()
    }

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

/// Sizes of what an agent of a team observes and does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TeamSizes {
    /// Most entities of a team.
    pub entities: usize,
    /// Features d of an entity.
    pub features: usize,
    /// Actions U.
    pub actions: usize,
    /// Whether the one-hot of an entity's last action follows its features.
    pub last_action: bool,
}

impl TeamSizes {
    /// The sizes of a contract, and of teams of so many entities.
    pub fn of_contract(contract: &ContractV1, entities: u16) -> Self {
        Self {
            entities: entities.into(),
            features: contract.features.into(),
            actions: contract.actions.into(),
            last_action: contract.append_last_action,
        }
    }

    /// What agents of a bundle observe and do that decide by one of its graphs.
    pub fn of(bundle: &Bundle, graph: &AgentGraph) -> Self {
        let (features, actions) = (graph.features.into(), graph.actions.into());
        let all = Self::of_contract(bundle.contract(), bundle.manifest().limits.n_max);
        Self { features, actions, ..all }
    }

    /// What a network over entities takes by itself: its rows are features, without last actions.
    pub fn of_entities(facts: &PolicyFacts) -> Option<Self> {
        let input = facts.entities()?;
        let (entities, features) = (input.shape.iter().rev().nth(1)?, input.shape.last()?);
        let actions = facts.wanted().find_map(|output| match output.role {
            OutputRole::Discrete(actions) => Some(actions),
            _ => None,
        });
        let (entities, features) = (*entities, *features);
        Some(Self { entities, features, actions: actions?, last_action: false })
    }

    /// Numbers of a row.
    pub fn row(&self) -> usize {
        self.features + if self.last_action { self.actions } else { 0 }
    }

    /// What the inputs that a caller would give are in such a team, in their order.
    ///
    /// # Errors
    /// The policy does not choose one of the actions, or an input is nothing that an agent observes.
    pub fn meanings(&self, facts: &PolicyFacts) -> Result<Vec<Meaning>, CompileError> {
        self.check_choice(facts)?;
        let mut rows = facts.given().filter(|input| input.role == InputRole::Observation);
        if let (Some(one), Some(other)) = (rows.next(), rows.next()) {
            let names = format!("`{}` and `{}`", one.name, other.name);
            return Err(no_agent(format!("an agent observes one row, {names} are two")));
        }
        facts.given().map(|input| self.meaning(input)).collect()
    }

    fn meaning(&self, input: &PolicyInput) -> Result<Meaning, CompileError> {
        let (name, length) = (&input.name, input.length());
        match input.role {
            InputRole::Observation if length == self.row() => Ok(Meaning::OwnRow),
            InputRole::Observation => Err(no_agent(format!(
                "`{name}` has {length} numbers, an agent's own row has {} ({})",
                self.row(),
                self.columns()
            ))),
            InputRole::Available if length == self.actions => Ok(Meaning::Available),
            InputRole::Entities { own_first } => {
                self.check_rows(input)?;
                Ok(if own_first { Meaning::RowsOwnFirst } else { Meaning::Rows })
            }
            InputRole::Mask { blocks, own_first } => Ok(match (blocks, own_first) {
                (false, false) => Meaning::Visible,
                (false, true) => Meaning::VisibleOwnFirst,
                (true, false) => Meaning::Blocked,
                (true, true) => Meaning::BlockedOwnFirst,
            }),
            InputRole::OwnIndex => Ok(Meaning::OwnIndex),
            InputRole::Available | InputRole::Extra | InputRole::State => Err(no_agent(format!(
                "`{name}` {:?} is neither an agent's own row nor its available actions",
                input.shape
            ))),
        }
    }

    /// Whether the rows are an agent's, and enough of them.
    fn check_rows(&self, input: &PolicyInput) -> Result<(), CompileError> {
        let mut sizes = input.shape.iter().rev();
        let (row, count) = (sizes.next().unwrap_or(&0), sizes.next().unwrap_or(&0));
        let name = &input.name;
        if *row != self.row() {
            let (want, columns) = (self.row(), self.columns());
            return Err(no_agent(format!(
                "`{name}` has rows of {row} numbers, an entity has {want} ({columns})"
            )));
        }
        if *count < self.entities {
            let most = self.entities;
            return Err(no_agent(format!("`{name}` has {count} rows, teams have {most} entities")));
        }
        Ok(())
    }

    /// What stands in a row, for people.
    fn columns(&self) -> String {
        let features = format!("{} features", self.features);
        if self.last_action {
            format!("{features} and the one-hot of its last action among {}", self.actions)
        } else {
            format!("{features}, its last action is none of them")
        }
    }

    fn check_choice(&self, facts: &PolicyFacts) -> Result<(), CompileError> {
        let want = self.actions;
        let outputs: Vec<_> = facts.wanted().collect();
        let [output] = outputs.as_slice() else {
            let names: Vec<_> = outputs.iter().map(|output| output.name.as_str()).collect();
            let names = names.join("`, `");
            let reason = format!("it has several outputs, `{names}`: `--output NAME` says which");
            return Err(no_agent(reason));
        };
        let name = &output.name;
        match output.role {
            OutputRole::Discrete(got) if got != want => {
                Err(no_agent(format!("`{name}` chooses among {got} actions, an agent has {want}")))
            }
            // A choice among several is as many choices as there are rows.
            OutputRole::Discrete(_) if ![1, want].contains(&output.length()) => {
                let shape = &output.shape;
                Err(no_agent(format!("`{name}` {shape:?} is more than one choice")))
            }
            OutputRole::Discrete(_) => Ok(()),
            OutputRole::Continuous(_) | OutputRole::State => Err(no_agent(format!(
                "`{name}` {:?} is no choice of one of {want} actions; where its numbers are the actions' scores, \
                 write `--output {name}:discrete`",
                output.shape
            ))),
        }
    }
}

fn no_agent(reason: String) -> CompileError {
    CompileError::NoAgent { reason }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::policy::{PolicyOutput, ValueType};

    fn facts(
        inputs: &[(&str, usize, InputRole)],
        output: OutputRole,
        length: usize,
    ) -> PolicyFacts {
        let input = |(name, length, role): &(&str, usize, InputRole)| PolicyInput {
            normals: Vec::new(),
            name: (*name).to_owned(),
            kind: ValueType::F32,
            shape: vec![1, *length],
            role: *role,
        };
        let (name, kind, shape) = ("q".to_owned(), ValueType::F32, vec![1, length]);
        PolicyFacts {
            inputs: inputs.iter().map(input).collect(),
            outputs: vec![PolicyOutput { name, kind, shape, role: output }],
            states: Vec::new(),
            operators: Default::default(),
            parameters: 0,
            multiply_adds: None,
        }
    }

    const TEAM: TeamSizes = TeamSizes { entities: 4, features: 5, actions: 3, last_action: true };

    fn refused(facts: &PolicyFacts) -> String {
        TEAM.meanings(facts).unwrap_err().to_string()
    }

    #[test]
    fn an_agent_observes_its_row_and_its_available_actions() {
        let inputs = [
            ("mask", 3, InputRole::Available),
            ("h", 9, InputRole::State),
            ("obs", 8, InputRole::Observation),
        ];
        let facts = facts(&inputs, OutputRole::Discrete(3), 3);
        assert_eq!(TEAM.meanings(&facts).unwrap(), [Meaning::Available, Meaning::OwnRow]);
        let without = TeamSizes { last_action: false, ..TEAM };
        let reason = without.meanings(&facts).unwrap_err().to_string();
        assert!(reason.ends_with(
            "`obs` has 8 numbers, an agent's own row has 5 (5 features, its last action is none of them)"
        ));
    }

    #[test]
    fn an_agent_observes_entities() {
        let rows = |count, width, own_first| {
            let role = InputRole::Entities { own_first };
            let mut facts = facts(&[("seen", 0, role)], OutputRole::Discrete(3), 3);
            facts.inputs[0].shape = vec![1, count, width];
            facts
        };
        assert_eq!(TEAM.meanings(&rows(4, 8, true)).unwrap(), [Meaning::RowsOwnFirst]);
        assert_eq!(TEAM.meanings(&rows(6, 8, false)).unwrap(), [Meaning::Rows]);
        let narrow = refused(&rows(4, 5, true));
        assert!(narrow.contains("`seen` has rows of 5 numbers, an entity has 8 (5 features"));
        assert!(refused(&rows(3, 8, true)).ends_with("`seen` has 3 rows, teams have 4 entities"));
        let alone = TeamSizes::of_entities(&rows(6, 8, true));
        let want = TeamSizes { entities: 6, features: 8, actions: 3, last_action: false };
        assert_eq!(alone, Some(want));
        let role = InputRole::Mask { blocks: true, own_first: false };
        let mask = facts(&[("pad", 4, role)], OutputRole::Discrete(3), 3);
        assert_eq!(TEAM.meanings(&mask).unwrap(), [Meaning::Blocked]);
    }

    #[test]
    fn what_does_not_fit_is_named() {
        let row = [("obs", 8, InputRole::Observation)];
        let short = [("obs", 5, InputRole::Observation)];
        let other = [row[0], ("time", 1, InputRole::Extra)];
        let two = [row[0], ("more", 8, InputRole::Observation)];
        let (choice, scores) = (OutputRole::Discrete(3), OutputRole::Continuous(3));
        for (facts, words) in [
            (facts(&short, choice, 3), "`obs` has 5 numbers, an agent's own row has 8"),
            (facts(&other, choice, 3), "`time` [1, 1] is neither"),
            (facts(&two, choice, 3), "`obs` and `more` are two"),
            (facts(&row, OutputRole::Discrete(4), 4), "chooses among 4 actions, an agent has 3"),
            (facts(&row, choice, 6), "more than one choice"),
            (facts(&row, scores, 3), "`--output q:discrete`"),
        ] {
            assert!(refused(&facts).contains(words), "{}", refused(&facts));
        }
    }
}
