//! Why a network does not become a plan.

use std::borrow::Cow;
use std::path::PathBuf;
use std::{fmt, io};

use serde::{Deserialize, Serialize};
use sortie_core::plan::PlanError;

/// What differs is the compiler's fault, unless something else in the file explains it.
const PLEA: &str = ": please report this file";

/// Why a network could not be read, compiled or run.
#[derive(Debug, thiserror::Error, Serialize, Deserialize)]
#[non_exhaustive]
pub enum CompileError {
    /// The bytes are not an ONNX model that can be read.
    #[error("the ONNX file cannot be read: {reason}")]
    Unreadable {
        /// What the reader said.
        reason: String,
    },
    /// The inputs are those of no network that is known.
    #[error(
        "an agent network needs entities f32 [N, D], self_index i64 [1] and visible bool [N], with memory a state \
         f32 [R] that comes out too, a team-value network entities and relation f32 [N, _] and present, is_agent, in_task, open, team bool [N], \
         a network over all entities entities f32 [N, D], present bool [N] and, where needed, is_agent bool [N] and \
         groups bool [N, T]; the file has {found}; a policy of another kind needs no \
         bundle: `sortie compile FILE.onnx` makes a plan of it"
    )]
    Inputs {
        /// The inputs of the file, with types and shapes.
        found: String,
    },
    /// A size is left open.
    #[error("the size `{name}` of {values} is left open; fix it, as in `--size {name}=7`")]
    OpenSize {
        /// The size's name.
        name: String,
        /// The inputs that have it.
        values: String,
    },
    /// More must be said about a policy's inputs or outputs.
    #[error("{what} is not clear: {candidates}; write {flag}")]
    Unclear {
        /// What must be said.
        what: Cow<'static, str>,
        /// What it may be.
        candidates: String,
        /// The flag that says it.
        flag: Cow<'static, str>,
    },
    /// A flag names what the file does not have.
    #[error("the file has no {what} `{name}`, only {found}")]
    NotInFile {
        /// What is named.
        what: Cow<'static, str>,
        /// The name.
        name: String,
        /// The names that there are.
        found: String,
    },
    /// Inputs or outputs that no policy has.
    #[error("the file is no policy: {reason}")]
    NoPolicy {
        /// What is wrong.
        reason: String,
    },
    /// An agent's network stands where an allocator's is needed, or the other way round.
    #[error("the file is not {want} network")]
    OtherNetwork {
        /// Whose network is needed.
        want: Cow<'static, str>,
    },
    /// One of three files that are compiled together.
    #[error(
        "{part} is no plan by itself: trunk, step and critic are compiled together, from a bundle"
    )]
    PartAlone {
        /// The part.
        part: Cow<'static, str>,
    },
    /// The sizes of the file and of the contract do not fit.
    #[error("{what} is {got} in the file, the contract says {want}")]
    Size {
        /// What differs.
        what: Cow<'static, str>,
        /// In the file.
        got: usize,
        /// In the contract.
        want: usize,
    },
    /// A size is beyond what a plan can express.
    #[error("{what} is {got}, at most {max} is possible")]
    TooLarge {
        /// What is too large.
        what: Cow<'static, str>,
        /// Its size.
        got: usize,
        /// The limit.
        max: usize,
    },
    /// A part of the graph matches no pattern.
    #[error(
        "`{node}` ({operator} {shapes}) does not fit: {hint}; `--backend tract` still runs this file on a host"
    )]
    Unsupported {
        /// The node's name.
        node: String,
        /// Its operator.
        operator: String,
        /// Shapes of its inputs.
        shapes: String,
        /// The nearest supported pattern.
        hint: Cow<'static, str>,
    },
    /// A node asks for what its reader does not know.
    #[error(
        "`{node}` ({operator}) asks for {what}, which tract does not read: the policy would be computed without; \
         export it without, or run it by onnxruntime"
    )]
    PassedOver {
        /// The node's name.
        node: String,
        /// Its operator.
        operator: String,
        /// What is passed over.
        what: String,
    },
    /// A part of the network has no int8 form.
    #[error("{what} has no int8 form: compile with the profile exact or fused")]
    NoInt8 {
        /// The part.
        what: Cow<'static, str>,
    },
    /// A weight is not a finite number.
    #[error("{layer} holds a weight that is not finite")]
    NonFiniteWeight {
        /// The layer or the constant.
        layer: Cow<'static, str>,
    },
    /// Plan and file differ, and the file holds a number beyond what layers learn.
    #[error(
        "plan and file differ, and the file computes with {weight:e} (the constant `{constant}`): unless that is a mask's, the \
         file is damaged ({})",
        .error.to_string().trim_end_matches(PLEA)
    )]
    WildWeight {
        /// The constant.
        constant: String,
        /// Its number.
        weight: f32,
        /// How they differ.
        error: Box<CompileError>,
    },
    /// The plan is further from the truth than 32 bits account for, so it was thrown away.
    #[error(
        "the plan is wrong on input {input} of the proof of seed {seed}: it gives {number:e} where the file's nodes, in double \
         precision, give {truth:e}; that is {distance:.0} times what 32 bits make any engine err there (limit {limit}, \
         root mean square of an output's number {mean:.1} of {mean_limit}){}",
        PLEA
    )]
    Wrong {
        /// The plan's number.
        number: f32,
        /// What it should be.
        truth: f64,
        /// The distance, in units of the scatter of right engines.
        distance: f64,
        /// The largest distance allowed.
        limit: f64,
        /// The largest root mean square of any output number's distances.
        mean: f64,
        /// The largest allowed.
        mean_limit: f64,
        /// The input.
        input: usize,
        /// The seed of the inputs.
        seed: u64,
    },
    /// The plan answers where the network has no answer, or gives none where it has one.
    #[error(
        "on input {input} of the proof of seed {seed} the plan {}{}",
        if *.answers { "answers, and the network's numbers are not finite" } else { "gives no answer, and the network does" },
        PLEA
    )]
    AnswersOtherwise {
        /// Whether the plan answers.
        answers: bool,
        /// The input.
        input: usize,
        /// The seed of the inputs.
        seed: u64,
    },
    /// The network could not be run on an observation.
    #[error("the network cannot be run: {reason}")]
    Run {
        /// What the engine said.
        reason: String,
    },
    /// The process that reads the file ended without an answer.
    #[error(
        "reading the ONNX file was given up, because {ending}{}: it is damaged, or larger than networks of agents are",
        if said.is_empty() { String::new() } else { format!(" (`{said}`)") }
    )]
    GivenUp {
        /// How it ended.
        ending: Ending,
        /// What it said, empty if nothing.
        said: String,
    },
    /// There is no program that reads ONNX files.
    #[error(
        "`{}` is missing, which reads ONNX files: `cargo build {}-p sortie-tools` makes it",
        program.display(),
        if cfg!(debug_assertions) { "" } else { "--release " }
    )]
    NoCompiler {
        /// Where it should be.
        program: PathBuf,
    },
    /// The program that reads ONNX files is of another version.
    #[error(
        "`{}` is version {}, this program is {want}: `cargo build {}-p sortie-tools` makes it anew, or take both from one \
         release",
        program.display(),
        if got.is_empty() { "unknown" } else { got },
        if cfg!(debug_assertions) { "" } else { "--release " }
    )]
    OtherVersion {
        /// Where it lies.
        program: PathBuf,
        /// Its version, empty where it does not say.
        got: String,
        /// The version of the program that asks.
        want: String,
    },
    /// The plan that a bundle ships is of another network, or of other sizes.
    #[error("`{part}` is no plan of this bundle's network: {reason}")]
    ForeignPlan {
        /// The file.
        part: Cow<'static, str>,
        /// What does not fit.
        reason: String,
    },
    /// A plan does not give the answers that its bundle recorded.
    #[error(
        "the plan does not give the bundle's golden answers: error {error:.1e} (limit {limit:.0e}), {others} of \
         {cases} choices differ"
    )]
    Unproved {
        /// The largest error, |a - b| / (1 + max |b|).
        error: f32,
        /// The limit.
        limit: f32,
        /// Other actions or allocations.
        others: usize,
        /// Golden observations or allocations.
        cases: usize,
    },
    /// The process that reads the file cannot be started.
    #[error("no process can be started that reads the ONNX file: {reason}")]
    NoProcess {
        /// What the system said.
        reason: String,
    },
    /// The names behind a plan cannot be read.
    #[error("the names behind the plan cannot be read: {reason}; compile the policy again")]
    Annex {
        /// What is wrong with them.
        reason: String,
    },
    /// The guards of a plan cannot be used.
    #[error("{reason}; compile the policy again, or copy its plan again")]
    Guards {
        /// What is wrong with them.
        reason: String,
    },
    /// What is said of a bundle's policy cannot be read.
    #[error("{reason}")]
    NoRoles {
        /// What is wrong with it.
        reason: String,
    },
    /// A policy cannot act for an agent of a team.
    #[error("no agent of a team can act by this policy: {reason}")]
    NoAgent {
        /// What does not fit.
        reason: String,
    },
    /// The plan is not one that can be loaded.
    #[error("the plan cannot be loaded")]
    Plan(#[from] PlanError),
}

impl CompileError {
    /// Whether flags help: the file can be read, and more must be said about it.
    pub fn asks(&self) -> bool {
        matches!(self, Self::OpenSize { .. } | Self::Unclear { .. } | Self::NotInFile { .. })
    }

    /// The error of a program that reads ONNX files and could not be started.
    pub fn not_started(program: PathBuf, error: &io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::NotFound => Self::NoCompiler { program },
            _ => Self::NoProcess { reason: format!("`{}`: {error}", program.display()) },
        }
    }
}

/// How a process ended that gave no answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Ending {
    /// It asked for more memory than it may have.
    Memory {
        /// The limit in MiB.
        limit_mib: u32,
    },
    /// It used its processor time up.
    Time {
        /// The limit in seconds.
        limit_s: u32,
    },
    /// It gave no answer in time.
    Silent {
        /// The limit in seconds.
        limit_s: u32,
    },
    /// Its stack overflowed.
    Stack,
    /// A signal ended it.
    Signal(i32),
    /// It ended by itself with this code; 101 is a panic.
    Code(i32),
}

impl fmt::Display for Ending {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Memory { limit_mib } => write!(f, "it takes more than {limit_mib} MiB of memory"),
            Self::Time { limit_s } => write!(f, "it takes more than {limit_s} s of processor time"),
            Self::Silent { limit_s } => write!(f, "there was no answer for {limit_s} s"),
            Self::Stack => write!(f, "its parts are nested too deeply"),
            Self::Signal(signal) => write!(f, "signal {signal} ended the process that read it"),
            Self::Code(code) => write!(f, "the process that read it ended with code {code}"),
        }
    }
}
