//! Sweeps inside 123D logs.

use point_skeleton::dataset::py123d::count_points;

use super::seed;
use crate::check::short;
use crate::{Memory, Seed, Target};

/// A small cell may decode to 16 MiB, whose numbers a decoder widens to four bytes, in a few copies.
const DECODED: Memory = Memory { fixed: 256 << 20, factor: 1000 };

pub(super) const TARGETS: [Target; 3] = [
    Target { name: "sweep_ipc", run: points, seeds: ipc_seeds, max_len: 8192, memory: DECODED },
    Target { name: "sweep_laz", run: points, seeds: laz_seeds, max_len: 8192, memory: DECODED },
    Target { name: "sweep_draco", run: points, seeds: draco_seeds, max_len: 8192, memory: DECODED },
];

/// The count decodes the points and compares their number with the header.
fn points(data: &[u8]) {
    if let Err(found) = count_points(data) {
        short(&found, data);
    }
}

/// Returns seeds from made-up cells that py123d wrote.
macro_rules! cells {
    ($($name:literal),+) => {
        vec![$(seed($name, include_bytes!(concat!("../../../../src/dataset/py123d/codec/cells/", $name)))),+]
    };
}

fn ipc_seeds() -> Vec<Seed> {
    cells!("ipc", "ipc_lz4", "ipc_zstd", "ipc_none", "ipc_one")
}

fn laz_seeds() -> Vec<Seed> {
    cells!("laz_3", "laz_6", "laz_8", "laz_offset", "laz_none", "laz_one")
}

fn draco_seeds() -> Vec<Seed> {
    cells!(
        "draco_0",
        "draco_4",
        "draco_7",
        "draco_10",
        "draco_double",
        "draco_float",
        "draco_tree",
        "draco_one"
    )
}
