//! Regenerates the seeds in `corpus/`. Other files there remain: they are inputs that once revealed a fault.

use std::path::Path;

use point_skeleton_fuzz::TARGETS;

fn main() -> std::io::Result<()> {
    for target in TARGETS.iter() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(target.name);
        std::fs::create_dir_all(&folder)?;
        for (name, bytes) in (target.seeds)() {
            std::fs::write(folder.join(format!("seed-{name}")), bytes)?;
        }
    }
    Ok(())
}
