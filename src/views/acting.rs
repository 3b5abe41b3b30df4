//! A deployed policy that acts for all agents of any environment, and what it thinks.

use sortie_core::{DecideError, NO_ACTION, Observation as Own, Policy};
use sortie_envs::{Observation, Shape};

use super::mind::{Diary, Mind, Thought};
use crate::failure::{Exit, Failure};
use crate::worlds::world::entity_mask;

/// Acts by a mind in an environment without subtasks.
pub(super) struct Actors<'a> {
    diary: Diary<'a>,
    rows: Vec<f32>,
    last_actions: Vec<u16>,
}

impl<'a> Actors<'a> {
    /// Actors at the beginning of an episode.
    pub(super) fn new(mind: &'a mut dyn Mind, shape: &Shape) -> Self {
        Self {
            diary: Diary::new(mind),
            rows: vec![0.0; shape.entities * shape.features],
            last_actions: vec![NO_ACTION; shape.agents],
        }
    }

    /// Writes the action of every agent that exists, and returns their thoughts.
    pub(super) fn act(
        &mut self,
        seen: &Observation,
        shape: &Shape,
        actions: &mut [u16],
    ) -> Result<Vec<Thought>, Failure> {
        for (entity, row) in self.rows.chunks_exact_mut(shape.features).enumerate() {
            match seen.entities >> entity & 1 == 1 {
                true => seen.rows.write_dense(seen.row_of(entity), row),
                false => row.fill(0.0),
            }
        }
        for (agent, action) in actions.iter_mut().enumerate().take(seen.agents()) {
            let codes = (0..shape.actions).map(|code| (seen.available[agent] >> code & 1) as u16);
            let observation = Own {
                rows: &self.rows,
                stride: shape.features,
                last_actions: &self.last_actions,
                visible: entity_mask(seen.observable[agent] & seen.present),
                self_index: agent,
                available: &codes.collect::<Vec<_>>(),
            };
            *action = self.diary.decide(&observation).map_err(refusal)?.action;
        }
        self.last_actions.copy_from_slice(actions);
        Ok(std::mem::take(&mut self.diary.thoughts))
    }
}

fn refusal(error: DecideError) -> Failure {
    Failure::new(Exit::BadData, format!("the policy refuses what an agent sees: {error}"))
}

#[cfg(test)]
mod tests {
    use sortie_core::Decision;
    use sortie_envs::random::generator;
    use sortie_envs::{EntitySet, Split};

    use super::*;
    use crate::environment::ScenarioSetName;

    /// Values each action by the agent's own features; attends to all that is visible.
    struct Fake;

    impl Policy for Fake {
        fn actions(&self) -> usize {
            3
        }

        fn utilities(&mut self, seen: &Own<'_>, utilities: &mut [f32]) -> Result<(), DecideError> {
            let own = &seen.rows[seen.self_index * seen.stride..][..seen.stride];
            let cell = own[..6].iter().position(|value| *value == 1.0).expect("its cell");
            utilities.fill(0.0);
            utilities[cell % 3] = 1.0 + f32::from(seen.last_actions[seen.self_index] == NO_ACTION);
            Ok(())
        }

        fn decide(&mut self, _: &Own<'_>) -> Result<Decision, DecideError> {
            Err(DecideError::BadLength)
        }
    }

    impl Mind for Fake {
        fn attention(&mut self, seen: &Own<'_>) -> Result<Vec<(usize, Vec<f32>)>, DecideError> {
            Ok(seen.visible.iter().map(|entity| (entity, vec![0.5])).collect())
        }
    }

    #[test]
    fn actors_see_their_rows_and_what_they_did() {
        let name = ScenarioSetName::parse("group-matching/4x6x2").expect("a ring");
        let mut world = name.open(Split::Test).expect("it opens");
        let mut random = generator(3);
        world.reset(0, &mut random);
        let shape = world.spec().shape;
        let (mut state, mut seen) = (Vec::new(), Observation::default());
        let mut mind = Fake;
        let mut actors = Actors::new(&mut mind, &shape);
        for first in [true, false] {
            state.clear();
            world.save(0, &mut state);
            world.observe(&state, 0, EntitySet::MAX, &mut seen);
            let mut actions = [7; 4];
            let thoughts = actors.act(&seen, &shape, &mut actions).expect("actions");
            assert_eq!(thoughts.len(), 4);
            for (agent, (thought, action)) in thoughts.iter().zip(actions).enumerate() {
                let mut row = vec![0.0; shape.features];
                seen.rows.write_dense(agent, &mut row);
                let cell = row[..6].iter().position(|value| *value == 1.0).expect("its cell");
                assert_eq!(usize::from(action), cell % 3);
                assert_eq!(thought.utilities[cell % 3], if first { 2.0 } else { 1.0 });
                assert_eq!(thought.attention.len(), 4);
            }
            world.step(0, &actions, &mut random).expect("a step");
        }
    }
}
