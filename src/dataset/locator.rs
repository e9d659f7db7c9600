use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use super::{DatasetError, ReadOptions};

/// Location of a log. Text form: `FORMAT:PATH[@VERSION][#SCENE]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogLocator {
    /// Format, which selects the reader.
    pub format: LogFormat,
    /// Folder or file; with [`LogFormat::Other`], any text that its reader understands.
    pub path: PathBuf,
    /// Version of the data set, for instance `v1.0-mini`.
    pub version: Option<String>,
    /// Scene name or token.
    pub scene: Option<String>,
    /// Folder of sweeps and images, if not the dataset's default.
    pub sensor_root: Option<PathBuf>,
    /// Folder of maps, if not the dataset's default.
    pub map_root: Option<PathBuf>,
    /// Whether file names in the dataset may point outside the folder of sweeps and images.
    pub allow_outside: bool,
    /// Options for ambiguous data.
    pub reading: ReadOptions,
}

impl LogLocator {
    /// Returns the files and folders that the log is read from, as far as the locator names them.
    pub fn inputs(&self) -> impl Iterator<Item = &Path> {
        let is_path = !matches!(self.format, LogFormat::Other(_));
        let roots = [&self.sensor_root, &self.map_root].into_iter().flatten();
        is_path.then_some(&self.path).into_iter().chain(roots).map(PathBuf::as_path)
    }

    /// Creates a locator for the only scene of a path, with default folders.
    pub fn new(format: LogFormat, path: impl Into<PathBuf>) -> Self {
        let path = path.into();
        let (version, scene, sensor_root, map_root, reading) = Default::default();
        Self { format, path, version, scene, sensor_root, map_root, allow_outside: false, reading }
    }
}

/// Formats as parsed, without the separately given folders.
impl fmt::Display for LogLocator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.format.name(), self.path.display())?;
        self.version.as_ref().map_or(Ok(()), |version| write!(f, "@{version}"))?;
        self.scene.as_ref().map_or(Ok(()), |scene| write!(f, "#{scene}"))
    }
}

/// Log formats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LogFormat {
    /// nuScenes: 13 JSON tables.
    NuScenes,
    /// Argoverse 2: folder of a sensor log, or folder of logs.
    Argoverse,
    /// nuPlan: SQLite log, or folder of logs.
    NuPlan,
    /// Folder of nuPlan logs, restricted to the ten evaluation logs of the paper.
    NuPlanSimgen,
    /// A format with this name, of a reader outside this crate.
    Other(&'static str),
}

impl LogFormat {
    /// The formats of this crate's readers.
    pub const ALL: [Self; 4] = [Self::NuScenes, Self::NuPlan, Self::NuPlanSimgen, Self::Argoverse];

    /// Name in the text form of a locator.
    pub fn name(self) -> &'static str {
        match self {
            Self::NuScenes => "nuscenes",
            Self::NuPlan => "nuplan",
            Self::NuPlanSimgen => "nuplan-simgen",
            Self::Argoverse => "av2",
            Self::Other(name) => name,
        }
    }
}

impl FromStr for LogLocator {
    type Err = DatasetError;

    fn from_str(text: &str) -> Result<Self, DatasetError> {
        let wrong = || DatasetError::Locator {
            found: text.to_owned(),
            formats: "nuscenes, nuplan, nuplan-simgen or av2",
        };
        let (format, rest) = text.split_once(':').ok_or_else(wrong)?;
        let format = LogFormat::ALL.into_iter().find(|known| known.name() == format).ok_or_else(wrong)?;
        let (rest, scene) = split_tail(rest, '#');
        let (path, version) = split_tail(rest, '@');
        if path.is_empty() || version == Some("") || scene == Some("") {
            return Err(wrong());
        }
        let (version, scene) = (version.map(Into::into), scene.map(Into::into));
        Ok(Self { version, scene, ..Self::new(format, path) })
    }
}

/// Splits at the last `mark`. A mark before the last folder separator belongs to the path.
fn split_tail(text: &str, mark: char) -> (&str, Option<&str>) {
    match text.rsplit_once(mark) {
        Some((head, tail)) if !tail.contains('/') => (head, Some(tail)),
        _ => (text, None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_parts_are_found() {
        let locator: LogLocator = "nuscenes:/data/a@b/nuscenes@v1.0-mini#scene-0061".parse().unwrap();
        assert_eq!(locator.to_string(), "nuscenes:/data/a@b/nuscenes@v1.0-mini#scene-0061");
        assert_eq!(locator.path, PathBuf::from("/data/a@b/nuscenes"));
        assert_eq!(locator.version.as_deref(), Some("v1.0-mini"));
        assert_eq!(locator.scene.as_deref(), Some("scene-0061"));
        let bare: LogLocator = "nuscenes:data".parse().unwrap();
        assert_eq!((bare.version, bare.scene), (None, None));
        assert_eq!(LogLocator::new(LogFormat::Other("made"), "seed=7").to_string(), "made:seed=7");
    }

    #[test]
    fn other_forms_are_refused() {
        for text in ["", "nuscenes", "nuscenes:", "kitti:/data", "nuscenes:/data@", "nuscenes:/data#"] {
            let message = text.parse::<LogLocator>().unwrap_err().to_string();
            assert!(LogFormat::ALL.iter().all(|format| message.contains(format.name())), "{message}");
        }
    }
}
