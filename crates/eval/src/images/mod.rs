//! Metrics of images: quality, structure, sharpness, motion and seams between cameras.

pub(super) mod image_quality;
pub(super) mod luma;
pub(super) mod motion;
pub(super) mod seams;
pub(super) mod sharpness;
pub(super) mod ssim;
