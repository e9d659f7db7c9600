use glam::DVec2;

use super::cells::Cells;
use super::draw::Draw;
use super::ground::flat;
use super::line::Line;
use super::street_strips::StreetStrips;
use super::style::Style;
use crate::mesh::{Skin, Surface};
use crate::plan::{LaneKind, Network, Road};

/// Height of paint, and of covers and patches, above the road, meters.
const PAINT_M: f64 = 0.006;
const COVER_M: f64 = 0.003;
const WHITE: [u8; 3] = [226, 226, 220];
/// Width of lines, meters.
const LINE_M: f64 = 0.13;

/// Adds lines, parking bays, crossings, arrows, covers and patches to the roads.
pub(super) fn paint(strips: &StreetStrips, style: &Style, cells: &mut Cells) {
    for (i, (road, line)) in strips.network.roads.iter().zip(&strips.lines).enumerate() {
        let Some(line) = line else { continue };
        let brush = Brush { network: strips.network, road: i, line };
        brush.lines(road, style, cells);
        brush.covers(road, style, cells);
    }
    stop_lines(strips.network, cells);
    crossings(strips, cells);
    for (i, lane) in strips.network.lanes.iter().enumerate() {
        if let LaneKind::Road(road) = lane.kind
            && strips.network.roads.get(road).is_some_and(|road| road.lanes_each_way > 1)
        {
            arrow(strips.network, i, cells);
        }
    }
}

/// Painter of one road.
struct Brush<'a> {
    network: &'a Network,
    road: usize,
    line: &'a Line,
}

impl Brush<'_> {
    fn lines(&self, road: &Road, style: &Style, cells: &mut Cells) {
        let mut draw = Draw::new(style.seed, &[0x6c1e, self.road as i64]);
        let lanes_m = road.lanes_each_way as f64 * road.lane_width_m;
        if road.lanes_each_way > 1 {
            for side in [-0.11, 0.11] {
                self.stroke(side, [1e9, 0.0], style.middle_line, cells);
            }
        } else if draw.chance(0.75) {
            self.stroke(0.0, draw.pick(&[[3.0, 4.0], [1e9, 0.0], [4.0, 2.0]]), style.middle_line, cells);
        }
        for k in 1..road.lanes_each_way {
            for side in [-1.0, 1.0] {
                self.stroke(side * k as f64 * road.lane_width_m, [3.0, 5.0], WHITE, cells);
            }
        }
        for (parking, side) in road.parking_m.into_iter().zip([1.0, -1.0]) {
            let edge = side * lanes_m;
            if parking > 1.0 {
                self.stroke(edge, [1e9, 0.0], WHITE, cells);
                self.bays(edge, side * parking, cells);
            } else if road.lanes_each_way > 1 {
                self.stroke(edge - side * 0.2, [1e9, 0.0], WHITE, cells);
            }
        }
    }

    /// Adds a line along the road with strokes and gaps of the given lengths.
    fn stroke(&self, left_m: f64, [stroke_m, gap_m]: [f64; 2], rgb: [u8; 3], cells: &mut Cells) {
        let mut at = 0.3;
        while at < self.line.length() - 0.3 {
            // Continuous lines are drawn in pieces of at most 2 m, which follow bends and end at crossings.
            let end = (at + stroke_m.min(2.0)).min(self.line.length());
            let next = self.line.stations().iter().copied().find(|s| *s > at + 0.05).unwrap_or(end);
            let long = stroke_m > 100.0;
            let end = if long { end } else { (at + stroke_m).min(self.line.length()) };
            self.rectangle([at, end], [left_m - LINE_M / 2.0, left_m + LINE_M / 2.0], next, rgb, cells);
            at = end + gap_m;
        }
    }

    /// Adds strokes across the parking strip, 6 m apart.
    fn bays(&self, from_m: f64, across_m: f64, cells: &mut Cells) {
        let count = ((self.line.length() - 16.0) / 6.0).floor();
        let start = (self.line.length() - 6.0 * count) / 2.0;
        for k in 0..=count.max(-1.0) as i64 {
            let s = start + 6.0 * k as f64;
            let (low, high) = (from_m.min(from_m + across_m), from_m.max(from_m + across_m));
            self.rectangle([s - 0.05, s + 0.05], [low, high], s, WHITE, cells);
        }
    }

    /// Adds a painted rectangle with at most one bend; skips it on crossings.
    fn rectangle(&self, s: [f64; 2], left: [f64; 2], bend: f64, rgb: [u8; 3], cells: &mut Cells) {
        let middle = self.line.point((s[0] + s[1]) / 2.0, (left[0] + left[1]) / 2.0);
        if self
            .network
            .crossings
            .iter()
            .any(|crossing| crossing.road == self.road && inside(crossing, middle))
        {
            return;
        }
        let bend = bend.clamp(s[0], s[1]);
        for piece in [[s[0], bend], [bend, s[1]]] {
            if piece[1] - piece[0] > 0.01 {
                let corner = |s: f64, left: f64| self.line.point(s, left);
                let [a, b] = piece;
                let corners =
                    [corner(a, left[0]), corner(b, left[0]), corner(b, left[1]), corner(a, left[1])];
                flat(cells.near(middle), &corners, PAINT_M, Skin::new(rgb, Surface::Paint));
            }
        }
    }

    /// Adds manhole covers, gullies at the kerbs, and asphalt patches.
    fn covers(&self, road: &Road, style: &Style, cells: &mut Cells) {
        let mut draw = Draw::new(style.seed, &[0xc04e, self.road as i64]);
        let mut at = draw.between(6.0, 25.0);
        while at < self.line.length() - 6.0 {
            let lane = draw.between(-0.8, 0.8) * (road.half_width_m - 2.5).max(0.5);
            let centre = self.line.point(at, lane);
            let along = self.line.direction(at);
            if draw.chance(0.55) {
                let corner = |i: usize| {
                    centre + 0.36 * DVec2::from_angle(std::f64::consts::TAU * i as f64 / 12.0).rotate(along)
                };
                let corners: Vec<DVec2> = (0..12).map(corner).collect();
                flat(cells.near(centre), &corners, COVER_M, Skin::new([82, 80, 78], Surface::Metal));
            } else {
                let (a, b) = (along * draw.between(0.6, 1.8), along.perp() * draw.between(0.4, 0.9));
                let rgb = draw.shade(style.asphalt.map(|c| c.saturating_sub(14)), 0.08);
                let corners = [centre - a - b, centre + a - b, centre + a + b, centre - a + b];
                flat(cells.near(centre), &corners, COVER_M, Skin::new(rgb, Surface::Asphalt));
            }
            for side in [-1.0, 1.0] {
                let edge = self.line.point(at + 7.0 * side, side * (road.half_width_m - 0.25));
                let (a, b) = (along * 0.25, along.perp() * 0.18);
                let corners = [edge - a - b, edge + a - b, edge + a + b, edge - a + b];
                if (0.5..self.line.length() - 0.5).contains(&(at + 7.0 * side)) {
                    flat(cells.near(edge), &corners, COVER_M, Skin::new([58, 58, 58], Surface::Metal));
                }
            }
            at += draw.between(16.0, 40.0);
        }
    }
}

/// Returns whether a position is on a crossing or within 0.3 m of it.
fn inside(crossing: &crate::plan::Crossing, place: DVec2) -> bool {
    (0..4).all(|i| {
        let (a, b) = (crossing.outline[i], crossing.outline[(i + 1) % 4]);
        (b - a).normalize_or_zero().perp_dot(place - a) > -0.3
    })
}

fn stop_lines(network: &Network, cells: &mut Cells) {
    for ([a, b], _) in &network.stop_lines {
        let half = (*b - *a).normalize_or_zero().perp() * 0.2;
        let corners = [*a - half, *b - half, *b + half, *a + half];
        flat(cells.near((*a + *b) / 2.0), &corners, PAINT_M, Skin::new(WHITE, Surface::Paint));
    }
}

/// Adds the stripes of zebra crossings, parallel to the road, from kerb to kerb.
fn crossings(strips: &StreetStrips, cells: &mut Cells) {
    for crossing in &strips.network.crossings {
        let (Some(road), Some(Some(line))) =
            (strips.network.roads.get(crossing.road), strips.lines.get(crossing.road))
        else {
            continue;
        };
        let [from, to] = crossing.path;
        let across = (to - from).normalize_or(DVec2::X);
        let along = across.perp();
        let middle = crossing.outline.iter().sum::<DVec2>() / 4.0;
        let half = crossing.outline.iter().map(|p| (*p - middle).dot(along).abs()).fold(0.0, f64::max);
        let reach = crossing.outline.iter().map(|p| (*p - middle).dot(across).abs()).fold(0.0, f64::max);
        let count = (reach / 0.5).floor() as i64;
        for k in (-count..=count).filter(|k| k % 2 == 0) {
            let centre = middle + across * (0.5 * k as f64);
            let (a, b) = (across * 0.25, along * half);
            let corners = [centre - a - b, centre + a - b, centre + a + b, centre - a + b];
            if line.locate(centre)[1].abs() < road.half_width_m - 0.35 {
                flat(cells.near(centre), &corners, PAINT_M, Skin::new(WHITE, Surface::Paint));
            }
        }
    }
}

/// Adds arrows for the permitted turns before the end of a lane.
fn arrow(network: &Network, lane: usize, cells: &mut Cells) {
    let lane = &network.lanes[lane];
    let Some(line) = Line::new(&lane.centerline) else { return };
    if line.length() < 30.0 {
        return;
    }
    let mut turns = [false; 3];
    for next in lane.successors.iter().filter_map(|next| network.lanes.get(*next)) {
        if let Some(next) = Line::new(&next.centerline) {
            let turn = next.direction(0.0).angle_to(next.direction(next.length()));
            turns[if turn > 0.5 {
                0
            } else if turn < -0.5 {
                2
            } else {
                1
            }] = true;
        }
    }
    let tail = line.length() - 16.0;
    let (ahead, left) = (line.direction(tail), line.direction(tail).perp());
    let start = line.point(tail, 0.0);
    let mesh = cells.near(start);
    let mut add = |corners: &[[f64; 2]]| {
        let mut corners: Vec<DVec2> = corners.iter().map(|[x, y]| start + ahead * *x + left * *y).collect();
        if super::street_strips::area_twice(&corners) < 0.0 {
            corners.reverse();
        }
        flat(mesh, &corners, PAINT_M, Skin::new(WHITE, Surface::Paint));
    };
    if turns != [false; 3] {
        add(&[[0.0, -0.08], [2.2, -0.08], [2.2, 0.08], [0.0, 0.08]]);
    }
    if turns[1] {
        add(&[[2.2, -0.08], [3.4, -0.08], [3.4, 0.08], [2.2, 0.08]]);
        add(&[[3.4, -0.3], [5.0, 0.0], [3.4, 0.3]]);
    }
    for (go, side) in [(turns[0], 1.0), (turns[2], -1.0)] {
        if go {
            add(&[[1.7, 0.08 * side], [2.2, 0.08 * side], [2.75, 0.6 * side], [2.45, 0.7 * side]]);
            add(&[[2.95, 0.35 * side], [2.2, 0.9 * side], [3.1, 1.25 * side]]);
        }
    }
}
