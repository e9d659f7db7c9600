use std::path::{Path, PathBuf};

use glam::DVec3;
use serde::Serialize;

use super::{Point, PointFile, npy, ply};
use crate::error::FileError;
use crate::files::input::is_taken;
use crate::files::{FileKind, Inputs, OutputFile};
use crate::named;

/// File format of points.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PointFormat {
    /// NumPy array of floats, Nx6 (x y z r g b) or Nx7 with the class last.
    Npy,
    /// PLY.
    Ply,
}

named!(PointFormat, "point format" {
    Npy => "npy", "";
    Ply => "ply", "";
});

impl PointFormat {
    /// Returns the format of a file by its extension; `None` for other extensions.
    pub fn of(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_str()?.to_ascii_lowercase();
        [Self::Npy, Self::Ply].into_iter().find(|format| format.extension() == extension)
    }

    /// Returns the file extension, without the dot.
    pub fn extension(self) -> &'static str {
        match self {
            Self::Npy => "npy",
            Self::Ply => "ply",
        }
    }

    /// Returns the kind of its files, as written here.
    pub fn kind(self) -> FileKind {
        match self {
            Self::Npy => FileKind {
                name: "an NPY file of points",
                // Headers of such shapes are padded to 128 bytes. NumPy writes shapes without the last comma.
                begin: b"\x93NUMPY\x01\x00\x76\x00{'descr': '<f4', 'fortran_order': False, 'shape': (",
                marks: &[b", 6, ), }", b", 7, ), }"],
            },
            Self::Ply => FileKind {
                name: "a PLY file of pskel",
                begin: b"ply\nformat binary_little_endian 1.0\nelement vertex ",
                marks: &[b"property uchar class\nend_header\n"],
            },
        }
    }

    /// Writes points. NPY files have a column of classes only if `with_class`.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn write(self, path: &Path, points: &[Point], with_class: bool) -> Result<(), FileError> {
        match self {
            Self::Npy => npy::write(path, points, with_class),
            Self::Ply => ply::write(path, points),
        }
    }

    /// Opens, before any work, a file of points to write, and the file of its origin beside it:
    /// `FILE.origin.json`, like `p.npy.origin.json`.
    ///
    /// # Errors
    /// Fails as [`OutputFile::open`] for either. A file of the origin that cannot be written is an error only
    /// if there is an origin.
    pub fn open_files(self, path: &Path, inputs: &Inputs) -> Result<PointOutput, FileError> {
        let points = OutputFile::open(path, self.kind(), inputs)?;
        let mut origin = points.path().as_os_str().to_owned();
        origin.push(".origin.json");
        match OutputFile::open(Path::new(&origin), ORIGIN, inputs) {
            Err(error @ FileError::Content { .. }) => Err(error),
            origin => Ok(PointOutput { format: self, points, origin }),
        }
    }
}

/// Files of points to write, see [`PointFormat::open_files`].
#[derive(Debug)]
pub struct PointOutput {
    format: PointFormat,
    points: OutputFile,
    origin: Result<OutputFile, FileError>,
}

impl PointOutput {
    /// Writes the points of a file. If they are relative to an origin, also writes that, and returns its
    /// path. Otherwise removes the origin of an earlier file.
    ///
    /// # Errors
    /// Fails if a file cannot be written, or if a file of another kind has the name of the origin's by now.
    pub fn write(self, file: &PointFile) -> Result<Option<PathBuf>, FileError> {
        let with_class = file.points.iter().any(|p| p.class() != 0);
        let write = || self.format.write(self.points.path(), &file.points, with_class);
        if file.origin != DVec3::ZERO {
            let origin = self.origin?;
            // Written before the points, so that points never exist without their origin.
            origin.write_json(&FileOrigin { origin: file.origin.to_array() })?;
            return write().map(|()| Some(origin.path().to_owned()));
        }
        let stale = self.origin.as_ref().ok().map(OutputFile::path).filter(|path| is_taken(path));
        stale.map_or(Ok(()), |path| ORIGIN.check(path))?;
        write()?;
        stale.map_or(Ok(()), |path| std::fs::remove_file(path).map_err(FileError::io("delete", path)))?;
        Ok(None)
    }
}

/// File kind of an origin.
const ORIGIN: FileKind =
    FileKind { name: "an origin of points", begin: b"{\n  \"origin\": [", marks: &[b"]\n}"] };

/// Origin file beside points whose coordinates are relative to an origin.
#[derive(Serialize)]
struct FileOrigin {
    origin: [f64; 3],
}
