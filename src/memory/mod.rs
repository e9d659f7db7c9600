//! One budget of memory for everything whose size is declared by a file, an option or another process.
//!
//! # How it works
//! A camera list of 60 kB can ask for terabytes of maps, and the allocator ends the process when the system
//! refuses. So whoever takes memory by a declared size first calls [`reserve`] with an estimate ([`Need`]),
//! which is compared with what is [`available`]: the least that the system, the container, `ulimit -v` or the
//! variable [`VARIABLE`] allow. An error names both numbers. Reservations whose memory is not taken yet count
//! as taken, so that threads and renderers of one process share the budget.

mod available;

use std::fmt;
use std::sync::{Mutex, MutexGuard, PoisonError};

pub use available::{Available, LimitSource, VARIABLE, address_space, available, variable_limit};

use available::taken_bytes;

/// Needs below this are not compared with the budget: reading its limits takes longer than using the memory.
const SMALL_BYTES: u64 = 32 << 20;

/// Memory that is about to be taken.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Need {
    /// Description that begins an error, like `drawing 6 views of up to 900x1600 pixels`.
    pub what: String,
    /// Estimated size, bytes.
    pub bytes: u64,
    /// What to change in order to need less.
    pub advice: &'static str,
}

/// More memory is needed than available.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{} needs {} of memory, but {} is available ({}): {}; {VARIABLE}=8G, for example, sets another limit",
    need.what, Bytes(need.bytes), Bytes(available.bytes), available.source, need.advice
)]
pub struct MemoryError {
    /// What was needed.
    pub need: Need,
    /// What was available.
    pub available: Available,
}

/// For interfaces that only have I/O errors.
impl From<MemoryError> for std::io::Error {
    fn from(error: MemoryError) -> Self {
        Self::new(std::io::ErrorKind::OutOfMemory, error)
    }
}

/// A part of the budget, which is free again on drop.
#[derive(Debug, Default)]
#[must_use = "the memory counts as free again once this is dropped"]
pub struct Reservation {
    bytes: u64,
}

/// Sum of all reservations, bytes.
static RESERVED: Mutex<u64> = Mutex::new(0);

fn reserved() -> MutexGuard<'static, u64> {
    // A sum is consistent at every moment.
    RESERVED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Reserves memory before it is taken. The reservation should live as long as the memory, or until all of it
/// is taken.
///
/// # Errors
/// Fails if less is available.
pub fn reserve(bytes: u64, need: impl FnOnce() -> Need) -> Result<Reservation, MemoryError> {
    let mut reservation = Reservation::default();
    reservation.grow(bytes, need)?;
    Ok(reservation)
}

impl Reservation {
    /// Enlarges the reservation to a total of `bytes`, if it is smaller. `need` describes the total; its size
    /// is replaced.
    ///
    /// # Errors
    /// Fails if less is available; the reservation then stays as it is.
    pub fn grow(&mut self, bytes: u64, need: impl FnOnce() -> Need) -> Result<(), MemoryError> {
        let Some(more) = bytes.checked_sub(self.bytes).filter(|more| *more > 0) else { return Ok(()) };
        let mut reserved = reserved();
        if more >= SMALL_BYTES {
            let available = available().less(reserved.saturating_sub(taken_bytes()));
            if more > available.bytes {
                // The part that is reserved already counts as available to this need.
                let available = Available { bytes: available.bytes.saturating_add(self.bytes), ..available };
                return Err(MemoryError { need: Need { bytes, ..need() }, available });
            }
        }
        *reserved = reserved.saturating_add(more);
        self.bytes = bytes;
        Ok(())
    }
}

impl Drop for Reservation {
    fn drop(&mut self) {
        let mut reserved = reserved();
        *reserved = reserved.saturating_sub(self.bytes);
    }
}

/// Number of bytes as text, in the largest fitting binary unit.
pub struct Bytes(pub u64);

impl fmt::Display for Bytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        const UNITS: [&str; 4] = ["MiB", "GiB", "TiB", "PiB"];
        let (mut number, mut unit) = (self.0 as f64 / f64::from(1 << 20), 0);
        while number >= 1024.0 && unit + 1 < UNITS.len() {
            (number, unit) = (number / 1024.0, unit + 1);
        }
        write!(f, "{number:.1} {}", UNITS[unit])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn need() -> Need {
        Need { what: "a test".to_owned(), bytes: 0, advice: "test less" }
    }

    #[test]
    fn refuses_more_than_is_available_with_both_numbers() {
        let error = reserve(1 << 60, need).unwrap_err();
        assert!(error.available.bytes < 1 << 50);
        let text = error.to_string();
        assert!(text.starts_with("a test needs 1024.0 PiB of memory, but "), "{text}");
        assert!(text.contains(": test less; PSKEL_MEMORY=8G"), "{text}");
        assert!(reserve(1 << 20, need).is_ok());
    }

    #[test]
    fn reservations_count_until_they_are_dropped() {
        let most = available().bytes;
        let half = reserve(most / 2, need).unwrap();
        assert!(reserve(most / 10 * 7, need).is_err());
        drop(half);
        let mut whole = reserve(most / 10 * 7, need).unwrap();
        assert!(whole.grow(1, need).is_ok() && whole.bytes == most / 10 * 7);
        assert!(whole.grow(most * 2, need).is_err() && whole.bytes == most / 10 * 7);
    }

    #[test]
    fn sizes_are_written_in_fitting_units() {
        let texts = [0, 3 << 19, 5 << 30, 1 << 63].map(|bytes| Bytes(bytes).to_string());
        assert_eq!(texts, ["0.0 MiB", "1.5 MiB", "5.0 GiB", "8192.0 PiB"]);
    }
}
