//! Decisions of several agents in one call.
//!
//! Observations of one frame are worked on together, as many as the arena has room for: rows that several agents
//! see are embedded once, and every matrix is read once for all of them. Each answer has the bits that the agent
//! would get alone. An observation with which something is wrong is answered alone, and so gets its own error.

use heapless::Vec;
use zerocopy::FromBytes;

use super::Plan;
use crate::choose::masked_argmax;
use crate::entity_mask::EntityMask;
use crate::kernels::mark::Marks;
use crate::limits;
use crate::ops::team::{Member, TEAM, Team};
use crate::ops::{Gru, OpRef, OperatorSet};
use crate::policy::{DecideError, Decision, Observation};

/// An agent's utilities in the arena, or why there are none.
type Computed<'s> = Result<&'s [f32], DecideError>;

impl<S: OperatorSet> Plan<'_, S> {
    /// Bytes of arena that every agent beyond the first needs to be worked on together with others; 0 where the
    /// plan decides for one agent after the other.
    pub fn arena_bytes_per_agent(&self) -> usize {
        self.program.own_floats().map_or(0, |floats| 4 * floats as usize)
    }

    /// Bytes of arena with which `agents` agents are worked on together. [`Plan::decide_batch`] takes any
    /// arena that is enough for one.
    pub fn batch_arena_bytes(&self, agents: usize) -> usize {
        let further = agents.min(TEAM).saturating_sub(1);
        self.arena_bytes().saturating_add(further.saturating_mul(self.arena_bytes_per_agent()))
    }

    /// Decides for every observation as [`Plan::decide`] does. Answers beyond the shorter of the two slices are
    /// not given. `hidden` `[B, R]` holds the states of those that observe, in the same order, where the policy has memory;
    /// a state of another size answers everyone with [`DecideError::HiddenState`].
    pub fn decide_batch(
        &self,
        arena: &mut [u8],
        observations: &[Observation<'_>],
        hidden: Option<&mut [f32]>,
        decisions: &mut [Result<Decision, DecideError>],
    ) {
        let hidden = hidden.unwrap_or_default();
        let asked = Asked { observations, arena, shared: &mut [], hidden };
        self.run_batch(asked, &mut |index, utilities| {
            let place = decisions.get_mut(index).zip(observations.get(index));
            if let Some((decision, observation)) = place {
                *decision =
                    utilities.and_then(|utilities| masked_argmax(utilities, observation.available));
            }
        });
    }

    /// Writes the utilities `[B, U]` of every observation as [`Plan::utilities`] does, and whether it could.
    pub fn utilities_batch(
        &self,
        arena: &mut [u8],
        observations: &[Observation<'_>],
        utilities: &mut [f32],
        results: &mut [Result<(), DecideError>],
    ) {
        self.utilities_shared(arena, &mut [], observations, utilities, results);
    }

    /// As [`Self::utilities_batch`] for one entity that looks at several selections of a frame's rows. With
    /// [`Self::shared_floats`] of memory, scores and values of rows are computed once for all of them: utilities
    /// are the same but for rounding, and do not depend on what else is asked in the same call.
    pub fn utilities_shared(
        &self,
        arena: &mut [u8],
        shared: &mut [f32],
        observations: &[Observation<'_>],
        utilities: &mut [f32],
        results: &mut [Result<(), DecideError>],
    ) {
        let actions = self.actions();
        let asked = Asked { observations, arena, shared, hidden: &mut [] };
        self.run_batch(asked, &mut |index, computed| {
            let start = index.saturating_mul(actions);
            let to = utilities.get_mut(start..start.saturating_add(actions));
            if let Some(result) = results.get_mut(index) {
                *result = match (computed, to) {
                    (Ok(computed), Some(to)) if computed.len() == to.len() => {
                        to.copy_from_slice(computed);
                        Ok(())
                    }
                    (Err(error), _) => Err(error),
                    _ => Err(DecideError::BadLength),
                };
            }
        });
    }

    /// Floats of memory in which several selections share what they have in common.
    pub fn shared_floats(&self) -> usize {
        let floats = |op: OpRef<'_>| match op {
            OpRef::AttendOwn(op) => op.shared_floats(),
            _ => 0,
        };
        self.program.ops().map(floats).max().unwrap_or(0)
    }

    fn run_batch(&self, mut asked: Asked<'_>, answer: &mut dyn FnMut(usize, Computed<'_>)) {
        let (want, got) = (asked.observations.len() * self.hidden(), asked.hidden.len());
        if got != want {
            let refused = DecideError::HiddenState { want, got };
            return (0..asked.observations.len()).for_each(|index| answer(index, Err(refused)));
        }
        let (mut members, mut alone) = (Vec::new(), Vec::<usize, TEAM>::new());
        let mut next = 0;
        while next < asked.observations.len() {
            self.gather(&mut members, asked.arena.len(), asked.observations, next);
            let count = members.len().max(1);
            alone.clear();
            // Who shares nothing and has no company is faster alone.
            if (count == 1 && asked.shared.is_empty())
                || self.run_team(&mut asked, &mut members, &mut alone, answer).is_err()
            {
                alone.clear();
                // There is room for every member.
                for index in next..next + count {
                    let _ = alone.push(index);
                }
            }
            for &index in &alone {
                let hidden = state_of(asked.hidden, self.hidden(), index);
                if let Some(observation) = asked.observations.get(index) {
                    answer(index, self.run(asked.arena, observation, hidden));
                }
            }
            next += count;
        }
    }

    /// Gathers the agents from `next` on that can be worked on together.
    fn gather(
        &self,
        members: &mut Vec<Member, TEAM>,
        arena_bytes: usize,
        observations: &[Observation<'_>],
        next: usize,
    ) {
        members.clear();
        let spare = arena_bytes.saturating_sub(self.arena_bytes());
        let further = spare.checked_div(self.arena_bytes_per_agent()).unwrap_or(0);
        let n_max = self.header.n_max as usize;
        let mut rows = EntityMask::EMPTY;
        let mut frame: Option<&Observation<'_>> = None;
        for (index, observation) in observations.iter().enumerate().skip(next).take(further + 1) {
            rows = rows.or(&observation.visible);
            rows.insert(observation.self_index);
            let fits = observation.stride >= self.header.features as usize
                && rows.len() <= n_max + 1
                && observation.visible.len() <= n_max
                && observation.self_index < limits::ENTITIES
                && is_same_frame(frame.get_or_insert(observation), observation);
            if !fits || members.push(Member { index, ..Member::default() }).is_err() {
                break;
            }
        }
    }

    /// Works for a team; who is to be asked alone afterwards is added to `alone`.
    fn run_team(
        &self,
        asked: &mut Asked<'_>,
        members: &mut [Member],
        alone: &mut Vec<usize, TEAM>,
        answer: &mut dyn FnMut(usize, Computed<'_>),
    ) -> Result<(), DecideError> {
        let own_floats = self.program.own_floats().ok_or(DecideError::BadLength)? as usize;
        let row_floats = (self.program.floats() as usize).saturating_sub(own_floats);
        let rest = asked.arena.split_at_mut_checked(4 * row_floats);
        let (rows, rest) = rest.ok_or(DecideError::BadLength)?;
        let rest = rest.split_at_mut_checked(4 * own_floats * members.len());
        let (own, rest) = rest.ok_or(DecideError::BadLength)?;
        let marks = rest.get_mut(..8 * self.program.nonzeros() as usize);
        let mut team = Team {
            rows: <[f32]>::mut_from_bytes(rows).map_err(|_| DecideError::BadLength)?,
            own: <[f32]>::mut_from_bytes(own).map_err(|_| DecideError::BadLength)?,
            own_floats: own_floats.max(1),
            shared: asked.shared,
            nonzeros: marks
                .and_then(|marks| <[Marks]>::mut_from_bytes(marks).ok())
                .ok_or(DecideError::BadLength)?,
            members,
        };
        if let Some(gru) = self.program.memory() {
            recall(gru, &mut team, asked.hidden)?;
        }
        let observations = asked.observations;
        self.run_members(observations, &mut team)?;
        let place = self.program.utilities().ok_or(DecideError::BadLength)?;
        let utilities = team.own_place(&place);
        let memory = self.program.memory().map(|gru| (gru, team.own_place(&gru.to)));
        for (member, floats) in team.own_places() {
            if member.alone {
                let _ = alone.push(member.index);
                continue;
            }
            let utilities = floats.get(utilities.range()).ok_or(DecideError::BadLength);
            let utilities = utilities.and_then(super::finite);
            if let (Ok(_), Some((gru, to))) = (utilities, &memory) {
                let state = state_of(asked.hidden, gru.size as usize, member.index);
                copy(state, floats.get(to.range()))?;
            }
            answer(member.index, utilities);
        }
        Ok(())
    }
}

/// What is asked at once, and the memory to answer it.
struct Asked<'b> {
    observations: &'b [Observation<'b>],
    arena: &'b mut [u8],
    /// Room for what several selections of one entity share, see [`Plan::shared_floats`].
    shared: &'b mut [f32],
    /// States `[B, R]` of those that observe.
    hidden: &'b mut [f32],
}

/// The state, `size` floats, of the observation at `index`.
fn state_of(hidden: &mut [f32], size: usize, index: usize) -> Option<&mut [f32]> {
    let start = index.saturating_mul(size);
    hidden.get_mut(start..start.saturating_add(size))
}

/// Copies every member's state to its own place.
fn recall(gru: &Gru, team: &mut Team<'_>, hidden: &mut [f32]) -> Result<(), DecideError> {
    let place = team.own_place(&gru.state);
    team.own_places().try_for_each(|(member, floats)| {
        let state = state_of(hidden, gru.size as usize, member.index);
        copy(floats.get_mut(place.range()), state.as_deref())
    })
}

fn copy(to: Option<&mut [f32]>, from: Option<&[f32]>) -> Result<(), DecideError> {
    let (to, from) = to.zip(from).ok_or(DecideError::BadLength)?;
    for (to, from) in to.iter_mut().zip(from) {
        *to = *from;
    }
    Ok(())
}

/// Whether two agents look at the same rows.
fn is_same_frame(a: &Observation<'_>, b: &Observation<'_>) -> bool {
    core::ptr::eq(a.rows, b.rows)
        && a.stride == b.stride
        && core::ptr::eq(a.last_actions, b.last_actions)
}
