//! The lock between Vulkan calls and the creation and destruction of instances and devices.
//!
//! # Why
//! At the start of every call of every device, the Khronos validation layer looks up the state of the
//! instance or device in one map per process. Until version 1.4.304 no lock protects that map
//! (`GetLayerDataPtr` in its `vk_layer_data.h` says so). `vkCreateInstance`, `vkCreateDevice` and their
//! counterparts change it while other threads read it, and a reader follows a wild or null pointer. Vulkan
//! allows such calls on several threads, so callers of this module may make them.
//!
//! # How it works
//! Code that creates or destroys an instance, a messenger or a device holds the lock exclusively ([`alone`]).
//! A call of an instance or device with a layer holds a share for the duration of the call ([`Calls`]).
//! Without a layer there is nothing to protect, and the call takes no lock. Each instance has its own
//! messenger, so messages reach the device that caused them.
//!
//! To avoid deadlocks, a thread takes one share at a time, takes other locks before its share, and waits for
//! the device in short calls. Vulkan calls by other code in the process bypass the gate.

use std::ops::Deref;
use std::sync::{PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

static GATE: RwLock<()> = RwLock::new(());

/// Locks the gate exclusively: blocks all other instances and devices with layers from Vulkan until dropped.
pub(in super::super) fn alone() -> RwLockWriteGuard<'static, ()> {
    #[cfg(debug_assertions)]
    nesting::check();
    GATE.write().unwrap_or_else(PoisonError::into_inner)
}

/// A share of the gate: blocks the creation and destruction of instances and devices until dropped.
pub(in super::super) struct Share {
    _guard: RwLockReadGuard<'static, ()>,
    #[cfg(debug_assertions)]
    _nesting: nesting::Nesting,
}

impl Share {
    /// Takes a share for calls that pass through a layer; returns `None` for other calls.
    pub(in super::super) fn new(layered: bool) -> Option<Self> {
        layered.then(|| Self {
            #[cfg(debug_assertions)]
            _nesting: nesting::Nesting::new(),
            _guard: GATE.read().unwrap_or_else(PoisonError::into_inner),
        })
    }
}

/// The functions of an instance or device, for one call.
pub(in super::super) struct Calls<'a, T> {
    functions: &'a T,
    _share: Option<Share>,
}

impl<'a, T> Calls<'a, T> {
    pub(in super::super) fn new(functions: &'a T, layered: bool) -> Self {
        Self { functions, _share: Share::new(layered) }
    }
}

impl<T> Deref for Calls<'_, T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.functions
    }
}

/// Detects threads that would deadlock with themselves: a second share waits for a thread that waits for
/// exclusive access, which waits for the first share.
#[cfg(debug_assertions)]
mod nesting {
    use std::cell::Cell;

    thread_local! {
        static SHARED: Cell<bool> = const { Cell::new(false) };
    }

    /// Asserts that this thread holds no share.
    pub(in super::super) fn check() {
        debug_assert!(!SHARED.get(), "this thread holds a share of the gate already");
    }

    /// Marks this thread as holding a share.
    pub(in super::super) struct Nesting;

    impl Nesting {
        pub(in super::super) fn new() -> Self {
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
    fn only_calls_through_a_layer_block_creation() {
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
    fn a_second_share_on_a_thread_panics() {
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
