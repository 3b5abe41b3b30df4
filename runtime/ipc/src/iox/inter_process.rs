//! iceoryx2's services between processes, with handles of messages from a pool.
//!
//! While a message is written iceoryx2 0.10 keeps its handle in a reference-counted box, which it takes from
//! the heap and gives back for each message (`arc_sync_policy::single_threaded`). The service here
//! differs in that alone: boxes given back are used again, so that sending takes nothing from the heap
//! once a few messages have been sent. What lies in shared memory is that of
//! `iceoryx2::service::ipc`.

use core::cell::{Cell, RefCell};
use core::fmt::{self, Debug};
use core::marker::PhantomData;
use core::mem::ManuallyDrop;
use core::ptr::NonNull;
use std::alloc::{Layout, alloc, dealloc, handle_alloc_error};

use iceoryx2::service::Service;
use iceoryx2::service::internal::ServiceInternal;
use iceoryx2::service::ipc::Service as Library;
use iceoryx2_bb_elementary_traits::testing::abandonable::Abandonable;
use iceoryx2_bb_elementary_traits::zero_copy_send::ZeroCopySend;
use iceoryx2_cal::arc_sync_policy::{ArcSyncPolicy, ArcSyncPolicyCreationError, LockGuard};

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

/// A value with one or more owners, all of one thread. Its box comes from the thread's pool and goes
/// back there.
pub struct Pooled<T> {
    shared: NonNull<Shared<T>>,
    owns: PhantomData<Shared<T>>,
}

struct Shared<T> {
    owners: Cell<usize>,
    value: T,
}

impl<T> Pooled<T> {
    #[allow(unsafe_code)]
    pub(super) fn of(value: T) -> Self {
        let shared = take(Layout::new::<Shared<T>>()).cast::<Shared<T>>();
        // SAFETY: the block has this layout and nobody else has it.
        unsafe { shared.write(Shared { owners: Cell::new(1), value }) };
        Self { shared, owns: PhantomData }
    }

    #[allow(unsafe_code)]
    fn shared(&self) -> &Shared<T> {
        // SAFETY: the box is valid for as long as it has an owner, and its value is only ever shared.
        unsafe { self.shared.as_ref() }
    }

    pub(super) fn value(&self) -> &T {
        &self.shared().value
    }

    /// Ends one ownership without the value's destructor. The last owner gets the value in its box, which
    /// is not used again.
    #[allow(unsafe_code)]
    fn abandon(self) -> Option<NonNull<T>> {
        let this = ManuallyDrop::new(self);
        let owners = this.shared().owners.get() - 1;
        this.shared().owners.set(owners);
        // SAFETY: the box is still valid, and of its value only the address is taken.
        let value = unsafe { NonNull::new_unchecked(&raw mut (*this.shared.as_ptr()).value) };
        (owners == 0).then_some(value)
    }
}

impl<T> Clone for Pooled<T> {
    fn clone(&self) -> Self {
        let owners = &self.shared().owners;
        owners.set(owners.get() + 1);
        Self { shared: self.shared, owns: PhantomData }
    }
}

impl<T> Drop for Pooled<T> {
    #[allow(unsafe_code)]
    fn drop(&mut self) {
        let owners = self.shared().owners.get() - 1;
        self.shared().owners.set(owners);
        if owners == 0 {
            // SAFETY: this was the last owner: the value is dropped once, and the box is free.
            unsafe { self.shared.drop_in_place() };
            give(Layout::new::<Shared<T>>(), self.shared.cast());
        }
    }
}

impl<T: Debug> Debug for Pooled<T> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.value().fmt(formatter)
    }
}

/// Blocks of memory that nobody uses now, by layout: a few of a few layouts.
struct Pool(Vec<(Layout, NonNull<u8>)>);

thread_local! {
    static POOL: RefCell<Pool> = const { RefCell::new(Pool(Vec::new())) };
}

impl Drop for Pool {
    #[allow(unsafe_code)]
    fn drop(&mut self) {
        for (layout, block) in self.0.drain(..) {
            // SAFETY: blocks in the pool were allocated with their layout and have no user.
            unsafe { dealloc(block.as_ptr(), layout) };
        }
    }
}

/// A block of a layout that is not of size zero: from the pool, or from the heap.
#[allow(unsafe_code)]
fn take(layout: Layout) -> NonNull<u8> {
    let pooled = POOL.try_with(|pool| {
        let free = &mut pool.borrow_mut().0;
        let place = free.iter().position(|(of, _)| *of == layout)?;
        Some(free.swap_remove(place).1)
    });
    pooled.ok().flatten().unwrap_or_else(|| {
        // SAFETY: a box holds a count, so that its size is not zero.
        let block = unsafe { alloc(layout) };
        NonNull::new(block).unwrap_or_else(|| handle_alloc_error(layout))
    })
}

/// Gives a block back; to the heap where the thread ends and has no pool any more.
#[allow(unsafe_code)]
fn give(layout: Layout, block: NonNull<u8>) {
    let kept = POOL.try_with(|pool| pool.borrow_mut().0.push((layout, block)));
    if kept.is_err() {
        // SAFETY: the block came from `take` with this layout, and its user is gone.
        unsafe { dealloc(block.as_ptr(), layout) };
    }
}

#[cfg(test)]
mod tests {
    use std::rc::Rc;

    use super::*;

    #[test]
    fn a_value_lives_as_long_as_its_owners_and_its_box_is_used_again() {
        let witness = Rc::new(());
        let first = Pooled::of((7_u64, Rc::clone(&witness)));
        let second = first.clone();
        let place = first.shared.cast::<u8>();
        drop(first);
        assert_eq!((second.value().0, Rc::strong_count(&witness)), (7, 2));
        drop(second);
        assert_eq!(Rc::strong_count(&witness), 1);
        let third = Pooled::of((8_u64, Rc::clone(&witness)));
        assert_eq!(third.shared.cast::<u8>(), place);
        assert_ne!(Pooled::of([0_u8; 3]).shared.cast::<u8>(), place, "another layout");
    }

    #[test]
    fn the_last_owner_gets_what_is_abandoned() {
        let witness = Rc::new(());
        let first = Pooled::of(Rc::clone(&witness));
        let second = first.clone();
        assert!(first.abandon().is_none());
        assert!(second.abandon().is_some());
        assert_eq!(Rc::strong_count(&witness), 2, "no destructor ran");
    }

    #[test]
    fn a_thread_that_ends_leaves_nothing() {
        let ended = std::thread::spawn(|| {
            thread_local! {
                static LAST: RefCell<Option<Pooled<u64>>> = const { RefCell::new(None) };
            }
            LAST.set(Some(Pooled::of(1)));
            drop(Pooled::of(2_u64));
        });
        assert!(ended.join().is_ok());
    }
}
