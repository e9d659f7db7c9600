use point_skeleton::conditions::ConditionError;
use point_skeleton::dataset::DatasetError;
use point_skeleton::error::FileError;
use point_skeleton::files::text::printable;
use point_skeleton::skeleton::BuildError;
use point_skeleton::threads::ThreadError;
#[cfg(feature = "video")]
use pskel_sim::report::VideoError;

/// Error of an export.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// Error of a file.
    #[error(transparent)]
    File(#[from] FileError),
    /// Error of a log.
    #[error(transparent)]
    Log(#[from] DatasetError),
    /// Error of building a skeleton.
    #[error(transparent)]
    Build(#[from] BuildError),
    /// Error of rendering.
    #[error(transparent)]
    Render(#[from] point_skeleton::Error),
    /// A thread could not be started.
    #[error(transparent)]
    Threads(#[from] ThreadError),
    /// Error of encoding maps.
    #[error(transparent)]
    Conditions(#[from] ConditionError),
    /// Error of encoding a video.
    #[cfg(feature = "video")]
    #[error(transparent)]
    Video(#[from] VideoError),
    /// Options that contradict each other.
    #[error("expected {expected}, found {found}")]
    Options {
        /// What the other options require.
        expected: &'static str,
        /// The given option.
        found: &'static str,
    },
    /// Two logs have one name; shards are named after logs.
    #[error("expected logs whose names differ as file names, found {name} twice")]
    SameName {
        /// The name.
        name: String,
    },
    /// Two logs have one scene number in a layout that numbers them by their names.
    #[error(
        "expected logs whose names differ in their digits, which number scenes, found {name} and {other}"
    )]
    SameScene {
        /// Name of a log.
        name: String,
        /// Name of the other one.
        other: String,
    },
    /// A log of the validation split is not exported.
    #[error("expected names of exported logs for the validation split, found {}", printable(name))]
    NoLog {
        /// The given name.
        name: String,
    },
    /// The progress callback requested a stop.
    #[error("export cancelled")]
    Stopped,
    /// The log lacks something that the layout needs.
    #[error("expected {expected} in log {}, found {found}", printable(log))]
    Lacks {
        /// What the layout needs.
        expected: &'static str,
        /// What the log has.
        found: String,
        /// Name of the log.
        log: String,
    },
}
