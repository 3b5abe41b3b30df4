//! Compiles ONNX networks to plans, and proves that both compute the same.
//!
//! tract parses the file and simplifies the graph; patterns are matched on that graph by structure, never by node
//! name; what matches is lowered to a plan. The finished plan and the graph then answer the same random
//! observations, and a plan that differs is refused. The same graph also runs as [`TractPolicy`] or [`TractTeamValue`].
//!
//! Files of strangers are read by another process, with limits: [`sortie_plans::CompilerProcess`], answered by
//! [`answer_compiler`].
#![forbid(unsafe_code)]

mod answer;
mod assemble;
mod compile;
mod engine;
#[cfg(test)]
mod entities_tests;
#[cfg(test)]
mod executor_tests;
mod graph;
mod graph_inputs;
mod inspect;
mod int8_layout;
#[cfg(test)]
mod int8_tests;
mod judge;
mod layout;
mod linked;
mod lower;
mod lower_entities;
mod lower_int8;
mod lower_proposals;
mod matching;
pub mod onnxruntime;
mod parity;
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

pub use answer::answer_compiler;
pub use compile::compile;
pub use inspect::inspect_onnx;
pub use judge::{Judge, judge_agent, judge_team_values};
pub use linked::{InProcess, LinkedEngines};
pub use parity::{compare_entities_with_graph, compare_team_values_with_graph, compare_with_graph};
pub use proposals::{compare_proposals_with_graphs, compile_proposals};
pub use tract_policy::TractPolicy;
pub use tract_team_value::TractTeamValue;
