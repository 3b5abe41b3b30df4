//! Attention of one query over several selections of rows.

use heapless::Vec;

use super::attend_own::AttendOwn;
use super::place;
use super::team::{Member, Pairs, TEAM, Team};
use crate::kernels::Kernels;
use crate::kernels::product::{Around, padded};
use crate::kernels::rows::Rows;
use crate::kernels::several::Pair;
use crate::kernels::softmax::{Scores, slots};
use crate::policy::DecideError;

/// What all members share: scores `[heads, rows]`, values `[heads, rows, h]`, each row padded.
struct Shared<'a> {
    scores: &'a mut [f32],
    values: &'a mut [f32],
}

impl AttendOwn {
    /// Rows that there can be.
    fn rows_max(&self) -> usize {
        (self.rows.len as usize).checked_div(self.padded_width()).unwrap_or(0)
    }

    fn shared_scores(&self) -> usize {
        usize::from(self.heads) * slots(self.rows_max())
    }

    /// Floats that members with one query share.
    pub(crate) fn shared_floats(&self) -> usize {
        let values = self.rows_max() * usize::from(self.heads) * padded(self.head_width());
        self.shared_scores() + values
    }

    /// As [`Self::run_team`] for members that are the same entity and so ask the same: scores and values of rows
    /// are computed once, and every member mixes the values of the rows that it sees.
    pub(super) fn run_shared(
        &self,
        kernels: impl Kernels,
        weights: &[f32],
        team: &mut Team<'_>,
    ) -> Result<(), DecideError> {
        let count = rows_seen(team.members);
        let (matrix, around) = (self.query.matrix(weights)?, self.query.around(weights, false)?);
        let width = usize::from(self.width);
        // One member asks for all.
        let speaker = team.members.first().map(|member| member.index);
        let asks = |member: &Member| Some(member.index) == speaker;
        kernels.products(matrix, &mut team.own_rows(width, &self.query_place, asks), around);
        for head in 0..usize::from(self.heads) {
            let query = self.query_place.part(self.head(head));
            let matrix = self.keys(weights, head)?;
            kernels.products(
                matrix,
                &mut team.pairs(&query, &self.absorbed, asks),
                Around::NOTHING,
            );
            self.score(kernels, team, head, count)?;
            self.value(kernels, weights, team, head, count)?;
            self.mix_values(kernels, team, head)?;
        }
        self.answer_team(kernels, weights, team)
    }

    /// One head's part of what is shared.
    fn shared<'a>(&self, shared: &'a mut [f32], head: usize) -> Result<Shared<'a>, DecideError> {
        let (scores, values) =
            shared.split_at_mut_checked(self.shared_scores()).ok_or(DecideError::BadLength)?;
        let scores = scores.chunks_exact_mut(slots(self.rows_max()).max(1)).nth(head);
        let step = padded(self.head_width());
        let values = values.chunks_exact_mut((self.rows_max() * step).max(1)).nth(head);
        let (scores, values) = scores.zip(values).ok_or(DecideError::BadLength)?;
        Ok(Shared { scores, values })
    }

    /// Scores of the first `count` rows.
    fn score(
        &self,
        kernels: impl Kernels,
        team: &mut Team<'_>,
        head: usize,
        count: usize,
    ) -> Result<(), DecideError> {
        let absorbed = team.own_place(&self.absorbed);
        let Shared { scores, .. } = self.shared(team.shared, head)?;
        let rows = Rows::first(team.rows, self.padded_width(), count);
        kernels.dots(place(team.own, &absorbed)?, rows, scores);
        Ok(())
    }

    /// Values of the first `count` rows.
    fn value(
        &self,
        kernels: impl Kernels,
        weights: &[f32],
        team: &mut Team<'_>,
        head: usize,
        count: usize,
    ) -> Result<(), DecideError> {
        let matrix = self.values(weights, head)?;
        let Shared { values, .. } = self.shared(team.shared, head)?;
        let rows = team.rows.chunks_exact(self.padded_width().max(1)).take(count);
        let values = values.chunks_exact_mut(padded(self.head_width()).max(1));
        let mut pairs = rows.zip(values);
        loop {
            let mut some = Pairs::new();
            for (row, outputs) in pairs.by_ref().take(TEAM) {
                let inputs = row.get(..usize::from(self.width)).ok_or(DecideError::BadLength)?;
                // There is room for as many.
                let _ = some.push(Pair { inputs, outputs });
            }
            if some.is_empty() {
                return Ok(());
            }
            kernels.products(matrix, &mut some, Around::NOTHING);
        }
    }

    /// Every member's mixture of the values that it sees; who sees nothing gets zeros.
    fn mix_values(
        &self,
        kernels: impl Kernels,
        team: &mut Team<'_>,
        head: usize,
    ) -> Result<(), DecideError> {
        let step = padded(self.head_width());
        let output = self.attended.part(head * step..(head + 1) * step);
        let [scores, output] = [&self.places()[3], &output].map(|place| team.own_place(place));
        let Team { own, own_floats, members, shared, .. } = team;
        let Shared { scores: all_scores, values } = self.shared(shared, head)?;
        let mut asked: Vec<Scores<'_>, TEAM> = Vec::new();
        let mut outputs: Vec<&mut [f32], TEAM> = Vec::new();
        for (member, floats) in members.iter().zip(own.chunks_exact_mut((*own_floats).max(1))) {
            let [scores, output] = super::places(floats, [&scores, &output])?;
            let count = member.slots.len();
            let scores = scores.get_mut(..slots(count)).ok_or(DecideError::BadLength)?;
            for (score, slot) in scores.iter_mut().zip(&member.slots) {
                *score = *all_scores.get(usize::from(*slot)).ok_or(DecideError::BadLength)?;
            }
            // There is room for every member.
            let _ = asked.push(Scores { scores, count, finite: true });
            let _ = outputs.push(output);
        }
        kernels.softmaxes(&mut asked);
        // By reference, as a vector that is taken apart ends with a slice that could fail.
        for ((member, weights), output) in members.iter_mut().zip(&asked).zip(&mut outputs) {
            member.alone |= !weights.finite;
            let rows = Rows { slots: &member.slots, ..Rows::first(values, step, 0) };
            kernels.mix(weights.scores, rows, output);
        }
        Ok(())
    }
}

/// Rows up to the last that any member sees.
fn rows_seen(members: &[Member]) -> usize {
    let last = |member: &Member| member.slots.last().map_or(0, |slot| usize::from(*slot) + 1);
    members.iter().map(last).max().unwrap_or(0)
}
