//! World, runner and allocator as processes over shared memory, or all in one thread.
//!
//! A *domain* isolates one deployment: its paths, locks and shared-memory names carry its id. The
//! roles are the state machines of `sortie-core`; this crate gives them links, locks and loops.
//! Everything of a domain is removed by the last process that leaves it, or by the next that comes.
#![deny(unsafe_code)]

mod control;
mod doctor;
mod domain;
mod doorbell;
mod error;
mod in_process;
mod iox;
mod policy;
mod process_info;
mod processes;
mod real_time;
mod stop;
mod supervisor;
mod swap;
mod threads;

pub use control::{Answer, Order, control};
pub use doctor::{Finding, Severity, examine};
pub use domain::{
    BellKind, Domain, DomainContract, DomainFacts, Draws, Lock, Membership, Starting, TeamBundle,
    TeamBundles, model_text,
};
pub use doorbell::Doorbell;
pub use error::Error;
pub use in_process::{InProcess, run_in_process};
pub use iox::{
    AnyThread, ControlRx, FrameNews, Heard, Housekeeping, InterProcess, IntraProcess, IoxAgent,
    IoxAllocator, IoxControl, IoxRecorder, IoxWatcher, IoxWorld, LinkService, LinkSetup,
};
pub use policy::{
    Action, ClientCounters, ClientSettings, Engine, Expected, Fallback, PolicyClient, PolicySchema,
    PolicyServer, Port, ServeCounters, ServeSettings, Served,
};
pub use process_info::{BUILD, Candidate, HostProcess, NotAProcess, ProcessInfo};
pub use processes::{
    AllocatorProcess, Children, Fill, Loaded, LoadedModel, ProcessSettings, Registry,
    RunnerProcess, SwappedAllocator, SwappedPolicy, WorldSettings, allocator_offer,
    allocator_process, group_agents, runner_process, runner_process_with_heuristic,
    stand_in_allocator_process, stand_in_process, world_process, world_process_with_fill,
};
pub use real_time::RealTime;
pub use stop::{MonotonicClock, Stop, Wakeable, Waker, outlive_file_limits};
pub use supervisor::{Charge, RestartPolicy, Supervision, SupervisorEvent, supervise};
pub use swap::{Readiness, Swap};
pub use threads::{ThreadAgent, ThreadAllocator, ThreadWorld, Threads};
