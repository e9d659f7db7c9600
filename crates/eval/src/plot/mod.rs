//! Line plots as SVG.

use std::io::Write;
use std::ops::Range;
use std::path::Path;

use plotters::prelude::{
    ChartBuilder, IntoDrawingArea, LineSeries, PathElement, RGBAColor, SVGBackend, SeriesLabelPosition, WHITE,
};
use plotters::style::{BLACK, Color};
use point_skeleton::error::FileError;
use point_skeleton::files::write_whole;

/// A line plot.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Plot<'a> {
    /// Title above the plot.
    pub title: &'a str,
    /// Names of the axes, x and y.
    pub axes: [&'a str; 2],
    /// Curves in the order of the legend.
    pub curves: Vec<Curve>,
}

/// A curve of a [`Plot`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curve {
    /// Name in the legend.
    pub name: String,
    /// Points (x, y); points that are not finite are skipped.
    pub points: Vec<[f64; 2]>,
    /// Whether the curve is drawn thin and pale, as background for the others.
    pub is_faint: bool,
}

const SIZE: (u32, u32) = (900, 480);
/// Line colors that are distinguishable with red-green color blindness, too. Source: Okabe and Ito, 2008.
const COLORS: [[u8; 3]; 7] =
    [[0, 114, 178], [213, 94, 0], [0, 158, 115], [204, 121, 167], [230, 159, 0], [86, 180, 233], [0, 0, 0]];

impl Plot<'_> {
    /// Writes the plot as SVG.
    ///
    /// # Errors
    /// Fails if the plot cannot be drawn, or if the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), FileError> {
        let drawn = self.svg().map_err(|error| FileError::io("draw", path)(std::io::Error::other(error)))?;
        write_whole(path, |out| out.write_all(drawn.as_bytes()).map_err(FileError::io("write", path)))
    }

    fn svg(&self) -> Result<String, String> {
        let mut text = String::new();
        self.draw(&mut text).map_err(|error| error.to_string())?;
        Ok(text)
    }

    fn draw(&self, text: &mut String) -> Result<(), Box<dyn std::error::Error>> {
        let area = SVGBackend::with_string(text, SIZE).into_drawing_area();
        area.fill(&WHITE)?;
        let [x, y] = [0, 1].map(|axis| self.range(axis));
        let mut chart = ChartBuilder::on(&area)
            .caption(self.title, ("sans-serif", 20))
            .margin(12)
            .x_label_area_size(42)
            .y_label_area_size(64)
            .build_cartesian_2d(x.clone(), y.clone())?;
        let light = BLACK.mix(0.08);
        chart.configure_mesh().light_line_style(light).x_desc(self.axes[0]).y_desc(self.axes[1]).draw()?;
        for (curve, rgb) in self.curves.iter().zip(COLORS.into_iter().cycle()) {
            let [r, g, b] = rgb;
            let color = RGBAColor(r, g, b, if curve.is_faint { 0.3 } else { 1.0 });
            let style = color.stroke_width(if curve.is_faint { 1 } else { 2 });
            let points = curve.finite().map(|[x, y]| (x, y));
            chart
                .draw_series(LineSeries::new(points, style))?
                .label(&curve.name)
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], style));
        }
        chart
            .configure_series_labels()
            .position(self.freest_corner(&x, &y))
            .background_style(WHITE.mix(0.8))
            .border_style(light)
            .draw()?;
        area.present()?;
        Ok(())
    }

    /// Returns the corner with the fewest points, for the legend.
    fn freest_corner(&self, x: &Range<f64>, y: &Range<f64>) -> SeriesLabelPosition {
        let share = |value: f64, range: &Range<f64>| (value - range.start) / (range.end - range.start);
        let points = || self.curves.iter().flat_map(Curve::finite);
        let within = |(right, upper): (bool, bool)| {
            let near = |value: f64, far_end: bool| if far_end { value > 0.5 } else { value < 0.5 };
            points().filter(|p| near(share(p[0], x), right) && near(share(p[1], y), upper)).count()
        };
        let corners = [
            ((true, true), SeriesLabelPosition::UpperRight),
            ((false, false), SeriesLabelPosition::LowerLeft),
            ((true, false), SeriesLabelPosition::LowerRight),
            ((false, true), SeriesLabelPosition::UpperLeft),
        ];
        let freest = corners.into_iter().min_by_key(|(corner, _)| within(*corner));
        freest.map_or(SeriesLabelPosition::UpperRight, |(_, position)| position)
    }

    /// Returns the value range of an axis, with a margin in y.
    fn range(&self, axis: usize) -> Range<f64> {
        let values = || self.curves.iter().flat_map(Curve::finite).map(|point| point[axis]);
        let (low, high) =
            (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max));
        if low > high {
            return 0.0..1.0;
        }
        let room = if axis == 0 { 0.0 } else { 0.05 * (high - low) };
        let least = (low.abs().max(high.abs()) * 1e-6).max(1e-9);
        low - room..(high + room).max(low + least)
    }
}

impl Curve {
    fn finite(&self) -> impl Iterator<Item = [f64; 2]> {
        self.points.iter().copied().filter(|point| point.iter().all(|value| value.is_finite()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn svg_has_named_curves_and_is_deterministic() {
        let curve = |name: &str, points: &[[f64; 2]], is_faint| Curve {
            name: name.to_owned(),
            points: points.to_vec(),
            is_faint,
        };
        let plot = Plot {
            title: "a < b",
            axes: ["step", "loss"],
            curves: vec![
                curve("each step", &[[0.0, 3.0], [1.0, f64::NAN], [2.0, 1.0]], true),
                curve("mean", &[[0.0, 2.5], [2.0, 1.5]], false),
            ],
        };
        let svg = plot.svg().unwrap();
        assert_eq!(svg, plot.svg().unwrap());
        for expected in ["a &lt; b", "each step", "mean", "loss"] {
            assert!(svg.contains(expected), "{expected} in {svg}");
        }
        assert!(svg.matches("<polyline").count() >= 4, "axes, two curves and a legend: {svg}");
        assert!(!svg.contains("NaN"), "{svg}");
        assert_eq!(plot.range(0), 0.0..2.0);
        assert_eq!(plot.range(1), 0.9..3.1);
        // The legend is in the corner without curves.
        let corner = |points: &[[f64; 2]]| {
            let plot = Plot { curves: vec![curve("c", points, false)], ..Plot::default() };
            format!("{:?}", plot.freest_corner(&plot.range(0), &plot.range(1)))
        };
        assert_eq!(corner(&[[0.0, 1.0], [1.0, 0.0]]), "UpperRight");
        assert_eq!(corner(&[[0.0, 0.1], [0.9, 1.0], [1.0, 0.0]]), "UpperLeft");
        // Empty plots and single points are drawn, too.
        assert!(Plot::default().svg().is_ok());
        assert!(Plot { curves: vec![curve("one", &[[1.0, 5.0]], false)], ..plot }.svg().is_ok());
    }
}
