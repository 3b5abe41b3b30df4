//! ONNX files read by another process, whose memory and time are limited.
//!
//! What parses ONNX files takes sizes from them: a damaged file can make it allocate without bound, loop, or
//! overflow its stack, which no process survives. [`CompilerProcess`] starts a program for each file, which calls
//! [`read_request`]: it limits itself, and reads what to do and the file from standard input. It writes its
//! answer to standard output; what it says beside that is kept out of sight.

use std::ffi::OsString;
use std::io::{self, Read, Write};
use std::os::unix::process::ExitStatusExt;
use std::path::PathBuf;
use std::process::{Child, Command, ExitStatus, Output, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, OnceLock};
use std::thread;
use std::time::Duration;

use rustix::process::{
    Pid, PidfdFlags, Resource, Rlimit, Signal, getrlimit, pidfd_open, pidfd_send_signal, setrlimit,
};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use sortie_attention::AttentionLayers;
use sortie_bundle::Recording;

use crate::bundle_plans::Compiler;
use crate::error::{CompileError, Ending};
use crate::facts::{InspectedOnnx, OnnxFacts};
use crate::policy::{PolicyFacts, PolicyOptions};
use crate::policy_plan::{CompiledPolicy, ProofCase};
use crate::report::{CompileOptions, Compiled, ProposalFiles};

/// What the process may use. Agents' networks need about a tenth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProcessLimits {
    /// Address space in MiB.
    pub memory_mib: u32,
    /// Seconds of processor time.
    pub processor_s: u32,
    /// Seconds until it is ended, whatever it does.
    pub wall_s: u32,
}

impl Default for ProcessLimits {
    fn default() -> Self {
        Self { memory_mib: 2048, processor_s: 60, wall_s: 600 }
    }
}

/// What the process is asked for; the ONNX file follows.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub enum Request {
    /// A plan of one network.
    Compile(CompileOptions),
    /// An int8 plan of one network, rounded for observations: the bytes of a recording.
    CompileRounded(CompileOptions, Vec<u8>),
    /// A plan of three, [`ProposalFiles::joined`].
    CompileProposals(CompileOptions),
    /// A plan of a policy.
    CompilePolicy(PolicyOptions, CompileOptions),
    /// The same, proved on what was recorded too.
    CompileRecordedPolicy(PolicyOptions, CompileOptions, Vec<ProofCase>),
    /// A few runs of the graph.
    Rehearse {
        /// Entities of each run.
        n_max: usize,
        /// Features of an entity; none for all columns.
        features: Option<usize>,
    },
    /// A few runs of a policy.
    RehearsePolicy(PolicyOptions),
    /// The file's facts.
    Inspect(PolicyOptions),
    /// The layers that give an agent's attention.
    Attention,
}

/// Starts a process for every ONNX file that is to be read.
///
/// ```no_run
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use sortie_plans::{CompileOptions, Compiler, CompilerProcess};
///
/// let compiler = CompilerProcess::new("target/release/sortie-tools", ["compiler"]);
/// let compiled = compiler.compile(&std::fs::read("agent.onnx")?, &CompileOptions::default())?;
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct CompilerProcess {
    program: PathBuf,
    arguments: Vec<OsString>,
    version: Option<&'static str>,
    /// Whether the program is of that version: asked once, for all clones.
    checked: Arc<OnceLock<()>>,
    limits: ProcessLimits,
}

impl Compiler for CompilerProcess {
    fn compile(&self, onnx: &[u8], options: &CompileOptions) -> Result<Compiled, CompileError> {
        self.ask(Request::Compile(*options), onnx)
    }

    fn compile_rounded(
        &self,
        onnx: &[u8],
        options: &CompileOptions,
        examples: &Recording,
    ) -> Result<Compiled, CompileError> {
        self.ask(Request::CompileRounded(*options, examples.to_bytes()), onnx)
    }

    fn compile_proposals(
        &self,
        files: &ProposalFiles<'_>,
        options: &CompileOptions,
    ) -> Result<Compiled, CompileError> {
        self.ask(Request::CompileProposals(*options), &files.joined())
    }

    fn compile_policy(
        &self,
        onnx: &[u8],
        policy: &PolicyOptions,
        options: &CompileOptions,
    ) -> Result<CompiledPolicy, CompileError> {
        self.compile_policy(onnx, policy, options)
    }
}

impl CompilerProcess {
    /// A program that answers a [`Request`] when it is started with these arguments.
    pub fn new<A: Into<OsString>>(
        program: impl Into<PathBuf>,
        arguments: impl IntoIterator<Item = A>,
    ) -> Self {
        Self {
            program: program.into(),
            arguments: arguments.into_iter().map(Into::into).collect(),
            version: None,
            checked: Arc::default(),
            limits: ProcessLimits::default(),
        }
    }

    /// The same, refused where the program is of another version than this: both speak a language of their own.
    pub fn of_version(self, version: &'static str) -> Self {
        Self { version: Some(version), checked: Arc::default(), ..self }
    }

    /// The same with other limits.
    pub fn with_limits(self, limits: ProcessLimits) -> Self {
        Self { limits, ..self }
    }

    /// Has a file read and its graph run a few times on `n_max` random entities of `features`, none for all columns.
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

    /// The plan of a policy whoever exported it.
    ///
    /// # Errors
    /// The file cannot be read, more must be said about it, a node has no step, or plan and graph differ.
    pub fn compile_policy(
        &self,
        onnx: &[u8],
        policy: &PolicyOptions,
        options: &CompileOptions,
    ) -> Result<CompiledPolicy, CompileError> {
        self.ask(Request::CompilePolicy(policy.clone(), *options), onnx)
    }

    /// The same; a quarter of the inputs of its proof are recorded ones.
    ///
    /// # Errors
    /// As [`Self::compile_policy`].
    pub fn compile_recorded_policy(
        &self,
        onnx: &[u8],
        policy: &PolicyOptions,
        options: &CompileOptions,
        recorded: Vec<ProofCase>,
    ) -> Result<CompiledPolicy, CompileError> {
        self.ask(Request::CompileRecordedPolicy(policy.clone(), *options, recorded), onnx)
    }

    /// The facts of an ONNX file, whether or not it can be compiled.
    pub fn inspect_onnx(&self, onnx: &[u8]) -> Result<OnnxFacts, CompileError> {
        self.inspect(onnx, &PolicyOptions::default()).map(|inspected| inspected.facts)
    }

    /// The facts of an ONNX file, and of the policy that it is if it is no network that plans are made of.
    pub fn inspect(
        &self,
        onnx: &[u8],
        options: &PolicyOptions,
    ) -> Result<InspectedOnnx, CompileError> {
        self.ask(Request::Inspect(options.clone()), onnx)
    }

    /// Has a policy read and run a few times, as [`Self::rehearse`] has a network.
    pub fn rehearse_policy(
        &self,
        onnx: &[u8],
        options: &PolicyOptions,
    ) -> Result<PolicyFacts, CompileError> {
        self.ask(Request::RehearsePolicy(options.clone()), onnx)
    }

    /// The layers that give the attention of an agent's network.
    pub fn attention(&self, onnx: &[u8]) -> Result<AttentionLayers, CompileError> {
        self.ask(Request::Attention, onnx)
    }

    /// Refuses a program that is missing, or says with `--version` that it is of another version than
    /// [`Self::of_version`] asks for. Every request does so first; what was good once is not asked again.
    pub fn check_version(&self) -> Result<(), CompileError> {
        let Some(want) = self.version.filter(|_| self.checked.get().is_none()) else {
            return Ok(());
        };
        let program = || self.program.clone();
        let said = Command::new(&self.program).arg("--version").stdin(Stdio::null()).output();
        let said = said.map_err(|error| CompileError::not_started(program(), &error))?;
        let said = String::from_utf8_lossy(&said.stdout);
        let got = said.lines().next().unwrap_or_default().trim_start_matches("sortie ").trim();
        if got != want {
            let (got, want) = (got.to_owned(), want.to_owned());
            return Err(CompileError::OtherVersion { program: program(), got, want });
        }
        let _ = self.checked.set(());
        Ok(())
    }

    fn ask<T: DeserializeOwned>(&self, request: Request, onnx: &[u8]) -> Result<T, CompileError> {
        self.check_version()?;
        let answered = self.exchange(request, onnx);
        let not_started = |error| CompileError::not_started(self.program.clone(), &error);
        let Answered { output, in_time } = answered.map_err(not_started)?;
        if !in_time {
            let ending = Ending::Silent { limit_s: self.limits.wall_s };
            return Err(CompileError::GivenUp { ending, said: String::new() });
        }
        let answered = output.status.success();
        let answer = answered.then(|| postcard::from_bytes(&output.stdout).ok()).flatten();
        answer.unwrap_or_else(|| Err(self.given_up(&output)))
    }

    fn exchange(&self, request: Request, onnx: &[u8]) -> io::Result<Answered> {
        let mut command = Command::new(&self.program);
        command.args(&self.arguments).stdin(Stdio::piped());
        let mut process = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn()?;
        let request = postcard::to_stdvec(&request).map_err(io::Error::other)?;
        let watch = Watch::over(&process, Duration::from_secs(self.limits.wall_s.into()))?;
        if let Some(mut input) = process.stdin.take() {
            let limits = self.limits.to_bytes();
            let parts = [limits.as_slice(), &request, onnx];
            // Where the process ended early, its status says more than a broken pipe.
            let _ = parts.into_iter().try_for_each(|part| input.write_all(part));
        }
        let output = process.wait_with_output()?;
        Ok(Answered { output, in_time: watch.ended_in_time() })
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
        let ProcessLimits { memory_mib, processor_s, .. } = self.limits;
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

/// What a process said, and whether it ended before its time was over.
struct Answered {
    output: Output,
    in_time: bool,
}

/// Ends a process that takes too long.
struct Watch {
    ended: mpsc::Sender<()>,
    thread: thread::JoinHandle<bool>,
}

impl Watch {
    fn over(process: &Child, limit: Duration) -> io::Result<Self> {
        let pid = i32::try_from(process.id()).ok().and_then(Pid::from_raw);
        let pid = pid.ok_or_else(|| io::Error::other("the process has no number"))?;
        // A descriptor stays this process, even where the number is given to another.
        let process = pidfd_open(pid, PidfdFlags::empty())?;
        let (ended, ending) = mpsc::channel();
        let watch = move || {
            let in_time = ending.recv_timeout(limit) != Err(RecvTimeoutError::Timeout);
            if !in_time {
                let _ = pidfd_send_signal(&process, Signal::KILL);
            }
            in_time
        };
        Ok(Self { ended, thread: thread::Builder::new().spawn(watch)? })
    }

    fn ended_in_time(self) -> bool {
        drop(self.ended);
        self.thread.join().unwrap_or(true)
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
        Self { memory_mib: (words >> 32) as u32, processor_s: words as u32, ..Self::default() }
    }

    /// Limits this process, and leaves no core file behind when it ends.
    fn apply(self) -> io::Result<()> {
        let Self { memory_mib, processor_s, .. } = self;
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

/// What a program does first that was started by a [`CompilerProcess`]: it limits itself, and reads the request and the
/// file from standard input.
///
/// # Errors
/// The request cannot be read, or the limits not be set.
pub fn read_request() -> io::Result<(Request, Vec<u8>)> {
    let mut input = io::stdin().lock();
    let mut limits = [0; ProcessLimits::BYTES];
    input.read_exact(&mut limits)?;
    ProcessLimits::from_bytes(limits).apply()?;
    let mut given = Vec::new();
    input.read_to_end(&mut given)?;
    let (request, onnx) = postcard::take_from_bytes(&given).map_err(io::Error::other)?;
    Ok((request, onnx.to_vec()))
}

#[cfg(test)]
mod tests {
    use std::fs::Permissions;
    use std::os::unix::fs::PermissionsExt;

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
        assert!(error.contains("/nowhere/compiler"), "{error}");
    }

    #[test]
    fn a_program_is_asked_for_its_version_once() {
        let folder = tempfile::tempdir().unwrap();
        let (program, asked) = (folder.path().join("program"), folder.path().join("asked"));
        let script = |version: &str| {
            let count = format!("[ \"$1\" = --version ] && echo >>{}", asked.display());
            let script = format!("#!/bin/sh\n{count}\necho sortie {version}\n");
            std::fs::write(&program, script).unwrap();
            std::fs::set_permissions(&program, Permissions::from_mode(0o700)).unwrap();
        };
        let times = || std::fs::read_to_string(&asked).unwrap().lines().count();
        let process = CompilerProcess::new(&program, ["compiler"]).of_version("1.2.3");
        script("1.2.2");
        for expected in 1..=2 {
            let refused = process.inspect_onnx(&[]).unwrap_err();
            assert!(matches!(refused, CompileError::OtherVersion { .. }), "{refused}");
            assert_eq!(times(), expected);
        }
        script("1.2.3");
        for _ in 0..3 {
            let answered = process.clone().inspect_onnx(&[]).unwrap_err();
            assert!(matches!(answered, CompileError::GivenUp { .. }), "{answered}");
            assert_eq!(times(), 3);
        }
    }

    #[test]
    fn a_process_that_only_sleeps_is_ended() {
        let process = CompilerProcess::new("/bin/sh", ["-c", "exec sleep 600"]);
        let limits = ProcessLimits { wall_s: 1, ..ProcessLimits::default() };
        let error = process.with_limits(limits).inspect_onnx(&[0; 1 << 20]).unwrap_err();
        let ending = Ending::Silent { limit_s: 1 };
        assert!(matches!(error, CompileError::GivenUp { ending: got, .. } if got == ending));
    }
}
