//! Plans: a fixed header, a program of fixed records, raw aligned weights; used in place, checked once.
//!
//! [`Plan::load`] makes every check. After it a decision never allocates, blocks or panics; it fails only for
//! the observation's sake ([`DecideError`]). Weights are never copied: they stay in the caller's bytes, be that
//! flash, a memory map or [`AlignedBytes`].

#[cfg(any(test, feature = "alloc"))]
mod aligned;
mod batch;
#[cfg(any(test, feature = "std"))]
mod draft;
mod error;
mod execution;
#[cfg(feature = "std")]
mod guard_facts;
mod guards;
mod header;
mod in_place;
mod needed;
mod policy;
mod program;
mod robot;
#[cfg(feature = "std")]
mod robot_facts;
mod sections;
#[cfg(test)]
mod tests;
mod trip;

#[cfg(any(test, feature = "alloc"))]
pub use aligned::AlignedBytes;
#[cfg(any(test, feature = "std"))]
#[doc(hidden)]
pub use draft::ProgramDraft;
pub use error::{Part, PlanError};
#[cfg(feature = "std")]
pub use guard_facts::{
    Beyond, GuardFacts, GuardedBy, GuardedOutputs, GuardedSizes, InputGuards, OutputGuards,
};
pub use guards::{GuardFallback, GuardState, Guards};
pub use header::{ALIGNMENT, Header, Network, Profile, Proof, VERSION, arena_bytes};
#[doc(hidden)]
pub use header::{Checksums, HEADER_BYTES};
pub use in_place::Aligned;
pub use needed::Needed;
pub use policy::Given;
#[doc(hidden)]
pub use program::{OPS, Ops, Program};
pub use robot::{Fact, Normaliser, Robot};
#[cfg(feature = "std")]
pub use robot_facts::RobotFacts;
pub use trip::{GuardError, Trip};

#[doc(hidden)]
pub use crate::ops::{LAYOUT_INT8, LAYOUT_TILES};

pub(crate) use execution::PlanArithmetic;

use zerocopy::FromBytes;

use crate::checksum::{CRC32C, crc32c};
use crate::choose::{masked_argmax, masked_sample};
use crate::entities::Entities;
use crate::entity_mask::EntityMask;
use crate::kernels::build::Build;
use crate::kernels::mark::Marks;
use crate::limits;
use crate::math::all_finite;
use crate::ops::{AllOperators, OpKind, OperatorSet, Scratch, Sizes, has};
use crate::policy::{DecideError, Decision, Observation};

/// A loaded plan: checked, bound to its weights, and run by the operators of `S`.
#[derive(Clone, Debug)]
pub struct Plan<'a, S: OperatorSet = AllOperators> {
    header: Header,
    program: Program<'a, S>,
    weights: &'a [f32],
    arithmetic: PlanArithmetic,
}

impl<'a> Plan<'a> {
    /// Checks a plan and binds it to its weights. Bytes behind the weights are ignored.
    pub fn load(plan: &'a [u8]) -> Result<Self, PlanError> {
        Self::load_with(plan)
    }
}

impl<'a, S: OperatorSet> Plan<'a, S> {
    /// As [`Plan::load`] with the operators of `S` alone; a plan that needs others is refused.
    pub fn load_with(plan: &'a [u8]) -> Result<Self, PlanError> {
        let (header, checksums) = Header::read(plan)?;
        let program_bytes = part(plan, header.program_offset, header.program_len)?;
        if checksums.program != program_checksum(plan, program_bytes) {
            return Err(PlanError::Crc(Part::Program));
        }
        if header.layout != header.profile.layout() {
            return Err(PlanError::WrongLayout { got: header.layout });
        }
        let weights = part(plan, header.weights_offset, header.weights_len)?;
        if checksums.weights != crc32c(weights) {
            return Err(PlanError::Crc(Part::Weights));
        }
        check_multiple(header.weights_offset as usize)?;
        check_alignment(weights)?;
        let weights =
            <[f32]>::ref_from_bytes(weights).map_err(|_| PlanError::ShapeMismatch { op: 0 })?;
        let program = Program::read(program_bytes)?;
        check(&header, &program)?;
        let arithmetic = PlanArithmetic::of(header.profile, Build::widest())
            .ok_or(PlanError::WrongProfile { got: header.profile.id() })?;
        Ok(Self { header, program, weights, arithmetic })
    }

    /// The same plan on another build of the kernels than the widest.
    ///
    /// All builds give the same bits; this exists to check that.
    pub fn on(self, build: Build) -> Self {
        Self { arithmetic: self.arithmetic.on(build), ..self }
    }

    /// The header.
    pub fn header(&self) -> &Header {
        &self.header
    }

    #[doc(hidden)]
    /// The program.
    pub fn program(&self) -> &Program<'a, S> {
        &self.program
    }

    /// Bytes of arena that a decision needs.
    pub fn arena_bytes(&self) -> usize {
        self.header.arena_bytes as usize
    }

    /// Number of actions U.
    pub fn actions(&self) -> usize {
        self.header.actions as usize
    }

    /// Checks that an arena is large and aligned enough.
    pub fn check_arena(&self, arena: &[u8]) -> Result<(), PlanError> {
        let (need, got) = (self.arena_bytes(), arena.len());
        if got < need {
            return Err(PlanError::ArenaTooSmall { need, got });
        }
        check_alignment(arena)
    }

    /// Checks that an arena is aligned enough.
    pub(crate) fn check_arena_alignment(&self, arena: &[u8]) -> Result<(), PlanError> {
        check_alignment(arena)
    }

    /// Floats R of the recurrent state that the caller keeps for every agent, 0 if there is none.
    pub fn hidden(&self) -> usize {
        self.header.hidden as usize
    }

    /// Writes the utilities `[U]` of one agent, not masked by availability. `arena` is working memory;
    /// `hidden` `[R]` is the agent's recurrent state, replaced if the utilities could be computed.
    pub fn utilities(
        &self,
        arena: &mut [u8],
        observation: &Observation<'_>,
        hidden: Option<&mut [f32]>,
        utilities: &mut [f32],
    ) -> Result<(), DecideError> {
        let computed = self.run(arena, observation, hidden)?;
        if computed.len() != utilities.len() {
            return Err(DecideError::BadLength);
        }
        utilities.copy_from_slice(computed);
        Ok(())
    }

    /// Greedy choice among the available actions, lowest index on ties.
    pub fn decide(
        &self,
        arena: &mut [u8],
        observation: &Observation<'_>,
        hidden: Option<&mut [f32]>,
    ) -> Result<Decision, DecideError> {
        masked_argmax(self.run(arena, observation, hidden)?, observation.available)
    }

    /// An action drawn from the plan's logits by 32 random bits, of a plan that ends in a draw.
    pub fn sample(
        &self,
        arena: &mut [u8],
        observation: &Observation<'_>,
        hidden: Option<&mut [f32]>,
        random: u32,
    ) -> Result<Decision, DecideError> {
        if !self.program.draws() {
            return Err(DecideError::Greedy);
        }
        masked_sample(self.run(arena, observation, hidden)?, observation.available, random)
    }

    /// Writes the outputs of a network over all entities, in the source graph's order: those of entities
    /// `[N, width]` with zeros for absent ones, those of groups `[T, width]`.
    pub fn evaluate(
        &self,
        arena: &mut [u8],
        entities: &Entities<'_>,
        outputs: &mut [&mut [f32]],
    ) -> Result<(), DecideError> {
        if self.header.network != Network::Entities || outputs.len() != self.program.output_count()
        {
            return Err(DecideError::BadLength);
        }
        let observation = Observation {
            rows: entities.rows,
            stride: entities.stride,
            last_actions: &[],
            visible: entities.present,
            // No row is embedded beside those of present entities.
            self_index: entities.present.iter().next().unwrap_or(0),
            available: &[],
        };
        let mut scratch = self.scratch(arena, &observation)?;
        (scratch.agents, scratch.groups) = (entities.agents, entities.groups);
        self.run_agent(&observation, &mut scratch)?;
        self.program.outputs().zip(outputs).try_for_each(|(output, to)| output.read(&scratch, to))
    }

    /// Refuses plans of other networks.
    pub fn check_network(&self, network: Network) -> Result<(), PlanError> {
        if self.header.network == network { Ok(()) } else { Err(PlanError::WrongNetwork) }
    }

    /// Refuses plans that cannot act for an agent of a team: those of other networks, and policies of which an input is
    /// nothing that an agent observes, or that choose no action.
    pub(crate) fn check_agent(&self) -> Result<(), PlanError> {
        let acts = match self.header.network {
            Network::Agent => true,
            Network::Policy => self.program.acts_in_teams(),
            _ => false,
        };
        acts.then_some(()).ok_or(PlanError::WrongNetwork)
    }

    /// Touches every cache line of the weights, so that the next decision finds them near.
    pub fn warm(&self) {
        let lines = self.weights.chunks(16).filter_map(|line| line.first());
        core::hint::black_box(lines.fold(0, |bits, weight| bits ^ weight.to_bits()));
    }

    /// Runs the program and returns the utilities in the arena.
    fn run<'s>(
        &self,
        arena: &'s mut [u8],
        observation: &Observation<'_>,
        hidden: Option<&mut [f32]>,
    ) -> Result<&'s [f32], DecideError> {
        let hidden = hidden.unwrap_or_default();
        // A set without inputs has no code of policies.
        if const { has::<S>(OpKind::Input) } && self.header.network == Network::Policy {
            return self.run_in_team(arena, observation, hidden);
        }
        let (want, got) = (self.hidden(), hidden.len());
        if got != want {
            return Err(DecideError::HiddenState { want, got });
        }
        let mut scratch = self.scratch(arena, observation)?;
        if let Some(gru) = self.program.memory() {
            let state = scratch.floats.get_mut(gru.state.range());
            for (to, from) in state.ok_or(DecideError::BadLength)?.iter_mut().zip(&*hidden) {
                *to = *from;
            }
        }
        self.run_agent(observation, &mut scratch)?;
        let place = self.program.utilities().ok_or(DecideError::BadLength)?;
        let floats: &'s [f32] = scratch.floats;
        let utilities = finite(floats.get(place.range()).ok_or(DecideError::BadLength)?)?;
        if let Some(gru) = self.program.memory() {
            let state = floats.get(gru.to.range()).ok_or(DecideError::BadLength)?;
            for (to, from) in hidden.iter_mut().zip(state) {
                *to = *from;
            }
        }
        Ok(utilities)
    }

    /// The arena as the operators see it.
    fn scratch<'s>(
        &self,
        arena: &'s mut [u8],
        observation: &Observation<'_>,
    ) -> Result<Scratch<'s>, DecideError> {
        let (max, got) = (self.header.n_max as usize, observation.visible.len());
        if got > max {
            return Err(DecideError::TooManyEntities { max, got });
        }
        // Else rows would overlap, and a hidden one could reach into a visible one.
        if observation.stride < self.header.features as usize {
            return Err(DecideError::BadLength);
        }
        let float_bytes = 4 * self.program.floats() as usize;
        let arena = arena.get_mut(..self.arena_bytes()).ok_or(DecideError::BadLength)?;
        let (floats, list) =
            arena.split_at_mut_checked(float_bytes).ok_or(DecideError::BadLength)?;
        let floats = <[f32]>::mut_from_bytes(floats).map_err(|_| DecideError::BadLength)?;
        let nonzeros = <[Marks]>::mut_from_bytes(list).map_err(|_| DecideError::BadLength)?;
        let present = observation.visible;
        let agents = EntityMask::EMPTY;
        Ok(Scratch {
            floats,
            nonzeros,
            visible: 0,
            own: 0,
            present,
            agents,
            groups: &[],
            inputs: None,
            features: self.header.features as usize,
            most: self.header.n_max as usize,
        })
    }

    /// The weights.
    pub(crate) fn weights(&self) -> &'a [f32] {
        self.weights
    }

    /// How it computes.
    pub(crate) fn arithmetic(&self) -> PlanArithmetic {
        self.arithmetic
    }
}

fn finite(utilities: &[f32]) -> Result<&[f32], DecideError> {
    all_finite(utilities).then_some(utilities).ok_or(DecideError::NonFinite)
}

/// Checks that header and program agree, that parts do not overlap and that all sizes are ones that messages can express.
fn check<S: OperatorSet>(header: &Header, program: &Program<'_, S>) -> Result<(), PlanError> {
    let sizes = Sizes {
        floats: program.floats(),
        nonzeros: program.nonzeros(),
        weights: header.weights_len / 4,
        n_max: header.n_max,
        features: header.features,
        actions: header.actions,
        hidden: header.hidden,
    };
    let within = |size: u32, limit: usize| size > 0 && size as usize <= limit;
    let program_end = u64::from(header.program_offset) + u64::from(header.program_len);
    let fits = header.program_offset as usize >= HEADER_BYTES
        && program_end <= u64::from(header.weights_offset)
        && header.arena_alignment as usize == ALIGNMENT
        && within(header.n_max, limits::ENTITIES)
        && within(header.actions, limits::ACTIONS)
        && within(header.features, limits::FEATURES)
        && u64::from(header.arena_bytes) == program.arena_bytes();
    let mismatch = program.mismatch();
    if !fits {
        return Err(mismatch);
    }
    program.check(&sizes, header)?;
    // Plans of the first version say nothing about teams.
    let per_agent = 4 * u64::from(program.own_floats().unwrap_or(0));
    let fits_teams = [0, per_agent].contains(&u64::from(header.arena_bytes_per_agent));
    fits_teams.then_some(()).ok_or(mismatch)
}

fn part(plan: &[u8], offset: u32, len: u32) -> Result<&[u8], PlanError> {
    let (start, len) = (offset as usize, len as usize);
    let need = start.saturating_add(len);
    plan.get(start..need).ok_or(PlanError::Truncated { need, got: plan.len() })
}

fn check_alignment(bytes: &[u8]) -> Result<(), PlanError> {
    if bytes.is_empty() { Ok(()) } else { check_multiple(bytes.as_ptr().addr()) }
}

fn check_multiple(place: usize) -> Result<(), PlanError> {
    if place.is_multiple_of(ALIGNMENT) {
        return Ok(());
    }
    Err(PlanError::Misaligned { need: ALIGNMENT, got: place & place.wrapping_neg() })
}

/// The checksum of header and program, the header's own checksum taken as zero.
fn program_checksum(plan: &[u8], program: &[u8]) -> u32 {
    let mut digest = CRC32C.digest();
    let header = plan.get(..HEADER_BYTES).unwrap_or(plan);
    let (before, rest) = header.split_at_checked(header::CRC_OFFSET).unwrap_or((header, &[]));
    digest.update(before);
    digest.update(&[0; 4]);
    digest.update(rest.get(4..).unwrap_or(&[]));
    digest.update(program);
    digest.finalize()
}

/// The checksums that belong into the header, computed over its bytes, the program and the weights.
pub fn checksums(header: &Header, program: &[u8], weights: &[u8]) -> Checksums {
    let weights = crc32c(weights);
    let bytes = header.to_bytes(Checksums { program: 0, weights });
    Checksums { program: program_checksum(&bytes, program), weights }
}
