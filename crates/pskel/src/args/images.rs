//! Images of other programs in the place of generated ones.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::Args;
use point_skeleton::error::FileError;
use point_skeleton::files::json;
use pskel_generate::{ImageFolder, ImageLayout, ImportOptions};
use pskel_sim::report::images::ImageRows;

use super::names::names;
use super::numbers::finite;

/// Options of a generator, which have no effect beside images.
const GENERATOR: [&str; 11] = [
    "generator",
    "strategy",
    "infer_steps",
    "guidance",
    "guide",
    "without",
    "noise_seed",
    "sampler",
    "recipe",
    "captions",
    "generator_timeout",
];

/// Options for images of other programs.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Images of other programs")]
pub(crate) struct ImageArgs {
    /// Score the images in this folder instead of generating images; in folders PART/CLIP or PART, or for
    /// all parts. The first --window - 1 frames of each clip are references and need no images
    #[arg(long, value_name = "DIR", requires = "image_layout", conflicts_with_all = GENERATOR)]
    images: Option<PathBuf>,
    /// Names of their files
    #[arg(long, requires = "images", value_parser = names::<ImageLayout>())]
    image_layout: Option<ImageLayout>,
    /// Other names of clips or recordings in paths, as {"sliding_0": "scene-0003"}
    #[arg(long, value_name = "F.json", requires = "images")]
    image_index: Option<PathBuf>,
    /// Number of the image or video frame at a clip's first frame
    #[arg(long, value_name = "N", requires = "images", default_value_t = 0)]
    first_image: u64,
    /// Rate of the numbered images or video frames, hertz [default: the rate of the clip]
    #[arg(long, value_name = "HZ", requires = "images", value_parser = rate_hz)]
    image_hz: Option<f64>,
    /// Rows of the camera's image that the images show, for methods that crop: 32..544/576 for rows 32 to
    /// 543 of 576. Ground truth and class maps are cropped likewise
    #[arg(long, value_name = "FIRST..END/HEIGHT", requires = "images")]
    image_rows: Option<ImageRows>,
    /// Use the images of one camera for all cameras; the table says so. Images without a camera in their
    /// path are of this one
    #[arg(long, value_name = "CAM", requires = "images")]
    copy_camera: Option<String>,
}

impl ImageArgs {
    /// Lists the images; `None` without `--images`.
    pub(crate) fn open(&self) -> Result<Option<ImageFolder>, FileError> {
        let (Some(root), Some(options)) = (&self.images, self.options()?) else { return Ok(None) };
        ImageFolder::open(root, options).map(Some)
    }

    /// Returns how images are assigned to frames; `None` without `--images`.
    fn options(&self) -> Result<Option<ImportOptions>, FileError> {
        let Some(layout) = self.image_layout else { return Ok(None) };
        let aliases = self
            .image_index
            .as_deref()
            .map(|path| json::read::<BTreeMap<String, String>>(path, "names of clips by names in paths"));
        Ok(Some(ImportOptions {
            layout,
            copy_camera: self.copy_camera.clone(),
            first: self.first_image,
            hz: self.image_hz,
            rows: self.image_rows,
            aliases: aliases.transpose()?.unwrap_or_default(),
        }))
    }

    /// Returns the folder.
    pub(crate) fn folder(&self) -> Option<&Path> {
        self.images.as_deref()
    }

    /// Returns what is unusual about the images, for tables.
    pub(crate) fn remark(&self) -> Option<String> {
        let copied = self.copy_camera.as_ref().map(|camera| format!("images of {camera} for all cameras"));
        let rows = self.image_rows.map(|rows| format!("rows {rows} of each image"));
        let all: Vec<String> = copied.into_iter().chain(rows).collect();
        (!all.is_empty()).then(|| all.join(", "))
    }

    /// Returns the files and folders that are read.
    pub(crate) fn inputs(&self) -> impl Iterator<Item = &Path> {
        [&self.images, &self.image_index].into_iter().filter_map(Option::as_deref)
    }
}

/// Parses a rate.
fn rate_hz(text: &str) -> Result<f64, String> {
    let hz = finite(text).filter(|hz| (0.01..=1000.0).contains(hz));
    hz.ok_or_else(|| "expected hertz from 0.01 to 1000".into())
}
