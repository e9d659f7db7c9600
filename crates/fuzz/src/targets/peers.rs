//! Answers of planners and denoisers over a socket.

use std::cell::RefCell;
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

use image::RgbImage;
use point_skeleton::conditions::DepthBins;
use point_skeleton::dataset::LogReader;
use point_skeleton::geometry::ImageSize;
use pskel_generate::{
    Codec, Denoiser, DenoiserRig, DroppedConditions, Frame, FrameConditions, GenerateOptions, Guidance,
    Latent, Level, ProcessDenoiser, SamplerOptions, Strategy,
};
use pskel_sim::peer::{PeerAddress, PeerSpec};
use pskel_sim::{EgoPolicy, Rates, Scenario, SimOptions, Simulation};
use safetensors::tensor::{Dtype, TensorView, serialize};

use super::{LARGE, Scratch, seed};
use crate::check::short;
use crate::synthetic_log::SyntheticLog;
use crate::{Seed, Target};

pub(super) const TARGETS: [Target; 2] = [
    Target { name: "planner", run: planner, seeds: planner_seeds, max_len: 4096, memory: LARGE },
    Target { name: "denoiser", run: denoiser, seeds: denoiser_seeds, max_len: 8192, memory: LARGE },
];

/// Longer than any answer takes. It is never reached, since a connection ends with its last answer.
const TIMEOUT_S: f64 = 20.0;

/// Maximum wait of an answer for its message. After a truncated answer no message comes: the peer waits for
/// the rest of the answer.
const PATIENCE: Duration = Duration::from_millis(50);

/// Server that answers the messages of each connection.
struct Server {
    spec: PeerSpec,
    answers: Sender<Vec<Vec<u8>>>,
    _folder: Scratch,
}

impl Server {
    /// Starts a server; `read` reads one message.
    fn start(read: fn(&mut BufReader<UnixStream>) -> std::io::Result<()>) -> Self {
        let folder = Scratch::new();
        let path = folder.path("socket");
        let listener = UnixListener::bind(&path).expect("a socket");
        let (answers, received) = channel();
        std::thread::spawn(move || serve(&listener, &received, read));
        let spec = PeerSpec { address: PeerAddress::Unix(path), timeout_s: TIMEOUT_S };
        Self { spec, answers, _folder: folder }
    }

    /// Sets the answers of the next connection, one per message.
    fn next(&self, answers: Vec<Vec<u8>>) -> PeerSpec {
        self.answers.send(answers).expect("a server");
        self.spec.clone()
    }
}

fn serve(
    listener: &UnixListener,
    answers: &Receiver<Vec<Vec<u8>>>,
    read: fn(&mut BufReader<UnixStream>) -> std::io::Result<()>,
) {
    while let (Ok(answers), Ok((stream, _))) = (answers.recv(), listener.accept()) {
        let answer = |stream: UnixStream| -> std::io::Result<()> {
            stream.set_read_timeout(Some(PATIENCE))?;
            let mut reader = BufReader::new(stream.try_clone()?);
            for answer in answers {
                let _ = read(&mut reader);
                (&stream).write_all(&answer)?;
            }
            Ok(())
        };
        let _ = answer(stream); // the peer may have closed the connection
    }
}

fn read_line(reader: &mut BufReader<UnixStream>) -> std::io::Result<()> {
    reader.read_until(b'\n', &mut Vec::new()).map(|_| ())
}

fn read_counted(reader: &mut BufReader<UnixStream>) -> std::io::Result<()> {
    let mut length = [0; 8];
    reader.read_exact(&mut length)?;
    std::io::copy(&mut reader.take(u64::from_le_bytes(length)), &mut std::io::sink()).map(|_| ())
}

thread_local! {
    static PLANNER: (Server, SyntheticLog) = (Server::start(read_line), SyntheticLog::new(20));
    static DENOISER: RefCell<Server> = RefCell::new(Server::start(read_counted));
}

const HELLO: &[u8] = b"{\"protocol\": \"pskel-planner\", \"version\": 1}\n";

/// Sends the input's lines as answers; after a first byte of 0, a valid hello comes first.
fn planner(data: &[u8]) {
    PLANNER.with(|(server, synthetic)| {
        let mut answers = Vec::new();
        let lines = data.strip_prefix(&[0]).inspect(|_| answers.push(HELLO.to_vec())).unwrap_or(data);
        answers.extend(lines.split_inclusive(|byte| *byte == b'\n').take(6).map(<[u8]>::to_vec));
        let ego = EgoPolicy::External(server.next(answers));
        let rates = Some(10.0);
        let options = SimOptions { steps: 5, sim_hz: rates, plan_hz: rates, ego, ..SimOptions::default() };
        let scenario = Scenario { log: synthetic.recording(), map: None, rates: Rates::default() };
        let error = match Simulation::new(&scenario, options) {
            Err(error) => Some(error),
            Ok(mut sim) => std::iter::repeat_with(|| sim.step()).take(6).find_map(Result::err),
        };
        error.iter().for_each(|error| short(&error.to_string(), data));
    });
}

fn planner_seeds() -> Vec<Seed> {
    let plan = "{\"trajectory\": [{\"t\": 0.1, \"x\": 1000.8, \"y\": 500, \"heading\": 0, \"v\": 8}, {\"t\": \
        0.5, \
                \"x\": 1004, \"y\": 500.5, \"heading\": 0.1, \"v\": 8}]}\n";
    let ego = "{\"step\": 0, \"frame\": \"ego\", \"trajectory\": [{\"t\": 0, \"x\": 0, \"y\": 0, \
        \"heading\": 0, \"v\": 8}, \
               {\"t\": 1, \"x\": 8, \"y\": 0, \"heading\": 0, \"v\": 8}]}\n";
    vec![
        seed("plan", format!("\0{plan}{plan}")),
        seed("ego", format!("\0{ego}{}", ego.replace("\"step\": 0, ", ""))),
        seed("hello", [HELLO, plan.as_bytes()].concat()),
        seed("cut", "\0{\"trajectory\": ["),
    ]
}

const SIZE: ImageSize = ImageSize { height: 4, width: 4 };
const VIEWS: usize = 1;

fn options() -> GenerateOptions {
    GenerateOptions {
        window: 2,
        steps: 2,
        clean: 0,
        strategy: Strategy::ResetAndRoll,
        sampler: SamplerOptions::default(),
        guidance: Guidance::default(),
    }
}

/// Splits an input into messages, each after its length (two bytes). A length with its highest bit set omits
/// the protocol's eight-byte length. After a first byte of 0, a valid hello comes first.
fn messages(data: &[u8]) -> Vec<Vec<u8>> {
    let mut messages = Vec::new();
    let mut rest = data.strip_prefix(&[0]).inspect(|_| messages.push(counted(&hello(true)))).unwrap_or(data);
    while let Some((length, behind)) = rest.split_first_chunk::<2>().filter(|_| messages.len() < 6) {
        let length = u16::from_le_bytes(*length);
        let (message, others) = behind.split_at(behind.len().min(usize::from(length & 0x7fff)));
        messages.push(if length < 0x8000 { counted(message) } else { message.to_vec() });
        rest = others;
    }
    messages
}

fn counted(message: &[u8]) -> Vec<u8> {
    [&(message.len() as u64).to_le_bytes(), message].concat()
}

/// Written by hand, since the library's order of texts differs between processes.
fn hello(decodes: bool) -> Vec<u8> {
    let size = if decodes { r#","image_size":"4,4""# } else { "" };
    let texts = r#""protocol":"pskel-denoiser","version":"1","latent_shape":"1,3,2,2","dtype":"F32""#;
    let header = format!(r#"{{"__metadata__":{{{texts}{size}}}}}"#);
    counted(format!("{header:width$}", width = header.len().next_multiple_of(8)).as_bytes())
}

fn tensor(name: &str, shape: &[usize]) -> Vec<u8> {
    let bytes = vec![62; 4 * shape.iter().product::<usize>()];
    let view = TensorView::new(Dtype::F32, shape.to_vec(), &bytes).expect("a tensor");
    serialize([(name, view)], None).expect("a message")
}

fn denoiser(data: &[u8]) {
    let spec = DENOISER.with_borrow(|server| server.next(messages(data)));
    if let Err(error) = ask(&spec) {
        short(&error.to_string(), data);
    }
}

/// Requests a prediction, then encodes and decodes an image.
fn ask(spec: &PeerSpec) -> Result<(), pskel_generate::DenoiserError> {
    let rig =
        DenoiserRig { cameras: vec!["camera".to_owned(); VIEWS], image_sizes: vec![SIZE; VIEWS], fps: 5.0 };
    let mut denoiser = ProcessDenoiser::start(spec, &options(), &rig, SIZE)?;
    let shape = denoiser.shape();
    assert_eq!(shape.views, VIEWS);
    if shape.len() > 1 << 16 {
        // A hello may declare a shape up to the longest message; a request would need as much memory.
        return Ok(());
    }
    let pixels = SIZE.pixels();
    let condition = FrameConditions {
        size: SIZE,
        color: vec![[128; 3]; VIEWS * pixels],
        bins: vec![128; VIEWS * pixels],
        depth_bins: DepthBins::default(),
        boxes: vec![[128; 3]; VIEWS * pixels],
        map: vec![[128; 3]; VIEWS * pixels],
        dropped: DroppedConditions::default(),
        action: [0.0; 3],
        cameras: vec![[0.5; 16]; VIEWS],
        prompts: Default::default(),
    };
    let latent = Latent::filled(shape, 0.5);
    let frame = Frame {
        latent: &latent,
        level: Level { timestep: 500.0, sigma: 0.5 },
        is_reference: false,
        condition: &condition,
    };
    let predicted = denoiser.predict(&[frame, frame])?;
    assert!(predicted.iter().all(|p| p.shape() == shape && p.values().iter().all(|v| v.is_finite())));
    let (codec, size): (Box<dyn Codec + Send>, ImageSize) = denoiser.codec()?;
    if size.pixels() <= 1 << 16 {
        let latent = codec.encode(&[RgbImage::new(size.width, size.height)])?;
        assert_eq!(latent.shape(), shape);
        assert_eq!(codec.decode(&latent, &condition)?.len(), VIEWS);
    }
    Ok(())
}

fn denoiser_seeds() -> Vec<Seed> {
    let message = |bytes: Vec<u8>| [&(bytes.len() as u16).to_le_bytes(), bytes.as_slice()].concat();
    let prediction = || message(tensor("prediction", &[2, 1, 3, 2, 2]));
    let (latents, images) =
        (message(tensor("latents", &[1, 3, 2, 2])), message(tensor("images", &[1, 3, 4, 4])));
    vec![
        seed("all", [&[0], &prediction()[..], &latents, &images].concat()),
        seed("hello", [message(hello(false)), prediction()].concat()),
        seed("raw", [&[0, 3, 128][..], b"\x07\0\0"].concat()),
    ]
}
