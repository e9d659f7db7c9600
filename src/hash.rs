//! Pseudo-random numbers that depend only on a seed and integer keys.

/// Mixes a seed and integers into 64 well-distributed bits (splitmix64 steps).
pub fn hash(seed: u64, parts: &[i64]) -> u64 {
    let mut state = mix(seed.wrapping_add(0x9e37_79b9_7f4a_7c15));
    for &part in parts {
        state = mix(state ^ (part as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    }
    state
}

fn mix(mut x: u64) -> u64 {
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// Returns a uniform value in `[0, 1)`.
pub fn unit(seed: u64, parts: &[i64]) -> f64 {
    (hash(seed, parts) >> 11) as f64 / (1u64 << 53) as f64
}

/// Returns a uniform value in `[low, high)`.
pub fn between(seed: u64, parts: &[i64], low: f64, high: f64) -> f64 {
    low + (high - low) * unit(seed, parts)
}

/// Returns smooth noise in `[0, 1)` with features of length 1.
pub fn noise(seed: u64, x: f64, y: f64) -> f64 {
    let (x0, y0) = (x.floor(), y.floor());
    let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
    let (u, v) = (smooth(x - x0), smooth(y - y0));
    let corner = |i: i64, j: i64| unit(seed, &[x0 as i64 + i, y0 as i64 + j]);
    let low = corner(0, 0) * (1.0 - u) + corner(1, 0) * u;
    let high = corner(0, 1) * (1.0 - u) + corner(1, 1) * u;
    low * (1.0 - v) + high * v
}
