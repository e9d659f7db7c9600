//! Visible surface of each sample (`glsl/surface.vert`, `.frag`).
//!
//! # How it works
//! Depth is `NEAR / z` under the test GREATER: 1 at the near plane, 0 at infinity, precise everywhere. Two
//! more attachments store normal, color, surface, seed and uv, and the triangle with its draw. Shading is
//! deferred, so overdraw costs little; near meshes are drawn first.

use std::sync::Arc;

use ash::vk;
use bytemuck::{Pod, Zeroable};
use point_skeleton::gpu::{
    Area, Depth, DepthTest, Device, GpuError, GraphicsPipeline, GraphicsPipelineDesc, PipelineLayout,
    Recorder, RenderPass, RenderPassDesc, Target, Topology, VertexBuffer, assert_layout,
};

use super::corners::Part;
use super::lens::{Lens, NEAR_M, nearest_m};
use super::maps::Triangles;
use super::mesh_draw::MeshDraw;
use super::shaders;
use crate::mesh::Vertex;

/// Normal, color and surface, seed, uv.
pub(super) const SURFACE: vk::Format = vk::Format::R32G32B32A32_UINT;
/// Provoking vertex of the triangle, draw index plus 1.
pub(super) const OWNER: vk::Format = vk::Format::R32G32_UINT;
/// Depth.
pub(super) const DEPTH: vk::Format = vk::Format::D32_SFLOAT;

#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct SurfacePush {
    clip_x: [f32; 4],
    clip_y: [f32; 4],
    camera_z: [f32; 4],
    turn_x: [f32; 4],
    turn_y: [f32; 4],
    turn_z: [f32; 4],
    draw: u32,
    near_m: f32,
    pad: [u32; 2],
}
assert_layout!(SurfacePush, shaders::surface_vert::town_surface_draw, [
    clip_x: CLIP_X,
    clip_y: CLIP_Y,
    camera_z: CAMERA_Z,
    turn_x: TURN_X,
    turn_y: TURN_Y,
    turn_z: TURN_Z,
    draw: DRAW,
    near_m: NEAR_M,
]);

/// Pipeline and pass, which do not depend on image sizes.
pub(super) struct SurfacePass {
    pipeline: GraphicsPipeline,
    pub(super) pass: Arc<RenderPass>,
}

impl SurfacePass {
    pub(super) fn new(device: &Arc<Device>) -> Result<Self, GpuError> {
        let (vertex, fragment) = (&shaders::surface_vert::SHADER, &shaders::surface_frag::SHADER);
        let layout = Arc::new(PipelineLayout::new(device, &[vertex, fragment])?);
        let depth = Some(Depth { format: DEPTH, test: DepthTest::Greater });
        let color_read = vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL;
        let desc = RenderPassDesc { name: "town surfaces", colors: &[SURFACE, OWNER], color_read, depth };
        let pass = Arc::new(RenderPass::new(device, &desc)?);
        let offsets = [
            std::mem::offset_of!(Vertex, position) as u32,
            std::mem::offset_of!(Vertex, normal) as u32,
            std::mem::offset_of!(Vertex, uv) as u32,
            std::mem::offset_of!(Vertex, rgba) as u32,
            std::mem::offset_of!(Vertex, surface) as u32,
        ];
        let stride = size_of::<Vertex>() as u32;
        let pipeline = GraphicsPipeline::new(&GraphicsPipelineDesc {
            name: "town surfaces",
            layout: &layout,
            vertex,
            fragment,
            pass: &pass,
            topology: Topology::Triangles,
            vertices: Some(VertexBuffer { stride, per_instance: false, offsets: &offsets }),
        })?;
        Ok(Self { pipeline, pass })
    }

    /// Draws all meshes that may be visible, the nearest first.
    pub(super) fn record<'a>(
        &'a self,
        recorder: &mut Recorder<'a>,
        target: &'a Target,
        lens: &Lens,
        (triangles, parts): (&'a Triangles, &[Part]),
        draws: &[MeshDraw],
    ) -> Result<(), GpuError> {
        let seen = |(number, draw): (usize, &MeshDraw)| {
            let clip = lens.clip_rows(&draw.town_from_mesh);
            nearest_m(&clip, parts[draw.mesh].bounds?).map(|nearest| (nearest, number, clip))
        };
        let mut order: Vec<_> = draws.iter().enumerate().filter_map(seen).collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let [width, height] = lens.samples;
        let mut pass = recorder.pass(target, Area { width, height, viewport_pad: 0 });
        pass.bind(&self.pipeline, &[]);
        pass.vertices(&triangles.vertices);
        pass.indices(&triangles.indices);
        for (_, number, clip) in order {
            let draw = &draws[number];
            let [clip_x, clip_y, camera_z] = clip.map(|row| row.as_vec4().to_array());
            // The same rotation applies to normals, because poses have no scale.
            let turn = draw.town_from_mesh.matrix3.transpose();
            let row = |row: glam::DVec3| row.extend(0.0).as_vec4().to_array();
            let push = SurfacePush {
                clip_x,
                clip_y,
                camera_z,
                turn_x: row(turn.x_axis),
                turn_y: row(turn.y_axis),
                turn_z: row(turn.z_axis),
                draw: number as u32 + 1,
                near_m: NEAR_M as f32,
                pad: [0; 2],
            };
            pass.draw_indexed(bytemuck::bytes_of(&push), parts[draw.mesh].indices.clone())?;
        }
        drop(pass);
        recorder.stamp("surfaces");
        Ok(())
    }
}
