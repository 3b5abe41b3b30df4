//! Compiles ONNX networks to plans, and proves that both compute the same.
//!
//! tract parses the file and simplifies the graph; patterns are matched on that graph by structure, never by node
//! name; what matches is lowered to a plan. The finished plan and the graph then answer the same random
//! observations, and a plan that differs is refused. The same graph also runs as [`TractPolicy`] or [`TractTeamValue`].
//!
//! Files of strangers are read by another process, with limits: [`CompilerProcess`].
#![forbid(unsafe_code)]

mod agreement;
mod assemble;
mod attention;
mod compile;
mod engine;
#[cfg(test)]
mod entities_tests;
mod error;
#[cfg(test)]
mod executor_tests;
mod families;
mod golden_allocations;
mod graph;
mod graph_inputs;
mod inspect;
mod int8_layout;
#[cfg(test)]
mod int8_tests;
mod judge;
mod layout;
mod lower;
mod lower_entities;
mod lower_int8;
mod lower_proposals;
mod matching;
mod observations;
#[cfg(feature = "onnxruntime")]
pub mod onnxruntime;
mod parity;
mod process;
mod proposals;
#[cfg(test)]
mod proposals_tests;
#[cfg(test)]
mod recurrent_tests;
#[cfg(test)]
mod testing;
mod tract_entities;
mod tract_policy;
mod tract_proposals;
mod tract_team_value;

pub use agreement::{
    Agreement, LEAST_AGREEMENT, LEAST_OBSERVATIONS, Quantised, RECORDED, agreement, quantise,
};
pub use attention::AttentionProbe;
pub use compile::{
    CompileOptions, Compiled, OperatorReport, Report, VERSION, compile, compile_allocator,
    compile_bundle, compile_bundle_as, compile_proposals_of,
};
pub use error::CompileError;
pub use families::{
    Family, ObservationSizes, Standard, TeamQuerySizes, observation_families, team_query_families,
};
pub use golden_allocations::compare_with_golden_allocations;
pub use graph_inputs::Rows;
pub use inspect::{OnnxFacts, PlanFacts, inspect_onnx, inspect_plan};
pub use judge::{Judge, judge_agent, judge_team_values};
pub use observations::{
    OwnedEntities, OwnedTeamQuery, random_allocation_states, random_entities, random_observations,
    random_team_queries,
};
pub use parity::{
    Comparison, TOLERANCE, compare_entities_with_graph, compare_team_values_with_graph,
    compare_with_golden, compare_with_graph,
};
pub use process::{CompilerProcess, Ending, ProcessLimits, answer_compiler};
pub use proposals::{ProposalFiles, compare_proposals_with_graphs, compile_proposals};
pub use tract_policy::TractPolicy;
pub use tract_team_value::TractTeamValue;
