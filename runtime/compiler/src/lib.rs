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
mod compile;
mod flat;
mod graph;
mod judge;
mod linked;
mod lower;
mod matching;
pub mod onnxruntime;
mod reference;
mod tract;

pub use answer::{answer_compiler, inspect, inspect_onnx};
pub use compile::{
    compare_entities_with_graph, compare_proposals_with_graphs, compare_team_values_with_graph,
    compare_with_graph, compile, compile_policy, compile_proposals, compile_rounded,
};
pub use judge::{Judge, judge_agent, judge_team_values};
pub use linked::{InProcess, LinkedEngines};
pub use tract::{TractPolicy, TractTeamValue};
