//! Limit on the number of threads that the environment requests.

use point_skeleton::threads::POOL_VARIABLES;

use crate::WrongUsage;

/// Number of threads that is always allowed, and the limit per processor on larger machines.
const ALWAYS_ALLOWED: usize = 256;
const PER_PROCESSOR: usize = 4;

/// Rejects a number of threads that would only keep the machine busy with starting them. Several libraries
/// read the variable, each for its own threads, so it cannot be replaced by a smaller number.
///
/// # Errors
/// Fails if a variable requests more threads than the machine can use.
pub(crate) fn check_environment() -> Result<(), WrongUsage> {
    let processors = std::thread::available_parallelism().map_or(1, usize::from);
    POOL_VARIABLES.iter().try_for_each(|name| check(name, std::env::var(name).ok().as_deref(), processors))
}

/// Checks a variable. Invalid numbers are ignored, as the libraries that read it do.
fn check(name: &str, value: Option<&str>, processors: usize) -> Result<(), WrongUsage> {
    let most = ALWAYS_ALLOWED.max(PER_PROCESSOR * processors);
    match value.and_then(|text| text.parse::<usize>().ok()) {
        Some(asked) if asked > most => {
            Err(WrongUsage(format!("expected at most {most} threads in {name}, found {asked}")))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rejects_excessive_thread_counts() {
        for value in [None, Some(""), Some("0"), Some("1"), Some("256"), Some("many"), Some("-1")] {
            assert!(check("N", value, 2).is_ok(), "{value:?}");
        }
        let message = check("N", Some("257"), 2).unwrap_err().to_string();
        assert_eq!(message, "expected at most 256 threads in N, found 257");
        assert!(check("N", Some("400"), 100).is_ok() && check("N", Some("401"), 100).is_err());
    }
}
