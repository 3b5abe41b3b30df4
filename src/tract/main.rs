//! The command line of Sortie with what reads and runs ONNX files inside: tract, the compiler, onnxruntime's binding.
//!
//! They take minutes to compile. `sortie` does without, and starts this program in its place where they are needed.

use std::process::ExitCode;

fn main() -> ExitCode {
    sortie::main(Some(&sortie_compiler::LinkedEngines))
}
