//! The small network: codec, training, weights, and the independence of its caches from forecasts.

use std::path::Path;
use std::process::Command;

use image::RgbImage;
use pskel_generate::{
    Codec, Condition, Denoiser, DroppedConditions, Frame, FrameConditions, GaussianNoise, GenerateOptions,
    Latent, Level, NoiseSource, Strategy, TrainingClip,
};
use pskel_network::train::{TrainOptions, Trainer, measure};
use pskel_network::{Network, NetworkConfig, NetworkError, Weights};
use pskel_sim::Forecast;
use pskel_testing::generator_inputs::{GeneratorInputs, options as roll_options};
use pskel_testing::small_network::{VIEWS, clip, clip_for, config, weights};

fn train_options() -> TrainOptions {
    TrainOptions { steps: 4, warmup: 2, batch: 2, learning_rate: 3e-3, ..TrainOptions::default() }
}

fn conditions(drive: &TrainingClip) -> Vec<FrameConditions> {
    let encoder = drive.encoder();
    (0..drive.frames.len()).map(|frame| drive.conditions(frame, &encoder)).collect()
}

fn network(drives: &[TrainingClip]) -> Network {
    Network::new(weights(drives), VIEWS).unwrap()
}

/// Latents are the mean colors of 4x4 pixels, normalized.
#[test]
fn latents_of_the_clips_have_unit_variance() {
    let drives = [clip(1, 5), clip(2, 4)];
    let statistics = measure(&config(), &drives).unwrap();
    let codec = network(&drives);
    let mut channels = vec![Vec::new(); 3];
    for (drive, frame) in drives.iter().flat_map(|d| (0..d.frames.len()).map(move |f| (d, f))) {
        let latent = codec.encode(&drive.images(frame)).unwrap();
        for (i, value) in latent.values().iter().enumerate() {
            channels[i / 32 % 3].push(f64::from(*value));
        }
    }
    for (channel, values) in channels.iter().enumerate() {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let square = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64;
        assert!(mean.abs() < 1e-3 && (square - 1.0).abs() < 2e-3, "{channel} {mean} {square}");
    }
    let images = drives[0].images(3);
    let latent = codec.encode(&images).unwrap();
    assert_eq!((latent.shape(), latent.shape().to_array()), (config().shape(VIEWS), [2, 3, 4, 8]));
    // Green (1) of camera 1, row 2, column 5.
    let pixels = (0..16).map(|i| images[1].get_pixel(5 * 4 + i % 4, 2 * 4 + i / 4).0[1]);
    let mean = pixels.map(f32::from).sum::<f32>() / 16.0 / 255.0;
    let found = latent.values()[((3 + 1) * 4 + 2) * 8 + 5];
    assert!((found - (mean - statistics.means[1]) / statistics.scales[1]).abs() < 1e-5);
    let error = codec.encode(&images[..1]).unwrap_err().to_string();
    assert!(error.contains("expected 2 images, found 1"), "{error}");
    let error = codec.encode(&vec![RgbImage::new(36, 16); 2]).unwrap_err().to_string();
    assert!(error.contains("images of 16x32, found 16x36"), "{error}");
    let error = codec.decode(&latent, &conditions(&clip_for(&config(), 3, 1, 1))[0]).unwrap_err().to_string();
    assert!(error.contains("conditions of 2 cameras, found 3"), "{error}");
}

/// The prior is the error of the filled color: nothing if points show the whole image, the entropy of gray if
/// there are none.
#[test]
fn priors_are_the_error_of_the_filled_color() {
    let full = |mut drive: TrainingClip| {
        for frame in &mut drive.frames {
            frame.color.clone_from(&frame.truth);
            frame.bins.fill(1);
        }
        drive
    };
    let seen = measure(&config(), &[full(clip(1, 5))]).unwrap();
    assert_eq!(seen.priors, [0.01; 3]);
    let mut blind = clip(1, 5);
    for frame in &mut blind.frames {
        frame.color.fill([0; 3]);
        frame.bins.fill(0);
    }
    let blind = measure(&config(), &[blind]).unwrap();
    for c in 0..3 {
        let expected = (1.0 + ((blind.means[c] - 0.5) / blind.scales[c]).powi(2)).sqrt();
        assert!((blind.priors[c] - expected).abs() < 1e-3, "{blind:?}");
    }
    let error = measure(&config(), &[clip(1, 3)]).unwrap_err().to_string();
    assert!(error.contains("at least 4 frames, found 3 in made 1"), "{error}");
    let error = measure(&config(), &[clip_for(&config(), 9, 1, 4)]).unwrap_err().to_string();
    assert!(error.contains("1 to 8 cameras, found 9"), "{error}");
}

fn trained(trainer: &mut Trainer<'_>, steps: u64) {
    for _ in 0..steps {
        trainer.step().unwrap();
    }
}

/// Name of the variable with the file that a child process of this test writes.
const OUT: &str = "PSKEL_TEST_TRAINED";

/// The tensor library reads its number of threads from the environment, so each run needs its own process.
#[test]
fn training_is_reproducible_for_any_threads_and_when_resumed() {
    // A rig of another number of cameras is drawn as often.
    let drives = [clip(1, 5), clip_for(&config(), 3, 2, 6)];
    let begin = || Trainer::new(train_options(), config(), &drives, vec![1.0, 1.0]).unwrap();
    if let Some(out) = std::env::var_os(OUT) {
        let mut trainer = begin();
        trained(&mut trainer, 4);
        return trainer.save(Path::new(&out)).unwrap();
    }
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    for threads in ["1", "2"] {
        let test = "network::training_is_reproducible_for_any_threads_and_when_resumed";
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args([test, "--exact"]).env("RAYON_NUM_THREADS", threads).env(OUT, path(threads));
        let output = command.output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
    }
    let through = std::fs::read(path("1")).unwrap();
    assert!(through == std::fs::read(path("2")).unwrap());
    let mut trainer = begin();
    trained(&mut trainer, 2);
    trainer.save(&path("half")).unwrap();
    let mut trainer = Trainer::resume(&path("half"), &drives).unwrap();
    assert_eq!((trainer.done(), trainer.is_done()), (2, false));
    assert_eq!(trainer.step().unwrap().step, 2);
    trained(&mut trainer, 1);
    trainer.save(&path("resumed")).unwrap();
    assert!(trainer.is_done() && through == std::fs::read(path("resumed")).unwrap());
    // Three steps give another result than four.
    assert!(through != std::fs::read(path("half")).unwrap());

    let other = [clip(1, 5), clip(3, 6)];
    let error = Trainer::resume(&path("half"), &other).err().unwrap().to_string();
    assert!(error.contains("the drives that it began with") && error.ends_with("half"), "{error}");
    trainer.weights("test").unwrap().write(&path("weights")).unwrap();
    let error = Trainer::resume(&path("weights"), &drives).err().unwrap().to_string();
    assert!(error.contains("expected a saved training, found no training in the header"), "{error}");
    let error = Weights::open(&path("half")).unwrap_err().to_string();
    assert!(error.contains("expected weights, found no network in the header"), "{error}");
}

/// The network memorizes one window.
#[test]
fn a_small_network_overfits_a_clip() {
    let drives = [clip(1, 4)];
    let options = TrainOptions {
        steps: 150,
        warmup: 10,
        learning_rate: 5e-3,
        augment: 0.0,
        all_cameras: 1.0,
        ..train_options()
    };
    let mut trainer = Trainer::new(options, config(), &drives, vec![1.0]).unwrap();
    let losses: Vec<f64> = (0..150).map(|_| trainer.step().unwrap().loss).collect();
    let mean = |losses: &[f64]| losses.iter().sum::<f64>() / losses.len() as f64;
    let (first, last) = (mean(&losses[..5]), mean(&losses[130..]));
    // Found: 40.9 and 10.4.
    assert!((25.0..60.0).contains(&first), "{first}");
    assert!(last < first / 3.0 && last < 15.0, "{first} {last}");
    let weights = trainer.weights("pskel train").unwrap();
    assert_eq!((weights.about.steps, &weights.about.logs[..]), (150, &["made 1".to_owned()][..]));
}

#[test]
fn a_diverging_training_is_stopped() {
    let drives = [clip(1, 4)];
    let options = TrainOptions { learning_rate: 1e30, warmup: 0, ..train_options() };
    let mut trainer = Trainer::new(options, config(), &drives, vec![1.0]).unwrap();
    let error = (0..4).find_map(|_| trainer.step().err()).unwrap();
    assert!(matches!(error, NetworkError::NotFinite { .. }), "{error}");
    assert!(error.to_string().contains(&format!("step {} of training", trainer.done())), "{error}");
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
    let FrameConditions { points, layout, cameras, .. } = conditions;
    FrameConditions {
        points: points[..points.len() / VIEWS].to_vec(),
        layout: layout[..layout.len() / VIEWS].to_vec(),
        cameras: cameras[..1].to_vec(),
        ..conditions.clone()
    }
}

/// One camera or eight, with the same weights; more are refused.
#[test]
fn a_network_takes_any_rig_of_one_to_eight_cameras() {
    let weights = weights(&[clip(1, 5)]);
    for cameras in [1, 3, 8] {
        let drive = clip_for(&config(), cameras, 1, 4);
        let mut network = Network::new(weights.clone(), cameras).unwrap();
        let noise = noises(&network, 1);
        let latents = predicted(&mut network, &noise, &conditions(&drive));
        assert!(latents.iter().all(|latent| latent.shape().views == cameras));
        let images = network.decode(&latents[3], &conditions(&drive)[3]).unwrap();
        assert!(images.len() == cameras && images.iter().all(|image| image.dimensions() == (32, 16)));
    }
    for cameras in [0, 9] {
        let error = Network::new(weights.clone(), cameras).err().unwrap().to_string();
        assert!(error.contains(&format!("expected 1 to 8 cameras, found {cameras}")), "{error}");
    }
}

/// The images of a frame depend on its own conditions alone.
#[test]
fn frames_are_decoded_with_their_conditions() {
    let drive = clip(1, 5);
    let (network, conditions) = (network(std::slice::from_ref(&drive)), conditions(&drive));
    let latent = network.encode(&drive.images(0)).unwrap();
    let decoded = |frame: usize| network.decode(&latent, &conditions[frame]).unwrap();
    assert!(decoded(0) == decoded(0) && decoded(0) != decoded(1));
}

fn noises(network: &Network, seed: u64) -> Vec<Latent> {
    (0..4).map(|frame| GaussianNoise { seed }.noise(network.shape(), frame, 0)).collect()
}

#[test]
fn conditions_change_the_prediction() {
    let drives = [clip(1, 5)];
    let mut network = network(&drives);
    let conditions = conditions(&drives[0]);
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
    let drives = [clip(1, 5)];
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("weights.safetensors");
    let written = weights(&drives);
    written.write(&path).unwrap();
    let read = Weights::open(&path).unwrap();
    assert_eq!(
        (&read.config, &read.statistics, &read.about),
        (&written.config, &written.statistics, &written.about)
    );
    assert_eq!(read.count(), written.count());
    let conditions = conditions(&drives[0]);
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
    assert!(error.contains("block.00.in of f32 [128, 32], found F32 [144, 32]"), "{error}");
    let error = changed(r#"\"s\",\"v\""#, r#"\"s\",\"x\""#);
    assert!(error.contains("expected weights, found"), "{error}");
    let error = changed(r#"head\":16"#, r#"head\":17"#);
    assert!(error.contains("whole heads"), "{error}");
    let error = changed(r#""ego.a""#, r#""ego.c""#);
    assert!(error.contains("ego.a of f32 [32, 4], found no such array"), "{error}");
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

/// The shipped weights state their origin, and the log of their training is stored beside them.
#[test]
fn shipped_weights_match_the_default_network_and_training() {
    let weights = Weights::shipped().unwrap();
    assert_eq!(weights.config, NetworkConfig::default());
    let log = include_str!("../../shipped/loss.csv");
    let options = TrainOptions::default();
    assert_eq!((weights.about.seed, weights.about.steps), (options.seed, options.steps));
    assert_eq!(log.lines().count() as u64, 1 + options.steps);
    let command = &weights.about.command;
    assert!(command.starts_with("pskel train nuscenes:pandaset-002 town:seed=201,"), "{command}");
    assert_eq!((weights.about.logs.len(), weights.count() / 100_000), (6, 18));
}

#[test]
fn the_networks_cache_is_independent_of_forecasts() {
    the_cache_has_seen_no_forecast(&weights(&[clip(1, 8)]));
}

#[test]
fn the_shipped_networks_cache_is_independent_of_forecasts() {
    the_cache_has_seen_no_forecast(&Weights::shipped().unwrap());
}

/// Compares bit by bit, with the network itself and the same seed: other forecasts change neither caches nor
/// later frames, unless frames roll on.
fn the_cache_has_seen_no_forecast(weights: &Weights) {
    let conditions = conditions(&clip_for(&weights.config, VIEWS, 1, 8));
    let elsewhere = self::conditions(&clip_for(&weights.config, VIEWS, 2, 8));
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
