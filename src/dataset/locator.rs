use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

use super::DatasetError;
use crate::error::FileError;

/// A log's name on the command line: `FORMAT:PATH[@VERSION][#SCENE]`, or `town:OPTIONS` for what is built in.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogLocator {
    /// Which reader.
    pub format: LogFormat,
    /// Folder or file; of the town its options.
    pub path: PathBuf,
    /// Data set version, for instance `v1.0-mini`.
    pub version: Option<String>,
    /// Scene name or token.
    pub scene: Option<String>,
    /// Where sweeps and images are, if not at the data set's usual place.
    pub sensor_root: Option<PathBuf>,
    /// Where maps are, if not at the data set's usual place.
    pub map_root: Option<PathBuf>,
    /// Whether files that the data set names may lie outside of the folder of sweeps and images.
    pub allow_outside: bool,
}

impl LogLocator {
    /// The only scene of a path, everything at its usual place.
    pub fn new(format: LogFormat, path: impl Into<PathBuf>) -> Self {
        let path = path.into();
        let (version, scene, sensor_root, map_root) = Default::default();
        Self { format, path, version, scene, sensor_root, map_root, allow_outside: false }
    }

    /// Checks the folders that were given for sensors and maps.
    ///
    /// # Errors
    /// One that is not there, or is a file.
    pub(super) fn check_roots(&self) -> Result<(), FileError> {
        for folder in self.sensor_root.iter().chain(&self.map_root) {
            let found = std::fs::metadata(folder).map_err(FileError::io("read", folder))?;
            if !found.is_dir() {
                return Err(FileError::content("a folder", "a file", folder));
            }
        }
        Ok(())
    }
}

/// As on the command line, without the folders that are given beside it.
impl fmt::Display for LogLocator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.format.name(), self.path.display())?;
        self.version.as_ref().map_or(Ok(()), |version| write!(f, "@{version}"))?;
        self.scene.as_ref().map_or(Ok(()), |scene| write!(f, "#{scene}"))
    }
}

/// The formats that can be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LogFormat {
    /// The 13 JSON tables of nuScenes.
    NuScenes,
    /// A folder of an Argoverse 2 sensor log, or a folder of them.
    Argoverse,
    /// A SQLite log of nuPlan, or a folder of them.
    NuPlan,
    /// The ten evaluation logs of the paper in a folder of nuPlan logs.
    NuPlanSimgen,
    /// The town that is built in.
    Town,
}

impl LogFormat {
    /// All of them.
    pub const ALL: [Self; 5] =
        [Self::NuScenes, Self::NuPlan, Self::NuPlanSimgen, Self::Argoverse, Self::Town];
    /// Names on the command line.
    pub const NAMES: &'static str = "nuscenes, nuplan, nuplan-simgen, av2 or town";

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::NuScenes => "nuscenes",
            Self::NuPlan => "nuplan",
            Self::NuPlanSimgen => "nuplan-simgen",
            Self::Argoverse => "av2",
            Self::Town => "town",
        }
    }
}

impl FromStr for LogLocator {
    type Err = DatasetError;

    fn from_str(text: &str) -> Result<Self, DatasetError> {
        let wrong = || DatasetError::Locator { found: text.to_owned(), formats: LogFormat::NAMES };
        let (format, rest) = text.split_once(':').ok_or_else(wrong)?;
        let format = LogFormat::ALL.into_iter().find(|known| known.name() == format).ok_or_else(wrong)?;
        if format == LogFormat::Town {
            return Ok(Self::new(format, rest)); // not a path: nothing is split off
        }
        let (rest, scene) = split_tail(rest, '#');
        let (path, version) = split_tail(rest, '@');
        if path.is_empty() || version == Some("") || scene == Some("") {
            return Err(wrong());
        }
        let (version, scene) = (version.map(Into::into), scene.map(Into::into));
        Ok(Self { version, scene, ..Self::new(format, path) })
    }
}

/// Splits at the last `mark`, unless a folder separator comes behind it (it is part of the path then).
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
        let town: LogLocator = "town:seed=7,frames=40".parse().unwrap();
        assert_eq!(town, LogLocator::new(LogFormat::Town, "seed=7,frames=40"));
        let names = LogFormat::ALL.map(LogFormat::name);
        assert_eq!(
            LogFormat::NAMES.split([',', ' ']).filter(|n| !["", "or"].contains(n)).collect::<Vec<_>>(),
            names
        );
    }

    #[test]
    fn other_forms_are_refused() {
        for text in ["", "nuscenes", "nuscenes:", "kitti:/data", "nuscenes:/data@", "nuscenes:/data#"] {
            assert!(text.parse::<LogLocator>().is_err(), "{text}");
        }
    }
}
