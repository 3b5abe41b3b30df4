//! One of two values, number by number.

use zerocopy::{Immutable, IntoBytes, KnownLayout, TryFromBytes};

use super::super::operator::Operator;
use super::super::{Place, Places, Scratch, Sizes, apart};
use crate::kernels::Kernels;
use crate::policy::{DecideError, Observation};

/// The numbers of `yes` where the condition is other than 0, those of `no` elsewhere.
#[derive(Clone, Copy, Debug, PartialEq, Eq, TryFromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Select {
    /// The condition, as long as the result.
    pub condition: Place,
    /// As long, or one number.
    pub yes: Place,
    /// As long, or one number.
    pub no: Place,
    /// The result, apart from the others.
    pub to: Place,
}

impl Operator for Select {
    const LAYOUT: Option<u32> = None;

    fn check(&self, sizes: &Sizes) -> bool {
        let lengths = [1, self.to.len];
        self.condition.len == self.to.len
            && lengths.contains(&self.yes.len)
            && lengths.contains(&self.no.len)
            && [self.condition, self.yes, self.no]
                .iter()
                .all(|place| sizes.hold_apart(&[place, &self.to]))
    }

    fn reads(&self) -> Places {
        Places::of([self.condition, self.yes, self.no])
    }

    fn writes(&self) -> Places {
        Places::of([self.to])
    }

    #[inline(always)]
    fn run<K: Kernels>(
        &self,
        _: K,
        _: &[f32],
        _: &Observation<'_>,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), DecideError> {
        let (sources, to) = apart(scratch.floats, &self.to)?;
        let condition = sources.get(&self.condition)?;
        let (yes, no) = (sources.get(&self.yes)?, sources.get(&self.no)?);
        // Both are told apart once and not for every number, of which several are then worked on at once.
        match yes {
            [one] => to.fill(*one),
            yes => to.iter_mut().zip(yes).for_each(|(to, yes)| *to = *yes),
        }
        let to = to.iter_mut().zip(condition);
        match no {
            [one] => {
                to.for_each(|(to, condition)| *to = if *condition == 0.0 { *one } else { *to })
            }
            no => to
                .zip(no)
                .for_each(|((to, condition), no)| *to = if *condition == 0.0 { *no } else { *to }),
        }
        Ok(())
    }
}
