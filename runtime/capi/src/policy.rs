//! A loaded policy, in memory of the caller.

use core::alloc::Layout;
use core::slice;

use sortie_core::plan::{ALIGNMENT, Network, Robot};

use crate::border::{Array, Span, apart};
use crate::errors::SortieError;
use crate::operators::Plan;
use crate::placed::Placed;

/// A loaded policy. It lives in the memory that was given to `sortie_load`, and ends with it: there is nothing to be freed.
/// One thread at a time uses it; several policies may share one plan.
pub struct SortiePolicy {
    mark: usize,
    memory: Span,
    /// The plan's bytes.
    pub(crate) bytes: &'static [u8],
    pub(crate) plan: Plan<'static>,
    /// What stands in the plan beside the network.
    pub(crate) robot: Option<Robot<'static>>,
    pub(crate) arena: &'static mut [u8],
    /// Room for the inputs of a call; empty slices between calls.
    pub(crate) inputs: &'static mut [&'static [f32]],
    /// Room for the outputs of a call.
    pub(crate) outputs: &'static mut [&'static mut [f32]],
}

/// Where the parts of a policy's memory start, from its first aligned byte on.
struct Parts {
    inputs: usize,
    outputs: usize,
    arena: usize,
    bytes: usize,
}

impl Parts {
    fn of(plan: &Plan<'_>) -> Option<Self> {
        let slots = |count| Layout::array::<&[f32]>(count).ok();
        let (inputs, outputs) = (plan.program().input_count(), plan.program().output_count());
        let policy = Layout::new::<SortiePolicy>();
        let (all, inputs) = policy.extend(slots(inputs)?).ok()?;
        let (all, outputs) = all.extend(slots(outputs)?).ok()?;
        let arena = Layout::from_size_align(plan.arena_bytes(), ALIGNMENT).ok()?;
        let (all, arena) = all.extend(arena).ok()?;
        Some(Self { inputs, outputs, arena, bytes: all.size() })
    }
}

impl Placed for SortiePolicy {
    const NAME: [u8; 4] = *b"PLCY";
    const ALIGNMENT: usize = ALIGNMENT;
    const MISSING: SortieError = SortieError::NoPolicy;

    unsafe fn mark(at: *const Self) -> usize {
        // SAFETY: as the caller promises.
        unsafe { (&raw const (*at).mark).read() }
    }
}

/// Checks a plan for being one that this library runs.
pub(crate) fn load(bytes: &[u8]) -> Result<Plan<'_>, SortieError> {
    let plan = Plan::load_with(bytes)?;
    match plan.header().network {
        Network::Agent | Network::Policy => Ok(plan),
        _ => Err(SortieError::WrongNetwork),
    }
}

/// Bytes that hold a policy at whatever address they start.
pub(crate) fn memory_bytes(plan: &Plan<'_>) -> Result<usize, SortieError> {
    let parts = Parts::of(plan).ok_or(SortieError::MemoryTooSmall)?;
    Ok(parts.bytes.saturating_add(ALIGNMENT - 1))
}

impl SortiePolicy {
    /// Lays a policy into memory.
    ///
    /// # Safety
    /// Both come from [`Array::of`]; the plan can be read and the memory be written, by nobody else, as long as the policy
    /// is used.
    pub(crate) unsafe fn place(
        plan: Array<u8>,
        memory: Array<u8>,
    ) -> Result<*mut Self, SortieError> {
        apart([memory.span()].into_iter(), [plan.span()].into_iter())?;
        // SAFETY: as the caller promises.
        let bytes = unsafe { plan.read() };
        let (plan, robot) = (load(bytes)?, Robot::of_plan(bytes));
        let parts = Parts::of(&plan).ok_or(SortieError::MemoryTooSmall)?;
        let before = memory.start().addr().wrapping_neg() % ALIGNMENT;
        if memory.len() < parts.bytes.saturating_add(before) {
            return Err(SortieError::MemoryTooSmall);
        }
        let start = memory.start().wrapping_add(before);
        let (inputs, outputs) = (plan.program().input_count(), plan.program().output_count());
        // SAFETY: all bytes lie inside the memory, which is the caller's to give; written before any of it is read.
        unsafe { start.write_bytes(0, parts.bytes) };
        let at = |offset| start.wrapping_add(offset);
        let input_slots = at(parts.inputs).cast::<&'static [f32]>();
        let output_slots = at(parts.outputs).cast::<&'static mut [f32]>();
        (0..inputs).for_each(|slot| {
            // SAFETY: the layout has room for so many slots, aligned.
            unsafe { input_slots.wrapping_add(slot).write(&[]) }
        });
        (0..outputs).for_each(|slot| {
            // SAFETY: as above.
            unsafe { output_slots.wrapping_add(slot).write(&mut []) }
        });
        let policy = start.cast::<Self>();
        // SAFETY: the parts lie apart, aligned, and were written; they belong to the policy from now on.
        unsafe {
            policy.write(Self {
                mark: Self::mark_at(policy),
                memory: Array::new(start, parts.bytes).span(),
                bytes,
                arena: slice::from_raw_parts_mut(at(parts.arena), plan.arena_bytes()),
                inputs: slice::from_raw_parts_mut(input_slots, inputs),
                outputs: slice::from_raw_parts_mut(output_slots, outputs),
                plan,
                robot,
            });
        }
        Ok(policy)
    }

    /// Where the plan lies.
    pub(crate) fn plan_span(&self) -> Span {
        Array::new(self.bytes.as_ptr(), self.bytes.len()).span()
    }

    /// What a call writes lies apart from what it reads, from the policy and from its plan.
    pub(crate) fn check_apart(
        &self,
        written: impl Iterator<Item = Span> + Clone,
        read: impl Iterator<Item = Span> + Clone,
    ) -> Result<(), SortieError> {
        apart(written.chain([self.memory]), read.chain([self.plan_span()]))
    }

    /// The network is of the wanted kind.
    pub(crate) fn check_network(&self, network: Network) -> Result<(), SortieError> {
        self.plan.check_network(network).map_err(|_| SortieError::WrongKind)
    }
}
