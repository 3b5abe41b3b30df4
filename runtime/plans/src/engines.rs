//! Engines that run ONNX graphs themselves: what a program has that links them.
//!
//! They take minutes to compile, so that the programs that act do without; see [`Engines`].

use std::io;
use std::path::Path;

use sortie_core::allocate::proposals::Draw;
use sortie_core::allocate::{TeamQuery, TeamValueNetwork};
use sortie_core::{AllocateError, AllocationState, DecideError, Observation, Policy};

use crate::comparison::TrueNumber;
use crate::error::CompileError;
use crate::network::{GraphAnswers, NetworkFiles, TrueAnswers};
use crate::policy::{FlatPolicy, PolicyOptions};
use crate::report::ProposalFiles;

/// The engines of a program, and its compiler.
pub trait Engines: Sync {
    /// Answers one request of a [`crate::CompilerProcess`], from standard input to standard output.
    ///
    /// # Errors
    /// The request cannot be read, the answer not be written, or the limits not be set.
    fn answer_compiler(&self) -> io::Result<()>;

    /// tract, on the simplified graph.
    fn tract(&self) -> &'static dyn GraphEngine;

    /// onnxruntime, on the file as it is; its library is opened at run time, that of `python` if it is given.
    ///
    /// # Errors
    /// No library is found, or it cannot be used.
    fn onnxruntime(
        &self,
        python: Option<&Path>,
    ) -> Result<&'static dyn OnnxRuntimeEngine, OnnxRuntimeError>;

    /// A policy's file, node by node in double precision.
    ///
    /// # Errors
    /// The file cannot be read, or more must be said about it.
    fn truth(
        &self,
        onnx: &[u8],
        options: &PolicyOptions,
    ) -> Result<Box<dyn TrueFlatPolicy>, CompileError>;

    /// Columns of the entities and of the relation in a team-value graph.
    ///
    /// # Errors
    /// The file is none.
    fn team_value_columns(&self, onnx: &[u8]) -> Result<(usize, usize), CompileError>;

    /// A network's file, node by node in double precision; an agent's rows have so many features before the last
    /// action's one-hot.
    ///
    /// # Errors
    /// The files cannot be read, have other sizes, or an operator that the reference evaluator lacks.
    fn true_network(
        &self,
        files: &NetworkFiles<'_>,
        features: usize,
        seed: u64,
    ) -> Result<Box<dyn TrueAnswers>, CompileError>;
}

/// An engine that runs the source graph itself. Files of strangers are for [`crate::CompilerProcess::rehearse`] first.
pub trait GraphEngine: Sync {
    /// Its name.
    fn name(&self) -> &'static str;

    /// Its version.
    fn version(&self) -> &str;

    /// An agent's graph as a policy; `features` is the number d of columns before the last action's one-hot.
    ///
    /// # Errors
    /// The file cannot be read, or has other sizes.
    fn policy(&self, onnx: &[u8], features: usize) -> Result<Box<dyn Policy + Send>, CompileError>;

    /// The graph of a team-value network.
    ///
    /// # Errors
    /// The file cannot be read.
    fn team_value(&self, onnx: &[u8]) -> Result<Box<dyn TeamValueNetwork + Send>, CompileError>;

    /// A policy of which only what these options say is known.
    ///
    /// # Errors
    /// The file cannot be read, or more must be said about it.
    fn flat_policy(
        &self,
        onnx: &[u8],
        options: &PolicyOptions,
    ) -> Result<Box<dyn FlatPolicy>, CompileError>;

    /// A network whatever it gives: nothing is refused for its values. An agent's rows have so many features before the
    /// last action's one-hot.
    ///
    /// # Errors
    /// A file cannot be read, or has other sizes.
    fn network(
        &self,
        files: &NetworkFiles<'_>,
        features: usize,
    ) -> Result<Box<dyn GraphAnswers>, CompileError>;
}

/// A policy's truth: its file's nodes in double precision, and eight times more with a rounding of 32 bits behind each.
pub trait TrueFlatPolicy {
    /// Begins without memory.
    fn begin(&mut self);

    /// All outputs, states behind the others; of one that chooses, the scores that it chooses from. `states` are all
    /// recurrent states, where they are known, else those that the call before left behind.
    ///
    /// # Errors
    /// The inputs do not fit, or the file has an operator that the reference evaluator lacks.
    fn run(
        &mut self,
        inputs: &[&[f32]],
        states: Option<&[f32]>,
    ) -> Result<Vec<Vec<TrueNumber>>, CompileError>;
}

/// The peer of benchmarks.
pub trait OnnxRuntimeEngine: GraphEngine {
    /// Runs `variant`, which has the inputs and outputs of `onnx`: the same network quantised, for example.
    ///
    /// # Errors
    /// A file cannot be read.
    fn policy_of_variant(
        &self,
        onnx: &[u8],
        variant: &[u8],
        features: usize,
    ) -> Result<Box<dyn Policy>, CompileError>;

    /// The agent's graph for all agents of a frame in one call.
    ///
    /// # Errors
    /// The file cannot be read.
    fn batched_agents(
        &self,
        onnx: &[u8],
        features: usize,
    ) -> Result<Box<dyn BatchedUtilities>, CompileError>;

    /// The team-value graph for all teams of all subtasks in one call.
    ///
    /// # Errors
    /// The file cannot be read.
    fn batched_team_values(&self, onnx: &[u8]) -> Result<Box<dyn BatchedValues>, CompileError>;

    /// An allocator that proposes.
    ///
    /// # Errors
    /// A file cannot be read.
    fn proposals(&self, files: &ProposalFiles<'_>)
    -> Result<Box<dyn DrawnProposals>, CompileError>;
}

/// One call for all agents of a frame.
pub trait BatchedUtilities {
    /// Writes the utilities `[A, U]`.
    ///
    /// # Errors
    /// The observations do not fit the graph, or each other.
    fn utilities(
        &mut self,
        frame: &[Observation<'_>],
        utilities: &mut [f32],
    ) -> Result<(), DecideError>;
}

/// One call for many teams.
pub trait BatchedValues {
    /// Writes the value of each.
    ///
    /// # Errors
    /// The queries do not fit the graph, or each other.
    fn values(
        &mut self,
        queries: &[TeamQuery<'_>],
        values: &mut [f32],
    ) -> Result<(), AllocateError>;
}

/// Proposals drawn and valued by another engine.
pub trait DrawnProposals {
    /// Draws as many as there are `values`, values them, and returns the best allocation.
    ///
    /// # Errors
    /// The state does not fit the graphs.
    fn propose(
        &mut self,
        state: &AllocationState<'_>,
        draw: &mut dyn Draw,
        values: &mut [f32],
    ) -> Result<Vec<u8>, AllocateError>;
}

/// Why onnxruntime cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum OnnxRuntimeError {
    /// No library was found.
    #[error(
        "onnxruntime was not found {place}; `python3 -m venv venv && venv/bin/pip install onnxruntime` installs \
         it, `--python venv/bin/python3` or ORT_DYLIB_PATH names it"
    )]
    NotFound {
        /// Where it was looked for.
        place: String,
    },
    /// The library cannot be opened, or is too old.
    #[error("the library of onnxruntime cannot be used: {reason}")]
    Unusable {
        /// What is wrong with it.
        reason: String,
    },
}
