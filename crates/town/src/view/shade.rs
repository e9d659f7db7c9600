//! Lighting and shading of samples, and resolve to pixels (`glsl/light.frag`, `<kind>.frag`,
//! `resolve.frag`).
//!
//! # How it works
//! A first pass over all samples computes the visible share of sun and sky, and writes the kind of each
//! sample's shader as depth. Each shader then runs over all samples with the depth test EQUAL, so that it
//! shades only its own samples. A last pass resolves samples to pixels: color with the tent filter 1-2-1 in
//! linear light, triangle and draw from the sample at the pixel's centre.

use std::sync::Arc;

use ash::vk::{self, BufferUsageFlags as Usage, ImageUsageFlags};
use bytemuck::{Pod, Zeroable};
use glam::{DVec3, DVec4, Vec3};
use point_skeleton::gpu::{
    Area, Bind, Buffer, BufferDesc, Depth, DepthTest, DescriptorSet, Device, GpuError, GraphicsPipeline,
    GraphicsPipelineDesc, Image, ImageDesc, Memory, PipelineLayout, Recorder, RenderPass, RenderPassDesc,
    Scope, Shader, Target, Topology, assert_layout,
};

use super::Light;
use super::lens::{Lens, NEAR_M};
use super::maps::{Frames, Maps};
use super::shaders;
use super::surfaces::{DEPTH, OWNER, SURFACE, SurfacePass};

/// Visible share of sun and sky of a sample.
const LIGHT: vk::Format = vk::Format::R8G8_UNORM;
/// Linear color of a sample.
const COLOR: vk::Format = vk::Format::R16G16B16A16_SFLOAT;
/// sRGB color of a pixel.
const PIXEL: vk::Format = vk::Format::R32_UINT;
/// Device memory of a sample in all images, bytes.
const SAMPLE_BYTES: u64 = 16 + 8 + 4 + 4 + 2 + 8;

/// Shaders by kind, in the order of the numbers in `light.frag`.
const KINDS: [&Shader; 7] = [
    &shaders::sky_frag::SHADER,
    &shaders::ground_frag::SHADER,
    &shaders::wall_frag::SHADER,
    &shaders::window_frag::SHADER,
    &shaders::shiny_frag::SHADER,
    &shaders::matt_frag::SHADER,
    &shaders::leaf_frag::SHADER,
];

#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct ViewBlock {
    rays: [[f32; 4]; 3],
    maps: [[[f32; 4]; 3]; 3],
    sun: [f32; 4],
    sunlight: [f32; 4],
    zenith: [f32; 4],
    horizon: [f32; 4],
    ground: [f32; 4],
    scale: [f32; 4],
}
assert_layout!(ViewBlock, shaders::light_frag::town_view, [
    rays: RAY_X,
    maps: NEAR_X,
    sun: SUN,
    sunlight: SUNLIGHT,
    zenith: ZENITH,
    horizon: HORIZON,
    ground: GROUND,
    scale: SCALE,
]);

impl ViewBlock {
    fn new(lens: &Lens, light: &Light, frames: &Frames) -> Self {
        let rays = lens.rays().transpose();
        let ray = |row: DVec3, place: f64| row.extend(place).as_vec4().to_array();
        let rows = |rows: [DVec4; 3]| rows.map(|row| row.as_vec4().to_array());
        let with = |rgb: Vec3, fourth: f32| rgb.extend(fourth).to_array();
        Self {
            rays: [
                ray(rays.x_axis, lens.place.x),
                ray(rays.y_axis, lens.place.y),
                ray(rays.z_axis, lens.place.z),
            ],
            maps: frames.texel_rows(lens.place).map(rows),
            sun: with(light.towards_sun.as_vec3(), if light.bare { 1.0 } else { 0.0 }),
            sunlight: with(light.sun, light.exposure),
            zenith: with(light.zenith, light.clouds),
            horizon: with(light.horizon, light.haze_per_m),
            ground: with(light.ground, light.lamps),
            scale: [NEAR_M as f32, lens.sample_m() as f32, light.cloud_shift, 0.0],
        }
    }
}

/// Pipelines and passes that do not depend on image sizes.
pub(super) struct ShadePass {
    block: Arc<Buffer>,
    light: Screen,
    light_pass: Arc<RenderPass>,
    kinds: Vec<Screen>,
    color_pass: Arc<RenderPass>,
    resolve: Screen,
    resolve_pass: Arc<RenderPass>,
}

/// Fragment shader that runs over all samples.
struct Screen {
    pipeline: GraphicsPipeline,
    fragment: &'static Shader,
}

impl Screen {
    fn new(
        device: &Arc<Device>,
        fragment: &'static Shader,
        pass: &Arc<RenderPass>,
    ) -> Result<Self, GpuError> {
        let vertex = &shaders::screen_vert::SHADER;
        let pipeline = GraphicsPipeline::new(&GraphicsPipelineDesc {
            name: fragment.name,
            layout: &Arc::new(PipelineLayout::new(device, &[vertex, fragment])?),
            vertex,
            fragment,
            pass,
            topology: Topology::Triangles,
            vertices: None,
        })?;
        Ok(Self { pipeline, fragment })
    }

    /// Creates the shader's descriptor set from the bindings that it uses.
    fn set(&self, binds: &[Bind]) -> Result<DescriptorSet, GpuError> {
        let used = self.fragment.bindings.iter().filter_map(|b| binds.get(b.binding as usize).cloned());
        DescriptorSet::new(self.pipeline.layout(), 0, used.collect())
    }
}

/// Images for tiles up to one size.
pub(super) struct Samples {
    /// Maximum width and height of a tile, pixels.
    pub(super) pixels: [u32; 2],
    /// Target of [`SurfacePass`].
    pub(super) surfaces: Target,
    light: (Target, DescriptorSet),
    colors: (Target, Vec<DescriptorSet>),
    resolve: (Target, DescriptorSet),
    shown: Arc<Image>,
    pixel: Arc<Image>,
    /// Readback for each pixel of the tile: provoking vertex, and draw index plus 1.
    pub(super) shown_back: Buffer,
    /// Readback of each pixel's color.
    pub(super) pixel_back: Buffer,
}

impl ShadePass {
    pub(super) fn new(device: &Arc<Device>) -> Result<Self, GpuError> {
        let (read, copied) =
            (vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL, vk::ImageLayout::TRANSFER_SRC_OPTIMAL);
        let pass = |name, colors: &[vk::Format], color_read, test: Option<DepthTest>| {
            let depth = test.map(|test| Depth { format: DEPTH, test });
            RenderPass::new(device, &RenderPassDesc { name, colors, color_read, depth }).map(Arc::new)
        };
        let light_pass = pass("town light", &[LIGHT], read, Some(DepthTest::Less))?;
        let color_pass = pass("town colors", &[COLOR], read, Some(DepthTest::Equal))?;
        let resolve_pass = pass("town pixels", &[OWNER, PIXEL], copied, None)?;
        let light = Screen::new(device, &shaders::light_frag::SHADER, &light_pass)?;
        let kinds = KINDS.iter().map(|shader| Screen::new(device, shader, &color_pass));
        let kinds = kinds.collect::<Result<_, _>>()?;
        let resolve = Screen::new(device, &shaders::resolve_frag::SHADER, &resolve_pass)?;
        let (size, usage) = (size_of::<ViewBlock>() as u64, Usage::UNIFORM_BUFFER | Usage::TRANSFER_DST);
        let desc = BufferDesc { name: "town view", size, usage, memory: Memory::Device };
        let block = Arc::new(Buffer::new(device, &desc)?);
        Ok(Self { block, light, light_pass, kinds, color_pass, resolve, resolve_pass })
    }

    /// Returns the maximum pixel count of a tile.
    pub(super) fn max_area(device: &Device) -> u32 {
        const MAX_PIXELS: u64 = 3 << 19;
        // A pixel has four samples; the largest image takes 16 of a sample's bytes.
        (device.max_allocation() / (4 * SAMPLE_BYTES)).min(MAX_PIXELS) as u32
    }

    /// Creates images for tiles of up to this width and height, pixels.
    pub(super) fn samples(
        &self,
        device: &Arc<Device>,
        (surface_stage, maps): (&SurfacePass, &Maps),
        pixels: [u32; 2],
    ) -> Result<Samples, GpuError> {
        let image = |name, [width, height]: [u32; 2], format, usage| {
            Image::new(device, &ImageDesc { name, width, height, layers: None, format, usage }).map(Arc::new)
        };
        let size = pixels.map(|side| 2 * side + 1);
        let sampled = |name, format| {
            let drawn = if format == DEPTH {
                ImageUsageFlags::DEPTH_STENCIL_ATTACHMENT
            } else {
                ImageUsageFlags::COLOR_ATTACHMENT
            };
            image(name, size, format, drawn | ImageUsageFlags::SAMPLED)
        };
        let (surface, owner) = (sampled("town surfaces", SURFACE)?, sampled("town owners", OWNER)?);
        let (depth, kind) = (sampled("town depths", DEPTH)?, sampled("town kinds", DEPTH)?);
        let (light, color) = (sampled("town light", LIGHT)?, sampled("town colors", COLOR)?);
        let copied = ImageUsageFlags::COLOR_ATTACHMENT | ImageUsageFlags::TRANSFER_SRC;
        let (shown, pixel) =
            (image("town owners", pixels, OWNER, copied)?, image("town pixels", pixels, PIXEL, copied)?);
        // In the order of the binding numbers in `glsl`.
        let layers = [&maps.standing, &maps.moving];
        let [standing, moving] =
            layers.map(|layer| layer.images.each_ref().map(|image| Bind::Image(image.clone())));
        let images = [&surface, &depth, &light].map(|image| Bind::Image(image.clone()));
        let mut binds = vec![Bind::Buffer(self.block.clone())];
        binds.extend(images);
        binds.extend(standing);
        binds.extend([&owner, &color].map(|image| Bind::Image(image.clone())));
        binds.extend(moving);
        let back = |name, pixel_bytes: u64| {
            let size = u64::from(pixels[0]) * u64::from(pixels[1]) * pixel_bytes;
            let (usage, memory) = (Usage::TRANSFER_DST, Memory::Readback);
            Buffer::new(device, &BufferDesc { name, size, usage, memory })
        };
        let surfaces = Target::new(&surface_stage.pass, vec![surface, owner, depth])?;
        let colors = Target::new(&self.color_pass, vec![color, kind.clone()])?;
        let kinds = self.kinds.iter().map(|kind| kind.set(&binds)).collect::<Result<_, _>>()?;
        Ok(Samples {
            pixels,
            surfaces,
            light: (Target::new(&self.light_pass, vec![light, kind])?, self.light.set(&binds)?),
            colors: (colors, kinds),
            resolve: (
                Target::new(&self.resolve_pass, vec![shown.clone(), pixel.clone()])?,
                self.resolve.set(&binds)?,
            ),
            shown,
            pixel,
            shown_back: back("town owners for the host", 8)?,
            pixel_back: back("town pixels for the host", 4)?,
        })
    }

    /// Uploads the view and its light; must precede all passes of the view.
    pub(super) fn update<'a>(
        &'a self,
        recorder: &mut Recorder<'a>,
        lens: &Lens,
        (light, frames): (&Light, &Frames),
    ) -> Result<(), GpuError> {
        let block = ViewBlock::new(lens, light, frames);
        recorder.update(&self.block, 0, bytemuck::bytes_of(&block))?;
        recorder.barrier(Scope::CopyWrite, Scope::ShaderRead);
        Ok(())
    }

    /// Shades the samples of a tile with this width and height in pixels, and copies the pixels to the host.
    pub(super) fn record<'a>(
        &'a self,
        recorder: &mut Recorder<'a>,
        samples: &'a Samples,
        pixels: [u32; 2],
    ) -> Result<(), GpuError> {
        let area =
            |[width, height]: [u32; 2]| Area { width: width.max(1), height: height.max(1), viewport_pad: 0 };
        let all = area(pixels.map(|side| 2 * side + 1));
        let mut screen = |target: &'a Target, area, shaders: &mut dyn Iterator<Item = _>| {
            let mut pass = recorder.pass(target, area);
            for (index, (screen, set)) in shaders.enumerate() {
                let (screen, set): (&'a Screen, &'a DescriptorSet) = (screen, set);
                let depth = (index as f32 + 1.0) / 16.0; // the kind in `light.frag`
                pass.bind(&screen.pipeline, &[set]);
                pass.draw(bytemuck::bytes_of(&depth), 0..3, 1)?;
            }
            drop(pass);
            Ok::<(), GpuError>(())
        };
        screen(&samples.light.0, all, &mut [(&self.light, &samples.light.1)].into_iter())?;
        screen(&samples.colors.0, all, &mut self.kinds.iter().zip(&samples.colors.1))?;
        let resolve = [(&self.resolve, &samples.resolve.1)];
        screen(&samples.resolve.0, area(pixels), &mut resolve.into_iter())?;
        recorder.copy_image(&samples.shown, pixels, &samples.shown_back)?;
        recorder.copy_image(&samples.pixel, pixels, &samples.pixel_back)?;
        recorder.barrier(Scope::CopyWrite, Scope::Host);
        recorder.stamp("shade");
        Ok(())
    }
}
