//! Distances between distributions of image features.

pub(super) mod conv_net;
pub(super) mod features;
pub(super) mod frechet;
