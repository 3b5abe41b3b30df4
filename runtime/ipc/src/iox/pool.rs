//! Reference-counted values of one thread in boxes that are used again.

use core::cell::{Cell, RefCell};
use core::fmt::{self, Debug};
use core::marker::PhantomData;
use core::mem::ManuallyDrop;
use core::ptr::NonNull;
use std::alloc::{Layout, alloc, dealloc, handle_alloc_error};

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
    /// Boxes a value.
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

    /// The value.
    pub(super) fn value(&self) -> &T {
        &self.shared().value
    }

    /// Ends one ownership without the value's destructor. The last owner gets the value in its box, which
    /// is not used again.
    #[allow(unsafe_code)]
    pub(super) fn abandon(self) -> Option<NonNull<T>> {
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
    use super::*;
    use std::rc::Rc;

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
