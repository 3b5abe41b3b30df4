//! An allocator that gives the best that it knows, by one look or by the best of several symmetries.

use std::collections::BTreeMap;

use sortie_envs::{Environment, Spec, Split};
use sortie_learn::LearnError;
use sortie_learn::networks::best;
use sortie_learn::subtasks::{Allocate, AllocateTurned, ToAllocate, best_course};

use super::deciding::{Asked, Group, Seen};
use super::network::Network;

/// An allocator that gives the best that it knows.
pub(super) struct Greedy<'a> {
    looks: Looks<'a>,
    /// What was found best to do in states that are still to come.
    planned: BTreeMap<Vec<u8>, Vec<u8>>,
}

/// The network at work under each of the symmetries by which an episode is played to its end; under the first alone if there is
/// no more.
struct Looks<'a> {
    network: (&'a Network, &'a [f32]),
    groups: Vec<Group>,
}

impl<'a> Greedy<'a> {
    pub(super) fn new(network: (&'a Network, &'a [f32])) -> Self {
        let looks = Looks { network, groups: vec![Group::default()] };
        Self { looks, planned: BTreeMap::new() }
    }
}

impl AllocateTurned for Looks<'_> {
    fn allocate_turned(
        &mut self,
        environment: &dyn Environment,
        state: &[u8],
        in_force: &[u8],
        turn: usize,
    ) -> Result<Vec<u8>, LearnError> {
        let group = &mut self.groups[turn];
        group.made.clear();
        let asked = Asked { episode: 0, state, before: in_force };
        let seen = Seen { environment, turn, states: &[asked] };
        let given = group.allocate(self.network, seen, best);
        Ok(given.into_iter().flatten().collect())
    }
}

impl Allocate for Greedy<'_> {
    fn allocate(&mut self, to: ToAllocate<'_>) -> Result<(), LearnError> {
        let ToAllocate { environment, state, allocation, .. } = to;
        let turns = self.looks.groups.len();
        let given = if turns == 1 {
            self.looks.allocate_turned(environment, state, allocation, 0)?
        } else if let Some(planned) = self.planned.remove(state) {
            planned
        } else {
            let mut world = environment.open(1, Split::Test);
            let course = best_course(&mut self.looks, &mut *world, (state, allocation), turns)?;
            self.planned.extend(course);
            self.planned.remove(state).unwrap_or_default()
        };
        allocation.copy_from_slice(&given);
        Ok(())
    }

    fn choose_among(&mut self, proposals: Option<usize>, spec: &Spec) -> bool {
        let turns = proposals.unwrap_or(1).min(spec.turns);
        self.looks.groups.resize_with(turns, Group::default);
        true
    }
}
