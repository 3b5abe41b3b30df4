//! Updates and replay buffers that have been through their largest batch, and are full, allocate nothing.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use sortie_envs::{Split, Step};
use sortie_learn::Transition;
use sortie_learn::learner::{Learner, Loss, Rules};
use sortie_learn::trajectory::{Capacity, Trajectories, Widths};
use sortie_nn::layers::SparseRows;
use sortie_nn::random::stream;
use sortie_nn::tape::Parameters;

/// Counts what the calling thread allocates.
struct Counting;

thread_local! {
    static COUNT: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: everything is done by the system's allocator.
#[expect(unsafe_code, reason = "an allocator is unsafe to implement")]
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        COUNT.set(COUNT.get() + 1);
        // SAFETY: the caller's promise is the same.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise is the same.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

fn allocations(work: impl FnOnce()) -> usize {
    let before = COUNT.get();
    work();
    COUNT.get() - before
}

/// Without products of matrices, whose kernels pack what they multiply.
#[test]
fn a_warm_learner_allocates_nothing() {
    let mut parameters = Parameters::default();
    let layer = parameters.sparse_linear("layer", [4, 3], 2.0, &mut stream(1, 1, 0));
    let mut learner: Learner<SparseRows> = Learner::new(parameters, Rules::default(), 1);
    let mut update = |shards: usize| {
        learner.update(shards, 1e-3, |shard| {
            shard.space.clear();
            for row in 0..8 {
                shard.space.push((row + shard.number) % 4, 1.0);
                shard.space.end_row();
            }
            let mut values = shard.spare.begin(shard.target);
            let worth = values.sparse_linear(shard.space, layer);
            let y = shard.pass.sparse_linear(shard.space, layer);
            let y = shard.pass.elu(y);
            let targets = values.values(worth);
            Loss::of(&mut shard.pass, |pass| pass.squared_error(y, targets, 0.1))
        });
    };
    assert!(allocations(|| update(3)) > 0);
    update(3);
    for shards in [3, 1, 2, 3] {
        assert_eq!(allocations(|| update(shards)), 0);
    }
}

#[test]
fn a_full_replay_buffer_allocates_nothing() {
    let ring = sortie_envs::open("group-matching/3x6x1", Split::Train, 1, &Default::default());
    let ring = ring.expect("an environment");
    let widths = Widths { agents: 3, tasks: 1, earners: 3 };
    for capacity in [Capacity::States(700), Capacity::Episodes(20)] {
        let mut replay = Trajectories::new(capacity, 2, widths);
        let (mut random, mut drawn) = (stream(1, 1, 0), Vec::new());
        let mut play = |steps: usize| {
            for step in 0..steps {
                replay.push(&Transition {
                    environment: &*ring,
                    instance: step % 2,
                    state: &[1; 40],
                    actions: &[1; 3],
                    step: Step { terminated: step / 2 % 30 == 29, ..Step::default() },
                    task_rewards: &[1.0],
                    agent_rewards: &[1.0; 3],
                    next: &[1; 40],
                });
            }
            replay.draw(3, &mut random);
            replay.draw_episodes(replay.episodes().min(5), &mut random, &mut drawn);
        };
        play(10_000);
        assert_eq!(allocations(|| play(10_000)), 0, "{capacity:?}");
    }
}
