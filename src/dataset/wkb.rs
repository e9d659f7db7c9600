//! Geometries in well-known binary (WKB), alone or behind the header of a GeoPackage.

use geozero::error::{GeozeroError, Result};
use geozero::wkb::{process_ewkb_geom, process_gpkg_geom, process_wkb_geom};
use geozero::{GeomProcessor, error};
use glam::DVec2;

use crate::dataset::Area;
use crate::dataset::recording::degenerate::{self, Fault};

/// Geometry of a feature.
pub(in crate::dataset) enum Shape {
    /// One or more polygons.
    Areas(Vec<Area>),
    /// One or more lines.
    Lines(Vec<Vec<DVec2>>),
}

/// Required coordinate system of a GeoPackage's header: WGS 84.
const SRS_ID: i32 = 4326;

/// Flags of EWKB in the type of a geometry, as PostGIS and GEOS write them: z, m, coordinate system.
const EWKB_FLAGS: u8 = 0xe0;

/// Decodes a geometry of a GeoPackage in longitude and latitude, and projects its points. `None` if nothing
/// is left: empty parts are skipped, and those without an area or a length are skipped and passed to
/// `faults`.
///
/// # Errors
/// Returns a description of the content if it is not lines or polygons, bytes are truncated, or coordinates
/// are not longitude and latitude.
#[cfg(feature = "nuplan")]
pub(in crate::dataset) fn decode_gpkg(
    bytes: &[u8],
    project: &dyn Fn(DVec2) -> Option<DVec2>,
    faults: &mut Vec<Fault>,
) -> std::result::Result<Option<Shape>, String> {
    let mut collector = Collector::new(Some(SRS_ID), project, faults);
    let mut rest = bytes;
    process_gpkg_geom(&mut rest, &mut collector).map_err(|e| e.to_string())?;
    collector.finish(rest)
}

/// Decodes a geometry in meters, with or without heights, as [`decode_gpkg`] but without a projection.
///
/// # Errors
/// Returns a description of the content if it is not lines or polygons, or bytes are truncated.
#[cfg(feature = "123d")]
pub(in crate::dataset) fn decode_wkb(
    bytes: &[u8],
    faults: &mut Vec<Fault>,
) -> std::result::Result<Option<Shape>, String> {
    let mut collector = Collector::new(None, &Some, faults);
    let mut rest = bytes;
    // The type is the second field, in the byte order of the first.
    let kind = if bytes.first() == Some(&1) { bytes.get(4) } else { bytes.get(1) };
    let decoded = match kind {
        Some(kind) if kind & EWKB_FLAGS != 0 => process_ewkb_geom(&mut rest, &mut collector),
        _ => process_wkb_geom(&mut rest, &mut collector),
    };
    decoded.map_err(|e| e.to_string())?;
    collector.finish(rest)
}

impl<'a> Collector<'a> {
    fn new(
        srs_id: Option<i32>,
        project: &'a dyn Fn(DVec2) -> Option<DVec2>,
        faults: &'a mut Vec<Fault>,
    ) -> Self {
        Self { srs_id, project, areas: Vec::new(), lines: Vec::new(), rings: None, faults }
    }

    fn finish(self, rest: &[u8]) -> std::result::Result<Option<Shape>, String> {
        if !rest.is_empty() {
            return Err(format!("{} bytes behind the geometry", rest.len()));
        }
        let Collector { areas, lines, .. } = self;
        match (areas.is_empty(), lines.is_empty()) {
            (false, true) => Ok(Some(Shape::Areas(areas))),
            (true, false) => Ok(Some(Shape::Lines(lines))),
            (true, true) => Ok(None),
            (false, false) => Err("areas and lines".to_owned()),
        }
    }
}

/// Collects the parts of a geometry from the parser's callbacks.
struct Collector<'a> {
    /// Required coordinate system; `None` if there is none.
    srs_id: Option<i32>,
    project: &'a dyn Fn(DVec2) -> Option<DVec2>,
    areas: Vec<Area>,
    /// The last entry is the ring or line being read.
    lines: Vec<Vec<DVec2>>,
    /// Rings of the polygon being read; those without an area are `None`.
    rings: Option<Vec<Option<Vec<DVec2>>>>,
    faults: &'a mut Vec<Fault>,
}

fn wrong(text: impl Into<String>) -> GeozeroError {
    error::GeozeroError::Geometry(text.into())
}

impl GeomProcessor for Collector<'_> {
    fn srid(&mut self, srid: Option<i32>) -> Result<()> {
        match srid {
            found if found == self.srs_id => Ok(()),
            other => Err(wrong(format!("srs_id {}", other.map_or("none".to_owned(), |id| id.to_string())))),
        }
    }

    fn xy(&mut self, x: f64, y: f64, _: usize) -> Result<()> {
        let place = DVec2::new(x, y);
        let point = if place.is_finite() { (self.project)(place) } else { Some(place) };
        let point = point.ok_or_else(|| wrong(format!("longitude {x}, latitude {y}")))?;
        let line = self.lines.last_mut().ok_or_else(|| wrong("a point without a line"))?;
        line.push(point);
        Ok(())
    }

    // Declared lengths are not trusted for allocation; the input limits the number of points.
    fn linestring_begin(&mut self, _: bool, _: usize, _: usize) -> Result<()> {
        self.lines.push(Vec::new());
        Ok(())
    }

    fn linestring_end(&mut self, _: bool, _: usize) -> Result<()> {
        let line = self.lines.pop().unwrap_or_default();
        match &mut self.rings {
            Some(rings) => {
                let ring = degenerate::ring(line);
                self.faults.extend(ring.as_ref().err());
                rings.push(ring.ok());
            }
            None if line.is_empty() => {}
            None => match degenerate::line(line) {
                Ok(line) => self.lines.push(line),
                Err(fault) => self.faults.push(fault),
            },
        }
        Ok(())
    }

    fn polygon_begin(&mut self, _: bool, _: usize, _: usize) -> Result<()> {
        self.rings = Some(Vec::new());
        Ok(())
    }

    fn polygon_end(&mut self, _: bool, _: usize) -> Result<()> {
        let mut rings = self.rings.take().unwrap_or_default().into_iter();
        if let Some(Some(exterior)) = rings.next() {
            self.areas.push(Area { exterior, holes: rings.flatten().collect() });
        }
        Ok(())
    }

    fn point_begin(&mut self, _: usize) -> Result<()> {
        Err(wrong("a point"))
    }

    fn empty_point(&mut self, _: usize) -> Result<()> {
        Err(wrong("an empty point"))
    }

    fn multipoint_begin(&mut self, _: usize, _: usize) -> Result<()> {
        Err(wrong("points"))
    }

    // Collections may nest without limit, and curves are not supported.
    fn geometrycollection_begin(&mut self, _: usize, _: usize) -> Result<()> {
        Err(wrong("a geometry collection"))
    }

    fn circularstring_begin(&mut self, _: usize, _: usize) -> Result<()> {
        Err(wrong("a curve"))
    }

    fn compoundcurve_begin(&mut self, _: usize, _: usize) -> Result<()> {
        Err(wrong("a curve"))
    }

    fn curvepolygon_begin(&mut self, _: usize, _: usize) -> Result<()> {
        Err(wrong("a polygon of curves"))
    }

    fn multicurve_begin(&mut self, _: usize, _: usize) -> Result<()> {
        Err(wrong("curves"))
    }

    fn multisurface_begin(&mut self, _: usize, _: usize) -> Result<()> {
        Err(wrong("surfaces"))
    }

    fn triangle_begin(&mut self, _: bool, _: usize, _: usize) -> Result<()> {
        Err(wrong("a triangle"))
    }

    fn polyhedralsurface_begin(&mut self, _: usize, _: usize) -> Result<()> {
        Err(wrong("a surface"))
    }

    fn tin_begin(&mut self, _: usize, _: usize) -> Result<()> {
        Err(wrong("triangles"))
    }
}
