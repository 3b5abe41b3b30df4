//! Guards around a response: what is let in, what is let out, and what is given out instead.

use core::ffi::c_void;
use core::ptr;

use sortie_core::plan::Trip;

use crate::border::Array;
use crate::errors::SortieError;
use crate::guards::SortieGuards;
use crate::placed::Placed;
use crate::policy::SortiePolicy;

/// Bytes that guards take, wherever they start, beside a float for every number of all outputs: `SORTIE_GUARDS_MEMORY`.
pub const SORTIE_GUARDS_BYTES: usize = 256;

const _: () =
    assert!(size_of::<SortieGuards>() + align_of::<SortieGuards>() <= SORTIE_GUARDS_BYTES);

/// The age of an observation that nobody knows.
pub const SORTIE_AGE_UNKNOWN: u64 = u64::MAX;

/// The guard that tripped. Numbers are those of Sortie's messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(i32)]
pub enum SortieGuard {
    /// None did.
    None = 0,
    /// An input is outside of its range, or NaN.
    InputRange = 1,
    /// The observation is older than it may be.
    Age = 2,
    /// An output is NaN or infinite.
    OutputNotFinite = 3,
    /// An output is outside of its range.
    OutputRange = 4,
    /// An output is further from the last one given out than it may change by.
    OutputRate = 5,
    /// The policy has not answered: for programs to say, to `sortie_fall_back`.
    Undecided = 7,
    /// None now: one that tripped before is held.
    Held = 8,
}

/// What a guard found.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct SortieTrip {
    /// Which guard, a `SortieGuard`; `SORTIE_GUARD_NONE` where all is well.
    pub guard: i32,
    /// At which number of all inputs, or of all outputs, one behind the other.
    pub index: u32,
    /// Whether outputs were brought back to their limits, and can be given out.
    pub clamped: bool,
}

impl SortieTrip {
    const NONE: Self = Self { guard: SortieGuard::None as i32, index: 0, clamped: false };

    /// What the core found.
    fn of(trip: Trip, clamped: bool) -> Result<Self, SortieError> {
        let guard = match trip {
            Trip::InputRange { .. } => SortieGuard::InputRange,
            Trip::Age => SortieGuard::Age,
            Trip::OutputNotFinite { .. } => SortieGuard::OutputNotFinite,
            Trip::OutputRange { .. } => SortieGuard::OutputRange,
            Trip::OutputRate { .. } => SortieGuard::OutputRate,
            Trip::Undecided => SortieGuard::Undecided,
            Trip::Held => SortieGuard::Held,
            // Lengths are looked at before.
            _ => return Err(SortieError::WrongLength),
        };
        Ok(Self { guard: guard as i32, index: trip.index().unwrap_or(0), clamped })
    }
}

/// Lays the guards that stand in a policy's plan (`sortie compile --guards`) into memory, which may start anywhere and stays
/// as long as they are used: `SORTIE_GUARDS_MEMORY` says how much. One for each robot. `*guards` is NULL where that fails.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_guard(
    policy: *const SortiePolicy,
    memory: *mut c_void,
    memory_bytes: usize,
    guards: *mut *mut SortieGuards,
) -> SortieError {
    let place = || {
        let to = Array::of(guards, 1, 1)?;
        let memory = Array::<u8>::of(memory.cast(), memory_bytes, memory_bytes)?;
        // SAFETY: as the caller promises.
        let policy = unsafe { SortiePolicy::at(policy) }?;
        policy.check_apart([to.span()].into_iter(), [memory.span()].into_iter())?;
        // SAFETY: apart from memory, policy and plan; the caller promises that it can be written.
        let to = unsafe { to.write() };
        to.fill(ptr::null_mut());
        // SAFETY: as the caller promises, as long as the guards are used.
        to.fill(unsafe { SortieGuards::place(policy, memory) }?);
        Ok(())
    };
    place().into()
}

/// Forgets what was given out, and what is held: where an episode begins, or a robot has stood still.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_guard_begin(guards: *mut SortieGuards) -> SortieError {
    // SAFETY: as the caller promises.
    unsafe { SortieGuards::at_mut(guards) }.map(|guards| guards.state.begin()).into()
}

/// Before the policy: whether it may be asked. `inputs` are the numbers of all inputs, one behind the other; `age_ns` is
/// the time since they were measured, or `SORTIE_AGE_UNKNOWN`. Where `trip->guard` says that a guard tripped, the policy is
/// not asked, and `sortie_fall_back` says what is given out.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_check_inputs(
    guards: *mut SortieGuards,
    inputs: *const f32,
    length: usize,
    age_ns: u64,
    trip: *mut SortieTrip,
) -> SortieError {
    let check = || {
        // SAFETY: as the caller promises.
        let guards = unsafe { SortieGuards::at_mut(guards) }?;
        let (inputs, trip) = (Array::of(inputs, length, guards.inputs)?, Array::of(trip, 1, 1)?);
        guards.check_apart([trip.span()].into_iter(), [inputs.span()].into_iter())?;
        let age_ns = (age_ns != SORTIE_AGE_UNKNOWN).then_some(age_ns);
        // SAFETY: apart from what is written; the caller promises the memory.
        let checked = guards.guards.check_inputs(&guards.state, unsafe { inputs.read() }, age_ns);
        // SAFETY: as above.
        unsafe { tell(checked.map(|()| None), trip) }
    };
    check().into()
}

/// Behind the policy: whether its outputs may be given out, the numbers of all of them, one behind the other. Where
/// `trip->guard` says that a guard tripped, and `trip->clamped` not that they were brought back to their limits,
/// `sortie_fall_back` says what is given out instead. What passes is remembered as given out.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_check_outputs(
    guards: *mut SortieGuards,
    outputs: *mut f32,
    length: usize,
    trip: *mut SortieTrip,
) -> SortieError {
    let check = || {
        // SAFETY: as the caller promises.
        let guards = unsafe { SortieGuards::at_mut(guards) }?;
        let outputs = Array::of(outputs, length, guards.state.previous().len())?;
        let trip = Array::of(trip, 1, 1)?;
        guards.check_apart([trip.span(), outputs.span()].into_iter(), [].into_iter())?;
        // SAFETY: apart from the guards and the trip; the caller promises the memory.
        let outputs = unsafe { outputs.write() };
        let checked = guards.guards.check_outputs(&mut guards.state, outputs);
        // SAFETY: as above.
        unsafe { tell(checked, trip) }
    };
    check().into()
}

/// Writes what is given out where `guard` tripped, a `SortieGuard`, or where `sortie_respond` failed
/// (`SORTIE_GUARD_UNDECIDED`): the plan's fallback, or the last outputs where it has none. Remembers it as given out, and
/// holds it as long as the plan says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn sortie_fall_back(
    guards: *mut SortieGuards,
    guard: i32,
    outputs: *mut f32,
    length: usize,
) -> SortieError {
    let fall_back = || {
        // SAFETY: as the caller promises.
        let guards = unsafe { SortieGuards::at_mut(guards) }?;
        let outputs = Array::of(outputs, length, guards.state.previous().len())?;
        guards.check_apart([outputs.span()].into_iter(), [].into_iter())?;
        // Where does not matter, and a kind has eight bits.
        let number = u32::try_from(guard).ok().filter(|number| *number < 1 << 8);
        let trip = number.and_then(Trip::from_number).filter(|trip| *trip != Trip::Length);
        let trip = trip.ok_or(SortieError::NoTrip)?;
        // SAFETY: apart from the guards; the caller promises the memory.
        let outputs = unsafe { outputs.write() };
        guards.guards.fall_back(&mut guards.state, trip, outputs);
        Ok(())
    };
    fall_back().into()
}

/// # Safety
/// As of [`Array::write`].
unsafe fn tell(
    checked: Result<Option<Trip>, Trip>,
    to: Array<SortieTrip>,
) -> Result<(), SortieError> {
    let told = match checked {
        Ok(None) => SortieTrip::NONE,
        Ok(Some(trip)) => SortieTrip::of(trip, true)?,
        Err(trip) => SortieTrip::of(trip, false)?,
    };
    // SAFETY: as the caller promises.
    unsafe { to.write() }.fill(told);
    Ok(())
}
