use std::collections::BTreeMap;

use crate::{
    DepthErrors, DepthSummary, FilledError, MaskRule, Overlap, VEHICLE_CLASS, compare_filled, vehicle_mask,
};
use glam::{DVec2, DVec3};
use point_skeleton::conditions::{CameraConditions, ConditionOptions, MapKind, MapSet};
use point_skeleton::dataset::{Area, Class, LogReader, VectorMap};
use point_skeleton::geometry::View;
use point_skeleton::scene::{EgoOffset, SceneState, SelectionOptions, state_of_frame};
use point_skeleton::{MapOptions, Renderer};
use pskel_town::Town;
use serde::Serialize;

use super::differences::{DifferenceSums, MaskBand};
use super::error::FidelityError;
use super::truth::TrueMaps;

/// Maximum distance of near cars, meters from the ego to the center of the box.
const NEAR_M: f64 = 40.0;

/// Ego pose relative to the recorded one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Pose {
    /// Recorded pose.
    Logged,
    /// Offset to the side, meters.
    Beside(f64),
    /// Rotated to the left, degrees.
    Turned(f64),
}

/// Inputs for measuring a row of the table.
pub(super) struct Measurement<'a> {
    pub(super) town: &'a Town,
    pub(super) options: ConditionOptions,
    pub(super) map: Option<&'a VectorMap>,
}

/// Accumulated results of a row.
pub(super) struct Measured {
    pub(super) name: String,
    pose: Pose,
    to_the_left: usize,
    color: Vec<FilledError>,
    depth: DepthErrors,
    /// By selection of actor clouds, in the order of [`Masks::ALL`].
    masks: [MaskSums; 3],
    differences: DifferenceSums,
}

/// Selection of the actor clouds that produce the masks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Masks {
    /// As in rendered maps: actors with many points by their own, others by templates.
    Rendered,
    /// Templates, if available.
    Templates,
    /// Actors' own points, if they have any.
    Own,
}

#[derive(Clone, Copy, Default)]
struct MaskSums {
    /// By class, without class 0.
    classes: [Overlap; 4],
    /// Masks of vehicles by [`MaskRule`].
    vehicles: [Overlap; MaskRule::ALL.len()],
    near_cars: Overlap,
}

/// Row of the table.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Ego pose relative to the recorded one.
    pub pose: String,
    /// Number of compared images.
    pub images: usize,
    /// Number of frames with the ego offset to the left.
    pub to_the_left: usize,
    /// Means over images; the PSNR is over images with filled pixels.
    pub color: FilledError,
    /// Depth errors; `None` if no pixel has both depths.
    pub depth: Option<DepthSummary>,
    /// Masks of rendered maps: actors with many points by their own, others by templates.
    pub rendered: MaskRow,
    /// Masks of templates alone.
    pub templates: MaskRow,
    /// Masks of the actors' own points alone.
    pub own_points: MaskRow,
    /// Where masks of vehicles of rendered maps differ from the true ones.
    pub differences: Vec<MaskBand>,
}

/// IoU values; `None` if neither map nor ground truth shows the class.
#[derive(Clone, Debug, Serialize)]
pub struct MaskRow {
    /// By class.
    pub classes: BTreeMap<&'static str, Option<f64>>,
    /// Masks of vehicles as `evaluate` computes them, by [`MaskRule`].
    pub vehicles: BTreeMap<&'static str, Option<f64>>,
    /// Cars within 40 m.
    pub near_cars: Option<f64>,
}

/// Names of the classes, starting with class 1.
pub(super) const CLASS_NAMES: [&str; 4] = ["motor_vehicle", "pedestrian", "cycle", "object"];

impl Pose {
    /// Poses of all rows.
    pub(super) const ALL: [Self; 8] = [
        Self::Logged,
        Self::Beside(0.5),
        Self::Beside(1.0),
        Self::Beside(2.0),
        Self::Beside(3.5),
        Self::Turned(5.0),
        Self::Turned(10.0),
        Self::Turned(20.0),
    ];

    fn name(self) -> String {
        match self {
            Self::Logged => "as driven".to_owned(),
            Self::Beside(m) => format!("{m} m to the side"),
            Self::Turned(deg) => format!("turned by {deg} deg"),
        }
    }
}

impl Masks {
    const ALL: [Self; 3] = [Self::Rendered, Self::Templates, Self::Own];

    fn selection(self) -> SelectionOptions {
        let default = SelectionOptions::default();
        match self {
            Self::Rendered => default,
            Self::Templates => SelectionOptions { min_actor_points: usize::MAX, ..default },
            Self::Own => SelectionOptions { min_actor_points: 0, ..default },
        }
    }
}

impl Measured {
    pub(super) fn new(pose: Pose) -> Self {
        let (to_the_left, color, depth, masks, differences) = Default::default();
        Self { name: pose.name(), pose, to_the_left, color, depth, masks, differences }
    }

    pub(super) fn summary(self) -> Row {
        let [rendered, templates, own_points] = self.masks.map(|sums| sums.row());
        Row {
            pose: self.name,
            images: self.color.len(),
            to_the_left: self.to_the_left,
            color: mean(&self.color),
            depth: self.depth.summary(),
            rendered,
            templates,
            own_points,
            differences: self.differences.bands(),
        }
    }
}

impl MaskSums {
    /// Adds an image. `near` is indexed by instance number and marks nearby cars.
    fn add(&mut self, map: &CameraConditions, truth: &TrueMaps, near: &[bool]) {
        let (Some(class), Some(instance)) = (&map.class, &map.instance) else { return };
        for (number, overlap) in (1..).zip(&mut self.classes) {
            overlap.add_maps((class, |c| *c == number), (&truth.class, |c| *c == number));
        }
        let vehicles: Vec<bool> = truth.class.iter().map(|class| *class == VEHICLE_CLASS).collect();
        for (rule, overlap) in MaskRule::ALL.into_iter().zip(&mut self.vehicles) {
            overlap.add_masks(&vehicle_mask(class, truth.width, rule), &vehicles);
        }
        let is_near = |instance: &u32| near.get(*instance as usize).copied().unwrap_or(false);
        self.near_cars.add_maps((instance, is_near), (&truth.instance, is_near));
    }

    fn row(&self) -> MaskRow {
        let classes = CLASS_NAMES.into_iter().zip(self.classes.map(|overlap| overlap.iou())).collect();
        let rules = MaskRule::ALL.map(MaskRule::name).into_iter();
        let vehicles = rules.zip(self.vehicles.map(|overlap| overlap.iou())).collect();
        MaskRow { classes, vehicles, near_cars: self.near_cars.iou() }
    }
}

/// Returns the means over images; of the PSNR over those with filled pixels.
pub(super) fn mean(errors: &[FilledError]) -> FilledError {
    let mean = |of: fn(&FilledError) -> f64| {
        let values: Vec<f64> = errors.iter().map(of).filter(|v| !v.is_nan()).collect();
        values.iter().sum::<f64>() / values.len() as f64
    };
    FilledError {
        psnr_db: mean(|e| e.psnr_db),
        mean_abs: mean(|e| e.mean_abs),
        median_abs: mean(|e| e.median_abs),
        filled: mean(|e| e.filled),
    }
}

impl Measurement<'_> {
    /// Adds a frame's images to a row.
    pub(super) fn add(
        &self,
        renderer: &mut Renderer<'_>,
        frame: usize,
        row: &mut Measured,
    ) -> Result<(), FidelityError> {
        let log = self.town.recording();
        let offset = self.offset(frame, row);
        let state = state_of_frame(log, frame, offset)
            .ok_or_else(|| FidelityError::NoFrame { frame, log: log.shown_name().into_owned() })?;
        let views: Vec<View> = state.cameras.iter().map(|c| self.options.drawn_view(&c.view)).collect();
        let truth: Vec<TrueMaps> = self
            .town
            .truth(state.t_us, &views)?
            .iter()
            .zip(&state.cameras)
            .map(|(seen, camera)| TrueMaps::new(seen, self.options.written_size(&camera.view)))
            .collect();
        let near = near_cars(&state);
        for (masks, sums) in Masks::ALL.into_iter().zip(&mut row.masks) {
            let of_masks = MapSet::of(&[MapKind::Class, MapKind::Instance]);
            let maps = if masks == Masks::Rendered { self.options.maps } else { of_masks };
            let options = ConditionOptions { maps, ..self.options.clone() };
            let set = renderer.render_with(&state, &MapOptions::new(options, masks.selection()))?.set;
            for (map, truth) in set.cameras.iter().zip(&truth) {
                sums.add(map, truth, &near);
                if let Some(color) = &map.color {
                    row.color.push(compare_filled(color, &truth.color));
                }
                if let Some(depth_m) = &map.depth_m {
                    row.depth.add(depth_m, &truth.depth_m);
                }
                row.differences.add(map, truth, &self.options.splat);
            }
        }
        Ok(())
    }

    /// Returns the ego offset: to the right, or to the left if only that is on a lane.
    fn offset(&self, frame: usize, row: &mut Measured) -> EgoOffset {
        match row.pose {
            Pose::Logged => EgoOffset::default(),
            Pose::Turned(deg) => EgoOffset { yaw_deg: deg, ..EgoOffset::default() },
            Pose::Beside(m) => {
                let (right, left) = (
                    EgoOffset { left_m: -m, ..EgoOffset::default() },
                    EgoOffset { left_m: m, ..EgoOffset::default() },
                );
                if !self.is_on_lane(frame, right) && self.is_on_lane(frame, left) {
                    row.to_the_left += 1;
                    return left;
                }
                right
            }
        }
    }

    fn is_on_lane(&self, frame: usize, offset: EgoOffset) -> bool {
        let Some(frame) = self.town.recording().frames.get(frame) else { return false };
        let at = (frame.global_from_ego * offset.pose()).transform_point(DVec3::ZERO).truncate();
        let lanes = self.map.into_iter().flat_map(|map| map.lanes.iter().chain(&map.lane_connectors));
        lanes.map(|lane| &lane.outline).any(|area| is_within(area, at))
    }
}

/// Returns whether each actor is a nearby car, indexed by instance number; number 0 is the background.
fn near_cars(state: &SceneState) -> Vec<bool> {
    let ego = state.global_from_ego.translation;
    let near = state.actors.iter().map(|actor| {
        let away_m = actor.cuboid.pose.translation.distance(ego);
        actor.class == Class::MotorVehicle && actor.category == "vehicle.car" && away_m < NEAR_M
    });
    std::iter::once(false).chain(near).collect()
}

/// Returns whether a point lies inside an area's outline (even-odd rule).
fn is_within(area: &Area, at: DVec2) -> bool {
    let ring = &area.exterior;
    let crosses = |i: usize| {
        let (a, b) = (ring[i], ring[(i + 1) % ring.len()]);
        (a.y > at.y) != (b.y > at.y) && at.x < a.x + (at.y - a.y) / (b.y - a.y) * (b.x - a.x)
    };
    (0..ring.len()).filter(|i| crosses(*i)).count() % 2 == 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use point_skeleton::conditions::ImageSize;
    use pskel_town::view::GroundTruthView;

    fn truth() -> GroundTruthView {
        let (class, instance) = (vec![0, 1, 1, 2, 0, 3, 4, 1], vec![0, 1, 2, 3, 0, 4, 5, 1]);
        let image = image::RgbImage::from_fn(4, 2, |x, y| image::Rgb([10 + x as u8, 20 + y as u8, 30]));
        GroundTruthView { image, depth_m: (1..9).map(|i| i as f32).collect(), class, instance }
    }

    /// Ground truth against itself: every IoU is 1, color and depth errors are 0.
    #[test]
    fn ground_truth_scores_perfectly_against_itself() {
        let seen = truth();
        let maps = TrueMaps::new(&seen, ImageSize { height: 2, width: 4 });
        let map = CameraConditions {
            class: Some(seen.class.clone()),
            instance: Some(seen.instance.clone()),
            ..CameraConditions::default()
        };
        let mut sums = MaskSums::default();
        sums.add(&map, &maps, &[false, true, true]);
        let row = sums.row();
        assert!(row.classes.values().all(|iou| *iou == Some(1.0)) && row.near_cars == Some(1.0));
        let color: Vec<[u8; 3]> = seen.image.pixels().map(|p| p.0).collect();
        let mut measured = Measured::new(Pose::Logged);
        measured.color.push(compare_filled(&color, &maps.color));
        measured.depth.add(&seen.depth_m, &maps.depth_m);
        let summary = measured.summary();
        assert_eq!((summary.color.psnr_db, summary.color.filled), (f64::INFINITY, 1.0));
        assert_eq!(summary.depth.map(|d| (d.pixels, d.p95_m)), Some((8, 0.0)));
    }

    /// One pixel of the near car has the number of the far one, and one pedestrian is missing.
    #[test]
    fn computes_mask_ious() {
        let maps = TrueMaps::new(&truth(), ImageSize { height: 2, width: 4 });
        let map = CameraConditions {
            class: Some(vec![0, 1, 1, 0, 1, 3, 4, 1]),
            instance: Some(vec![0, 2, 2, 0, 1, 4, 5, 1]),
            ..CameraConditions::default()
        };
        let mut sums = MaskSums::default();
        sums.add(&map, &maps, &[false, true]);
        let row = sums.row();
        let ious: Vec<Option<f64>> = CLASS_NAMES.iter().map(|name| row.classes[name]).collect();
        assert_eq!(ious, [Some(0.75), Some(0.0), Some(1.0), Some(1.0)]);
        assert_eq!(row.near_cars, Some(1.0 / 3.0));
    }

    #[test]
    fn point_in_area_test() {
        let corners = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [2.0, 1.0], [0.0, 4.0]];
        let area = Area { exterior: corners.map(DVec2::from).to_vec(), holes: Vec::new() };
        let within = |x, y| is_within(&area, DVec2::new(x, y));
        assert!(within(1.0, 0.5) && within(0.5, 2.5) && within(3.5, 2.5));
        assert!(!within(2.0, 2.5) && !within(-1.0, 1.0) && !within(5.0, 1.0) && !within(2.0, -0.1));
    }
}
