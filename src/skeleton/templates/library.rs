//! Template library: a folder with `templates.json` and `templates.points`, in the layout of a skeleton's
//! points.

use std::io::Write;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{TemplateCloud, TemplateOptions, TemplateReport};
use crate::cloud::Point;
use crate::error::FileError;
use crate::files::Checksum;
use crate::files::input::is_taken;
use crate::files::{Inputs, TEMPLATES as KIND, WholeFolder, write_json, write_whole};
use crate::gpu::MappedFile;
use crate::skeleton::entry::Entry;
use crate::skeleton::store::read_manifest;
use crate::skeleton::{Source, Template};

const MANIFEST: &str = "templates.json";
const POINTS: &str = "templates.points";

/// Contents of `templates.json`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LibraryManifest {
    /// [`LibraryManifest::FORMAT`].
    pub format: String,
    /// [`LibraryManifest::VERSION`].
    pub version: u32,
    /// Source logs of the actors.
    pub sources: Vec<LogSource>,
    /// Options with which the templates were generated.
    pub options: TemplateOptions,
    /// Report: assets used and dropped.
    pub report: TemplateReport,
    /// Templates whose clouds `templates.points` stores consecutively.
    pub templates: Vec<Template>,
}

/// Source log of actors.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LogSource {
    /// Log.
    #[serde(flatten)]
    pub source: Source,
    /// Number of assets.
    pub actors: usize,
}

impl LibraryManifest {
    /// Format identifier in the manifest.
    pub const FORMAT: &'static str = "point-skeleton-templates";
    /// Format version; incremented when older readers would misread a library.
    pub const VERSION: u32 = 2;
}

/// Templates that several skeletons can share.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TemplateLibrary {
    /// Manifest; its `templates` equal the manifests of `clouds`.
    pub manifest: LibraryManifest,
    /// Templates with their points, in the order of kinds.
    pub clouds: Vec<TemplateCloud>,
}

impl TemplateLibrary {
    /// Creates a library from templates and the report on their generation.
    pub fn new(
        sources: Vec<LogSource>,
        options: TemplateOptions,
        (clouds, report): (Vec<TemplateCloud>, TemplateReport),
    ) -> Self {
        let templates = clouds.iter().map(|(template, _)| template.clone()).collect();
        let (format, version) = (LibraryManifest::FORMAT.into(), LibraryManifest::VERSION);
        Self { manifest: LibraryManifest { format, version, sources, options, report, templates }, clouds }
    }

    /// Opens the output folder for [`TemplateLibrary::write`]; it must differ from `inputs`.
    ///
    /// # Errors
    /// Returns any error of [`WholeFolder::open`].
    pub fn target(path: &Path, inputs: &Inputs) -> Result<WholeFolder, FileError> {
        WholeFolder::open(path, KIND, inputs)
    }

    /// Returns whether a folder looks like a library.
    pub fn is_at(path: &Path) -> bool {
        is_taken(&path.join(MANIFEST))
    }

    /// Writes the folder; `more` may add files to it. An existing library is replaced.
    ///
    /// # Errors
    /// Returns any error of `more`. Fails if a file cannot be written or if the target holds anything but a
    /// library. Partial output is removed.
    pub fn write<E: From<FileError>>(
        &self,
        target: WholeFolder,
        more: impl FnOnce(&Path) -> Result<(), E>,
    ) -> Result<(), E> {
        target.write(|folder| {
            let file = folder.join(POINTS);
            write_whole::<FileError>(&file, |writer| {
                let mut clouds = self.clouds.iter();
                let write = |(_, points): &TemplateCloud| writer.write_all(bytemuck::cast_slice(points));
                clouds.try_for_each(write).map_err(FileError::io("write", &file))
            })?;
            more(folder)?;
            Ok(write_json(&folder.join(MANIFEST), &self.manifest)?)
        })
    }

    /// Returns a checksum of a library's templates, which contain the checksums of their points, as 16
    /// hexadecimal digits.
    ///
    /// # Errors
    /// Fails if the manifest is missing or damaged, or has another format or version.
    pub fn fingerprint_at(path: &Path) -> Result<String, FileError> {
        let path = path.join(MANIFEST);
        let templates = serde_json::to_vec(&read_library(&path)?.templates);
        let templates = templates.map_err(|error| FileError::io("read", &path)(error.into()))?;
        Ok(Checksum::of(&templates).to_string())
    }

    /// Reads a library.
    ///
    /// # Errors
    /// Fails if a file is missing or damaged, or has another format or version.
    pub fn open(path: &Path) -> Result<Self, FileError> {
        let manifest = read_library(&path.join(MANIFEST))?;
        let file = path.join(POINTS);
        let mapped = MappedFile::open(&file)?;
        let bytes = mapped.as_bytes();
        let total: u128 = manifest.templates.iter().map(|t| t.points as u128).sum();
        let expected = total * size_of::<Point>() as u128;
        if bytes.len() as u128 != expected {
            let expected = format!("{expected} bytes ({total} points)");
            return Err(FileError::content(expected, format!("{} bytes", bytes.len()), &file));
        }
        let mut rest = bytes;
        let cloud = |(index, template): (usize, &Template)| {
            let (head, tail) = rest.split_at(template.points * size_of::<Point>());
            rest = tail;
            let points: Vec<Point> = bytemuck::pod_collect_to_vec(head);
            template.check(index, &points, &file)?;
            Ok((template.clone(), points))
        };
        let clouds = manifest.templates.iter().enumerate().map(cloud).collect::<Result<_, FileError>>()?;
        Ok(Self { manifest, clouds })
    }
}

fn read_library(path: &Path) -> Result<LibraryManifest, FileError> {
    let format = (LibraryManifest::FORMAT, LibraryManifest::VERSION);
    let manifest: LibraryManifest = read_manifest(path, "a list of templates", format)?;
    for (i, template) in manifest.templates.iter().enumerate() {
        if manifest.templates[..i].iter().any(|other| other.kind == template.kind) {
            let found = format!("{} twice", template.kind.name());
            return Err(FileError::content("one template a kind", found, path));
        }
        template.check_limits(path)?;
    }
    Ok(manifest)
}
