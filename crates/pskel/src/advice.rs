//! Options that help against errors of the libraries, which name no options themselves.

use std::error::Error;

use point_skeleton::conditions::ConditionError;
use point_skeleton::dataset::DatasetError;
use point_skeleton::error::FileError;
use point_skeleton::files::input::DataRoot;
use point_skeleton::gpu::GpuError;
use point_skeleton::raster::RasterError;
use point_skeleton::skeleton::BuildError;

/// Returns the option that helps against an error or one of its causes; `None` if there is none.
pub(super) fn advice(error: &anyhow::Error) -> Option<&'static str> {
    error.chain().find_map(of_cause)
}

fn of_cause(cause: &(dyn Error + 'static)) -> Option<&'static str> {
    if let Some(ConditionError::Sizes { .. }) = cause.downcast_ref() {
        return Some("--size or --out-size gives all cameras one size");
    }
    if let Some(BuildError::Interrupted { source, .. }) = cause.downcast_ref() {
        // A folder that cannot be replaced now cannot be replaced later either.
        let is_fixed =
            matches!(&**source, BuildError::File(FileError::Io { verb: "replace" | "rename to", .. }));
        return (!is_fixed).then_some("--resume continues the build after the retained frames");
    }
    if let Some(DatasetError::File(FileError::Content { expected, .. })) = cause.downcast_ref() {
        return expected
            .contains(DataRoot::BELOW)
            .then_some("--allow-outside permits paths outside the folder");
    }
    if let Some(FileError::Io { path, .. }) = cause.downcast_ref()
        && path.file_name().is_some_and(|name| name == "skeleton.json")
    {
        return Some("`pskel build LOG --out DIR` writes a skeleton");
    }
    match cause.downcast_ref()? {
        RasterError::Gpu(GpuError::NoLoader { .. } | GpuError::NoDevice { .. }) => {
            Some("--rasterizer cpu needs no Vulkan")
        }
        RasterError::Gpu(GpuError::Unsupported { .. }) => {
            Some("--rasterizer selects another rasterizer, --gpu-memory the memory for points")
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::Context;
    use pskel_eval::bench::BenchError;
    use pskel_sim::rollout::RolloutError;
    use std::path::Path;

    #[test]
    fn causes_are_found_below_contexts() {
        let outside =
            FileError::content(format!("{} as filename", DataRoot::BELOW), "..", Path::new("a.json"));
        let error = Err::<(), _>(DatasetError::from(outside)).context("log a").unwrap_err();
        assert!(advice(&error).unwrap().starts_with("--allow-outside "));
        let missing =
            FileError::io("read", Path::new("sk/skeleton.json"))(std::io::ErrorKind::NotFound.into());
        assert!(advice(&missing.into()).unwrap().starts_with("`pskel build LOG"));
        let none = GpuError::NoDevice { found: "none".into() };
        let none = point_skeleton::Error::from(RasterError::from(none));
        assert!(advice(&none.into()).unwrap().starts_with("--rasterizer cpu "));
        let source = Box::new(BuildError::Frame { frames: 1, found: 2 });
        let stopped = BuildError::Interrupted { source, frames: 1, path: "sk.partial".into() };
        assert!(advice(&stopped.into()).unwrap().starts_with("--resume "));
        let source = FileError::io("replace", Path::new("sk"))(std::io::ErrorKind::CrossesDevices.into());
        let stopped =
            BuildError::Interrupted { source: Box::new(source.into()), frames: 1, path: "sk.partial".into() };
        assert_eq!(advice(&stopped.into()), None, "it would fail in the same way");
        assert_eq!(advice(&anyhow::anyhow!("other")), None);
    }

    /// The errors of all libraries keep their causes in the chain.
    #[test]
    fn causes_are_found_below_the_errors_of_layers() {
        let raster = || RasterError::from(GpuError::NoDevice { found: "none".into() });
        let maps = || ConditionError::from(raster());
        let step = point_skeleton::Error::Step { name: "0".into(), source: Box::new(maps().into()) };
        let errors: [anyhow::Error; 5] = [
            maps().into(),
            step.into(),
            BenchError::from(raster()).into(),
            BenchError::Render(maps().into()).into(),
            RolloutError::from(maps()).into(),
        ];
        for error in &errors {
            assert!(advice(error).is_some_and(|hint| hint.starts_with("--rasterizer cpu ")), "{error:?}");
        }
    }
}
