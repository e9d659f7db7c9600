//! HTTP and WebSocket server of the page.
//!
//! # How it works
//! One thread serves all connections. `gate` decides who may connect, `assets` has the page, `client` serves
//! one WebSocket. Nothing here knows of skeletons: requests become inputs of the engine.

mod assets;
mod client;
mod files;
mod gate;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use axum::Router;
use axum::extract::ws::WebSocketUpgrade;
use axum::extract::{Path, Query, State};
use axum::http::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, REFERRER_POLICY, SET_COOKIE};
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use serde::Deserialize;
use tokio::net::TcpListener;

pub(crate) use self::gate::Gate;
use crate::hub::{Hub, Input, Picture};

/// Maximum size of a message of a client.
const MAX_MESSAGE: usize = 16 << 10;
/// Time between looks at the flag that ends the server.
const TICK: Duration = Duration::from_millis(50);
/// What the page may load: its own files, and images in memory.
const POLICY: &str = "default-src 'self'; img-src 'self' blob: data:; style-src 'self' 'unsafe-inline'; \
    media-src 'self' blob:; base-uri 'none'; form-action 'none'";

/// Shared by all requests.
#[derive(Clone)]
struct Site {
    hub: Arc<Hub>,
    gate: Arc<Gate>,
    /// Folder of saved drives.
    out: Arc<PathBuf>,
}

#[derive(Deserialize)]
struct Token {
    token: Option<String>,
}

#[derive(Deserialize)]
struct PictureQuery {
    camera: String,
    map: String,
    token: Option<String>,
}

/// Serves until `stop` is set.
///
/// # Errors
/// Fails if connections cannot be accepted.
pub(crate) fn serve(
    listener: std::net::TcpListener,
    hub: Arc<Hub>,
    gate: Gate,
    out: PathBuf,
    stop: &AtomicBool,
) -> std::io::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    listener.set_nonblocking(true)?;
    let site = Site { hub, gate: Arc::new(gate), out: Arc::new(out) };
    let app = Router::new()
        .route("/", get(index))
        .route("/page/{name}", get(asset))
        .route("/live", get(live))
        .route("/picture", get(picture))
        .route("/rollouts/{*path}", get(rollout))
        .with_state(site);
    runtime.block_on(async {
        let listener = TcpListener::from_std(listener)?;
        tokio::select! {
            served = async { axum::serve(listener, app).await } => served,
            () = stopped(stop) => Ok(()),
        }
    })
    // Open connections end with the runtime.
}

async fn stopped(stop: &AtomicBool) {
    while !stop.load(Ordering::Relaxed) {
        tokio::time::sleep(TICK).await;
    }
}

async fn index(State(site): State<Site>, Query(query): Query<Token>, headers: HeaderMap) -> Response {
    if let Err(refusal) = site.gate.check(&headers, query.token.as_deref()) {
        return refusal.into_response();
    }
    let headers = [
        (CONTENT_TYPE, "text/html; charset=utf-8".to_owned()),
        (CONTENT_SECURITY_POLICY, POLICY.to_owned()),
        (REFERRER_POLICY, "no-referrer".to_owned()),
        (CACHE_CONTROL, "no-store".to_owned()),
        (SET_COOKIE, site.gate.cookie()),
    ];
    (headers, assets::INDEX).into_response()
}

async fn asset(State(site): State<Site>, Path(name): Path<String>, headers: HeaderMap) -> Response {
    if let Err(refusal) = site.gate.check_origin(&headers) {
        return refusal.into_response();
    }
    match assets::find(&name) {
        Some((kind, text)) => ([(CONTENT_TYPE, kind), (CACHE_CONTROL, "no-store")], text).into_response(),
        None => StatusCode::NOT_FOUND.into_response(),
    }
}

async fn live(
    State(site): State<Site>,
    Query(query): Query<Token>,
    headers: HeaderMap,
    upgrade: WebSocketUpgrade,
) -> Response {
    if let Err(refusal) = site.gate.check(&headers, query.token.as_deref()) {
        return refusal.into_response();
    }
    let upgrade = upgrade.max_message_size(MAX_MESSAGE).max_frame_size(MAX_MESSAGE);
    upgrade.on_upgrade(move |socket| client::serve(socket, site.hub))
}

/// Returns a map of the present state at the size of the recorded camera, as PNG.
async fn picture(
    State(site): State<Site>,
    Query(query): Query<PictureQuery>,
    headers: HeaderMap,
) -> Response {
    if let Err(refusal) = site.gate.check(&headers, query.token.as_deref()) {
        return refusal.into_response();
    }
    let (reply, answer) = tokio::sync::oneshot::channel();
    site.hub.input(Input::Picture(Picture { camera: query.camera, map: query.map, reply }));
    match answer.await {
        Ok(Ok(bytes)) => ([(CONTENT_TYPE, "image/png"), (CACHE_CONTROL, "no-store")], bytes).into_response(),
        Ok(Err(text)) => (StatusCode::BAD_REQUEST, text).into_response(),
        Err(_) => (StatusCode::SERVICE_UNAVAILABLE, "the engine has ended").into_response(),
    }
}

/// Returns a file of a saved drive.
async fn rollout(
    State(site): State<Site>,
    Query(query): Query<Token>,
    Path(path): Path<String>,
    headers: HeaderMap,
) -> Response {
    if let Err(refusal) = site.gate.check(&headers, query.token.as_deref()) {
        return refusal.into_response();
    }
    match files::read(&site.out, &path) {
        Some((kind, bytes)) => ([(CONTENT_TYPE, kind)], bytes).into_response(),
        None => StatusCode::NOT_FOUND.into_response(),
    }
}
