//! `pskel render --distort`.

use crate::tiny_log::RunPskel as _;
use crate::tiny_log::{TinyLog, tree};

#[test]
fn render_distort_does_not_change_pinholes() {
    let log = TinyLog::new();
    log.succeed("build nuscenes:log --out sk");
    let render = "render nuscenes:log --skeleton sk --frames 0..2 --out-size 30x40 --out out";
    log.succeed(&format!("{render}/plain"));
    log.succeed(&format!("{render}/raw --distort"));
    let [plain, raw] = ["plain", "raw"].map(|name| tree(&log.path(&format!("out/{name}/000001"))));
    assert_eq!(plain, raw);
    let distort = |name: &str| log.json(&format!("out/{name}/index.json"))["options"]["distort"].clone();
    assert_eq!([distort("plain"), distort("raw")], [false, true]);
}
