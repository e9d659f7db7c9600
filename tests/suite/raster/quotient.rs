//! Floors of quotients as the shaders compute them on devices that do not round divisions correctly.

use super::random::Random;

/// `floor_quotient` of glsl/common/quotient.wgsl and glsl/splat.vert, with the quotient that a device
/// returns.
fn floor_quotient(a: f32, b: f32, quotient: f32) -> f32 {
    let whole = quotient.round_ties_even();
    if whole == 0.0 || (quotient - whole).abs() > 1e-6 * quotient.abs() {
        return quotient.floor();
    }
    let high = |value: f32| f32::from_bits(value.to_bits() & 0xffff_f000);
    let (whole_high, b_high) = (high(whole), high(b));
    let (whole_low, b_low) = (whole - whole_high, b - b_high);
    let product = whole * b;
    let lost =
        ((whole_high * b_high - product) + whole_low * b_high + whole_high * b_low) + whole_low * b_low;
    let residual = (a - product) - lost;
    let downward = if whole > 0.0 { u32::MAX } else { 1 };
    let below = f32::from_bits(whole.to_bits().wrapping_add(downward));
    if residual > -0.5 * (whole - below) * b { whole } else { whole - 1.0 }
}

/// Returns the float `steps` places above a value, or below it if negative.
fn moved(value: f32, steps: i32) -> f32 {
    (0..steps.abs()).fold(value, |value, _| if steps > 0 { value.next_up() } else { value.next_down() })
}

/// Vulkan allows 2.5 units in the last place. The check can fail: without the correction some floors are
/// wrong.
#[test]
fn floors_of_quotients_are_exact_on_any_device() {
    let random = &mut Random(42);
    let mut uncorrected = 0;
    for _ in 0..300_000 {
        let [least, most] = [1e-5_f32, 1e5].map(|depth_m| u64::from(depth_m.to_bits()));
        let b = f32::from_bits((least + random.below(most - least)) as u32);
        let columns = 1 << random.below(20);
        let whole = random.below(columns) as f32 * if random.below(2) == 0 { 1.0 } else { -1.0 };
        let fraction = if random.below(4) == 0 { random.below(1000) as f32 / 1000.0 } else { 0.0 };
        let a = moved((whole + fraction) * b, random.below(7) as i32 - 3);
        let expected = (a / b).floor();
        for error in -3..=3 {
            // A quotient with another sign is farther off.
            let quotient = moved(a / b, error);
            if quotient.signum() == (a / b).signum() && quotient.is_normal() {
                assert_eq!(floor_quotient(a, b, quotient), expected, "{a:e} / {b:e}, {error}");
                uncorrected += usize::from(quotient.floor() != expected);
            }
        }
    }
    assert!(uncorrected > 10_000, "{uncorrected}");
}
