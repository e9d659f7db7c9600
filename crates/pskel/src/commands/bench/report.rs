use std::collections::BTreeMap;
use std::fmt::Write;

use pskel_eval::bench::{BenchResult, Spread};

/// Formats the table for the terminal. `notes` are appended to the lines that their keys name.
pub(super) fn table(result: &BenchResult, notes: &BTreeMap<&str, String>) -> String {
    let mut table = String::new();
    // Writing to a string cannot fail.
    let mut line = |name: &str, value: &str| {
        let note = notes.get(name).map(|note| format!(" ({note})")).unwrap_or_default();
        let _ = writeln!(table, "{name:<12} {value}{note}");
    };
    line("device", &result.info.device);
    line("driver", &result.info.driver);
    line("rasterizer", result.info.rasterizer);
    line("points", &result.points.to_string());
    line("cameras", &result.cameras.to_string());
    line("size", &result.size);
    line("out size", &result.out_size.map_or("not reduced".to_owned(), |size| size.to_string()));
    line("frames", &result.frames.to_string());
    let Spread { min, median, p99, max } = result.frame_ms;
    line("frame", &format!("min {min:.2}, median {median:.2}, p99 {p99:.2}, max {max:.2} ms"));
    let mut stages: Vec<(&&str, &f64)> = result.stages_ms.iter().collect();
    stages.sort_by(|a, b| b.1.total_cmp(a.1));
    for (name, stage_ms) in stages {
        let share = 100.0 * stage_ms / median.max(1e-9);
        line(&format!("  {name}"), &format!("{stage_ms:>9.2} ms {share:>5.1} %"));
    }
    line("points/s", &format!("{:.1} million", result.points_per_s / 1e6));
    line("memory", &result.peak_rss_mb.map_or("not known".to_owned(), |mb| format!("{mb:.0} MB at most")));
    line("filled", &result.filled.map_or("no depth map".to_owned(), |pixels| format!("{pixels} pixels")));
    table
}

/// Formats a one-line summary.
pub(super) fn summary(result: &BenchResult) -> String {
    format!(
        "rendered {} frames of {} points in {} cameras by {} on {}: {:.2} ms a frame, {:.1} million points/s",
        result.frames,
        result.points,
        result.cameras,
        result.info.rasterizer,
        result.info.device,
        result.frame_ms.median,
        result.points_per_s / 1e6
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use point_skeleton::raster::RasterizerInfo;

    fn result() -> BenchResult {
        BenchResult {
            info: RasterizerInfo { rasterizer: "cpu", device: "host".into(), driver: "plain".into() },
            points: 4_000_000,
            cameras: 6,
            size: "900x1600".into(),
            out_size: None,
            frames: 20,
            frame_ms: Spread { min: 10.0, median: 20.0, p99: 39.0, max: 40.0 },
            stages_ms: BTreeMap::from([("copy", 5.0), ("splat", 15.0)]),
            points_per_s: 2e8,
            peak_rss_mb: None,
            filled: Some(77),
            non_finite: 3,
            timed: Vec::new(),
            names: Vec::new(),
            in_flight: 1,
        }
    }

    #[test]
    fn table_lists_all_results() {
        let notes = BTreeMap::from([("points", "3 not finite".to_owned())]);
        let table = table(&result(), &notes);
        for text in [
            "device       host\n",
            "points       4000000 (3 not finite)\n",
            "frame        min 10.00, median 20.00, p99 39.00, max 40.00 ms\n",
            "  splat          15.00 ms  75.0 %\n  copy            5.00 ms  25.0 %\n",
            "points/s     200.0 million\n",
            "memory       not known\n",
            "filled       77 pixels\n",
        ] {
            assert!(table.contains(text), "{table}\nexpected {text}");
        }
        let summary = summary(&result());
        assert!(
            summary.contains("20 frames of 4000000 points in 6 cameras by cpu on host: 20.00 ms"),
            "{summary}"
        );
    }

    #[test]
    fn json_uses_command_line_names() {
        let json = serde_json::to_value(result()).unwrap();
        assert_eq!((&json["rasterizer"], &json["driver"]), (&"cpu".into(), &"plain".into()));
        assert_eq!(
            json["frame_ms"],
            serde_json::json!({"min": 10.0, "median": 20.0, "p99": 39.0, "max": 40.0})
        );
        assert_eq!(
            (&json["out_size"], &json["peak_rss_mb"]),
            (&serde_json::Value::Null, &serde_json::Value::Null)
        );
    }
}
