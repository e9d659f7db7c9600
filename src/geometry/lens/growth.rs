//! Polynomials on the range where they grow.

/// Evaluates a polynomial with coefficients in ascending order.
pub(super) fn value(coefficients: &[f64], x: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * x + c)
}

/// Returns the coefficients of the derivative.
pub(super) fn derivative(coefficients: &[f64]) -> Vec<f64> {
    (1_u32..).zip(coefficients.iter().skip(1)).map(|(power, c)| f64::from(power) * c).collect()
}

/// Returns the end of the range, from 0 up to `end`, within which a polynomial is positive; 0 if it is not
/// positive at 0.
pub(super) fn positive_until(coefficients: &[f64], end: f64) -> f64 {
    let mut inside = 0.0;
    if value(coefficients, inside) <= 0.0 {
        return inside;
    }
    // Between two extrema, a polynomial has at most one zero.
    for at in zeros(&derivative(coefficients), end).into_iter().chain([end]) {
        if value(coefficients, at) <= 0.0 {
            return bisected(coefficients, inside, at).0;
        }
        inside = at;
    }
    end
}

/// Returns the places between 0 and `end` where a polynomial changes its sign, in ascending order.
fn zeros(coefficients: &[f64], end: f64) -> Vec<f64> {
    if coefficients.len() < 2 {
        return Vec::new();
    }
    let mut ends = zeros(&derivative(coefficients), end);
    ends.insert(0, 0.0);
    ends.push(end);
    let is_positive = |x: f64| value(coefficients, x) > 0.0;
    let changes = ends.windows(2).filter(|pair| is_positive(pair[0]) != is_positive(pair[1]));
    changes.map(|pair| bisected(coefficients, pair[0], pair[1]).0).collect()
}

/// Returns neighboring numbers between which the sign changes; it differs between `low` and `high`.
fn bisected(coefficients: &[f64], mut low: f64, mut high: f64) -> (f64, f64) {
    let is_positive = |x: f64| value(coefficients, x) > 0.0;
    let is_low = is_positive(low);
    loop {
        let middle = f64::midpoint(low, high);
        if middle <= low || middle >= high {
            return (low, high);
        }
        if is_positive(middle) == is_low { low = middle } else { high = middle }
    }
}

/// Returns where a function that grows from 0 to `end` reaches a target: by Newton's method, with bisection
/// where a step leaves the range. `function` returns value and slope. `None` if the target is out of reach.
pub(super) fn inverse(target: f64, end: f64, function: impl Fn(f64) -> (f64, f64)) -> Option<f64> {
    const STEPS: u32 = 200;
    if !(function(0.0).0 <= target && target <= function(end).0) {
        return None;
    }
    let (mut low, mut high) = (0.0, end);
    let mut x = target.clamp(low, high);
    for _ in 0..STEPS {
        let (found, slope) = function(x);
        let step = (found - target) / slope;
        if found == target || step.abs() <= f64::EPSILON * x {
            break;
        }
        if found < target {
            low = x
        } else {
            high = x
        }
        let newton = x - step;
        x = if newton > low && newton < high { newton } else { f64::midpoint(low, high) };
    }
    Some(x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomials_are_positive_until_their_first_zero() {
        // (1 - x)(2 - x)(3 - x)(4 - x): at 5 it is positive again.
        let quartic = [24.0, -50.0, 35.0, -10.0, 1.0];
        assert!((positive_until(&quartic, 5.0) - 1.0).abs() < 1e-12);
        assert_eq!(positive_until(&quartic, 0.5), 0.5);
        // (1 - 4 x)(2 - 3 x), and a parabola between whose ends the sign changes twice.
        assert!((positive_until(&[2.0, -11.0, 12.0], 9.0) - 0.25).abs() < 1e-12);
        assert_eq!(
            [[1.0, 0.0], [0.0, 1.0], [-1.0, 1.0]].map(|line| positive_until(&line, 3.0)),
            [3.0, 0.0, 0.0]
        );
    }

    #[test]
    fn growing_functions_are_inverted() {
        let cubic = |x: f64| (x * x * x + 0.01 * x, 3.0 * x * x + 0.01);
        for target in [0.0, 1e-300, 1e-9, 0.3, 1.0, 8.02] {
            let found = inverse(target, 2.0, cubic).unwrap();
            assert!((cubic(found).0 - target).abs() <= 4.0 * f64::EPSILON * target, "{target}: {found}");
        }
        assert_eq!([-1e-9, 8.03, f64::NAN].map(|target| inverse(target, 2.0, cubic)), [None; 3]);
    }
}
