//! Cameras of a scene by name.

use std::collections::BTreeMap;

use point_skeleton::dataset::{ImageRecord, RigCamera};

use super::super::slots;
use super::super::world_scenario::Clip;

/// Cameras of a scene: each of the log by its name, and up to seven also by a name of NVIDIA's rig.
pub(super) struct Cameras<'a>(BTreeMap<String, Named<'a>>);

/// A camera with a name.
pub(super) struct Named<'a> {
    pub(super) rig: &'a RigCamera,
    /// Times of its images between the first and the last frame, microseconds; of the frames without images.
    pub(super) times_us: Vec<i64>,
    first_image: Option<&'a ImageRecord>,
    /// Whether the name is of NVIDIA's rig.
    is_slot: bool,
}

impl<'a> Cameras<'a> {
    pub(super) fn new(clip: &Clip<'a>) -> Self {
        let rig = &clip.log.rig;
        let slots = slots::names(rig).into_iter().zip(rig);
        let slots =
            slots.filter_map(|(name, rig)| Some((name?.replace(':', "_"), Named::new(clip, rig, true))));
        let mut cameras: BTreeMap<String, Named<'_>> = slots.collect();
        // A log with the names of NVIDIA's rig retains its own.
        for rig in rig {
            let name = rig.camera.name.to_string();
            let is_slot = cameras.contains_key(&name);
            cameras.insert(name, Named::new(clip, rig, is_slot));
        }
        Self(cameras)
    }

    /// Returns the cameras in alphabetical order of their names.
    pub(super) fn iter(&self) -> impl Iterator<Item = (&str, &Named<'a>)> {
        self.0.iter().map(|(name, camera)| (name.as_str(), camera))
    }

    /// Returns the first image of each camera with a name of NVIDIA's rig.
    pub(super) fn first_images(&self) -> impl Iterator<Item = (&str, &'a ImageRecord)> {
        let slots = self.iter().filter(|(_, camera)| camera.is_slot);
        slots.filter_map(|(name, camera)| Some((name, camera.first_image?)))
    }
}

impl<'a> Named<'a> {
    fn new(clip: &Clip<'a>, rig: &'a RigCamera, is_slot: bool) -> Self {
        let images = images(clip, rig.channel);
        let times_us = match images.as_slice() {
            [] => clip.frames.iter().map(|frame| frame.t_us).collect(),
            images => images.iter().map(|image| image.t_us).collect(),
        };
        Self { rig, times_us, first_image: images.first().copied(), is_slot }
    }
}

/// Returns the images of a camera between the first and the last frame, in order of time.
fn images<'a>(clip: &Clip<'a>, channel: usize) -> Vec<&'a ImageRecord> {
    let Some(times_us) = clip.times_us() else { return Vec::new() };
    let all = clip.frames.iter().flat_map(|frame| frame.between_images.iter().chain(&frame.images));
    let mut images: Vec<&ImageRecord> =
        all.filter(|image| image.channel == channel && times_us.contains(&image.t_us)).collect();
    images.sort_by_key(|image| image.t_us);
    images.dedup_by_key(|image| image.t_us);
    images
}
