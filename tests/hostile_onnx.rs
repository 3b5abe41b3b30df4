//! Damaged ONNX files: compiled or refused with a reason, never a panic.
//!
//! Seeded changes to good files, a few thousand of them; `SORTIE_FUZZ_SECONDS` goes on with further seeds for as long.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};

use rand_core::{Rng, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use sortie_compiler::{CompileOptions, compile};

/// Seeds that every run tries.
const SEEDS: u64 = 20;

const FILES: [(&str, &[u8]); 4] = [
    ("agent_eight_heads", include_bytes!("../../../tests/golden/onnx/agent_eight_heads.onnx")),
    ("agent_small", include_bytes!("../../../tests/golden/onnx/agent_small.onnx")),
    ("agent_odd_sizes", include_bytes!("../../../tests/golden/onnx/agent_odd_sizes.onnx")),
    ("team_value_small", include_bytes!("../../../tests/golden/onnx/team_value_small.onnx")),
];

/// Inputs that once got through to a panic.
const FOUND: [&[u8]; 1] = [b""];

fn below(rng: &mut Xoshiro256PlusPlus, bound: usize) -> usize {
    rng.next_u32() as usize % bound.max(1)
}

/// One to four changes: a byte, a bit, a cut, a hole, a repetition.
fn damaged(rng: &mut Xoshiro256PlusPlus, good: &[u8]) -> Vec<u8> {
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

/// Whether the compiler answered; what it answered does not matter.
fn answers(onnx: &[u8]) -> bool {
    let options = CompileOptions { n_max: 4, inputs: 4, ..CompileOptions::default() };
    let answer = catch_unwind(AssertUnwindSafe(|| {
        compile(onnx, &options).map_err(|error| assert!(!error.to_string().is_empty())).is_ok()
    }));
    answer.is_ok()
}

#[test]
fn damaged_files_never_panic() {
    let seconds = std::env::var("SORTIE_FUZZ_SECONDS").ok();
    let seconds = seconds.map_or(0, |seconds| seconds.parse().expect("a number of seconds"));
    let end = Instant::now() + Duration::from_secs(seconds);
    let mut escaped = Vec::new();
    let mut seed = 0;
    while seed < SEEDS || Instant::now() < end {
        let mut rng = Xoshiro256PlusPlus::seed_from_u64(seed);
        let (name, good) = FILES[below(&mut rng, FILES.len())];
        if !answers(&damaged(&mut rng, good)) {
            escaped.push(format!("{name} with seed {seed}"));
        }
        seed += 1;
    }
    println!("{seed} files");
    assert!(escaped.is_empty(), "{} panics of {seed} files: {escaped:?}", escaped.len());
}

#[test]
fn what_was_found_stays_found() {
    assert!(FOUND.iter().all(|onnx| answers(onnx)));
}
