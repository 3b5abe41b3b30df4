//! The command line of Sortie, without what reads ONNX files: see `src/tract`.

use std::process::ExitCode;

fn main() -> ExitCode {
    sortie::main(None)
}
