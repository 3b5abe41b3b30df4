//! Decisions of the program of pages, in WebAssembly by Node.js, whose engine Chromium has as well.

use std::fs;
use std::path::Path;
use std::process::Command;

use sortie_cli::PAGE_PROGRAM;
use sortie_cli::failure::{Exit, Failure, with_sources};

use crate::firmware::Subject;

/// Prints the hash of all utilities, as a number.
const SCRIPT: &str = "
const { readFileSync } = require('node:fs');
const { gunzipSync } = require('node:zlib');
const cast = readFileSync('cast.bin');
WebAssembly.instantiate(gunzipSync(readFileSync('page.wasm.gz'))).then(({ instance }) => {
  const { room, certify, memory } = instance.exports;
  const place = room(cast.length);
  new Uint8Array(memory.buffer, place, cast.length).set(cast);
  console.log(BigInt.asUintN(64, certify(place, cast.length)).toString());
});";

/// By what, and the hash of every network.
///
/// # Errors
/// There is no Node.js; a network is one that pages do not ask by single observations; the program refuses it.
pub(super) fn hashes(parts: &[Subject]) -> Result<(String, Vec<u64>), Failure> {
    let version = printed(Command::new("node").arg("--version"))?;
    let folder =
        tempfile::tempdir().map_err(|error| Failure::file(Path::new("a folder"), &error))?;
    let write = |name: &str, bytes: &[u8]| {
        let file = folder.path().join(name);
        fs::write(&file, bytes).map_err(|error| Failure::file(&file, &error))
    };
    write("page.wasm.gz", PAGE_PROGRAM)?;
    let hash = |part: &Subject| {
        let message = "pages decide for agents that see entities and run no options";
        let cast = part.cast()?.ok_or_else(|| Failure::new(Exit::Usage, message))?;
        write("cast.bin", &cast.to_bytes().map_err(Failure::bug)?)?;
        let told = printed(Command::new("node").args(["-e", SCRIPT]).current_dir(folder.path()))?;
        match told.parse().map_err(Failure::bug)? {
            // What the program answers where it cannot decide.
            0 => Err(Failure::new(Exit::BadData, "pages refuse this network")),
            hash => Ok(hash),
        }
    };
    let hashes = parts.iter().map(hash).collect::<Result<_, _>>()?;
    Ok((format!("Node.js {version}"), hashes))
}

/// What a program prints, in one line.
fn printed(command: &mut Command) -> Result<String, Failure> {
    let output = command.output().map_err(|error| {
        let message = format!("`node` cannot be started: {}", with_sources(&error));
        Failure::new(Exit::NotRunning, message)
    })?;
    let [told, said] = [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text));
    match output.status.success() {
        true => Ok(told.trim().to_owned()),
        false => Err(Failure::new(Exit::BadData, format!("node: {}", said.trim()))),
    }
}
