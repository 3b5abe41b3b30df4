//! Decides in a loop on made-up observations: for instruction counts and quick timings of a plan.
//!
//! `cargo run --release -p sortie-core --features std --example decide -- agent.plan 11 1000 avx2 5`: a plan, visible
//! entities, calls, a build of the kernels, and agents that decide in one call.
#![allow(clippy::print_stdout, reason = "a program of its own")]

use std::time::Instant;

use sortie_core::internal::kernels::build::Build;
use sortie_core::plan::{AlignedBytes, Plan};
use sortie_core::{DecideError, EntityMask, Observation};

/// Different frames, so that branches cannot be learned by heart.
const FRAMES: usize = 64;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let mut next = |name: &str| arguments.next().ok_or_else(|| format!("{name} is missing"));
    let bytes = AlignedBytes::copy_of(&std::fs::read(next("PLAN")?)?);
    let (visible, calls) = (next("VISIBLE")?.parse::<usize>()?, next("CALLS")?.parse::<usize>()?);
    let name = next("BUILD")?;
    let agents = next("AGENTS").map_or(Ok(1), |count| count.parse::<usize>())?;
    let build = Build::all().find(|build| build.name() == name).ok_or("no such build")?;
    let plan = Plan::load(bytes.as_slice())?.on(build);
    let mut arena = AlignedBytes::zeroed(plan.batch_arena_bytes(agents));
    let header = *plan.header();
    let (stride, entities) = (header.features as usize, header.n_max as usize);
    let frames = rows(FRAMES * entities * stride);
    let actions: Vec<u16> = (0..entities.div_ceil(2)).map(|agent| (agent % 8) as u16).collect();
    let available = vec![1; plan.actions()];
    let mut utilities = vec![0.0; agents * plan.actions()];
    let mut results = vec![Err(DecideError::BadLength); agents];
    let mut hash = 0_u64;
    let mut nanoseconds = Vec::with_capacity(calls);
    for call in 0..calls {
        let frame = frames.chunks(entities * stride).nth(call % FRAMES).unwrap_or(&[]);
        let see = |agent: usize| Observation {
            rows: frame,
            stride,
            last_actions: &actions,
            visible: EntityMask::first(visible),
            self_index: (call + agent) % visible.max(1),
            available: &available,
        };
        let seen: Vec<Observation<'_>> = (0..agents).map(see).collect();
        let started = Instant::now();
        if agents == 1 {
            plan.utilities(arena.as_mut_slice(), &seen[0], None, &mut utilities)?;
        } else {
            plan.utilities_batch(arena.as_mut_slice(), &seen, &mut utilities, &mut results);
            results.iter().try_for_each(|result| *result)?;
        }
        nanoseconds.push(started.elapsed().as_nanos());
        for utility in &utilities {
            hash = hash.wrapping_mul(31).wrapping_add(u64::from(utility.to_bits()));
        }
    }
    nanoseconds.sort_unstable();
    let share = |tenths: usize| nanoseconds.get(calls * tenths / 10).copied().unwrap_or(0);
    println!("{} ns a call, tenth percentile {}, bits {hash:016x}", share(5), share(1));
    Ok(())
}

/// Features of which about one in six is not zero, as in recorded observations.
fn rows(count: usize) -> Vec<f32> {
    let mut state = 1_u64;
    let mut below = move |bound: u64| {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) % bound
    };
    (0..count).map(|_| if below(6) == 0 { below(1000) as f32 / 1000.0 } else { 0.0 }).collect()
}
