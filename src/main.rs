//! The command line of Sortie, without what reads ONNX files: see `src/tools`.

use std::process::ExitCode;

use sortie_cli::{Program, run_program};

fn main() -> ExitCode {
    run_program(&Program {
        version: sortie_version::SHORT,
        built: sortie_version::LONG,
        tools: None,
        zenoh: None,
    })
}
