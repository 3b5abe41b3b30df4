//! Once connections are made, a tick by doorbell does not call the kernel, as long as nobody sleeps,
//! nor the heap: shown over shared memory by a counting allocator, and by the kernel itself, which
//! turns the system calls of a thread into signals.
#![cfg(all(target_os = "linux", target_arch = "x86_64"))]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::atomic::{AtomicU8, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use rustix::thread::{disable_syscall_user_dispatch, enable_syscall_user_dispatch};
use sortie_core::plan::{Guards, Plan};
use sortie_core::roles::{
    AllocatorOptions, AllocatorRole, Identity, Poll, RunnerOptions, RunnerRole, TickReport,
    WorldObserver, WorldOptions, WorldRole,
};
use sortie_core::wire::{ControlStatus, FrameMut};
use sortie_core::{
    AllocateError, AllocationState, Allocator, DecideError, Decision, EntityMask, Observation,
    Policy, Shape, StepOutcome, UnavailableAction, World,
};
use sortie_ipc::{
    BellKind, ClientSettings, ControlRx, Domain, DomainContract, DomainFacts, Expected, Fallback,
    IoxAgent, IoxAllocator, IoxWorld, LinkSetup, PolicyClient, PolicySchema, PolicyServer,
    RealTime, ServeSettings, Served, Stop,
};

const SHAPE: Shape = Shape { agents: 8, entities: 16, tasks: 4, actions: 14, features: 58 };
const EVERY_AGENT: u64 = 0b1111_1111;
/// Ticks in which connections are made.
const WARM_UP: usize = 200;
const TICKS: usize = 5_000;

/// The system's allocator, counting the calls of each thread.
struct Counting;

thread_local! {
    static HEAP_CALLS: Cell<usize> = const { Cell::new(0) };
}

fn count() {
    HEAP_CALLS.set(HEAP_CALLS.get() + 1);
}

// SAFETY: every call goes to the system's allocator as it came; counting touches no memory of the heap.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: as the caller promises.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        count();
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(memory, layout) }
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: as the caller promises.
        unsafe { System.realloc(memory, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// What the kernel does with the system calls of a watched thread: [`ALLOW`], or a signal.
static FILTER: AtomicU8 = AtomicU8::new(ALLOW);
const ALLOW: u8 = 0;
const BLOCK: u8 = 1;
static BLOCKED: AtomicUsize = AtomicUsize::new(0);

/// How often `work` tries to call the kernel from this thread; what it calls is not done.
fn system_calls(work: impl FnOnce()) -> usize {
    BLOCKED.store(0, Ordering::SeqCst);
    FILTER.store(BLOCK, Ordering::SeqCst);
    work();
    FILTER.store(ALLOW, Ordering::SeqCst);
    BLOCKED.load(Ordering::SeqCst)
}

/// Watches the system calls of this thread while `work` runs, which says when. One thread at a time.
fn watched(work: impl FnOnce()) {
    static TURN: Mutex<()> = Mutex::new(());
    let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    let note = || {
        BLOCKED.fetch_add(1, Ordering::SeqCst);
        // The return from the handler is a system call as well.
        FILTER.store(ALLOW, Ordering::SeqCst);
    };
    // Any region will do from which nobody calls the kernel.
    static NO_CODE: [u8; 1] = [0];
    // SAFETY: the handler accesses atomics only.
    let handler = unsafe { signal_hook::low_level::register(SIGSYS, note) }.unwrap();
    // SAFETY: the flag lives for ever; all calls are allowed for now.
    unsafe { enable_syscall_user_dispatch(&NO_CODE, &FILTER) }.unwrap();
    work();
    // SAFETY: the flag says that all calls are allowed, as without.
    unsafe { disable_syscall_user_dispatch() }.unwrap();
    signal_hook::low_level::unregister(handler);
}
const SIGSYS: i32 = 31;

/// Everybody sees everything; an episode is longer than any test.
struct Still;

impl World for Still {
    fn shape(&self) -> Shape {
        SHAPE
    }

    fn reset(&mut self) {}

    fn observe(&self, frame: &mut FrameMut<'_>) {
        let all = EntityMask::first(SHAPE.entities);
        frame.set_present(&all);
        frame.set_open_tasks(1);
        for agent in 0..SHAPE.agents {
            frame.set_observable(agent, &all);
            frame.available_mut(agent).fill(1);
        }
    }

    fn step(&mut self, _: &[u16]) -> Result<StepOutcome, UnavailableAction> {
        Ok(StepOutcome { episode_ended: false, tasks_changed: false })
    }
}

struct First;

impl Policy for First {
    fn actions(&self) -> usize {
        SHAPE.actions
    }

    fn utilities(&mut self, _: &Observation<'_>, _: &mut [f32]) -> Result<(), DecideError> {
        Ok(())
    }

    fn decide(&mut self, _: &Observation<'_>) -> Result<Decision, DecideError> {
        Ok(Decision { action: 0, utility: 0.0 })
    }
}

impl Allocator for First {
    fn allocate(
        &mut self,
        _: &AllocationState<'_>,
        allocation: &mut [u8],
    ) -> Result<(), AllocateError> {
        allocation.fill(0);
        Ok(())
    }
}

#[derive(Default)]
struct Ticks {
    done: usize,
    allocated: usize,
}

impl WorldObserver for Ticks {
    fn tick(&mut self, report: &TickReport<'_>) {
        assert_eq!(report.answered, EVERY_AGENT);
        self.done += 1;
    }

    fn allocated(&mut self, _: &sortie_core::wire::AllocMsg) {
        self.allocated += 1;
    }
}

/// A team in one thread, which takes turns instead of sleeping.
struct Team {
    world: (WorldRole, IoxWorld),
    runners: [(RunnerRole, IoxAgent); 2],
    allocator: (AllocatorRole, IoxAllocator),
    ticks: Ticks,
}

impl Team {
    fn open(domain: &Domain) -> Self {
        let contract = DomainContract { hash: 1, decision_interval: 4, ..Default::default() };
        let format = DomainFacts::new(&contract, SHAPE).format().unwrap();
        let setup = LinkSetup {
            domain,
            format,
            name: "quiet",
            bell: BellKind::Doorbell,
            linger: Duration::ZERO,
        };
        let world = WorldRole::new(WorldOptions {
            format,
            identity: Identity::new(4, "world"),
            term: 1,
            required: EVERY_AGENT,
            allocator: true,
            strict: true,
            pipelined: false,
            join_patience_ns: u64::MAX,
            period_ns: 0,
            patience_ns: 0,
            absent_after: 3,
            absent: 0,
            decision_interval: 4,
            safe_action: Some(0),
            episodes: None,
            tick_interval_ns: 0,
        });
        let runner = |pid: u32, agents| {
            let options = RunnerOptions {
                format,
                identity: Identity::new(pid, "runner"),
                agents,
                subtasks: true,
                decision_interval: 4,
                period_ns: 0,
                safe_action: Some(0),
            };
            (RunnerRole::new(options), IoxAgent::open(&setup).unwrap())
        };
        let mut allocator = AllocatorRole::new(AllocatorOptions {
            format,
            identity: Identity::new(3, "allocator"),
            decision_interval: 4,
        });
        allocator.lead(1);
        let mut team = Self {
            world: (world, IoxWorld::open(&setup).unwrap()),
            runners: [runner(1, 0b1111), runner(2, 0b1111_0000)],
            allocator: (allocator, IoxAllocator::open(&setup).unwrap()),
            ticks: Ticks::default(),
        };
        team.allocator.0.join(&mut team.allocator.1).unwrap();
        for (role, link) in &mut team.runners {
            role.join(link).unwrap();
        }
        team
    }

    /// Goes on until so many ticks are done.
    fn run(&mut self, ticks: usize) {
        while self.ticks.done < ticks {
            let (world, link) = &mut self.world;
            assert_ne!(world.poll(link, &mut Still, &mut self.ticks).unwrap(), Poll::Ended);
            assert!(!is_asked(link));
            let (allocator, link) = &mut self.allocator;
            allocator.poll(link, &mut First).unwrap();
            assert!(!is_asked(link));
            for (runner, link) in &mut self.runners {
                runner.poll(link, &mut First).unwrap();
                assert!(!is_asked(link));
            }
        }
    }
}

/// Looks for requests, as every process does before it sleeps.
fn is_asked(link: &mut impl ControlRx) -> bool {
    link.answer_requests(&mut |request| request.answer(0, ControlStatus::Done, 0))
}

#[test]
fn a_tick_without_sleepers_calls_neither_kernel_nor_heap() {
    let domain = Domain::new(&format!("quiet{}", std::process::id())).unwrap();
    let _membership = domain.enter().unwrap();
    let mut team = Team::open(&domain);
    team.run(WARM_UP);
    let allocated = team.ticks.allocated;
    let mut calls = 0;
    let mut heap_calls = 0;
    watched(|| {
        let before = HEAP_CALLS.get();
        calls = system_calls(|| team.run(WARM_UP + TICKS));
        heap_calls = HEAP_CALLS.get() - before;
    });
    assert_eq!((calls, heap_calls), (0, 0), "system calls, calls of the heap");
    assert_eq!(team.ticks.allocated - allocated, TICKS / 4);
}

#[test]
fn neither_end_of_a_served_policy_calls_the_heap() {
    const GUARDED: &[u8] =
        sortie_core::include_plan!("../../../tests/golden/plans/guarded-2.3.plan");
    let plan = Plan::load(GUARDED).unwrap();
    let guards = Guards::of_plan(GUARDED).unwrap();
    let schema = PolicySchema::of_plan(&plan).unwrap();
    let domain = Domain::new(&format!("served{}", std::process::id())).unwrap();
    let deadline = Duration::from_secs(3600);
    let (stop, fallback, real_time) = (Stop::new(), Fallback::Hold, RealTime::default());
    let settings = ServeSettings { deadline, fallback, draw: None, linger: None, real_time };
    std::thread::scope(|scope| {
        let server = scope.spawn(|| {
            let mut server = PolicyServer::open(&domain, schema, &settings).unwrap();
            let mut heap_calls = Vec::with_capacity(WARM_UP + TICKS);
            let mut note = |_: &Served| heap_calls.push(HEAP_CALLS.get());
            server.serve(&plan, guards, &mut note, &stop).unwrap();
            heap_calls[heap_calls.len() - 1] - heap_calls[WARM_UP]
        });
        let expected = Expected { inputs: &[("", 1)], outputs: &[("", 1)], actions: 0 };
        let settings = ClientSettings::default();
        let mut client = PolicyClient::connect(&domain, &expected, &settings).unwrap();
        let mut decide = |times| {
            for _ in 0..times {
                client.decide(&[&[0.5]], &[]).unwrap();
            }
        };
        decide(WARM_UP);
        let before = HEAP_CALLS.get();
        decide(TICKS);
        let heap_calls = HEAP_CALLS.get() - before;
        stop.stop();
        assert_eq!((heap_calls, server.join().unwrap()), (0, 0), "calls of client and server");
    });
}

#[test]
fn system_calls_are_noticed() {
    let mut calls = [0; 2];
    watched(|| {
        calls = [
            system_calls(|| {
                let _ = rustix::thread::gettid();
            }),
            system_calls(|| {}),
        ];
    });
    assert_eq!(calls, [1, 0]);
}
