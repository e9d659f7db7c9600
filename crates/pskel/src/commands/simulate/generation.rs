//! The generator of `pskel simulate`. Without the feature `network` there is none.

#[cfg(feature = "network")]
mod with_network;
#[cfg(not(feature = "network"))]
mod without_network;

#[cfg(feature = "network")]
pub(crate) use with_network::{GeneratorArgs, GivenImages, Opened};
#[cfg(not(feature = "network"))]
pub(crate) use without_network::{GeneratorArgs, GivenImages, Opened};
