//! `pas-cache`: the cache of the training code of *Point as Skeleton*, by token of the image (nuScenes
//! sample_data, nuPlan image): `3dbox_images/TOKEN.png` and `hdmap_images/TOKEN.png`, RGB at the size of the
//! image; `proj_depth_g1.0/TOKEN.png` (nuPlan: `proj_depth_g1.0_b256`), 16-bit gray, and
//! `proj_clr/TOKEN.png`, RGB, at the size of the maps.

use point_skeleton::Maps;
use point_skeleton::conditions::{ConditionOptions, MapKind, MapSet, draw_layouts};
use point_skeleton::dataset::{ImageRecord, nuplan};
use point_skeleton::files::FileName;

use super::{LayoutWriter, Source};
use crate::ExportError;
use crate::files::maps_as_png;
use crate::samples::Sample;
use crate::shard::Shard;

pub(super) struct PasCache<'a> {
    source: &'a Source<'a>,
}

impl<'a> PasCache<'a> {
    pub(super) fn new(source: &'a Source<'a>) -> Self {
        Self { source }
    }

    fn folder(&self, kind: MapKind) -> &str {
        match (kind, self.source.listed.locator.format) {
            (MapKind::Boxes, _) => "3dbox_images",
            (MapKind::Map, _) => "hdmap_images",
            (MapKind::Depth, format) if *format == nuplan::FORMAT => "proj_depth_g1.0_b256",
            (MapKind::Depth, _) => "proj_depth_g1.0",
            _ => &self.source.options.color_folder,
        }
    }

    /// Returns whether another frame is nearer to an image: in nuPlan, images of 10 Hz belong to two frames
    /// of 20 Hz.
    fn is_of_other_frame(&self, image: &ImageRecord, frame: usize) -> bool {
        let frames = &self.source.recording().frames;
        let neighbors = frame.saturating_sub(1)..frames.len().min(frame + 2);
        let has = |index: &usize| frames[*index].images.iter().any(|other| other.token == image.token);
        let times = neighbors.filter(has).map(|index| (index, frames[index].t_us));
        nearest(image.t_us, times).is_some_and(|nearest| nearest != frame)
    }
}

/// Returns the frame whose time is nearest, the earlier one of two; times belong to frames by index.
fn nearest(t_us: i64, times: impl Iterator<Item = (usize, i64)>) -> Option<usize> {
    times.min_by_key(|(index, time_us)| (time_us.abs_diff(t_us), *index)).map(|(index, _)| index)
}

impl LayoutWriter for PasCache<'_> {
    fn add(&mut self, shard: &mut Shard, sample: &Sample<'_>, maps: &Maps) -> Result<(), ExportError> {
        let mut tokens = Vec::new();
        for image in &sample.images {
            let image = image.filter(|image| !self.is_of_other_frame(image, sample.frame));
            let token = image.map(|image| FileName::new(&image.token));
            let in_log = |error: point_skeleton::files::NameError| {
                error.of("the token of an image").in_file(&self.source.listed.locator.path)
            };
            tokens.push(token.transpose().map_err(in_log)?);
        }
        let both = MapSet::of(&[MapKind::Boxes, MapKind::Map]);
        let kinds = if sample.state.map.is_some() { both } else { both.without(MapKind::Map) };
        let conditions = &self.source.options.conditions;
        let options = ConditionOptions { maps: kinds, size: None, out_size: None, ..conditions.clone() };
        let layouts = draw_layouts(&sample.state, &options)?;
        for cameras in [maps.cameras(), &layouts.cameras] {
            let path = |index: usize, kind| {
                let token = tokens[index].as_ref()?;
                Some(format!("{}/{token}.png", self.folder(kind)))
            };
            for file in maps_as_png(cameras, &conditions.depth_bins, path)? {
                shard.put(&file.name, &file.bytes)?;
            }
        }
        Ok(())
    }

    fn finish(self: Box<Self>, _: &mut Shard) -> Result<(), ExportError> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each image is in the cache once, with the maps of the nearest frame.
    #[test]
    fn images_belong_to_the_nearest_frame() {
        let of = |t_us| nearest(t_us, [(4, 1_000_000), (5, 1_050_000), (6, 1_100_000)].into_iter());
        assert_eq!(
            [of(999_000), of(1_024_999), of(1_025_001), of(1_090_000)].map(Option::unwrap),
            [4, 4, 5, 6]
        );
        assert_eq!(of(1_075_000), Some(5), "of two equally near frames the earlier one");
        assert_eq!(nearest(0, std::iter::empty()), None);
    }
}
