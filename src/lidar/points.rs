//! Positions of visible points, on the host.
//!
//! # How it works
//! A rasterizer says which point each pixel shows. Its exact position decides the range, since a pixel of the
//! ground far ahead is a meter long. Pages of clouds with visible points are read when they are first needed,
//! and stay while memory lasts; they are the points that the rasterizer reads, so this changes no result.

use glam::{DAffine3, Vec3};
use rayon::prelude::*;

use super::image::Hit;
use crate::cloud::paged::PAGE;
use crate::cloud::{Cloud, Point};
use crate::error::FileError;
use crate::geometry::View;
use crate::raster::{CloudSet, Instance};

/// Pages that stay in memory, 64 KiB each: 1 GiB.
const PAGES: usize = 16_384;

/// Points before and after a point in the order of a cloud that may be its neighbors.
const NEIGHBORS: usize = 16;
/// Distance of neighbors, meters.
const NEAR_M: f32 = 0.1;

/// Points of clouds by their pages.
pub(crate) struct PointPages<'a> {
    clouds: CloudSet<'a>,
    /// Index of each cloud's first page, and the number of all pages.
    firsts: Vec<usize>,
    /// Pages that are in memory.
    pages: Vec<Option<Vec<Point>>>,
    /// Call that last used each page.
    used: Vec<u64>,
    call: u64,
    loaded: usize,
}

/// Place of a numbered point: its instance, and its index in the instance's cloud.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Place {
    pub(super) instance: usize,
    pub(super) point: usize,
}

/// Numbers of the points of instances, which are consecutive.
pub(super) struct Numbers {
    /// Number of points before each instance, and of all.
    before: Vec<u64>,
}

impl Numbers {
    /// Returns the place of a point by its number; `None` beyond the last.
    pub(super) fn place(&self, number: u32) -> Option<Place> {
        let number = u64::from(number);
        let instance = self.before.partition_point(|before| *before <= number).checked_sub(1)?;
        (instance + 1 < self.before.len())
            .then(|| Place { instance, point: (number - self.before[instance]) as usize })
    }
}

impl<'a> PointPages<'a> {
    /// Creates the pages of clouds; none is read.
    pub(crate) fn new(clouds: CloudSet<'a>) -> Self {
        let mut firsts = vec![0];
        firsts.extend(clouds.iter().scan(0, |pages, cloud| {
            *pages += cloud.len().div_ceil(PAGE);
            Some(*pages)
        }));
        let count = firsts.last().copied().unwrap_or(0);
        Self { clouds, firsts, pages: vec![None; count], used: vec![0; count], call: 0, loaded: 0 }
    }

    /// Returns the numbers of the points of instances.
    pub(super) fn numbers(&self, instances: &[Instance]) -> Numbers {
        let mut before = vec![0];
        before.extend(instances.iter().scan(0, |points, instance| {
            *points += self.clouds.get(instance.cloud).map_or(0, |cloud| cloud.len() as u64);
            Some(*points)
        }));
        Numbers { before }
    }

    /// Reads the pages of visible points into memory, if they are not there. `points` are maps of point
    /// numbers + 1, 0 where empty.
    ///
    /// # Errors
    /// Fails if points cannot be read or are damaged.
    pub(super) fn load(
        &mut self,
        instances: &[Instance],
        numbers: &Numbers,
        points: &[&[u32]],
    ) -> Result<(), FileError> {
        self.call += 1;
        let bits = vec![false; self.pages.len()];
        let rows = points.par_iter().flat_map(|map| map.par_chunks(1 << 16));
        let needed = rows
            .fold(
                || bits.clone(),
                |mut bits, row| {
                    for place in row.iter().filter_map(|point| numbers.place(point.checked_sub(1)?)) {
                        bits[self.page(instances[place.instance].cloud, place.point)] = true;
                    }
                    bits
                },
            )
            .reduce(
                || bits.clone(),
                |mut all, some| {
                    all.iter_mut().zip(some).for_each(|(all, some)| *all |= some);
                    all
                },
            );
        let missing: Vec<usize> =
            (0..needed.len()).filter(|&i| needed[i] && self.pages[i].is_none()).collect();
        (0..needed.len()).filter(|i| needed[*i]).for_each(|i| self.used[i] = self.call);
        let read: Result<Vec<Vec<Point>>, FileError> =
            missing.par_iter().map(|page| self.read(*page)).collect();
        for (page, points) in missing.into_iter().zip(read?) {
            self.pages[page] = Some(points);
            self.loaded += 1;
        }
        self.evict();
        Ok(())
    }

    /// Returns the page of a point of an instance; `None` if it is not in memory.
    fn page_of(&self, instance: &Instance, point: usize) -> Option<&[Point]> {
        self.pages[self.page(instance.cloud, point)].as_deref()
    }

    /// Returns the mean position of a point and of its neighbors, meters, and its class. The nearest of
    /// several noisy points is nearer than their surface. Points are sorted in space, so neighbors are next
    /// to it.
    fn smoothed(&self, instance: &Instance, point: usize) -> Option<(Vec3, u8)> {
        let (page, at) = (self.page_of(instance, point)?, point % PAGE);
        let own = Vec3::from(page.get(at)?.position);
        let (mut sum, mut count) = (Vec3::ZERO, 0.0);
        for other in &page[at.saturating_sub(NEIGHBORS)..(at + NEIGHBORS + 1).min(page.len())] {
            let offset = Vec3::from(other.position) - own;
            if offset.length_squared() <= NEAR_M * NEAR_M {
                sum += offset;
                count += 1.0;
            }
        }
        Some((own + sum / count, page[at].class()))
    }

    /// Returns the visible point of each pixel of a view, in the frame of its camera. `points` has the
    /// numbers + 1 of the points, 0 where empty.
    pub(super) fn hits(
        &self,
        view: &View,
        instances: &[Instance],
        numbers: &Numbers,
        points: &[u32],
    ) -> Vec<Hit> {
        let camera_from_local: Vec<DAffine3> =
            instances.iter().map(|instance| view.camera_from_world * instance.world_from_local).collect();
        let hit = |point: &u32| {
            let Place { instance, point } = numbers.place(point.checked_sub(1)?)?;
            let posed = &instances[instance];
            let (position, class) = self.smoothed(posed, point)?;
            let at = camera_from_local[instance].transform_point3(position.as_dvec3());
            (at.z > 0.0).then(|| Hit {
                at: [(at.x / at.z) as f32, (at.y / at.z) as f32],
                inverse_z: (1.0 / at.z) as f32,
                label: posed.number << 8 | u32::from(class),
            })
        };
        points.par_iter().with_min_len(1 << 12).map(|point| hit(point).unwrap_or_default()).collect()
    }

    fn page(&self, cloud: usize, point: usize) -> usize {
        self.firsts[cloud] + point / PAGE
    }

    fn read(&self, page: usize) -> Result<Vec<Point>, FileError> {
        let cloud = self.firsts.partition_point(|first| *first <= page) - 1;
        let first = (page - self.firsts[cloud]) * PAGE;
        let count = PAGE.min(self.clouds[cloud].len() - first);
        match &self.clouds[cloud] {
            Cloud::Memory(points) => Ok(points[first..first + count].to_vec()),
            Cloud::Stored(stored) => {
                let mut points = vec![Point::default(); count];
                stored.read(first / PAGE, &mut points)?;
                Ok(points)
            }
        }
    }

    /// Drops the pages that were not used for longest, while there are too many. Those of this call stay.
    fn evict(&mut self) {
        if self.loaded <= PAGES {
            return;
        }
        let mut old: Vec<usize> =
            (0..self.pages.len()).filter(|i| self.pages[*i].is_some() && self.used[*i] < self.call).collect();
        old.sort_by_key(|page| self.used[*page]);
        for page in old.into_iter().take(self.loaded - PAGES) {
            self.pages[page] = None;
            self.loaded -= 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DAffine3;

    #[test]
    fn points_are_found_by_their_numbers() {
        let cloud = |count: usize, from: usize| -> Vec<Point> {
            (0..count).map(|i| Point::new([(from + i) as f32, 0.0, 0.0], [0; 3], 0)).collect()
        };
        let (small, large) = (cloud(3, 0), cloud(PAGE + 10, 100));
        let mut pages = PointPages::new(vec![(&small).into(), (&large).into()]);
        let instance = |cloud| Instance { cloud, world_from_local: DAffine3::IDENTITY, number: 0 };
        let instances = [instance(0), instance(1), instance(0)];
        let numbers = pages.numbers(&instances);
        let last = (PAGE + 13) as u32;
        pages.load(&instances, &numbers, &[&[0, 1, 3, 4, last, last + 1, last + 3]]).unwrap();
        let x = |number: u32| {
            let Place { instance, point } = numbers.place(number)?;
            Some(pages.page_of(&instances[instance], point)?[point % PAGE].position[0])
        };
        let found = [0, 2, 3, last - 1, last, last + 2, last + 3].map(x);
        let end = (PAGE + 109) as f32;
        assert_eq!(found, [Some(0.0), Some(2.0), Some(100.0), Some(end), Some(0.0), Some(2.0), None]);
    }

    #[test]
    fn positions_are_means_of_neighbors() {
        let xs = [0.0, 0.01, 0.05, 5.0, 5.01];
        let points: Vec<Point> = xs.iter().map(|x| Point::new([*x, 1.0, 2.0], [0; 3], 3)).collect();
        let mut pages = PointPages::new(vec![(&points).into()]);
        let instances = [Instance { cloud: 0, world_from_local: DAffine3::IDENTITY, number: 0 }];
        let numbers = pages.numbers(&instances);
        pages.load(&instances, &numbers, &[&[1]]).unwrap();
        for (point, expected) in [(0, 0.02), (1, 0.02), (3, 5.005)] {
            let (position, class) = pages.smoothed(&instances[0], point).unwrap();
            assert!(position.distance(Vec3::new(expected, 1.0, 2.0)) < 1e-6 && class == 3, "{position}");
        }
    }

    #[test]
    fn only_pages_with_visible_points_are_read() {
        let points = vec![Point::default(); 3 * PAGE];
        let mut pages = PointPages::new(vec![(&points).into()]);
        let instances = [Instance { cloud: 0, world_from_local: DAffine3::IDENTITY, number: 0 }];
        let numbers = pages.numbers(&instances);
        pages.load(&instances, &numbers, &[&[0, 1 + 2 * PAGE as u32], &[0]]).unwrap();
        let loaded: Vec<bool> = pages.pages.iter().map(Option::is_some).collect();
        assert_eq!(loaded, [false, false, true]);
    }
}
