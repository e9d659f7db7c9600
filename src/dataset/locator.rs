use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use super::format::{LogFormat, format_names, formats};
use super::{DatasetError, ReadOptions};

/// Location of a log. Text form: `FORMAT:PATH[@VERSION][#SCENE]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogLocator {
    /// Format, which selects the reader.
    pub format: &'static LogFormat,
    /// Folder or file; any text that the reader understands if [`LogFormat::has_path`] is `false`.
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
        let roots = [&self.sensor_root, &self.map_root].into_iter().flatten();
        self.format.has_path.then_some(&self.path).into_iter().chain(roots).map(PathBuf::as_path)
    }

    /// Creates a locator for the only scene of a path, with default folders.
    pub fn new(format: &'static LogFormat, path: impl Into<PathBuf>) -> Self {
        let path = path.into();
        let (version, scene, sensor_root, map_root, reading) = Default::default();
        Self { format, path, version, scene, sensor_root, map_root, allow_outside: false, reading }
    }
}

/// Formats as parsed, without the separately given folders.
impl fmt::Display for LogLocator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.format.name, self.path.display())?;
        self.version.as_ref().map_or(Ok(()), |version| write!(f, "@{version}"))?;
        self.scene.as_ref().map_or(Ok(()), |scene| write!(f, "#{scene}"))
    }
}

impl FromStr for LogLocator {
    type Err = DatasetError;

    /// Parses `FORMAT:PATH[@VERSION][#SCENE]`, or a path without a format, which is recognized by its files.
    fn from_str(text: &str) -> Result<Self, DatasetError> {
        let wrong = || DatasetError::Locator { found: text.to_owned(), formats: format_names() };
        let named = text.split_once(':').and_then(|(name, rest)| {
            let format = formats().into_iter().find(|format| format.name == name)?;
            Some((format, rest))
        });
        let locator = match named {
            Some((format, rest)) if format.has_path => parse_path(format, rest).ok_or_else(wrong)?,
            Some((format, rest)) => Self::new(format, rest),
            None => detect(text)?.ok_or_else(wrong)?,
        };
        (locator.format.check)(&locator)?;
        Ok(locator)
    }
}

/// Parses `PATH[@VERSION][#SCENE]`.
fn parse_path(format: &'static LogFormat, text: &str) -> Option<LogLocator> {
    let (rest, scene) = split_tail(text, '#');
    let (path, version) = split_tail(rest, '@');
    if path.is_empty() || version == Some("") || scene == Some("") {
        return None;
    }
    let (version, scene) = (version.map(Into::into), scene.map(Into::into));
    Some(LogLocator { version, scene, ..LogLocator::new(format, path) })
}

/// Recognizes the format of `PATH[@VERSION][#SCENE]` by the files there; `None` if there are no files of a format.
///
/// # Errors
/// Fails if there are files of several formats.
fn detect(text: &str) -> Result<Option<LogLocator>, DatasetError> {
    let without_scene = split_tail(text, '#').0;
    // Paths may have the marks too.
    let paths = [text, without_scene, split_tail(without_scene, '@').0];
    let Some(path) = paths.into_iter().find(|path| Path::new(path).exists()) else { return Ok(None) };
    let mut found = formats();
    found.retain(|format| format.has_path && (format.detect)(Path::new(path)));
    match found.as_slice() {
        [] => Ok(None),
        [format] if path == text => Ok(Some(LogLocator::new(format, path))),
        [format] => Ok(parse_path(format, text)),
        several => {
            let names: Vec<&str> = several.iter().map(|format| format.name).collect();
            Err(DatasetError::SeveralFormats { names: names.join(", "), path: path.into() })
        }
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
    }

    #[test]
    fn other_forms_are_refused() {
        for text in ["", "nuscenes", "nuscenes:", "kitti:/data", "nuscenes:/data@", "nuscenes:/data#"] {
            let message = text.parse::<LogLocator>().unwrap_err().to_string();
            assert!(formats().iter().all(|format| message.contains(format.name)), "{message}");
        }
    }
}
