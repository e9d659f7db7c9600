use image::RgbImage;

/// A step of a rollout. All slices have one entry per camera, in the same order. All images, maps and masks
/// of a camera have the size of its generated image; maps and masks are row by row.
#[derive(Clone, Copy, Debug)]
pub struct ScoredFrame<'a> {
    /// Time of the step, seconds.
    pub t_s: f64,
    /// Generated images.
    pub generated: &'a [RgbImage],
    /// Ground-truth images, if available.
    pub truth: Option<&'a [RgbImage]>,
    /// Class maps.
    pub class: Option<&'a [Vec<u8>]>,
    /// Masks of moving actors; see [`moving_mask`](crate::moving_mask).
    pub moving: Option<&'a [Vec<bool>]>,
    /// Masks of vehicles in the generated images by a segmentation model, compared with the class maps.
    pub masks: Option<&'a [Vec<bool>]>,
}

/// Error of a step that cannot be scored.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ScoreError {
    /// Wrong number of cameras.
    #[error("expected {what} of {expected} cameras, found {found}")]
    Cameras {
        /// Kind of the input.
        what: &'static str,
        /// Number of generated images, or of cameras in the previous step.
        expected: usize,
        /// Number given.
        found: usize,
    },
    /// Wrong size of an image.
    #[error("expected {what} of {}x{} pixels for camera {camera}, found \
        {}x{}", expected.1, expected.0, found.1, found.0)]
    Size {
        /// Kind of the input.
        what: &'static str,
        /// Index of the camera.
        camera: usize,
        /// Width and height.
        expected: (u32, u32),
        /// Width and height.
        found: (u32, u32),
    },
    /// Wrong size of a map or mask.
    #[error("expected {what} of {expected} pixels for camera {camera}, found {found}")]
    Pixels {
        /// Kind of the input.
        what: &'static str,
        /// Index of the camera.
        camera: usize,
        /// Pixel count of the generated image.
        expected: usize,
        /// Number of pixels given.
        found: usize,
    },
}

impl ScoredFrame<'_> {
    /// Checks that all inputs have these sizes, width and height per camera.
    pub(super) fn check(&self, sizes: &[(u32, u32)]) -> Result<(), ScoreError> {
        check_images("generated images", self.generated, sizes)?;
        check_images("ground-truth images", self.truth.unwrap_or(self.generated), sizes)?;
        check_maps("class maps", self.class, sizes)?;
        check_maps("masks of moving actors", self.moving, sizes)?;
        check_maps("external vehicle masks", self.masks, sizes)
    }
}

fn check_images(what: &'static str, images: &[RgbImage], sizes: &[(u32, u32)]) -> Result<(), ScoreError> {
    check_cameras(what, images.len(), sizes)?;
    let found = images.iter().map(RgbImage::dimensions).zip(sizes).enumerate();
    match found.into_iter().find(|(_, (found, expected))| found != *expected) {
        Some((camera, (found, expected))) => {
            Err(ScoreError::Size { what, camera, expected: *expected, found })
        }
        None => Ok(()),
    }
}

fn check_maps<T>(
    what: &'static str,
    maps: Option<&[Vec<T>]>,
    sizes: &[(u32, u32)],
) -> Result<(), ScoreError> {
    let Some(maps) = maps else { return Ok(()) };
    check_cameras(what, maps.len(), sizes)?;
    let pixels = sizes.iter().map(|(width, height)| *width as usize * *height as usize);
    for (camera, (map, expected)) in maps.iter().zip(pixels).enumerate() {
        if map.len() != expected {
            return Err(ScoreError::Pixels { what, camera, expected, found: map.len() });
        }
    }
    Ok(())
}

fn check_cameras(what: &'static str, found: usize, sizes: &[(u32, u32)]) -> Result<(), ScoreError> {
    let expected = sizes.len();
    if found == expected { Ok(()) } else { Err(ScoreError::Cameras { what, expected, found }) }
}
