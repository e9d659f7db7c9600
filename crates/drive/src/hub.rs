//! What engine and clients share: the newest frame, messages to clients, and who drives.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::Sender;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use axum::body::Bytes;
use axum::extract::ws::Utf8Bytes;
use tokio::sync::{broadcast, watch};

use crate::generated::Made;
use crate::message::{Command, ServerMessage};

/// Number of messages that a client can be behind before it misses some.
const MESSAGES: usize = 256;

/// Number of a client.
pub(crate) type ClientId = u64;

/// Frame ready to be sent.
#[derive(Clone, Debug)]
pub(crate) struct Frame {
    pub(crate) number: u64,
    pub(crate) bytes: Bytes,
}

/// Input of the engine.
pub(crate) enum Input {
    /// Command of a client.
    Command(ClientId, Command),
    /// A client can take a frame again, or a new one is there.
    Room,
    /// Asks for a map of the present state.
    Picture(Picture),
    /// Answer of the generator.
    Generated(Made),
}

/// Request of a map at the size of the recorded camera.
pub(crate) struct Picture {
    pub(crate) camera: String,
    pub(crate) map: String,
    /// Receives the PNG file, or one line.
    pub(crate) reply: tokio::sync::oneshot::Sender<Result<Vec<u8>, String>>,
}

/// Text message to one client, or to all.
#[derive(Clone, Debug)]
pub(crate) struct Note {
    pub(crate) to: Option<ClientId>,
    pub(crate) text: Utf8Bytes,
}

/// Shared by engine and clients.
pub(crate) struct Hub {
    frames: watch::Sender<Option<Arc<Frame>>>,
    notes: broadcast::Sender<Note>,
    /// First message to a client, once the engine is ready.
    hello: watch::Sender<Option<Utf8Bytes>>,
    engine: Mutex<Sender<Input>>,
    clients: Mutex<Clients>,
    next: AtomicU64,
}

/// Clients in the order of their arrival.
#[derive(Default)]
struct Clients {
    all: Vec<Client>,
    driver: Option<ClientId>,
}

struct Client {
    id: ClientId,
    /// Frames sent and not yet acknowledged.
    in_flight: usize,
}

/// Maximum number of frames that a client has not acknowledged.
pub(crate) const MAX_IN_FLIGHT: usize = 2;

impl Hub {
    pub(crate) fn new(engine: Sender<Input>) -> Self {
        Self {
            frames: watch::Sender::new(None),
            notes: broadcast::Sender::new(MESSAGES),
            hello: watch::Sender::new(None),
            engine: Mutex::new(engine),
            clients: Mutex::default(),
            next: AtomicU64::new(1),
        }
    }

    fn clients(&self) -> MutexGuard<'_, Clients> {
        self.clients.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Passes an input to the engine; nothing happens once it has ended.
    pub(crate) fn input(&self, input: Input) {
        let _ = self.engine.lock().unwrap_or_else(PoisonError::into_inner).send(input);
    }

    /// Adds a client; the first one drives. `None` if there are too many.
    pub(crate) fn join(&self, most: usize) -> Option<ClientId> {
        let mut clients = self.clients();
        if clients.all.len() >= most {
            return None;
        }
        let id = self.next.fetch_add(1, Ordering::Relaxed);
        clients.all.push(Client { id, in_flight: 0 });
        clients.driver.get_or_insert(id);
        drop(clients);
        self.tell_who();
        self.input(Input::Room);
        Some(id)
    }

    /// Removes a client; if it drove, the one that has waited longest drives.
    pub(crate) fn leave(&self, id: ClientId) {
        let mut clients = self.clients();
        clients.all.retain(|client| client.id != id);
        if clients.driver == Some(id) {
            clients.driver = clients.all.first().map(|client| client.id);
        }
        drop(clients);
        self.tell_who();
        self.input(Input::Room);
    }

    /// Gives the wheel to a client, or takes it from it.
    pub(crate) fn drive(&self, id: ClientId, take: bool) {
        let mut clients = self.clients();
        if take {
            clients.driver = Some(id);
        } else if clients.driver == Some(id) {
            clients.driver = None;
        }
        drop(clients);
        self.tell_who();
    }

    /// Returns whether a client drives; one that asks while nobody does drives from then on.
    pub(crate) fn may_drive(&self, id: ClientId) -> bool {
        let mut clients = self.clients();
        let is_new = clients.driver.is_none();
        let drives = *clients.driver.get_or_insert(id) == id;
        drop(clients);
        if is_new {
            self.tell_who();
        }
        drives
    }

    /// Tells each client whether it drives.
    fn tell_who(&self) {
        let clients = self.clients();
        let (ids, driver): (Vec<ClientId>, _) = (clients.all.iter().map(|c| c.id).collect(), clients.driver);
        drop(clients);
        for id in &ids {
            let who = ServerMessage::Who { you_drive: driver == Some(*id), clients: ids.len() };
            self.tell(Some(*id), who.json());
        }
    }

    /// Returns the number of clients.
    pub(crate) fn count(&self) -> usize {
        self.clients().all.len()
    }

    /// Changes the number of frames that a client has not acknowledged, and returns it.
    pub(crate) fn in_flight(&self, id: ClientId, change: impl FnOnce(usize) -> usize) -> usize {
        let mut clients = self.clients();
        let Some(client) = clients.all.iter_mut().find(|client| client.id == id) else { return 0 };
        let before = client.in_flight;
        client.in_flight = change(before);
        let after = client.in_flight;
        drop(clients);
        if before >= MAX_IN_FLIGHT && after < MAX_IN_FLIGHT {
            self.input(Input::Room);
        }
        after
    }

    /// Returns whether a client can take a frame.
    pub(crate) fn has_room(&self) -> bool {
        self.clients().all.iter().any(|client| client.in_flight < MAX_IN_FLIGHT)
    }

    /// Makes a frame the newest one.
    pub(crate) fn publish(&self, number: u64, bytes: Vec<u8>) {
        self.frames.send_replace(Some(Arc::new(Frame { number, bytes: bytes.into() })));
    }

    /// Sends a message to a client, or to all.
    pub(crate) fn tell(&self, to: Option<ClientId>, text: String) {
        let _ = self.notes.send(Note { to, text: text.into() }); // without clients nobody listens
    }

    /// Sets the first message to clients.
    pub(crate) fn set_hello(&self, text: String) {
        self.hello.send_replace(Some(text.into()));
    }

    pub(crate) fn frames(&self) -> watch::Receiver<Option<Arc<Frame>>> {
        self.frames.subscribe()
    }

    pub(crate) fn notes(&self) -> broadcast::Receiver<Note> {
        self.notes.subscribe()
    }

    pub(crate) fn hello(&self) -> watch::Receiver<Option<Utf8Bytes>> {
        self.hello.subscribe()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_client_drives() {
        let (sender, inputs) = std::sync::mpsc::channel();
        let hub = Hub::new(sender);
        let [a, b] = [0; 2].map(|_| hub.join(2).unwrap());
        assert!(hub.join(2).is_none() && hub.count() == 2);
        assert!(hub.may_drive(a) && !hub.may_drive(b));
        hub.drive(b, true);
        assert!(!hub.may_drive(a) && hub.may_drive(b));
        hub.drive(a, false); // does not drive
        assert!(hub.may_drive(b));
        hub.leave(b);
        assert!(hub.may_drive(a));
        drop(inputs);
        hub.input(Input::Room); // the engine has ended
    }

    #[test]
    fn clients_have_room_for_two_frames() {
        let (sender, inputs) = std::sync::mpsc::channel();
        let hub = Hub::new(sender);
        assert!(!hub.has_room());
        let id = hub.join(9).unwrap();
        assert_eq!([0; 2].map(|_| hub.in_flight(id, |n| n + 1)), [1, 2]);
        assert!(!hub.has_room());
        let before = inputs.try_iter().count();
        assert_eq!((before, hub.in_flight(id, |n| n.saturating_sub(1))), (1, 1));
        assert!(hub.has_room() && inputs.try_iter().count() == 1);
    }
}
