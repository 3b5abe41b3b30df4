//! Policies whoever exported them: what is asked of a file, what it turns out to be, and what runs it.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use sortie_bundle::{Bundle, PolicyRoles};

use crate::error::CompileError;

/// What is said about a file; what is left out is found.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PolicyOptions {
    /// The outputs that are wanted, each with `:discrete` or `:continuous` behind its name where that must be said.
    pub outputs: Vec<String>,
    /// Sizes that the file leaves open, by their name in it.
    pub sizes: Vec<(String, usize)>,
    /// Recurrent states, `IN:OUT` each; `none` alone where what looks like one is none.
    pub states: Vec<String>,
    /// The mask of available actions; `none` where what looks like one is none.
    pub available: Option<String>,
    /// The input that holds the entities `[1, N, D]` of a team.
    pub entities: Option<String>,
    /// Which of them the agent may attend to: `NAME:visible` where that is 1, `NAME:blocked` where it is 0.
    pub mask: Option<String>,
    /// Which of them the agent itself is: `first`, or the input with its number.
    pub own: Option<String>,
}

impl From<PolicyRoles> for PolicyOptions {
    fn from(roles: PolicyRoles) -> Self {
        let PolicyRoles { output, state, available, entities, mask, own, size } = roles;
        let sizes = size.into_iter().collect();
        Self { outputs: output, sizes, states: state, available, entities, mask, own }
    }
}

impl From<PolicyOptions> for PolicyRoles {
    fn from(options: PolicyOptions) -> Self {
        let PolicyOptions { outputs, sizes, states, available, entities, mask, own } = options;
        let size = sizes.into_iter().collect();
        Self { output: outputs, state: states, available, entities, mask, own, size }
    }
}

/// What is said of a bundle's agent, where that is a policy over inputs of fixed sizes.
///
/// # Errors
/// The bundle's `policy.toml` cannot be read.
pub fn roles_of(bundle: &Bundle) -> Result<Option<PolicyOptions>, CompileError> {
    let roles = bundle.policy_roles();
    let roles = roles.map_err(|error| CompileError::NoRoles { reason: error.to_string() })?;
    Ok(roles.map(PolicyOptions::from))
}

/// What encoder and decoder of an allocator that points are compiled as: they choose no action, and no input is a mask of those.
pub fn pointing_policies() -> [PolicyOptions; 2] {
    let of_encoder = ["tables", "keys", "values", "points"];
    [&of_encoder[..], &["scores"]].map(|outputs| PolicyOptions {
        outputs: outputs.iter().map(|output| format!("{output}:continuous")).collect(),
        states: vec!["none".to_owned()],
        available: Some("none".to_owned()),
        ..PolicyOptions::default()
    })
}

/// What a policy takes and gives: only what the wanted outputs are computed from, sizes fixed, a batch of one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PolicyFacts {
    /// Inputs, in the file's order.
    pub inputs: Vec<PolicyInput>,
    /// Wanted outputs in the file's order, then the next states in the order of `states`.
    pub outputs: Vec<PolicyOutput>,
    /// Recurrent states.
    pub states: Vec<PolicyState>,
    /// Operators of the simplified graph, as tract calls them.
    pub operators: BTreeMap<String, usize>,
    /// Numbers that are stored in the file for these outputs.
    pub parameters: u64,
    /// Multiply-adds of one decision in products and convolutions; none where a loop's length is not known.
    pub multiply_adds: Option<u64>,
}

/// An input that outputs are computed from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PolicyInput {
    /// The file's name for it.
    pub name: String,
    /// The type of its numbers.
    pub kind: ValueType,
    /// Its sizes.
    pub shape: Vec<usize>,
    /// What it is for.
    pub role: InputRole,
    /// Mean and deviation of every number, where the network first normalises by such; empty elsewhere. Plans do not keep
    /// them.
    #[serde(default)]
    pub normals: Vec<[f32; 2]>,
}

/// An output.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PolicyOutput {
    /// The file's name for it.
    pub name: String,
    /// The type of its numbers.
    pub kind: ValueType,
    /// Its sizes.
    pub shape: Vec<usize>,
    /// What it is for.
    pub role: OutputRole,
}

/// A recurrent state: what comes out is what goes in next.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PolicyState {
    /// The name of the input.
    pub input: String,
    /// The name of the output.
    pub output: String,
    /// Its numbers.
    pub length: usize,
}

/// What an input is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum InputRole {
    /// What the policy sees.
    Observation,
    /// Which actions it may take.
    Available,
    /// What it remembers.
    State,
    /// All entities of a team, `[1, N, D]`.
    Entities {
        /// Whether the agent's own row comes before all others.
        own_first: bool,
    },
    /// Which of them it may attend to.
    Mask {
        /// Whether it is 1 for the others.
        blocks: bool,
        /// Whether the agent itself comes before all others.
        own_first: bool,
    },
    /// Which of them it is itself.
    OwnIndex,
    /// Whatever else it needs.
    Extra,
}

/// What an output is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum OutputRole {
    /// One of so many actions: scores of all, or the place of the one that was chosen.
    Discrete(usize),
    /// So many numbers that are the action.
    Continuous(usize),
    /// What it will remember.
    State,
}

/// Types of numbers in files that can be run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[expect(missing_docs, reason = "the types' own names")]
pub enum ValueType {
    F32,
    F64,
    I64,
    I32,
    U8,
    Bool,
}

/// What a policy gives for one output.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PolicyAnswer {
    /// The output's numbers.
    pub numbers: Vec<f32>,
    /// What they are the places of the largest of, row by row; empty where they are no choice made inside.
    pub scores: Vec<f32>,
}

/// A score as plans give it: what must not be chosen often has the score minus infinity, and gets the lowest that is a number.
pub fn finite_score(number: f32) -> f32 {
    if number == f32::NEG_INFINITY { f32::MIN } else { number }
}

/// A policy with fixed sizes. Its caller keeps the recurrent states.
///
/// All numbers cross as f32: masks are 0 and 1, and whole numbers are exact as far as 2^24.
pub trait FlatPolicy: Send {
    /// What it takes and gives.
    fn facts(&self) -> &PolicyFacts;

    /// One decision. `inputs` are those that are no states, in their order; `states` are all of them one behind the
    /// other, and are replaced; there is an answer for each output that is no state.
    ///
    /// # Errors
    /// Lengths do not fit, or the engine refuses.
    fn run(
        &mut self,
        inputs: &[&[f32]],
        states: &mut [f32],
    ) -> Result<Vec<PolicyAnswer>, CompileError>;

    /// One decision with states and outputs of its own, which nobody reads: what benchmarks time.
    ///
    /// # Errors
    /// As [`Self::run`].
    fn step(&mut self, inputs: &[&[f32]]) -> Result<(), CompileError>;
}

impl PolicyFacts {
    /// Of `inputs` as many as take so many multiply-adds together, but some however large the network is: each number of
    /// a large one is a sum of many that a fault shows in.
    pub fn affordable(&self, inputs: usize, multiply_adds: u64) -> usize {
        const LEAST: usize = 32;
        let affordable = multiply_adds / self.multiply_adds.unwrap_or(1).max(1);
        inputs.min(usize::try_from(affordable).unwrap_or(inputs).max(LEAST))
    }

    /// The inputs that a caller gives at every decision.
    pub fn given(&self) -> impl Iterator<Item = &PolicyInput> {
        self.inputs.iter().filter(|input| input.role != InputRole::State)
    }

    /// The outputs that a caller wants.
    pub fn wanted(&self) -> impl Iterator<Item = &PolicyOutput> {
        self.outputs.iter().filter(|output| output.role != OutputRole::State)
    }

    /// The input that holds the entities of a team.
    pub fn entities(&self) -> Option<&PolicyInput> {
        self.inputs.iter().find(|input| matches!(input.role, InputRole::Entities { .. }))
    }

    /// Numbers of all recurrent states.
    pub fn state_length(&self) -> usize {
        self.states.iter().map(|state| state.length).sum()
    }

    /// Refuses what is not as long as the file says.
    ///
    /// # Errors
    /// The message names the input.
    pub fn check<N>(&self, inputs: &[&[N]], states: &[N]) -> Result<(), CompileError> {
        let misfit = |what: &str, got: usize, want: usize| {
            Err(CompileError::Run { reason: format!("{what}: {got} given, {want} needed") })
        };
        if inputs.len() != self.given().count() {
            return misfit("inputs", inputs.len(), self.given().count());
        }
        for (given, input) in inputs.iter().zip(self.given()) {
            if given.len() != input.length() {
                return misfit(
                    &format!("numbers of `{}`", input.name),
                    given.len(),
                    input.length(),
                );
            }
        }
        if states.len() != self.state_length() {
            return misfit("numbers of the recurrent state", states.len(), self.state_length());
        }
        Ok(())
    }
}

impl PolicyInput {
    /// Its numbers.
    pub fn length(&self) -> usize {
        self.shape.iter().product()
    }
}

impl PolicyOutput {
    /// Its numbers.
    pub fn length(&self) -> usize {
        self.shape.iter().product()
    }
}

impl ValueType {
    /// Its name in messages and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::F64 => "f64",
            Self::I64 => "i64",
            Self::I32 => "i32",
            Self::U8 => "u8",
            Self::Bool => "bool",
        }
    }

    /// Whether it has fractions.
    pub fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }

    /// Whether it counts.
    pub fn is_integer(self) -> bool {
        matches!(self, Self::I64 | Self::I32)
    }

    /// Whether masks are of this type.
    pub fn is_mask(self) -> bool {
        matches!(self, Self::Bool | Self::U8)
    }
}

impl InputRole {
    /// Its name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Observation => "observation",
            Self::Available => "available actions",
            Self::State => "recurrent state",
            Self::Entities { own_first: true } => "entities, itself first",
            Self::Entities { own_first: false } => "entities",
            Self::Mask { blocks: true, .. } => "blocked entities",
            Self::Mask { blocks: false, .. } => "visible entities",
            Self::OwnIndex => "own entity",
            Self::Extra => "extra",
        }
    }
}

impl std::fmt::Display for OutputRole {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Discrete(actions) => write!(f, "action, discrete {actions}"),
            Self::Continuous(numbers) => write!(f, "action, continuous {numbers}"),
            Self::State => f.write_str("next recurrent state"),
        }
    }
}
