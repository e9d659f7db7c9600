//! Options that help against errors of the libraries, which name no options themselves.

use std::error::Error;

use point_skeleton::conditions::ConditionError;
use point_skeleton::dataset::DatasetError;
use point_skeleton::error::FileError;
use point_skeleton::files::input::DataRoot;
use point_skeleton::gpu::GpuError;
use point_skeleton::raster::RasterError;
use point_skeleton::skeleton::BuildError;
use pskel_sim::rollout::RolloutError;

/// Returns the option that helps against an error or one of its causes; `None` if there is none.
pub(super) fn advice(error: &anyhow::Error) -> Option<&'static str> {
    error.chain().find_map(of_cause)
}

fn of_cause(cause: &(dyn Error + 'static)) -> Option<&'static str> {
    let cause = inner(cause);
    if let Some(ConditionError::Sizes { .. }) = cause.downcast_ref() {
        return Some("--size or --out-size gives all cameras one size");
    }
    if let Some(BuildError::Interrupted { .. }) = cause.downcast_ref() {
        return Some("--resume continues the build after the retained frames");
    }
    if let Some(DatasetError::File(FileError::Content { expected, .. })) = cause.downcast_ref() {
        return expected
            .contains(DataRoot::BELOW)
            .then_some("--allow-outside permits paths outside the folder");
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

/// Returns the error within a transparent one.
fn inner<'a>(cause: &'a (dyn Error + 'static)) -> &'a (dyn Error + 'static) {
    if let Some(RolloutError::Maps(error)) = cause.downcast_ref() {
        return error;
    }
    let boxed = cause.downcast_ref::<Box<point_skeleton::Error>>().map(AsRef::as_ref);
    match boxed.or(cause.downcast_ref()) {
        Some(point_skeleton::Error::Log(error)) => error,
        Some(point_skeleton::Error::Build(error)) => error,
        Some(point_skeleton::Error::Render(error)) => error,
        Some(point_skeleton::Error::Raster(error)) => error,
        Some(
            point_skeleton::Error::File(_)
            | point_skeleton::Error::Sequence(_)
            | point_skeleton::Error::Step { .. },
        )
        | None => cause,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::Context;
    use std::path::Path;

    #[test]
    fn causes_are_found_below_contexts() {
        let outside =
            FileError::content(format!("{} as filename", DataRoot::BELOW), "..", Path::new("a.json"));
        let error = Err::<(), _>(DatasetError::from(outside)).context("log a").unwrap_err();
        assert!(advice(&error).unwrap().starts_with("--allow-outside "));
        let none = GpuError::NoDevice { found: "none".into() };
        let none = point_skeleton::Error::from(RasterError::from(none));
        assert!(advice(&none.into()).unwrap().starts_with("--rasterizer cpu "));
        let source = Box::new(BuildError::Frame { frames: 1, found: 2 });
        let stopped = BuildError::Interrupted { source, frames: 1, path: "sk.partial".into() };
        assert!(advice(&stopped.into()).unwrap().starts_with("--resume "));
        assert_eq!(advice(&anyhow::anyhow!("other")), None);
    }
}
