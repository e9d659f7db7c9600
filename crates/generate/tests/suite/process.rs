//! Denoisers in Python.

mod failures;
mod numbers;

use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};

use point_skeleton::conditions::{DepthBins, Prompts};
use point_skeleton::geometry::ImageSize;
use pskel_generate::{
    DenoiserError, DenoiserRig, DroppedConditions, Frame, FrameConditions, GaussianNoise, GenerateError,
    GenerateOptions, Generator, GuidedPrediction, Latent, LatentShape, Level, Prediction, ProcessDenoiser,
    SamplerOptions, Strategy,
};
use pskel_sim::peer::{PeerAddress, PeerError, PeerSpec};
use pskel_testing::generator_inputs::{GeneratorInputs, options as options_of};
use safetensors::SafeTensors;

use super::rolls::assert_near;

const VIEWS: usize = 2;
const SIZE: ImageSize = ImageSize { height: 16, width: 24 };
/// Latent shape of the example denoiser.
const SHAPE: LatentShape = LatentShape { views: VIEWS, channels: 3, height: 2, width: 3 };
/// Long enough for Python to start on a busy machine, seconds.
const PATIENT_S: f64 = 60.0;
/// For tests that wait for the timeout, seconds.
const HASTY_S: f64 = 4.0;

fn options() -> GenerateOptions {
    options_of(Strategy::ResetAndRoll)
}

fn examples() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples")
}

fn command(text: String) -> PeerAddress {
    PeerAddress::Command(text)
}

fn example() -> PeerAddress {
    command(format!("exec python3 {}", examples().join("denoiser.py").display()))
}

fn rig() -> DenoiserRig {
    let sizes = [(900, 1600), (450, 800)].map(|(height, width)| ImageSize { height, width });
    let cameras = ["left", "right"].map(str::to_owned);
    DenoiserRig { cameras: cameras.to_vec(), image_sizes: sizes.to_vec(), fps: 12.5 }
}

fn start(address: PeerAddress, timeout_s: f64) -> Result<ProcessDenoiser, DenoiserError> {
    ProcessDenoiser::start(&PeerSpec { address, timeout_s }, &options(), &rig(), SIZE)
}

/// Returns the error of starting a denoiser.
fn refused(address: PeerAddress, timeout_s: f64) -> PeerError {
    match start(address, timeout_s) {
        Err(DenoiserError::Process(error)) => error,
        Err(error) => panic!("{error}"),
        Ok(_) => panic!("no error"),
    }
}

/// Denoiser that runs some lines of Python: `see()` returns the next message, `say(texts, name=(dtype, shape,
/// bytes))` answers; the functions of the example are available.
fn script(folder: &Path, lines: &str) -> PeerAddress {
    let path = folder.join("fake.py");
    let head = format!(
        "import os, sys, time\nsys.dont_write_bytecode = True\nsys.path.insert(0, {:?})\nimport denoiser\n\
         from denoiser import array, read, struct, write\nsource, out = sys.stdin.buffer, sys.stdout.buffer\n\
         def see():\n    return read(source)\ndef say(texts={{}}, **tensors):\n    write(out, texts, \
         tensors)\n\
         SHAPE = [4, 2, 3, 2, 3]\nHELLO = {{'protocol': 'pskel-denoiser', 'version': '1', 'latent_shape': \
         '2,3,2,3', \
         'dtype': 'F32'}}\n",
        examples().display().to_string()
    );
    std::fs::write(&path, format!("{head}{lines}\n")).unwrap();
    command(format!("exec python3 {}", path.display()))
}

/// Returns conditions that differ from frame to frame.
fn conditions(number: usize) -> FrameConditions {
    let byte = |i: usize, factor: usize| ((i * factor + number * 41) % 256) as u8;
    let count = VIEWS * SIZE.pixels();
    let rgb = |factor: usize| (0..count).map(|i| [0, 1, 2].map(|c| byte(3 * i + c, factor))).collect();
    let cameras = (0..VIEWS).map(|view| std::array::from_fn(|i| f32::from(byte(view * 16 + i, 3)) / 255.0));
    FrameConditions {
        size: SIZE,
        color: rgb(7),
        bins: (0..count).map(|i| u16::from(byte(i, 5))).collect(),
        depth_bins: DepthBins::default(),
        boxes: rgb(11),
        map: rgb(13),
        dropped: DroppedConditions::default(),
        action: [number as f32, 0.5, -0.25],
        cameras: cameras.collect(),
        prompts: match number {
            0 => Prompts::Frame("frame 0, \"rain\"".to_owned()),
            _ => Prompts::Cameras(vec![format!("left {number}"), String::new()]),
        },
    }
}

/// Returns the expected latent of the example.
fn colors(conditions: &FrameConditions) -> Latent {
    let (height, width) = (SIZE.height as usize, SIZE.width as usize);
    let mut latent = Latent::filled(SHAPE, 0.0);
    let points = conditions.points();
    for (i, value) in latent.values_mut().iter_mut().enumerate() {
        let (view, channel, row, column) = (i / 18, i / 6 % 3, i / 3 % 2, i % 3);
        let pixel = |k: usize| {
            let at = ((view * 20 + channel) * height + row * 8 + k / 8) * width + column * 8 + k % 8;
            f64::from(points[at])
        };
        *value = ((0..64).map(pixel).sum::<f64>() / 32.0 - 1.0) as f32;
    }
    latent
}

fn drive(frames: usize) -> GeneratorInputs<FrameConditions> {
    let conditions: Vec<FrameConditions> = (0..3 + frames).map(conditions).collect();
    GeneratorInputs::of(&options(), conditions[..3].iter().map(colors).collect(), &conditions)
}

const NOISE: GaussianNoise = GaussianNoise { seed: 5 };

fn assert_shows_colors(denoiser: ProcessDenoiser, frames: usize) -> Vec<Latent> {
    let drive = drive(frames);
    let (made, _) = drive.run(&mut drive.generator(denoiser, NOISE, options()));
    let expected: Vec<Latent> = drive.committed[3..].iter().map(|c| colors(c.get())).collect();
    assert_near(&made, &expected, 1e-4);
    made
}

/// Calls the denoiser once with a window of four frames; the latents are noise.
fn predict(denoiser: &mut ProcessDenoiser) -> Result<Vec<Latent>, DenoiserError> {
    use pskel_generate::Denoiser;
    on_window(|window| denoiser.predict(window))
}

/// Calls the denoiser for guidance, with the same window.
fn guided(denoiser: &mut ProcessDenoiser) -> Result<GuidedPrediction, DenoiserError> {
    use pskel_generate::Denoiser;
    on_window(|window| denoiser.predict_guided(window, DroppedConditions::GUIDED))
}

fn on_window<T>(call: impl FnOnce(&[Frame<'_, FrameConditions>]) -> T) -> T {
    use pskel_generate::NoiseSource;
    let latents: Vec<Latent> = (0..4).map(|frame| NOISE.clone().noise(SHAPE, frame, 0)).collect();
    let conditions: Vec<FrameConditions> = (0..4).map(conditions).collect();
    let frame = |position: usize| Frame {
        latent: &latents[position],
        level: Level { timestep: 250.0 * position as f32, sigma: 0.25 * position as f32 },
        is_reference: position == 0,
        condition: &conditions[position],
    };
    call(&(0..4).map(frame).collect::<Vec<_>>())
}

/// Returns the error of a call, and checks that later calls fail too.
fn fails(address: PeerAddress, timeout_s: f64) -> PeerError {
    let mut denoiser = start(address, timeout_s).unwrap();
    let error = match predict(&mut denoiser) {
        Err(DenoiserError::Process(error)) => error,
        other => panic!("{other:?}"),
    };
    let after = predict(&mut denoiser).unwrap_err();
    assert!(matches!(after, DenoiserError::Process(PeerError::Gone { .. })), "{after}");
    error
}

#[test]
fn the_example_shows_the_colors_over_pipes() {
    let made = assert_shows_colors(start(example(), PATIENT_S).unwrap(), 3);
    assert_eq!(made, assert_shows_colors(start(example(), PATIENT_S).unwrap(), 3), "it can be repeated");
}

struct Server(Child);

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn the_example_shows_the_colors_over_sockets() {
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("denoiser");
    // A stale socket of an earlier run is in the way; no process listens on it.
    drop(UnixListener::bind(&socket).unwrap());
    // A port that was free just before.
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    for argument in [format!("unix:{}", socket.display()), format!("tcp:127.0.0.1:{port}")] {
        // The client waits until the server listens.
        let server =
            Command::new("python3").arg(examples().join("denoiser.py")).arg(&argument).spawn().unwrap();
        let mut server = Server(server);
        assert_shows_colors(start(argument.parse().unwrap(), PATIENT_S).unwrap(), 1);
        assert!(server.0.wait().unwrap().success(), "it ends with the connection");
    }
}

/// Returns shape and values of a message's tensor.
fn tensor(message: &SafeTensors<'_>, name: &str) -> (Vec<usize>, Vec<f32>) {
    let tensor = message.tensor(name).unwrap();
    assert_eq!(tensor.dtype(), safetensors::Dtype::F32, "{name}");
    let values = tensor.data().chunks(4).map(|b| f32::from_le_bytes(b.try_into().unwrap()));
    (tensor.shape().to_vec(), values.collect())
}

#[test]
fn denoisers_receive_the_documented_messages() {
    let folder = tempfile::tempdir().unwrap();
    let seen = |name: &str| std::fs::read(folder.path().join(name)).unwrap();
    let lines = format!(
        "def keep(name):\n    message = source.read(*struct.unpack('<Q', source.read(8)))\n    \
         with open({:?} + '/' + name, 'wb') as f:\n        f.write(message)\n\
         keep('hello')\nsay(HELLO)\nfor call in '01':\n    keep(call)\n    \
         say({{'call': call, 'more': 'x'}}, prediction=('F32', SHAPE, bytes(576)), other=('I64', [1], \
         bytes(8)))",
        folder.path().display().to_string()
    );
    let spec = PeerSpec { address: script(folder.path(), &lines), timeout_s: PATIENT_S };
    let sampler = SamplerOptions::Ddim { prediction: Prediction::Epsilon };
    let ddim = GenerateOptions { sampler, ..options() };
    let mut denoiser = ProcessDenoiser::start(&spec, &ddim, &rig(), SIZE).unwrap();
    for _ in 0..2 {
        assert_eq!(predict(&mut denoiser).unwrap(), vec![Latent::filled(SHAPE, 0.0); 4]);
    }
    let texts =
        |bytes: &[u8]| SafeTensors::read_metadata(bytes).unwrap().1.metadata().clone().unwrap_or_default();
    let hello = texts(&seen("hello"));
    for (name, text) in [
        ("protocol", "pskel-denoiser"),
        ("version", "1"),
        ("window", "4"),
        ("views", "2"),
        ("condition_size", "16,24"),
        ("sampler", "ddim"),
        ("prediction", "epsilon"),
        ("fps", "12.5"),
        ("cameras", r#"["left","right"]"#),
        ("image_sizes", "[[1600,900],[800,450]]"),
    ] {
        assert_eq!(hello[name], text, "{name}");
    }
    assert_eq!(texts(&seen("0"))["call"], "0");
    let bytes = seen("1");
    let reported = texts(&bytes);
    let conditions: Vec<FrameConditions> = (0..4).map(conditions).collect();
    assert_eq!(reported["prompts"], r#"["frame 0, \"rain\"",["left 1",""],["left 2",""],["left 3",""]]"#);
    assert_eq!(reported["call"], "1");
    assert_eq!(reported["references"], "[true,false,false,false]");
    let message = SafeTensors::deserialize(&bytes).unwrap();
    assert_eq!(message.len(), 7);
    let all = |of: fn(&FrameConditions) -> Vec<f32>| conditions.iter().flat_map(of).collect::<Vec<f32>>();
    assert_eq!(tensor(&message, "timesteps"), (vec![4], vec![0.0, 250.0, 500.0, 750.0]));
    assert_eq!(tensor(&message, "sigmas"), (vec![4], vec![0.0, 0.25, 0.5, 0.75]));
    assert_eq!(tensor(&message, "points"), (vec![4, 2, 20, 16, 24], all(FrameConditions::points)));
    assert_eq!(tensor(&message, "layout"), (vec![4, 2, 6, 16, 24], all(FrameConditions::layout)));
    assert_eq!(tensor(&message, "action"), (vec![4, 3], all(|c| c.action.to_vec())));
    assert_eq!(tensor(&message, "cameras"), (vec![4, 2, 16], all(|c| c.cameras.concat())));
    let (shape, latents) = tensor(&message, "latents");
    assert_eq!(shape, [4, 2, 3, 2, 3]);
    use pskel_generate::NoiseSource;
    let noise = (0..4).flat_map(|frame| NOISE.clone().noise(SHAPE, frame, 0).values().to_vec());
    assert_eq!(latents, noise.collect::<Vec<f32>>());
}

/// A process that says so gets one call for both halves, another one two.
#[test]
fn guidance_takes_one_call_if_the_process_predicts_both_halves() {
    let folder = tempfile::tempdir().unwrap();
    let filled = |value: &str| format!("('F32', SHAPE, array.array('f', [{value}] * 144).tobytes())");
    let both = format!(
        "see()\nsay(HELLO | {{'guidance': 'true'}})\nfor call in '01':\n    texts, _ = see()\n    \
         assert texts['dropped'] == '[\"layout\",\"action\"]', texts\n    \
         say({{'call': call}}, prediction={}, unconditional={})",
        filled("3.0"),
        filled("1.0")
    );
    let twice = format!(
        "see()\nsay(HELLO)\nfor call in range(4):\n    texts, _ = see()\n    assert 'dropped' not in texts\
            \n    \
         assert (texts['prompts'] == '[\"\", \"\", \"\", \"\"]'.replace(' ', '')) == (call % 2 == 1), \
         texts\n    \
         say({{'call': str(call)}}, prediction={} if call % 2 == 0 else {})",
        filled("3.0"),
        filled("1.0")
    );
    for lines in [both, twice] {
        let mut denoiser = start(script(folder.path(), &lines), PATIENT_S).unwrap();
        for _ in 0..2 {
            let GuidedPrediction { conditional, unconditional } = guided(&mut denoiser).unwrap();
            assert_eq!(conditional, vec![Latent::filled(SHAPE, 3.0); 4]);
            assert_eq!(unconditional, vec![Latent::filled(SHAPE, 1.0); 4]);
        }
    }
    let one = format!("see()\nsay(HELLO | {{'guidance': 'true'}})\nsee()\nsay(prediction={})", filled("3.0"));
    let message =
        guided(&mut start(script(folder.path(), &one), PATIENT_S).unwrap()).unwrap_err().to_string();
    assert!(message.contains("a tensor `unconditional` from the denoiser, found prediction"), "{message}");
    let wrong = script(folder.path(), "see()\nsay(HELLO | {'guidance': 'yes'})\nsee()");
    let message = refused(wrong, PATIENT_S).to_string();
    assert!(
        message.contains("`guidance` \"true\" or \"false\" from the denoiser, found \"yes\""),
        "{message}"
    );
}

/// Eighths up to 18 are exact in all of these types.
#[test]
fn half_precision_numbers_are_decoded() {
    let folder = tempfile::tempdir().unwrap();
    for (dtype, pack) in [
        ("F32", "struct.pack('<f', x)"),
        ("F16", "struct.pack('<e', x)"),
        ("BF16", "struct.pack('<f', x)[2:]"),
    ] {
        let lines = format!(
            "see()\nsay(HELLO | {{'dtype': '{dtype}'}})\nsee()\n\
             say(prediction=('{dtype}', SHAPE, b''.join({pack} for x in (i / 8 for i in range(144)))))\nsee()"
        );
        let predictions = predict(&mut start(script(folder.path(), &lines), PATIENT_S).unwrap()).unwrap();
        let values: Vec<f32> = predictions.iter().flat_map(|latent| latent.values().to_vec()).collect();
        assert_eq!(values, (0..144).map(|i| i as f32 / 8.0).collect::<Vec<_>>(), "{dtype}");
    }
}
