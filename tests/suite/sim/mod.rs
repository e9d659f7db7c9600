//! The closed loop.

mod actors;
mod course;
mod external;
mod local_path;
mod made;
mod replay;
mod resume;
