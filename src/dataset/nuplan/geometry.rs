//! Geometry columns of a GeoPackage: a header, then well-known binary in longitude and latitude.
//!
//! Format: <https://www.geopackage.org/spec/#gpb_format>.

use geozero::error::{GeozeroError, Result};
use geozero::wkb::process_gpkg_geom;
use geozero::{GeomProcessor, error};
use glam::DVec2;

use super::projection::Utm;
use crate::dataset::Area;

/// What lines and rings of a layer are made of.
pub(super) enum Shape {
    /// A polygon or several.
    Areas(Vec<Area>),
    /// A line or several.
    Lines(Vec<Vec<DVec2>>),
}

/// Coordinates of the header's system must be these: WGS 84.
const SRS_ID: i32 = 4326;

/// Decodes a geometry and takes it to a UTM zone; `None` if it is empty. Empty parts of it are left out.
///
/// # Errors
/// Anything but a line, polygon or several of them, truncated bytes, a ring of fewer than three corners, coordinates that
/// are no longitude and latitude; the message tells what was found.
pub(super) fn decode(bytes: &[u8], utm: &Utm) -> std::result::Result<Option<Shape>, String> {
    let mut collector = Collector { utm, areas: Vec::new(), lines: Vec::new(), rings: None };
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

/// Hears the parts of a geometry one after the other.
struct Collector<'a> {
    utm: &'a Utm,
    areas: Vec<Area>,
    /// The last is the one being read, whether ring or line.
    lines: Vec<Vec<DVec2>>,
    /// Within a polygon: its rings.
    rings: Option<Vec<Vec<DVec2>>>,
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
        let point = self.utm.project(DVec2::new(x, y));
        let point = point.ok_or_else(|| wrong(format!("longitude {x}, latitude {y}")))?;
        let line = self.lines.last_mut().ok_or_else(|| wrong("a point without a line"))?;
        line.push(point);
        Ok(())
    }

    // The declared lengths are not believed: bytes end before memory does.
    fn linestring_begin(&mut self, _: bool, _: usize, _: usize) -> Result<()> {
        self.lines.push(Vec::new());
        Ok(())
    }

    fn linestring_end(&mut self, _: bool, _: usize) -> Result<()> {
        let Some(rings) = &mut self.rings else {
            return match self.lines.last().map_or(0, Vec::len) {
                0 => {
                    self.lines.pop();
                    Ok(())
                }
                1 => Err(wrong("a line of 1 points")),
                _ => Ok(()),
            };
        };
        let mut ring = self.lines.pop().unwrap_or_default();
        if ring.len() > 1 && ring.first() == ring.last() {
            ring.pop();
        }
        if ring.len() < 3 {
            return Err(wrong(format!("a ring of {} corners", ring.len())));
        }
        rings.push(ring);
        Ok(())
    }

    fn polygon_begin(&mut self, _: bool, _: usize, _: usize) -> Result<()> {
        self.rings = Some(Vec::new());
        Ok(())
    }

    fn polygon_end(&mut self, _: bool, _: usize) -> Result<()> {
        let mut rings = self.rings.take().unwrap_or_default().into_iter();
        if let Some(exterior) = rings.next() {
            self.areas.push(Area { exterior, holes: rings.collect() });
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

    // Collections may nest without end, and curves are none of what is drawn.
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
