//! The lock between Vulkan calls and the creation and destruction of instances and devices.
//!
//! # Why
//! The Khronos validation layer finds the state of an instance or device in one map per process, at the start of every
//! call of every device. Until version 1.4.304 nothing locks that map (`GetLayerDataPtr` in its `vk_layer_data.h` says so):
//! `vkCreateInstance`, `vkCreateDevice` and their counterparts change it while other threads read it, and a reader
//! follows a wild or null pointer. Vulkan allows such calls on several threads, so callers of this module may make them.
//!
//! # How it works
//! Whatever creates or destroys an instance, a messenger or a device holds the lock alone ([`alone`]). A call of an
//! instance or device with a layer takes a share of it for as long as the call lasts ([`Calls`]); without a layer there
//! is nothing to protect, and the call takes no lock. Each instance keeps its own messenger, so messages reach
//! the device that caused them.
//!
//! To be free of deadlocks, a thread takes one share at a time, takes other locks before its share, and waits for
//! the device in short calls. Vulkan calls of other code in the process do not go through the gate.

use std::ops::Deref;
use std::sync::{PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

static GATE: RwLock<()> = RwLock::new(());

/// Keeps all other instances and devices with layers out of Vulkan for as long as it lives.
pub(super) fn alone() -> RwLockWriteGuard<'static, ()> {
    #[cfg(debug_assertions)]
    nesting::check();
    GATE.write().unwrap_or_else(PoisonError::into_inner)
}

/// Keeps instances and devices from being created and destroyed for as long as it lives.
pub(super) struct Share {
    _guard: RwLockReadGuard<'static, ()>,
    #[cfg(debug_assertions)]
    _nesting: nesting::Nesting,
}

impl Share {
    /// A share for calls that go through a layer; other calls need none.
    pub(super) fn new(layered: bool) -> Option<Self> {
        layered.then(|| Self {
            #[cfg(debug_assertions)]
            _nesting: nesting::Nesting::new(),
            _guard: GATE.read().unwrap_or_else(PoisonError::into_inner),
        })
    }
}

/// The functions of an instance or device, for one call.
pub(super) struct Calls<'a, T> {
    functions: &'a T,
    _share: Option<Share>,
}

impl<'a, T> Calls<'a, T> {
    pub(super) fn new(functions: &'a T, layered: bool) -> Self {
        Self { functions, _share: Share::new(layered) }
    }
}

impl<T> Deref for Calls<'_, T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.functions
    }
}

/// Finds threads that would wait for themselves: a second share waits for a thread that waits to be alone, which waits
/// for the first share.
#[cfg(debug_assertions)]
mod nesting {
    use std::cell::Cell;

    thread_local! {
        static SHARED: Cell<bool> = const { Cell::new(false) };
    }

    /// That this thread has no share.
    pub(super) fn check() {
        debug_assert!(!SHARED.get(), "this thread holds a share of the gate already");
    }

    /// Notes that this thread has a share.
    pub(super) struct Nesting;

    impl Nesting {
        pub(super) fn new() -> Self {
            check();
            SHARED.set(true);
            Self
        }
    }

    impl Drop for Nesting {
        fn drop(&mut self) {
            SHARED.set(false);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc;
    use std::thread;
    use std::time::Duration;

    use super::*;

    #[test]
    fn only_calls_through_a_layer_keep_creation_waiting() {
        const SOON: Duration = Duration::from_millis(50);
        let (sender, receiver) = mpsc::channel();
        let share = Share::new(true);
        assert!(share.is_some() && Share::new(false).is_none());
        thread::scope(move |scope| {
            scope.spawn(move || {
                drop(alone());
                sender.send(()).unwrap();
            });
            assert!(receiver.recv_timeout(SOON).is_err());
            drop(share);
            receiver.recv().unwrap();
        });
    }

    #[test]
    #[cfg(debug_assertions)]
    fn a_second_share_of_a_thread_is_a_mistake() {
        let nested = thread::spawn(|| {
            let _share = Share::new(true);
            Share::new(true).is_some()
        });
        assert!(nested.join().is_err());
        let nested = thread::spawn(|| {
            let _share = Share::new(true);
            drop(alone());
        });
        assert!(nested.join().is_err());
    }
}
