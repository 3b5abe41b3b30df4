//! The fixed first bytes of a plan.

use super::error::PlanError;
use crate::ops::{LAYOUT_INT8, LAYOUT_TILES};

/// Bytes of the header.
pub const HEADER_BYTES: usize = 128;
/// The plan format of this build: major, minor. It reads the same major up to the same minor.
pub const VERSION: (u16, u16) = (2, 3);
/// Alignment of the weights inside a plan and of the arena, in bytes.
pub const ALIGNMENT: usize = 64;

const MAGIC: [u8; 8] = *b"SORTIEPL";
/// The minor version from which on plans say their distance from the network in double precision.
const PROOF_MINOR: u16 = 3;
const ENDIAN_PROBE: u32 = 0x0102_0304;
/// Where the checksum of header and program stands.
pub(super) const CRC_OFFSET: usize = 60;

/// How a plan computes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "std", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Profile {
    /// f32 without fused multiply-add: the same bits on every target.
    Exact,
    /// f32 with fused multiply-add: the same bits on every target that has it, none on others.
    Fused,
    /// int8 weights, int16 inputs, sums in i32; what lies between layers is f32 without fused multiply-add: the
    /// same bits on every target.
    Int8,
}

/// What a plan computes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Network {
    /// An agent's utilities.
    Agent,
    /// The value of a team at a subtask.
    TeamValue,
    /// Proposals of allocations, and what each is worth.
    Proposals,
    /// Any outputs over all entities: a critic, the trunk of an allocator.
    Entities,
    /// A policy over inputs of fixed sizes: one agent's action, or any outputs.
    Policy,
}

/// How far a plan's numbers were from its network's when it was compiled, on the processor that did: on other ones the last
/// bits of the measure differ.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "std", derive(serde::Serialize), serde(untagged))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Proof {
    /// From the network in double precision, in what the rounding of f32 makes right engines err in that very number:
    /// what plans say since format 2.3.
    Distance {
        /// Largest of any number. At most 16, but for int8 plans: they are judged by their actions.
        max_distance: f32,
        /// Inputs compared, 65,535 where there were more; 0 where nothing was proved.
        inputs: u16,
    },
    /// From the network in f32: what plans say up to format 2.2.
    Error {
        /// Largest |a - b| / (1 + max |b|).
        max_rel_error: f32,
    },
}

/// The header of a plan; magic, version, byte order and checksums are checked and not kept.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Header {
    /// How the weights are laid out.
    pub layout: u32,
    /// Bytes of arena that one decision needs.
    pub arena_bytes: u32,
    /// Alignment of the arena, in bytes.
    pub arena_alignment: u32,
    /// Most visible entities.
    pub n_max: u32,
    /// Features d of an entity, the last action not counted.
    pub features: u32,
    /// Actions U.
    pub actions: u32,
    /// Floats of the hidden state, 0 if there is none.
    pub hidden: u32,
    /// Where the program starts.
    pub program_offset: u32,
    /// Bytes of the program.
    pub program_len: u32,
    /// Where the weights start, a multiple of [`ALIGNMENT`].
    pub weights_offset: u32,
    /// Bytes of the weights.
    pub weights_len: u32,
    /// SHA-256 of the ONNX file that the plan was made from.
    pub source: [u8; 32],
    /// Hash of the contract that the policy was trained for, 0 if unknown.
    pub contract: u64,
    /// How far its numbers were from the source graph's.
    pub proof: Proof,
    /// Measured share of inputs for which the chosen action differed from the source graph's.
    pub action_mismatch: f32,
    /// How the plan computes.
    pub profile: Profile,
    /// What it computes.
    pub network: Network,
    /// Most subtasks, 0 if none.
    pub t_max: u16,
    /// Bytes of arena that every further agent of a team needs, 0 where agents are worked on one by one.
    pub arena_bytes_per_agent: u32,
    /// Whether the layer behind the attention takes the own row as well.
    pub skip: bool,
}

impl Header {
    /// Reads and checks the header; the checksums are the caller's to compare.
    pub fn read(plan: &[u8]) -> Result<(Self, Checksums), PlanError> {
        // What is no plan at all is called so even where it is short.
        if plan.first_chunk().is_some_and(|start| *start != MAGIC) {
            return Err(PlanError::BadMagic);
        }
        let got = plan.len();
        let header = plan.first_chunk::<HEADER_BYTES>();
        let mut fields = Fields(header.ok_or(PlanError::Truncated { need: HEADER_BYTES, got })?);
        let _: [u8; MAGIC.len()] = fields.next()?;
        let (major, minor) = (fields.u16()?, fields.u16()?);
        if major != VERSION.0 || minor > VERSION.1 {
            return Err(PlanError::Version { major, minor });
        }
        if fields.u32()? != ENDIAN_PROBE {
            return Err(PlanError::Endian);
        }
        let (layout, arena_bytes, arena_alignment) = (fields.u32()?, fields.u32()?, fields.u32()?);
        let (n_max, features, actions) = (fields.u32()?, fields.u32()?, fields.u32()?);
        let hidden = fields.u32()?;
        let (program_offset, program_len) = (fields.u32()?, fields.u32()?);
        let (weights_offset, weights_len) = (fields.u32()?, fields.u32()?);
        let checksums = Checksums { program: fields.u32()?, weights: fields.u32()? };
        let source = fields.next()?;
        let contract = u64::from_le_bytes(fields.next()?);
        let measure = f32::from_le_bytes(fields.next()?);
        let action_mismatch = f32::from_le_bytes(fields.next()?);
        let [profile, network] = fields.next()?;
        let t_max = fields.u16()?;
        let arena_bytes_per_agent = fields.u32()?;
        let [skip, _] = fields.next()?;
        let inputs = fields.u16()?;
        let header = Self {
            layout,
            arena_bytes,
            arena_alignment,
            n_max,
            features,
            actions,
            hidden,
            program_offset,
            program_len,
            weights_offset,
            weights_len,
            source,
            contract,
            proof: if minor < PROOF_MINOR {
                Proof::Error { max_rel_error: measure }
            } else {
                Proof::Distance { max_distance: measure, inputs }
            },
            action_mismatch,
            profile: Profile::from_id(profile)?,
            network: Network::from_id(network)?,
            t_max,
            arena_bytes_per_agent,
            skip: match skip {
                0 => false,
                1 => true,
                _ => return Err(PlanError::UnknownOp),
            },
        };
        Ok((header, checksums))
    }

    /// The header as bytes, with the given checksums.
    pub fn to_bytes(&self, checksums: Checksums) -> [u8; HEADER_BYTES] {
        let mut bytes = [0; HEADER_BYTES];
        let mut rest = bytes.as_mut_slice();
        let mut put = |field: &[u8]| {
            if let Some((to, after)) = core::mem::take(&mut rest).split_at_mut_checked(field.len())
            {
                to.copy_from_slice(field);
                rest = after;
            }
        };
        put(&MAGIC);
        put(&VERSION.0.to_le_bytes());
        let (minor, measure, inputs) = match self.proof {
            Proof::Distance { max_distance, inputs } => (PROOF_MINOR, max_distance, inputs),
            Proof::Error { max_rel_error } => (PROOF_MINOR - 1, max_rel_error, 0),
        };
        put(&minor.to_le_bytes());
        let sizes = [
            ENDIAN_PROBE,
            self.layout,
            self.arena_bytes,
            self.arena_alignment,
            self.n_max,
            self.features,
            self.actions,
            self.hidden,
            self.program_offset,
            self.program_len,
            self.weights_offset,
            self.weights_len,
            checksums.program,
            checksums.weights,
        ];
        sizes.iter().for_each(|size| put(&size.to_le_bytes()));
        put(&self.source);
        put(&self.contract.to_le_bytes());
        put(&measure.to_le_bytes());
        put(&self.action_mismatch.to_le_bytes());
        put(&[self.profile.id(), self.network.id()]);
        put(&self.t_max.to_le_bytes());
        put(&self.arena_bytes_per_agent.to_le_bytes());
        put(&[u8::from(self.skip), 0]);
        put(&inputs.to_le_bytes());
        bytes
    }
}

/// CRC-32C of the parts of a plan.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Checksums {
    /// Of header and program, the header's own checksum taken as zero.
    pub program: u32,
    /// Of the weights.
    pub weights: u32,
}

/// Bytes of arena that the plan needs, as a constant: `static ARENA: [u8; arena_bytes(PLAN)]`.
///
/// A plan too short to have a header needs 0 bytes, and is refused at load.
pub const fn arena_bytes(plan: &[u8]) -> usize {
    word(plan, 20)
}

/// The records of a plan's program, behind the sizes of its arena; none where the plan is too short.
pub(super) const fn records(plan: &[u8]) -> &[u8] {
    const SIZES: usize = 8;
    let (offset, len) = (word(plan, 44), word(plan, 48));
    let Some((_, rest)) = plan.split_at_checked(offset) else { return &[] };
    let Some((program, _)) = rest.split_at_checked(len) else { return &[] };
    match program.split_at_checked(SIZES) {
        Some((_, records)) => records,
        None => &[],
    }
}

/// A word of the header, 0 where the plan is too short.
const fn word(plan: &[u8], offset: usize) -> usize {
    let Some((_, rest)) = plan.split_at_checked(offset) else { return 0 };
    let Some(field) = rest.first_chunk::<4>() else { return 0 };
    u32::from_le_bytes(*field) as usize
}

impl Proof {
    /// Of a plan that was compared with nothing.
    pub const NONE: Self = Self::Distance { max_distance: 0.0, inputs: 0 };
}

impl Profile {
    /// The profile's name, for people and scripts.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::Fused => "fused",
            Self::Int8 => "int8",
        }
    }

    /// The profile's number in the header.
    pub const fn id(self) -> u8 {
        match self {
            Self::Exact => 0,
            Self::Fused => 1,
            Self::Int8 => 2,
        }
    }

    /// How the weights of such plans are laid out.
    pub const fn layout(self) -> u32 {
        match self {
            Self::Exact | Self::Fused => LAYOUT_TILES,
            Self::Int8 => LAYOUT_INT8,
        }
    }

    fn from_id(id: u8) -> Result<Self, PlanError> {
        match id {
            0 => Ok(Self::Exact),
            1 => Ok(Self::Fused),
            2 => Ok(Self::Int8),
            got => Err(PlanError::WrongProfile { got }),
        }
    }
}

impl Network {
    /// The network's name, for people and scripts.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Agent => "agent",
            Self::TeamValue => "team-value",
            Self::Proposals => "proposals",
            Self::Entities => "entities",
            Self::Policy => "policy",
        }
    }

    /// The network's number in the header.
    pub const fn id(self) -> u8 {
        match self {
            Self::Agent => 0,
            Self::TeamValue => 1,
            Self::Proposals => 2,
            Self::Entities => 5,
            Self::Policy => 6,
        }
    }

    fn from_id(id: u8) -> Result<Self, PlanError> {
        match id {
            0 => Ok(Self::Agent),
            1 => Ok(Self::TeamValue),
            2 => Ok(Self::Proposals),
            5 => Ok(Self::Entities),
            6 => Ok(Self::Policy),
            _ => Err(PlanError::UnknownOp),
        }
    }
}

/// The fields of the header, one after the other.
struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    fn next<const LEN: usize>(&mut self) -> Result<[u8; LEN], PlanError> {
        let (field, rest) = self.0.split_first_chunk().ok_or(PlanError::BadMagic)?;
        self.0 = rest;
        Ok(*field)
    }

    fn u16(&mut self) -> Result<u16, PlanError> {
        self.next().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Result<u32, PlanError> {
        self.next().map(u32::from_le_bytes)
    }
}

#[cfg(test)]
mod tests;
