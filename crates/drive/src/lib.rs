//! `pskel drive`: a live page of a log, in which a person looks around and drives.
//!
//! # How it works
//! Two threads share a `hub`: the `engine` owns renderer and simulation, takes commands, and renders what
//! the page shows (`view`); the `server` serves the page and its clients. Between them `encode` makes JPEG or
//! PNG files of the maps while the next state is rendered. A client gets the newest frame when it has
//! acknowledged the ones before, so a slow client neither slows the simulation nor lags behind.
//! Messages: `docs/src/reference/drive.md`.

mod encode;
mod engine;
mod error;
mod frame;
mod generated;
mod hub;
mod inputs;
mod message;
mod options;
mod server;
mod view;

use std::net::TcpListener;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::channel;

pub use error::DriveError;
pub use inputs::{Inputs, LiveGenerator, OpenGenerator};
pub use options::DriveOptions;

use crate::hub::Hub;
use crate::message::ServerMessage;
use crate::server::Gate;

/// Reports progress while log and skeleton are opened: what is done, and how many steps of how many.
pub type Progress<'p> = dyn Fn(&str, usize, usize) + Sync + 'p;

/// Serves a live page until `stop` is set. The page is there at once; `open` opens log and skeleton
/// meanwhile, and its progress is shown. `ready` is called with the address of the page, which contains a
/// secret token.
///
/// # Errors
/// Fails if the address cannot be listened on, if `open` fails, or if rendering fails.
pub fn serve(
    options: &DriveOptions,
    open: impl FnOnce(&Progress<'_>) -> Result<Inputs, DriveError> + Send,
    ready: impl FnOnce(&str),
    stop: &AtomicBool,
) -> Result<(), DriveError> {
    let listen = |source| DriveError::Listen { address: options.address, source };
    let listener = TcpListener::bind(options.address).map_err(listen)?;
    let address = listener.local_addr().map_err(listen)?;
    let gate = Gate::new(address)?;
    let url = format!("http://{address}/?token={}", gate.token());
    let (sender, commands) = channel();
    let hub = Arc::new(Hub::new(sender));
    std::thread::scope(|scope| {
        let for_engine = Arc::clone(&hub);
        let engine = scope.spawn(move || {
            let hub = &*for_engine;
            let progress = |what: &str, done: usize, of: usize| {
                hub.tell(None, ServerMessage::Progress { what, done, of }.json());
            };
            let result =
                open(&progress).and_then(|inputs| engine::run(inputs, options, hub, &commands, stop));
            stop.store(true, Ordering::Relaxed); // without the engine there is nothing to serve
            result
        });
        ready(&url);
        let served = server::serve(listener, hub, gate, options.out.clone(), stop);
        stop.store(true, Ordering::Relaxed);
        let result = engine.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        result.and(served.map_err(DriveError::Server))
    })
}
