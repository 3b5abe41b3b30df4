//! Guards of a deployed policy: what is let in, what is let out, and what is given out instead.
//!
//! They stand in the plan, written where it is made, and are read where they stand: nothing is copied, nothing is taken from
//! a heap, nothing panics. Numbers are compared, added and subtracted in `f32`, one by one: a trip is the same on every
//! target.

use zerocopy::byteorder::little_endian::{F32, U32, U64};
use zerocopy::{FromBytes, Immutable, KnownLayout, Unaligned};

use super::sections::Sections;
use super::trip::{GuardError, Trip};
use crate::checksum::{CRC32C, crc32c};

pub(super) const MAGIC: [u8; 8] = *b"SORTIEGU";
/// The form of the section's bytes.
pub(super) const FORM: u8 = 1;

/// What stands first in the section. At any address, as all of it.
#[derive(Clone, Copy, FromBytes, Immutable, KnownLayout, Unaligned)]
#[repr(C)]
struct Head {
    form: u8,
    fallback: u8,
    /// 1 where outputs beyond a limit are clamped.
    clamps: u8,
    _unused: u8,
    hold: U32,
    age_ns_max: U64,
    inputs: U32,
    outputs: U32,
}

/// What is let through of an input.
#[derive(Clone, Copy, Debug, FromBytes, Immutable, KnownLayout, Unaligned)]
#[repr(C)]
pub(super) struct InputLimits {
    lowest: F32,
    highest: F32,
}

/// What is let through of an output.
#[derive(Clone, Copy, Debug, FromBytes, Immutable, KnownLayout, Unaligned)]
#[repr(C)]
pub(super) struct OutputLimits {
    lowest: F32,
    highest: F32,
    change: F32,
}

impl InputLimits {
    /// Of NaN nothing is true.
    fn let_through(&self, input: f32) -> bool {
        let [lowest, highest] = self.range();
        lowest <= input && input <= highest
    }

    /// Lowest and highest value.
    pub(super) fn range(&self) -> [f32; 2] {
        [self.lowest.get(), self.highest.get()]
    }
}

impl OutputLimits {
    fn are_in_range(&self, output: f32) -> bool {
        self.lowest.get() <= output && output <= self.highest.get()
    }

    fn let_change(&self, previous: f32, output: f32) -> bool {
        (output - previous).abs() <= self.change.get()
    }

    /// Lowest and highest value, and largest change.
    pub(super) fn all(&self) -> [f32; 3] {
        [self.lowest.get(), self.highest.get(), self.change.get()]
    }

    /// The nearest output to this one that is let through; where a change would leave the range, the range counts.
    fn clamp(&self, previous: f32, output: f32) -> f32 {
        let [lowest, highest, change] = self.all();
        let mut clamped = output;
        if !self.let_change(previous, output) {
            clamped = if output > previous { previous + change } else { previous - change };
        }
        if clamped < lowest {
            clamped = lowest;
        }
        if clamped > highest {
            clamped = highest;
        }
        clamped
    }
}

/// What is given out where a guard tripped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum GuardFallback {
    /// The plan does not say: what the caller does without an answer, which in [`Guards::fall_back`] is `Hold`.
    #[default]
    Unsaid,
    /// The last outputs once more; zeros before the first.
    Hold,
    /// Zeros.
    Zero,
    /// The numbers of [`Guards::safe_outputs`].
    Safe,
}

impl GuardFallback {
    /// In the order of their numbers in a plan.
    pub(super) const ALL: [Self; 4] = [Self::Unsaid, Self::Hold, Self::Zero, Self::Safe];
}

/// The guards that stand in a plan: `sortie compile --guards` writes them.
///
/// A call before the network and one behind it say which guard tripped; one more writes what is safe, in the same tick.
/// Equal to a limit is within it. Nothing allocates or panics; what passes costs a loop over the inputs and one over the
/// outputs.
///
/// ```
/// use sortie_core::include_plan;
/// use sortie_core::plan::{Aligned, GuardState, Guards, Plan, Trip, arena_bytes};
///
/// const PLAN: &[u8] = include_plan!("../../../../tests/golden/plans/guarded-2.3.plan");
///
/// let plan = Plan::load(PLAN)?;
/// let guards = Guards::of_plan(PLAN)?.ok_or("a plan without guards")?;
/// guards.check_fits(1, 1)?;                          // numbers of all inputs, and of all outputs
/// let mut state = GuardState::new([0.0; 1]);         // room for the last outputs
/// let (mut arena, mut memory) = (Aligned([0; arena_bytes(PLAN)]), [0.0; 16]);
/// let (mut force, age_ns) = ([0.0], 2_000_000);
/// let mut trips = [None; 3];
/// for (position, told) in [0.5, f32::NAN, 0.4].into_iter().zip(&mut trips) {
///     let decided = guards
///         .check_inputs(&state, &[position], Some(age_ns))
///         .and_then(|()| {
///             plan.respond(&mut arena.0, &[&[position]], &mut memory, &mut [&mut force])
///                 .map_err(|_| Trip::Undecided)
///         })
///         .and_then(|()| guards.check_outputs(&mut state, &mut force));
///     if let Err(trip) = decided {
///         guards.fall_back(&mut state, trip, &mut force);
///         *told = Some(trip);
///     }
///     assert!(force[0].abs() <= 1.0);                // to the motor, whatever happened
/// }
/// // This plan holds its fallback for two further decisions.
/// assert_eq!(trips, [None, Some(Trip::InputRange { index: 0 }), Some(Trip::Held)]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Guards<'p> {
    inputs: &'p [InputLimits],
    outputs: &'p [OutputLimits],
    safe: &'p [F32],
    fallback: GuardFallback,
    clamps: bool,
    hold: u32,
    age_ns_max: u64,
}

/// What guards remember of a robot. `M` is room for as many numbers as all outputs have: an array, a slice, or a `Vec`.
#[derive(Clone, Debug)]
pub struct GuardState<M> {
    /// What was given out last, whatever gave it.
    previous: M,
    is_given: bool,
    /// Further decisions for which the fallback stays in force.
    held: u32,
}

impl<M: AsRef<[f32]> + AsMut<[f32]>> GuardState<M> {
    /// Nothing was given out yet.
    pub fn new(room: M) -> Self {
        let mut state = Self { previous: room, is_given: false, held: 0 };
        state.begin();
        state
    }

    /// Forgets what was given out, and what is held: another robot, or one that was standing still.
    pub fn begin(&mut self) {
        self.previous.as_mut().fill(0.0);
        (self.is_given, self.held) = (false, 0);
    }

    /// The outputs that were given out last; zeros before the first.
    pub fn previous(&self) -> &[f32] {
        self.previous.as_ref()
    }

    /// Further decisions for which the fallback stays in force.
    pub fn held(&self) -> u32 {
        self.held
    }
}

impl<'p> Guards<'p> {
    /// Those of a plan's bytes; none where the plan has none.
    ///
    /// # Errors
    /// See [`GuardError`]. Where anything behind the weights is cut off or changed nobody knows whether it was the guards:
    /// that is [`GuardError::Damaged`] too. A file that ends right before its guards is a plan without any; a program that
    /// must have some refuses `None`.
    pub fn of_plan(plan: &'p [u8]) -> Result<Option<Self>, GuardError> {
        let mut sections = Sections::of_plan(plan)?;
        let mut found = None;
        for section in sections.by_ref() {
            let checksum = if section.magic == MAGIC {
                // A second one would leave open which counts.
                if found.replace(section.body).is_some() {
                    return Err(GuardError::Damaged);
                }
                checksum(&section.magic, &section.length, section.body)
            } else {
                crc32c(section.body)
            };
            if checksum != section.checksum {
                return Err(GuardError::Damaged);
            }
        }
        if !sections.is_over() {
            return Err(GuardError::Damaged);
        }
        found.map(Self::read).transpose()
    }

    fn read(body: &'p [u8]) -> Result<Self, GuardError> {
        let (head, rest) = Head::read_from_prefix(body).map_err(|_| GuardError::Damaged)?;
        if head.form != FORM {
            return Err(GuardError::Version { got: head.form });
        }
        let fallback = GuardFallback::ALL.get(usize::from(head.fallback));
        let fallback = *fallback.ok_or(GuardError::Damaged)?;
        let (inputs, outputs) = (head.inputs.get() as usize, head.outputs.get() as usize);
        let (inputs, rest) = <[InputLimits]>::ref_from_prefix_with_elems(rest, inputs)
            .map_err(|_| GuardError::Damaged)?;
        let (outputs, rest) = <[OutputLimits]>::ref_from_prefix_with_elems(rest, outputs)
            .map_err(|_| GuardError::Damaged)?;
        let safe = <[F32]>::ref_from_bytes(rest).map_err(|_| GuardError::Damaged)?;
        let are_right = inputs.iter().all(|limits| limits.lowest.get() <= limits.highest.get())
            && outputs.iter().all(|limits| {
                let [lowest, highest, change] = limits.all();
                lowest <= highest && change >= 0.0
            })
            && safe.iter().all(|number| number.get().is_finite())
            && (fallback == GuardFallback::Safe) != safe.is_empty()
            && head.clamps <= 1;
        if !are_right {
            return Err(GuardError::Contradiction);
        }
        Ok(Self {
            inputs,
            outputs,
            safe,
            fallback,
            clamps: head.clamps == 1,
            hold: head.hold.get(),
            age_ns_max: head.age_ns_max.get(),
        })
    }

    /// Checks that they are about a plan with so many numbers in all inputs and in all outputs.
    ///
    /// # Errors
    /// [`GuardError::Inputs`], [`GuardError::Outputs`].
    pub fn check_fits(&self, inputs: usize, outputs: usize) -> Result<(), GuardError> {
        let fits = |got: usize, want: usize| got == 0 || got == want;
        if !fits(self.inputs.len(), inputs) {
            return Err(GuardError::Inputs { want: inputs, got: self.inputs.len() });
        }
        for got in [self.outputs.len(), self.safe.len()] {
            if !fits(got, outputs) {
                return Err(GuardError::Outputs { want: outputs, got });
            }
        }
        Ok(())
    }

    /// Before the network: age, inputs (those of all, one behind the other), and what is held. `age_ns` is the time since
    /// the observation was made, where that is known.
    ///
    /// # Errors
    /// The guard that tripped: the network is not run, and [`Self::fall_back`] says what is given out.
    pub fn check_inputs<M>(
        &self,
        state: &GuardState<M>,
        inputs: &[f32],
        age_ns: Option<u64>,
    ) -> Result<(), Trip> {
        if age_ns.is_some_and(|age_ns| age_ns > self.age_ns_max) {
            return Err(Trip::Age);
        }
        if !self.inputs.is_empty() {
            if self.inputs.len() != inputs.len() {
                return Err(Trip::Length);
            }
            let mut pairs = self.inputs.iter().zip(inputs);
            if let Some(index) = pairs.position(|(limits, input)| !limits.let_through(*input)) {
                return Err(Trip::InputRange { index: index as u32 });
            }
        }
        if state.held > 0 { Err(Trip::Held) } else { Ok(()) }
    }

    /// Behind the network: its outputs, those of all, one behind the other. What passes is remembered as given out. Where
    /// outputs are clamped, says of the first that was by which guard.
    ///
    /// # Errors
    /// The guard that tripped: the outputs must not be given out, and [`Self::fall_back`] says what is.
    pub fn check_outputs<M: AsRef<[f32]> + AsMut<[f32]>>(
        &self,
        state: &mut GuardState<M>,
        outputs: &mut [f32],
    ) -> Result<Option<Trip>, Trip> {
        let previous = state.previous.as_mut();
        let is_guarded = !self.outputs.is_empty();
        if previous.len() != outputs.len() || (is_guarded && self.outputs.len() != outputs.len()) {
            return Err(Trip::Length);
        }
        if !state.is_given {
            // The first outputs change by nothing.
            copy(outputs, previous);
        }
        let mut triples = self.outputs.iter().zip(&*previous).zip(&*outputs);
        let passes = triples.all(|((limits, previous), output)| {
            limits.are_in_range(*output) && limits.let_change(*previous, *output)
        });
        let tripped = if passes { Ok(None) } else { self.clamp(previous, outputs).map(Some) };
        if tripped.is_ok() {
            copy(outputs, previous);
            state.is_given = true;
        } else if !state.is_given {
            previous.fill(0.0);
        }
        tripped
    }

    /// Outputs of which one is not let through: brings all of them within their limits, if that is how it is answered.
    #[cold]
    fn clamp(&self, previous: &[f32], outputs: &mut [f32]) -> Result<Trip, Trip> {
        let mut first = None;
        let triples = self.outputs.iter().zip(previous).zip(outputs);
        for (index, ((limits, &previous), output)) in (0..).zip(triples) {
            if !output.is_finite() {
                return Err(Trip::OutputNotFinite { index });
            }
            let trip = if !limits.are_in_range(*output) {
                Trip::OutputRange { index }
            } else if !limits.let_change(previous, *output) {
                Trip::OutputRate { index }
            } else {
                continue;
            };
            let clamped = limits.clamp(previous, *output);
            // A caller's own fallback may have given out what is no number: nothing is near that.
            if !self.clamps || !limits.are_in_range(clamped) {
                return Err(trip);
            }
            first.get_or_insert(trip);
            *output = clamped;
        }
        // One was not let through, else nobody would have asked.
        first.ok_or(Trip::Length)
    }

    /// Writes what is given out instead of what the network says, and remembers it. Every trip but [`Trip::Held`] begins
    /// the hold anew.
    pub fn fall_back<M: AsRef<[f32]> + AsMut<[f32]>>(
        &self,
        state: &mut GuardState<M>,
        trip: Trip,
        outputs: &mut [f32],
    ) {
        match self.fallback {
            GuardFallback::Unsaid | GuardFallback::Hold => copy(state.previous.as_ref(), outputs),
            GuardFallback::Zero => outputs.fill(0.0),
            GuardFallback::Safe => {
                for (to, from) in outputs.iter_mut().zip(self.safe) {
                    *to = from.get();
                }
            }
        }
        self.fell_back(state, trip, outputs);
    }

    /// Remembers what a caller has given out by a fallback of its own. As [`Self::fall_back`] otherwise.
    pub fn fell_back<M: AsRef<[f32]> + AsMut<[f32]>>(
        &self,
        state: &mut GuardState<M>,
        trip: Trip,
        outputs: &[f32],
    ) {
        copy(outputs, state.previous.as_mut());
        state.is_given = true;
        state.held = if trip == Trip::Held { state.held.saturating_sub(1) } else { self.hold };
    }

    /// What is given out where a guard tripped.
    pub fn fallback(&self) -> GuardFallback {
        self.fallback
    }

    /// The safe outputs that the plan names; none unless the fallback is [`GuardFallback::Safe`].
    pub fn safe_outputs(&self) -> impl ExactSizeIterator<Item = f32> + use<'p> {
        self.safe.iter().map(|number| number.get())
    }

    /// Whether outputs beyond their limits are brought back to them, and told of, instead of the fallback.
    pub fn clamps(&self) -> bool {
        self.clamps
    }

    /// Further decisions for which the fallback stays in force after a trip.
    pub fn hold(&self) -> u32 {
        self.hold
    }

    /// The oldest that an observation may be, in nanoseconds; none where that is not guarded.
    pub fn age_ns_max(&self) -> Option<u64> {
        (self.age_ns_max != u64::MAX).then_some(self.age_ns_max)
    }

    /// Whether outputs are guarded.
    pub fn limits_outputs(&self) -> bool {
        !self.outputs.is_empty()
    }

    /// Those of each input; none where inputs are not guarded.
    #[cfg(feature = "std")]
    pub(super) fn input_limits(&self) -> &'p [InputLimits] {
        self.inputs
    }

    /// Those of each output; none where outputs are not guarded.
    #[cfg(feature = "std")]
    pub(super) fn output_limits(&self) -> &'p [OutputLimits] {
        self.outputs
    }
}

/// The checksum of a section of guards. Name and length count, so that a name that was changed to one that nobody knows
/// cannot make its plan one without guards.
pub(super) fn checksum(magic: &[u8; 8], length: &[u8; 4], body: &[u8]) -> u32 {
    let mut digest = CRC32C.digest();
    digest.update(magic);
    digest.update(length);
    digest.update(body);
    digest.finalize()
}

/// As many numbers as both have; no optimiser has to know that they are as many.
fn copy(from: &[f32], to: &mut [f32]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to = *from;
    }
}

#[cfg(all(test, feature = "std"))]
mod tests;
