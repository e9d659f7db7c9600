//! The logs of the protocol `nuplan-simgen`, which can be named as a set: `nuplan-simgen:FOLDER`.

use point_skeleton::dataset::{LogFormat, nuplan};

const NAME: &str = "nuplan-simgen";

/// The ten evaluation logs of the paper *Point as Skeleton*.
pub const SIMGEN: [&str; 10] = [
    "2021.05.12.22.28.35_veh-35_00620_01164",
    "2021.05.12.22.00.38_veh-35_01008_01518",
    "2021.05.12.23.36.44_veh-35_02035_02387",
    "2021.05.12.23.36.44_veh-35_01133_01535",
    "2021.05.12.23.36.44_veh-35_00152_00504",
    "2021.05.25.14.16.10_veh-35_01690_02183",
    "2021.06.09.12.39.51_veh-26_01943_02303",
    "2021.06.09.14.58.55_veh-35_01894_02311",
    "2021.06.09.17.23.18_veh-38_00773_01140",
    "2021.06.14.16.32.09_veh-35_05038_05402",
];

/// Format of locators that name these logs in a folder of nuPlan logs.
pub static SIMGEN_FORMAT: LogFormat = LogFormat {
    name: NAME,
    has_path: true,
    rates_hz: nuplan::FORMAT.rates_hz,
    detect: |_| false,
    check: LogFormat::unchecked,
    expand: |locator| nuplan::expand_set(locator, NAME, &SIMGEN),
    outline: LogFormat::outline_by_opening,
    open: |locator, opener| {
        let mut logs = nuplan::expand_set(locator, NAME, &SIMGEN)?;
        // Of several logs none is chosen here: the reader lists them.
        match (logs.pop(), logs.is_empty()) {
            (Some(log), true) => opener.open(&log),
            _ => (nuplan::FORMAT.open)(locator, opener),
        }
    },
};
