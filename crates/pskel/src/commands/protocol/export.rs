//! Images of a protocol's rollouts, for other programs.

use std::path::{Path, PathBuf};

use clap::Args;
use point_skeleton::files::{FileName, Inputs, WholeFolder, json};
use pskel_generate::{ImageLayout, RolloutImages};
use serde::Deserialize;

use crate::args::names::names;
use crate::args::outputs::FolderArgs;
use crate::{WrongUsage, print_result};

/// Write the generated images of a protocol for other programs: PART/CLIP/CAM/NUMBER.png or PART/CLIP/CAM.mp4
///
/// Numbers are those of the clip's frames. `--images` reads them again.
#[derive(Debug, Args)]
pub(crate) struct ExportImagesArgs {
    /// Folder of a protocol command
    #[arg(value_name = "DIR")]
    protocol: PathBuf,
    /// Layout: frames or video
    #[arg(long, default_value = "frames", value_parser = names::<ImageLayout>())]
    image_layout: ImageLayout,
    #[command(flatten)]
    folder: FolderArgs,
}

/// Content of `results.json` that is used here.
#[derive(Deserialize)]
struct Results {
    parts: Vec<Part>,
}

#[derive(Deserialize)]
struct Part {
    images: Images,
}

#[derive(Deserialize)]
struct Images {
    rollouts: Vec<Rollout>,
}

#[derive(Deserialize)]
struct Rollout {
    folder: PathBuf,
    cameras: Vec<FileName>,
}

/// Writes the images of all rollouts.
pub(super) fn run(args: &ExportImagesArgs) -> anyhow::Result<()> {
    if args.image_layout == ImageLayout::Nuscenes {
        let message = "expected --image-layout frames or video, found nuscenes (the copy of the data set has \
                       these names)";
        return Err(WrongUsage(message.to_owned()).into());
    }
    let results: Results = json::read(&args.protocol.join("results.json"), "results of a protocol")?;
    let out = &args.folder.out;
    let inputs = Inputs::new([args.protocol.as_path()]);
    let target = WholeFolder::open(out, "images", &inputs)?;
    let mut count = 0;
    target.write(|whole| -> Result<(), anyhow::Error> {
        for Rollout { folder, cameras } in results.parts.into_iter().flat_map(|part| part.images.rollouts) {
            let images = RolloutImages::open(&args.protocol.join(&folder), cameras)?;
            count += write(&images, args.image_layout, &whole.join(folder))?;
        }
        Ok(())
    })?;
    print_result(&format!("{count} images: {}", out.display()));
    Ok(())
}

#[cfg(feature = "video")]
fn write(images: &RolloutImages, layout: ImageLayout, out: &Path) -> anyhow::Result<usize> {
    Ok(if layout == ImageLayout::Video { images.write_videos(out)? } else { images.write_frames(out)? })
}

#[cfg(not(feature = "video"))]
fn write(images: &RolloutImages, layout: ImageLayout, out: &Path) -> anyhow::Result<usize> {
    if layout == ImageLayout::Video {
        use point_skeleton::error::FileError;
        return Err(FileError::content("a program with the feature video", "one without", out).into());
    }
    Ok(images.write_frames(out)?)
}
