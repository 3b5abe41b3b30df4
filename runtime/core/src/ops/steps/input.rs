//! What the caller gives, or an agent of a team observes.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::super::operator::Operator;
use super::super::{Place, Places, Scratch, Sizes, places};
use crate::kernels::Kernels;
use crate::math::all_finite;
use crate::policy::{DecideError, Observation};

/// One input of a policy: its numbers are copied to the arena, and have to be finite.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Input {
    /// Which of the caller's inputs it is.
    pub index: u16,
    /// What it is where nobody gives it: in a team.
    pub meaning: Meaning,
    /// Where it stands, as long as the input.
    pub to: Place,
}

/// What an input of a policy is in a team. A row is d features, behind them the last action's one-hot where there is
/// room for it; N is `n_max`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(u16)]
pub enum Meaning {
    /// Nothing of a team: only its caller knows.
    None,
    /// The row of the agent that observes.
    OwnRow,
    /// Availability `[U]`: 1 where an action is available, else 0.
    Available,
    /// The rows of all entities `[N, row]`; zeros where one is neither visible nor the agent itself.
    Rows,
    /// The same, the agent's own row before all others.
    RowsOwnFirst,
    /// The entities `[N]` that it may attend to: 1 where visible, else 0.
    Visible,
    /// The same, the agent itself before all others.
    VisibleOwnFirst,
    /// The entities `[N]` that it may not attend to: 0 where visible, else 1.
    Blocked,
    /// The same, the agent itself before all others.
    BlockedOwnFirst,
    /// The number of the agent's own row.
    OwnIndex,
}

impl Meaning {
    /// Whether the agent's own row comes before all others.
    const fn own_first(self) -> bool {
        matches!(self, Self::RowsOwnFirst | Self::VisibleOwnFirst | Self::BlockedOwnFirst)
    }

    /// Whether an input of so many numbers can mean this.
    fn fits(self, len: u32, sizes: &Sizes) -> bool {
        let rows = |count: u32| {
            let fits = |row: u32| u64::from(len) == u64::from(count) * u64::from(row);
            fits(sizes.features) || fits(sizes.features.saturating_add(sizes.actions))
        };
        match self {
            Self::None => true,
            Self::OwnRow => rows(1),
            Self::Available => len == sizes.actions,
            Self::Rows | Self::RowsOwnFirst => rows(sizes.n_max),
            Self::Visible | Self::VisibleOwnFirst | Self::Blocked | Self::BlockedOwnFirst => {
                len == sizes.n_max
            }
            Self::OwnIndex => len == 1,
        }
    }

    /// Writes what an agent of a team observes; `features` is d, `most` is N.
    fn write(
        self,
        seen: &Observation<'_>,
        [features, most]: [usize; 2],
        to: &mut [f32],
    ) -> Result<(), DecideError> {
        self.check_entities(seen, most)?;
        match self {
            Self::None => return Err(DecideError::BadLength),
            Self::OwnRow => write_row(seen, seen.self_index, features, to)?,
            Self::Available => {
                if seen.available.len() != to.len() {
                    return Err(DecideError::BadLength);
                }
                for (to, code) in to.iter_mut().zip(seen.available) {
                    *to = f32::from(u8::from(*code != 0));
                }
            }
            Self::Rows | Self::RowsOwnFirst => {
                let row = to.len().checked_div(most).unwrap_or(0).max(1);
                for (place, to) in to.chunks_exact_mut(row).enumerate() {
                    let entity = self.entity(seen, place);
                    if entity == seen.self_index || seen.visible.contains(entity) {
                        write_row(seen, entity, features, to)?;
                    } else {
                        to.fill(0.0);
                    }
                }
            }
            Self::Visible | Self::VisibleOwnFirst | Self::Blocked | Self::BlockedOwnFirst => {
                let blocks = matches!(self, Self::Blocked | Self::BlockedOwnFirst);
                for (place, to) in to.iter_mut().enumerate() {
                    let is_visible = seen.visible.contains(self.entity(seen, place));
                    *to = f32::from(u8::from(is_visible != blocks));
                }
            }
            // Entities are few enough to be exact.
            Self::OwnIndex => to.fill(seen.self_index as f32),
        }
        Ok(())
    }

    /// Refuses entities for which there is no room.
    fn check_entities(self, seen: &Observation<'_>, max: usize) -> Result<(), DecideError> {
        if matches!(self, Self::None | Self::OwnRow | Self::Available) {
            return Ok(());
        }
        let last = seen.visible.iter().fold(seen.self_index, usize::max);
        let got = last.saturating_add(1);
        if got > max { Err(DecideError::TooManyEntities { max, got }) } else { Ok(()) }
    }

    /// The entity in a place of the rows.
    fn entity(self, seen: &Observation<'_>, place: usize) -> usize {
        match place {
            place if !self.own_first() || place > seen.self_index => place,
            0 => seen.self_index,
            place => place - 1,
        }
    }
}

/// Writes an entity's features, and behind them the one-hot of its last action where there is room for it.
fn write_row(
    seen: &Observation<'_>,
    entity: usize,
    features: usize,
    to: &mut [f32],
) -> Result<(), DecideError> {
    let start = entity.saturating_mul(seen.stride);
    let from = seen.rows.get(start..start.saturating_add(features));
    let from = from.ok_or(DecideError::BadLength)?;
    let (row, last) = to.split_at_mut_checked(features).ok_or(DecideError::BadLength)?;
    for (to, from) in row.iter_mut().zip(from) {
        *to = *from;
    }
    last.fill(0.0);
    let action = seen.last_actions.get(entity).map(|action| usize::from(*action));
    if let Some(to) = action.and_then(|action| last.get_mut(action)) {
        *to = 1.0;
    }
    Ok(())
}

impl Operator for Input {
    const LAYOUT: Option<u32> = None;

    fn check(&self, sizes: &Sizes) -> bool {
        sizes.holds(&self.to) && self.meaning.fits(self.to.len, sizes)
    }

    fn writes(&self) -> Places {
        Places::of([self.to])
    }

    #[inline(always)]
    fn run<K: Kernels>(
        &self,
        _: K,
        _: &[f32],
        seen: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let (inputs, sizes) = (scratch.inputs, [scratch.features, scratch.most]);
        let [to] = places(scratch.floats, [&self.to])?;
        match inputs {
            None => self.meaning.write(seen, sizes, to)?,
            Some(inputs) => {
                let input = inputs.get(usize::from(self.index)).ok_or(DecideError::BadLength)?;
                if input.len() != to.len() {
                    return Err(DecideError::BadLength);
                }
                to.copy_from_slice(input);
            }
        }
        all_finite(to).then_some(()).ok_or(DecideError::NonFinite)
    }
}
