//! iceoryx2's services between processes, with handles of messages from a pool.
//!
//! While a message is written iceoryx2 0.10 keeps its handle in a reference-counted box, which it takes from
//! the heap and gives back for each message (`arc_sync_policy::single_threaded`). The service here
//! differs in that alone: boxes given back are used again, so that sending takes nothing from the heap
//! once a few messages have been sent. What lies in shared memory is that of
//! `iceoryx2::service::ipc`.

use core::fmt::Debug;
use core::ptr::NonNull;

use iceoryx2::service::Service;
use iceoryx2::service::internal::ServiceInternal;
use iceoryx2::service::ipc::Service as Library;
use iceoryx2_bb_elementary_traits::testing::abandonable::Abandonable;
use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;
use iceoryx2_cal::arc_sync_policy::{ArcSyncPolicy, ArcSyncPolicyCreationError, LockGuard};

use super::pool::Pooled;

/// Services over shared memory, for links between processes.
#[derive(Clone, Debug)]
pub struct InterProcess;

impl Service for InterProcess {
    type ServiceNameHasher = <Library as Service>::ServiceNameHasher;
    type StaticStorage = <Library as Service>::StaticStorage;
    type ConfigSerializer = <Library as Service>::ConfigSerializer;
    type PersistentDynamicStorage<T: Debug + Send + Sync + ZeroCopySend + 'static> =
        <Library as Service>::PersistentDynamicStorage<T>;
    type Bag = <Library as Service>::Bag;
    type DynamicStorage<T: Debug + Send + Sync + ZeroCopySend + 'static> =
        <Library as Service>::DynamicStorage<T>;
    type SharedMemory = <Library as Service>::SharedMemory;
    type ResizableSharedMemory = <Library as Service>::ResizableSharedMemory;
    type Connection = <Library as Service>::Connection;
    type Event = <Library as Service>::Event;
    type Monitoring = <Library as Service>::Monitoring;
    type Reactor = <Library as Service>::Reactor;
    type ArcThreadSafetyPolicy<T: Send + Debug + Abandonable> = Pooled<T>;
    type BlackboardMgmt<T: Send + Sync + Debug + ZeroCopySend + 'static> =
        <Library as Service>::BlackboardMgmt<T>;
    type BlackboardPayload = <Library as Service>::BlackboardPayload;
    type UniqueId = <Library as Service>::UniqueId;
}

impl ServiceInternal<InterProcess> for InterProcess {}

/// Access to a value that only one thread has.
#[derive(Debug)]
pub struct Guard<'a, T>(&'a T);

impl<T> core::ops::Deref for Guard<'_, T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.0
    }
}

impl<'a, T: Send + Abandonable> LockGuard<'a, T> for Guard<'a, T> {}

impl<T: Send + Debug + Abandonable> ArcSyncPolicy<T> for Pooled<T> {
    type LockGuard<'a>
        = Guard<'a, T>
    where
        Self: 'a;

    fn new(value: T) -> Result<Self, ArcSyncPolicyCreationError> {
        Ok(Self::of(value))
    }

    fn lock(&self) -> Guard<'_, T> {
        Guard(self.value())
    }
}

impl<T: Send + Debug + Abandonable> Abandonable for Pooled<T> {
    #[allow(unsafe_code)]
    unsafe fn abandon_in_place(this: NonNull<Self>) {
        // SAFETY: as the caller promises, it owns what lies there, and does not use it afterwards.
        let this = unsafe { this.read() };
        if let Some(value) = this.abandon() {
            // SAFETY: nobody else owns the value, whose destructor does not run.
            unsafe { T::abandon_in_place(value) };
        }
    }
}
