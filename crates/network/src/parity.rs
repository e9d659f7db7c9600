//! The network equals its definition in PyTorch within 1e-4 of the outputs' standard deviation.
//! `python/tests/small/parity.py` writes the expected outputs.

use std::path::{Path, PathBuf};

use pskel_generate::Latent;
use pskel_testing::small_network::{VIEWS, clip_for};
use safetensors::SafeTensors;

use crate::Weights;
use crate::latents::{latent_of_rows, rows_of_latent};
use crate::model::Encoded;

const SIGMAS: [f32; 3] = [0.9, 0.5, 0.1];

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/parity").join(name)
}

fn values(tensors: &SafeTensors<'_>, name: &str) -> Vec<f64> {
    let data = tensors.tensor(name).unwrap();
    data.data().as_chunks::<4>().0.iter().map(|bytes| f64::from(f32::from_le_bytes(*bytes))).collect()
}

/// Returns the largest difference, in standard deviations of what is expected.
fn off(found: impl Iterator<Item = f64>, expected: &[f64]) -> f64 {
    let found: Vec<f64> = found.collect();
    assert_eq!(found.len(), expected.len());
    let count = expected.len() as f64;
    let mean = expected.iter().sum::<f64>() / count;
    let deviation = (expected.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count).sqrt();
    assert!(deviation > 0.01, "{deviation}");
    found.iter().zip(expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / deviation
}

/// Compares velocities and images; of the images, one of `step` numbers.
fn assert_equal(weights: &Weights, outputs: &str, step: usize) {
    let shape = weights.config.shape(VIEWS);
    let conditions = clip_for(&weights.config.recipe, VIEWS, 1, SIGMAS.len()).conditions;
    let model = weights.model().unwrap();
    let encoded: Vec<Encoded> = conditions.iter().map(|frame| model.encode(frame)).collect();
    let latent = |frame: usize| {
        let value = |i: usize| (1.3 * (0.37 * (frame * shape.len() + i) as f64).sin()) as f32;
        rows_of_latent(&Latent::new(shape, (0..shape.len()).map(value).collect()).unwrap())
    };
    let latents: Vec<Vec<f32>> = (0..SIGMAS.len()).map(latent).collect();
    let bytes = std::fs::read(file(outputs)).unwrap();
    let expected = SafeTensors::deserialize(&bytes).unwrap();
    let velocity = model.velocity(&latents.concat(), &SIGMAS, &encoded.iter().collect::<Vec<_>>());
    let frames = velocity.chunks(shape.len()).map(|rows| latent_of_rows(shape, rows).values().to_vec());
    let velocity: Vec<f32> = frames.flatten().collect();
    let far = off(velocity.into_iter().map(f64::from), &values(&expected, "velocity"));
    assert!(far < 1e-4, "velocity {far}");
    let colors = model.decode(&latents[2], &conditions[2], &encoded[2]);
    let colors = colors.as_flattened().iter().step_by(step).map(|level| f64::from(*level));
    let far = off(colors, &values(&expected, "images"));
    assert!(far < 1e-4, "images {far}");
}

#[test]
fn a_small_network_equals_pytorch() {
    assert_equal(&Weights::open(&file("small.safetensors")).unwrap(), "small-outputs.safetensors", 1);
}

#[test]
fn the_shipped_network_equals_pytorch() {
    assert_equal(&Weights::shipped().unwrap(), "shipped-outputs.safetensors", 7);
}
