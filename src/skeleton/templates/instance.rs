//! Points of one actor, prepared for aggregation.

use glam::DVec3;

use super::TemplateOptions;
use super::kind::Family;
use super::thin::poisson_thin;
use crate::cloud::Point;
use crate::geometry::is_position;
use crate::skeleton::Asset;

/// Points of an actor, prepared for aggregation.
#[derive(Clone, Debug)]
pub(super) struct Instance {
    /// `LOG/TRACK`.
    pub(super) name: String,
    pub(super) family: Family,
    /// Length, width, height, meters.
    pub(super) size_m: DVec3,
    /// Number of points before thinning.
    pub(super) points_in: usize,
    /// Points in box coordinates, at least a template's spacing apart, so that long observation gives an
    /// actor no more weight.
    pub(super) points: Vec<Point>,
}

impl Instance {
    /// Prepares the points of an asset; the error is the reason why it is unusable.
    pub(super) fn new(
        asset: &Asset,
        points: &[Point],
        options: &TemplateOptions,
    ) -> Result<Self, &'static str> {
        let family = Family::of(&asset.category).ok_or("actors of a category without templates")?;
        let size_m = DVec3::from(asset.size);
        // Far points would overflow squared distances.
        let is_near = |p: &&Point| is_position(DVec3::from(p.position.map(f64::from)));
        let finite: Vec<&Point> = points.iter().filter(is_near).collect();
        if finite.is_empty() {
            return Err("actors without points");
        }
        let retained = poisson_thin(finite.iter().map(|p| p.position), options.spacing_m(size_m));
        Ok(Self {
            name: format!("{}/{}", asset.log, asset.track),
            family,
            size_m,
            points_in: points.len(),
            points: retained.into_iter().map(|i| *finite[i]).collect(),
        })
    }
}
