//! Makes the seeds in `corpus/` anew. Other files there stay: they are inputs that once found a fault. `--targets` prints
//! the targets with the longest input of each instead.
#![allow(clippy::print_stdout)]

use std::path::Path;

use point_skeleton_fuzz::TARGETS;

fn main() -> std::io::Result<()> {
    if std::env::args().any(|arg| arg == "--targets") {
        TARGETS.iter().for_each(|target| println!("{} {}", target.name, target.max_len));
        return Ok(());
    }
    for target in TARGETS.iter() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(target.name);
        std::fs::create_dir_all(&folder)?;
        for (name, bytes) in (target.seeds)() {
            std::fs::write(folder.join(format!("seed-{name}")), bytes)?;
        }
    }
    Ok(())
}
