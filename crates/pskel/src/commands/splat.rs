use std::path::PathBuf;
use std::time::Instant;

use clap::Args;
use point_skeleton::cloud;
use point_skeleton::conditions::write::npz;
use point_skeleton::conditions::{
    ConditionOptions, ConditionSet, MapKind, MapSet, check_memory, render_views,
};
use point_skeleton::files::{Inputs, OutputFile};
use point_skeleton::raster::Instance;
use point_skeleton::scene::SceneInstances;

use crate::args::rasterizer::RasterizerArgs;
use crate::args::size::SizeArgs;
use crate::args::source::CloudArgs;
use crate::progress::Progress;
use crate::{WrongUsage, print_notes, print_result};

/// Splat any point cloud into any cameras: color, depth, class and point number per pixel
///
/// The nearest point wins every pixel that its square covers; among points of equal depth, the first one in
/// the file. Writes the arrays color (u8, VxHxWx3), depth (f32, VxHxW, meters, -300 where empty), class (u8,
/// VxHxW) and point (u32, VxHxW, row in the file + 1, 0 where empty), views in the order of the camera file.
#[derive(Debug, Args)]
#[command(mut_arg("points", |arg| arg.required(true)), mut_arg("cameras", |arg| arg.required(true)))]
pub(crate) struct SplatArgs {
    #[command(flatten)]
    cloud: CloudArgs,
    /// Archive to write
    #[arg(long, value_name = "F.npz")]
    out: PathBuf,
    #[command(flatten)]
    size: SizeArgs,
    #[command(flatten)]
    rasterizer: RasterizerArgs,
}

/// Runs the command: reads points and cameras, renders, writes the arrays.
pub(crate) fn run(args: SplatArgs) -> anyhow::Result<()> {
    let start = Instant::now();
    let CloudArgs { points: Some(points), cameras: Some(cameras) } = &args.cloud else {
        return Err(WrongUsage("expected --points and --cameras, found none".to_owned()).into());
    };
    let inputs = Inputs::new([points, cameras]);
    let out = OutputFile::open(&args.out, npz::COLOR_FIRST, &inputs)?;
    let views = cloud::cameras::read(cameras)?;
    let cloud = cloud::read(points)?;
    print_notes(points, &cloud.notes);
    let mut rasterizer = args.rasterizer.create(vec![(&cloud.points).into()])?;
    let instance = Instance { cloud: 0, world_from_local: cloud.world_from_local(), number: 0 };
    let clouds = SceneInstances { color: vec![instance], geometry: vec![instance] };
    let maps = [MapKind::Color, MapKind::Depth, MapKind::Class, MapKind::Point];
    let options = ConditionOptions { maps: MapSet::of(&maps), ..args.size.conditions() };
    check_memory(&views, &options, false)?;
    let mut set = ConditionSet::default();
    let mut progress = Progress::new(views.len());
    for view in &views {
        let view = std::slice::from_ref(view);
        set.cameras.extend(render_views(rasterizer.as_mut(), &clouds, view, None, &options)?);
        progress.step(&view[0].camera.name);
    }
    drop(progress);
    npz::write(out.path(), &set)?;
    let not_drawn = match cloud.non_finite {
        0 => String::new(),
        n => format!(" ({n} not finite, never drawn)"),
    };
    let info = rasterizer.info();
    print_result(&format!(
        "splatted {} points{not_drawn} into {} views by {} on {} in {:.2} s: {}",
        cloud.points.len(),
        views.len(),
        info.rasterizer,
        info.device,
        start.elapsed().as_secs_f64(),
        args.out.display()
    ));
    Ok(())
}
