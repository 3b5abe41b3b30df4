//! Memory that starts where plans and arenas must, without a heap.

/// A value that starts at a multiple of [`ALIGNMENT`](super::ALIGNMENT).
///
/// As an arena whose size the plan gives, so that one that does not fit fails to link:
///
/// ```
/// use sortie_core::include_plan;
/// use sortie_core::plan::{Aligned, Plan, arena_bytes};
///
/// const PLAN: &[u8] = include_plan!("../../../../tests/golden/plans/agent-2.0.plan");
///
/// let arena = Aligned([0; arena_bytes(PLAN)]);
/// Plan::load(PLAN)?.check_arena(&arena.0)?;
/// # Ok::<(), sortie_core::plan::PlanError>(())
/// ```
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct Aligned<T>(pub T);

const _: () = assert!(align_of::<Aligned<u8>>() == super::ALIGNMENT);

/// The bytes of a plan file as a constant of the program: aligned, and used where they lie.
///
/// The path is taken like that of `include_bytes!`: from the file that names it.
#[macro_export]
macro_rules! include_plan {
    ($path:expr $(,)?) => {{
        static PLAN: $crate::plan::Aligned<[u8; include_bytes!($path).len()]> =
            $crate::plan::Aligned(*include_bytes!($path));
        let plan: &'static [u8] = &PLAN.0;
        plan
    }};
}
