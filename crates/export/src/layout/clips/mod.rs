//! Layouts of video generators that take clips of points and recorded images at a rate: what they share.

pub(super) mod freevs;
mod pickle;
pub(super) mod streetcrafter;

use std::path::Path;

use image::RgbImage;
use point_skeleton::Maps;
use point_skeleton::conditions::ConditionOptions;
use point_skeleton::dataset::{ImageRecord, Recording};
use point_skeleton::error::FileError;

use super::{Source, sizes};
use crate::files::recorded_images;
use crate::rules::ClipRules;
use crate::samples::Sample;
use crate::shard::Shard;
use crate::{ExportError, ExportOptions, SampleTimes};

/// Returns options with the size of a log's maps, if none is requested.
///
/// # Errors
/// Fails as [`ClipRules::size`].
pub(super) fn sized(
    rules: &ClipRules,
    options: &ConditionOptions,
    log: &Recording,
) -> Result<ConditionOptions, ExportError> {
    let size = match options.size.or(options.out_size) {
        None => Some(rules.size(log)?),
        Some(_) => options.size,
    };
    Ok(ConditionOptions { size, ..options.clone() })
}

/// Checks that the key frames of a log can be samples.
///
/// # Errors
/// Fails as [`ClipRules::check_frames`].
pub(super) fn check(rules: &ClipRules, options: &ExportOptions, log: &Recording) -> Result<(), ExportError> {
    if options.times != SampleTimes::KeyFrames {
        return Ok(());
    }
    let [first, end] = options.frames.unwrap_or([0, log.frames.len()]);
    let end = end.min(log.frames.len());
    rules.check_frames(&log.frames[first.min(end)..end], log)
}

/// Returns the recorded image of each camera at the size of its maps. Views without one cannot be in a clip:
/// they are left out and counted in the shard's notes. At a rate, images of other times do not count.
///
/// # Errors
/// Fails as [`recorded_images`].
fn images(
    shard: &mut Shard,
    source: &Source<'_>,
    sample: &Sample<'_>,
    maps: &Maps,
) -> Result<Vec<Option<RgbImage>>, ExportError> {
    let is_timely = |image: &&ImageRecord| match source.options.times {
        SampleTimes::Rate { hz } => ClipRules::is_timely(image.t_us, sample.state.t_us, hz),
        _ => true,
    };
    let records: Vec<_> = sample.images.iter().map(|image| image.filter(is_timely)).collect();
    let images = recorded_images(shard, source.log, &records, &sizes(maps))?;
    let left_out = images.iter().filter(|image| image.is_none()).count();
    shard.note("views left out, without a recorded image", left_out);
    Ok(images)
}

/// Divides ascending numbers into runs of consecutive ones.
fn runs<T>(numbers: &[T], number: impl Fn(&T) -> usize) -> impl Iterator<Item = &[T]> {
    numbers.chunk_by(move |a, b| number(a) + 1 == number(b))
}

/// Returns the error of an export without a clip.
fn no_clip(rules: &ClipRules, found: usize, out: &Path) -> FileError {
    let expected = format!("at least {} consecutive samples of a camera for a clip", rules.length);
    FileError::content(expected, format!("at most {found}"), out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_divide_runs() {
        let numbers = [3, 4, 5, 7, 9, 10];
        let found: Vec<&[usize]> = runs(&numbers, |n| *n).collect();
        assert_eq!(found, [&[3, 4, 5][..], &[7], &[9, 10]]);
        assert_eq!(runs(&[0_usize; 0], |n| *n).count(), 0);
    }
}
