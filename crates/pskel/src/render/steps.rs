use std::collections::BTreeMap;
use std::sync::Arc;

use point_skeleton::dataset::{EgoTrack, Frame, Recording};
use point_skeleton::geometry::View;
use point_skeleton::scene::{
    EgoOffset, SceneMap, SceneState, name_of_frame, name_of_time, state_at, state_of_frame, with_cameras,
};

use super::RenderArgs;
use crate::WrongUsage;
use crate::numbers::FrameRange;

/// Times to render; all of them are within the log.
pub(super) struct Steps<'a> {
    log: &'a Recording,
    ego: EgoTrack,
    offset: EgoOffset,
    /// Cameras that replace the log's.
    views: Option<Vec<View>>,
    /// HD map of every state.
    map: Option<Arc<SceneMap>>,
    when: Vec<When>,
}

#[derive(Clone, Copy)]
enum When {
    Frame(usize),
    Time(i64),
}

impl<'a> Steps<'a> {
    pub(super) fn new(
        log: &'a Recording,
        args: &RenderArgs,
        views: Option<Vec<View>>,
        map: Option<Arc<SceneMap>>,
    ) -> anyhow::Result<Self> {
        let when: Vec<When> = if args.at.is_empty() {
            let frames = FrameRange::of(args.frames, log.frames.len())?;
            match args.hz {
                Some(hz) => times_at_rate(&log.frames[frames], hz).map(When::Time).collect(),
                None => frames.map(When::Frame).collect(),
            }
        } else {
            check_times(log, &args.at)?;
            args.at.iter().copied().map(When::Time).collect()
        };
        anyhow::ensure!(!when.is_empty(), "expected a log with frames, found none in {}", log.shown_name());
        anyhow::ensure!(
            views.is_some() || !log.cameras.is_empty(),
            "expected cameras in log {} or by --cameras, found none",
            log.shown_name()
        );
        let (ego, offset) = (EgoTrack::new(log), args.ego_offset.unwrap_or_default());
        Ok(Self { log, ego, offset, views, map, when })
    }

    pub(super) fn len(&self) -> usize {
        self.when.len()
    }

    /// Returns the names of the states, in order.
    pub(super) fn names(&self) -> impl Iterator<Item = String> {
        self.when.iter().map(|when| match *when {
            When::Frame(index) => name_of_frame(index),
            When::Time(t_us) => name_of_time(t_us),
        })
    }

    /// Returns the states, in order.
    pub(super) fn states(&self) -> impl Iterator<Item = anyhow::Result<SceneState>> {
        self.when.iter().map(|when| {
            let state = match *when {
                When::Frame(index) => state_of_frame(self.log, index, self.offset),
                When::Time(t_us) => state_at(self.log, &self.ego, t_us, self.offset),
            };
            let mut state =
                state.ok_or_else(|| anyhow::anyhow!("expected a time within the log's ego poses"))?;
            state.map.clone_from(&self.map);
            Ok(self.views.as_deref().map_or(state.clone(), |views| with_cameras(state, views)))
        })
    }

    /// Counts the frames without an image of a log's camera, by camera.
    pub(super) fn missing_images(&self) -> BTreeMap<&str, usize> {
        let mut missing = BTreeMap::new();
        for when in &self.when {
            let (When::Frame(index), None) = (*when, &self.views) else { continue };
            let has = |channel| self.log.frames[index].images.iter().any(|i| i.channel == channel);
            for (_, camera) in self.log.cameras.iter().enumerate().filter(|(channel, _)| !has(*channel)) {
                *missing.entry(camera.as_str()).or_default() += 1;
            }
        }
        missing
    }
}

/// Returns the times from the first to the last frame at a rate: the first one and every `1 / hz` seconds, each
/// rounded to microseconds separately, so that they do not drift.
fn times_at_rate(frames: &[Frame], hz: f64) -> impl Iterator<Item = i64> {
    let ends = frames.first().zip(frames.last()).map(|(first, last)| [first.t_us, last.t_us]);
    ends.into_iter().flat_map(move |[first, last]| {
        let times = (0_u64..).map(move |i| first + (i as f64 * 1e6 / hz).round() as i64);
        times.take_while(move |t_us| *t_us <= last)
    })
}

/// Checks that times are distinct, since they become folder names, and that they are within the log.
fn check_times(log: &Recording, times: &[i64]) -> anyhow::Result<()> {
    for (i, t_us) in times.iter().enumerate() {
        if times[..i].contains(t_us) {
            return Err(WrongUsage(format!("expected times in --at that differ, found {t_us} twice")).into());
        }
        let ends = log.frames.first().zip(log.frames.last());
        let range = ends.map_or("nothing".to_owned(), |(a, b)| format!("{} to {}", a.t_us, b.t_us));
        anyhow::ensure!(
            log.covers(*t_us),
            "expected times in --at within log {} ({range} us), found {t_us}",
            log.shown_name()
        );
    }
    Ok(())
}
