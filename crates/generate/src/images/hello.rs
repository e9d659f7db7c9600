use point_skeleton::conditions::MapKind;
use point_skeleton::geometry::ImageSize;
use pskel_sim::peer::ProtocolError;
use safetensors::SafeTensorError;
use serde::{Serialize, Serializer};

use super::rig::ImageRig;
use crate::DenoiserRig;
use crate::process::connection::MAX_ANSWER_BYTES;
use crate::process::hello::image_size;
use crate::process::message::{Answer, serialized};

const PROTOCOL: &str = "pskel-images";
const VERSION: &str = "1";
/// Maximum number of references, earlier images and forecasts.
const MAX_COUNT: usize = 100;
/// Maps that can be asked for; the last one only if the log has an HD map.
const MAPS: [MapKind; 6] =
    [MapKind::Color, MapKind::Depth, MapKind::Class, MapKind::Instance, MapKind::Boxes, MapKind::Map];

/// What the process wants, by its answer to the hello.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Wanted {
    /// Size of its images.
    pub(super) size: ImageSize,
    /// Maps of each frame.
    #[serde(serialize_with = "names")]
    pub(super) maps: Vec<MapKind>,
    /// Number of recorded images at the beginning.
    pub(super) references: usize,
    /// Number of earlier images in a request, at most.
    pub(super) history: usize,
    /// Number of forecasts in a request, at most.
    pub(super) forecasts: usize,
}

fn names<S: Serializer>(maps: &[MapKind], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(maps.iter().map(|map| map.name()))
}

fn offered(has_map: bool) -> &'static [MapKind] {
    if has_map { &MAPS } else { &MAPS[..MAPS.len() - 1] }
}

pub(super) fn hello(rig: &ImageRig, size: ImageSize) -> Result<Vec<u8>, SafeTensorError> {
    let DenoiserRig { cameras, image_sizes, fps } = &rig.rig;
    let sizes: Vec<[u32; 2]> = image_sizes.iter().map(|size| [size.width, size.height]).collect();
    let maps: Vec<&str> = offered(rig.has_map).iter().map(|map| map.name()).collect();
    let texts = [
        ("protocol", PROTOCOL.to_owned()),
        ("version", VERSION.to_owned()),
        ("log", rig.log.clone()),
        ("seed", rig.seed.to_string()),
        ("fps", fps.to_string()),
        ("condition_size", format!("{},{}", size.height, size.width)),
        ("cameras", serde_json::json!(cameras).to_string()),
        ("image_sizes", serde_json::json!(sizes).to_string()),
        ("maps", serde_json::json!(maps).to_string()),
    ];
    serialized(texts, [])
}

/// Parses and validates the answer to the hello.
pub(super) fn read_hello(answer: &[u8], rig: &ImageRig) -> Result<Wanted, ProtocolError> {
    let answer = Answer::read(answer)?;
    refuse_error(&answer)?;
    let text = |name: &str| answer.texts.get(name).map_or("", String::as_str);
    if (text("protocol"), text("version")) != (PROTOCOL, VERSION) {
        let found =
            format!("`protocol` {} of `version` {}", answer.quoted("protocol"), answer.quoted("version"));
        return Err(ProtocolError::new(format!("`protocol` {PROTOCOL:?} of `version` {VERSION:?}"), found));
    }
    let cameras = rig.rig.cameras.len().max(1);
    // Half of the limit leaves room for the header.
    let most = (MAX_ANSWER_BYTES / 2) as usize / 3 / cameras;
    let size = image_size(text("image_size")).filter(|size| size.pixels() <= most);
    let size = size.ok_or_else(|| {
        let expected = format!("`image_size` \"H,W\" of positive numbers, at most {most} pixels");
        ProtocolError::new(expected, answer.quoted("image_size"))
    })?;
    let references = count(&answer, "references", 1)?;
    Ok(Wanted {
        size,
        maps: maps(&answer, offered(rig.has_map))?,
        references,
        history: count(&answer, "history", references)?,
        forecasts: count(&answer, "forecasts", 0)?,
    })
}

/// Fails if the answer is an error.
pub(super) fn refuse_error(answer: &Answer<'_>) -> Result<(), ProtocolError> {
    match answer.texts.get("error") {
        Some(_) => Err(ProtocolError::new("images", format!("the error {}", answer.quoted("error")))),
        None => Ok(()),
    }
}

/// Parses a number of images.
fn count(answer: &Answer<'_>, name: &str, default: usize) -> Result<usize, ProtocolError> {
    let Some(text) = answer.texts.get(name) else { return Ok(default) };
    text.parse().ok().filter(|count| *count <= MAX_COUNT).ok_or_else(|| {
        ProtocolError::new(format!("`{name}` from 0 to {MAX_COUNT}, if any"), answer.quoted(name))
    })
}

/// Parses the list of maps.
fn maps(answer: &Answer<'_>, offered: &[MapKind]) -> Result<Vec<MapKind>, ProtocolError> {
    let Some(text) = answer.texts.get("maps") else { return Ok(vec![MapKind::Color]) };
    let named = |name: &String| offered.iter().copied().find(|map| map.name() == name);
    let names: Option<Vec<String>> = serde_json::from_str(text).ok();
    let maps: Option<Vec<MapKind>> = names.and_then(|names| names.iter().map(named).collect());
    let is_once = |maps: &Vec<MapKind>| (1..maps.len()).all(|i| !maps[..i].contains(&maps[i]));
    maps.filter(is_once).ok_or_else(|| {
        let names: Vec<&str> = offered.iter().map(|map| map.name()).collect();
        let expected = format!("`maps` as a JSON list of {}, each at most once", names.join(", "));
        ProtocolError::new(expected, answer.quoted("maps"))
    })
}
