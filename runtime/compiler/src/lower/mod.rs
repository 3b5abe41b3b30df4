//! Matched layers become operators and weights, and both the bytes of a plan.

mod agent;
mod entities;
mod int8;
mod policy;
mod proposals;
mod rounding;
#[cfg(test)]
mod tests;

use sortie_core::plan::{
    ALIGNMENT, HEADER_BYTES, Header, Network, Profile, Program, ProgramDraft, Proof, checksums,
};
use sortie_plans::CompileError;

pub(crate) use agent::{AgentSizes, Choice, lower_agent};
pub(crate) use entities::{EntitySizes, lower_entities};
pub(crate) use int8::lower_agent_int8;
pub(crate) use policy::{LoweredPolicy, lower_policy};
pub(crate) use proposals::lower_proposals;

/// What the header says beside sizes and places.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Origin {
    /// SHA-256 of the ONNX file.
    pub(crate) source: [u8; 32],
    pub(crate) profile: Profile,
    pub(crate) network: Network,
    /// Hash of the contract, 0 if unknown.
    pub(crate) contract: u64,
    /// Most subtasks, 0 if none.
    pub(crate) t_max: u16,
    pub(crate) proof: Proof,
    /// Measured share of differing actions.
    pub(crate) action_mismatch: f32,
}

/// Lays out header, program and weights.
pub(crate) fn assemble(
    program: &ProgramDraft,
    weights: &[u8],
    sizes: AgentSizes,
    origin: &Origin,
) -> Result<Vec<u8>, CompileError> {
    let program_bytes = program.to_bytes();
    let program_bytes = program_bytes.as_slice();
    let program: Program<'_> = Program::read(program_bytes)?;
    let weights_offset = (HEADER_BYTES + program_bytes.len()).next_multiple_of(ALIGNMENT);
    let header = Header {
        layout: origin.profile.layout(),
        arena_bytes: program.arena_bytes() as u32,
        arena_alignment: ALIGNMENT as u32,
        n_max: sizes.n_max as u32,
        features: sizes.features as u32,
        actions: sizes.actions as u32,
        hidden: match origin.network {
            Network::Policy => program.states().map(|state| state.from.len).sum(),
            _ => program.memory().map_or(0, |unit| unit.size),
        },
        program_offset: HEADER_BYTES as u32,
        program_len: program_bytes.len() as u32,
        weights_offset: weights_offset as u32,
        weights_len: weights.len() as u32,
        source: origin.source,
        contract: origin.contract,
        proof: origin.proof,
        action_mismatch: origin.action_mismatch,
        profile: origin.profile,
        network: origin.network,
        t_max: origin.t_max,
        // Readers of format 2.0 know no teams that remember.
        arena_bytes_per_agent: match program.memory() {
            Some(_) => 0,
            None => 4 * program.own_floats().unwrap_or(0),
        },
        skip: program.skips(),
    };
    let checksums = checksums(&header, program_bytes, weights);
    let mut plan = header.to_bytes(checksums).to_vec();
    plan.extend(program_bytes);
    plan.resize(weights_offset, 0);
    plan.extend(weights);
    Ok(plan)
}
