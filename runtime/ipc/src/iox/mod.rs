//! The links over iceoryx2: its only user. Rules for it that cost days to find:
//!
//! * one table of services for all processes, opened or created with the schema as attribute;
//! * nothing that a killed process could leave locked (no blackboard), nobody waits for a reader;
//! * bells by `try_wait`, `ppoll` and `try_wait` again: a wait set drained once loses wake-ups, and
//!   the library's timed wait is late by up to 12 ms;
//! * ports stay on the thread that made them; processes are spawned, never forked.

mod bell;
mod inter_process;
mod links;
mod open;
mod opener;
mod recorder;
mod served;
mod services;
mod watcher;

use iceoryx2::port::listener::Listener;
use iceoryx2::prelude::{FileDescriptor, FileDescriptorBased};
use iceoryx2::service::Service;

pub use iceoryx2::service::ipc_threadsafe::Service as AnyThread;
pub use iceoryx2::service::local_threadsafe::Service as IntraProcess;
pub use inter_process::InterProcess;
pub use links::{Housekeeping, IoxAgent, IoxAllocator, IoxWorld};
pub(crate) use open::{Cleaner, set_log_level};
pub use recorder::{Heard, IoxRecorder};
pub(crate) use served::{ServedLink, ServedPresence, ServedSetup, ServedWatcher, served_bytes};
pub use services::LinkSetup;
pub(crate) use services::worst_case_bytes;
pub(crate) use watcher::dead_nodes;
pub use watcher::{ControlRx, FrameNews, IoxControl, IoxWatcher};

/// The services that links are opened over: [`InterProcess`], whose links stay on their thread; [`AnyThread`], which is
/// the same to others and takes a message's handle from the heap; or [`IntraProcess`] for threads of one process, with
/// nothing in shared memory.
pub trait LinkService: Service {
    /// What becomes readable when a listener is notified.
    #[doc(hidden)]
    fn descriptor(listener: &Listener<Self>) -> &FileDescriptor;
}

macro_rules! opens_links {
    ($($service:ident),+) => {$(
        impl LinkService for $service {
            fn descriptor(listener: &Listener<Self>) -> &FileDescriptor {
                listener.file_descriptor()
            }
        }
    )+};
}
opens_links!(InterProcess, AnyThread, IntraProcess);
