use glam::DAffine3;
use rayon::prelude::*;

use crate::skeleton::colorize::agreed_color;
use crate::skeleton::sweep::SweepCloud;
use crate::skeleton::{Candidate, ColorView, Coloring, Projector};

/// Number of points per job.
const JOB: usize = 16_384;

/// Colors the points of a sweep taken at `t_us`. `place` returns the pose of a part of it at a time.
pub(super) fn sweep(
    cloud: &mut SweepCloud,
    t_us: i64,
    views: &[&ColorView],
    how: Coloring,
    place: impl Fn(Option<usize>, i64) -> Option<DAffine3>,
) {
    for (track, points) in cloud.parts_mut() {
        if how == Coloring::EveryCamera {
            if let Some(place) = place(track, t_us) {
                copy_for_every_view(views, &place, points);
            }
            continue;
        }
        let placed: Vec<(&ColorView, Projector, f64)> = (views.iter())
            .filter_map(|view| {
                let project = Projector::new(&view.view, &place(track, view.t_us)?);
                Some((*view, project, (view.t_us - t_us) as f64 * 1e-6))
            })
            .collect();
        points.par_chunks_mut(JOB).for_each(|job| color(job, &placed));
    }
}

/// Colors points from views, each with its projection and its time relative to the points' sweep, seconds.
fn color(points: &mut [Candidate], views: &[(&ColorView, Projector, f64)]) {
    let mut looks = Vec::with_capacity(views.len());
    for point in points {
        looks.clear();
        looks.extend(
            views.iter().filter_map(|(view, project, dt_s)| view.look(project, point.position, *dt_s)),
        );
        point.rgb = agreed_color(&looks);
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
