//! Draco point clouds, versions 2.0 to 2.3 of the bitstream, of both encodings (sequential and KD-tree).
//!
//! # How it works
//! The `draco-core` crate decodes attributes, within limits of points and bytes. The position is quantized;
//! features are generic attributes whose names are in the metadata. Numbers of a type that Draco lacks are
//! stored as their bytes, beside an attribute whose first value spells the type (`<i8`). Format:
//! <https://google.github.io/draco/spec/>.

use draco_core::{
    DataType, DecodeLimits, DecoderBuffer, DracoError, GeometryAttributeType, GeometryMetadata,
    PointAttribute, PointCloud, PointCloudDecoder,
};

use super::feature::{Column, Kind};
use super::{Points, is_read, most_decoded};

pub(super) const MAGIC: &[u8] = b"DRACO";

/// Prefix of attributes that spell the type of the feature whose name follows.
const TYPE_PREFIX: &str = "__dtype__";

/// Bit of the header's flags that says that metadata follow.
const METADATA: u16 = 0x8000;

/// Bytes of a position.
const POSITION_BYTES: u64 = 12;

/// Decodes a point cloud.
///
/// # Errors
/// Returns a description of the invalid content.
pub(super) fn decode(bytes: &[u8]) -> Result<Points, String> {
    let rows = declared_points(bytes)? as usize;
    let limits = DecodeLimits::default().with_max_points(rows as u64);
    let limits = limits.with_max_decoded_bytes(most_decoded(bytes));
    let mut cloud = PointCloud::new();
    let mut buffer = DecoderBuffer::new(bytes).with_limits(limits);
    PointCloudDecoder::new().decode(&mut buffer, &mut cloud).map_err(|e| damaged(&e))?;
    let mut points = Points { xyz: positions(&cloud, rows)?, ..Points::default() };
    let features = Features::of(&cloud);
    for (name, attribute) in &features.0 {
        if is_read(name) {
            let values = values(attribute, rows).ok_or_else(|| format!("a feature {name} without values"))?;
            points.extend_feature(name, &Column::new(features.kind(name, attribute)?, &values))?;
        } else if !name.starts_with(TYPE_PREFIX) {
            points.skipped.push((*name).to_owned());
        }
    }
    Ok(points)
}

/// Returns the number of points that a header declares.
///
/// # Errors
/// Returns a description of a header that is damaged or not of a point cloud, or of a number of points that
/// exceeds the limit of decoded bytes.
pub(super) fn declared_points(bytes: &[u8]) -> Result<u64, String> {
    let mut buffer = DecoderBuffer::new(bytes);
    check_header(&mut buffer)?;
    let points = skip_metadata(&mut buffer).and_then(|()| buffer.decode_u32()).map_err(|e| damaged(&e))?;
    if u64::from(points) * POSITION_BYTES > most_decoded(bytes) {
        return Err(format!("{points} points in a Draco cloud of {} bytes", bytes.len()));
    }
    Ok(points.into())
}

/// Reads the magic, the version and the kind of geometry.
fn check_header(buffer: &mut DecoderBuffer<'_>) -> Result<(), String> {
    let header = buffer.decode_slice(MAGIC.len() + 3).map_err(|e| damaged(&e))?;
    match header[MAGIC.len()..] {
        [2, minor @ 0..=3, 0] => {
            buffer.set_version(2, minor);
            Ok(())
        }
        [2, 0..=3, _] => Err("a Draco mesh".to_owned()),
        [major, minor, _] => Err(format!("Draco {major}.{minor}")),
        _ => Err("a damaged Draco cloud".to_owned()),
    }
}

/// Reads the method, the flags and the metadata, which the number of points follows.
fn skip_metadata(buffer: &mut DecoderBuffer<'_>) -> Result<(), DracoError> {
    let (_method, flags) = (buffer.decode_u8()?, buffer.decode_u16()?);
    match flags & METADATA {
        0 => Ok(()),
        _ => GeometryMetadata::decode(buffer).map(drop),
    }
}

fn damaged(error: &DracoError) -> String {
    format!("a damaged Draco cloud ({error})")
}

/// Returns the positions in the order of the points.
fn positions(cloud: &PointCloud, rows: usize) -> Result<Vec<[f32; 3]>, String> {
    let position =
        cloud.named_attribute(GeometryAttributeType::Position).ok_or("a Draco cloud without positions")?;
    let (kind, components) = (position.data_type(), position.num_components());
    if (kind, components) != (DataType::Float32, 3) {
        return Err(format!("positions of {components} {kind:?}"));
    }
    let bytes = values(position, rows).ok_or("positions without values")?;
    let floats: Vec<f32> = bytes.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
    Ok(floats.as_chunks::<3>().0.to_vec())
}

/// Returns the values of an attribute as bytes, in the order of the points.
fn values(attribute: &PointAttribute, rows: usize) -> Option<Vec<u8>> {
    let stride = usize::from(attribute.num_components()) * attribute.data_type().byte_length();
    let data = attribute.buffer().data();
    let Some(map) = attribute.explicit_mapping() else {
        return data.get(..rows.checked_mul(stride)?).map(<[u8]>::to_vec);
    };
    let value = |index: usize| data.get(index.checked_mul(stride)?..)?.get(..stride);
    map.iter().map(|index| value(index.0 as usize)).collect::<Option<Vec<_>>>().map(|values| values.concat())
}

/// Attributes with their names, in the order of the file.
struct Features<'a>(Vec<(&'a str, &'a PointAttribute)>);

impl<'a> Features<'a> {
    /// Positions have no name, and neither has an attribute that no feature of py123d is.
    fn of(cloud: &'a PointCloud) -> Self {
        let attributes = (0..cloud.num_attributes()).filter_map(|id| cloud.try_attribute(id).ok());
        let name = |attribute: &PointAttribute| {
            let metadata = cloud.attribute_metadata_by_unique_id(attribute.unique_id())?;
            str::from_utf8(metadata.metadata().get_raw("name")?).ok()
        };
        Self(attributes.filter_map(|attribute| Some((name(attribute)?, attribute))).collect())
    }

    /// Returns the type of a feature with one number per point.
    fn kind(&self, name: &str, attribute: &PointAttribute) -> Result<Kind, String> {
        let (stored, components) = (attribute.data_type(), attribute.num_components());
        let mut named = self.0.iter().filter(|(other, _)| other.strip_prefix(TYPE_PREFIX) == Some(name));
        let spelled = named.next().map(|(_, spelling)| spelled(spelling));
        let kind = spelled.unwrap_or_else(|| if components == 1 { kind(stored) } else { None });
        let stride = usize::from(components) * stored.byte_length();
        let kind = kind.filter(|kind| kind.bytes() == stride);
        if self.0.iter().filter(|(other, _)| *other == name).count() > 1 {
            return Err(format!("two features {name}"));
        }
        kind.ok_or_else(|| format!("a feature {name} of {components} {stored:?}"))
    }
}

fn kind(data_type: DataType) -> Option<Kind> {
    Some(match data_type {
        DataType::Uint8 | DataType::Bool => Kind::U8,
        DataType::Int8 => Kind::I8,
        DataType::Uint16 => Kind::U16,
        DataType::Int16 => Kind::I16,
        DataType::Uint32 => Kind::U32,
        DataType::Int32 => Kind::I32,
        DataType::Uint64 => Kind::U64,
        DataType::Int64 => Kind::I64,
        DataType::Float32 => Kind::F32,
        DataType::Float64 => Kind::F64,
        DataType::Invalid => return None,
    })
}

/// Returns the type that the first value of an attribute spells, as NumPy does.
fn spelled(attribute: &PointAttribute) -> Option<Kind> {
    let text = attribute.buffer().data();
    let text = text.get(..attribute.num_components().into())?;
    Some(match str::from_utf8(text).ok()?.trim_end_matches('\0') {
        "|u1" | "|b1" => Kind::U8,
        "|i1" => Kind::I8,
        "<u2" => Kind::U16,
        "<i2" => Kind::I16,
        "<u4" => Kind::U32,
        "<i4" => Kind::I32,
        "<u8" => Kind::U64,
        "<i8" => Kind::I64,
        "<f2" => Kind::F16,
        "<f4" => Kind::F32,
        "<f8" => Kind::F64,
        _ => return None,
    })
}

#[cfg(test)]
mod tests;
