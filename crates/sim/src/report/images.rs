//! Images of the generator at a step, as files in its folder: `generated/CAM.png`, `truth/CAM.png` if
//! available, and `generated.json`, which records whether they are references.

use std::path::Path;

use image::RgbImage;
use point_skeleton::dataset::{picture_size, read_picture};
use point_skeleton::error::FileError;
use point_skeleton::files::FileName;
use point_skeleton::files::input::is_there;
use point_skeleton::files::json;
use point_skeleton::files::write_json;
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
}

/// Content of `generated.json`.
#[derive(Serialize, Deserialize)]
struct GeneratedMetadata {
    kind: Kind,
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
    write_json(&folder.join(KIND), &GeneratedMetadata { kind })
}

/// Reads the images from the folder of a step; `None` if there are none.
///
/// # Errors
/// Fails if a file is missing or damaged.
pub fn read(folder: &Path, cameras: &[FileName]) -> Result<Option<StepImages>, FileError> {
    let Some(is_reference) = is_reference(folder)? else { return Ok(None) };
    let read = |name: &str| {
        let image = |camera: &FileName| open(&folder.join(name).join(format!("{camera}.png")));
        cameras.iter().map(image).collect::<Result<Vec<_>, _>>()
    };
    let truth = folder.join(TRUTH).is_dir().then(|| read(TRUTH)).transpose()?;
    Ok(Some(StepImages { is_reference, images: read(GENERATED)?, truth }))
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
    let path = folder.join(KIND);
    if !is_there(&path)? && !folder.join(GENERATED).is_dir() {
        return Ok(None);
    }
    let GeneratedMetadata { kind } =
        json::read(&path, "kind \"generated\" or \"reference\" of the step's images")?;
    Ok(Some(kind == Kind::Reference))
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
    fn images_round_trip() {
        let folder = tempfile::tempdir().unwrap();
        let cameras = ["a", "b"];
        let names = cameras.map(|name| name.parse().unwrap());
        let image = |level: u8| RgbImage::from_fn(3, 2, |x, y| Rgb([level, x as u8, y as u8]));
        let step = StepImages {
            is_reference: false,
            images: vec![image(1), image(2)],
            truth: Some(vec![image(3), image(4)]),
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
