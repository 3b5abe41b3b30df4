//! Several agents that look at one frame: weights are read and rows embedded once for all of them.

use heapless::Vec;

use super::{Place, places};
use crate::kernels::mark::Marks;
use crate::kernels::several::Pair;
use crate::limits;
use crate::policy::Observation;

/// Most agents that are worked on together; more are cut into several teams.
pub(crate) const TEAM: usize = 32;

/// One agent of a team.
#[derive(Debug, Default)]
pub(crate) struct Member {
    /// Which of the observations asked about is this agent's.
    pub(crate) index: usize,
    /// The rows of the entities that it sees, in rising order.
    pub(crate) slots: Vec<u16, { limits::ENTITIES }>,
    /// Its own row.
    pub(crate) own: u8,
    /// Whether something is wrong with what it sees, so that it is to decide alone and get its own error.
    pub(crate) alone: bool,
}

impl Member {
    /// Notes in which slot an entity's row was embedded, if this agent sees the entity or is it.
    pub(crate) fn note(&mut self, observation: &Observation<'_>, entity: usize, slot: Option<u8>) {
        let is_seen = observation.visible.contains(entity);
        let is_own = observation.self_index == entity;
        let Some(slot) = slot else {
            self.alone |= is_seen || is_own;
            return;
        };
        if is_own {
            self.own = slot;
        }
        if is_seen {
            // There is room for every entity.
            let _ = self.slots.push(slot.into());
        }
    }
}

/// The arena of a team: shared rows, then for every member the places behind them.
pub(crate) struct Team<'a> {
    /// Embedded rows `[n_max + 1, width]` of everything that any member sees, and of the members.
    pub(crate) rows: &'a mut [f32],
    /// The members' own places, one member behind the other.
    pub(crate) own: &'a mut [f32],
    /// Floats of one member's own places, at least one.
    pub(crate) own_floats: usize,
    /// Room for what members share that are the same entity, see [`super::AttendOwn::shared_floats`]; none where
    /// every member is to get the bits that it would get alone.
    pub(crate) shared: &'a mut [f32],
    /// Marks the inputs of a sparse product.
    pub(crate) nonzeros: &'a mut [Marks],
    /// The members, borrowed: they are large, and to move them would copy room for a whole team.
    pub(crate) members: &'a mut [Member],
}

/// Inputs and outputs of the members that a product is for.
pub(crate) type Pairs<'a> = Vec<Pair<'a>, TEAM>;

impl<'a> Team<'a> {
    /// Whether all members are the same entity, which looks at several selections of rows.
    pub(crate) fn is_one_entity(&self) -> bool {
        let mut members = self.members.iter();
        let first = members.next().map(|member| member.own);
        members.all(|member| Some(member.own) == first)
    }

    /// A place among a member's own.
    pub(crate) fn own_place(&self, place: &Place) -> Place {
        // That places lie behind the rows was checked at load.
        Place { offset: place.offset.saturating_sub(self.rows.len() as u32), ..*place }
    }

    /// Every member and its own places.
    pub(crate) fn own_places(&mut self) -> impl Iterator<Item = (&mut Member, &mut [f32])> {
        self.members.iter_mut().zip(self.own.chunks_exact_mut(self.own_floats.max(1)))
    }

    /// The members' floats `from` and `to`, for those members that are `wanted`.
    pub(crate) fn pairs(
        &mut self,
        from: &Place,
        to: &Place,
        wanted: impl Fn(&Member) -> bool,
    ) -> Pairs<'_> {
        let (from, to) = (self.own_place(from), self.own_place(to));
        let mut pairs = Vec::new();
        let own = self.own.chunks_exact_mut(self.own_floats.max(1));
        for (_, floats) in self.members.iter().zip(own).filter(|(member, _)| wanted(member)) {
            if let Ok([inputs, outputs]) = places(floats, [&from, &to]) {
                // There is room for every member.
                let _ = pairs.push(Pair { inputs, outputs });
            }
        }
        pairs
    }

    /// Copies the first `width` floats of every member's own row to its floats `to`.
    pub(super) fn keep_own_rows(&mut self, width: usize, to: &Place) {
        for pair in &mut self.own_rows(width, to, |_| true) {
            for (to, from) in pair.outputs.iter_mut().zip(pair.inputs) {
                *to = *from;
            }
        }
    }

    /// The first `width` floats of the members' own rows, and their floats `to`.
    pub(crate) fn own_rows(
        &mut self,
        width: usize,
        to: &Place,
        wanted: impl Fn(&Member) -> bool,
    ) -> Pairs<'_> {
        let to = self.own_place(to);
        let stride = crate::kernels::product::padded(width);
        let mut pairs = Vec::new();
        let own = self.own.chunks_exact_mut(self.own_floats.max(1));
        for (member, floats) in self.members.iter().zip(own).filter(|(member, _)| wanted(member)) {
            let start = usize::from(member.own) * stride;
            let row = self.rows.get(start..start + width);
            if let (Some(inputs), Ok([outputs])) = (row, places(floats, [&to])) {
                let _ = pairs.push(Pair { inputs, outputs });
            }
        }
        pairs
    }
}
