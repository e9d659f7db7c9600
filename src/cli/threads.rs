//! How many threads the environment may ask for.

use super::WrongUsage;

/// What rayon reads: the second where the first is not set.
const VARIABLES: [&str; 2] = ["RAYON_NUM_THREADS", "RAYON_RS_NUM_CPUS"];
/// Threads that any machine starts; more are allowed where there are processors for a quarter of them.
const ALWAYS_ALLOWED: usize = 256;
const PER_PROCESSOR: usize = 4;

/// Refuses a number of threads that would only keep the machine busy with starting them. Several libraries read the
/// variable, each for threads of its own, so that no smaller number can be put in its place.
///
/// # Errors
/// More threads than the machine has use for.
pub(super) fn check_environment() -> Result<(), WrongUsage> {
    let processors = std::thread::available_parallelism().map_or(1, usize::from);
    VARIABLES.iter().try_for_each(|name| check(name, std::env::var(name).ok().as_deref(), processors))
}

/// What is no number is ignored by those that read it, too.
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
    fn only_what_no_machine_has_use_for_is_refused() {
        for value in [None, Some(""), Some("0"), Some("1"), Some("256"), Some("many"), Some("-1")] {
            assert!(check("N", value, 2).is_ok(), "{value:?}");
        }
        let message = check("N", Some("257"), 2).unwrap_err().to_string();
        assert_eq!(message, "expected at most 256 threads in N, found 257");
        assert!(check("N", Some("400"), 100).is_ok() && check("N", Some("401"), 100).is_err());
    }
}
