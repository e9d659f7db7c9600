//! Log names and options in text form.

use std::cell::RefCell;
use std::fmt::Display;
use std::str::FromStr;

use point_skeleton::dataset::LogLocator;
use point_skeleton::geometry::ImageSize;
use point_skeleton::raster::SplatSchedule;
use pskel::logs;
use pskel_sim::peer::PeerAddress;
use pskel_sim::{EgoPolicy, PathAnchor};
use pskel_town::TownOptions;

use super::{SMALL, Scratch, seed};
use crate::check::{assert_names_file, short};
use crate::{Seed, Target};

pub(super) const TARGETS: [Target; 2] = [
    Target { name: "names", run: names, seeds: name_seeds, max_len: 256, memory: SMALL },
    Target { name: "path", run: path, seeds: path_seeds, max_len: 2048, memory: SMALL },
];

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::new(Scratch::new());
}

/// Checks that a parsed text is written and parsed back to the same value, and that an error is short.
fn round_trip<T: FromStr<Err: Display> + Display + PartialEq + std::fmt::Debug>(text: &str) {
    match text.parse::<T>() {
        Ok(value) => {
            let written = value.to_string();
            assert_eq!(written.parse::<T>().ok().as_ref(), Some(&value), "{written:?}");
        }
        Err(error) => short(&error.to_string(), text.as_bytes()),
    }
}

fn names(data: &[u8]) {
    let Ok(text) = str::from_utf8(data) else { return };
    round_trip::<LogLocator>(text);
    round_trip::<SplatSchedule>(text);
    round_trip::<ImageSize>(text);
    round_trip::<PeerAddress>(text);
    round_trip::<TownOptions>(text);
    if let Err(error) = logs::locate(text) {
        short(&error.to_string(), data);
    }
}

fn name_seeds() -> Vec<Seed> {
    let texts = [
        "nuscenes:/data/a@b/nuscenes@v1.0-mini#scene-0061",
        "av2:logs#*",
        "nuplan-simgen:nuplan",
        "nuplan:a.db",
        "town:seed=7,frames=40,hz=5,beams=32,lidar_hz=10,size=450x800,light=day",
        "15:2,35:1,100:0",
        "450x800",
        "unix:/run/planner",
        "tcp:[::1]:80",
        "seed=7,frames=40,hz=5,beams=64,lidar_hz=20,light=dusk",
    ];
    texts.iter().enumerate().map(|(i, text)| seed(&format!("text{i}"), *text)).collect()
}

/// Reads a path for the ego; the first byte selects the format.
fn path(data: &[u8]) {
    let (format, bytes) = data.split_first().unwrap_or((&0, &[]));
    let name = ["p.json", "p.npy", "p.csv", "p.txt"][usize::from(format % 4)];
    let file = SCRATCH.with_borrow(|scratch| scratch.put(name, bytes));
    if let Err(error) = EgoPolicy::read(&file, PathAnchor::Takeover) {
        assert_names_file(error, &file, data);
    }
}

fn path_seeds() -> Vec<Seed> {
    let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (3, 2), }\n";
    let npy =
        [&b"\x01\x93NUMPY\x01\x00"[..], &[header.len() as u8, 0], header.as_bytes(), &[62; 12], &[63; 12]];
    vec![
        seed("list", "\0[[0, 0], [5, 0.5], [20, 1]]"),
        seed("object", "\0{\"points\": [[3, 0.1], [20, 1]]}"),
        seed(
            "waypoints",
            "\0{\"waypoints\": [{\"t_us\": 5, \"x_m\": 1, \"y_m\": 2, \"heading_rad\": 0, \
                \"speed_mps\": 3}]}",
        ),
        seed("npy", npy.concat()),
        seed("csv", "\x02x,y\n0,0\n5;0.5\n# nothing\n20 1\n"),
    ]
}
