use glam::DAffine3;
use rayon::prelude::*;

use super::estimator::{Candidate, ColorView};
use super::estimator::{LANES, LaneSamples, agreed_colors};
use crate::skeleton::ingest::projector::{Corners, Pixels, PointColumns};
use crate::skeleton::ingest::sweep::SweepCloud;
use crate::skeleton::{Coloring, Projector};
use crate::vectors::wide;

/// Number of points per job.
const JOB: usize = 1024;

/// Colors the points of a sweep taken at `t_us`. `place` returns the pose that a part has at a time.
pub(in super::super) fn sweep(
    cloud: &mut SweepCloud,
    t_us: i64,
    views: &[&ColorView],
    how: Coloring,
    place: impl Fn(Option<usize>, i64) -> Option<DAffine3> + Sync,
) {
    let parts: Vec<_> = cloud.parts_mut().collect();
    parts.into_par_iter().for_each(|(track, points)| {
        if how == Coloring::EveryCamera {
            if let Some(place) = place(track, t_us) {
                copy_for_every_view(views, &place, points);
            }
            return;
        }
        let placed: Vec<(&ColorView, Projector)> = (views.iter())
            .filter_map(|view| Some((*view, Projector::new(&view.view, &place(track, view.t_us)?))))
            .collect();
        color_part(points, &placed);
    });
}

/// Colors the points of a part, which are sorted in space.
fn color_part(points: &mut [Candidate], views: &[(&ColorView, Projector)]) {
    color_jobs(points, views, Hidden::Refused);
    // A point that every image hides is still part of the geometry, and the test is not perfect.
    let hidden: Vec<usize> = (0..points.len()).filter(|i| points[*i].rgb.is_none()).collect();
    let mut rest: Vec<Candidate> = hidden.iter().map(|i| points[*i]).collect();
    color_jobs(&mut rest, views, Hidden::Accepted);
    for (i, point) in hidden.iter().zip(rest) {
        points[*i].rgb = point.rgb;
    }
}

/// Whether views that do not see a point count.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Hidden {
    Refused,
    Accepted,
}

fn color_jobs(points: &mut [Candidate], views: &[(&ColorView, Projector)], hidden: Hidden) {
    let jobs = points.par_chunks_mut(JOB);
    jobs.for_each_init(Workspace::default, |space, job| space.color(job, views, hidden));
}

/// Buffers of a job.
#[derive(Default)]
struct Workspace {
    columns: PointColumns,
    pixels: Pixels,
    /// Samples per group of points, as many as views.
    samples: Vec<LaneSamples>,
    /// Number of samples per point.
    counts: Vec<usize>,
}

impl Workspace {
    /// Colors points from views, each with its projection. All points are looked up in one image before the
    /// next; together they need a small piece of it.
    fn color(&mut self, points: &mut [Candidate], views: &[(&ColorView, Projector)], hidden: Hidden) {
        let Self { columns, pixels, samples, counts } = self;
        let positions = points.iter().map(|point| point.position);
        let bounds = Corners::of(positions.clone());
        columns.set(positions);
        let near: Vec<_> = views.iter().filter(|(_, project)| !project.misses(&bounds)).collect();
        let places = near.len().max(1);
        samples.clear();
        samples.resize(points.len().div_ceil(LANES) * places, LaneSamples::NONE);
        counts.clear();
        counts.resize(points.len(), 0);
        for (view, project) in &near {
            project.pixels(columns, pixels);
            let radii = view.radii();
            wide(
                #[inline(always)]
                || {
                    for (i, pixel, depth_m) in pixels.iter() {
                        if hidden == Hidden::Accepted || !view.hides(pixel, depth_m) {
                            let sample = view.sample(radii, pixel, depth_m);
                            samples[i / LANES * places + counts[i]].set(i % LANES, sample);
                            counts[i] += 1;
                        }
                    }
                },
            );
        }
        wide(
            #[inline(always)]
            || {
                let groups = points.chunks_mut(LANES).zip(counts.chunks(LANES)).zip(samples.chunks(places));
                for ((points, counts), samples) in groups {
                    let most = counts.iter().max().map_or(0, |most| *most);
                    let colors = agreed_colors(&samples[..most]);
                    for ((point, count), color) in points.iter_mut().zip(counts).zip(colors) {
                        point.rgb = (*count > 0).then_some(color);
                    }
                }
            },
        );
    }
}

/// Implements [`Coloring::EveryCamera`]: every part has its pose at the sweep's time.
fn copy_for_every_view(views: &[&ColorView], place: &DAffine3, points: &mut Vec<Candidate>) {
    let project: Vec<Projector> = views.iter().map(|v| Projector::new(&v.view, place)).collect();
    let mut copies = Vec::with_capacity(points.len());
    for point in points.iter() {
        let seen = views.iter().zip(&project).filter_map(|(view, project)| {
            let (pixel, _) = project.pixel(point.position)?;
            Some(view.image.get_pixel(pixel.x as u32, pixel.y as u32).0)
        });
        let before = copies.len();
        copies.extend(seen.map(|rgb| Candidate { rgb: Some(rgb), ..*point }));
        if copies.len() == before {
            copies.push(*point); // counted as uncolored later
        }
    }
    *points = copies;
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use image::{Rgb, RgbImage};

    use super::*;
    use crate::geometry::{Camera, View};
    use crate::skeleton::ingest::occlusion::OcclusionGrid;

    /// A camera at the origin that looks along z and sees one color; `wall_m`: depth of a wall that fills its
    /// image.
    fn view(grey: u8, wall_m: Option<f64>) -> ColorView {
        let camera =
            Camera::new("c", 160, 90, [[100.0, 0.0, 80.0], [0.0, 100.0, 45.0], [0.0, 0.0, 1.0]]).unwrap();
        let mut grid = OcclusionGrid::new(&camera);
        for (x, y) in (0..90).flat_map(|y| (0..160).map(move |x| (x, y))) {
            if let Some(wall_m) = wall_m {
                grid.add(glam::DVec2::new(f64::from(x), f64::from(y)), wall_m);
            }
        }
        let image = RgbImage::from_pixel(160, 90, Rgb([grey; 3]));
        let view = View { camera, camera_from_world: DAffine3::IDENTITY };
        ColorView { image, view, t_us: 0, occlusion: Some(grid.close()) }
    }

    #[test]
    fn hidden_views_count_only_if_there_are_no_others() {
        let views = [view(10, Some(5.0)), view(200, None)];
        let color_of = |views: &[ColorView], z: f64| {
            let position = DVec3::new(0.0, 0.0, z);
            let background = vec![Candidate { position, rgb: None }];
            let mut cloud = SweepCloud { background, ..SweepCloud::default() };
            let views: Vec<&ColorView> = views.iter().collect();
            sweep(&mut cloud, 0, &views, Coloring::Agreed, |_, _| Some(DAffine3::IDENTITY));
            cloud.background[0].rgb
        };
        // Before the wall both count, behind it the other view alone.
        assert_eq!(color_of(&views, 4.0), Some([105; 3]));
        assert_eq!(color_of(&views, 20.0), Some([200; 3]));
        assert_eq!(color_of(&views[..1], 20.0), Some([10; 3]));
        assert_eq!(color_of(&views, -1.0), None);
    }
}
