//! The plan that the program is built around, and what stands for a panic.

use core::panic::PanicInfo;

use sortie_core::include_plan;
use sortie_core::operators::{Needed, OpKind, OperatorSet};

pub(crate) const PLAN: &[u8] = include_plan!(env!("SORTIE_PLAN"));

/// The operators of the plan.
#[derive(Clone, Copy, Debug)]
pub(crate) struct OfPlan;

impl OperatorSet for OfPlan {
    const OPERATORS: &[OpKind] = const { &Needed::by(PLAN) }.kinds();
}

unsafe extern "C" {
    /// Exists nowhere: a program that can call it does not link.
    fn a_path_to_a_panic_is_left() -> !;
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    // SAFETY: never runs: there is no program with it.
    unsafe { a_path_to_a_panic_is_left() }
}
