use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use point_skeleton::error::FileError;
use point_skeleton::files::{Checksum, FileName};
use point_skeleton::geometry::ImageSize;
use point_skeleton::named;
use pskel_sim::report::images::ImageRows;
use serde::Serialize;

use super::names;

/// How the files of a folder are named.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ImageLayout {
    /// By recorded images.
    Nuscenes,
    /// By numbers of frames.
    Frames,
    /// Videos.
    Video,
}

named!(ImageLayout, "layout of images" {
    Nuscenes => "nuscenes", "CAM/NAME.jpg with the name, token or time of the recorded image";
    Frames => "frames", "an image per frame, named by clip, camera and number, as CLIP/CAM/0001.png";
    Video => "video", "a video per camera, named by clip and camera, as CLIP/CAM.mp4";
});

impl ImageLayout {
    /// Returns the file name extensions of its files.
    fn extensions(self) -> &'static [&'static str] {
        match self {
            Self::Nuscenes | Self::Frames => &["png", "jpg", "jpeg"],
            Self::Video => &["mp4", "m4v", "mov"],
        }
    }
}

/// How the images in a folder are assigned to frames.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ImportOptions {
    /// Names of files.
    pub layout: ImageLayout,
    /// Camera whose images stand for those of all cameras; images without a camera in their path are its
    /// images.
    pub copy_camera: Option<String>,
    /// Number of the image at a clip's first frame, of the layouts `frames` and `video`.
    pub first: u64,
    /// Rate of numbered images, hertz; `None` for the rate of the clip.
    pub hz: Option<f64>,
    /// Rows of the camera's image that the images show; `None` for all.
    pub rows: Option<ImageRows>,
    /// Names of clips or logs by other names in paths.
    pub aliases: BTreeMap<String, String>,
}

/// Images of another program.
#[derive(Debug)]
pub struct ImageFolder {
    pub(super) root: PathBuf,
    pub(super) options: ImportOptions,
    /// All files, sorted.
    pub(super) files: Vec<ListedFile>,
    /// Files by stem, in order.
    by_stem: BTreeMap<String, Vec<usize>>,
    /// Size of all images, which the first one has.
    pub(super) size: Option<ImageSize>,
    /// Sizes and numbers of frames of the videos of clips.
    pub(super) videos: BTreeMap<usize, (ImageSize, usize)>,
    /// Whether a file is an image of a clip, whether or not it is used.
    pub(super) known: Vec<bool>,
}

/// A file below the folder.
#[derive(Debug)]
pub(super) struct ListedFile {
    pub(super) path: PathBuf,
    /// Path below the folder without extension and numbers of samples, with `/`.
    pub(super) name: String,
}

impl ImageFolder {
    /// Lists a folder.
    ///
    /// # Errors
    /// Fails if the folder cannot be read, or if it has no file of the layout.
    pub fn open(root: &Path, options: ImportOptions) -> Result<Self, FileError> {
        let mut files = Vec::new();
        list(root, root, options.layout.extensions(), &mut files)?;
        if files.is_empty() {
            let endings = options.layout.extensions().join(", ");
            return Err(FileError::content(format!("files of type {endings}"), "none", root));
        }
        let mut by_stem: BTreeMap<String, Vec<usize>> = BTreeMap::new();
        for (number, file) in files.iter().enumerate() {
            by_stem.entry(file.stem().to_owned()).or_default().push(number);
        }
        let (root, known) = (root.to_owned(), vec![false; files.len()]);
        Ok(Self { root, options, files, by_stem, size: None, videos: BTreeMap::new(), known })
    }

    /// Returns a checksum of the names and lengths of all files: images of another run differ in it.
    ///
    /// # Errors
    /// Fails if a file cannot be read.
    pub fn checksum(&self) -> Result<Checksum, FileError> {
        let mut list = String::new();
        for ListedFile { path, name } in &self.files {
            let length = path.metadata().map_err(FileError::io("read", path))?.len();
            list += &format!("{name} {length}\n");
        }
        Ok(Checksum::of(list.as_bytes()))
    }

    /// Returns the options.
    pub fn options(&self) -> &ImportOptions {
        &self.options
    }

    /// Returns the files that belong to no clip so far.
    pub fn unknown(&self) -> impl Iterator<Item = &Path> {
        let unknown = self.files.iter().zip(&self.known).filter(|(_, is_known)| !**is_known);
        unknown.map(|(file, _)| file.path.as_path())
    }

    /// Returns the files below a folder with this stem.
    pub(super) fn with_stem<'s>(&'s self, below: &'s str, stem: &str) -> impl Iterator<Item = usize> + 's {
        let all = self.by_stem.get(stem).map(Vec::as_slice).unwrap_or_default();
        all.iter().copied().filter(move |number| self.files[*number].is_below(below))
    }

    /// Returns whether a folder below it has files.
    pub(super) fn has_folder(&self, below: &str) -> bool {
        self.files.iter().any(|file| file.is_below(below))
    }
}

impl ListedFile {
    pub(super) fn stem(&self) -> &str {
        self.name.rsplit('/').next().unwrap_or_default()
    }

    /// Returns whether the file is in this folder, given by its path; "" is the root.
    pub(super) fn is_below(&self, folder: &str) -> bool {
        folder.is_empty() || self.name.strip_prefix(folder).is_some_and(|rest| rest.starts_with('/'))
    }

    /// Returns the index of the camera in its path below a folder.
    pub(super) fn camera(&self, below: &str, cameras: &[FileName]) -> Option<usize> {
        names::longest(&self.name[below.len()..], cameras.iter().map(FileName::as_str))
    }
}

/// Adds the files with one of these extensions, sorted by path.
fn list(
    root: &Path,
    folder: &Path,
    extensions: &[&str],
    files: &mut Vec<ListedFile>,
) -> Result<(), FileError> {
    let entries = std::fs::read_dir(folder).map_err(FileError::io("read", folder))?;
    let entries = entries.map(|entry| entry.map(|entry| entry.path())).collect::<Result<Vec<_>, _>>();
    let mut paths = entries.map_err(FileError::io("read", folder))?;
    paths.sort();
    for path in paths {
        if path.is_dir() {
            list(root, &path, extensions, files)?;
            continue;
        }
        let extension = path.extension().and_then(|ending| ending.to_str()).map(str::to_ascii_lowercase);
        let stem = path.with_extension("");
        let name = stem.strip_prefix(root).ok().and_then(Path::to_str);
        if let (Some(name), Some(extension)) = (name, extension)
            && extensions.contains(&extension.as_str())
        {
            files.push(ListedFile { name: names::without_samples(name), path });
        }
    }
    Ok(())
}
