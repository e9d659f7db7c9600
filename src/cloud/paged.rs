//! Clouds in files that are read page by page.
//!
//! # How it works
//! A file has the points of several clouds, one after the other, without a header. A page is [`PAGE`]
//! consecutive points of a cloud; its last page may have fewer. A table in a second file has the checksum of
//! each page, and bounds of its blocks ([`BLOCK`] points): what a camera may see is known before any point is
//! read. Pages are read, not mapped: what is read through a mapping counts as memory of the process, and
//! truncating a mapped file ends it.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;
use rustix::fs::{Advice, fadvise};

use super::{Bounds, Point};
use crate::error::FileError;
use crate::files::input::{open_regular, read_table};
use crate::files::{Checksum, Hasher};

/// Points of a page.
pub const PAGE: usize = 4096;
/// Points of a block, a part of a page with bounds of its own.
pub const BLOCK: usize = 1024;

const BLOCKS: usize = PAGE / BLOCK;
const POINT_BYTES: u64 = size_of::<Point>() as u64;

/// Entry of a page in the table.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct Page {
    /// Minimum and maximum x, y, z of each block's finite points, meters; NaN without any.
    bounds: [[f32; 6]; BLOCKS],
    /// Of the points.
    xxh3: Checksum,
}

impl Page {
    fn of(points: &[Point]) -> Self {
        let mut bounds = [[f32::NAN; 6]; BLOCKS];
        for (to, block) in bounds.iter_mut().zip(points.chunks(BLOCK)) {
            if let Some(Bounds { min, max }) = Bounds::of_finite(block) {
                *to = [min[0], min[1], min[2], max[0], max[1], max[2]];
            }
        }
        Self { bounds, xxh3: Checksum::of(points) }
    }

    fn blocks(&self) -> impl Iterator<Item = Option<Bounds>> {
        self.bounds.iter().map(|&[x0, y0, z0, x1, y1, z1]| {
            (x0 <= x1).then_some(Bounds { min: [x0, y0, z0], max: [x1, y1, z1] })
        })
    }
}

/// Writer of clouds to a file, with its table.
pub struct PagedWriter {
    path: PathBuf,
    points: BufWriter<File>,
    table_path: PathBuf,
    table: Vec<Page>,
    /// Number of pages before the last cloud.
    first_page: usize,
    /// Points of its last page, if it is not complete.
    rest: Vec<Point>,
    /// Number and checksum of the points that were appended to it.
    points_in_cloud: usize,
    hasher: Hasher,
}

/// Number, bounds and checksum of a cloud's points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CloudSummary {
    /// Number of points.
    pub points: usize,
    /// Bounds of the finite points, meters; `None` without any.
    pub bounds: Option<Bounds>,
    /// Of all points.
    pub xxh3: Checksum,
}

impl PagedWriter {
    /// Creates both files.
    ///
    /// # Errors
    /// Fails if a file cannot be created.
    pub fn create(path: &Path, table: &Path) -> Result<Self, FileError> {
        let file = File::create(path).map_err(FileError::io("create", path))?;
        let points = BufWriter::with_capacity(1 << 20, file);
        Ok(Self {
            path: path.to_owned(),
            points,
            table_path: table.to_owned(),
            table: Vec::new(),
            first_page: 0,
            rest: Vec::new(),
            points_in_cloud: 0,
            hasher: Hasher::default(),
        })
    }

    /// Returns the part of the table for a cloud.
    pub fn table_of(points: &[Point]) -> Vec<u8> {
        let pages: Vec<Page> = points.chunks(PAGE).map(Page::of).collect();
        bytemuck::cast_slice(&pages).to_vec()
    }

    /// Returns the file of points.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Appends a cloud.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn add(&mut self, points: &[Point]) -> Result<(), FileError> {
        self.write(points)?;
        self.end_pages();
        Ok(())
    }

    /// Appends points to the last cloud, which [`PagedWriter::end`] ends.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn append(&mut self, points: &[Point]) -> Result<(), FileError> {
        self.points_in_cloud += points.len();
        self.hasher.add(points);
        self.write(points)
    }

    /// Ends a cloud of appended points; returns its summary.
    pub fn end(&mut self) -> CloudSummary {
        let first_page = self.first_page;
        self.end_pages();
        let blocks = self.table[first_page..].iter().flat_map(Page::blocks);
        let (points, hasher) = (std::mem::take(&mut self.points_in_cloud), std::mem::take(&mut self.hasher));
        CloudSummary { points, bounds: blocks.flatten().reduce(Bounds::and), xxh3: hasher.checksum() }
    }

    /// Writes points and their complete pages.
    fn write(&mut self, points: &[Point]) -> Result<(), FileError> {
        let missing = if self.rest.is_empty() { 0 } else { PAGE - self.rest.len() };
        let (first, others) = points.split_at(missing.min(points.len()));
        self.rest.extend(first);
        if self.rest.len() == PAGE {
            self.end_page();
        }
        let (pages, rest) = others.split_at(others.len() / PAGE * PAGE);
        self.table.par_extend(pages.par_chunks(PAGE).map(Page::of));
        self.rest.extend(rest);
        self.points.write_all(bytemuck::cast_slice(points)).map_err(FileError::io("write", &self.path))
    }

    /// Ends the last page of a cloud.
    fn end_pages(&mut self) {
        if !self.rest.is_empty() {
            self.end_page();
        }
        self.first_page = self.table.len();
    }

    fn end_page(&mut self) {
        self.table.push(Page::of(&self.rest));
        self.rest.clear();
    }

    /// Writes all points that are still in memory.
    ///
    /// # Errors
    /// Fails if the file cannot be written.
    pub fn flush(&mut self) -> Result<(), FileError> {
        self.points.flush().map_err(FileError::io("write", &self.path))
    }

    /// Writes the remaining points and the table; returns its checksum.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
    pub fn finish(&mut self) -> Result<Checksum, FileError> {
        self.flush()?;
        let write = std::fs::write(&self.table_path, bytemuck::cast_slice(&self.table));
        write.map_err(FileError::io("write", &self.table_path))?;
        Ok(Checksum::of(&self.table))
    }
}

/// A cloud's place in a file.
#[derive(Clone, Debug)]
struct Span {
    /// Description in messages.
    name: String,
    first_point: u64,
    points: usize,
    first_page: usize,
}

impl Span {
    fn pages(&self) -> usize {
        self.points.div_ceil(PAGE)
    }
}

/// File of clouds.
#[derive(Debug)]
pub struct PagedFile {
    path: PathBuf,
    file: File,
    table: Vec<Page>,
    spans: Vec<Span>,
}

impl PagedFile {
    /// Opens a file of clouds with some names (for messages) and numbers of points, and its table with some
    /// checksum. Points are validated whenever they are read.
    ///
    /// # Errors
    /// Fails if a file cannot be read or has another size, or if the table has another checksum.
    pub fn open(
        path: &Path,
        table: &Path,
        clouds: impl IntoIterator<Item = (String, usize)>,
        xxh3: Checksum,
    ) -> Result<Self, FileError> {
        let (mut spans, mut first_point, mut first_page) = (Vec::new(), 0_u128, 0);
        for (name, points) in clouds {
            // The sum of all is validated below.
            let span = Span { name, first_point: first_point as u64, points, first_page };
            first_point += points as u128;
            first_page = first_page.saturating_add(span.pages());
            spans.push(span);
        }
        let (file, found) = open_regular(path)?;
        check_size(path, first_point, found)?;
        let bytes = read_table(table)?;
        if bytes.len() != first_page * size_of::<Page>() {
            let expected = format!("{} bytes ({first_page} pages)", first_page * size_of::<Page>());
            return Err(FileError::content(expected, format!("{} bytes", bytes.len()), table));
        }
        xxh3.check(&bytes, || "a table of pages".to_owned(), table)?;
        let table = bytemuck::pod_collect_to_vec(&bytes);
        Ok(Self { path: path.to_owned(), file, table, spans })
    }

    /// Checks that the file still has its size, bytes.
    ///
    /// # Errors
    /// Fails if it has another one.
    pub fn check_size(&self, found: u64) -> Result<(), FileError> {
        check_size(&self.path, self.spans.iter().map(|span| span.points as u128).sum(), found)
    }

    /// Returns all clouds in order.
    pub fn clouds(&self) -> impl Iterator<Item = StoredCloud<'_>> {
        self.spans.iter().map(|span| StoredCloud { file: self, span })
    }
}

fn check_size(path: &Path, points: u128, found: u64) -> Result<(), FileError> {
    let expected = points * u128::from(POINT_BYTES);
    if u128::from(found) == expected {
        return Ok(());
    }
    Err(FileError::content(format!("{expected} bytes ({points} points)"), format!("{found} bytes"), path))
}

/// A cloud of a [`PagedFile`].
#[derive(Clone, Copy, Debug)]
pub struct StoredCloud<'a> {
    file: &'a PagedFile,
    span: &'a Span,
}

impl StoredCloud<'_> {
    /// Returns the number of points.
    pub fn len(&self) -> usize {
        self.span.points
    }

    /// Returns whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the bounds of each block, meters; `None` for a block without finite points.
    pub fn blocks(&self) -> impl Iterator<Item = Option<Bounds>> {
        let Span { first_page, points, .. } = *self.span;
        let pages = &self.file.table[first_page..first_page + self.span.pages()];
        pages.iter().flat_map(Page::blocks).take(points.div_ceil(BLOCK))
    }

    /// Reads points from the first one of a page on, of one or more pages, and validates them.
    ///
    /// # Errors
    /// Fails if the file cannot be read, if it was truncated, or if points do not match their checksum.
    pub fn read(&self, page: usize, points: &mut [Point]) -> Result<(), FileError> {
        let PagedFile { path, file, table, .. } = self.file;
        let Span { name, first_point, first_page, .. } = self.span;
        let offset = (first_point + (page * PAGE) as u64) * POINT_BYTES;
        file.read_exact_at(bytemuck::cast_slice_mut(points), offset).map_err(|error| {
            if error.kind() == std::io::ErrorKind::UnexpectedEof {
                let expected = format!("{} points of {name} from byte {offset} on", points.len());
                return FileError::content(expected, "the end of the file (it was truncated)", path);
            }
            FileError::io("read", path)(error)
        })?;
        for (page, part) in (page..).zip(points.chunks(PAGE)) {
            table[first_page + page].xxh3.check(part, || format!("page {page} of {name}"), path)?;
        }
        Ok(())
    }

    /// Validates all points.
    ///
    /// # Errors
    /// Fails as [`StoredCloud::read`], with the first error.
    pub fn check(&self) -> Result<(), FileError> {
        let mut points = vec![Point::default(); PAGE.min(self.len())];
        for (page, first) in (0..self.len()).step_by(PAGE).enumerate() {
            self.read(page, &mut points[..PAGE.min(self.len() - first)])?;
        }
        Ok(())
    }

    /// Lets the system read all points into its cache, without waiting for it.
    pub fn load_ahead(&self) {
        let Span { first_point, points, .. } = *self.span;
        if let Some(bytes) = std::num::NonZeroU64::new(points as u64 * POINT_BYTES) {
            // Points can be read without it.
            let _ = fadvise(&self.file.file, first_point * POINT_BYTES, Some(bytes), Advice::WillNeed);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cloud(count: usize, from: f32) -> Vec<Point> {
        (0..count).map(|i| Point::new([from + i as f32, 0.5, -1.0], [i as u8, 2, 3], 1)).collect()
    }

    fn write(folder: &Path, clouds: &[Vec<Point>]) -> Checksum {
        let mut writer = PagedWriter::create(&folder.join("p"), &folder.join("t")).unwrap();
        clouds.iter().for_each(|cloud| writer.add(cloud).unwrap());
        writer.finish().unwrap()
    }

    fn open(folder: &Path, lengths: &[usize], xxh3: Checksum) -> Result<PagedFile, FileError> {
        let clouds = lengths.iter().enumerate().map(|(i, length)| (format!("cloud {i}"), *length));
        PagedFile::open(&folder.join("p"), &folder.join("t"), clouds, xxh3)
    }

    #[test]
    fn pages_are_read_in_any_order() {
        let folder = tempfile::tempdir().unwrap();
        let clouds = [cloud(10, 0.0), Vec::new(), cloud(2 * PAGE + 1500, 1e4), cloud(PAGE, 5.0)];
        let xxh3 = write(folder.path(), &clouds);
        let file = open(folder.path(), &clouds.each_ref().map(Vec::len), xxh3).unwrap();
        let stored: Vec<StoredCloud> = file.clouds().collect();
        for (stored, points) in stored.iter().zip(&clouds).rev() {
            assert_eq!((stored.len(), stored.is_empty()), (points.len(), points.is_empty()));
            let bounds: Vec<_> = points.chunks(BLOCK).map(Bounds::of).collect();
            assert_eq!(stored.blocks().collect::<Vec<_>>(), bounds);
            for (page, expected) in points.chunks(PAGE).enumerate().rev() {
                let mut found = vec![Point::default(); expected.len()];
                stored.read(page, &mut found).unwrap();
                assert_eq!(found, expected);
            }
            stored.load_ahead();
        }
        let mut both = vec![Point::default(); PAGE + 1500];
        stored[2].read(1, &mut both).unwrap();
        assert_eq!(both, clouds[2][PAGE..]);
    }

    /// The same bytes result from a cloud in parts of any size.
    #[test]
    fn clouds_are_written_in_parts() {
        let clouds = [cloud(3 * PAGE + 700, 0.0), cloud(2 * PAGE, 7.0), cloud(5, 1.0)];
        let folders = [(); 2].map(|()| tempfile::tempdir().unwrap());
        let whole = write(folders[0].path(), &clouds);
        let [points, table] = ["p", "t"].map(|name| folders[1].path().join(name));
        let mut writer = PagedWriter::create(&points, &table).unwrap();
        for (cloud, size) in clouds.iter().zip([1500, PAGE, 3]) {
            cloud.chunks(size).for_each(|part| writer.append(part).unwrap());
            let (bounds, xxh3) = (Bounds::of(cloud), Checksum::of(cloud));
            assert_eq!(writer.end(), CloudSummary { points: cloud.len(), bounds, xxh3 });
        }
        assert_eq!(writer.finish().unwrap(), whole);
        let [bytes, parts] = folders.each_ref().map(|folder| std::fs::read(folder.path().join("p")).unwrap());
        assert!(bytes == parts);
    }

    #[test]
    fn blocks_without_finite_points_have_no_bounds() {
        let folder = tempfile::tempdir().unwrap();
        let mut points = cloud(BLOCK + 1, 0.0);
        points[BLOCK].position[1] = f32::INFINITY;
        let xxh3 = write(folder.path(), &[points]);
        let file = open(folder.path(), &[BLOCK + 1], xxh3).unwrap();
        let blocks: Vec<_> = file.clouds().next().unwrap().blocks().collect();
        assert!(blocks.len() == 2 && blocks[0].is_some() && blocks[1].is_none(), "{blocks:?}");
    }

    #[test]
    fn damage_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let clouds = [cloud(PAGE + 1, 0.0), cloud(5, 0.0)];
        let xxh3 = write(folder.path(), &clouds);
        let lengths = [PAGE + 1, 5];
        let message = |file: Result<PagedFile, FileError>| file.unwrap_err().to_string();
        let short = message(open(folder.path(), &[PAGE, 5], xxh3));
        assert!(short.contains("expected 65616 bytes (4101 points), found 65632 bytes"), "{short}");
        let huge = message(open(folder.path(), &[usize::MAX, usize::MAX], xxh3));
        assert!(huge.contains("points), found 65632 bytes"), "{huge}");
        let file = open(folder.path(), &lengths, xxh3).unwrap();
        let (points, table) = (folder.path().join("p"), folder.path().join("t"));
        // The file changes while it is open.
        let mut bytes = std::fs::read(&points).unwrap();
        bytes[PAGE * 16] ^= 1;
        std::fs::write(&points, &bytes).unwrap();
        let read = |cloud: usize, page| {
            let stored = file.clouds().nth(cloud).unwrap();
            let mut points = vec![Point::default(); if (cloud, page) == (0, 0) { PAGE } else { 1 }];
            stored.read(page, &mut points).map_err(|error| error.to_string())
        };
        assert_eq!(read(0, 0), Ok(()));
        let checked: Vec<bool> = file.clouds().map(|cloud| cloud.check().is_ok()).collect();
        assert_eq!(checked, [false, true]);
        let changed = read(0, 1).unwrap_err();
        assert!(changed.contains("expected page 1 of cloud 0 with checksum"), "{changed}");
        std::fs::File::options().write(true).open(&points).unwrap().set_len(1000).unwrap();
        let cut = read(0, 1).unwrap_err();
        assert!(cut.contains("1 points of cloud 0 from byte 65536 on, found the end of the file"), "{cut}");
        std::fs::write(&points, &bytes).unwrap();
        let mut entries = std::fs::read(&table).unwrap();
        entries[0] ^= 1;
        std::fs::write(&table, &entries).unwrap();
        let changed = message(open(folder.path(), &lengths, xxh3));
        assert!(changed.contains("expected a table of pages with checksum"), "{changed}");
        std::fs::write(&table, &entries[..200]).unwrap();
        let cut = message(open(folder.path(), &lengths, xxh3));
        assert!(cut.contains("expected 312 bytes (3 pages), found 200 bytes"), "{cut}");
    }
}
