//! Formats and locations of logs, and the opener, which refer to each other. `registry` has the formats of
//! the program.

use std::any::Any;
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use crate::dataset::{DatasetError, LogOutline, LogReader, ReadOptions};

/// Opens the reader of a log.
pub type OpenReader = fn(&LogLocator, &LogOpener) -> Result<Box<dyn LogReader>, DatasetError>;

/// Format of logs. Formats of one name are equal.
pub struct LogFormat {
    /// Name in the text form of a locator, `NAME:PATH`.
    pub name: &'static str,
    /// Whether the path of a locator names a file or folder. Otherwise it is a text that only the format
    /// understands.
    pub has_path: bool,
    /// Simulation and planning steps per second that suit its logs.
    pub rates_hz: [f64; 2],
    /// Returns whether a file or folder has logs of the format, by the names of files alone.
    pub detect: fn(&Path) -> bool,
    /// Checks a locator without opening a file.
    pub check: fn(&LogLocator) -> Result<(), DatasetError>,
    /// Returns the logs that a locator refers to, in order: the locator itself unless it names a set of logs.
    pub expand: fn(&LogLocator) -> Result<Vec<LogLocator>, DatasetError>,
    /// Returns name and length of a log.
    pub outline: fn(&LogLocator, &LogOpener) -> Result<LogOutline, DatasetError>,
    /// Opens a log. The opener may have read tables of it.
    pub open: OpenReader,
}

impl LogFormat {
    /// Value of [`LogFormat::check`] for formats whose locators need none.
    ///
    /// # Errors
    /// Never fails.
    pub fn unchecked(_: &LogLocator) -> Result<(), DatasetError> {
        Ok(())
    }

    /// Value of [`LogFormat::outline`] for formats whose logs are opened for it.
    ///
    /// # Errors
    /// Fails as [`LogFormat::open`].
    pub fn outline_by_opening(locator: &LogLocator, opener: &LogOpener) -> Result<LogOutline, DatasetError> {
        Ok(LogOutline::of((locator.format.open)(locator, opener)?.recording()))
    }
}

impl PartialEq for LogFormat {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

impl Eq for LogFormat {}

impl fmt::Debug for LogFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

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
    /// Returns the options of commands with which the log is read, without those that have their default
    /// values.
    pub fn arguments(&self) -> Vec<String> {
        let (usual, reading) = (ReadOptions::default(), &self.reading);
        let folder = |path: &Option<PathBuf>| path.as_ref().map(|path| path.display().to_string());
        let other = |name: &str, is_usual: bool| (!is_usual).then(|| name.to_owned());
        let options = [
            ("--sensor-root", folder(&self.sensor_root)),
            ("--map-root", folder(&self.map_root)),
            ("--missing", other(reading.missing.name(), reading.missing == usual.missing)),
            ("--ring-is", other(reading.rings.name(), reading.rings == usual.rings)),
            ("--image-distortion", other(reading.distortion.name(), reading.distortion == usual.distortion)),
        ];
        let given = options.into_iter().filter_map(|(name, value)| Some([name.to_owned(), value?]));
        given.flatten().chain(self.allow_outside.then(|| "--allow-outside".to_owned())).collect()
    }

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

/// Opens logs. Tables that hold many logs, as in nuScenes, are read once for consecutive logs of one data
/// set.
#[derive(Debug, Default)]
pub struct LogOpener {
    /// Tables that were read last.
    tables: Mutex<Option<Arc<dyn Any + Send + Sync>>>,
}

impl LogOpener {
    /// Creates an opener that has read nothing.
    pub fn new() -> Self {
        Self::default()
    }

    /// Opens the log that a locator names.
    ///
    /// # Errors
    /// Returns any error of the format's reader.
    pub fn open(&self, locator: &LogLocator) -> Result<Box<dyn LogReader>, DatasetError> {
        (locator.format.open)(locator, self)
    }

    /// Returns name and length of a log. nuScenes lists them in two small tables; logs of other formats are
    /// opened.
    ///
    /// # Errors
    /// Fails as [`LogOpener::open`].
    pub fn outline(&self, locator: &LogLocator) -> Result<LogOutline, DatasetError> {
        (locator.format.outline)(locator, self)
    }

    /// Returns the tables that were read last if they fit, or reads others.
    ///
    /// # Errors
    /// Returns any error of `read`.
    pub fn tables<T: Any + Send + Sync>(
        &self,
        fit: impl Fn(&T) -> bool,
        read: impl FnOnce() -> Result<T, DatasetError>,
    ) -> Result<Arc<T>, DatasetError> {
        let mut tables = self.tables.lock().unwrap_or_else(PoisonError::into_inner);
        let known = tables.clone().and_then(|tables| tables.downcast::<T>().ok());
        if let Some(known) = known.filter(|known| fit(known)) {
            return Ok(known);
        }
        let read = Arc::new(read()?);
        *tables = Some(Arc::clone(&read) as Arc<dyn Any + Send + Sync>);
        Ok(read)
    }
}
