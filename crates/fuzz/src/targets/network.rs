//! Networks and caches: safetensors with a JSON header.

use std::cell::RefCell;

use point_skeleton::dataset::LogReader;
use point_skeleton::geometry::ImageSize;
use pskel_generate::toy::LinearDenoiser;
use pskel_generate::{
    Cache, Denoiser, DroppedConditions, Frame, FrameConditions, GaussianNoise, GenerateOptions, Generator,
    Guidance, Latent, LatentShape, Level, Recipe, SamplerOptions, Strategy,
};
use pskel_network::{Attend, Network, NetworkConfig, Statistics, Weights};
use pskel_sim::{Committed, Rates, Scenario, SimOptions, Simulation};
use serde_json::{Value, json};

use super::clouds::written;
use super::{LARGE, SMALL, Scratch, edit_seeds, edited, seed};
use crate::check::{assert_names_file, short};
use crate::synthetic_log::SyntheticLog;
use crate::{Seed, Target};

pub(super) const TARGETS: [Target; 2] = [
    Target { name: "weights", run: weights, seeds: weight_seeds, max_len: 4096, memory: LARGE },
    Target { name: "cache", run: cache, seeds: cache_seeds, max_len: 8192, memory: SMALL },
];

/// A valid file.
struct Stored {
    scratch: Scratch,
    weights: Vec<u8>,
}

thread_local! {
    static STORED: RefCell<Stored> = RefCell::new(Stored::new());
    static CACHE: Vec<u8> = cache_file();
}

fn config() -> NetworkConfig {
    let side = ImageSize { height: 32, width: 32 };
    NetworkConfig {
        recipe: Recipe { drawn: side, size: side, ..Recipe::default() },
        frames: 2,
        encoder: [16; 4],
        decoder: [16; 4],
        width: 16,
        head: 16,
        hidden: 16,
        blocks: vec![Attend::Space, Attend::Time],
    }
}

fn conditions() -> FrameConditions {
    let Recipe { size, bins, .. } = config().recipe;
    let image = |factor: u8| (0..size.pixels()).map(|p| [factor, (p % 6) as u8 * 40, 9]).collect::<Vec<_>>();
    FrameConditions {
        size,
        color: image(3),
        bins: (0..size.pixels()).map(|p| p as u16 % 256).collect(),
        depth_bins: bins,
        boxes: image(5),
        map: image(7),
        dropped: DroppedConditions::default(),
        action: [0.5, 0.0, 0.1],
        cameras: vec![[0.25; 16]],
        prompts: Default::default(),
    }
}

impl Stored {
    fn new() -> Self {
        let statistics = Statistics { means: vec![0.5; 3], scales: vec![0.2; 3], priors: vec![0.5; 3] };
        let random = Weights::random(&config(), &statistics, 1).expect("weights");
        Self { weights: written("w", |path| random.write(path)), scratch: Scratch::new() }
    }
}

/// Returns the file for an input. After a first byte of 0, the input edits the header of `base`; after a 1,
/// it is positions (two bytes), each with its new byte. Any other input is the file itself.
fn file(data: &[u8], base: &[u8], key: &str) -> Vec<u8> {
    match data.split_first() {
        Some((0, edits)) => with_header(base, key, edits),
        Some((1, changes)) => {
            let mut bytes = base.to_vec();
            for [low, high, byte] in changes.as_chunks().0 {
                let at = usize::from(u16::from_le_bytes([*low, *high]));
                if let Some(place) = bytes.get_mut(at) {
                    *place = *byte;
                }
            }
            bytes
        }
        _ => data.to_vec(),
    }
}

fn with_header(base: &[u8], key: &str, edits: &[u8]) -> Vec<u8> {
    let (length, rest) = base.split_at(8);
    let length = u64::from_le_bytes(length.try_into().expect("eight bytes")) as usize;
    let mut header: Value = serde_json::from_slice(&rest[..length]).expect("a header");
    let text = header["__metadata__"][key].as_str().unwrap_or_default();
    let about: Value = serde_json::from_str(text).expect("JSON in the header");
    let mut both = edited(&json!([about, header]), edits);
    let about = both.get(0).cloned().unwrap_or_default();
    header = both.get_mut(1).map(Value::take).unwrap_or_default();
    if let Some(place) = header.pointer_mut(&format!("/__metadata__/{key}")) {
        *place = about.to_string().into();
    }
    let header = header.to_string();
    [&(header.len() as u64).to_le_bytes(), header.as_bytes(), &rest[length..]].concat()
}

/// Maximum length of a file that becomes a seed, bytes.
const MAX_SEED: usize = 4096;

fn seeds(file: &[u8]) -> Vec<Seed> {
    let mut seeds = edit_seeds();
    seeds.iter_mut().for_each(|(_, edits)| edits.insert(0, 0));
    seeds.push(seed("changed", [1, 9, 0, b'x', 255, 2, 255]));
    // Larger seeds would grow the repository for little benefit.
    if file.len() <= MAX_SEED {
        seeds.push(seed("file", file));
    }
    seeds
}

fn weights(data: &[u8]) {
    STORED.with_borrow(|stored| {
        let path = stored.scratch.put("weights.safetensors", &file(data, &stored.weights, "network"));
        let weights = match Weights::open(&path) {
            Err(error) => return assert_names_file(error, &path, data),
            Ok(weights) => weights,
        };
        weights.write(&path).expect("weights to write");
        let again = Weights::open(&path).expect("weights that were written");
        assert_eq!(again.fingerprint(), weights.fingerprint());
        if weights.config.shape(1) == config().shape(1) && weights.config.recipe == config().recipe {
            predict(weights);
        }
    });
}

/// Runs a network once; the numbers may have any value.
fn predict(weights: Weights) {
    let shape = weights.config.shape(1);
    let Ok(mut network) = Network::new(weights, 1) else { return };
    let (latent, condition) = (Latent::filled(shape, 0.5), conditions());
    let frame = Frame {
        latent: &latent,
        level: Level { timestep: 500.0, sigma: 0.5 },
        is_reference: false,
        condition: &condition,
    };
    if let Ok(predicted) = network.predict(&[frame, frame]) {
        assert!(predicted.len() == 2 && predicted.iter().all(|latent| latent.shape() == shape));
    }
}

fn weight_seeds() -> Vec<Seed> {
    seeds(&Stored::new().weights)
}

const SHAPE: LatentShape = LatentShape { views: 1, channels: 2, height: 2, width: 1 };

fn options() -> GenerateOptions {
    GenerateOptions {
        window: 3,
        steps: 3,
        clean: 0,
        strategy: Strategy::ResetAndRoll,
        sampler: SamplerOptions::default(),
        guidance: Guidance::default(),
    }
}

type Toys = Generator<LinearDenoiser, GaussianNoise>;

/// Returns a committed condition; only a rollout can commit one.
fn committed() -> Committed<Latent> {
    let synthetic = SyntheticLog::new(2);
    let scenario = Scenario { log: synthetic.recording(), map: None, rates: Rates::default() };
    let rollout = Simulation::new(&scenario, SimOptions::default()).expect("a rollout");
    rollout.committed().map(|_| Latent::filled(SHAPE, 0.25))
}

fn cache_file() -> Vec<u8> {
    let latent = || Latent::filled(SHAPE, 0.5);
    let references = (0..options().references()).map(|_| (latent(), committed())).collect();
    let toy = LinearDenoiser { shape: SHAPE };
    let mut generator =
        Toys::new(toy, GaussianNoise { seed: 1 }, options(), references).expect("a generator");
    generator.step(committed(), &[]).expect("a frame");
    generator.cache().to_bytes().expect("a cache")
}

fn cache(data: &[u8]) {
    let bytes = CACHE.with(|base| file(data, base, "cache"));
    let cache = match Cache::from_bytes(&bytes) {
        Err(error) => return short(&error.to_string(), data),
        Ok(cache) => cache,
    };
    let written = cache.to_bytes().expect("a cache to write");
    let again = Cache::from_bytes(&written).expect("a cache that was written");
    assert_eq!(again.to_bytes().ok(), Some(written));
    let shown = (0..options().references()).map(|_| committed()).collect();
    match Toys::resume(LinearDenoiser { shape: SHAPE }, GaussianNoise { seed: 1 }, options(), cache, shown) {
        Err(error) => short(&error.to_string(), data),
        Ok(mut generator) => {
            let synthetic = generator.step(committed(), &[]).expect("a frame");
            assert_eq!(synthetic.shape(), SHAPE);
        }
    }
}

fn cache_seeds() -> Vec<Seed> {
    seeds(&cache_file())
}
