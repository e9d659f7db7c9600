//! The small network: codec, weights, and the independence of its caches from forecasts.

use image::RgbImage;
use pskel_generate::{
    Codec, Condition, Denoiser, DroppedConditions, Frame, FrameConditions, GaussianNoise, GenerateOptions,
    Latent, Level, NoiseSource, Strategy,
};
use pskel_network::{Network, Weights};
use pskel_sim::Forecast;
use pskel_testing::generator_inputs::{GeneratorInputs, options as roll_options};
use pskel_testing::small_network::{VIEWS, clip, clip_for, config, statistics, weights};

fn network() -> Network {
    Network::new(weights(), VIEWS).unwrap()
}

/// Latents are the mean colors of 16x16 pixels, normalized.
#[test]
fn latents_are_normalized_mean_colors() {
    let (drive, codec, statistics) = (clip(1, 5), network(), statistics());
    let images = &drive.images[3];
    let latent = codec.encode(images).unwrap();
    assert_eq!((latent.shape(), latent.shape().to_array()), (config().shape(VIEWS), [2, 3, 2, 4]));
    // Green (1) of camera 1, row 1, column 2.
    let pixels = (0..256).map(|i| images[1].get_pixel(2 * 16 + i % 16, 16 + i / 16).0[1]);
    let mean = pixels.map(f32::from).sum::<f32>() / 256.0 / 255.0;
    let found = latent.values()[((3 + 1) * 2 + 1) * 4 + 2];
    assert!((found - (mean - statistics.means[1]) / statistics.scales[1]).abs() < 1e-5);
    let error = codec.encode(&images[..1]).unwrap_err().to_string();
    assert!(error.contains("expected 2 images, found 1"), "{error}");
    let error = codec.encode(&vec![RgbImage::new(36, 16); 2]).unwrap_err().to_string();
    assert!(error.contains("images of 32x64, found 16x36"), "{error}");
    let error =
        codec.decode(&latent, &clip_for(&config().recipe, 3, 1, 1).conditions[0]).unwrap_err().to_string();
    assert!(error.contains("conditions of 2 cameras, found 3"), "{error}");
}

fn level(sigma: f32) -> Level {
    Level { timestep: sigma * 1000.0, sigma }
}

fn predicted(network: &mut Network, latents: &[Latent], conditions: &[FrameConditions]) -> Vec<Latent> {
    let frame = |(latent, condition)| Frame { latent, level: level(0.6), is_reference: false, condition };
    let window: Vec<_> = latents.iter().zip(conditions).map(frame).collect();
    network.predict(&window).unwrap()
}

/// Returns the conditions of the first camera.
fn conditions_of_one(conditions: &FrameConditions) -> FrameConditions {
    let FrameConditions { size, color, bins, boxes, map, cameras, .. } = conditions;
    let pixels = size.pixels();
    FrameConditions {
        color: color[..pixels].to_vec(),
        bins: bins[..pixels].to_vec(),
        boxes: boxes[..pixels].to_vec(),
        map: map[..pixels].to_vec(),
        cameras: cameras[..1].to_vec(),
        ..conditions.clone()
    }
}

/// One camera or eight, with the same weights; more are refused.
#[test]
fn a_network_takes_any_rig_of_one_to_eight_cameras() {
    let weights = weights();
    for cameras in [1, 3, 8] {
        let drive = clip_for(&config().recipe, cameras, 1, 4);
        let mut network = Network::new(weights.clone(), cameras).unwrap();
        let noise = noises(&network, 1);
        let latents = predicted(&mut network, &noise, &drive.conditions);
        assert!(latents.iter().all(|latent| latent.shape().views == cameras));
        let images = network.decode(&latents[3], &drive.conditions[3]).unwrap();
        assert!(images.len() == cameras && images.iter().all(|image| image.dimensions() == (64, 32)));
    }
    for cameras in [0, 9] {
        let error = Network::new(weights.clone(), cameras).err().unwrap().to_string();
        assert!(error.contains(&format!("expected 1 to 8 cameras, found {cameras}")), "{error}");
    }
}

/// The images of a frame depend on its own conditions alone.
#[test]
fn frames_are_decoded_with_their_conditions() {
    let (network, drive) = (network(), clip(1, 5));
    let conditions = drive.conditions;
    let latent = network.encode(&drive.images[0]).unwrap();
    let decoded = |frame: usize| network.decode(&latent, &conditions[frame]).unwrap();
    assert!(decoded(0) == decoded(0) && decoded(0) != decoded(1));
}

fn noises(network: &Network, seed: u64) -> Vec<Latent> {
    (0..4).map(|frame| GaussianNoise { seed }.noise(network.shape(), frame, 0)).collect()
}

#[test]
fn conditions_change_the_prediction() {
    let mut network = network();
    let conditions = clip(1, 5).conditions;
    let latents = noises(&network, 1);
    let whole = predicted(&mut network, &latents, &conditions);
    let none = DroppedConditions::default();
    let all = [
        DroppedConditions { layout: true, ..none },
        DroppedConditions { action: true, ..none },
        DroppedConditions { color: true, ..none },
        DroppedConditions { depth: true, ..none },
    ];
    for dropped in all {
        let without: Vec<_> = conditions.iter().map(|c| c.without(dropped)).collect();
        assert!(predicted(&mut network, &latents, &without) != whole, "{dropped:?}");
    }
    // Cached results are reused only for equal conditions.
    assert!(predicted(&mut network, &latents, &conditions) == whole);
    assert!(predicted(&mut network, &latents, &conditions) == whole);
    assert!(predicted(&mut network, &latents, &conditions[1..]) != whole);
    // Shorter windows are accepted; other sizes are rejected.
    assert_eq!(predicted(&mut network, &latents[..2], &conditions).len(), 2);
    let small = conditions_of_one(&conditions[0]);
    let frame = Frame { latent: &latents[0], level: level(0.6), is_reference: false, condition: &small };
    let error = network.predict(&[frame]).unwrap_err().to_string();
    assert!(error.contains("conditions of 2 cameras, found 1"), "{error}");
    let frame = Frame { condition: &conditions[0], ..frame };
    let error = network.predict(&[frame; 5]).unwrap_err().to_string();
    assert!(error.contains("a window of 1 to 4 frames, found 5"), "{error}");
    let error = network.predict(&[Frame { level: level(f32::NAN), ..frame }]).unwrap_err().to_string();
    assert!(error.contains("found NaN"), "{error}");
}

#[test]
fn weights_are_read_back_or_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("weights.safetensors");
    let written = weights();
    written.write(&path).unwrap();
    let read = Weights::open(&path).unwrap();
    assert_eq!(
        (&read.config, &read.statistics, &read.about),
        (&written.config, &written.statistics, &written.about)
    );
    assert_eq!(read.count(), written.count());
    let conditions = clip(1, 5).conditions;
    let mut networks = [Network::new(written, VIEWS).unwrap(), Network::open(&path, VIEWS).unwrap()];
    let latents = noises(&networks[0], 2);
    let [a, b] = networks.each_mut().map(|network| predicted(network, &latents, &conditions));
    assert!(a == b);

    let bytes = std::fs::read(&path).unwrap();
    let refused = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        let error = Weights::open(&path).unwrap_err().to_string();
        assert!(error.ends_with("weights.safetensors"), "{error}");
        error
    };
    // Replaces a text in the header by another of the same length.
    let changed = |from: &str, to: &str| {
        assert_eq!(from.len(), to.len());
        let at = bytes.windows(from.len()).position(|part| part == from.as_bytes()).unwrap();
        let mut bytes = bytes.clone();
        bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
        refused(&bytes)
    };
    let error = changed(r#"hidden\":48"#, r#"hidden\":32"#);
    assert!(error.contains("denoiser.blocks.0.into.weight of f32 [128, 32], found F32 [144, 32]"), "{error}");
    let error = changed(r#"\"s\",\"v\""#, r#"\"s\",\"x\""#);
    assert!(error.contains("expected weights, found"), "{error}");
    let error = changed(r#"head\":16"#, r#"head\":17"#);
    assert!(error.contains("whole heads"), "{error}");
    let error = changed(r#""denoiser.ego_a.weight""#, r#""denoiser.ego_c.weight""#);
    assert!(error.contains("denoiser.ego_a.weight of f32 [32, 4], found no such array"), "{error}");
    let error = refused(&bytes[..bytes.len() - 4]);
    assert!(error.contains("expected weights, found"), "{error}");
    // Replaces the last number of the last parameter.
    for (number, name) in [(f32::NAN, "NaN"), (f32::INFINITY, "inf"), (f32::NEG_INFINITY, "-inf")] {
        let mut bytes = bytes.clone();
        bytes.splice(bytes.len() - 4.., number.to_le_bytes());
        let error = refused(&bytes);
        assert!(
            error.contains("expected finite numbers in ") && error.contains(&format!("found {name} at ")),
            "{error}"
        );
    }
}

/// The shipped weights state their origin.
#[test]
fn shipped_weights_are_for_images_of_the_papers_size() {
    let weights = Weights::shipped().unwrap();
    assert_eq!(weights.config.recipe.size.to_string(), "256x448");
    assert!(weights.about.steps > 0 && weights.about.logs.len() > 1, "{:?}", weights.about);
    assert!(weights.about.command.starts_with("python -m pskel.train "), "{}", weights.about.command);
    assert_eq!(weights.count() / 100_000, 29);
}

#[test]
fn the_networks_cache_is_independent_of_forecasts() {
    the_cache_has_seen_no_forecast(&weights());
}

#[test]
fn the_shipped_networks_cache_is_independent_of_forecasts() {
    the_cache_has_seen_no_forecast(&Weights::shipped().unwrap());
}

/// Compares bit by bit, with the network itself and the same seed: other forecasts change neither caches nor
/// later frames, unless frames roll on.
fn the_cache_has_seen_no_forecast(weights: &Weights) {
    let conditions = clip_for(&weights.config.recipe, VIEWS, 1, 8).conditions;
    let elsewhere = clip_for(&weights.config.recipe, VIEWS, 2, 8).conditions;
    let network = || Network::new(weights.clone(), VIEWS).unwrap();
    for (strategy, forgets) in [(Strategy::ResetAndRoll, true), (Strategy::Rolling, false)] {
        let options = GenerateOptions { steps: 4, ..roll_options(strategy) };
        let references = noises(&network(), 3)[..3].to_vec();
        let mut drive = GeneratorInputs::of(&options, references, &conditions);
        let run = |drive: &GeneratorInputs<FrameConditions>| {
            drive.run(&mut drive.generator(network(), GaussianNoise { seed: 4 }, options))
        };
        let (frames, caches) = run(&drive);
        for (forecast, other) in drive.forecasts[1].iter_mut().zip(&elsewhere) {
            *forecast = Forecast::new(other.clone());
        }
        let (others, other_caches) = run(&drive);
        assert_eq!(caches == other_caches, forgets, "{strategy:?}");
        assert!(frames[0] == others[0] && frames[1] != others[1]);
        assert_eq!(frames[2..] == others[2..], forgets);
    }
}
