//! Traces in the Chrome trace event format: complete events (`ph: "X"`, times in microseconds), and names of
//! tracks.

use std::time::Duration;

use point_skeleton::error::FileError;
use point_skeleton::files::{FileKind, OutputFile};
use serde::Serialize;
use serde_json::{Value, json};

use super::measure::TimedFrame;

/// First track of stages; tracks of frames start at 1. Far more than frames in flight.
const FIRST_STAGE_TRACK: usize = 101;

#[derive(Debug, Serialize)]
struct Trace {
    #[serde(rename = "traceEvents")]
    events: Vec<Value>,
    #[serde(rename = "displayTimeUnit")]
    unit: &'static str,
}

/// Trace files of this program.
pub const TRACE: FileKind = FileKind {
    name: "a trace of pskel bench",
    begin: b"{\n  \"traceEvents\": [",
    marks: &[b"\"pskel bench\""],
};

/// Writes frames, from begin to end, and their stages, placed one after the other from the frame's begin.
/// Frames in flight together get separate tracks. `names` belong to the workload's frames.
pub(super) fn write(
    file: &OutputFile,
    frames: &[TimedFrame],
    in_flight: usize,
    names: &[String],
) -> Result<(), FileError> {
    file.write_json(&Trace { events: events(frames, in_flight, names), unit: "ms" })
}

fn events(frames: &[TimedFrame], in_flight: usize, names: &[String]) -> Vec<Value> {
    let mut events = vec![label("process_name", 0, "pskel bench")];
    for slot in 0..in_flight {
        events.push(label("thread_name", 1 + slot, &format!("frames {slot}")));
        events.push(label("thread_name", FIRST_STAGE_TRACK + slot, &format!("stages {slot}")));
    }
    for (number, frame) in frames.iter().enumerate() {
        let slot = number % in_flight;
        let args = json!({"frame": number, "shows": names[frame.index]});
        let whole = (frame.begun, frame.finished.saturating_sub(frame.begun));
        events.push(complete(("frame", &format!("frame {number}")), 1 + slot, whole, &args));
        let mut start = frame.begun;
        for (stage, time) in &frame.stages.0 {
            events.push(complete(("stage", stage), FIRST_STAGE_TRACK + slot, (start, *time), &args));
            start += *time;
        }
    }
    events
}

/// Returns a complete event from category and name, start and duration.
fn complete(
    (category, name): (&str, &str),
    track: usize,
    (start, length): (Duration, Duration),
    args: &Value,
) -> Value {
    let us = |time: Duration| time.as_nanos() as f64 / 1e3;
    json!({
        "name": name, "cat": category, "ph": "X", "ts": us(start), "dur": us(length), "pid": 1, "tid": track,
        "args": args,
    })
}

fn label(what: &str, track: usize, name: &str) -> Value {
    json!({"name": what, "ph": "M", "pid": 1, "tid": track, "args": {"name": name}})
}

#[cfg(test)]
mod tests {
    use super::*;
    use point_skeleton::files::Inputs;
    use point_skeleton::raster::StageTimes;

    fn frame(begun_us: u64, finished_us: u64) -> TimedFrame {
        let [begun, finished] = [begun_us, finished_us].map(Duration::from_micros);
        let mut stages = StageTimes::default();
        stages.add("a", Duration::from_micros(10));
        stages.add("b", Duration::from_nanos(20_500));
        TimedFrame { index: 1, begun, finished, took: finished - begun, stages }
    }

    /// Returns name, track, start and duration of the complete events.
    fn bars(frames: &[TimedFrame], in_flight: usize) -> Vec<(String, u64, f64, f64)> {
        let events = events(frames, in_flight, &["a", "b"].map(String::from));
        let bars = events.iter().filter(|e| e["ph"] == "X").map(|e| {
            assert_eq!(e["args"]["shows"], "b");
            let number = |key: &str| e[key].as_f64().unwrap();
            (e["name"].as_str().unwrap().to_owned(), e["tid"].as_u64().unwrap(), number("ts"), number("dur"))
        });
        bars.collect()
    }

    #[test]
    fn stages_are_laid_out_from_frame_start() {
        let found = bars(&[frame(0, 50), frame(60, 100)], 1);
        let bar = |name: &str, track, start, length| (name.to_owned(), track, start, length);
        let expected = [
            bar("frame 0", 1, 0.0, 50.0),
            bar("a", 101, 0.0, 10.0),
            bar("b", 101, 10.0, 20.5),
            bar("frame 1", 1, 60.0, 40.0),
            bar("a", 101, 60.0, 10.0),
            bar("b", 101, 70.0, 20.5),
        ];
        assert_eq!(found, expected);
    }

    #[test]
    fn overlapping_frames_use_two_tracks() {
        let found = bars(&[frame(0, 50), frame(30, 80), frame(60, 110)], 2);
        let tracks: Vec<u64> = found.iter().filter(|b| b.0.starts_with("frame")).map(|b| b.1).collect();
        assert_eq!(tracks, [1, 2, 1]);
    }

    #[test]
    fn only_own_traces_are_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let open = || OutputFile::open(&folder.path().join("t.json"), TRACE, &Inputs::default());
        write(&open().unwrap(), &[frame(0, 50)], 1, &["a", "b"].map(String::from)).unwrap();
        open().unwrap();
        std::fs::write(folder.path().join("t.json"), "{\"traceEvents\": []}").unwrap();
        assert!(open().unwrap_err().to_string().starts_with("expected a trace of pskel bench to replace"));
    }
}
