//! Ego paths read from files.

use std::path::Path;

use glam::DVec2;
use point_skeleton::cloud::npy;
use point_skeleton::error::FileError;
use point_skeleton::files::input::{read_file, utf8};
use point_skeleton::files::json;
use point_skeleton::geometry::Polyline;
use serde::Serialize;

/// Path of points for the ego: meters in the ego frame at its [anchor](crate::PathAnchor), x forward, y to
/// the left.
#[derive(Clone, Debug, PartialEq)]
pub struct LocalPath {
    points: Vec<[f64; 2]>,
}

/// Errors of reading or validating a path.
#[derive(Debug, thiserror::Error)]
pub enum LocalPathError {
    /// A file cannot be read or parsed.
    #[error(transparent)]
    File(#[from] FileError),
    /// The points do not form a path.
    #[error("expected {expected}, found {found}")]
    Points {
        /// Expected property of the points.
        expected: &'static str,
        /// Actual value.
        found: String,
    },
}

/// Maximum number of points: about half the Earth's circumference at a point per meter.
const MAX_POINTS: usize = 20_000_000;
/// Maximum file size, at an upper bound of bytes per point in text; checked before reading.
pub(crate) const MAX_BYTES: u64 = 64 * MAX_POINTS as u64;
/// Maximum coordinate, meters.
const MAX_COORDINATE_M: f64 = 1e7;

impl LocalPath {
    /// Creates a path from points in meters, x forward and y to the left of the ego at the anchor. The path
    /// starts at the ego, even if the points do not.
    ///
    /// # Errors
    /// Fails if there are fewer than 2 or more than 20 million points, if a point is not finite or too far
    /// away, or if all points coincide.
    pub fn new(points: Vec<[f64; 2]>) -> Result<Self, LocalPathError> {
        let wrong = |expected: &'static str, found: String| Err(LocalPathError::Points { expected, found });
        if points.len() < 2 || points.len() > MAX_POINTS {
            return wrong("a path of 2 to 20 million points", format!("{}", points.len()));
        }
        let far = |p: &[f64; 2]| !p.iter().all(|v| v.abs() <= MAX_COORDINATE_M);
        if let Some(i) = points.iter().position(far) {
            let [x, y] = points[i];
            return wrong("finite points within 10000 km of the ego", format!("({x}, {y}) at point {i}"));
        }
        if Polyline::new(points.iter().map(|p| DVec2::from_array(*p))).is_none() {
            return wrong("a path with a length", "points at one place".to_owned());
        }
        Ok(Self { points })
    }

    /// Reads a path from `.json` (a list of points, or an object with such a list as `points`), `.npy`
    /// (floats of 16, 32 or 64 bits, `[N, 2]`), or text in two columns (`.csv`, `.txt`, `.tsv`). Text columns
    /// are separated by commas, semicolons or blanks; a header line and text from `#` on are skipped.
    ///
    /// # Errors
    /// Fails if the file cannot be read or has another format. Returns any error of [`LocalPath::new`].
    pub fn read(path: &Path) -> Result<Self, LocalPathError> {
        Self::parse(&read_file(path, MAX_BYTES)?, path)
    }

    /// Parses the content of a file as [`LocalPath::read`] does.
    pub(crate) fn parse(bytes: &[u8], path: &Path) -> Result<Self, LocalPathError> {
        let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        let points = match extension.as_deref() {
            Some("json") => from_json(bytes, path)?,
            Some("npy") => from_npy(bytes, path)?,
            Some("csv" | "txt" | "tsv") => from_text(bytes, path)?,
            _ => {
                let found = extension.unwrap_or_else(|| "none".to_owned());
                return Err(FileError::content("an ending .json, .npy, .csv or .txt", found, path).into());
            }
        };
        Self::new(points).map_err(|error| match error {
            LocalPathError::Points { expected, found } => FileError::content(expected, found, path).into(),
            error => error,
        })
    }

    /// Returns the points, meters in the ego frame at the anchor.
    pub fn points(&self) -> &[[f64; 2]] {
        &self.points
    }
}

impl Serialize for LocalPath {
    /// Serializes the number of points and a hash of them, which suffices to distinguish paths.
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        use std::hash::{Hash, Hasher};
        let mut hasher = rand_seeder::SipHasher::new();
        for [x, y] in &self.points {
            (x.to_bits(), y.to_bits()).hash(&mut hasher);
        }
        format!("{} points {:016x}", self.points.len(), hasher.finish()).serialize(serializer)
    }
}

fn from_json(bytes: &[u8], path: &Path) -> Result<Vec<[f64; 2]>, FileError> {
    #[derive(serde::Deserialize)]
    struct Named {
        points: Vec<[f64; 2]>,
    }
    const EXPECTED: &str = "a list of [x, y] or {\"points\": [[x, y], ..]}";
    // One form at a time, so that errors name the place in it.
    let is_object = utf8(bytes).is_ok_and(|text| text.trim_start().starts_with('{'));
    if is_object {
        return json::parse(bytes, EXPECTED, path).map(|named: Named| named.points);
    }
    json::parse(bytes, EXPECTED, path)
}

fn from_npy(bytes: &[u8], path: &Path) -> Result<Vec<[f64; 2]>, FileError> {
    npy::rows(bytes, path)
}

fn from_text(bytes: &[u8], path: &Path) -> Result<Vec<[f64; 2]>, FileError> {
    let text = utf8(bytes).map_err(|found| FileError::content("UTF-8 text", found, path))?;
    let mut points = Vec::new();
    let mut header = false;
    for (number, line) in text.lines().enumerate() {
        let line = line.split('#').next().unwrap_or_default().trim();
        if line.is_empty() {
            continue;
        }
        let columns = |c: char| c == ',' || c == ';' || c.is_whitespace();
        let cells: Vec<&str> = line.split(columns).filter(|cell| !cell.is_empty()).collect();
        let numbers: Vec<f64> = cells.iter().filter_map(|cell| cell.parse().ok()).collect();
        match (numbers[..].try_into(), cells.len()) {
            (Ok(point), 2) => points.push(point),
            // A header line has no number and occurs once.
            (_, 2) if numbers.is_empty() && points.is_empty() && !header => header = true,
            _ => {
                let found = format!("{:?} in line {}", line.chars().take(60).collect::<String>(), number + 1);
                return Err(FileError::content("two numbers a line", found, path));
            }
        }
    }
    Ok(points)
}
