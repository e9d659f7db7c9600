//! Which frames of a window a network is told to be finished.

use std::cell::RefCell;
use std::rc::Rc;

use pskel_generate::toy::LinearDenoiser;
use pskel_generate::{Denoiser, DenoiserError, Frame, GaussianNoise, Latent, LatentShape, Strategy};
use pskel_testing::generator_inputs::{GeneratorInputs, SHAPE, options};

/// Keeps the flags of all calls, as text: `R` for a reference, `-` for a frame that is denoised.
struct Recorder {
    inner: LinearDenoiser,
    calls: Rc<RefCell<Vec<String>>>,
}

impl Denoiser for Recorder {
    type Condition = Latent;

    fn shape(&self) -> LatentShape {
        self.inner.shape()
    }

    fn predict(&mut self, window: &[Frame<'_, Latent>]) -> Result<Vec<Latent>, DenoiserError> {
        let flags = window.iter().map(|frame| if frame.is_reference { 'R' } else { '-' });
        self.calls.borrow_mut().push(flags.collect());
        self.inner.predict(window)
    }
}

/// Returns the call flags of the first and the second generated frame.
fn reference_kinds(strategy: Strategy) -> [Vec<String>; 2] {
    let options = options(strategy);
    let clip = GeneratorInputs::new(&options);
    let calls = Rc::default();
    let denoiser = Recorder { inner: LinearDenoiser { shape: SHAPE }, calls: Rc::clone(&calls) };
    let mut generator = clip.generator(denoiser, GaussianNoise { seed: 1 }, options);
    let first = generator.cache().next;
    [first, first + 1].map(|frame| {
        generator.step(clip.committed[frame].clone(), &clip.forecasts[frame - first]).unwrap();
        calls.take()
    })
}

/// A window of four frames, eight inference steps, two calls a roll.
#[test]
fn references_are_the_unchanged_frames_of_a_call() {
    let twice =
        |flags: &[&str]| flags.iter().flat_map(|flags| [(*flags).to_owned(), (*flags).to_owned()]).collect();
    let [first, second] = reference_kinds(Strategy::ResetAndRoll);
    let expected: Vec<String> = twice(&["RRR-", "RR--", "R---", "----"]);
    assert_eq!(first, expected);
    // The window was reset to the first roll of the first frame.
    let expected: Vec<String> = twice(&["RR--", "R---", "----", "----"]);
    assert_eq!(second, expected);
    for calls in reference_kinds(Strategy::Causal { history_noise: 0 }) {
        assert_eq!(calls, vec!["RRR-".to_owned(); 8]);
    }
}
