//! The three graphs of an allocator that proposes, which become one plan.

use serde::{Deserialize, Serialize};

use crate::error::CompileError;

/// The ONNX files of an allocator that proposes.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct ProposalFiles<'a> {
    /// `allocator_trunk.onnx`
    pub trunk: &'a [u8],
    /// `allocator_step.onnx`
    pub step: &'a [u8],
    /// `allocator_critic.onnx`
    pub critic: &'a [u8],
}

impl<'a> ProposalFiles<'a> {
    /// The files as one, by which a plan is known.
    pub fn joined(&self) -> Vec<u8> {
        // Writing plain bytes to memory has no way to fail.
        postcard::to_stdvec(self).unwrap_or_default()
    }

    /// The files of what [`Self::joined`] gave.
    pub fn split(joined: &'a [u8]) -> Result<Self, CompileError> {
        let unreadable =
            |error: postcard::Error| CompileError::Unreadable { reason: error.to_string() };
        postcard::from_bytes(joined).map_err(unreadable)
    }
}
