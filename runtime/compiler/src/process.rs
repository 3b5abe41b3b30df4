//! ONNX files read by another process, whose memory and time are limited.
//!
//! What parses ONNX files takes sizes from them: a damaged file can make it allocate without bound, loop, or
//! overflow its stack, which no process survives. [`CompilerProcess`] starts a program for each file, which calls
//! [`answer_compiler`]: it limits itself, reads what to do and the file from standard input, and writes its
//! answer to standard output. What it says beside that is kept out of sight.

use std::ffi::OsString;
use std::fmt;
use std::io::{self, Read, Write};
use std::os::unix::process::ExitStatusExt;
use std::path::PathBuf;
use std::process::{Command, ExitStatus, Output, Stdio};

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use sortie_bundle::Bundle;
use sortie_core::plan::{AlignedBytes, Profile};

use crate::compile::{
    CompileOptions, Compiled, agent_plan, allocator_plan, compile, proposal_plan,
};
use crate::engine::TeamValueEngine;
use crate::error::CompileError;
use crate::graph::{EntityRoles, Graph, Inputs, TeamRoles};
use crate::graph_inputs::Rows;
use crate::inspect::{OnnxFacts, inspect_onnx};
use crate::matching::match_agent;
use crate::observations::{random_entities, random_observations_of, random_team_queries_of};
use crate::proposals::{ProposalFiles, compile_proposals};
use crate::tract_entities::TractEntities;
use crate::tract_policy::TractPolicy;
use crate::tract_team_value::TractTeamValue;

/// What the process may use. Agents' networks need about a tenth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProcessLimits {
    /// Address space in MiB.
    pub memory_mib: u32,
    /// Seconds of processor time.
    pub processor_s: u32,
}

impl Default for ProcessLimits {
    fn default() -> Self {
        Self { memory_mib: 2048, processor_s: 60 }
    }
}

/// How a process ended that gave no answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum Ending {
    /// It asked for more memory than it may have.
    Memory {
        /// The limit in MiB.
        limit_mib: u32,
    },
    /// It used its processor time up.
    Time {
        /// The limit in seconds.
        limit_s: u32,
    },
    /// Its stack overflowed.
    Stack,
    /// A signal ended it.
    Signal(i32),
    /// It ended by itself with this code; 101 is a panic.
    Code(i32),
}

impl fmt::Display for Ending {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Memory { limit_mib } => write!(f, "it takes more than {limit_mib} MiB of memory"),
            Self::Time { limit_s } => write!(f, "it takes more than {limit_s} s of processor time"),
            Self::Stack => write!(f, "its parts are nested too deeply"),
            Self::Signal(signal) => write!(f, "signal {signal} ended the process that read it"),
            Self::Code(code) => write!(f, "the process that read it ended with code {code}"),
        }
    }
}

/// What the process is asked for; the ONNX file follows.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
enum Request {
    Compile(CompileOptions),
    CompileProposals(CompileOptions),
    Rehearse { n_max: usize, features: Option<usize> },
    Inspect,
}

/// Starts a process for every ONNX file that is to be read.
///
/// ```no_run
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use sortie_compiler::{CompileOptions, CompilerProcess, answer_compiler};
///
/// if std::env::args().nth(1).as_deref() == Some("compiler") {
///     return Ok(answer_compiler()?);
/// }
/// let compiler = CompilerProcess::new(std::env::current_exe()?, ["compiler"]);
/// let compiled = compiler.compile(&std::fs::read("agent.onnx")?, &CompileOptions::default())?;
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct CompilerProcess {
    program: PathBuf,
    arguments: Vec<OsString>,
    limits: ProcessLimits,
}

impl CompilerProcess {
    /// A program that calls [`answer_compiler`] when it is started with these arguments.
    pub fn new<A: Into<OsString>>(
        program: impl Into<PathBuf>,
        arguments: impl IntoIterator<Item = A>,
    ) -> Self {
        let arguments = arguments.into_iter().map(Into::into).collect();
        Self { program: program.into(), arguments, limits: ProcessLimits::default() }
    }

    /// The same with other limits.
    pub fn with_limits(self, limits: ProcessLimits) -> Self {
        Self { limits, ..self }
    }

    /// As [`compile`].
    pub fn compile(&self, onnx: &[u8], options: &CompileOptions) -> Result<Compiled, CompileError> {
        self.ask(Request::Compile(*options), onnx)
    }

    /// As [`compile_proposals`].
    pub fn compile_proposals(
        &self,
        files: &ProposalFiles<'_>,
        options: &CompileOptions,
    ) -> Result<Compiled, CompileError> {
        self.ask(Request::CompileProposals(*options), &files.joined())
    }

    /// As [`crate::compile_bundle_as`]. A plan that was compiled before is checked and taken without a process.
    pub fn compile_bundle(
        &self,
        bundle: &Bundle,
        profile: Profile,
    ) -> Result<AlignedBytes, CompileError> {
        agent_plan(bundle, profile, &|onnx, options| self.compile(onnx, options))
    }

    /// As [`crate::compile_allocator`].
    pub fn compile_allocator(&self, bundle: &Bundle) -> Result<Option<AlignedBytes>, CompileError> {
        allocator_plan(bundle, &|onnx, options| self.compile(onnx, options))
    }

    /// As [`crate::compile_proposals_of`].
    pub fn compile_proposals_of(
        &self,
        bundle: &Bundle,
        profile: Profile,
    ) -> Result<Option<AlignedBytes>, CompileError> {
        proposal_plan(bundle, profile, &|joined, options| {
            self.ask(Request::CompileProposals(*options), joined)
        })
    }

    /// Reads a file and runs its graph a few times on `n_max` random entities of `features`, none for all columns.
    ///
    /// What went well there goes well here: this process may then run the graph itself.
    pub fn rehearse(
        &self,
        onnx: &[u8],
        n_max: usize,
        features: Option<usize>,
    ) -> Result<(), CompileError> {
        self.ask(Request::Rehearse { n_max, features }, onnx)
    }

    /// As [`inspect_onnx`].
    pub fn inspect_onnx(&self, onnx: &[u8]) -> Result<OnnxFacts, CompileError> {
        self.ask(Request::Inspect, onnx)
    }

    fn ask<T: DeserializeOwned>(&self, request: Request, onnx: &[u8]) -> Result<T, CompileError> {
        let output = self.exchange(request, onnx).map_err(|error| CompileError::NoProcess {
            reason: format!("`{}`: {error}", self.program.display()),
        })?;
        let answered = output.status.success();
        let answer = answered.then(|| postcard::from_bytes(&output.stdout).ok()).flatten();
        answer.unwrap_or_else(|| Err(self.given_up(&output)))
    }

    fn exchange(&self, request: Request, onnx: &[u8]) -> io::Result<Output> {
        let mut command = Command::new(&self.program);
        command.args(&self.arguments).stdin(Stdio::piped());
        let mut process = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn()?;
        let request = postcard::to_stdvec(&request).map_err(io::Error::other)?;
        if let Some(mut input) = process.stdin.take() {
            let limits = self.limits.to_bytes();
            let parts = [limits.as_slice(), &request, onnx];
            // Where the process ended early, its status says more than a broken pipe.
            let _ = parts.into_iter().try_for_each(|part| input.write_all(part));
        }
        process.wait_with_output()
    }

    fn given_up(&self, output: &Output) -> CompileError {
        const SHOWN: usize = 200;
        let said = String::from_utf8_lossy(&output.stderr);
        let ending = self.ending(output.status, &said);
        let words = said.split_whitespace().collect::<Vec<_>>().join(" ");
        CompileError::GivenUp { ending, said: words.chars().take(SHOWN).collect() }
    }

    fn ending(&self, status: ExitStatus, said: &str) -> Ending {
        const ABORT: i32 = 6;
        const PROCESSOR_TIME: i32 = 24;
        let ProcessLimits { memory_mib, processor_s } = self.limits;
        match status.signal() {
            // The standard library's words, which come with an abort.
            Some(ABORT) if said.contains("memory allocation of") => {
                Ending::Memory { limit_mib: memory_mib }
            }
            Some(ABORT) if said.contains("has overflowed its stack") => Ending::Stack,
            Some(PROCESSOR_TIME) => Ending::Time { limit_s: processor_s },
            Some(signal) => Ending::Signal(signal),
            None => Ending::Code(status.code().unwrap_or_default()),
        }
    }
}

impl ProcessLimits {
    const BYTES: usize = 8;

    fn to_bytes(self) -> [u8; Self::BYTES] {
        let words = u64::from(self.memory_mib) << 32 | u64::from(self.processor_s);
        words.to_le_bytes()
    }

    fn from_bytes(bytes: [u8; Self::BYTES]) -> Self {
        let words = u64::from_le_bytes(bytes);
        Self { memory_mib: (words >> 32) as u32, processor_s: words as u32 }
    }

    /// Limits this process, and leaves no core file behind when it ends.
    fn apply(self) -> io::Result<()> {
        let Self { memory_mib, processor_s } = self;
        limit(Resource::As, u64::from(memory_mib) << 20)?;
        limit(Resource::Cpu, u64::from(processor_s))?;
        limit(Resource::Core, 0)
    }
}

/// Lowers a limit; one that is lower already stays.
fn limit(resource: Resource, most: u64) -> io::Result<()> {
    let Rlimit { current, maximum } = getrlimit(resource);
    let lowest = |limit: Option<u64>| Some(limit.map_or(most, |limit| limit.min(most)));
    setrlimit(resource, Rlimit { current: lowest(current), maximum })?;
    Ok(())
}

/// What a program does that was started by a [`CompilerProcess`]: reads one request from standard input and
/// writes the answer to standard output.
///
/// Fails where the request cannot be read, or the limits not be set.
pub fn answer_compiler() -> io::Result<()> {
    let mut input = io::stdin().lock();
    let mut limits = [0; ProcessLimits::BYTES];
    input.read_exact(&mut limits)?;
    ProcessLimits::from_bytes(limits).apply()?;
    let mut given = Vec::new();
    input.read_to_end(&mut given)?;
    let (request, onnx) = postcard::take_from_bytes(&given).map_err(io::Error::other)?;
    let answer = match request {
        Request::Compile(options) => postcard::to_stdvec(&compile(onnx, &options)),
        Request::CompileProposals(options) => postcard::to_stdvec(
            &ProposalFiles::split(onnx).and_then(|files| compile_proposals(&files, &options)),
        ),
        Request::Rehearse { n_max, features } => {
            postcard::to_stdvec(&rehearse(onnx, n_max, features))
        }
        Request::Inspect => postcard::to_stdvec(&inspect_onnx(onnx)),
    };
    io::stdout().lock().write_all(&answer.map_err(io::Error::other)?)
}

/// Runs a graph on inputs of the largest size. What it computes, or refuses to, does not matter here.
fn rehearse(onnx: &[u8], n_max: usize, features: Option<usize>) -> Result<(), CompileError> {
    const RUNS: usize = 4;
    const SEED: u64 = 1;
    let graph = Graph::read(onnx)?;
    match graph.inputs {
        Inputs::Agent(roles) => {
            let features = features.unwrap_or(graph.columns);
            // Whoever looks at attention matches the layers as well.
            let _ = match_agent(&graph);
            let mut engine = TractPolicy::from_graph(&graph, features)?;
            let mut state = vec![0.0; roles.memory.map_or(0, |memory| memory.size)];
            let mut utilities = vec![0.0; graph.actions];
            for seen in random_observations_of(RUNS, n_max, features, graph.actions, SEED) {
                let _ = engine.step(&seen.view(), Rows::All, &mut state, &mut utilities);
            }
        }
        Inputs::TeamValue(TeamRoles { features, relations, .. }) => {
            let mut engine = TractTeamValue::from_graph(&graph)?;
            for query in random_team_queries_of(RUNS, n_max, features, relations, SEED) {
                let state = query.state.view();
                let _ = engine.run(&query.view(&state), Rows::All);
            }
        }
        // No part runs by itself.
        Inputs::Proposals(_) => {
            graph.runnable()?;
        }
        Inputs::Entities(EntityRoles { group_count, .. }) => {
            let mut engine = TractEntities::from_graph(&graph)?;
            for step in random_entities(RUNS, n_max, graph.columns, group_count, SEED) {
                let _ = engine.run(&step.view());
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ends(command: &str) -> CompileError {
        let process = CompilerProcess::new("/bin/sh", ["-c", command]);
        process.inspect_onnx(&[0; 1 << 20]).unwrap_err()
    }

    #[test]
    fn an_end_without_an_answer_is_told_with_its_reason() {
        let ended = |command: &str, ending| {
            let error = ends(command);
            assert!(error.to_string().starts_with("reading the ONNX file was given up, because "));
            assert!(
                matches!(error, CompileError::GivenUp { ending: got, .. } if got == ending),
                "{error}"
            );
        };
        ended("exit 3", Ending::Code(3));
        ended("kill -9 $$", Ending::Signal(9));
        ended("kill -24 $$", Ending::Time { limit_s: 60 });
        ended(
            "echo memory allocation of 9 bytes failed >&2; kill -6 $$",
            Ending::Memory { limit_mib: 2048 },
        );
        ended("echo 'thread main has overflowed its stack' >&2; kill -6 $$", Ending::Stack);
        // An end in good order with what is no answer.
        ended("cat >/dev/null; echo no", Ending::Code(0));
    }

    #[test]
    fn a_program_that_does_not_exist_is_named() {
        let process = CompilerProcess::new("/nowhere/compiler", ["compiler"]);
        let error = process.inspect_onnx(&[]).unwrap_err().to_string();
        assert!(error.contains("`/nowhere/compiler`"), "{error}");
    }

    #[test]
    fn errors_cross_the_process_boundary_as_they_are() {
        let error = inspect_onnx(b"no network").map(|_| ()).unwrap_err();
        let bytes = postcard::to_stdvec(&error).unwrap();
        let crossed: CompileError = postcard::from_bytes(&bytes).unwrap();
        assert_eq!(format!("{error:?}"), format!("{crossed:?}"));
    }
}
