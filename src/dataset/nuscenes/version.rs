//! Tables of a version, which hold all of its scenes.

use std::borrow::Cow;
use std::hash::BuildHasher;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use rustc_hash::{FxBuildHasher, FxHashMap};
use serde::Deserialize;

use super::chain::Chain;
use super::choose::{choose_scene, table_folder};
use super::tables::rows::{RowFile, RowPlace, for_each_row};
use super::tables::{Annotation, EgoPose, Instance, Record, Sample, SampleData, Scene, Table};
use crate::dataset::lenient::or_default;
use crate::dataset::recording::notes::Notes;
use crate::dataset::{DatasetError, LogLocator, LogOutline};
use crate::error::FileError;
use crate::files::input::is_taken;
use crate::files::json;

/// Scenes and samples of a version, and where the rows of each scene are in the large tables.
#[derive(Debug)]
pub(in crate::dataset) struct Version {
    /// Folder of the tables.
    pub(super) folder: PathBuf,
    pub(super) scenes: Table<Scene>,
    pub(super) samples: Table<Sample>,
    /// Built when the first scene is opened.
    rows: Mutex<Option<Arc<SceneRows>>>,
}

/// Rows of the large tables.
#[derive(Debug)]
pub(super) struct SceneRows {
    data: RowsByScene,
    /// `None` for data sets without annotations.
    annotations: Option<RowsByScene>,
    poses: RowsByToken,
}

/// Rows of a table that refer to samples, by scene.
#[derive(Debug)]
struct RowsByScene {
    file: RowFile,
    /// Token of the scene, and its rows in file order.
    rows: FxHashMap<String, Vec<RowPlace>>,
    /// Number of rows that name no sample, although there are several scenes.
    unassigned: usize,
}

/// Rows of a table by the hash of their token.
#[derive(Debug)]
struct RowsByToken {
    file: RowFile,
    /// Sorted by hash.
    rows: Vec<(u64, RowPlace)>,
}

/// The field that assigns rows to scenes.
#[derive(Deserialize)]
struct SampleOf<'a> {
    #[serde(borrow, default)]
    sample_token: Cow<'a, str>,
}

/// [`SampleOf`] a row that is not strict JSON.
#[derive(Deserialize)]
struct OwnedSampleOf {
    #[serde(default, deserialize_with = "or_default")]
    sample_token: String,
}

/// The primary key.
#[derive(Deserialize)]
struct TokenOf<'a> {
    #[serde(borrow)]
    token: Cow<'a, str>,
}

/// [`TokenOf`] a row that is not strict JSON.
#[derive(Deserialize)]
struct OwnedTokenOf {
    token: String,
}

impl Version {
    /// Reads scenes and samples of a locator's version.
    ///
    /// # Errors
    /// Fails if the tables are missing or damaged.
    pub(in crate::dataset) fn open(locator: &LogLocator) -> Result<Self, DatasetError> {
        let folder = table_folder(locator)?;
        let (scenes, samples) = (Table::load(&folder)?, Table::load(&folder)?);
        Ok(Self { folder, scenes, samples, rows: Mutex::new(None) })
    }

    /// Returns whether the tables belong to a locator.
    pub(in crate::dataset) fn is_of(&self, locator: &LogLocator) -> bool {
        table_folder(locator).is_ok_and(|folder| folder == self.folder)
    }

    /// Returns the outline of a scene.
    ///
    /// # Errors
    /// Fails if the scene is unknown or its chain of samples is damaged.
    pub(in crate::dataset) fn outline(&self, locator: &LogLocator) -> Result<LogOutline, DatasetError> {
        let scene = choose_scene(&self.scenes, locator.scene.as_deref())?;
        let chain = Chain::of(&self.samples, scene, &mut Notes::new())?;
        Ok(LogOutline { name: scene.name.clone(), frames: chain.times_us.len() })
    }

    /// Returns the rows of all scenes. The first call reads the large tables once.
    ///
    /// # Errors
    /// Fails if one is missing or damaged.
    pub(super) fn rows(&self) -> Result<Arc<SceneRows>, FileError> {
        let mut rows = self.rows.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(rows) = rows.as_ref() {
            return Ok(rows.clone());
        }
        let (data, (annotations, poses)) = rayon::join(
            || self.rows_by_scene::<SampleData>(),
            || rayon::join(|| self.annotations(), || rows_by_token::<EgoPose>(&self.folder)),
        );
        let read = Arc::new(SceneRows { data: data?, annotations: annotations?, poses: poses? });
        Ok(rows.insert(read).clone())
    }

    /// Returns the rows of annotations; `None` without the tables of annotations and instances, as in the
    /// test set of Lyft Level 5.
    fn annotations(&self) -> Result<Option<RowsByScene>, FileError> {
        let is_there =
            [Annotation::path(&self.folder), Instance::path(&self.folder)].iter().any(|p| is_taken(p));
        is_there.then(|| self.rows_by_scene::<Annotation>()).transpose()
    }

    fn rows_by_scene<R: Record>(&self) -> Result<RowsByScene, FileError> {
        let path = R::path(&self.folder);
        let mut rows: FxHashMap<String, Vec<RowPlace>> = FxHashMap::default();
        let mut unassigned = 0;
        for_each_row(&path, R::TABLE, |place, row| {
            let of = serde_json::from_slice(row).map(|of: SampleOf<'_>| of.sample_token);
            let token = of.or_else(|_| json::parsed(row).map(|of: OwnedSampleOf| of.sample_token.into()))?;
            match self.scene_of(&token).map(|scene| (scene, rows.get_mut(scene))) {
                Some((_, Some(rows))) => rows.push(place),
                Some((scene, None)) => _ = rows.insert(scene.to_owned(), vec![place]),
                None => unassigned += usize::from(token.is_empty()),
            }
            Ok::<(), String>(())
        })?;
        Ok(RowsByScene { file: RowFile::open(path)?, rows, unassigned })
    }

    /// Returns the scene of a row's sample. A row without one belongs to the only scene: T4 leaves the sample
    /// of data between key frames out.
    fn scene_of(&self, sample: &str) -> Option<&str> {
        match (self.scenes.records.as_slice(), sample) {
            ([only], "") => Some(&only.token),
            _ => self.samples.find(sample).map(|sample| sample.scene_token.as_str()),
        }
    }
}

impl SceneRows {
    /// Reads sweeps and images of a scene.
    pub(super) fn data(&self, scene: &Scene) -> Result<Table<SampleData>, FileError> {
        self.data.read(scene)
    }

    /// Returns the number of sweeps and images that belong to no scene.
    pub(super) fn unassigned_data(&self) -> usize {
        self.data.unassigned
    }

    /// Reads the boxes of a scene; none if there are no tables of them. `folder` is that of the tables.
    pub(super) fn annotations(&self, scene: &Scene, folder: &Path) -> Result<Table<Annotation>, FileError> {
        match &self.annotations {
            Some(annotations) => annotations.read(scene),
            None => Table::new(Annotation::path(folder), Vec::new()),
        }
    }

    /// Reads the ego poses of tokens; those that do not exist are left out.
    pub(super) fn poses<'a>(
        &self,
        tokens: impl Iterator<Item = &'a str>,
    ) -> Result<Table<EgoPose>, FileError> {
        self.poses.read(tokens)
    }
}

impl RowsByScene {
    fn read<R: Record>(&self, scene: &Scene) -> Result<Table<R>, FileError> {
        let places = self.rows.get(&scene.token).into_iter().flatten();
        let records = places.map(|place| self.file.read(*place, R::TABLE)).collect::<Result<_, _>>()?;
        Table::new(self.file.path().to_owned(), records)
    }
}

impl RowsByToken {
    fn read<'a, R: Record>(&self, tokens: impl Iterator<Item = &'a str>) -> Result<Table<R>, FileError> {
        let mut records = Vec::new();
        for token in tokens {
            let hash = hash_of(token);
            let first = self.rows.partition_point(|(other, _)| *other < hash);
            for (_, place) in self.rows[first..].iter().take_while(|(other, _)| *other == hash) {
                let record: R = self.file.read(*place, R::TABLE)?;
                if record.token() == token {
                    records.push(record);
                }
            }
        }
        Table::new(self.file.path().to_owned(), records)
    }
}

fn rows_by_token<R: Record>(folder: &Path) -> Result<RowsByToken, FileError> {
    let path = R::path(folder);
    let mut rows = Vec::new();
    for_each_row(&path, R::TABLE, |place, row| {
        let of = serde_json::from_slice(row).map(|of: TokenOf<'_>| of.token);
        let token: Cow<'_, str> =
            of.or_else(|_| json::parsed(row).map(|of: OwnedTokenOf| of.token.into()))?;
        rows.push((hash_of(&token), place));
        Ok::<(), String>(())
    })?;
    rows.sort_unstable_by_key(|(hash, place)| (*hash, place.offset));
    Ok(RowsByToken { file: RowFile::open(path)?, rows })
}

fn hash_of(token: &str) -> u64 {
    FxBuildHasher.hash_one(token)
}
