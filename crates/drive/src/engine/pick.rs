//! What a pixel shows.

use glam::{DVec2, DVec3};
use point_skeleton::MapOptions;
use point_skeleton::conditions::ConditionSet;
use point_skeleton::dataset::Recording;
use point_skeleton::raster::{MapKind, MapSet};
use point_skeleton::scene::SceneState;
use point_skeleton::skeleton::Skeleton;
use serde::Serialize;

use crate::message::Pixel;

/// Maps that tell what a pixel shows.
pub(super) const MAPS: [MapKind; 4] = [MapKind::Color, MapKind::Depth, MapKind::Class, MapKind::Instance];

/// Answer to a click.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "type", rename = "picked")]
pub(super) struct Picked {
    camera: String,
    x: u32,
    y: u32,
    /// Along the axis of the camera, meters.
    depth_m: Option<f64>,
    class: Option<u8>,
    /// Global, meters.
    point: Option<[f64; 3]>,
    rgb: [u8; 3],
    track: Option<String>,
    actor: Option<PickedActor>,
}

/// Actor at a pixel.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct PickedActor {
    track: String,
    category: String,
    /// Points of the asset in the skeleton.
    points: usize,
    /// Whether geometry maps show a template rather than the asset.
    template: bool,
    size_m: [f64; 3],
    /// Points of the skeleton; `None` if it has none of this actor.
    asset: Option<String>,
    /// From the ego to the center of the box, meters.
    distance_m: f64,
    /// First and last box of the log, seconds since its first frame.
    from_s: Option<f64>,
    to_s: Option<f64>,
    boxes: usize,
    /// Mean speed between the boxes before and after, meters per second.
    speed_mps: Option<f64>,
    /// Recorded centers, global meters.
    path: Vec<[f64; 2]>,
}

/// Recorded boxes of a track: times (absolute microseconds) and global centers (meters).
fn recorded(log: &Recording, track: &str) -> Vec<(i64, DVec2)> {
    let Some(index) = log.tracks.iter().position(|known| known.id == track) else { return Vec::new() };
    let boxes = log.frames.iter().flat_map(|frame| frame.boxes.iter().map(|found| (frame.t_us, found)));
    let own = boxes.filter(|(_, found)| found.track == index);
    own.map(|(t_us, found)| (t_us, found.cuboid.pose.translation.truncate())).collect()
}

/// Returns the mean speed between the recorded boxes before and after a time, meters per second.
fn speed_mps(boxes: &[(i64, DVec2)], t_us: i64) -> Option<f64> {
    let after = boxes.partition_point(|(time_us, _)| *time_us <= t_us).clamp(1, boxes.len().max(2) - 1);
    let [(before_us, before), (after_us, after)] = [*boxes.get(after - 1)?, *boxes.get(after)?];
    Some(before.distance(after) / ((after_us - before_us) as f64 / 1e6))
}

/// Returns the options for rendering [`MAPS`].
pub(super) fn maps() -> MapSet {
    MapSet::of(&MAPS)
}

/// Returns what a pixel shows; `set` has [`MAPS`] of `state`.
///
/// # Errors
/// Fails if there is no such camera or pixel.
pub(super) fn picked(
    pixel: &Pixel,
    state: &SceneState,
    set: &ConditionSet,
    options: &MapOptions,
    skeleton: &Skeleton,
    log: &Recording,
) -> Result<Picked, String> {
    let found = set.cameras.iter().zip(&state.cameras).find(|(maps, _)| *maps.name == *pixel.camera);
    let (maps, camera) =
        found.ok_or_else(|| format!("expected a camera of the log, found {:?}", pixel.camera))?;
    if pixel.x >= maps.width || pixel.y >= maps.height {
        let (width, height) = (maps.width, maps.height);
        return Err(format!("expected a pixel within {width}x{height}, found {}, {}", pixel.x, pixel.y));
    }
    let at = (pixel.y * maps.width + pixel.x) as usize;
    let depth_m =
        maps.depth_m.as_ref().map(|depth_m| f64::from(depth_m[at])).filter(|depth| depth.is_finite());
    let view = options.conditions.drawn_view(&camera.view);
    let view =
        point_skeleton::geometry::View { camera: view.camera.resized(maps.height, maps.width), ..view };
    let point = depth_m.map(|depth_m| {
        let center = DVec3::new(f64::from(pixel.x) + 0.5, f64::from(pixel.y) + 0.5, 1.0);
        let in_camera = view.camera.intrinsics.inverse() * center * depth_m;
        view.camera_from_world.inverse().transform_point3(in_camera).to_array()
    });
    let instance = maps.instance.as_ref().map_or(0, |instance| instance[at]) as usize;
    let actor = instance.checked_sub(1).and_then(|index| state.actors.get(index));
    let actor = actor.map(|actor| {
        let mut assets = skeleton.manifest.actors.iter();
        let asset = assets.find(|asset| Some(asset.track.as_str()) == actor.asset() && asset.log == log.name);
        let boxes = recorded(log, &actor.track);
        let seconds = |t_us: i64| (t_us - log.frames.first().map_or(0, |frame| frame.t_us)) as f64 / 1e6;
        let center = actor.cuboid.pose.translation;
        let points = asset.map_or(0, |asset| asset.points);
        PickedActor {
            track: actor.track.clone(),
            category: actor.category.clone(),
            points,
            template: points <= options.selection.min_actor_points,
            size_m: actor.cuboid.size.to_array(),
            asset: asset.map(|asset| format!("{} points of {} sweeps", asset.points, asset.sweeps)),
            distance_m: center.distance(state.global_from_ego.translation),
            from_s: boxes.first().map(|(t_us, _)| seconds(*t_us)),
            to_s: boxes.last().map(|(t_us, _)| seconds(*t_us)),
            boxes: boxes.len(),
            speed_mps: speed_mps(&boxes, state.t_us),
            path: boxes.iter().map(|(_, center)| center.to_array()).collect(),
        }
    });
    Ok(Picked {
        camera: pixel.camera.clone(),
        x: pixel.x,
        y: pixel.y,
        depth_m,
        class: maps.class.as_ref().map(|class| class[at]).filter(|class| *class > 0),
        point,
        rgb: maps.color.as_ref().map_or([0; 3], |color| color[at]),
        track: actor.as_ref().map(|actor| actor.track.clone()),
        actor,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn speeds_are_those_around_a_time() {
        let boxes = [(0, 0.0), (1_000_000, 4.0), (3_000_000, 5.0)].map(|(t_us, x)| (t_us, DVec2::X * x));
        assert_eq!([-1, 0, 999_999].map(|t_us| speed_mps(&boxes, t_us)), [Some(4.0); 3]);
        assert_eq!([1_000_000, 3_000_000, 9_000_000].map(|t_us| speed_mps(&boxes, t_us)), [Some(0.5); 3]);
        assert_eq!((speed_mps(&boxes[..1], 0), speed_mps(&[], 0)), (None, None));
    }
}
