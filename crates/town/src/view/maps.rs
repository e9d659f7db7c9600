//! Shadow maps of the sun, and a sky visibility map (`glsl/depth.vert`).
//!
//! # How it works
//! Three orthographic depth maps surround the camera: a fine and a coarse one perpendicular to the sun's
//! rays, and one from above, which gives the visible share of the sky. Their centers move in whole texels, so
//! that shadows do not swim. The centers depend only on the camera's position.

use std::sync::Arc;

use ash::vk::{self, BufferUsageFlags as Usage, ImageUsageFlags};
use bytemuck::{Pod, Zeroable};
use glam::{DAffine3, DMat3, DVec3, DVec4};
use point_skeleton::gpu::{
    Area, Buffer, Commands, Depth, DepthTest, Device, GpuError, GraphicsPipeline, GraphicsPipelineDesc,
    Image, ImageDesc, Indices, PipelineLayout, Recorder, RenderPass, RenderPassDesc, Target, Topology,
    VertexBuffer, assert_layout,
};

use super::corners::{Corners, Part};
use super::light::Light;
use super::mesh_draw::MeshDraw;
use super::shaders;
use crate::mesh::Vertex;

const FORMAT: vk::Format = vk::Format::D32_SFLOAT;
/// Step of the maps' centers, meters: whole texels of each map.
const STEP_M: f64 = 10.0;
/// Side of each map, texels, and half its width, meters: fine, coarse, from above.
const MAPS: [(u32, f64); 3] = [(2048, 32.0), (2048, 160.0), (2048, 64.0)];
/// Half the depth range of each map along its rays, meters.
const REACH_M: [f64; 3] = [500.0, 500.0, 100.0];

#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct DepthPush {
    clip_x: [f32; 4],
    clip_y: [f32; 4],
    clip_z: [f32; 4],
}
assert_layout!(DepthPush, shaders::depth_vert::town_draw, [
    clip_x: CLIP_X,
    clip_y: CLIP_Y,
    clip_z: CLIP_Z,
]);

/// All triangles on the device.
pub(super) struct Triangles {
    pub(super) vertices: Buffer,
    pub(super) indices: Indices,
}

impl Triangles {
    pub(super) fn new(device: &Arc<Device>, corners: &Corners) -> Result<Self, GpuError> {
        let mut commands = Commands::new(device)?;
        let bytes = bytemuck::cast_slice(&corners.vertices);
        let vertices = Buffer::uploaded(device, &mut commands, "corners", Usage::VERTEX_BUFFER, bytes)?;
        Ok(Self { vertices, indices: Indices::new(device, &mut commands, &corners.indices)? })
    }
}

/// Pipeline and images of the maps, shared by all views.
pub(super) struct Maps {
    pipeline: GraphicsPipeline,
    /// Of what stands: rendered again only if that, the camera's surroundings or the light changes.
    pub(super) standing: Layer,
    /// Of actors, rendered for each view: the cameras of a rig have different times.
    pub(super) moving: Layer,
}

/// The three maps: fine, coarse, from above.
pub(super) struct Layer {
    pub(super) images: [Arc<Image>; 3],
    targets: [Target; 3],
}

/// What the maps of a view show.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Casters {
    frames: Frames,
    /// Whether each map is used: the sun's only if it shines.
    shown: [bool; 3],
    draws: Vec<MeshDraw>,
}

impl Casters {
    /// Returns what stands and what moves: meshes of the town are where they were modeled, actors have poses.
    pub(super) fn of(draws: &[MeshDraw], light: &Light, frames: &Frames) -> [Self; 2] {
        let shines = light.sun.max_element() > 0.0 && !light.bare;
        let (standing, moving) = draws.iter().partition(|draw| draw.town_from_mesh == DAffine3::IDENTITY);
        [standing, moving].map(|draws| Self { frames: *frames, shown: [shines, shines, !light.bare], draws })
    }

    /// Returns which maps differ for other casters.
    pub(super) fn differ(&self, other: Option<&Self>) -> [bool; 3] {
        let Some(other) = other.filter(|other| other.draws == self.draws) else { return [true; 3] };
        [0, 1, 2].map(|i| (self.frames.0[i], self.shown[i]) != (other.frames.0[i], other.shown[i]))
    }
}

/// Projections of the maps, which follow from the camera's position and the light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Frames([Frame; 3]);

/// Projection of one map: clip coordinates from town coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Frame {
    /// Rows for clip x, clip y, and depth from 0 to 1 away from the light.
    rows: [DVec4; 3],
}

impl Frame {
    /// Creates the projection of a map whose rays come from `towards`.
    fn new(towards: DVec3, place: DVec3, half_m: f64, reach_m: f64) -> Self {
        let side = DVec3::Z.cross(towards).try_normalize().unwrap_or(DVec3::X);
        let axes = DMat3::from_cols(side, towards.cross(side), towards).transpose();
        // Adding 0 turns -0 into 0.
        let middle = (axes * place / STEP_M).round() * STEP_M + 0.0;
        let axis = |row: DVec3, middle: f64, scale: f64| row.extend(-middle) * scale;
        let rows = axes.transpose();
        let x = axis(rows.x_axis, middle.x, 1.0 / half_m);
        let y = axis(rows.y_axis, middle.y, 1.0 / half_m);
        let away = axis(rows.z_axis, middle.z, -0.5 / reach_m) + DVec4::W * 0.5;
        Self { rows: [x, y, away] }
    }

    fn clip_rows(&self, town_from_mesh: &DAffine3) -> [DVec4; 3] {
        let linear = town_from_mesh.matrix3.transpose();
        let place = town_from_mesh.translation;
        self.rows.map(|row| (linear * row.truncate()).extend(row.truncate().dot(place) + row.w))
    }
}

impl Frames {
    pub(super) fn new(light: &Light, place: DVec3) -> Self {
        let towards = [light.towards_sun, light.towards_sun, DVec3::Z];
        Self(std::array::from_fn(|i| Frame::new(towards[i], place, MAPS[i].1, REACH_M[i])))
    }

    /// Returns rows that map `(place − camera, 1)` to texel x, texel y and depth, for each map.
    pub(super) fn texel_rows(&self, camera: DVec3) -> [[DVec4; 3]; 3] {
        let shift = DAffine3::from_translation(camera);
        std::array::from_fn(|i| {
            let half = f64::from(MAPS[i].0) / 2.0;
            let [x, y, z] = self.0[i].clip_rows(&shift);
            [x * half + DVec4::W * half, y * half + DVec4::W * half, z]
        })
    }
}

impl Maps {
    pub(super) fn new(device: &Arc<Device>) -> Result<Self, GpuError> {
        let (vertex, fragment) = (&shaders::depth_vert::SHADER, &shaders::depth_frag::SHADER);
        let layout = Arc::new(PipelineLayout::new(device, &[vertex, fragment])?);
        let depth = Some(Depth { format: FORMAT, test: DepthTest::Less });
        let color_read = vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL;
        let desc = RenderPassDesc { name: "town depth", colors: &[], color_read, depth };
        let pass = Arc::new(RenderPass::new(device, &desc)?);
        let pipeline = GraphicsPipeline::new(&GraphicsPipelineDesc {
            name: "town depth",
            layout: &layout,
            vertex,
            fragment,
            pass: &pass,
            topology: Topology::Triangles,
            vertices: Some(VertexBuffer {
                stride: size_of::<Vertex>() as u32,
                per_instance: false,
                offsets: &[std::mem::offset_of!(Vertex, position) as u32],
            }),
        })?;
        let layer = || Layer::new(device, &pass);
        Ok(Self { standing: layer()?, moving: layer()?, pipeline })
    }

    /// Renders the shadow casters of a layer into some of its maps.
    pub(super) fn record<'a>(
        &'a self,
        recorder: &mut Recorder<'a>,
        (triangles, parts): (&'a Triangles, &[Part]),
        (layer, some): (&'a Layer, [bool; 3]),
        Casters { frames, shown, draws }: &Casters,
    ) -> Result<(), GpuError> {
        for i in (0..3).filter(|i| some[*i]) {
            let (target, frame, side) = (&layer.targets[i], &frames.0[i], MAPS[i].0);
            let mut pass = recorder.pass(target, Area { width: side, height: side, viewport_pad: 0 });
            pass.bind(&self.pipeline, &[]);
            pass.vertices(&triangles.vertices);
            pass.indices(&triangles.indices);
            for draw in draws.iter().filter(|_| shown[i]) {
                let part = &parts[draw.mesh];
                let rows = frame.clip_rows(&draw.town_from_mesh);
                if part.bounds.is_some_and(|bounds| touches(&rows, bounds)) {
                    let [clip_x, clip_y, clip_z] = rows.map(|row| row.as_vec4().to_array());
                    let push = DepthPush { clip_x, clip_y, clip_z };
                    pass.draw_indexed(bytemuck::bytes_of(&push), part.indices.clone())?;
                }
            }
        }
        recorder.stamp("maps");
        Ok(())
    }
}

impl Layer {
    fn new(device: &Arc<Device>, pass: &Arc<RenderPass>) -> Result<Self, GpuError> {
        let image = |(side, _): (u32, f64)| {
            let usage = ImageUsageFlags::DEPTH_STENCIL_ATTACHMENT | ImageUsageFlags::SAMPLED;
            let (width, height) = (side, side);
            let desc = ImageDesc { name: "town depth", width, height, layers: None, format: FORMAT, usage };
            Image::new(device, &desc).map(Arc::new)
        };
        let [fine, coarse, over] = MAPS;
        let images = [image(fine)?, image(coarse)?, image(over)?];
        let target = |image: &Arc<Image>| Target::new(pass, vec![image.clone()]);
        let targets = [target(&images[0])?, target(&images[1])?, target(&images[2])?];
        Ok(Self { images, targets })
    }
}

/// Returns whether a box may reach into a map.
fn touches(rows: &[DVec4; 3], [min, max]: [DVec3; 2]) -> bool {
    let (middle, half) = ((min + max) / 2.0, (max - min) / 2.0);
    rows[..2].iter().all(|row| {
        let at = row.truncate().dot(middle) + row.w;
        at.abs() - row.truncate().abs().dot(half) <= 1.0
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Daylight;

    #[test]
    fn shadow_maps_move_in_whole_texels_around_the_camera() {
        let light = Light::new(Daylight::Dusk, 5);
        for (side, half) in MAPS {
            let texel = 2.0 * half / f64::from(side);
            assert_eq!((STEP_M / texel).fract(), 0.0);
        }
        let fixed = DVec3::new(3.0, 4.0, 0.5);
        let texel_of = |place: DVec3| {
            Frames::new(&light, place).texel_rows(place).map(|rows| {
                let p = (fixed - place).extend(1.0);
                rows.map(|row| row.dot(p))
            })
        };
        let first = texel_of(DVec3::new(0.0, 0.0, 1.5));
        for i in 0..40 {
            let place = DVec3::new(0.7 * f64::from(i), -0.4 * f64::from(i), 1.5);
            let now = texel_of(place);
            for (map, (a, b)) in first.iter().zip(&now).enumerate() {
                for axis in 0..2 {
                    let moved = a[axis] - b[axis];
                    assert!((moved - moved.round()).abs() < 1e-6, "{moved}");
                    let [x, y, z] = Frames::new(&light, place).texel_rows(place)[map].map(|row| row.w);
                    let side = f64::from(MAPS[map].0);
                    assert!([x, y].iter().all(|v| (v / side - 0.5).abs() < 0.16), "{x} {y}");
                    assert!((0.4..0.6).contains(&z));
                }
            }
        }
    }

    #[test]
    fn depth_increases_away_from_the_sun() {
        let light = Light::new(Daylight::Day, 5);
        let rows = Frames::new(&light, DVec3::ZERO).texel_rows(DVec3::ZERO);
        let at = |p: DVec3| rows[0].map(|row| row.dot(p.extend(1.0)));
        let (low, high) = (at(DVec3::ONE), at(DVec3::ONE + 3.0 * light.towards_sun));
        assert!((low[0] - high[0]).abs() < 1e-9 && (low[1] - high[1]).abs() < 1e-9);
        assert!(((low[2] - high[2]) * 2.0 * REACH_M[0] - 3.0).abs() < 1e-9);
    }
}
