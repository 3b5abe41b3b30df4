//! The plans of a bundle: found in it or compiled by another process, and proved before they act.
//!
//! Nothing here reads ONNX files. [`CompilerProcess`] starts a program that does, with limits; [`BundlePlans`] takes the
//! plan that a bundle ships, else one that was compiled before, else has it compiled, and asks each about the bundle's
//! golden observations and allocations. [`Engines`] is what a program has that links engines for ONNX graphs.
#![forbid(unsafe_code)]

mod agent_plans;
mod agreement;
mod annex;
mod bundle_plans;
mod cache;
mod comparison;
mod dsp;
mod ending;
mod engines;
mod error;
mod facts;
mod families;
mod golden_allocations;
mod judged_agents;
mod observations;
mod onnx_file;
mod options;
mod policy;
mod policy_agreement;
mod policy_plan;
mod process;
mod proof;
mod proposal_files;
mod quantised_policy;
mod report;
mod team_policy;
mod team_sizes;

pub use agent_plans::{AgentPlans, policy_by_agent};
pub use agreement::{
    Agreement, LEAST_AGREEMENT, LEAST_OBSERVATIONS, Quantised, RECORDED, agreement, quantise,
};
pub use annex::Annex;
pub use bundle_plans::{BundlePlans, Compiler};
pub use cache::user_cache;
pub use comparison::{Comparison, TOLERANCE, cannot_run, compare_with_golden, magnitude};
pub use dsp::for_dsp;
pub use ending::Ending;
pub use engines::{
    BatchedUtilities, BatchedValues, DrawnProposals, Engines, GraphEngine, OnnxRuntimeEngine,
    OnnxRuntimeError,
};
pub use error::CompileError;
pub use facts::{InspectedOnnx, OnnxFacts, PlanFacts, inspect_plan};
pub use families::{
    Family, ObservationSizes, Rows, Standard, TeamQuerySizes, observation_families,
    team_query_families,
};
pub use golden_allocations::compare_with_golden_allocations;
pub use judged_agents::{Answers, compare_agents};
pub use observations::{
    OwnedEntities, OwnedTeamQuery, random_allocation_states, random_entities, random_observations,
    random_observations_of, random_policy_inputs, random_states, random_team_queries,
    random_team_queries_of,
};
pub use onnx_file::read_onnx;
pub use options::{
    GraphNetworks, compare_with_golden_episodes, option_arena, option_networks, option_policy,
    options_over_graphs,
};
pub use policy::{
    FlatPolicy, InputRole, OutputRole, PolicyAnswer, PolicyFacts, PolicyInput, PolicyOptions,
    PolicyOutput, PolicyState, ValueType, roles_of,
};
pub use policy_agreement::{
    LARGEST_DEVIATION, OutputAgreement, PolicyAgreement, RecordedCase, policy_agreement,
};
pub use policy_plan::{CompiledPolicy, PlanFlatPolicy, choices};
pub use process::{CompilerProcess, ProcessLimits, Request, check_version, read_request};
pub use proposal_files::ProposalFiles;
pub use quantised_policy::{QuantisedPolicy, quantise_policy};
pub use report::{CompileOptions, Compiled, OperatorReport, Report, VERSION, report};
pub use sortie_attention::{AttentionLayers, AttentionProbe, Layer, Matrix};
pub use team_policy::TeamPolicy;
pub use team_sizes::TeamSizes;
