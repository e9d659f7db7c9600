//! Fingerprints of recordings and HD maps, which tell apart those with one name.

use std::hash::Hasher;
use std::path::{Component, Path, PathBuf};

use glam::DVec2;
use twox_hash::XxHash3_64;

use crate::dataset::{ActorEdits, Area, Frame, ImageRecord, Lane, Recording, SweepRecord, VectorMap};
use crate::geometry::{Camera, LensModel, Pose};

/// Prefix of this version's fingerprints; other versions' cannot be compared with them.
const MARK: &str = "2-";

impl Recording {
    /// Returns a fingerprint of everything that determines maps, except for the content of files: names,
    /// times, poses, cameras with intrinsics and distortion, sweeps and images with their paths below the
    /// folder that all of them share, tracks with their categories, boxes, traffic lights, routes and
    /// edits. The text is `2-` and 16 hexadecimal digits.
    pub fn fingerprint(&self) -> String {
        let mut hash = Fingerprint::new();
        hash.all(&[&self.name, &self.location, &self.description], |hash, text| hash.text(text));
        hash.all(&self.cameras, |hash, name| hash.text(name));
        hash.all(&self.rig, |hash, rig| {
            hash.number(rig.channel as u64);
            hash.pose(&rig.ego_from_camera);
            hash.camera(&rig.camera);
        });
        hash.all(&self.tracks, |hash, track| {
            hash.text(&track.id);
            hash.text(&track.category);
            hash.number(track.class as u64);
        });
        let folder = common_folder(&self.frames);
        hash.all(&self.frames, |hash, frame| hash.frame(frame, &folder));
        hash.all(&self.lights, |hash, light| {
            hash.number(light.frame as u64);
            hash.text(&light.lane_connector);
            hash.text(&light.color);
        });
        hash.all(&self.routes, |hash, route| {
            hash.number(route.frame as u64);
            hash.all(&route.roadblocks, |hash, id| hash.text(id));
            hash.all(route.goal.as_slice(), Fingerprint::pose);
        });
        if !self.edits.is_empty() {
            hash.edits(&self.edits);
        }
        hash.finish()
    }
}

impl VectorMap {
    /// Returns a fingerprint of the content, in the form of [`Recording::fingerprint`].
    pub fn fingerprint(&self) -> String {
        let mut hash = Fingerprint::new();
        hash.text(&self.location);
        for lanes in [&self.lanes, &self.lane_connectors] {
            hash.all(lanes, Fingerprint::lane);
        }
        for areas in [&self.drivable_area, &self.crossings, &self.stop_lines, &self.walkways] {
            hash.all(areas, Fingerprint::area);
        }
        hash.all(&self.dividers, |hash, line| hash.line(line));
        hash.finish()
    }
}

/// Returns whether a text is a fingerprint that can be compared with this version's.
pub(crate) fn is_fingerprint(text: &str) -> bool {
    text.starts_with(MARK)
}

/// Returns the folder that all sweeps and images share. It is not part of a fingerprint, since a data set may
/// be moved.
fn common_folder(frames: &[Frame]) -> PathBuf {
    let files = frames.iter().flat_map(|frame| {
        let images = frame.images.iter().chain(&frame.between_images).map(|image| &image.path);
        frame.sweeps.iter().map(|sweep| &sweep.path).chain(images)
    });
    let mut folders = files.filter_map(|path| path.parent());
    let mut common = folders.next().unwrap_or(Path::new("")).to_owned();
    for folder in folders {
        while !folder.starts_with(&common) && common.pop() {}
    }
    common
}

struct Fingerprint(XxHash3_64);

impl Fingerprint {
    fn new() -> Self {
        Self(XxHash3_64::new())
    }

    fn finish(&self) -> String {
        format!("{MARK}{:016x}", self.0.finish())
    }

    fn number(&mut self, number: u64) {
        self.0.write(&number.to_le_bytes());
    }

    fn numbers(&mut self, numbers: impl IntoIterator<Item = f64>) {
        numbers.into_iter().for_each(|number| self.number(number.to_bits()));
    }

    fn bytes(&mut self, bytes: &[u8]) {
        self.number(bytes.len() as u64);
        self.0.write(bytes);
    }

    fn text(&mut self, text: &str) {
        self.bytes(text.as_bytes());
    }

    fn edits(&mut self, edits: &ActorEdits) {
        for (track, t_us) in &edits.hold {
            self.text(track);
            self.number(*t_us as u64);
        }
        for (track, appearance) in &edits.replace {
            self.text(track);
            self.text(&appearance.to_string());
        }
        for (track, size_m) in &edits.size_m {
            self.text(track);
            self.numbers(*size_m);
        }
        // The frames have the boxes of the recorded ego alone; a simulation has others.
        edits.changes.iter().for_each(|change| self.text(&format!("{change:?}")));
    }

    /// Adds a list; its length keeps it apart from the next one.
    fn all<T>(&mut self, items: &[T], mut add: impl FnMut(&mut Self, &T)) {
        self.number(items.len() as u64);
        items.iter().for_each(|item| add(self, item));
    }

    fn pose(&mut self, pose: &Pose) {
        self.numbers(pose.rotation.to_array());
        self.numbers(pose.translation.to_array());
    }

    fn camera(&mut self, camera: &Camera) {
        self.text(&camera.name);
        self.number(camera.width.into());
        self.number(camera.height.into());
        self.numbers(camera.rows().into_iter().flatten());
        self.lens(camera.lens);
    }

    /// Adds a lens; the first number keeps models apart.
    fn lens(&mut self, lens: Option<LensModel>) {
        match lens {
            None => self.number(0),
            Some(LensModel::BrownConrady(distortion)) => {
                self.number(1);
                self.numbers(distortion.coefficients());
            }
            Some(LensModel::Mei(mei)) => {
                self.number(2);
                self.numbers([mei.xi()].into_iter().chain(mei.radial()));
            }
            Some(LensModel::FTheta(f_theta)) => {
                self.number(3);
                self.numbers(f_theta.polynomial());
            }
        }
    }

    fn frame(&mut self, frame: &Frame, folder: &Path) {
        self.number(frame.t_us.cast_unsigned());
        self.pose(&frame.global_from_ego);
        self.all(&frame.sweeps, |hash, sweep| hash.sweep(sweep, folder));
        for images in [&frame.images, &frame.between_images] {
            self.all(images, |hash, image| hash.image(image, folder));
        }
        self.all(&frame.boxes, |hash, item| {
            hash.number(item.track as u64);
            hash.pose(&item.cuboid.pose);
            hash.numbers(item.cuboid.size.to_array());
        });
    }

    fn sweep(&mut self, sweep: &SweepRecord, folder: &Path) {
        self.path(&sweep.path, folder);
        self.row(sweep.row);
        self.number(sweep.t_us.cast_unsigned());
        self.pose(&sweep.global_from_ego);
        self.pose(&sweep.ego_from_lidar);
        self.number(sweep.is_key.into());
    }

    fn image(&mut self, image: &ImageRecord, folder: &Path) {
        self.text(&image.token);
        self.number(image.channel as u64);
        self.path(&image.path, folder);
        self.row(image.row);
        self.number(image.t_us.cast_unsigned());
        self.pose(&image.global_from_ego);
        self.pose(&image.ego_from_camera);
        self.camera(&image.camera);
    }

    /// Adds the part of a path below a folder.
    fn path(&mut self, path: &Path, folder: &Path) {
        let parts: Vec<Component<'_>> = path.strip_prefix(folder).unwrap_or(path).components().collect();
        self.all(&parts, |hash, part| hash.bytes(part.as_os_str().as_encoded_bytes()));
    }

    /// Adds the row of a table.
    fn row(&mut self, row: Option<u32>) {
        // Nothing without one: fingerprints of logs without tables remain as they are.
        row.into_iter().for_each(|row| self.number(row.into()));
    }

    fn lane(&mut self, lane: &Lane) {
        self.text(&lane.id);
        self.area(&lane.outline);
        self.line(&lane.centerline);
        self.all(&lane.successors, |hash, id| hash.text(id));
    }

    fn area(&mut self, area: &Area) {
        self.line(&area.exterior);
        self.all(&area.holes, |hash, hole| hash.line(hole));
    }

    fn line(&mut self, points: &[DVec2]) {
        self.all(points, |hash, point| hash.numbers(point.to_array()));
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::DVec3;

    use super::*;
    use crate::dataset::{Class, NavigationRoute, RigCamera, Track, TrackBox, TrafficLight};
    use crate::geometry::{Cuboid, LensModel};

    fn log_at(root: &str) -> Recording {
        let track =
            |id: &str| Track { id: id.into(), category: "vehicle.car".into(), class: Class::MotorVehicle };
        let cuboid = Cuboid::new(Pose::IDENTITY, DVec3::ONE).unwrap();
        let rows = [[9.0, 0.0, 4.0], [0.0, 9.0, 4.0], [0.0, 0.0, 1.0]];
        let image = |name: &str| ImageRecord {
            token: name.into(),
            channel: 0,
            path: format!("{root}/images/{name}").into(),
            row: None,
            t_us: 1,
            global_from_ego: Pose::IDENTITY,
            ego_from_camera: Pose::IDENTITY,
            camera: Camera::new("front", 8, 8, rows).unwrap().into(),
        };
        let sweep = SweepRecord {
            path: format!("{root}/sweeps/1").into(),
            row: None,
            t_us: 1,
            global_from_ego: Pose::IDENTITY,
            ego_from_lidar: Pose::IDENTITY,
            is_key: true,
        };
        let frame = Frame {
            t_us: 1,
            global_from_ego: Pose::IDENTITY,
            sweeps: vec![sweep],
            images: vec![image("1")],
            between_images: vec![image("2")],
            boxes: vec![TrackBox { track: 0, cuboid }],
        };
        Recording {
            name: "a".into(),
            rig: vec![RigCamera::from(&image("1"))],
            tracks: vec![track("1"), track("2")],
            frames: vec![frame],
            lights: vec![TrafficLight { frame: 0, lane_connector: "7".into(), color: "red".into() }],
            routes: vec![NavigationRoute { frame: 0, roadblocks: vec!["8".into()], goal: None }],
            ..Recording::default()
        }
    }

    fn log() -> Recording {
        log_at("/data")
    }

    #[test]
    fn every_field_changes_the_fingerprint() {
        let lens = LensModel::from_opencv([0.1, 0.0, 0.0, 0.0, 0.0]);
        let changes: [&dyn Fn(&mut Recording); 27] = [
            &|log| log.description = "b".into(),
            &|log| log.name = "b".into(),
            &|log| log.location = "b".into(),
            &|log| log.rig[0].camera.intrinsics.x_axis.x += 1e-9,
            &|log| log.rig[0].ego_from_camera.translation.x += 1e-9,
            &|log| log.frames[0].t_us = 2,
            &|log| log.frames[0].global_from_ego.translation.x += 1e-9,
            &|log| log.frames[0].boxes[0].cuboid.size.z = 2.0,
            &|log| log.frames[0].boxes[0].track = 1,
            &|log| log.tracks[0].id = "0".into(),
            &|log| log.tracks[0].category = "vehicle.truck".into(),
            &|log| log.tracks[0].class = Class::Pedestrian,
            &|log| log.frames[0].sweeps[0].path = "/data/sweeps/2".into(),
            &|log| log.frames[0].sweeps[0].global_from_ego.translation.x += 1e-9,
            &|log| log.frames[0].sweeps[0].is_key = false,
            &|log| log.frames[0].images[0].path = "/data/images/3".into(),
            &|log| log.frames[0].sweeps[0].row = Some(1),
            &|log| log.frames[0].images[0].row = Some(1),
            &|log| Arc::make_mut(&mut log.frames[0].images[0].camera).intrinsics.z_axis.y += 1e-9,
            &|log| Arc::make_mut(&mut log.frames[0].images[0].camera).lens = lens,
            &|log| log.frames[0].between_images[0].t_us = 2,
            &|log| {
                let image = log.frames[0].between_images.pop();
                log.frames[0].images.extend(image);
            },
            &|log| log.lights[0].color = "green".into(),
            &|log| log.lights.clear(),
            &|log| log.routes[0].roadblocks[0] = "9".into(),
            &|log| log.routes[0].goal = Some(Pose::IDENTITY),
            &|log| log.frames.clear(),
        ];
        let whole = log().fingerprint();
        assert_eq!((whole.len(), whole == log().fingerprint()), (MARK.len() + 16, true));
        assert!(is_fingerprint(&whole) && !is_fingerprint(&whole[MARK.len()..]));
        for (number, change) in changes.iter().enumerate() {
            let mut other = log();
            change(&mut other);
            assert_ne!(other.fingerprint(), whole, "change {number}");
        }
    }

    #[test]
    fn moving_a_data_set_keeps_its_fingerprint() {
        for root in ["elsewhere/of/it", "/data/", "."] {
            assert_eq!(log_at(root).fingerprint(), log().fingerprint(), "{root}");
        }
    }

    #[test]
    fn every_map_layer_changes_the_fingerprint() {
        let ring = || vec![DVec2::ZERO, DVec2::X, DVec2::Y];
        let area = || Area { exterior: ring(), holes: vec![ring()] };
        let lane = |id: &str| Lane {
            id: id.into(),
            outline: area(),
            centerline: vec![DVec2::ZERO, DVec2::X],
            successors: vec!["2".into()],
        };
        let map = || VectorMap {
            location: "a".into(),
            lanes: vec![lane("1")],
            lane_connectors: vec![lane("2")],
            crossings: vec![area()],
            dividers: vec![ring()],
            ..VectorMap::default()
        };
        let changes: [fn(&mut VectorMap); 9] = [
            |map| map.location = "b".into(),
            |map| map.lanes[0].id = "3".into(),
            |map| map.lanes[0].outline.holes[0][1].x += 1e-9,
            |map| map.lanes[0].centerline[0].y = 1e-9,
            |map| map.lanes[0].successors.clear(),
            |map| map.lane_connectors.clear(),
            |map| std::mem::swap(&mut map.crossings, &mut map.walkways),
            |map| map.dividers[0].truncate(2),
            |map| std::mem::swap(&mut map.crossings, &mut map.stop_lines),
        ];
        let whole = map().fingerprint();
        assert!(is_fingerprint(&whole) && whole == map().fingerprint());
        for (number, change) in changes.iter().enumerate() {
            let mut other = map();
            change(&mut other);
            assert_ne!(other.fingerprint(), whole, "change {number}");
        }
    }
}
