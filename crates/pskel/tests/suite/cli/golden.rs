//! Hashes of a skeleton, maps and a rollout, recorded once: a change of structure must not change them.
//!
//! `ci/golden.py` does the same for recordings and the synthetic town, to compare two versions of the
//! program.

use twox_hash::XxHash3_64;

use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{TinyLog, tree};

/// Hash of the names and bytes of the files below a folder that neither hold the program's version nor
/// options.
fn hash_of(log: &TinyLog, folder: &str) -> u64 {
    const LEFT_OUT: [&str; 6] =
        ["skeleton.json", "index.json", "index.html", "rollout.json", "metrics.json", ".pskel-files"];
    let mut bytes = Vec::new();
    for (name, content) in tree(&log.path(folder)) {
        let file = name.rsplit('/').next().unwrap();
        if !LEFT_OUT.contains(&file) {
            bytes.extend_from_slice(name.as_bytes());
            bytes.push(0);
            bytes.extend_from_slice(&(content.len() as u64).to_le_bytes());
            bytes.extend_from_slice(&content);
        }
    }
    XxHash3_64::oneshot(&bytes)
}

#[test]
fn skeleton_maps_and_rollout_have_their_recorded_hashes() {
    let log = TinyLog::new();
    log.succeed("build nuscenes:log --out sk");
    let mut found = vec![("skeleton".to_owned(), hash_of(&log, "sk"))];
    for (format, size) in
        [("png", ""), ("png", " --out-size 16x24"), ("npz", ""), ("npz", " --out-size 16x24")]
    {
        for rasterizer in ["compute", "graphics", "cpu"] {
            let options = format!("--out maps --format {format} --rasterizer {rasterizer}{size}");
            log.succeed(&format!("render nuscenes:log --skeleton sk {options}"));
            let hash = hash_of(&log, "maps");
            match found.last().filter(|(name, _)| *name == format!("{format}{size}")) {
                Some((name, other)) => assert_eq!(hash, *other, "{name} {rasterizer}"),
                None => found.push((format!("{format}{size}"), hash)),
            }
        }
    }
    let options = "--out rollout --steps 20 --ego straight --actors idm --rasterizer cpu --out-size 16x24";
    log.succeed(&format!("simulate nuscenes:log --skeleton sk {options}"));
    found.push(("rollout".to_owned(), hash_of(&log, "rollout")));
    let found: Vec<(&str, u64)> = found.iter().map(|(name, hash)| (name.as_str(), *hash)).collect();
    assert_eq!(found, RECORDED, "{found:#x?}");
}

const RECORDED: [(&str, u64); 6] = [
    ("skeleton", 0xff8d_68cf_daf5_c0b2),
    ("png", 0x7adc_d26b_5ef5_2243),
    ("png --out-size 16x24", 0x691f_0dc9_57d7_7688),
    ("npz", 0xfca2_afa0_4dfb_185d),
    ("npz --out-size 16x24", 0x1d8d_8113_dddd_dd6d),
    ("rollout", 0xe123_1a8c_b435_ceb1),
];
