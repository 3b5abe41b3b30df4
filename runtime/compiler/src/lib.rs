//! Compiles ONNX networks to plans, and proves that both compute the same.
//!
//! tract parses the file and simplifies the graph; patterns are matched on that graph by structure, never by node
//! name; what matches is lowered to a plan. The finished plan then answers random observations, and so do the file's
//! nodes in double precision: a plan that is further from these than rounding accounts for is refused. The same graph
//! also runs as [`GraphPolicy`] or [`GraphTeamValue`].
//!
//! Files of strangers are read by another process, with limits: [`sortie_plans::CompilerProcess`], answered by
//! [`answer_compiler`].
#![forbid(unsafe_code)]

mod answer;
mod compile;
mod engine;
mod flat;
mod graph;
mod linked;
mod lower;
mod matching;
mod networks;
pub mod onnxruntime;
mod reference;

pub use answer::{answer_compiler, inspect, inspect_onnx};
pub use compile::{
    compare_with_files, compile, compile_policy, compile_proposals, compile_rounded,
};
pub use graph::silence_guarded_panics;
pub use linked::{InProcess, LinkedEngines};
pub use networks::{BatchedAgents, BatchedTeamValues, GraphPolicy, GraphTeamValue};
