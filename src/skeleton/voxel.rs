use glam::DVec3;

/// A colored point on its way into the skeleton.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ColoredPoint {
    /// Metres, relative to the cloud's origin.
    pub position: DVec3,
    /// Color.
    pub rgb: [u8; 3],
}

/// Merges the points of each voxel into one with their mean position and mean color, sorted by voxel (z fastest).
/// `voxel_m` of 0 keeps all points in their order. Positions may be up to 2²⁰ voxels from the origin.
pub fn merge_voxels(points: Vec<ColoredPoint>, voxel_m: f64) -> Vec<ColoredPoint> {
    if voxel_m <= 0.0 {
        return points;
    }
    let mut keyed: Vec<(u64, ColoredPoint)> =
        points.into_iter().map(|p| (voxel_key(p.position, voxel_m), p)).collect();
    // A stable sort keeps the order of points within a voxel, so that sums do not depend on anything else.
    keyed.sort_by_key(|(key, _)| *key);
    keyed.chunk_by(|a, b| a.0 == b.0).map(mean).collect()
}

fn mean(voxel: &[(u64, ColoredPoint)]) -> ColoredPoint {
    let count = voxel.len();
    let position = voxel.iter().map(|(_, p)| p.position).sum::<DVec3>() / count as f64;
    let channel = |c: usize| {
        let sum: usize = voxel.iter().map(|(_, p)| usize::from(p.rgb[c])).sum();
        ((sum + count / 2) / count) as u8
    };
    ColoredPoint { position, rgb: [channel(0), channel(1), channel(2)] }
}

/// 21 bits an axis.
fn voxel_key(position: DVec3, voxel_m: f64) -> u64 {
    let axis = |v: f64| ((v / voxel_m).floor() as i64 + (1 << 20)).clamp(0, (1 << 21) - 1) as u64;
    axis(position.x) << 42 | axis(position.y) << 21 | axis(position.z)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(x: f64, y: f64, z: f64, grey: u8) -> ColoredPoint {
        ColoredPoint { position: DVec3::new(x, y, z), rgb: [grey; 3] }
    }

    #[test]
    fn a_voxel_holds_the_mean_of_its_points() {
        let points = vec![
            point(0.001, 0.001, -0.001, 9),
            point(0.002, 0.001, 0.0, 10),
            point(0.004, 0.003, 0.002, 20),
        ];
        let merged = merge_voxels(points.clone(), 0.01);
        assert_eq!(merged.len(), 2);
        assert_eq!(merged[0], points[0]);
        assert_eq!(merged[1].rgb, [15; 3]);
        assert!((merged[1].position - DVec3::new(0.003, 0.002, 0.001)).length() < 1e-12);
        assert_eq!(merge_voxels(points.clone(), 0.0), points);
    }

    #[test]
    fn no_two_points_share_a_voxel() {
        let points: Vec<_> =
            (0..2000).map(|i| point(f64::from(i % 13) * 0.004, f64::from(i % 7) * 0.004, 0.0, 1)).collect();
        let merged = merge_voxels(points, 0.01);
        let mut keys: Vec<u64> = merged.iter().map(|p| voxel_key(p.position, 0.01)).collect();
        keys.dedup();
        assert_eq!(keys.len(), merged.len());
    }
}
