//! Damaged ONNX files: compiled or refused with a reason, whatever they do to the process that reads them.
//!
//! Seeded changes to good files; `SORTIE_FUZZ_SECONDS` goes on with further seeds for as long. The counts by
//! kind of answer are printed, and files that end a process are kept where `SORTIE_FUZZ_KEEP` says.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};
use std::{fs, thread};

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use sortie_compiler::compile;
use sortie_plans::{
    CompileError, CompileOptions, Compiler, CompilerProcess, Ending, PolicyOptions, ProcessLimits,
};

/// Changes to every file that each run of the tests tries.
const SEEDS: u64 = 120;

/// The same for every policy that others exported.
const POLICY_SEEDS: u64 = 40;

const FILES: [&str; 7] = [
    "agent_small",
    "agent_odd_sizes",
    "agent_eight_heads",
    "agent_one_head",
    "agent_gru_small",
    "team_value_small",
    "entities_odd_sizes",
];

/// A `Range` of 10^9 numbers, in 241 bytes: 4 GB, and again for whatever reads it.
const ALLOCATES: &str = "tests/hostile/allocates.onnx";

/// Less than users get: a file that hits a limit should do so soon.
const LIMITS: ProcessLimits = ProcessLimits { memory_mib: 512, processor_s: 5, wall_s: 600 };

/// The program whose processes read the files.
const PROGRAM: &str = env!("CARGO_BIN_EXE_sortie-tools");

fn compiler() -> CompilerProcess {
    CompilerProcess::new(PROGRAM, ["compiler"]).with_limits(LIMITS)
}

fn options() -> CompileOptions {
    CompileOptions { n_max: 4, inputs: 4, ..CompileOptions::default() }
}

fn read(path: impl AsRef<Path>) -> Vec<u8> {
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."));
    fs::read(root.join(path)).expect("the file is in the tree")
}

fn below(rng: &mut Xoshiro256PlusPlus, bound: usize) -> usize {
    rng.next_u32() as usize % bound.max(1)
}

/// One to four changes: a byte, a bit, a cut, a hole, a repetition.
fn damaged(seed: u64, good: &[u8]) -> Vec<u8> {
    let rng = &mut Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut bytes = good.to_vec();
    for _ in 0..=below(rng, 4) {
        let at = below(rng, bytes.len());
        let end = (at + 1 + below(rng, 24)).min(bytes.len());
        match below(rng, 8) {
            0 => bytes.truncate(at),
            1 => drop(bytes.drain(at..end)),
            2 => {
                let piece = bytes[at..end].to_vec();
                let to = below(rng, bytes.len());
                drop(bytes.splice(to..to, piece));
            }
            3..=4 => bytes[at] ^= 1 << below(rng, 8),
            5 => bytes[at] = [0, 1, 2, 0x7F, 0x80, 0xFF][below(rng, 6)],
            _ => bytes[at] = rng.next_u32() as u8,
        }
        if bytes.is_empty() {
            break;
        }
    }
    bytes
}

/// What became of a file, in a word.
fn kind(error: Option<&CompileError>) -> String {
    let text = match error {
        None => "Compiled".to_owned(),
        Some(CompileError::GivenUp { ending, .. }) => format!("{ending:?}"),
        Some(CompileError::Unreadable { reason }) if reason.contains("failed to allocate") => {
            return "Unreadable, for lack of memory".to_owned();
        }
        Some(CompileError::Unreadable { reason }) if reason.contains("gave up") => {
            return "Unreadable, by a panic".to_owned();
        }
        Some(error) => format!("{error:?}"),
    };
    text.split(' ').next().unwrap_or_default().to_owned()
}

/// Whether the end of a process is one that its limits are for.
fn is_contained(error: &CompileError) -> bool {
    match error {
        CompileError::GivenUp { ending, .. } => {
            matches!(ending, Ending::Memory { .. } | Ending::Time { .. } | Ending::Stack)
        }
        CompileError::NoProcess { .. } => false,
        _ => true,
    }
}

#[test]
fn damaged_files_are_compiled_or_refused_with_a_reason() {
    let seconds = std::env::var("SORTIE_FUZZ_SECONDS").ok();
    let seconds = seconds.map_or(0, |seconds| seconds.parse().expect("a number of seconds"));
    let end = Instant::now() + Duration::from_secs(seconds);
    let keep = std::env::var("SORTIE_FUZZ_KEEP").ok();
    let good = FILES.map(|name| (name, read(format!("tests/golden/onnx/{name}.onnx"))));
    let (next, kinds, wrong) = (AtomicU64::new(0), Mutex::default(), Mutex::new(Vec::new()));
    let work = || {
        let (compiler, options) = (compiler(), options());
        loop {
            let count = next.fetch_add(1, Ordering::Relaxed);
            let (seed, file) = (count / FILES.len() as u64, count as usize % FILES.len());
            if seed >= SEEDS && Instant::now() >= end {
                return;
            }
            let (name, onnx) = &good[file];
            let onnx = damaged(seed, onnx);
            let error = compiler.compile(&onnx, &options).err();
            let kinds: &Mutex<BTreeMap<String, u64>> = &kinds;
            *kinds.lock().unwrap().entry(kind(error.as_ref())).or_default() += 1;
            let Some(error) = error else { continue };
            assert!(!error.to_string().is_empty());
            if let (Some(keep), CompileError::GivenUp { .. }) = (&keep, &error) {
                fs::write(format!("{keep}/{}-{name}-{seed}.onnx", kind(Some(&error))), &onnx)
                    .expect("the folder of SORTIE_FUZZ_KEEP can be written to");
            }
            if !is_contained(&error) {
                wrong.lock().unwrap().push(format!("{name} with seed {seed}: {error}"));
            }
        }
    };
    thread::scope(|scope| {
        for _ in 0..thread::available_parallelism().map_or(1, usize::from) {
            scope.spawn(work);
        }
    });
    println!("{:?}", kinds.into_inner().unwrap());
    let wrong = wrong.into_inner().unwrap();
    assert!(wrong.is_empty(), "{} files: {wrong:#?}", wrong.len());
}

#[test]
fn damaged_policies_are_run_or_refused_with_a_reason() {
    for name in ["sb3_dqn.dynamo", "sb3_maskable_ppo.classic"] {
        let good = read(format!("tests/golden/onnx-foreign/{name}.onnx"));
        for seed in 0..POLICY_SEEDS {
            let options = PolicyOptions::default();
            let Err(error) = compiler().rehearse_policy(&damaged(seed, &good), &options) else {
                continue;
            };
            assert!(is_contained(&error), "{name} with seed {seed}: {error}");
        }
    }
}

#[test]
fn a_file_that_allocates_without_bound_is_given_up() {
    let error = compiler().compile(&read(ALLOCATES), &options()).unwrap_err();
    // The parser meets the limit itself, and is the one to say so.
    assert!(matches!(error, CompileError::Unreadable { .. }), "{error}");
    let folder = tempfile::tempdir().unwrap();
    let plan = folder.path().join("hostile.plan");
    let plan = plan.display().to_string();
    for arguments in [&["compile", ALLOCATES, "--out", &plan][..], &["inspect", ALLOCATES]] {
        let mut command = Command::new(PROGRAM);
        command.current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")).args(arguments);
        let output = command.output().expect("the program starts");
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(65), "{said}");
        assert!(said.starts_with(&format!("error: {ALLOCATES}")), "{said}");
        assert_eq!(said.lines().count(), 1, "{said}");
    }
}

#[test]
fn another_process_gives_the_same_plan() {
    for name in FILES {
        let onnx = read(format!("tests/golden/onnx/{name}.onnx"));
        let ours = compile(&onnx, &options()).unwrap();
        let theirs = compiler().compile(&onnx, &options()).unwrap();
        assert!(ours.bytes == theirs.bytes && ours.report == theirs.report, "{name}");
        compiler().rehearse(&onnx, 4, None).unwrap();
    }
}
