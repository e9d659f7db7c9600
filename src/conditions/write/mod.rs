//! Writers of condition maps: PNG, EXR, NPZ and safetensors files, and the metadata beside them.

pub(super) mod arrays;
#[cfg(feature = "exr")]
pub mod exr;
pub(super) mod format;
pub mod meta;
pub mod npz;
pub mod png;
pub mod safetensors;
#[cfg(test)]
pub(super) mod test_set;
