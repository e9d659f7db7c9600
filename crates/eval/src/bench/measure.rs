use std::time::{Duration, Instant};

use point_skeleton::Error;
use point_skeleton::pipeline::Pipeline;
use point_skeleton::raster::StageTimes;

use super::frames::Frames;

/// Number of frames to render, and of those in flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Plan {
    /// Untimed frames at the start.
    pub(super) warm_up: usize,
    /// Timed frames.
    pub(super) timed: usize,
    /// Frames in flight; at least 1.
    pub(super) in_flight: usize,
}

impl Plan {
    /// Returns the number of frames that are finished and waited for.
    pub(super) fn frames(&self) -> usize {
        self.warm_up + self.timed
    }

    /// Returns the job of a frame. Jobs are rendered in turn; the timed frames start with the first job.
    pub(super) fn job_of(&self, frame: usize, jobs: usize) -> usize {
        frame.checked_sub(self.warm_up).unwrap_or(frame) % jobs
    }
}

/// Timed frame. Times are relative to the begin of the first timed frame.
#[derive(Clone, Debug, PartialEq)]
pub struct TimedFrame {
    /// Index of the frame in the workload.
    pub index: usize,
    /// Time of its begin.
    pub begun: Duration,
    /// Time of its end.
    pub finished: Duration,
    /// From begin to end; with several frames in flight, from the end of the previous frame to its own end.
    pub took: Duration,
    /// Time of each stage.
    pub stages: StageTimes,
}

/// Result of a measurement.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Measured {
    pub(super) frames: Vec<TimedFrame>,
    /// Pixels of the last frame with a depth; `None` without depth maps.
    pub(super) filled: Option<u64>,
}

/// Renders frames in turn and times them. With several frames in flight, their number is the same at the
/// first and at the last timed frame: every interval contains one begin and one end. `on_frame` is called
/// with each finished frame.
pub(super) fn measure<F: Frames + ?Sized>(
    frames: &mut F,
    plan: &Plan,
    on_frame: &mut dyn FnMut(usize),
) -> Result<Measured, Error> {
    let (count, have_depth, clock) = (frames.count(), frames.have_depth(), Instant::now());
    let mut measured = Measured::default();
    let mut pipeline = Pipeline::with_depth(plan.in_flight);
    // The last ones only keep the device busy.
    let mut jobs = (0..plan.frames() + plan.in_flight - 1).map(|frame| plan.job_of(frame, count));
    let mut begin = |frames: &mut F| {
        let Some(job) = jobs.next() else { return Ok(None) };
        let begun = clock.elapsed();
        frames.begin(job)?;
        Ok::<_, Error>(Some(begun))
    };
    frames.rasterizer().take_stages(); // set-up and upload are not part of a frame
    let mut ended = clock.elapsed();
    for frame in 0..plan.frames() {
        let from = if plan.in_flight > 1 { ended } else { clock.elapsed() };
        let is_last = frame + 1 == plan.frames();
        let finish = |frames: &mut F, _: &Duration| {
            let drawn = frames.finish()?;
            Ok((clock.elapsed(), (is_last && have_depth).then(|| drawn.filled())))
        };
        let Some((begun, (finished, filled))) = pipeline.next(frames, &mut begin, finish)? else { break };
        (ended, measured.filled) = (finished, filled);
        let stages = frames.rasterizer().take_stages();
        if frame >= plan.warm_up {
            let index = plan.job_of(frame, count);
            measured.frames.push(TimedFrame { index, begun, finished, took: finished - from, stages });
        }
        on_frame(frame);
    }
    while pipeline.next(frames, &mut begin, |frames: &mut F, _| frames.finish().map(drop))?.is_some() {}
    if let Some(first) = measured.frames.first().map(|frame| frame.begun) {
        for frame in &mut measured.frames {
            frame.begun -= first;
            frame.finished -= first;
        }
    }
    Ok(measured)
}

#[cfg(test)]
mod tests {
    use super::super::frames::Jobs;
    use super::*;
    use point_skeleton::geometry::ImageSize;
    use point_skeleton::raster::{
        FrameJob, FrameMaps, MapSet, Occlusion, RasterError, Rasterizer, RasterizerInfo, SplatJob, SplatMaps,
        SplatSchedule, ViewMaps,
    };
    use std::collections::VecDeque;

    /// Takes a millisecond per frame, half of it in `begin`, and logs the calls.
    #[derive(Default)]
    struct Fake {
        in_flight: VecDeque<u32>,
        diary: String,
        stages: StageTimes,
    }

    impl Rasterizer for Fake {
        fn info(&self) -> RasterizerInfo {
            RasterizerInfo { rasterizer: "fake", device: String::new(), driver: String::new() }
        }

        fn begin(&mut self, job: &FrameJob<'_>) -> Result<(), RasterError> {
            let name = job.out_size.unwrap().height;
            self.in_flight.push_back(name);
            self.diary += &format!("b{name} ");
            self.work("begin");
            Ok(())
        }

        fn finish(&mut self) -> Result<FrameMaps<'_>, RasterError> {
            let name = self.in_flight.pop_front().ok_or(RasterError::NoFrame)?;
            self.diary += &format!("f{name} ");
            self.work("finish");
            let empty = || Vec::new().into();
            Ok(vec![ViewMaps {
                size: ImageSize { height: 1, width: 3 },
                rgb_class: empty(),
                depth_m: vec![2.5, f32::INFINITY, name as f32].into(),
                instance: empty(),
                point: empty(),
            }])
        }

        fn splat(&mut self, _: &SplatJob<'_>) -> Result<SplatMaps, RasterError> {
            Err(RasterError::NoFrame)
        }

        fn stages(&mut self) -> &mut StageTimes {
            &mut self.stages
        }
    }

    impl Fake {
        fn work(&mut self, stage: &'static str) {
            std::thread::sleep(HALF);
            self.stages.add(stage, HALF);
        }
    }

    const HALF: Duration = Duration::from_micros(500);

    /// Renders two jobs that are identified by their heights of 1 and 2.
    fn run(plan: Plan, maps: MapSet) -> (Measured, String, usize) {
        let schedule = SplatSchedule::default();
        let job = |height: u32| FrameJob {
            views: &[],
            schedule: &schedule,
            color: &[],
            geometry: &[],
            occlusion: Occlusion::Scene,
            crop: None,
            maps,
            out_size: Some(ImageSize { height, width: 1 }),
        };
        let mut fake = Fake::default();
        fake.stages.add("upload", HALF);
        let mut heard = Vec::new();
        let mut jobs = Jobs { rasterizer: &mut fake, jobs: vec![job(1), job(2)] };
        let measured = measure(&mut jobs, &plan, &mut |frame| heard.push(frame)).unwrap();
        assert_eq!(heard, (0..plan.frames()).collect::<Vec<_>>());
        (measured, fake.diary.trim().to_owned(), fake.in_flight.len())
    }

    #[test]
    fn frames_run_sequentially_with_one_in_flight() {
        let (measured, diary, left) = run(Plan { warm_up: 3, timed: 3, in_flight: 1 }, MapSet::SPLATTED);
        // The timed frames start with the first job.
        assert_eq!((diary.as_str(), left), ("b1 f1 b2 f2 b1 f1 b1 f1 b2 f2 b1 f1", 0));
        assert_eq!((measured.frames.len(), measured.filled), (3, Some(2)));
        assert_eq!(measured.frames[0].begun, Duration::ZERO);
        for frame in &measured.frames {
            assert_eq!(frame.stages.0.values().sum::<Duration>(), 2 * HALF);
            assert!(frame.took >= 2 * HALF && frame.took >= frame.finished - frame.begun);
            assert!(!frame.stages.0.contains_key("upload"));
        }
        assert!(measured.frames.windows(2).all(|w| w[0].finished <= w[1].begun));
    }

    #[test]
    fn two_frames_in_flight_overlap() {
        let (measured, diary, left) = run(Plan { warm_up: 1, timed: 2, in_flight: 2 }, MapSet::SPLATTED);
        assert_eq!((diary.as_str(), left), ("b1 b1 f1 b2 f1 b1 f2 f1", 0));
        assert_eq!((measured.frames.len(), measured.filled), (2, Some(2)));
        assert!(measured.frames[1].begun < measured.frames[0].finished);
        assert_eq!(measured.frames[1].took, measured.frames[1].finished - measured.frames[0].finished);
    }

    #[test]
    fn filled_pixels_are_unknown_without_depth() {
        let color = "color".parse().unwrap();
        let (measured, diary, _) = run(Plan { warm_up: 0, timed: 1, in_flight: 1 }, color);
        assert_eq!((diary.as_str(), measured.filled), ("b1 f1", None));
    }
}
