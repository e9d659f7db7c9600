//! Runs every target on its committed corpus and on mutations of it, without instrumentation: a short version
//! of `ci/fuzz.sh` that takes seconds. The corpus includes inputs that once revealed a fault.

use std::path::{Path, PathBuf};

use point_skeleton_fuzz::{TARGETS, Target, run};

/// Number of mutations per target.
const MUTATIONS: u64 = 300;

/// In a single test, because the process measures the memory of its runs together.
#[test]
fn corpus_and_mutations_hold() {
    let failed: Vec<String> = TARGETS.iter().filter_map(|target| all_hold(target).err()).collect();
    assert!(failed.is_empty(), "{}", failed.join("; "));
}

/// Stops at the first input on which a target fails.
fn all_hold(target: &'static Target) -> Result<(), String> {
    let corpus = corpus(target);
    let mut numbers = Numbers(0x9e37_79b9_7f4a_7c15);
    corpus.iter().try_for_each(|(name, bytes)| attempt(target, name, bytes))?;
    // The mutations are the same on every machine.
    for i in 0..MUTATIONS {
        let (_, bytes) = &corpus[numbers.below(corpus.len())];
        let (_, other) = &corpus[numbers.below(corpus.len())];
        let mutated = mutate(bytes, other, target.max_len, &mut numbers);
        attempt(target, &format!("mutation {i}"), &mutated)?;
    }
    Ok(())
}

fn corpus(target: &Target) -> Vec<(String, Vec<u8>)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(target.name);
    let entries = std::fs::read_dir(&folder).unwrap_or_else(|e| panic!("{e}: {}", folder.display()));
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    files.sort();
    let name = |path: &Path| path.file_name().unwrap().to_string_lossy().into_owned();
    let read = |path: PathBuf| (name(&path), std::fs::read(&path).unwrap());
    let corpus: Vec<_> = files.into_iter().map(read).collect();
    for (seed, _) in (target.seeds)() {
        assert!(
            corpus.iter().any(|(file, _)| *file == format!("seed-{seed}")),
            "{}: no seed {seed}",
            target.name
        );
    }
    corpus
}

/// Runs a target; on failure, saves the input to a file and names it.
fn attempt(target: &'static Target, name: &str, bytes: &[u8]) -> Result<(), String> {
    std::panic::catch_unwind(|| run(target, bytes)).map_err(|_| {
        let path = std::env::temp_dir().join(format!("pskel-fuzz-{}", target.name));
        std::fs::write(&path, bytes).unwrap();
        format!("{} fails on {name}, left in {}", target.name, path.display())
    })
}

/// SplitMix64.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ mixed >> 31
    }

    fn below(&mut self, n: usize) -> usize {
        (self.next() % n.max(1) as u64) as usize
    }
}

/// Applies a few byte mutations, as fuzzers do.
fn mutate(bytes: &[u8], other: &[u8], max_len: usize, numbers: &mut Numbers) -> Vec<u8> {
    const ODD: [u64; 8] = [0, 1, 0x7f, 0xff, 0x7fff_ffff, 0xffff_ffff, i64::MAX as u64, u64::MAX];
    let mut bytes = bytes.to_vec();
    for _ in 0..=numbers.below(4) {
        let at = numbers.below(bytes.len() + 1);
        let length = numbers.below(16.min(bytes.len() - at) + 1);
        match numbers.below(7) {
            0 if at < bytes.len() => bytes[at] ^= 1 << numbers.below(8),
            1 if at < bytes.len() => bytes[at] = numbers.next() as u8,
            2 => {
                let number = ODD[numbers.below(ODD.len())].to_le_bytes();
                let width = (1 << numbers.below(4)).min(bytes.len() - at);
                bytes[at..at + width].copy_from_slice(&number[..width]);
            }
            3 => drop(bytes.drain(at..at + length)),
            4 => bytes.extend_from_within(at..at + length),
            5 => {
                let from = numbers.below(other.len() + 1);
                let part = &other[from..(from + 32).min(other.len())];
                bytes.splice(at..at + length, part.iter().copied());
            }
            _ => bytes.truncate(at),
        }
    }
    bytes.truncate(max_len);
    bytes
}
