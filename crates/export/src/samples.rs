//! Samples of a unit: its key frames and, on request, the images between them.

use std::collections::BTreeMap;
use std::sync::Arc;

use point_skeleton::dataset::{EgoTrack, Frame, ImageRecord, Recording};
use point_skeleton::scene::{
    EgoOffset, SceneMap, SceneState, name_of_frame, state_of_frame, state_of_images,
};

/// An instant of a log to be rendered.
#[derive(Clone, Debug)]
pub(crate) struct Sample<'a> {
    /// State with the cameras of the images.
    pub(crate) state: SceneState,
    /// Recorded image of each camera of the state.
    pub(crate) images: Vec<Option<&'a ImageRecord>>,
    /// Frame of the log; for images between frames the next one.
    pub(crate) frame: usize,
    /// Whether it is the frame itself.
    pub(crate) is_key: bool,
}

/// Log of samples.
pub(crate) struct Sampler<'a> {
    pub(crate) log: &'a Recording,
    ego: EgoTrack,
    map: Option<Arc<SceneMap>>,
    between: bool,
}

impl<'a> Sampler<'a> {
    /// Creates the sampler of a log. `between`: whether images between key frames are samples.
    pub(crate) fn new(log: &'a Recording, map: Option<Arc<SceneMap>>, between: bool) -> Self {
        Self { log, ego: EgoTrack::new(log), map, between }
    }

    /// Returns the samples of a frame in order of time: groups of images before it, then the frame itself. Counts cameras without
    /// an image and groups without an ego pose.
    pub(crate) fn of_frame(&self, index: usize, notes: &mut BTreeMap<String, usize>) -> Vec<Sample<'a>> {
        let Some(frame) = self.log.frames.get(index) else { return Vec::new() };
        let mut samples = Vec::new();
        let mut note = |kind: &str, count: usize| {
            if count > 0 {
                *notes.entry(kind.to_owned()).or_default() += count;
            }
        };
        if self.between {
            for (place, group) in (1..).zip(groups(&frame.between_images)) {
                match self.between(index, place, &group) {
                    Some(sample) => samples.push(sample),
                    None => note("images outside of the log's ego poses", group.len()),
                }
            }
        }
        if let Some(sample) = self.key(index, frame) {
            note("cameras without an image", sample.images.iter().filter(|image| image.is_none()).count());
            samples.push(sample);
        }
        samples
    }

    fn key(&self, index: usize, frame: &'a Frame) -> Option<Sample<'a>> {
        let state = state_of_frame(self.log, index, EgoOffset::default())?;
        let image = |camera: &point_skeleton::scene::SceneCamera| {
            let name = &camera.view.camera.name;
            frame.images.iter().find(|image| self.log.cameras.get(image.channel) == Some(name))
        };
        let images = state.cameras.iter().map(image).collect();
        Some(Sample {
            state: SceneState { map: self.map.clone(), ..state },
            images,
            frame: index,
            is_key: true,
        })
    }

    /// Returns the sample of a group of images. Actors are interpolated to the mean of their times.
    fn between(&self, index: usize, place: usize, group: &[&'a ImageRecord]) -> Option<Sample<'a>> {
        let first = group.first()?.t_us;
        let t_us = first + group.iter().map(|image| image.t_us - first).sum::<i64>() / group.len() as i64;
        let mut images = group.to_vec();
        images.sort_by_key(|image| image.channel);
        let state = state_of_images(self.log, &self.ego, t_us, &images)?;
        // Before the frame in alphabetical order: 000012, 000012_01 .. follow 000011.
        let before = index.checked_sub(1).map_or_else(|| "before".to_owned(), name_of_frame);
        let name = format!("{before}_{place:02}");
        let state = SceneState { name, map: self.map.clone(), ..state };
        Some(Sample { state, images: images.into_iter().map(Some).collect(), frame: index, is_key: false })
    }
}

/// Divides images in order of time into groups in which each camera occurs at most once.
fn groups(images: &[ImageRecord]) -> Vec<Vec<&ImageRecord>> {
    let mut groups: Vec<Vec<&ImageRecord>> = Vec::new();
    for image in images {
        match groups.last_mut() {
            Some(group) if group.iter().all(|other| other.channel != image.channel) => group.push(image),
            _ => groups.push(vec![image]),
        }
    }
    groups
}
