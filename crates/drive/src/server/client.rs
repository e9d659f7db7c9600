//! A client: its messages to the engine, and frames to it, as fast as it acknowledges them.

use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::extract::ws::{CloseFrame, Message, WebSocket};
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::RecvError;
use tokio::time::{interval, timeout};

use crate::hub::{ClientId, Frame, Hub, Input, MAX_IN_FLIGHT, Note};
use crate::message::{ClientMessage, Command, ServerMessage};

/// Maximum number of clients at a time.
const MAX_CLIENTS: usize = 32;
/// Maximum number of messages that are not understood.
const MAX_WRONG: u32 = 10;
/// Messages per second on average, and at once.
const MESSAGES: [f64; 2] = [200.0, 400.0];
/// Time in which a client must take a message.
const PATIENCE: Duration = Duration::from_secs(30);
/// Codes of RFC 6455: policy violated, try again later.
const POLICY: u16 = 1008;
const LATER: u16 = 1013;

/// A connected client.
struct Client<'h> {
    id: ClientId,
    hub: &'h Hub,
    socket: WebSocket,
    /// Number of the last frame that was sent, or of the newest when the client came.
    last: u64,
    sent: u64,
    dropped: u64,
    wrong: u32,
    allowance: f64,
    since: Instant,
}

/// Why a connection ends.
struct Gone;

/// Serves a client until it leaves.
pub(super) async fn serve(mut socket: WebSocket, hub: Arc<Hub>) {
    let notes = hub.notes(); // before it joins: it is told then whether it drives
    let Some(id) = hub.join(MAX_CLIENTS) else {
        let frame = CloseFrame { code: LATER, reason: "too many clients".into() };
        let _ = socket.send(Message::Close(Some(frame))).await; // it may have left
        return;
    };
    let mut client = Client {
        id,
        hub: &hub,
        socket,
        last: 0,
        sent: 0,
        dropped: 0,
        wrong: 0,
        allowance: MESSAGES[1],
        since: Instant::now(),
    };
    let _ = client.run(notes).await; // either way the client has left
    hub.leave(id);
}

impl Client<'_> {
    async fn run(&mut self, mut notes: Receiver<Note>) -> Result<(), Gone> {
        let (mut frames, mut hello) = (self.hub.frames(), self.hub.hello());
        let mut seconds = interval(Duration::from_secs(1));
        hello.mark_changed();
        let mut is_greeted = false;
        loop {
            tokio::select! {
                message = self.socket.recv() => self.receive(message.ok_or(Gone)?.map_err(|_| Gone)?).await?,
                note = notes.recv() => match note {
                    Ok(note) if note.to.is_none_or(|to| to == self.id) => {
                        self.send(Message::Text(note.text)).await?;
                    }
                    Ok(_) | Err(RecvError::Lagged(_)) => {}
                    Err(RecvError::Closed) => return Err(Gone),
                },
                changed = hello.changed(), if !is_greeted => {
                    changed.map_err(|_| Gone)?;
                    let text = hello.borrow_and_update().clone();
                    if let Some(text) = text {
                        is_greeted = true;
                        self.send(Message::Text(text)).await?;
                        let newest = self.newest();
                        self.last = newest.as_ref().map_or(0, |frame| frame.number.saturating_sub(1));
                        self.offer().await?;
                    }
                }
                changed = frames.changed(), if is_greeted => {
                    changed.map_err(|_| Gone)?;
                    frames.mark_unchanged();
                    self.offer().await?;
                }
                _ = seconds.tick(), if is_greeted => {
                    let counts = ServerMessage::Counts {
                        sent: self.sent,
                        dropped: self.dropped,
                        clients: self.hub.count(),
                    };
                    self.send(Message::Text(counts.json().into())).await?;
                }
            }
        }
    }

    fn newest(&self) -> Option<Arc<Frame>> {
        self.hub.frames().borrow().clone()
    }

    /// Sends the newest frame if the client has not had it and can take one.
    async fn offer(&mut self) -> Result<(), Gone> {
        let Some(frame) = self.newest().filter(|frame| frame.number > self.last) else { return Ok(()) };
        if self.hub.in_flight(self.id, |n| n) >= MAX_IN_FLIGHT {
            return Ok(());
        }
        self.hub.in_flight(self.id, |n| n + 1);
        self.dropped += frame.number - self.last - 1;
        (self.last, self.sent) = (frame.number, self.sent + 1);
        self.send(Message::Binary(frame.bytes.clone())).await
    }

    async fn send(&mut self, message: Message) -> Result<(), Gone> {
        timeout(PATIENCE, self.socket.send(message)).await.map_err(|_| Gone)?.map_err(|_| Gone)
    }

    async fn receive(&mut self, message: Message) -> Result<(), Gone> {
        let text = match &message {
            Message::Text(text) => text.as_str(),
            Message::Close(_) => return Err(Gone),
            Message::Ping(_) | Message::Pong(_) => return Ok(()),
            Message::Binary(_) => return self.refuse("expected a text message, found a binary one").await,
        };
        let (now, [rate, most]) = (Instant::now(), MESSAGES);
        self.allowance = (self.allowance + rate * (now - self.since).as_secs_f64()).min(most) - 1.0;
        self.since = now;
        if self.allowance < 0.0 {
            return self.close("expected at most 200 messages per second, found more").await;
        }
        match serde_json::from_str(text) {
            Ok(ClientMessage::Ack {}) => {
                self.hub.in_flight(self.id, |n| n.saturating_sub(1));
                self.offer().await
            }
            Ok(ClientMessage::Drive { take }) => {
                self.hub.drive(self.id, take);
                Ok(())
            }
            Ok(ClientMessage::Command(command)) => self.pass(command).await,
            Err(_) => {
                let found: String = text.chars().filter(|c| !c.is_control()).take(60).collect();
                self.refuse(&format!("expected a message of the page, found {found:?}")).await
            }
        }
    }

    /// Passes a command to the engine; commands of watchers are refused, except questions.
    async fn pass(&mut self, command: Command) -> Result<(), Gone> {
        if !matches!(command, Command::Pick(_)) && !self.hub.may_drive(self.id) {
            let text = "another window drives: take the wheel there, or ask for it here";
            return self.notice(text).await;
        }
        self.hub.input(Input::Command(self.id, command));
        Ok(())
    }

    async fn notice(&mut self, text: &str) -> Result<(), Gone> {
        let notice = ServerMessage::Notice { level: "error", text };
        self.send(Message::Text(notice.json().into())).await
    }

    /// Answers a message that is not understood; too many of them end the connection.
    async fn refuse(&mut self, text: &str) -> Result<(), Gone> {
        self.wrong += 1;
        if self.wrong > MAX_WRONG {
            return self.close("too many messages that are not understood").await;
        }
        self.notice(text).await
    }

    async fn close(&mut self, reason: &'static str) -> Result<(), Gone> {
        let frame = CloseFrame { code: POLICY, reason: reason.into() };
        let _ = self.send(Message::Close(Some(frame))).await; // it leaves either way
        Err(Gone)
    }
}
