//! Loops for the vector instructions of the processor.
//!
//! `pulp` calls a closure through a shim of the compiler, `FnOnce::call_once`, which is not inlined if the
//! closure is long, whatever its attributes. Its loops then have the instructions of the oldest processors.
//! [`wide`] avoids the shim.

use pulp::{Simd, WithSimd};

/// Runs loops that are compiled for the widest vector instructions of the processor. The closure and all that
/// it calls must be `#[inline(always)]`; what is not inlined has the instructions of the oldest processors.
#[inline(always)]
pub(crate) fn wide<R>(loops: impl FnMut() -> R) -> R {
    pulp::Arch::new().dispatch(Loops(loops))
}

/// Calls a closure itself, rather than through a shim.
struct Loops<F>(F);

impl<R, F: FnMut() -> R> WithSimd for Loops<F> {
    type Output = R;

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) -> R {
        (self.0)()
    }
}
