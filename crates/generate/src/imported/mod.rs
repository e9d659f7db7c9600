//! Images of other programs as the generated images of a rollout.
//!
//! # How it works
//! [`ImageFolder`] lists the files of a folder. [`ImageFolder::clip`] finds the images of a clip's frames and
//! cameras by their names (`names`, `matching`) and counts those that are missing, doubled or of another
//! size (`counts`). The result, [`ClipImages`], starts an [`ImportSession`], which takes the place of a
//! generator in a rollout. `export` writes the generated images of rollouts in the same layouts.

pub(super) mod counts;
pub(super) mod export;
pub(super) mod folder;
pub(super) mod matching;
mod names;
pub(super) mod session;
