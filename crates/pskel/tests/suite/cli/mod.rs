//! The commands, one module each or per subject.

pub(super) mod bench;
pub(super) mod build;
pub(super) mod build_resume;
pub(super) mod checksums;
pub(super) mod clips;
pub(super) mod copies;
pub(super) mod distortion;
pub(super) mod evaluate;
pub(super) mod examples;
pub(super) mod export;
pub(super) mod formats;
pub(super) mod generated;
pub(super) mod golden;
pub(super) mod images;
pub(super) mod info;
pub(super) mod outputs;
pub(super) mod protocol;
pub(super) mod rates;
pub(super) mod render;
pub(super) mod splat;
pub(super) mod templates;
pub(super) mod tensor;
