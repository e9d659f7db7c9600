//! `webdataset`: an uncompressed tar per shard. A sample has the key `LOG-FRAME` and the files `KEY.json`,
//! and either `KEY.conditions.safetensors` or `KEY.MAP.CAMERA.png`; with recorded images also
//! `KEY.image.CAMERA.jpg`.
//!
//! Names are in lower case, since readers convert them. Maps of 16 bits are `KEY.MAP.CAMERA.npy`: all image
//! decoders of the package reduce PNG to 8 bits, without an error.

use std::borrow::Cow;
use std::path::Path;

use point_skeleton::cloud::cameras::rows;
use point_skeleton::conditions::write::safetensors;
use point_skeleton::error::FileError;
use point_skeleton::{MapKind, Maps};
use tar::{Builder, EntryType, Header};

use super::{LayoutWriter, Source, sizes};
use crate::files::{images_as_jpeg, maps_for_8_bits};
use crate::samples::Sample;
use crate::shard::{HashedFile, Shard};
use crate::{ExportError, SampleFormat};

pub(super) struct Tar<'a> {
    source: &'a Source<'a>,
    tar: Builder<HashedFile>,
}

impl<'a> Tar<'a> {
    pub(super) fn begin(shard: &Shard, source: &'a Source<'a>) -> Result<Self, ExportError> {
        Ok(Self { source, tar: Builder::new(shard.create(format!("{}.tar", shard.name()))?) })
    }

    fn append(&mut self, name: &str, parts: &[Cow<'_, [u8]>]) -> Result<(), FileError> {
        let mut header = Header::new_ustar();
        header.set_size(parts.iter().map(|part| part.len() as u64).sum());
        header.set_entry_type(EntryType::Regular);
        header.set_mode(0o644);
        header.set_mtime(0);
        header.set_uid(0);
        header.set_gid(0);
        let path = self.tar.get_ref().shown.clone();
        let content = Parts { parts, part: 0, at: 0 };
        self.tar.append_data(&mut header, name, content).map_err(FileError::io("write", &path))
    }
}

impl LayoutWriter for Tar<'_> {
    fn add(&mut self, shard: &mut Shard, sample: &Sample<'_>, maps: &Maps) -> Result<(), ExportError> {
        let source = self.source;
        let key = format!("{}-{}", source.listed.name, sample.state.name);
        let camera = |index: usize| maps.cameras()[index].name.to_lowercase();
        let mut meta = serde_json::json!(source.meta(maps));
        meta["log"] = serde_json::json!(source.recording().name);
        meta["frame"] = serde_json::json!(sample.frame);
        meta["caption"] = serde_json::json!(source.log_caption());
        meta["global_from_ego"] = serde_json::json!(rows(&sample.state.global_from_ego.affine()));
        let views = sample.state.cameras.iter().map(|camera| &camera.view.camera);
        let cameras = sample.images.iter().zip(source.captions(sample)).zip(views);
        for (index, ((image, caption), view)) in cameras.enumerate() {
            let camera = &mut meta["cameras"][index];
            camera["token"] = serde_json::json!(image.map(|image| &image.token));
            camera["t_us"] = serde_json::json!(image.map(|image| image.t_us));
            camera["original_size"] = serde_json::json!([view.height, view.width]);
            camera["caption"] = serde_json::json!(caption);
        }
        self.append(&format!("{key}.json"), &[Cow::Owned(meta.to_string().into_bytes())])?;
        let mut files = Vec::new();
        match source.options.format {
            SampleFormat::Png => {
                let name = |index, kind: MapKind| format!("{key}.{}.{}", kind.name(), camera(index));
                files = maps_for_8_bits(maps.cameras(), &source.options.conditions.depth_bins, name)?;
            }
            SampleFormat::Safetensors => {
                let name = format!("{key}.conditions.safetensors");
                let parts = safetensors::encode(
                    Path::new(&name),
                    &maps.set,
                    sample.state.t_us,
                    &source.options.conditions,
                )?;
                self.append(&name, &parts)?;
            }
        }
        if source.options.images {
            let name = |index| format!("{key}.image.{}.jpg", camera(index));
            files.extend(images_as_jpeg(shard, source.log, sample, &sizes(maps), name)?);
        }
        files.iter().try_for_each(|file| self.append(&file.name, &[Cow::Borrowed(&file.bytes)]))?;
        Ok(())
    }

    fn finish(self: Box<Self>, shard: &mut Shard) -> Result<(), ExportError> {
        let path = self.tar.get_ref().shown.clone();
        let file = self.tar.into_inner().map_err(FileError::io("write", &path))?;
        Ok(shard.close(file)?)
    }
}

/// Reads parts one after the other.
struct Parts<'a> {
    parts: &'a [Cow<'a, [u8]>],
    part: usize,
    at: usize,
}

impl std::io::Read for Parts<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        while let Some(part) = self.parts.get(self.part) {
            let rest = &part[self.at..];
            if !rest.is_empty() {
                let count = rest.len().min(buffer.len());
                buffer[..count].copy_from_slice(&rest[..count]);
                self.at += count;
                return Ok(count);
            }
            (self.part, self.at) = (self.part + 1, 0);
        }
        Ok(0)
    }
}
