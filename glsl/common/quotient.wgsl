// Returns `floor(a / b)` as a processor computes it, that is with a correctly rounded quotient. `b` must be positive,
// and the quotient of a pixel: within 2^20.
// Vulkan allows a division to be off by 2.5 units in the last place. That matters next to whole numbers only, where
// the sign of an exact residual decides.
fn floor_quotient(a: f32, b: f32) -> f32 {
    let quotient = a / b;
    let whole = round(quotient);
    if whole == 0.0 || abs(quotient - whole) > 1e-6 * abs(quotient) {
        return floor(quotient);
    }
    // The product of the whole number and `b`, and what its rounding lost: halves of 12 bits multiply exactly.
    let whole_high = bitcast<f32>(bitcast<u32>(whole) & 0xfffff000u);
    let whole_low = whole - whole_high;
    let b_high = bitcast<f32>(bitcast<u32>(b) & 0xfffff000u);
    let b_low = b - b_high;
    let product = whole * b;
    let lost = ((whole_high * b_high - product) + whole_low * b_high + whole_high * b_low) + whole_low * b_low;
    let residual = (a - product) - lost;
    // The quotient rounds to the whole number from half of the distance to the float below it. No quotient of floats
    // lies exactly halfway.
    let downward = select(1u, 0xffffffffu, whole > 0.0);
    let below = bitcast<f32>(bitcast<u32>(whole) + downward);
    return select(whole - 1.0, whole, residual > -0.5 * (whole - below) * b);
}
