use image::RgbImage;
use image::imageops::{FilterType, resize};

use crate::dataset::{Dataset, DatasetError, ImageRecord};
use crate::geometry::{ImageSize, View};
use crate::scene::{SceneCamera, SceneState};
use crate::town::{Town, TownError, TrueActor};

/// Where true images come from.
#[derive(Clone, Copy)]
pub enum TrueImages<'a> {
    /// The town knows what it looks like from anywhere.
    Town(&'a Town),
    /// A recorded log knows what its cameras saw.
    Logged(&'a dyn Dataset),
}

/// Why there are no true images.
#[derive(Debug, thiserror::Error)]
pub enum TrueImagesError {
    /// The town.
    #[error(transparent)]
    Town(#[from] TownError),
    /// A file of the log.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// A camera that the log has no image of.
    #[error("expected images of camera {camera} in log {log}, found none")]
    NoImage {
        /// Channel name.
        camera: String,
        /// Name of the log.
        log: String,
    },
}

impl TrueImages<'_> {
    /// Whether they show what is so when `ego` and actors need not be where the log has them.
    pub fn are_known(&self, ego_follows_log: bool, actors_follow_log: bool) -> bool {
        matches!(self, Self::Town(_)) || ego_follows_log && actors_follow_log
    }

    /// What the cameras of a state see, as images of a size: of a town drawn as `drawn` has the views, with actors where
    /// the state has them unless they follow the log; of a recorded log the image of each camera that is nearest in time.
    ///
    /// # Errors
    /// The town's device; images that are missing or damaged.
    pub fn of(
        &self,
        state: &SceneState,
        drawn: impl Fn(&View) -> View,
        size: ImageSize,
        actors_follow_log: bool,
    ) -> Result<Vec<RgbImage>, TrueImagesError> {
        let images = match self {
            Self::Town(town) => {
                let views: Vec<View> = state.cameras.iter().map(|camera| drawn(&camera.view)).collect();
                let seen = if actors_follow_log {
                    town.truth(state.t_us, &views)?
                } else {
                    let actor = |actor: &crate::scene::ActorState| (actor.track.clone(), actor.cuboid);
                    let actors: Vec<_> = state.actors.iter().map(actor).collect();
                    let actors: Vec<TrueActor<'_>> =
                        actors.iter().map(|(track, cuboid)| TrueActor { track, cuboid: *cuboid }).collect();
                    town.truth_of(state.t_us, &actors, &views)?
                };
                seen.into_iter().map(|seen| seen.image).collect()
            }
            Self::Logged(dataset) => {
                let image = |camera: &SceneCamera| logged(*dataset, &camera.view.camera.name, state.t_us);
                state.cameras.iter().map(image).collect::<Result<Vec<_>, _>>()?
            }
        };
        Ok(images.iter().map(|image| resize(image, size.width, size.height, FilterType::Triangle)).collect())
    }
}

/// The image of a camera that is nearest in time.
fn logged(dataset: &dyn Dataset, camera: &str, t_us: i64) -> Result<RgbImage, TrueImagesError> {
    let log = dataset.log();
    let of_camera =
        |record: &&ImageRecord| log.cameras.get(record.channel).is_some_and(|name| name == camera);
    let all = log.frames.iter().flat_map(|frame| frame.images.iter().chain(&frame.between_images));
    let nearest = all.filter(of_camera).min_by_key(|record| (record.t_us.abs_diff(t_us), record.t_us));
    let nearest = nearest
        .ok_or_else(|| TrueImagesError::NoImage { camera: camera.to_owned(), log: log.name.clone() })?;
    Ok(dataset.read_image(nearest)?)
}
