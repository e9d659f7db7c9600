use glam::{DVec2, DVec3};
use image::imageops::{FilterType, interpolate_bilinear, resize};
use image::{Rgb, RgbImage};
use rayon::prelude::*;

use super::{ActorState, SceneCamera, SceneState};
use crate::dataset::{DatasetError, ImageRecord, LogReader, PosedActor};
use crate::files::text::printable;
use crate::geometry::{Camera, ImageSize, View};

/// Ground-truth images of a log: recorded ones, or rendered from any pose if the log is synthetic.
#[derive(Clone, Copy)]
pub struct GroundTruthImages<'a> {
    reader: &'a dyn LogReader,
}

/// Error of looking up ground-truth images.
#[derive(Debug, thiserror::Error)]
pub enum GroundTruthError {
    /// Error of the log.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// The log has no image of a camera.
    #[error("expected images of camera {camera} in log {}, found none", printable(log))]
    NoImage {
        /// Channel name.
        camera: String,
        /// Name of the log.
        log: String,
    },
}

impl<'a> GroundTruthImages<'a> {
    /// Creates the source for a log.
    pub fn new(reader: &'a dyn LogReader) -> Self {
        Self { reader }
    }

    /// Reads a recorded image and removes its lens distortion.
    ///
    /// # Errors
    /// Fails if the file is missing or damaged.
    pub fn of_record(&self, record: &ImageRecord) -> Result<RgbImage, DatasetError> {
        Ok(rectified(self.reader.read_image(record)?, &record.camera))
    }

    /// Returns whether ground truth is available: always in a synthetic log, in a recorded log only if the
    /// ego and the actors follow the log.
    pub fn are_known(&self, ego_follows_log: bool, actors_follow_log: bool) -> bool {
        let follows_log = ego_follows_log && actors_follow_log && self.reader.recording().edits.is_empty();
        self.reader.view_renderer().is_some() || follows_log
    }

    /// Returns the ground-truth images of all cameras in a state, resized to `size`. In a synthetic log, the
    /// views are mapped by `drawn` and rendered, with the actors of the state unless they follow the log. In
    /// a recorded log, each camera gets its image that is nearest in time, with the lens distortion removed.
    ///
    /// # Errors
    /// Returns an error if the views cannot be rendered, or if an image is missing or damaged.
    pub fn of(
        &self,
        state: &SceneState,
        drawn: impl Fn(&View) -> View,
        size: ImageSize,
        actors_follow_log: bool,
    ) -> Result<Vec<RgbImage>, GroundTruthError> {
        let images = if let Some(renderer) = self.reader.view_renderer() {
            let views: Vec<View> = state.cameras.iter().map(|camera| drawn(&camera.view)).collect();
            let actors: Vec<PosedActor<'_>> = state.actors.iter().map(posed).collect();
            renderer.render_views(state.t_us, (!actors_follow_log).then_some(&actors), &views)?
        } else {
            let image = |camera: &SceneCamera| logged(self.reader, &camera.view.camera.name, state.t_us);
            state.cameras.par_iter().map(image).collect::<Result<Vec<_>, _>>()?
        };
        Ok(images.iter().map(|image| resize(image, size.width, size.height, FilterType::Triangle)).collect())
    }
}

fn posed(actor: &ActorState) -> PosedActor<'_> {
    PosedActor { track: &actor.track, cuboid: actor.cuboid }
}

/// Reads the image of a camera that is nearest in time, and rectifies it.
fn logged(reader: &dyn LogReader, camera: &str, t_us: i64) -> Result<RgbImage, GroundTruthError> {
    let log = reader.recording();
    let nearest = log
        .nearest_image(camera, t_us)
        .ok_or_else(|| GroundTruthError::NoImage { camera: camera.to_owned(), log: log.name.clone() })?;
    Ok(GroundTruthImages::new(reader).of_record(nearest)?)
}

/// Resamples an image to a pinhole camera of the same size and intrinsics, like the conditions. Interpolates
/// bilinearly between pixel centers; pixels outside the recorded image are black.
fn rectified(image: RgbImage, camera: &Camera) -> RgbImage {
    if camera.lens.is_none() {
        return image;
    }
    let (projection, camera_from_image) = (camera.projection(), camera.intrinsics.inverse());
    let ends = DVec2::new(f64::from(image.width()) - 1.0, f64::from(image.height()) - 1.0);
    let pixel = |x: u32, y: u32| {
        let ideal = camera_from_image * DVec3::new(f64::from(x) + 0.5, f64::from(y) + 0.5, 1.0);
        let seen = projection.pixel(ideal)? - 0.5;
        let shown = seen.cmpge(DVec2::splat(-0.5)).all() && seen.cmplt(ends + 0.5).all();
        let seen = seen.clamp(DVec2::ZERO, ends);
        interpolate_bilinear(&image, seen.x as f32, seen.y as f32).filter(|_| shown)
    };
    RgbImage::from_fn(image.width(), image.height(), |x, y| pixel(x, y).unwrap_or(Rgb([0; 3])))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{LensModel, View};
    use glam::DAffine3;

    /// Pixel values encode pixel positions, so the rectified image shows where the lens put each point of the
    /// pinhole.
    #[test]
    fn rectified_images_match_a_pinhole() {
        let (width, height) = (200, 120);
        let rows = [[150.0, 0.0, 97.0], [0.0, 160.0, 63.0], [0.0, 0.0, 1.0]];
        let pinhole = Camera::new("c", width, height, rows).unwrap();
        let lens = LensModel::from_opencv([-0.356, 0.17, 0.001, -0.002, -0.05]);
        let camera = Camera { lens, ..pinhole.clone() };
        let recorded = RgbImage::from_fn(width, height, |x, y| Rgb([x as u8, 2 * y as u8, 9]));
        assert_eq!(rectified(recorded.clone(), &pinhole), recorded);
        let found = rectified(recorded, &camera);
        let mut shown = 0;
        for point in [[0.0, 0.0], [0.3, -0.2], [-0.5, 0.1], [0.55, 0.3], [-0.6, -0.35]] {
            let world = DVec3::new(point[0], point[1], 1.0) * 7.0;
            let view = View { camera: camera.clone(), camera_from_world: DAffine3::IDENTITY };
            let at = view.project(world).unwrap().0.floor();
            let center = (at + 0.5).extend(1.0);
            let world = camera.intrinsics.inverse() * center;
            let expected = view.project_recorded(world).unwrap().0 - 0.5;
            let Rgb([x, y, blue]) = *found.get_pixel(at.x as u32, at.y as u32);
            let off = (expected - DVec2::new(f64::from(x), f64::from(y) / 2.0)).abs();
            assert!(off.x < 1.0 && off.y < 0.75 && blue == 9, "{expected} {x} {y}");
            shown += usize::from((expected - at).abs().max_element() > 1.0);
        }
        assert!(shown > 2, "the lens moves most of them");
    }
}
