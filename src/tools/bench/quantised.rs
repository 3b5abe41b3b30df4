//! The peer's own 8-bit network: onnxruntime's dynamic quantisation, by its Python package.

use std::fs;
use std::path::Path;
use std::process::Command;

use sortie_cli::failure::Failure;
use sortie_cli::output::tell;

const PROGRAM: &str = include_str!("../../../benches/quantise.py");

/// Quantises a network, or notes why it cannot be.
pub(super) fn quantise_or_note(python: Option<&Path>, onnx: &[u8]) -> Option<Vec<u8>> {
    let Some(python) = python else {
        tell!("note: onnxruntime int8 is not measured: `--python` names no interpreter");
        return None;
    };
    quantise(python, onnx)
        .inspect_err(|Failure { message, .. }| {
            tell!("note: onnxruntime int8 is not measured: {message}");
        })
        .ok()
}

fn quantise(python: &Path, onnx: &[u8]) -> Result<Vec<u8>, Failure> {
    let folder = tempfile::tempdir().map_err(Failure::bug)?;
    let [program, network, quantised] =
        ["quantise.py", "network.onnx", "quantised.onnx"].map(|name| folder.path().join(name));
    fs::write(&program, PROGRAM).map_err(|error| Failure::file(&program, &error))?;
    fs::write(&network, onnx).map_err(|error| Failure::file(&network, &error))?;
    let ran = Command::new(python)
        .args([&program, &network, &quantised])
        .output()
        .map_err(|error| Failure::file(python, &error))?;
    if !ran.status.success() {
        let words = String::from_utf8_lossy(&ran.stderr);
        let last = words.lines().last().unwrap_or("it says nothing");
        let message = format!("{last}; `{} -m pip install onnx` may help", python.display());
        return Err(Failure::difference(message));
    }
    fs::read(&quantised).map_err(|error| Failure::file(&quantised, &error))
}
