//! `opendwm-preview`: a package per shard for OpenDWM's `PreviewDataset`: `SHARD/data.json`, and
//! `SHARD/FRAME/{rgb,3dbox,hdmap,color,..}/CAMERA.{jpg,png}`.

use point_skeleton::Maps;
use point_skeleton::conditions::MapKind;
use serde_json::{Map, Value, json};

use super::{LayoutWriter, Source, sizes};
use crate::ExportError;
use crate::files::{Encoded, images_as_jpeg, maps_as_png};
use crate::samples::Sample;
use crate::shard::Shard;

pub(super) struct Package<'a> {
    source: &'a Source<'a>,
    folder: String,
    samples: Vec<Value>,
}

impl<'a> Package<'a> {
    pub(super) fn new(source: &'a Source<'a>, folder: &str) -> Self {
        Self { source, folder: folder.to_owned(), samples: Vec::new() }
    }
}

/// Returns the name of a map in `data.json`.
fn key(kind: MapKind) -> &'static str {
    match kind {
        MapKind::Boxes => "3dbox",
        MapKind::Map => "hdmap",
        other => other.name(),
    }
}

impl LayoutWriter for Package<'_> {
    fn add(&mut self, shard: &mut Shard, sample: &Sample<'_>, maps: &Maps) -> Result<(), ExportError> {
        let source = self.source;
        let frame = &sample.state.name;
        let camera = |index: usize| maps.cameras()[index].name.as_str();
        let map_path = |index: usize, kind| format!("{frame}/{}/{}.png", key(kind), camera(index));
        let image_path = |index: usize| format!("{frame}/rgb/{}.jpg", camera(index));
        let mut files = maps_as_png(maps.cameras(), &source.options.conditions.depth_bins, |index, kind| {
            Some(map_path(index, kind))
        })?;
        if source.options.images {
            files.extend(images_as_jpeg(shard, source.log, sample, &sizes(maps), image_path)?);
        }
        let meta = source.meta(maps);
        let mut infos = Map::new();
        for ((index, camera), caption) in meta.cameras.iter().enumerate().zip(source.captions(sample)) {
            let mut info = json!({
                "extrin": camera.ego_from_camera, "intrin": camera.intrinsics,
                "image_description": caption,
            });
            let exists = |path: &String| files.iter().any(|file| file.name == *path);
            for kind in MapKind::ALL {
                let path = Some(map_path(index, kind)).filter(exists);
                if path.is_some() || matches!(kind, MapKind::Boxes | MapKind::Map) {
                    info[key(kind)] = json!(path);
                }
            }
            info["rgb"] = json!(Some(image_path(index)).filter(exists));
            infos.insert(camera.name.to_string(), info);
        }
        self.samples.push(json!({
            "timestamp": sample.state.t_us as f64 * 1e-6,
            "ego_pose": point_skeleton::cloud::cameras::rows(&sample.state.global_from_ego.affine()),
            "camera_infos": infos,
        }));
        for Encoded { name, bytes } in files {
            shard.put(format!("{}/{name}", self.folder), &bytes)?;
        }
        Ok(())
    }

    fn finish(self: Box<Self>, shard: &mut Shard) -> Result<(), ExportError> {
        let numbered = self.samples.into_iter().enumerate();
        let data: Map<String, Value> = numbered.map(|(index, sample)| (index.to_string(), sample)).collect();
        let text = format!("{:#}\n", Value::Object(data));
        Ok(shard.put(format!("{}/data.json", self.folder), text.as_bytes())?)
    }
}
