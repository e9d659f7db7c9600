//! Closed-loop simulation.

mod actors;
mod course;
mod external;
mod local_path;
pub(crate) mod made;
mod replay;
mod resume;
