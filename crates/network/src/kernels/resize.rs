use rayon::prelude::*;

/// Halving and doubling of images `[N, H, W, C]`; H and W belong to the larger image, and are even.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct Resize {
    pub(in super::super) height: usize,
    pub(in super::super) width: usize,
    pub(in super::super) channels: usize,
}

impl Resize {
    /// Returns the means of 2x2 pixels, `[N, H / 2, W / 2, C]`.
    pub(in super::super) fn downsample(&self, x: &[f32]) -> Vec<f32> {
        let Self { height, width, channels: c } = *self;
        let mut out = vec![0.0_f32; x.len() / 4];
        let images = out.par_chunks_mut(height * width / 4 * c).zip(x.par_chunks(height * width * c));
        images.for_each(|(out, image)| {
            for (y, out) in out.chunks_mut(width / 2 * c).enumerate() {
                let rows = &image[2 * y * width * c..][..2 * width * c];
                let (upper, lower) = rows.split_at(width * c);
                for (x, out) in out.chunks_mut(c).enumerate() {
                    let (a, b) = (&upper[2 * x * c..][..2 * c], &lower[2 * x * c..][..2 * c]);
                    for j in 0..c {
                        out[j] = 0.25 * ((a[j] + a[c + j]) + (b[j] + b[c + j]));
                    }
                }
            }
        });
        out
    }

    /// Returns the image at twice the size, `[N, H, W, C]` of `[N, H / 2, W / 2, C]`: bilinear, with repeated
    /// borders.
    pub(in super::super) fn upsample(&self, x: &[f32]) -> Vec<f32> {
        let Self { height, width, channels: c } = *self;
        let (low, across) = (height / 2, width / 2);
        let mut out = vec![0.0_f32; x.len() * 4];
        let images = out.par_chunks_mut(height * width * c).zip(x.par_chunks(low * across * c));
        images.for_each(|(out, image)| {
            for (y, out) in out.chunks_mut(width * c).enumerate() {
                let [(near, near_share), (far, far_share)] = neighbors(y, low);
                let [near, far] = [near, far].map(|y| &image[y * across * c..][..across * c]);
                for (x, out) in out.chunks_mut(c).enumerate() {
                    let [(left, left_share), (right, right_share)] = neighbors(x, across);
                    for j in 0..c {
                        let mixed =
                            |row: &[f32]| left_share * row[left * c + j] + right_share * row[right * c + j];
                        out[j] = near_share * mixed(near) + far_share * mixed(far);
                    }
                }
            }
        });
        out
    }
}

/// Returns a pixel's two neighbors in the doubled line, within a line of `count` pixels, and their
/// shares: the nearer and the other one.
pub(in super::super) fn neighbors(place: usize, count: usize) -> [(usize, f32); 2] {
    let nearer = place / 2;
    let other = if place.is_multiple_of(2) { nearer.saturating_sub(1) } else { (nearer + 1).min(count - 1) };
    [(nearer, 0.75), (other, 0.25)]
}
