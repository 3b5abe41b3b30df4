//! The plans of a bundle: found in it or compiled by another process, and proved before they act.
//!
//! Nothing here reads ONNX files. [`CompilerProcess`] starts a program that does, with limits; [`BundlePlans`] takes the
//! plan that a bundle ships, else one that was compiled before, else has it compiled, and asks each about the bundle's
//! golden observations and allocations. [`Engines`] is what a program has that links engines for ONNX graphs.
#![forbid(unsafe_code)]

mod agreement;
mod bundle_plans;
mod cache;
mod comparison;
mod dsp;
mod engines;
mod error;
mod facts;
mod families;
mod golden;
mod judge;
mod network;
mod observations;
mod onnx_file;
mod options;
mod policy;
mod policy_plan;
mod process;
mod proof;
mod report;
mod team_policy;

pub use agreement::{
    Agreement, LEAST_AGREEMENT, LEAST_OBSERVATIONS, Quantised, RECORDED, agreement, quantise,
};
pub use bundle_plans::{BundlePlans, Compiler};
pub use cache::user_cache;
pub use comparison::{
    Comparison, Distances, MOST_DISTANCE, MOST_MEAN_DISTANCE, TOLERANCE, TrueNumber, Worst,
    cannot_run, fits, relative_error,
};
pub use dsp::{QuantisedPolicy, for_dsp, quantise_policy};
pub use engines::{
    BatchedUtilities, BatchedValues, DrawnProposals, Engines, GraphEngine, OnnxRuntimeEngine,
    OnnxRuntimeError, TrueFlatPolicy,
};
pub use error::{CompileError, Ending};
pub use facts::{Annex, InspectedOnnx, OnnxFacts, PlanFacts, inspect_plan};
pub use families::{
    Family, ObservationSizes, Rows, Standard, TeamQuerySizes, observation_families,
    team_query_families,
};
pub use golden::{
    GOLDEN_FAMILY, compare_pointing, compare_with_golden, compare_with_golden_allocations,
    golden_inputs, golden_teams,
};
pub use judge::{True, compare, compare_with_truth, needs_truth};
pub use network::{
    Answer, GraphAnswers, NetworkFiles, NetworkInput, NetworkSizes, TrueAnswers, output_widths,
    plan_answers,
};
pub use observations::{
    OwnedEntities, OwnedTeamQuery, policy_inputs_near_and_far, random_allocation_states,
    random_entities, random_observations, random_observations_of, random_policy_inputs,
    random_states, random_team_queries, random_team_queries_of,
};
pub use onnx_file::{is_plan, read_onnx, read_plan_or_onnx};
pub use options::{
    GraphNetworks, compare_with_golden_episodes, option_arena, option_networks, option_policy,
    options_over_graphs,
};
pub use policy::{
    FlatPolicy, InputRole, OutputRole, PolicyAnswer, PolicyFacts, PolicyInput, PolicyOptions,
    PolicyOutput, PolicyState, ValueType, finite_score, pointing_policies, roles_of,
};
pub use policy_plan::{
    CompiledPolicy, LARGEST_DEVIATION, OutputAgreement, PlanFlatPolicy, PolicyAgreement, ProofCase,
    RecordedCase, choices, policy_agreement,
};
pub use process::{CompilerProcess, ProcessLimits, Request, read_request};
pub use proof::{AgentPlans, policy_by_agent};
pub use report::{
    CompileOptions, Compiled, OperatorReport, ProposalFiles, Report, VERSION, report,
};
pub use sortie_attention::{AttentionLayers, AttentionProbe, Layer, Matrix};
pub use team_policy::{TeamPolicy, TeamSizes};
