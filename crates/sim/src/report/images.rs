//! Images of the generator at a step, as files in its folder: `generated/CAM.png`, `truth/CAM.png` if
//! available, and `generated.json`, which records whether they are references.

use std::fmt;
use std::ops::Range;
use std::path::Path;
use std::str::FromStr;

use image::RgbImage;
use point_skeleton::dataset::{picture_size, read_picture};
use point_skeleton::error::FileError;
use point_skeleton::files::FileName;
use point_skeleton::files::input::is_there;
use point_skeleton::files::json;
use point_skeleton::files::write_json;
use point_skeleton::geometry::{Camera, ImageSize};
use serde::{Deserialize, Serialize};

/// Folder of the generated images, and their name in the page.
pub const GENERATED: &str = "generated";
/// Folder of the ground-truth images, and their name in the page.
pub const TRUTH: &str = "truth";
/// File that records the kind of the images.
const KIND: &str = "generated.json";

/// Generated images of a step.
#[derive(Clone, Debug, PartialEq)]
pub struct StepImages {
    /// Whether the images are recorded ones that the generator begins with.
    pub is_reference: bool,
    /// Images, one per camera.
    pub images: Vec<RgbImage>,
    /// Ground-truth images, one per camera, if the recording has them.
    pub truth: Option<Vec<RgbImage>>,
    /// Rows of the cameras' images that all of these show; `None` for all rows.
    pub rows: Option<ImageRows>,
}

/// Rows of a camera's image that a smaller image shows, like `32..544/576`: rows 32 to 543 if it has 576
/// rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(into = "String", try_from = "String")]
pub struct ImageRows {
    first: u32,
    /// Row after the last one.
    end: u32,
    /// Number of rows of the whole image.
    height: u32,
}

impl ImageRows {
    /// Returns the share of the rows, more than 0, at most 1.
    pub fn share(self) -> f64 {
        f64::from(self.end - self.first) / f64::from(self.height)
    }

    /// Returns the size of the whole image, if these rows have a given size.
    pub fn whole(self, size: ImageSize) -> ImageSize {
        ImageSize { height: (f64::from(size.height) / self.share()).round() as u32, width: size.width }
    }

    /// Returns the rows of an image of this height, rounded.
    pub fn range(self, height: u32) -> Range<u32> {
        let row = |row: u32| (f64::from(row) * f64::from(height) / f64::from(self.height)).round() as u32;
        row(self.first)..row(self.end)
    }
}

impl fmt::Display for ImageRows {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}..{}/{}", self.first, self.end, self.height)
    }
}

impl FromStr for ImageRows {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers = text.split_once("..").and_then(|(first, rest)| {
            let (end, height) = rest.split_once('/')?;
            Some([first.parse().ok()?, end.parse().ok()?, height.parse().ok()?])
        });
        let rows = numbers.map(|[first, end, height]| Self { first, end, height });
        rows.filter(|rows| {
            rows.first < rows.end && rows.end <= rows.height && rows.height <= Camera::MAX_SIDE
        })
        .ok_or_else(|| format!("expected rows FIRST..END/HEIGHT, like 32..544/576, found {text:?}"))
    }
}

impl From<ImageRows> for String {
    fn from(rows: ImageRows) -> Self {
        rows.to_string()
    }
}

impl TryFrom<String> for ImageRows {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

/// Content of `generated.json`.
#[derive(Serialize, Deserialize)]
struct GeneratedMetadata {
    kind: Kind,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    rows: Option<ImageRows>,
}

#[derive(Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Kind {
    /// Ground-truth images that the generator begins with.
    Reference,
    Generated,
}

/// Writes the images into the folder of a step, with the names of the cameras.
///
/// # Errors
/// Fails if a folder cannot be created, or if a file cannot be written.
pub fn write(folder: &Path, cameras: &[FileName], step: &StepImages) -> Result<(), FileError> {
    let kinds = [(GENERATED, Some(&step.images)), (TRUTH, step.truth.as_ref())];
    for (name, images) in kinds.into_iter().filter_map(|(name, images)| Some((name, images?))) {
        let folder = folder.join(name);
        std::fs::create_dir_all(&folder).map_err(FileError::io("create", &folder))?;
        for (camera, image) in cameras.iter().zip(images) {
            let path = folder.join(format!("{camera}.png"));
            let saved = image.save(&path);
            saved.map_err(|error| FileError::io("write", &path)(std::io::Error::other(error)))?;
        }
    }
    let kind = if step.is_reference { Kind::Reference } else { Kind::Generated };
    write_json(&folder.join(KIND), &GeneratedMetadata { kind, rows: step.rows })
}

/// Reads the images from the folder of a step; `None` if there are none.
///
/// # Errors
/// Fails if a file is missing or damaged.
pub fn read(folder: &Path, cameras: &[FileName]) -> Result<Option<StepImages>, FileError> {
    let Some(GeneratedMetadata { kind, rows }) = metadata(folder)? else { return Ok(None) };
    let is_reference = kind == Kind::Reference;
    let read = |name: &str| {
        let image = |camera: &FileName| open(&folder.join(name).join(format!("{camera}.png")));
        cameras.iter().map(image).collect::<Result<Vec<_>, _>>()
    };
    let truth = folder.join(TRUTH).is_dir().then(|| read(TRUTH)).transpose()?;
    Ok(Some(StepImages { is_reference, images: read(GENERATED)?, truth, rows }))
}

/// Reads the generated image of a camera from the folder of a step.
///
/// # Errors
/// Fails if the file is missing or damaged.
pub fn read_generated(folder: &Path, camera: &FileName) -> Result<RgbImage, FileError> {
    open(&folder.join(GENERATED).join(format!("{camera}.png")))
}

/// Returns whether the images in the folder of a step are references; `None` if there are none.
///
/// # Errors
/// Fails if `generated.json` is missing beside images, or if it is invalid.
pub fn is_reference(folder: &Path) -> Result<Option<bool>, FileError> {
    Ok(metadata(folder)?.map(|metadata| metadata.kind == Kind::Reference))
}

/// Returns the rows of the cameras' images that the images in the folder of a step show; `None` for all.
///
/// # Errors
/// Fails as [`is_reference`].
pub fn rows(folder: &Path) -> Result<Option<ImageRows>, FileError> {
    Ok(metadata(folder)?.and_then(|metadata| metadata.rows))
}

fn metadata(folder: &Path) -> Result<Option<GeneratedMetadata>, FileError> {
    let path = folder.join(KIND);
    if !is_there(&path)? && !folder.join(GENERATED).is_dir() {
        return Ok(None);
    }
    json::read(&path, "kind \"generated\" or \"reference\" of the step's images").map(Some)
}

fn open(path: &Path) -> Result<RgbImage, FileError> {
    let (height, width) = picture_size(path)?;
    read_picture(path, height, width)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    #[test]
    fn rows_of_larger_images() {
        let rows: ImageRows = "32..544/576".parse().unwrap();
        assert_eq!((rows.to_string().as_str(), rows.share()), ("32..544/576", 512.0 / 576.0));
        let [whole, shown] = [576, 512].map(|height| ImageSize { height, width: 1024 });
        assert_eq!((rows.whole(shown), rows.range(576), rows.range(1152)), (whole, 32..544, 64..1088));
        for text in ["", "1..2", "2..2/4", "0..5/4", "-1..2/4", "0..2/99999"] {
            assert!(text.parse::<ImageRows>().unwrap_err().ends_with(&format!("found {text:?}")));
        }
    }

    #[test]
    fn images_round_trip() {
        let folder = tempfile::tempdir().unwrap();
        let cameras = ["a", "b"];
        let names = cameras.map(|name| name.parse().unwrap());
        let image = |level: u8| RgbImage::from_fn(3, 2, |x, y| Rgb([level, x as u8, y as u8]));
        let step = StepImages {
            is_reference: false,
            images: vec![image(1), image(2)],
            truth: Some(vec![image(3), image(4)]),
            rows: Some("1..3/4".parse().unwrap()),
        };
        assert_eq!(read(folder.path(), &names).unwrap(), None);
        write(folder.path(), &names, &step).unwrap();
        assert_eq!(read(folder.path(), &names).unwrap(), Some(step.clone()));
        let other = tempfile::tempdir().unwrap();
        let reference = StepImages { is_reference: true, truth: None, ..step };
        write(other.path(), &names, &reference).unwrap();
        assert_eq!(read(other.path(), &names).unwrap(), Some(reference));
        assert_eq!(read_generated(folder.path(), &names[1]).unwrap(), image(2));
        std::fs::write(folder.path().join("truth/b.png"), "no").unwrap();
        let message = read(folder.path(), &names).unwrap_err().to_string();
        assert!(message.contains("JPEG or PNG") && message.ends_with("b.png"), "{message}");
        std::fs::remove_file(other.path().join("generated/a.png")).unwrap();
        assert!(read(other.path(), &names).unwrap_err().to_string().ends_with("a.png"));
    }
}
