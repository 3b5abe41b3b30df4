//! A pointing head: utilities of actions that are aimed at entities.
//!
//! Each of these actions aims at one entity, and its utility is `q · x_e`: the agent's vector q with that entity's
//! embedding x_e. Who an entity is stays meaningful whatever its number, and one vector serves any number of targets. Where
//! the own row says how the agent stands to each of them, q goes on and is multiplied with that, too.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::int8_layer::{integers, quantised_floats};
use super::int8_rows::{rows as integer_rows, rows_floats};
use super::operator::Operator;
use super::team::Team;
use super::{LAYOUT_INT8, LAYOUT_TILES, Place, Scratch, Sizes, places};
use crate::kernels::Kernels;
use crate::kernels::int8::{Reach, Scale, row_max};
use crate::kernels::product::padded;
use crate::kernels::rows::{Rows, first_slots};
use crate::kernels::softmax::slots;
use crate::limits;
use crate::policy::{DecideError, Observation};

/// Which actions aim at which entities.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Targets {
    /// Actions that aim at nobody; they come first.
    pub untargeted: u16,
    /// The entity that the first of the others aims at; each of them aims at the next one.
    pub first_entity: u16,
    /// How many actions aim at an entity.
    pub count: u16,
    /// Width E of an embedding.
    pub width: u16,
    /// The column of the agent's own row where the features of pairs begin, target by target.
    pub first_pair: u16,
    /// Features F of a pair.
    pub pair_features: u16,
}

/// The pointing head of an agent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct PointAtEntities {
    /// The embeddings that [`super::EmbedEntities`] wrote.
    pub rows: Place,
    /// Which actions aim at which entities.
    pub targets: Targets,
    /// The utilities of actions that aim at nobody, what of q is for embeddings, and what is for pairs, padded each.
    pub from: Place,
    /// The dot products of q with all visible rows, `[n_max]`.
    pub scores: Place,
    /// The utilities `[U]`; zero where a target is not visible.
    pub to: Place,
}

/// As [`PointAtEntities`], of int8 weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Int8PointAtEntities {
    /// The embeddings that [`super::Int8EmbedEntities`] wrote.
    pub rows: Place,
    /// Which actions aim at which entities.
    pub targets: Targets,
    /// The utilities of actions that aim at nobody, what of q is for embeddings, and what is for pairs, padded each.
    pub from: Place,
    /// The dot products of q with all visible rows, `[n_max]`.
    pub scores: Place,
    /// q as integers.
    pub quantised: Place,
    /// The utilities `[U]`; zero where a target is not visible.
    pub to: Place,
}

impl Targets {
    fn check(&self, sizes: &Sizes) -> bool {
        let actions = u32::from(self.untargeted) + u32::from(self.count);
        let end = usize::from(self.first_entity) + usize::from(self.count);
        self.untargeted > 0
            && self.count > 0
            && self.width > 0
            && actions == sizes.actions
            && end <= limits::ENTITIES
            && self.pairs_end() <= sizes.features
    }

    /// One more than the last column that says how an agent stands to a target.
    fn pairs_end(&self) -> u32 {
        u32::from(self.first_pair) + u32::from(self.count) * u32::from(self.pair_features)
    }

    /// Floats of the utilities of actions that aim at nobody, and of the parts of q behind them.
    fn parts(&self) -> [usize; 3] {
        let pairs = match self.pair_features {
            0 => 0,
            features => padded(features.into()),
        };
        [padded(self.untargeted.into()), padded(self.width.into()), pairs]
    }

    /// Whether the places that hold floats are as long as they need to be.
    fn fit(&self, sizes: &Sizes, [from, scores, to]: [&Place; 3]) -> bool {
        from.len as usize == self.parts().iter().sum::<usize>()
            && scores.len == sizes.n_max
            && to.len == sizes.actions
    }

    fn multiply_adds(&self, visible: u64) -> u64 {
        let pairs = u64::from(self.count) * u64::from(self.pair_features);
        visible * padded(self.width.into()) as u64 + pairs
    }

    /// What of q is for embeddings, of what stands at `from`.
    fn query<'a>(&self, from: &'a [f32]) -> Result<&'a [f32], DecideError> {
        let [untargeted, width, _] = self.parts();
        from.get(untargeted..untargeted + width).ok_or(DecideError::BadLength)
    }

    /// What of q is for pairs, and what the own row says of them.
    fn pairs<'a>(
        &self,
        observation: &'a Observation<'_>,
        from: &'a [f32],
    ) -> Result<(&'a [f32], &'a [f32]), DecideError> {
        let [untargeted, width, _] = self.parts();
        let weights =
            from.get(untargeted + width..).and_then(|it| it.get(..self.pair_features.into()));
        let start = observation.self_index.saturating_mul(observation.stride);
        let row = observation.rows.get(start..);
        let row = row.and_then(|row| row.get(self.first_pair.into()..self.pairs_end() as usize));
        weights.zip(row).ok_or(DecideError::BadLength)
    }

    /// Writes all utilities, given the scores of what is visible, in rising order of the entities.
    fn answer(
        &self,
        observation: &Observation<'_>,
        from: &[f32],
        scores: &[f32],
        to: &mut [f32],
    ) -> Result<(), DecideError> {
        let (weights, pairs) = self.pairs(observation, from)?;
        let (untargeted, targeted) = to.split_at_mut(usize::from(self.untargeted).min(to.len()));
        for (to, from) in untargeted.iter_mut().zip(from) {
            *to = *from;
        }
        targeted.fill(0.0);
        for (entity, score) in observation.visible.iter().zip(scores) {
            let Some(target) = entity.checked_sub(self.first_entity.into()) else { continue };
            if let Some(utility) = targeted.get_mut(target) {
                let features = pairs.iter().skip(target * weights.len());
                let known = weights.iter().zip(features);
                *utility = known.fold(*score, |sum, (weight, feature)| sum + weight * feature);
            }
        }
        Ok(())
    }
}

/// Scores are worked on in whole vectors, for which a plan leaves room behind the last one.
fn whole(scores: Place) -> Place {
    Place { len: slots(scores.len as usize) as u32, ..scores }
}

impl Operator for PointAtEntities {
    const LAYOUT: Option<u32> = Some(LAYOUT_TILES);

    fn check(&self, sizes: &Sizes) -> bool {
        let width = padded(self.targets.width.into()) as u64;
        let rows = (u64::from(sizes.n_max) + 1).saturating_mul(width);
        self.targets.check(sizes)
            && self.targets.fit(sizes, [&self.from, &self.scores, &self.to])
            && u64::from(self.rows.len) == rows
            && sizes.hold_apart(&[&self.rows, &self.from, &whole(self.scores), &self.to])
    }

    fn multiply_adds(&self, visible: u64) -> u64 {
        self.targets.multiply_adds(visible)
    }

    #[inline(always)]
    fn run<K: Kernels>(
        &self,
        kernels: K,
        _: &[f32],
        observation: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let visible = scratch.visible;
        let wanted = [&self.rows, &self.from, &whole(self.scores), &self.to];
        let [rows, from, scores, to] = places(scratch.floats, wanted)?;
        let rows = Rows::first(rows, padded(self.targets.width.into()), visible);
        let scores = scores.get_mut(..slots(visible)).ok_or(DecideError::BadLength)?;
        kernels.dots(self.targets.query(from)?, rows, scores);
        self.targets.answer(observation, from, scores, to)
    }

    fn works_for_teams(&self, shared: u32) -> bool {
        self.rows == Place { offset: 0, len: shared }
    }

    /// As [`Self::run`] for all members of a team.
    fn run_team(
        &self,
        kernels: impl Kernels,
        _: &[f32],
        observations: &[Observation<'_>],
        team: &mut Team<'_>,
    ) -> Result<(), DecideError> {
        let wanted = [self.from, whole(self.scores), self.to].map(|place| team.own_place(&place));
        let Team { rows, own, own_floats, members, .. } = team;
        for (member, own) in members.iter().zip(own.chunks_exact_mut((*own_floats).max(1))) {
            let [from, scores, to] = places(own, wanted.each_ref())?;
            let width = padded(self.targets.width.into());
            let rows = Rows { slots: &member.slots, ..Rows::first(rows, width, 0) };
            let scores =
                scores.get_mut(..slots(member.slots.len())).ok_or(DecideError::BadLength)?;
            kernels.dots(self.targets.query(from)?, rows, scores);
            let observation = observations.get(member.index).ok_or(DecideError::BadLength)?;
            self.targets.answer(observation, from, scores, to)?;
        }
        Ok(())
    }
}

impl Operator for Int8PointAtEntities {
    const LAYOUT: Option<u32> = Some(LAYOUT_INT8);

    fn check(&self, sizes: &Sizes) -> bool {
        let width = self.targets.width;
        let scores = whole(self.scores);
        self.targets.check(sizes)
            && self.targets.fit(sizes, [&self.from, &self.scores, &self.to])
            && u64::from(self.rows.len) == rows_floats(sizes.n_max, width)
            && self.quantised.len as usize == quantised_floats(width.into())
            && sizes.hold_apart(&[&self.rows, &self.from, &scores, &self.quantised, &self.to])
    }

    fn multiply_adds(&self, visible: u64) -> u64 {
        self.targets.multiply_adds(visible)
    }

    #[inline(always)]
    fn run<K: Kernels>(
        &self,
        kernels: K,
        _: &[f32],
        observation: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let slots = first_slots(scratch.visible);
        let wanted = [&self.rows, &self.from, &whole(self.scores), &self.quantised, &self.to];
        let [rows, from, scores, quantised, to] = places(scratch.floats, wanted)?;
        self.point(kernels, observation, (rows, slots), [from, scores, quantised, to])
    }

    fn works_for_teams(&self, shared: u32) -> bool {
        self.rows == Place { offset: 0, len: shared }
    }

    /// As [`Self::run`] for all members of a team. Whose vector is no number decides alone.
    fn run_team(
        &self,
        kernels: impl Kernels,
        _: &[f32],
        observations: &[Observation<'_>],
        team: &mut Team<'_>,
    ) -> Result<(), DecideError> {
        let wanted = [self.from, whole(self.scores), self.quantised, self.to]
            .map(|place| team.own_place(&place));
        let Team { rows, own, own_floats, members, .. } = team;
        for (member, own) in members.iter_mut().zip(own.chunks_exact_mut((*own_floats).max(1))) {
            let own = places(own, wanted.each_ref())?;
            let observation = observations.get(member.index).ok_or(DecideError::BadLength)?;
            member.alone |= self.point(kernels, observation, (rows, &member.slots), own).is_err();
        }
        Ok(())
    }
}

impl Int8PointAtEntities {
    /// Points at the rows in some slots, which are those of what is visible.
    #[inline(always)]
    fn point(
        &self,
        kernels: impl Kernels,
        observation: &Observation<'_>,
        (rows, slots): (&[f32], &[u16]),
        [from, scores, quantised, to]: [&mut [f32]; 4],
    ) -> Result<(), DecideError> {
        let width = usize::from(self.targets.width);
        let rows = integer_rows(rows, width, slots)?;
        let query = self.targets.query(from)?.get(..width).ok_or(DecideError::BadLength)?;
        let vector = integers(quantised, width)?;
        let reach = Reach { least: 0.0, most: row_max(rows.width) };
        let Scale { step, .. } =
            kernels.quantise(query, reach, vector).ok_or(DecideError::NonFinite)?;
        kernels.int8_dots(vector, step, rows, scores);
        self.targets.answer(observation, from, scores, to)
    }
}
