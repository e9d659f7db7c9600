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
    /// Its images between the first and the last ego pose, in order of time.
    images: Vec<&'a ImageRecord>,
    /// Whether the name is of NVIDIA's rig.
    is_slot: bool,
}

impl<'a> Cameras<'a> {
    pub(super) fn new(clip: &Clip<'a>) -> Self {
        let images = |rig: &RigCamera| images(clip, rig.channel);
        let rig = &clip.log.rig;
        let own = rig
            .iter()
            .map(|rig| (rig.camera.name.to_string(), Named { rig, images: images(rig), is_slot: false }));
        // A log with the names of NVIDIA's rig retains its own.
        let slots = slots::names(rig).into_iter().zip(rig).filter_map(|(name, rig)| {
            Some((name?.replace(':', "_"), Named { rig, images: images(rig), is_slot: true }))
        });
        Self(slots.chain(own).collect())
    }

    /// Returns the cameras in alphabetical order of their names.
    pub(super) fn iter(&self) -> impl Iterator<Item = (&str, &Named<'a>)> {
        self.0.iter().map(|(name, camera)| (name.as_str(), camera))
    }

    /// Returns the first image of each camera with a name of NVIDIA's rig.
    pub(super) fn first_images(&self) -> impl Iterator<Item = (&str, &'a ImageRecord)> {
        self.iter()
            .filter(|(_, camera)| camera.is_slot)
            .filter_map(|(name, camera)| Some((name, *camera.images.first()?)))
    }
}

impl Named<'_> {
    /// Returns the times of the images, microseconds.
    pub(super) fn times_us(&self) -> impl Iterator<Item = i64> {
        self.images.iter().map(|image| image.t_us)
    }
}

fn images<'a>(clip: &Clip<'a>, channel: usize) -> Vec<&'a ImageRecord> {
    let Some(times_us) = clip.times_us() else { return Vec::new() };
    let all = clip.frames.iter().flat_map(|frame| frame.between_images.iter().chain(&frame.images));
    let mut images: Vec<&ImageRecord> =
        all.filter(|image| image.channel == channel && times_us.contains(&image.t_us)).collect();
    images.sort_by_key(|image| image.t_us);
    images.dedup_by_key(|image| image.t_us);
    images
}
