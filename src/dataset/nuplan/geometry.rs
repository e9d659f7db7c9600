//! Geometry columns of a GeoPackage: a header, then well-known binary (WKB) in longitude and latitude.

use geozero::error::{GeozeroError, Result};
use geozero::wkb::process_gpkg_geom;
use geozero::{GeomProcessor, error};
use glam::DVec2;

use super::projection::Utm;
use crate::dataset::Area;
use crate::dataset::recording::degenerate::{self, Fault};

/// Geometry of a feature.
pub(super) enum Shape {
    /// One or more polygons.
    Areas(Vec<Area>),
    /// One or more lines.
    Lines(Vec<Vec<DVec2>>),
}

/// Required coordinate system of the header: WGS 84.
const SRS_ID: i32 = 4326;

/// Decodes a geometry and projects it to a UTM zone. `None` if nothing is left: empty parts are skipped, and
/// those without an area or a length are skipped and passed to `faults`.
///
/// # Errors
/// Returns a description of the content if it is not lines or polygons, bytes are truncated, or coordinates
/// are not longitude and latitude.
pub(super) fn decode(
    bytes: &[u8],
    utm: &Utm,
    faults: &mut Vec<Fault>,
) -> std::result::Result<Option<Shape>, String> {
    let mut collector = Collector { utm, areas: Vec::new(), lines: Vec::new(), rings: None, faults };
    let mut rest = bytes;
    process_gpkg_geom(&mut rest, &mut collector).map_err(|e| e.to_string())?;
    if !rest.is_empty() {
        return Err(format!("{} bytes behind the geometry", rest.len()));
    }
    let Collector { areas, lines, .. } = collector;
    match (areas.is_empty(), lines.is_empty()) {
        (false, true) => Ok(Some(Shape::Areas(areas))),
        (true, false) => Ok(Some(Shape::Lines(lines))),
        (true, true) => Ok(None),
        (false, false) => Err("areas and lines".to_owned()),
    }
}

/// Collects the parts of a geometry from the parser's callbacks.
struct Collector<'a> {
    utm: &'a Utm,
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
            Some(SRS_ID) => Ok(()),
            other => Err(wrong(format!("srs_id {}", other.map_or("none".to_owned(), |id| id.to_string())))),
        }
    }

    fn xy(&mut self, x: f64, y: f64, _: usize) -> Result<()> {
        let place = DVec2::new(x, y);
        let point = if place.is_finite() { self.utm.project(place) } else { Some(place) };
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
