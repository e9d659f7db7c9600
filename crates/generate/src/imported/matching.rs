use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use point_skeleton::dataset::{ImageRecord, Recording, picture_size};
use point_skeleton::error::FileError;
use point_skeleton::files::FileName;
use point_skeleton::geometry::ImageSize;
use pskel_sim::report::images::ImageRows;

use super::counts::ImportCounts;
use super::folder::{ImageFolder, ImageLayout, ListedFile};
use super::names;

/// Largest relative difference in shape between an image and the camera's.
const SHAPE_TOLERANCE: f64 = 0.02;

/// Frames of a clip whose images are looked up.
#[derive(Clone, Debug)]
pub struct ClipFrames<'a> {
    /// Name of the part of the protocol.
    pub part: &'a str,
    /// Name of the clip.
    pub name: &'a str,
    /// Log of the clip.
    pub log: &'a Recording,
    /// Times of the frames, absolute microseconds.
    pub times_us: Vec<i64>,
    /// Rate of the frames, hertz.
    pub hz: f64,
    /// Number of leading frames that are references, for which no image is needed.
    pub references: usize,
    /// Whether the ego follows the log, so that recorded images have the frames' poses.
    pub follows_log: bool,
    /// Whether the part has no other clip of the log.
    pub is_only: bool,
    /// Whether no other part is selected, so that numbers of frames need no folder of the part.
    pub is_only_part: bool,
}

/// Where the images of a clip are looked up.
struct Lookup<'a> {
    clip: &'a ClipFrames<'a>,
    /// Names of the rig's cameras.
    cameras: &'a [FileName],
    /// Index of the camera whose images stand for all.
    copied: Option<usize>,
    /// Folder below the root.
    below: String,
}

/// Image of a frame and a camera.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct FrameImage {
    pub(super) path: PathBuf,
    /// Number of the frame in a video; `None` for an image file.
    pub(super) video_frame: Option<usize>,
}

/// Images of a clip.
#[derive(Clone, Debug)]
pub struct ClipImages {
    /// Images by frame, in the order of the rig's cameras; `None` for references and frames without all
    /// images.
    pub(super) frames: Vec<Option<Vec<FrameImage>>>,
    pub(super) references: usize,
    pub(super) size: ImageSize,
    pub(super) rows: Option<ImageRows>,
    /// What was found.
    pub counts: ImportCounts,
}

impl ImageFolder {
    /// Finds the images of a clip.
    ///
    /// # Errors
    /// Fails if no frame after the references has images of all cameras, if an image differs in shape from
    /// its camera's, or if a file cannot be read.
    pub fn clip(&mut self, clip: &ClipFrames<'_>) -> Result<ClipImages, FileError> {
        let cameras: Vec<FileName> = clip.log.rig.iter().map(|rig| rig.camera.name.clone()).collect();
        let copied = self.copied_camera(&cameras)?;
        let lookup = Lookup { clip, cameras: &cameras, copied, below: self.folder_of(clip)? };
        let found = match self.options.layout {
            ImageLayout::Nuscenes => self.by_record(&lookup),
            ImageLayout::Frames => self.by_number(&lookup),
            ImageLayout::Video => self.by_video(&lookup)?,
        };
        let shown: Vec<usize> = copied.map_or_else(|| (0..cameras.len()).collect(), |camera| vec![camera]);
        let mut counts = ImportCounts::default();
        let (mut frames, mut most) = (Vec::new(), 0);
        for number in 0..clip.times_us.len() {
            let mut images = Vec::new();
            for camera in &shown {
                let name = &cameras[*camera];
                let candidates = found.get(&(number, *camera)).map(Vec::as_slice).unwrap_or_default();
                candidates.iter().for_each(|(file, _)| self.known[*file] = true);
                if number < clip.references {
                    continue;
                }
                for (file, _) in candidates.iter().skip(1) {
                    counts.doubled.add(|| self.files[*file].path.display().to_string());
                }
                let Some((file, video_frame)) = candidates.first().copied() else {
                    counts.missing.add(|| format!("{}, frame {number}, {name}", clip.name));
                    continue;
                };
                let has_size = self.has_size(file, clip.log, name)?;
                let path = self.files[file].path.clone();
                match has_size {
                    true => images.push(FrameImage { path, video_frame }),
                    false => counts.wrong_size.add(|| path.display().to_string()),
                }
            }
            most = most.max(images.len());
            let is_whole = number >= clip.references && images.len() == shown.len();
            counts.used += if is_whole { images.len() } else { 0 };
            let of_all = |images: Vec<FrameImage>| match copied {
                Some(_) => vec![images[0].clone(); cameras.len()],
                None => images,
            };
            frames.push(is_whole.then(|| of_all(images)));
        }
        let Some(size) = self.size.filter(|_| counts.used > 0) else {
            return Err(self.nothing(clip, &cameras, most));
        };
        let (references, rows) = (clip.references, self.options.rows);
        Ok(ClipImages { frames, references, size, rows, counts })
    }

    /// Returns the index of the camera whose images stand for all.
    fn copied_camera(&self, cameras: &[FileName]) -> Result<Option<usize>, FileError> {
        let Some(name) = &self.options.copy_camera else { return Ok(None) };
        let found = cameras.iter().position(|camera| camera.as_str() == name);
        found.map(Some).ok_or_else(|| {
            let names: Vec<&str> = cameras.iter().map(FileName::as_str).collect();
            FileError::content(format!("one of the cameras {}", names.join(", ")), name, &self.root)
        })
    }

    /// Returns the folder with the images of a clip: `PART/CLIP`, `PART`, or the folder itself. Off the log,
    /// names of recorded images tell neither part nor clip. Numbers of frames do not tell the part.
    fn folder_of(&self, clip: &ClipFrames<'_>) -> Result<String, FileError> {
        let ClipFrames { part, name, follows_log, is_only_part, .. } = clip;
        let own = format!("{part}/{name}");
        let is_numbered = self.options.layout != ImageLayout::Nuscenes;
        if self.has_folder(&own) {
            return Ok(own);
        }
        if (is_numbered || *follows_log) && self.has_folder(part) {
            return Ok((*part).to_owned());
        }
        let expected = match (is_numbered, follows_log) {
            (true, _) if *is_only_part => return Ok(String::new()),
            (false, true) => return Ok(String::new()),
            (true, _) => format!("a folder {part}, since several parts are selected"),
            (false, false) => format!("a folder {own}, since the ego leaves the log"),
        };
        Err(FileError::content(expected, "none", &self.root))
    }

    /// Finds images by name, token or time of the recorded ones.
    fn by_record(&self, lookup: &Lookup<'_>) -> Found {
        let Lookup { clip, cameras, copied, below } = lookup;
        let mut by_time: BTreeMap<(usize, u64), Vec<usize>> = BTreeMap::new();
        for (number, file) in self.files.iter().enumerate().filter(|(_, file)| file.is_below(below)) {
            let camera = file.camera(below, cameras).or(*copied);
            if let (Some(camera), Some(t_us)) = (camera, names::last_number(file.stem())) {
                by_time.entry((camera, t_us)).or_default().push(number);
            }
        }
        let mut found = Found::new();
        for (number, t_us) in clip.times_us.iter().enumerate() {
            for (camera, name) in cameras.iter().enumerate() {
                let record = clip.log.nearest_image(name.as_str(), *t_us);
                let stem = |record: &ImageRecord| Some(record.path.file_stem()?.to_str()?.to_owned());
                let keys = record.map(|record| [stem(record).unwrap_or_default(), record.token.clone()]);
                let times = [record.map(|record| record.t_us), Some(*t_us)];
                let by_name = keys.iter().flatten().flat_map(|key| self.with_stem(below, key));
                // Names of images may be the same for all cameras.
                let of_camera = |file: &usize| {
                    self.files[*file].camera(below, cameras).or(*copied).is_none_or(|found| found == camera)
                };
                let by_name: Vec<usize> = by_name.filter(of_camera).collect();
                let times = times.into_iter().flatten().filter_map(|t_us| u64::try_from(t_us).ok());
                let by_time = times.filter_map(|t_us| by_time.get(&(camera, t_us))).flatten().copied();
                let mut all: Vec<usize> = by_name.into_iter().chain(by_time).collect();
                all.sort_unstable();
                all.dedup();
                if !all.is_empty() {
                    found.insert((number, camera), all.into_iter().map(|file| (file, None)).collect());
                }
            }
        }
        found
    }

    /// Finds images by clip, camera and number.
    fn by_number(&self, lookup: &Lookup<'_>) -> Found {
        let mut found = Found::new();
        for (file, camera, rest) in self.of_clip(lookup) {
            let frame = names::only_number(&rest).and_then(|number| self.frame_of(lookup.clip, number));
            if let Some(frame) = frame {
                found.entry((frame, camera)).or_default().push((file, None));
            }
        }
        found
    }

    /// Finds videos by clip and camera, and their frames.
    fn by_video(&mut self, lookup: &Lookup<'_>) -> Result<Found, FileError> {
        let mut found = Found::new();
        for (file, camera, _) in self.of_clip(lookup) {
            let opened = video_size(&self.files[file].path)?;
            self.videos.insert(file, opened);
            for number in 0..opened.1 {
                if let Some(frame) = self.frame_of(lookup.clip, number as u64) {
                    found.entry((frame, camera)).or_default().push((file, Some(number)));
                }
            }
        }
        Ok(found)
    }

    /// Returns the files of a clip with their camera, and their path without the names of clip and camera.
    fn of_clip(&self, lookup: &Lookup<'_>) -> Vec<(usize, usize, String)> {
        let Lookup { clip, cameras, copied, below } = lookup;
        let is_own = |name: &str| name == clip.name || clip.is_only && name == clip.log.name;
        let aliases = self.options.aliases.iter().filter(|(_, name)| is_own(name)).map(|(alias, _)| alias);
        let log = clip.is_only.then_some(clip.log.name.as_str());
        let mut own: Vec<&str> =
            std::iter::once(clip.name).chain(log).chain(aliases.map(String::as_str)).collect();
        own.sort_by_key(|name| std::cmp::Reverse(name.len()));
        let is_named = below.ends_with(&format!("/{}", clip.name));
        let of_file = |(number, file): (usize, &ListedFile)| {
            let path = file.name.get(below.len()..).filter(|_| file.is_below(below))?;
            let path = path.trim_start_matches('/');
            if !is_named && own.iter().all(|name| names::find(path, name).is_none()) {
                return None;
            }
            let camera = file.camera(below, cameras).or(*copied)?;
            let rest = own.iter().fold(path.to_owned(), |rest, name| names::without(&rest, name));
            Some((number, camera, names::without(&rest, cameras[camera].as_str())))
        };
        self.files.iter().enumerate().filter_map(of_file).collect()
    }

    /// Returns the frame of a clip that a numbered image shows; `None` if it is of none.
    fn frame_of(&self, clip: &ClipFrames<'_>, number: u64) -> Option<usize> {
        let number = number.checked_sub(self.options.first)?;
        let place = number as f64 * clip.hz / self.options.hz.unwrap_or(clip.hz);
        let frame = place.round();
        // A quarter of a frame: images at twice the rate are not taken twice.
        ((place - frame).abs() <= 0.25 && frame < clip.times_us.len() as f64).then_some(frame as usize)
    }

    /// Checks the shape of an image, and returns whether it has the size of the first one.
    fn has_size(&mut self, file: usize, log: &Recording, camera: &FileName) -> Result<bool, FileError> {
        let path = &self.files[file].path;
        let size = match self.videos.get(&file) {
            Some((size, _)) => *size,
            None => {
                let (height, width) = picture_size(path)?;
                ImageSize { height, width }
            }
        };
        if let Some(first) = self.size {
            return Ok(size == first);
        }
        let rig = log.rig.iter().find(|rig| rig.camera.name == *camera);
        let recorded = rig.map(|rig| ImageSize::of(&rig.camera)).filter(|_| self.options.rows.is_none());
        if let Some(recorded) = recorded {
            let shape = |size: ImageSize| f64::from(size.width) / f64::from(size.height);
            if (shape(size) / shape(recorded) - 1.0).abs() > SHAPE_TOLERANCE {
                let expected = format!(
                    "images of the shape of {camera}, {recorded}, or --image-rows (0..1/1 for all rows)"
                );
                return Err(FileError::content(expected, size.to_string(), path));
            }
        }
        self.size = Some(size);
        Ok(true)
    }

    /// Returns the error of a clip without images.
    fn nothing(&self, clip: &ClipFrames<'_>, cameras: &[FileName], most: usize) -> FileError {
        let expected = format!("images of clip {} by all {} cameras", clip.name, cameras.len());
        let found = match most {
            0 => format!(
                "none among {} files, the first is {}",
                self.files.len(),
                self.files[0].path.display()
            ),
            _ => format!("{most} (--copy-camera CAM takes the images of one camera for all)"),
        };
        FileError::content(expected, found, &self.root)
    }
}

/// Files, with the number of a video's frame, by frame and camera, in order of their paths.
type Found = BTreeMap<(usize, usize), Vec<(usize, Option<usize>)>>;

/// Returns the size and number of frames of a video.
#[cfg(feature = "video")]
fn video_size(path: &Path) -> Result<(ImageSize, usize), FileError> {
    let video = pskel_sim::report::VideoFrames::open(path)?;
    Ok((video.size(), video.count()))
}

/// Fails, since videos cannot be read.
#[cfg(not(feature = "video"))]
fn video_size(path: &Path) -> Result<(ImageSize, usize), FileError> {
    Err(FileError::content("a program with the feature video", "one without", path))
}
