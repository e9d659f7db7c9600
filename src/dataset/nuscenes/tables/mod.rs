//! Raw records of the JSON tables.
//!
//! # How it works
//! A table is one JSON array of records. The parser skips unused fields. The trainval set has tables of more
//! than a gigabyte; of these, `version` reads the records of one scene.

pub(super) mod numbers;
pub(super) mod rows;

use std::path::{Path, PathBuf};

use rustc_hash::FxHashMap;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};

use self::numbers::{TimeUs, Truth, Whole};
use self::rows::array_of;
use crate::dataset::DatasetError;
use crate::dataset::lenient::or_default;
use crate::error::FileError;
use crate::files::json;

/// Record of a table.
pub(super) trait Record: DeserializeOwned {
    /// Name of the file, without `.json`.
    const TABLE: &'static str;

    /// Returns the primary key.
    fn token(&self) -> &str;

    /// Returns the path of the table.
    fn path(folder: &Path) -> PathBuf {
        folder.join(format!("{}.json", Self::TABLE))
    }
}

/// Declares raw records: the table name and the fields to read.
macro_rules! records {
    ($($name:ident in $table:literal { $($(#[$of:meta])* $field:ident: $type:ty),* $(,)? })*) => {$(
        #[derive(Debug, serde::Deserialize)]
        pub(super) struct $name {
            pub(super) token: String,
            $($(#[$of])* pub(super) $field: $type,)*
        }
        impl Record for $name {
            const TABLE: &'static str = $table;
            fn token(&self) -> &str {
                &self.token
            }
        }
    )*};
}

records! {
    Scene in "scene" {
        name: String,
        #[serde(default, deserialize_with = "or_default")]
        description: String,
        #[serde(default, deserialize_with = "or_default")]
        log_token: String,
        first_sample_token: String,
    }
    Sample in "sample" {
        timestamp: TimeUs,
        #[serde(default, deserialize_with = "or_default")]
        next: String,
        scene_token: String,
    }
    SampleData in "sample_data" {
        #[serde(default, deserialize_with = "or_default")]
        sample_token: String,
        ego_pose_token: String,
        calibrated_sensor_token: String,
        timestamp: TimeUs,
        is_key_frame: Truth,
        is_valid: Option<Value>,
        #[serde(default)]
        height: Whole,
        #[serde(default)]
        width: Whole,
        filename: String,
        #[serde(default, deserialize_with = "or_default")]
        info_filename: String,
    }
    EgoPose in "ego_pose" { rotation: [f64; 4], translation: [f64; 3], timestamp: Option<Value> }
    CalibratedSensor in "calibrated_sensor" {
        sensor_token: String,
        translation: [f64; 3],
        rotation: [f64; 4],
        #[serde(default, deserialize_with = "or_default")]
        camera_intrinsic: Vec<Vec<f64>>,
        #[serde(flatten)]
        others: Map<String, Value>,
    }
    Sensor in "sensor" {
        channel: String,
        modality: String,
        #[serde(flatten)]
        others: Map<String, Value>,
    }
    Instance in "instance" { category_token: String }
    Annotation in "sample_annotation" {
        sample_token: String,
        instance_token: String,
        translation: [f64; 3],
        size: [f64; 3],
        rotation: [f64; 4],
        #[serde(default)]
        num_lidar_pts: Whole,
    }
    Category in "category" { name: String }
    LogRecord in "log" {
        #[serde(default, deserialize_with = "or_default")]
        location: String,
    }
}

/// Records of a table in file order, with lookup by token.
#[derive(Debug)]
pub(super) struct Table<R> {
    /// The file.
    pub(super) path: PathBuf,
    /// In file order until sorted.
    pub(super) records: Vec<R>,
    by_token: FxHashMap<String, usize>,
}

impl<R: Record> Table<R> {
    /// Reads a table.
    ///
    /// # Errors
    /// Fails if the file is missing, is not a JSON array of such records, or has a token twice.
    pub(super) fn load(folder: &Path) -> Result<Self, FileError> {
        let path = R::path(folder);
        let records = json::read(&path, &array_of(R::TABLE))?;
        Self::new(path, records)
    }

    /// Creates a table of records; `path` is for messages.
    ///
    /// # Errors
    /// Fails if a token occurs twice.
    pub(super) fn new(path: PathBuf, records: Vec<R>) -> Result<Self, FileError> {
        let by_token = positions(&records);
        if let Some((_, twice)) =
            records.iter().enumerate().find(|(i, record)| by_token[record.token()] != *i)
        {
            let found = format!("{} twice", twice.token());
            return Err(FileError::content("every token once", found, &path));
        }
        Ok(Self { path, records, by_token })
    }

    /// Returns the record of a token, if there is one.
    pub(super) fn find(&self, token: &str) -> Option<&R> {
        self.position(token).map(|i| &self.records[i])
    }

    /// Returns the record of a token; `by` names the referring record.
    ///
    /// # Errors
    /// Returns [`DatasetError::DanglingToken`] if there is none.
    pub(super) fn get(&self, token: &str, by: impl FnOnce() -> String) -> Result<&R, DatasetError> {
        self.find(token).ok_or_else(|| DatasetError::DanglingToken {
            table: R::TABLE,
            token: token.to_owned(),
            by: by(),
            path: self.path.clone(),
        })
    }

    /// Returns the index in [`Table::records`] of a token's record, if there is one.
    pub(super) fn position(&self, token: &str) -> Option<usize> {
        self.by_token.get(token).copied()
    }

    /// Drops the records that are not accepted by `keep`.
    pub(super) fn retain(&mut self, keep: impl FnMut(&R) -> bool) {
        self.records.retain(keep);
        self.by_token = positions(&self.records);
    }

    /// Sorts the records by token.
    pub(super) fn sort_by_token(&mut self) {
        self.records.sort_by(|a, b| a.token().cmp(b.token()));
        self.by_token = positions(&self.records);
    }
}

/// Returns the index of each record by its token, the last one of equal tokens.
fn positions<R: Record>(records: &[R]) -> FxHashMap<String, usize> {
    records.iter().enumerate().map(|(i, record)| (record.token().to_owned(), i)).collect()
}
