//! Masks of vehicles compared with the true ones by depth.

use point_skeleton::conditions::CameraConditions;
use point_skeleton::raster::SplatSchedule;
use serde::Serialize;

use super::truth::TrueMaps;
use crate::{MaskDifferences, MaskPair, MaskRule, VEHICLE_CLASS, vehicle_mask};

/// Ends of the ranges of depth, meters; the last range has none.
const ENDS_M: [u16; 3] = [20, 40, 60];

/// Differences in a range of camera depth: the true vehicle's, or the map's where there is none.
#[derive(Clone, Debug, Serialize)]
pub struct MaskBand {
    /// Rule of the mask.
    pub rule: MaskRule,
    /// Minimum depth, meters; `None` for all depths.
    pub from_m: Option<u16>,
    /// Maximum depth (exclusive), meters; `None` for all depths from `from_m` on.
    pub to_m: Option<u16>,
    /// Pixels by cause.
    #[serde(flatten)]
    pub differences: MaskDifferences,
}

/// Sums over images by [`MaskRule`] and range of depth.
#[derive(Default)]
pub(super) struct DifferenceSums([[MaskDifferences; ENDS_M.len() + 1]; MaskRule::ALL.len()]);

impl MaskBand {
    /// Formats the range of depth.
    pub(super) fn depth(&self) -> String {
        match (self.from_m, self.to_m) {
            (None, None) => "all".to_owned(),
            (from, Some(to)) => format!("{}-{to} m", from.unwrap_or(0)),
            (Some(from), None) => format!("from {from} m"),
        }
    }
}

impl DifferenceSums {
    /// Adds an image. `splat` is the schedule of the rendered maps.
    pub(super) fn add(&mut self, map: &CameraConditions, truth: &TrueMaps, splat: &SplatSchedule) {
        let (Some(class), Some(depth_m)) = (&map.class, &map.depth_m) else { return };
        let vehicles: Vec<bool> = truth.class.iter().map(|class| *class == VEHICLE_CLASS).collect();
        // A splat covers the pixel of its point and `radius` more; the mask rule and the edge add up to one.
        let reach_px = |depth_m: f32| {
            let covered = f64::from(splat.radius_at(depth_m).unwrap_or(0)) + 1.0;
            (covered * truth.scale).ceil() as usize
        };
        for (rule, bands) in MaskRule::ALL.into_iter().zip(&mut self.0) {
            let mask = vehicle_mask(class, truth.width, rule);
            let pair = MaskPair {
                width: truth.width,
                mask: &mask,
                class,
                depth_m,
                truth: &vehicles,
                true_depth_m: &truth.depth_m,
            };
            pair.add_to(bands, band_of, reach_px);
        }
    }

    /// Returns all depths and each range, by rule.
    pub(super) fn bands(&self) -> Vec<MaskBand> {
        let of_rule = |(rule, bands): (MaskRule, &[MaskDifferences; ENDS_M.len() + 1])| {
            let mut all = MaskDifferences::default();
            bands.iter().for_each(|band| all.join(band));
            let ranges = bands.iter().enumerate().map(move |(i, differences)| MaskBand {
                rule,
                from_m: Some(i.checked_sub(1).map_or(0, |before| ENDS_M[before])),
                to_m: ENDS_M.get(i).copied(),
                differences: *differences,
            });
            std::iter::once(MaskBand { rule, from_m: None, to_m: None, differences: all })
                .chain(ranges)
                .collect::<Vec<_>>()
        };
        MaskRule::ALL.into_iter().zip(&self.0).flat_map(of_rule).collect()
    }
}

fn band_of(depth_m: f32) -> usize {
    ENDS_M.iter().filter(|end_m| depth_m >= f32::from(**end_m)).count()
}
