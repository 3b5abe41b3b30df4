//! An allocator that gives the best that it knows, by one look or by the best of several symmetries.

use std::collections::BTreeMap;

use sortie_envs::{Environment, Spec, Split};
use sortie_learn::LearnError;
use sortie_learn::networks::best;
use sortie_learn::subtasks::{Allocate, ToAllocate};

use super::deciding::{Asked, Group, Seen};
use super::network::Network;

/// Allocations by states.
type Planned = BTreeMap<Vec<u8>, Vec<u8>>;

/// An allocator that gives the best that it knows.
pub(super) struct Greedy<'a> {
    network: (&'a Network, &'a [f32]),
    /// By symmetries of the rules, of which an episode is played to its end under each; the first alone if there is no more.
    groups: Vec<Group>,
    /// What was found best to do in states that are still to come.
    planned: Planned,
}

impl<'a> Greedy<'a> {
    pub(super) fn new(network: (&'a Network, &'a [f32])) -> Self {
        Self { network, groups: vec![Group::default()], planned: Planned::new() }
    }

    fn allocated(
        &mut self,
        environment: &dyn Environment,
        (state, before): (&[u8], &[u8]),
        turn: usize,
    ) -> Vec<u8> {
        let group = &mut self.groups[turn];
        group.made.clear();
        let asked = Asked { episode: 0, state, before };
        let seen = Seen { environment, turn, states: &[asked] };
        let given =
            group.allocate(self.network, seen, |scores, offered| best(scores, offered.into()));
        given.into_iter().flatten().collect()
    }

    /// Plays to the end by what a symmetry makes of it; what that returns, and what was given in each state.
    fn played(
        &mut self,
        world: &mut dyn Environment,
        (state, before): (&[u8], &[u8]),
        turn: usize,
    ) -> Result<(f64, Planned), LearnError> {
        let mut random = sortie_envs::random::generator(0);
        let mut actions = vec![0; world.spec().shape.agents];
        let (mut given, mut earned) = (Planned::new(), 0.0);
        let (mut state, mut allocation) = (state.to_vec(), before.to_vec());
        world.load(0, &state).map_err(LearnError::environment)?;
        loop {
            allocation = self.allocated(world, (&state, &allocation), turn);
            world.scripted(&state, &allocation, &mut random, &mut actions);
            given.insert(std::mem::take(&mut state), allocation.clone());
            let step = world.step(0, &actions, &mut random)?;
            earned += step.reward;
            if step.done() {
                return Ok((earned, given));
            }
            world.save(0, &mut state);
        }
    }
}

impl Allocate for Greedy<'_> {
    fn allocate(&mut self, to: ToAllocate<'_>) -> Result<(), LearnError> {
        let ToAllocate { environment, state, allocation, .. } = to;
        let given = if self.groups.len() == 1 {
            self.allocated(environment, (state, allocation), 0)
        } else if let Some(planned) = self.planned.remove(state) {
            planned
        } else {
            let mut world = environment.open(1, Split::Test);
            let now = (state, &*allocation);
            let plays = (0..self.groups.len()).map(|turn| self.played(&mut *world, now, turn));
            let plays = plays.collect::<Result<Vec<_>, _>>()?;
            let best = plays.into_iter().max_by(|one, other| one.0.total_cmp(&other.0));
            self.planned.extend(best.map(|(_, given)| given).unwrap_or_default());
            self.planned.remove(state).unwrap_or_default()
        };
        allocation.copy_from_slice(&given);
        Ok(())
    }

    fn choose_among(&mut self, proposals: Option<usize>, spec: &Spec) -> bool {
        let turns = proposals.unwrap_or(1).min(spec.turns);
        self.groups.resize_with(turns, Group::default);
        true
    }
}
