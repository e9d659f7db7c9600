//! Samples of a unit: its key frames and, on request, the images between them.

use std::collections::BTreeMap;
use std::sync::Arc;

use point_skeleton::dataset::{EgoTrack, Frame, ImageRecord, Recording};
use point_skeleton::scene::{
    EgoOffset, SceneCamera, SceneMap, SceneState, name_of_frame, state_at, state_of_frame, state_of_images,
};

use crate::SampleTimes;

/// An instant of a log to be rendered.
#[derive(Clone, Debug)]
pub(crate) struct Sample<'a> {
    /// State with the cameras of the images.
    pub(crate) state: SceneState,
    /// Recorded image for each camera of the state.
    pub(crate) images: Vec<Option<&'a ImageRecord>>,
    /// Number in the log: of samples at a rate from its first frame on, else of the frame.
    pub(crate) number: usize,
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
    times: SampleTimes,
}

impl<'a> Sampler<'a> {
    /// Creates the sampler of a log.
    pub(crate) fn new(log: &'a Recording, map: Option<Arc<SceneMap>>, times: SampleTimes) -> Self {
        Self { log, ego: EgoTrack::new(log), map, times }
    }

    /// Returns the samples after the previous frame, up to and including a frame, in order of time. Counts
    /// cameras without an image and groups without an ego pose.
    pub(crate) fn of_frame(&self, index: usize, notes: &mut BTreeMap<String, usize>) -> Vec<Sample<'a>> {
        let Some(frame) = self.log.frames.get(index) else { return Vec::new() };
        let mut samples = Vec::new();
        let mut note = |kind: &str, count: usize| {
            if count > 0 {
                *notes.entry(kind.to_owned()).or_default() += count;
            }
        };
        if let SampleTimes::Rate { hz } = self.times {
            return self.at_rate(index, hz).collect();
        }
        if self.times == SampleTimes::Images {
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
        let image = |camera: &SceneCamera| {
            let name = &camera.view.camera.name;
            frame.images.iter().find(|image| self.log.cameras.get(image.channel) == Some(name))
        };
        let images = state.cameras.iter().map(image).collect();
        Some(Sample {
            state: SceneState { map: self.map.clone(), ..state },
            images,
            number: index,
            frame: index,
            is_key: true,
        })
    }

    /// Returns the samples at a rate; the last one counts as the frame.
    fn at_rate(&self, index: usize, hz: f64) -> impl Iterator<Item = Sample<'a>> {
        let first = self.log.frames.first().map_or(0, |frame| frame.t_us);
        let end = self.log.frames[index].t_us;
        let time = move |number: u64| first + (number as f64 * 1e6 / hz).round() as i64;
        // Times after the previous frame; the estimate is corrected for rounding.
        let before = index.checked_sub(1).map_or(first - 1, |previous| self.log.frames[previous].t_us);
        let from = (((before - first).max(0)) as f64 * hz * 1e-6) as u64;
        let numbers = (from.saturating_sub(1)..).skip_while(move |n| time(*n) <= before);
        let numbers = numbers.take_while(move |n| time(*n) <= end);
        numbers.filter_map(move |number| {
            let state = state_at(self.log, &self.ego, time(number), EgoOffset::default())?;
            let nearest = |camera: &SceneCamera| {
                let images = self.log.frames[index.saturating_sub(1)..=index].iter();
                let images = images.flat_map(|frame| frame.between_images.iter().chain(&frame.images));
                let name = &camera.view.camera.name;
                let own = images.filter(|image| self.log.cameras.get(image.channel) == Some(name));
                own.min_by_key(|image| (image.t_us.abs_diff(state.t_us), image.t_us))
            };
            let images = state.cameras.iter().map(nearest).collect();
            let is_key = time(number + 1) > end;
            Some(Sample {
                state: SceneState { map: self.map.clone(), ..state },
                images,
                number: number as usize,
                frame: index,
                is_key,
            })
        })
    }

    /// Returns the sample for a group of images. Actors are interpolated to the mean of their times.
    fn between(&self, index: usize, place: usize, group: &[&'a ImageRecord]) -> Option<Sample<'a>> {
        let first = group.first()?.t_us;
        let t_us = first + group.iter().map(|image| image.t_us - first).sum::<i64>() / group.len() as i64;
        let mut images = group.to_vec();
        images.sort_by_key(|image| image.channel);
        let state = state_of_images(self.log, &self.ego, t_us, &images)?;
        // In alphabetical order: 000011_01, 000011_02 .. are between 000011 and 000012.
        let before = index.checked_sub(1).map_or_else(|| "before".to_owned(), name_of_frame);
        let name = format!("{before}_{place:02}");
        let state = SceneState { name, map: self.map.clone(), ..state };
        let images = images.into_iter().map(Some).collect();
        Some(Sample { state, images, number: index, frame: index, is_key: false })
    }
}

/// Divides images, ordered by time, into groups with each camera at most once.
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
