//! Windows, schedules and strategies of the generator.

use std::path::Path;

use proptest::prelude::*;
use pskel_generate::toy::LinearDenoiser;
use pskel_generate::{
    Cache, Ddim, Denoiser, DenoiserError, FlowMatch, Frame, GaussianNoise, GenerateOptions, Generator,
    Guidance, Latent, LatentShape, NoiseSource, Prediction, Roll, Strategy,
};
use pskel_sim::Forecast;
use pskel_testing::generator_inputs::{GeneratorInputs, SHAPE, committed, forecasts, made_up, options};
use pskel_testing::npz;
use pskel_testing::shared::fixtures;
use serde_json::Value;

#[test]
fn schedules_match_diffusers() {
    let Some(folder) = fixtures("schedules of another implementation") else { return };
    let file: Value =
        serde_json::from_slice(&std::fs::read(folder.join("generate/schedules.json")).unwrap()).unwrap();
    let list = |value: &Value| value.as_array().unwrap().clone();
    let number = |value: &Value| value.as_f64().unwrap();
    let count = |value: &Value| value.as_u64().unwrap() as usize;
    for table in list(&file["flow_match"]) {
        let ours = FlowMatch::new(count(&table["steps"]), number(&table["shift"]));
        for (ours, theirs, within) in
            [(ours.sigmas(), &table["sigmas"], 1e-6), (ours.timesteps(), &table["timesteps"], 1e-3)]
        {
            let theirs = list(theirs);
            assert_eq!(ours.len(), theirs.len());
            let off =
                ours.iter().zip(&theirs).map(|(a, b)| (f64::from(*a) - number(b)).abs()).fold(0.0, f64::max);
            assert!(off < within, "{off} at {table}");
        }
    }
    let ddim = &file["ddim"];
    let ours = Ddim::new(count(&ddim["steps"]));
    assert_eq!(ours.timesteps(), list(&ddim["timesteps"]).iter().map(count).collect::<Vec<_>>());
    let ends = list(&ddim["alphas_cumprod_first_last"]);
    assert!(
        (ours.alpha(0) - number(&ends[0])).abs() < 1e-6 && (ours.alpha(999) - number(&ends[1])).abs() < 1e-6
    );
    for step in list(&ddim["steps_taken"]) {
        let prediction = match step["prediction"].as_str().unwrap() {
            "epsilon" => Prediction::Epsilon,
            "sample" => Prediction::Sample,
            _ => Prediction::Velocity,
        };
        for ((x, model), after) in list(&step["x"]).iter().zip(list(&step["model"])).zip(list(&step["prev"]))
        {
            let ours = ours.step(prediction, count(&step["index"]), number(x), number(&model));
            assert!(
                (ours - number(&after)).abs() < 1e-6 * number(&after).abs().max(1.0),
                "{ours} {after} {prediction:?}"
            );
        }
    }
    for rule in list(&file["index_rule"]) {
        let [window, steps, clean, references] =
            ["window", "steps", "clean", "reference"].map(|key| count(&rule[key]));
        let roll = Roll { window, clean, steps };
        assert_eq!(roll.per_roll(), Some(count(&rule["per_roll"])));
        for call in list(&rule["roll"]) {
            let progress = roll.progress(count(&call["step"]), references);
            let (index, updated): (Vec<_>, Vec<_>) = progress.iter().map(|p| (p.index, p.is_updated)).unzip();
            assert_eq!(index, list(&call["index"]).iter().map(count).collect::<Vec<_>>());
            assert_eq!(
                updated,
                list(&call["update"]).iter().map(|v| v.as_bool().unwrap()).collect::<Vec<_>>()
            );
        }
    }
}

/// Noise of the fixture, in order of use.
struct Listed<'a> {
    noise: &'a [Latent],
    per_step: usize,
}

impl NoiseSource for Listed<'_> {
    fn noise(&mut self, _: LatentShape, frame: usize, draw: usize) -> Latent {
        self.noise[(frame - 3) * self.per_step + draw].clone()
    }
}

fn latents(path: &Path, name: &str) -> Vec<Latent> {
    let array = npz::read::<f64>(path, name);
    assert!(array.shape.ends_with(&SHAPE.to_array()), "{name} {:?}", array.shape);
    let frame = |values: &[f64]| Latent::new(SHAPE, values.iter().map(|v| *v as f32).collect()).unwrap();
    array.data.chunks(SHAPE.len()).map(frame).collect()
}

pub(crate) fn assert_near(ours: &[Latent], theirs: &[Latent], within: f32) {
    assert_eq!(ours.len(), theirs.len());
    let values = |latents: &[Latent]| latents.iter().flat_map(|l| l.values().to_vec()).collect::<Vec<f32>>();
    let off = values(ours).iter().zip(values(theirs)).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(off < within, "{off}");
}

#[test]
fn rollouts_match_another_implementation() {
    let Some(folder) = fixtures("rollouts of another implementation") else { return };
    let path = folder.join("generate/rollout.npz");
    let named = |name: &str| latents(&path, name);
    let (references, noise, conditions) = (named("reference"), named("noise"), named("committed"));
    for (ahead, frames, cache) in
        [("forecast_a", "frames_a", Some("cache_a")), ("forecast_b", "frames_b", None)]
    {
        let drive = GeneratorInputs {
            references: references.clone(),
            committed: committed(&conditions[..9]),
            forecasts: named(ahead).chunks(4).map(forecasts).collect(),
        };
        let noise = Listed { noise: &noise, per_step: 4 };
        let mut generator =
            drive.generator(LinearDenoiser { shape: SHAPE }, noise, options(Strategy::ResetAndRoll));
        let (ours, caches) = drive.run(&mut generator);
        assert_near(&ours, &named(frames), 1e-4);
        if let Some(cache) = cache {
            let ours: Vec<Latent> = caches.into_iter().flat_map(|cache| cache.frames).collect();
            assert_near(&ours, &named(cache), 1e-4);
        }
    }
    let drive = GeneratorInputs {
        references,
        committed: committed(&conditions[..9]),
        forecasts: vec![Vec::new(); 6],
    };
    let noise = Listed { noise: &noise, per_step: 1 };
    let causal = Strategy::Causal { history_noise: 0 };
    let (ours, _) = drive.run(&mut drive.generator(LinearDenoiser { shape: SHAPE }, noise, options(causal)));
    assert_near(&ours, &named("causal"), 1e-4);
}

/// Denoiser with perfect predictions: it returns the velocity from each frame's latent to its condition.
#[derive(Default)]
struct Knowing {
    calls: usize,
}

impl Denoiser for Knowing {
    type Condition = Latent;

    fn shape(&self) -> LatentShape {
        SHAPE
    }

    fn predict(&mut self, window: &[Frame<'_, Latent>]) -> Result<Vec<Latent>, DenoiserError> {
        self.calls += 1;
        let velocity = |frame: &Frame<'_, Latent>| {
            let of = |(x, clean): (&f32, &f32)| (x - clean) / frame.level.sigma;
            let values = frame.latent.values().iter().zip(frame.condition.values()).map(of);
            Latent::new(SHAPE, values.collect()).unwrap()
        };
        Ok(window.iter().map(velocity).collect())
    }
}

const STRATEGIES: [Strategy; 6] = [
    Strategy::ResetAndRoll,
    Strategy::Rolling,
    Strategy::Causal { history_noise: 0 },
    Strategy::Causal { history_noise: 100 },
    Strategy::NonCausal { forecasts: 2 },
    Strategy::NonCausal { forecasts: 0 },
];

/// Also at the end, where there are fewer forecasts, and after it, where there are none.
#[test]
fn every_frame_is_finished_when_it_is_due() {
    for strategy in STRATEGIES {
        let options = options(strategy);
        let drive = GeneratorInputs::new(&options);
        let mut generator = drive.generator(Knowing::default(), GaussianNoise { seed: 1 }, options);
        let (frames, _) = drive.run(&mut generator);
        let expected: Vec<Latent> = drive.committed[3..].iter().map(|c| c.get().clone()).collect();
        assert_near(&frames, &expected, 1e-5);
        let calls = match strategy {
            // The references pass through the window first, two calls each; at the end all four frames of the
            // window do.
            Strategy::Rolling => 2 * (3 + 8) + 4 * 8,
            _ => 12 * 8,
        };
        assert_eq!(generator.denoiser().calls, calls, "{strategy:?}");
    }
    let causal = Strategy::Causal { history_noise: 0 };
    for (window, clean, steps) in [(4, 1, 9), (4, 2, 8), (4, 3, 8), (2, 1, 8), (2, 0, 8)] {
        for strategy in [Strategy::ResetAndRoll, causal, Strategy::NonCausal { forecasts: window - 1 }] {
            let options = GenerateOptions { window, clean, steps, ..options(strategy) };
            let drive = GeneratorInputs::new(&options);
            let (noise, shown) = (GaussianNoise { seed: 1 }, &drive.committed[window - 1..]);
            let (frames, _) = drive.run(&mut drive.generator(Knowing::default(), noise, options));
            let expected: Vec<Latent> = shown.iter().map(|c| c.get().clone()).collect();
            assert_near(&frames, &expected, 1e-5);
        }
    }
}

/// Rolling has no effect if all frames except one are clean.
#[test]
fn rolling_with_one_noisy_frame_is_causal() {
    let frames = |strategy: Strategy| {
        let options = GenerateOptions { clean: 3, ..options(strategy) };
        let drive = GeneratorInputs::new(&options);
        drive.run(&mut drive.generator(LinearDenoiser { shape: SHAPE }, GaussianNoise { seed: 2 }, options)).0
    };
    assert!(frames(Strategy::ResetAndRoll) == frames(Strategy::Causal { history_noise: 0 }));
}

#[test]
fn a_retained_window_needs_its_forecasts() {
    let options = options(Strategy::Rolling);
    let drive = GeneratorInputs::new(&options);
    let mut generator = drive.generator(LinearDenoiser { shape: SHAPE }, GaussianNoise { seed: 1 }, options);
    generator.step(drive.committed[3].clone(), &drive.forecasts[0]).unwrap();
    let before = generator.cache().clone();
    let error = generator.step(drive.committed[4].clone(), &drive.forecasts[1][..1]).unwrap_err().to_string();
    assert!(error.contains("forecasts up to frame 6, the last in the window, at frame 4"), "{error}");
    assert!(error.contains("found up to frame 5") && *generator.cache() == before, "{error}");
    generator.step(drive.committed[4].clone(), &drive.forecasts[1][..2]).unwrap();
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(20))]

    /// Resetting rolls leave no trace of forecasts, bit by bit; frames that roll on retain it.
    #[test]
    fn the_cache_is_independent_of_forecasts(seed in 0u64.., changed in 0usize..8) {
        for (strategy, forgets) in STRATEGIES.map(|strategy| (strategy, strategy == Strategy::ResetAndRoll)) {
            let options = options(strategy);
            let mut drive = GeneratorInputs::new(&options);
            let run = |drive: &GeneratorInputs| {
                drive.run(&mut drive.generator(LinearDenoiser { shape: SHAPE }, GaussianNoise { seed },
                options))
            };
            let (frames, caches) = run(&drive);
            let had_forecasts = !drive.forecasts[changed].is_empty();
            for (number, forecast) in drive.forecasts[changed].iter_mut().enumerate() {
                *forecast = Forecast::new(made_up(seed ^ 1, number));
            }
            let (others, other_caches) = run(&drive);
            prop_assert_eq!(caches == other_caches, forgets || !had_forecasts, "{:?}", strategy);
            // Forecasts do have an effect.
            prop_assert_eq!(frames[changed] == others[changed], !had_forecasts);
            if forgets {
                prop_assert!(frames[changed + 1..] == others[changed + 1..]);
            }
        }
    }
}

#[test]
fn a_generator_resumes_from_its_cache() {
    for strategy in STRATEGIES {
        let options = options(strategy);
        let drive = GeneratorInputs::new(&options);
        let noise = GaussianNoise { seed: 3 };
        let (frames, caches) =
            drive.run(&mut drive.generator(LinearDenoiser { shape: SHAPE }, noise, options));
        for (done, cache) in caches.iter().enumerate() {
            let cache = Cache::from_bytes(&cache.to_bytes().unwrap()).unwrap();
            let shown = drive.committed[done + 1..done + 4].to_vec();
            let resumed = Generator::resume(LinearDenoiser { shape: SHAPE }, noise, options, cache, shown);
            let (others, other_caches) = drive.run(&mut resumed.unwrap());
            assert!(
                others == frames[done + 1..] && other_caches == caches[done + 1..],
                "{strategy:?} {done}"
            );
        }
    }
}

#[test]
fn damaged_caches_are_refused() {
    type Damage = fn(&mut Cache);
    let (rolling, causal) = (Strategy::Rolling, Strategy::Causal { history_noise: 0 });
    let damages: [(Strategy, Damage, &str); 10] = [
        (Strategy::ResetAndRoll, |c| c.next = 2, "3 to 1000000000 as the next frame, found 2"),
        (rolling, |c| c.next = usize::MAX, "3 to 1000000000 as the next frame"),
        (rolling, |c| c.next = 3, "3 reference frames, found 4"),
        (rolling, |c| _ = c.frames.pop(), "4 frames in the cache, found 3"),
        (causal, |c| c.frames.push(c.frames[0].clone()), "3 frames in the cache, found 4"),
        (Strategy::ResetAndRoll, |c| c.references = 4, "2 references in the cache, found 4"),
        (rolling, |c| c.references = 4, "0 to 3 references in the cache, found 4"),
        (Strategy::ResetAndRoll, |c| c.in_place = 1, "0 rolls in place in the cache, found 1"),
        (rolling, |c| c.in_place = 4, "0 to 3 rolls in place in the cache, found 4"),
        (causal, |c| c.frames[2].values_mut()[5] = f32::NAN, "finite latents in the cache, found NaN"),
    ];
    for (strategy, damage, said) in damages {
        let (options, noise) = (options(strategy), GaussianNoise { seed: 3 });
        let drive = GeneratorInputs::new(&options);
        let mut cache =
            drive.run(&mut drive.generator(LinearDenoiser { shape: SHAPE }, noise, options)).1[1].clone();
        damage(&mut cache);
        let cache = Cache::from_bytes(&cache.to_bytes().unwrap()).unwrap();
        let shown = drive.committed[2..5].to_vec();
        let error =
            Generator::resume(LinearDenoiser { shape: SHAPE }, noise, options, cache, shown).err().unwrap();
        assert!(error.to_string().contains(said), "{error}");
    }
}

/// Guidance moves away from the unconditional prediction; expected values are computed by hand.
#[test]
fn guidance_combines_two_predictions() {
    let plain = options(Strategy::Causal { history_noise: 0 });
    let drive = GeneratorInputs::new(&plain);
    let frame = |scale: f32| {
        let options = GenerateOptions { guidance: Guidance { scale, ..Guidance::default() }, ..plain };
        drive.run(&mut drive.generator(LinearDenoiser { shape: SHAPE }, GaussianNoise { seed: 4 }, options)).0
            [0]
        .clone()
    };
    let grey = GeneratorInputs {
        committed: committed(&vec![Latent::filled(SHAPE, 0.0); 11]),
        references: drive.references.clone(),
        forecasts: drive.forecasts.clone(),
    };
    let without =
        grey.run(&mut grey.generator(LinearDenoiser { shape: SHAPE }, GaussianNoise { seed: 4 }, plain)).0[0]
            .clone();
    assert_near(&[frame(0.0)], std::slice::from_ref(&without), 1e-6);
    // The toy denoiser is linear, so frames combine as velocities do.
    let twice: Vec<f32> =
        frame(1.0).values().iter().zip(without.values()).map(|(a, b)| 2.0 * a - b).collect();
    assert_near(&[frame(2.0)], &[Latent::new(SHAPE, twice).unwrap()], 1e-5);
}

/// Predictions of a denoiser, given the first latent of the window.
type Answer = fn(&Latent) -> Vec<Latent>;

/// Denoiser that returns a bad prediction in its second frame.
struct Failing {
    calls: usize,
    answer: Answer,
}

impl Denoiser for Failing {
    type Condition = Latent;

    fn shape(&self) -> LatentShape {
        SHAPE
    }

    fn predict(&mut self, window: &[Frame<'_, Latent>]) -> Result<Vec<Latent>, DenoiserError> {
        self.calls += 1;
        let good = window.iter().map(|frame| frame.latent.clone()).collect();
        Ok(if self.calls > 10 { (self.answer)(window[0].latent) } else { good })
    }
}

#[test]
fn network_errors_are_reported_and_change_nothing() {
    let options = options(Strategy::ResetAndRoll);
    let drive = GeneratorInputs::new(&options);
    let other = LatentShape { views: 1, ..SHAPE };
    let wrongs: [(Answer, &str); 3] = [
        (|x| vec![x.clone(); 3], "frame 4: expected 4 frames from the denoiser, found 3"),
        (
            |x| vec![Latent::filled(LatentShape { views: 1, ..x.shape() }, 0.0); 4],
            "latents of 2x3x2x2 for frame 0 of the window from the denoiser, found 1x3x2x2",
        ),
        (
            |x| [x.clone(), x.clone(), Latent::filled(x.shape(), f32::NAN), x.clone()].to_vec(),
            "finite values for frame 2 of the window from the denoiser, found NaN",
        ),
    ];
    for (answer, said) in wrongs {
        let mut generator = drive.generator(Failing { calls: 0, answer }, GaussianNoise { seed: 1 }, options);
        generator.step(drive.committed[3].clone(), &drive.forecasts[0]).unwrap();
        let before = generator.cache().clone();
        let error = generator.step(drive.committed[4].clone(), &drive.forecasts[1]).unwrap_err().to_string();
        assert!(error.contains(said), "{error}");
        assert_eq!(*generator.cache(), before);
    }
    let references =
        |count: usize, shape| vec![(Latent::filled(shape, 0.0), drive.committed[0].clone()); count];
    for (count, shape, said) in
        [(2, SHAPE, "3 reference frames, found 2"), (3, other, "latents of 2x3x2x2, found 1x3x2x2")]
    {
        let made = Generator::new(
            LinearDenoiser { shape: SHAPE },
            GaussianNoise { seed: 1 },
            options,
            references(count, shape),
        );
        assert!(made.err().unwrap().to_string().contains(said));
    }
}
