//! A server in another thread, and a client of it.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::channel;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use point_skeleton::raster::{RasterizerDesc, RasterizerKind};
use point_skeleton::{Log, Skeleton};
use pskel_drive::{DriveError, DriveOptions, Inputs, LiveGenerator, serve};
use pskel_sim::Rates;
use pskel_testing::six_cameras;
use serde_json::{Value, json};
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message, WebSocket, client};

/// Time in which a message must come.
const PATIENCE: Duration = Duration::from_secs(60);

/// A running server of the log with six cameras.
pub(crate) struct Server {
    pub(crate) scratch: tempfile::TempDir,
    pub(crate) address: String,
    pub(crate) token: String,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<Result<(), DriveError>>>,
}

/// A frame: its header, and the images in it.
pub(crate) struct Frame {
    pub(crate) header: Value,
    images: Vec<u8>,
}

/// A connected client.
pub(crate) struct Client {
    pub(crate) socket: WebSocket<TcpStream>,
    pub(crate) hello: Value,
    /// Text messages that nobody has asked for yet.
    pub(crate) texts: Vec<Value>,
}

/// Returns the written log and its skeleton in a folder.
pub(crate) fn inputs(folder: &Path, generator: Option<LiveGenerator>) -> Inputs {
    let root = folder.join("log");
    six_cameras::copy_to(&root, |_| true);
    let name = format!("nuscenes:{}", root.display());
    let log = Log::open(&name).unwrap();
    let skeleton_path = folder.join("skeleton");
    let skeleton = Skeleton::build(&log, &skeleton_path, &Default::default()).unwrap();
    let rates = Rates { sim_hz: 10.0, plan_hz: 5.0 };
    Inputs {
        log,
        scenario: Default::default(),
        log_name: name,
        log_arguments: Vec::new(),
        skeleton,
        skeleton_path,
        rates,
        generator,
    }
}

impl Server {
    pub(crate) fn start() -> Self {
        Self::with_generator(None)
    }

    pub(crate) fn with_generator(generator: Option<LiveGenerator>) -> Self {
        let scratch = tempfile::tempdir().unwrap();
        let rasterizer = RasterizerDesc { kind: RasterizerKind::Cpu, ..RasterizerDesc::default() };
        let options = DriveOptions {
            address: "127.0.0.1:0".parse().unwrap(),
            out: scratch.path().join("out"),
            rasterizer,
            templates: None,
        };
        let (sender, url) = channel();
        let (stop, folder) = (Arc::new(AtomicBool::new(false)), scratch.path().to_owned());
        let flag = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            serve(
                &options,
                |_| Ok(inputs(&folder, generator)),
                |url| sender.send(url.to_owned()).unwrap(),
                &flag,
            )
        });
        let url = url.recv_timeout(PATIENCE).unwrap();
        let (address, token) = url.strip_prefix("http://").unwrap().split_once("/?token=").unwrap();
        let (address, token) = (address.to_owned(), token.to_owned());
        Self { scratch, address, token, stop, thread: Some(thread) }
    }

    /// Returns the folder of saved drives.
    pub(crate) fn out(&self) -> PathBuf {
        self.scratch.path().join("out")
    }

    /// Asks for a WebSocket with some headers.
    pub(crate) fn ask(
        &self,
        path: &str,
        headers: &[(&str, &str)],
    ) -> Result<WebSocket<TcpStream>, tungstenite::Error> {
        let stream = TcpStream::connect(&self.address).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let mut request = format!("ws://{}{path}", self.address).into_client_request().unwrap();
        for (name, value) in headers {
            let name: tungstenite::http::HeaderName = name.parse().unwrap();
            request.headers_mut().insert(name, value.parse().unwrap());
        }
        client(request, stream).map(|(socket, _)| socket).map_err(|error| match error {
            tungstenite::HandshakeError::Failure(error) => error,
            tungstenite::HandshakeError::Interrupted(_) => panic!("interrupted"),
        })
    }

    /// Connects a client.
    pub(crate) fn connect(&self) -> Client {
        let socket = self.ask(&format!("/live?token={}", self.token), &[]).unwrap();
        let mut client = Client { socket, hello: Value::Null, texts: Vec::new() };
        client.hello = client.text("hello");
        client
    }

    /// Sends a GET request. Returns status and body.
    pub(crate) fn get(&self, path: &str, headers: &str) -> (u16, Vec<u8>) {
        let mut stream = TcpStream::connect(&self.address).unwrap();
        let host =
            if headers.contains("Host:") { String::new() } else { format!("Host: {}\r\n", self.address) };
        let request = format!("GET {path} HTTP/1.1\r\n{host}{headers}Connection: close\r\n\r\n");
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        let end = answer.windows(4).position(|w| w == b"\r\n\r\n").unwrap();
        let status = std::str::from_utf8(&answer[9..12]).unwrap().parse().unwrap();
        (status, answer[end + 4..].to_vec())
    }

    /// Ends the server, and returns its result.
    pub(crate) fn end(mut self) -> Result<(), DriveError> {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.take().unwrap().join().unwrap()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

impl Client {
    pub(crate) fn send(&mut self, message: &Value) {
        self.socket.send(Message::text(message.to_string())).unwrap();
    }

    /// Returns the next text message of a type; frames before it are acknowledged.
    pub(crate) fn text(&mut self, kind: &str) -> Value {
        if let Some(place) = self.texts.iter().position(|text| text["type"] == kind) {
            return self.texts.remove(place);
        }
        let start = Instant::now();
        while start.elapsed() < PATIENCE {
            match self.socket.read().unwrap() {
                Message::Text(text) => {
                    let text: Value = serde_json::from_str(&text).unwrap();
                    if text["type"] == kind {
                        return text;
                    }
                    self.texts.push(text);
                }
                Message::Binary(bytes) => drop(self.unpack(&bytes)),
                _ => {}
            }
        }
        panic!("no message {kind}; notices: {:?}", self.texts);
    }

    /// Returns the next frame, and acknowledges it.
    pub(crate) fn frame(&mut self) -> Frame {
        let start = Instant::now();
        while start.elapsed() < PATIENCE {
            match self.socket.read().unwrap() {
                Message::Binary(bytes) => return self.unpack(&bytes),
                Message::Text(text) => self.texts.push(serde_json::from_str(&text).unwrap()),
                _ => {}
            }
        }
        panic!("no frame; notices: {:?}", self.texts);
    }

    /// Returns the first frame that has a property.
    pub(crate) fn frame_with(&mut self, is_wanted: impl Fn(&Value) -> bool) -> Frame {
        let start = Instant::now();
        loop {
            let frame = self.frame();
            if is_wanted(&frame.header) {
                return frame;
            }
            assert!(start.elapsed() < PATIENCE, "{}; {:?}", frame.header, self.texts);
        }
    }

    fn unpack(&mut self, bytes: &[u8]) -> Frame {
        let length = u32::from_le_bytes(bytes[..4].try_into().unwrap()) as usize;
        let header: Value = serde_json::from_slice(&bytes[4..4 + length]).unwrap();
        self.send(&json!({"type": "ack", "frame": header["frame"]}));
        let images = bytes[4 + length..].to_vec();
        let sizes = header["images"].as_array().unwrap().iter().map(|image| image["bytes"].as_u64().unwrap());
        assert_eq!(sizes.sum::<u64>(), images.len() as u64);
        Frame { header, images }
    }
}

impl Frame {
    /// Returns the file of a camera's map.
    pub(crate) fn image(&self, camera: &str, map: &str) -> Option<&[u8]> {
        let mut start = 0;
        for image in self.header["images"].as_array()? {
            let bytes = image["bytes"].as_u64()? as usize;
            if image["camera"] == camera && image["map"] == map {
                return Some(&self.images[start..start + bytes]);
            }
            start += bytes;
        }
        None
    }
}
