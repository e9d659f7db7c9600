//! Camera images and ground-truth maps.

use std::collections::BTreeMap;

use glam::DVec3;
use image::RgbImage;
use point_skeleton::dataset::{ImageRecord, PosedActor};
use point_skeleton::geometry::{Camera, Pose, View};
use point_skeleton::memory::{Need, Reservation, reserve};

use super::error::TownError;
use super::record::seconds;
use super::renderer::{Figure, TownRenderer};
use super::town::Town;
use crate::plan::Actor;
use crate::view::{GroundTruthView, MeshRenderError};

impl Town {
    /// Renders views at a time: images and ground-truth maps. The views' world is the global frame. Instance
    /// numbers are index + 1 of the log's boxes at that time, as in
    /// [`Recording::boxes_at`](point_skeleton::dataset::Recording::boxes_at). Actors without a box (beyond
    /// the LiDAR's range) are visible, with class and instance 0.
    ///
    /// # Errors
    /// Returns an error if the device fails.
    pub fn truth(&self, t_us: i64, views: &[View]) -> Result<Vec<GroundTruthView>, TownError> {
        let tracks: Vec<usize> = self.log.boxes_at(t_us).iter().map(|item| item.track).collect();
        self.render(t_us, &self.figures(t_us, &tracks), views)
    }

    /// Renders the cameras of a frame, each at its own time and pose, in their order. Instance numbers refer
    /// to the frame's boxes. Empty if there is no such frame.
    ///
    /// # Errors
    /// Returns an error if the device fails.
    pub fn truth_of_frame(&self, index: usize) -> Result<Vec<GroundTruthView>, TownError> {
        let Some(frame) = self.log.frames.get(index) else { return Ok(Vec::new()) };
        let tracks: Vec<usize> = frame.boxes.iter().map(|item| item.track).collect();
        let mut seen = Vec::new();
        for record in &frame.images {
            seen.extend(self.render(record.t_us, &self.figures(record.t_us, &tracks), &[view_of(record)])?);
        }
        Ok(seen)
    }

    /// Renders views of a state that differs from the log: only the given actors are visible. Their instance
    /// is their index + 1. The time selects the pose of their limbs.
    ///
    /// # Errors
    /// Returns an error if the town does not have a track or if the device fails.
    pub fn truth_of(
        &self,
        t_us: i64,
        actors: &[PosedActor<'_>],
        views: &[View],
    ) -> Result<Vec<GroundTruthView>, TownError> {
        let town_from_global = self.global_from_town.inverse();
        let figure = |(index, actor): (usize, &PosedActor<'_>)| {
            let known = self.log.tracks.binary_search_by(|track| track.id.as_str().cmp(actor.track));
            let (town, track) = (self.log.name.clone(), actor.track.to_owned());
            let known = known.map_err(|_| TownError::Track { town, track })?;
            let ground = Pose { translation: DVec3::NEG_Z * (actor.cuboid.size.z / 2.0), ..Pose::IDENTITY };
            let town_from_actor = town_from_global * actor.cuboid.pose * ground;
            Ok(Figure { actor: self.actors[known], town_from_actor, number: index as u32 + 1 })
        };
        let figures: Vec<Figure> = actors.iter().enumerate().map(figure).collect::<Result<_, TownError>>()?;
        self.render(t_us, &figures, views)
    }

    /// Renders only the image of a record.
    pub(super) fn image(&self, record: &ImageRecord) -> Result<RgbImage, TownError> {
        let seen = self.render(record.t_us, &self.figures(record.t_us, &[]), &[view_of(record)])?;
        let empty = || RgbImage::new(record.camera.width, record.camera.height);
        Ok(seen.into_iter().next().map_or_else(empty, |seen| seen.image))
    }

    /// Returns all actors at a time, numbered in the order of `tracks`.
    fn figures(&self, t_us: i64, tracks: &[usize]) -> Vec<Figure> {
        let numbers: BTreeMap<usize, u32> =
            (1..).zip(tracks).map(|(n, track)| (self.actors[*track], n)).collect();
        let figure = |(index, actor): (usize, &Actor)| Figure {
            actor: index,
            town_from_actor: actor.motion.pose(seconds(t_us)),
            number: numbers.get(&index).copied().unwrap_or(0),
        };
        self.plan.traffic.actors.iter().enumerate().map(figure).collect()
    }

    fn render(
        &self,
        t_us: i64,
        figures: &[Figure],
        views: &[View],
    ) -> Result<Vec<GroundTruthView>, TownError> {
        let mut renderer = self.renderer.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if renderer.is_none() {
            let _meshes = reserve_meshes()?;
            *renderer = Some(TownRenderer::new(self.meshes(), &self.options)?);
        }
        let Some(renderer) = renderer.as_mut() else { return Ok(Vec::new()) };
        let views: Vec<View> = views.iter().map(|view| self.in_town(view)).collect();
        Ok(renderer.render(seconds(t_us), &self.plan.traffic.actors, figures, &views)?)
    }

    /// Returns the view with the town's frame as its world.
    fn in_town(&self, view: &View) -> View {
        let camera_from_world = view.camera_from_world * self.global_from_town.affine();
        View { camera: view.camera.clone(), camera_from_world }
    }
}

/// Reserves the memory of the town's meshes and of their renderer, which no option changes.
pub(super) fn reserve_meshes() -> Result<Reservation, TownError> {
    const BYTES: u64 = 512 << 20;
    let need = || Need { what: "the town".to_owned(), bytes: BYTES, advice: "no option needs less" };
    Ok(reserve(BYTES, need).map_err(MeshRenderError::from)?)
}

fn view_of(record: &ImageRecord) -> View {
    View { camera: Camera::clone(&record.camera), camera_from_world: record.camera_from_global().affine() }
}
