use std::collections::BTreeSet;
use std::str::FromStr;

use glam::{DQuat, DVec3};

use super::{ActorState, SceneCamera, SceneState};
use crate::dataset::{Appearance, EgoTrack, Frame, ImageRecord, Recording, RigCamera, TrackBox};
use crate::geometry::{ParseOptionError, Pose, View};

/// Returns the name of a frame's state.
pub fn name_of_frame(index: usize) -> String {
    format!("{index:06}")
}

/// Returns the name of the state at a time, microseconds.
pub fn name_of_time(t_us: i64) -> String {
    t_us.to_string()
}

/// Displacement of the ego in its own frame. Text form: `forward_m=1,left_m=2,yaw_deg=5`; any part may be
/// omitted.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct EgoOffset {
    /// Forward, meters.
    pub forward_m: f64,
    /// To the left, meters.
    pub left_m: f64,
    /// Up, meters.
    #[serde(skip_serializing_if = "is_zero")]
    pub up_m: f64,
    /// Rotation to the left, degrees.
    pub yaw_deg: f64,
    /// Rotation of the front up, about the axis to the left after the yaw, degrees.
    #[serde(skip_serializing_if = "is_zero")]
    pub pitch_deg: f64,
}

#[allow(clippy::trivially_copy_pass_by_ref)] // the signature that serde calls
fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

impl EgoOffset {
    /// Returns `ego_from_moved_ego`.
    pub fn pose(&self) -> Pose {
        let yawed =
            Pose::from_yaw(self.yaw_deg.to_radians(), DVec3::new(self.forward_m, self.left_m, self.up_m));
        if self.pitch_deg == 0.0 {
            return yawed;
        }
        let rotation = DQuat::from_rotation_y(-self.pitch_deg.to_radians());
        yawed * Pose { rotation, translation: DVec3::ZERO }
    }
}

impl std::fmt::Display for EgoOffset {
    /// Writes the text form, without the parts that are 0; empty if all are.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let parts = [
            ("forward_m", self.forward_m),
            ("left_m", self.left_m),
            ("up_m", self.up_m),
            ("yaw_deg", self.yaw_deg),
            ("pitch_deg", self.pitch_deg),
        ];
        let parts = parts.iter().filter(|(_, value)| *value != 0.0);
        let parts: Vec<String> = parts.map(|(name, value)| format!("{name}={value}")).collect();
        f.write_str(&parts.join(","))
    }
}

impl FromStr for EgoOffset {
    type Err = ParseOptionError;

    fn from_str(text: &str) -> Result<Self, ParseOptionError> {
        let wrong = || ParseOptionError {
            expected: "a moved ego, like forward_m=1,left_m=-2,yaw_deg=5 (any of them, up_m and pitch_deg, \
                each once, finite)",
            found: text.to_owned(),
        };
        let (mut offset, mut given) = (Self::default(), Vec::new());
        for part in text.split(',') {
            let (name, value) = part.split_once('=').ok_or_else(wrong)?;
            let name = name.trim();
            let field = match name {
                "forward_m" => &mut offset.forward_m,
                "left_m" => &mut offset.left_m,
                "up_m" => &mut offset.up_m,
                "yaw_deg" => &mut offset.yaw_deg,
                "pitch_deg" => &mut offset.pitch_deg,
                _ => return Err(wrong()),
            };
            *field = value.trim().parse().ok().filter(|value: &f64| value.is_finite()).ok_or_else(wrong)?;
            if given.contains(&name) {
                return Err(wrong());
            }
            given.push(name);
        }
        Ok(offset)
    }
}

impl SceneState {
    /// Returns the state without the actors of some tracks. The numbers in instance maps are those of the
    /// remaining actors.
    #[must_use]
    pub fn hiding(self, tracks: &BTreeSet<String>) -> Self {
        let actors = self.actors.into_iter().filter(|actor| !tracks.contains(&actor.track)).collect();
        Self { actors, ..self }
    }

    /// Returns the state with the ego and its cameras displaced; cameras fixed in the global frame stay.
    #[must_use]
    pub fn moved(&self, offset: EgoOffset) -> Self {
        let moved = |camera: &SceneCamera| match camera.ego_from_camera {
            Some(ego_from_camera) => {
                let global_from_ego = camera.global_from_ego * offset.pose();
                let camera_from_world = (global_from_ego * ego_from_camera).inverse().affine();
                let view = View { camera: camera.view.camera.clone(), camera_from_world };
                SceneCamera { view, global_from_ego, ..*camera }
            }
            None => camera.clone(),
        };
        Self {
            global_from_ego: self.global_from_ego * offset.pose(),
            cameras: self.cameras.iter().map(moved).collect(),
            ..self.clone()
        }
    }
}

/// Returns the state at a frame of a log; `None` if there is no such frame. Each camera uses the ego pose of
/// its own image, or the frame's if it has no image. Actors use their boxes at the frame's time. The HD map
/// is not set.
pub fn state_of_frame(log: &Recording, index: usize, offset: EgoOffset) -> Option<SceneState> {
    let frame = log.frames.get(index)?;
    let own_pose =
        |channel: usize| frame.images.iter().find(|i| i.channel == channel).map(|i| i.global_from_ego);
    let camera = |rig: RigCamera| {
        let global_from_ego = own_pose(rig.channel).unwrap_or(frame.global_from_ego);
        scene_camera(&rig, global_from_ego * offset.pose())
    };
    Some(SceneState {
        name: name_of_frame(index),
        t_us: frame.t_us,
        global_from_ego: frame.global_from_ego * offset.pose(),
        cameras: rig_at(log, frame).into_iter().map(camera).collect(),
        actors: actors(log, frame.t_us, &frame.boxes),
        map: None,
    })
}

/// Returns the state of some images of a log, at most one per camera: each camera uses the ego pose of its
/// image, and there are no other cameras. Ego and actors are interpolated to `t_us`, microseconds. `None`
/// outside the log. `ego` holds the log's ego poses. The HD map is not set.
pub fn state_of_images(
    log: &Recording,
    ego: &EgoTrack,
    t_us: i64,
    images: &[&ImageRecord],
) -> Option<SceneState> {
    let cameras = images.iter().map(|image| scene_camera(&RigCamera::from(*image), image.global_from_ego));
    let cameras = cameras.collect();
    Some(SceneState { cameras, ..state_of(log, t_us, ego.at(t_us)?, &log.boxes_at(t_us)) })
}

/// Returns the state at any time within the log; `None` outside it. All cameras share the ego pose at that
/// instant; ego and actors are interpolated. `ego` holds the log's ego poses. The HD map is not set.
pub fn state_at(log: &Recording, ego: &EgoTrack, t_us: i64, offset: EgoOffset) -> Option<SceneState> {
    Some(state_of(log, t_us, ego.at(t_us)? * offset.pose(), &log.boxes_at(t_us)))
}

/// Returns the state some seconds before a time or, if that is outside the log, after it, as [`state_at`];
/// `None` if both are outside. The times between are those that a LiDAR sweep takes.
pub fn state_beside(
    log: &Recording,
    ego: &EgoTrack,
    t_us: i64,
    seconds: f64,
    offset: EgoOffset,
) -> Option<SceneState> {
    let step_us = (seconds * 1e6).round() as i64;
    let at = |t_us: i64| state_at(log, ego, t_us, offset);
    at(t_us.checked_sub(step_us)?).or_else(|| at(t_us.checked_add(step_us)?))
}

/// Returns the state for any ego pose and boxes of a log's tracks at any time. All cameras share the ego pose
/// and have the calibration of the nearest frame. The state is named after the time; the HD map is not set.
pub fn state_of(log: &Recording, t_us: i64, global_from_ego: Pose, boxes: &[TrackBox]) -> SceneState {
    let nearest = log.frames.iter().min_by_key(|f| f.t_us.abs_diff(t_us));
    let rig = nearest.map_or_else(|| log.rig.clone(), |frame| rig_at(log, frame));
    SceneState {
        name: name_of_time(t_us),
        t_us,
        global_from_ego,
        cameras: rig.iter().map(|rig| scene_camera(rig, global_from_ego)).collect(),
        actors: actors(log, t_us, boxes),
        map: None,
    }
}

/// Replaces a state's cameras with cameras fixed in the global frame.
pub fn with_cameras(mut state: SceneState, views: &[View]) -> SceneState {
    let camera = |view: &View| SceneCamera {
        view: view.clone(),
        ego_from_camera: None,
        global_from_ego: state.global_from_ego,
    };
    state.cameras = views.iter().map(camera).collect();
    state
}

/// Returns all cameras of a log with the calibration of a frame's images, or the rig's where a camera has no
/// image.
fn rig_at(log: &Recording, frame: &Frame) -> Vec<RigCamera> {
    let camera = |channel: usize| {
        let of_image = frame.images.iter().find(|i| i.channel == channel).map(RigCamera::from);
        of_image.or_else(|| log.rig.iter().find(|c| c.channel == channel).cloned())
    };
    (0..log.cameras.len()).filter_map(camera).collect()
}

fn scene_camera(rig: &RigCamera, global_from_ego: Pose) -> SceneCamera {
    let camera_from_world = (global_from_ego * rig.ego_from_camera).inverse().affine();
    SceneCamera {
        view: View { camera: rig.camera.clone(), camera_from_world },
        ego_from_camera: Some(rig.ego_from_camera),
        global_from_ego,
    }
}

/// Returns the actors with their looks at a time, absolute microseconds.
pub(super) fn actors(log: &Recording, t_us: i64, boxes: &[TrackBox]) -> Vec<ActorState> {
    let actor = |item: &TrackBox| {
        let track = &log.tracks[item.track];
        let look = log.script.look_at(item.track, t_us);
        let like = look.and_then(|look| match look {
            Appearance::Track(other) => log.tracks.iter().find(|known| known.id == *other),
            _ => None,
        });
        ActorState {
            track: track.id.clone(),
            category: like.unwrap_or(track).category.clone(),
            class: track.class,
            cuboid: item.cuboid,
            appearance: look.or_else(|| log.edits.replace.get(&track.id)).cloned(),
        }
    };
    boxes.iter().map(actor).collect()
}

/// Returns the frame rate from the median time between frames; `None` for a single frame.
pub fn frame_rate_hz(frames: &[Frame]) -> Option<f64> {
    let mut steps: Vec<i64> = frames.windows(2).map(|w| w[1].t_us - w[0].t_us).collect();
    steps.sort_unstable();
    steps.get(steps.len() / 2).filter(|dt| **dt > 0).map(|dt| 1e6 / *dt as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn offsets_are_named_with_their_units() {
        let offset: EgoOffset = "left_m=-2.5, yaw_deg=90".parse().unwrap();
        assert_eq!(offset, EgoOffset { left_m: -2.5, yaw_deg: 90.0, ..EgoOffset::default() });
        assert!((offset.pose().yaw_rad() - std::f64::consts::FRAC_PI_2).abs() < 1e-15);
        assert_eq!(offset.to_string(), "left_m=-2.5,yaw_deg=90");
        assert_eq!(
            serde_json::to_string(&offset).unwrap(),
            r#"{"forward_m":0.0,"left_m":-2.5,"yaw_deg":90.0}"#
        );
        let raised: EgoOffset = "up_m=2,yaw_deg=90,pitch_deg=30".parse().unwrap();
        let ahead = raised.pose().transform_point(DVec3::X * 10.0);
        assert!((ahead - DVec3::new(0.0, 10.0 * 0.75_f64.sqrt(), 7.0)).length() < 1e-12, "{ahead}");
        for text in ["", "1,2,3", "left=1", "left_m=1,left_m=1", "yaw_deg=nan", "forward_m", "forward_m=1,"] {
            let message = text.parse::<EgoOffset>().unwrap_err().to_string();
            assert!(message.contains("forward_m=1,left_m=-2,yaw_deg=5"), "{message}");
        }
    }
}
