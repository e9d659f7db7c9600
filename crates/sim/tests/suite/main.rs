//! Tests of simulations by their public interface, one module per subject.
#![allow(clippy::unwrap_used)] // helpers outside `#[test]`

mod actors;
mod agreement;
mod course;
mod external;
mod families;
mod live;
mod local_path;
mod pdm;
mod peer_ends;
mod replay;
mod resume;
mod scenario;
mod scenario_files;
