use point_skeleton::error::FileError;

/// Error of a live page.
#[derive(Debug, thiserror::Error)]
pub enum DriveError {
    /// The log has no frames or no cameras.
    #[error("expected frames and cameras in log {log}, found none: nothing can be shown")]
    Nothing {
        /// Name of the log.
        log: String,
    },
    /// The server cannot listen.
    #[error(
        "cannot listen on {address}: {source}; another port is chosen with --port, any free one without it"
    )]
    Listen {
        /// Address.
        address: std::net::SocketAddr,
        /// Reason.
        source: std::io::Error,
    },
    /// The operating system has no random numbers for the token.
    #[error("cannot create a token: no random numbers from the operating system")]
    Token,
    /// Rendering failed.
    #[error(transparent)]
    Render(point_skeleton::Error),
    /// A file cannot be read or written.
    #[error(transparent)]
    File(#[from] FileError),
    /// The log or its skeleton cannot be opened.
    #[error(transparent)]
    Open(Box<dyn std::error::Error + Send + Sync>),
    /// The thread that encodes images has ended.
    #[error("the thread that encodes images has ended")]
    Encoder,
    /// The server has failed.
    #[error("the server has failed: {0}")]
    Server(std::io::Error),
}
