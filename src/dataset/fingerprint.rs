//! Fingerprints of recordings, which tell apart recordings with one name.

use std::hash::Hasher;

use twox_hash::XxHash3_64;

use super::{ImageRecord, Recording};
use crate::geometry::{Camera, Pose};

impl Recording {
    /// Returns a fingerprint of the content: name, location, description, times, poses, cameras, tokens of images, numbers of sweeps and
    /// images, and boxes with their tracks, as 16 hexadecimal digits. Places of files and categories are not part of it.
    pub fn fingerprint(&self) -> String {
        let mut hash = Fingerprint(XxHash3_64::new());
        hash.text(&self.name);
        hash.text(&self.location);
        hash.text(&self.description);
        for rig in &self.rig {
            hash.camera(&rig.camera);
        }
        hash.number(self.frames.len() as u64);
        for frame in &self.frames {
            hash.number(frame.t_us.cast_unsigned());
            hash.pose(&frame.global_from_ego);
            for length in
                [frame.sweeps.len(), frame.images.len(), frame.between_images.len(), frame.boxes.len()]
            {
                hash.number(length as u64);
            }
            for sweep in &frame.sweeps {
                hash.number(sweep.t_us.cast_unsigned());
                hash.pose(&sweep.ego_from_lidar);
            }
            frame.images.iter().chain(&frame.between_images).for_each(|image| hash.image(image));
            for item in &frame.boxes {
                hash.text(self.tracks.get(item.track).map_or("", |track| track.id.as_str()));
                hash.pose(&item.cuboid.pose);
                hash.numbers(item.cuboid.size.to_array());
            }
        }
        format!("{:016x}", hash.0.finish())
    }
}

struct Fingerprint(XxHash3_64);

impl Fingerprint {
    fn number(&mut self, number: u64) {
        self.0.write(&number.to_le_bytes());
    }

    fn numbers(&mut self, numbers: impl IntoIterator<Item = f64>) {
        numbers.into_iter().for_each(|number| self.number(number.to_bits()));
    }

    fn text(&mut self, text: &str) {
        self.number(text.len() as u64);
        self.0.write(text.as_bytes());
    }

    fn pose(&mut self, pose: &Pose) {
        self.numbers(pose.rotation.to_array());
        self.numbers(pose.translation.to_array());
    }

    fn camera(&mut self, camera: &Camera) {
        self.text(&camera.name);
        self.number(camera.width.into());
        self.number(camera.height.into());
    }

    fn image(&mut self, image: &ImageRecord) {
        self.text(&image.token);
        self.number(image.t_us.cast_unsigned());
        self.pose(&image.global_from_ego);
        self.pose(&image.ego_from_camera);
        self.camera(&image.camera);
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::super::{Class, Frame, Track, TrackBox};
    use super::*;
    use crate::geometry::Cuboid;

    fn log() -> Recording {
        let track =
            |id: &str| Track { id: id.into(), category: "vehicle.car".into(), class: Class::MotorVehicle };
        let cuboid = Cuboid::new(Pose::IDENTITY, DVec3::ONE).unwrap();
        let frame = Frame {
            t_us: 1,
            global_from_ego: Pose::IDENTITY,
            sweeps: Vec::new(),
            images: Vec::new(),
            between_images: Vec::new(),
            boxes: vec![TrackBox { track: 0, cuboid }],
        };
        Recording {
            name: "a".into(),
            tracks: vec![track("1"), track("2")],
            frames: vec![frame],
            ..Recording::default()
        }
    }

    #[test]
    fn every_part_of_the_content_counts() {
        let changes: [fn(&mut Recording); 7] = [
            |log| log.description = "b".into(),
            |log| log.name = "b".into(),
            |log| log.location = "b".into(),
            |log| log.frames[0].t_us = 2,
            |log| log.frames[0].global_from_ego.translation.x += 1e-9,
            |log| log.frames[0].boxes[0].cuboid.size.z = 2.0,
            |log| log.frames[0].boxes[0].track = 1,
        ];
        let whole = log().fingerprint();
        assert_eq!((whole.len(), whole == log().fingerprint()), (16, true));
        for change in changes {
            let mut other = log();
            change(&mut other);
            assert_ne!(other.fingerprint(), whole);
        }
    }
}
