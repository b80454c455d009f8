//! Vectors of six numbers: of a twist or a momentum.

pub(super) type Six = [f64; 6];

#[inline(always)]
pub(super) fn dot(a: &Six, b: &Six) -> f64 {
    // Two lanes.
    (a[0] * b[0] + a[2] * b[2] + a[4] * b[4]) + (a[1] * b[1] + a[3] * b[3] + a[5] * b[5])
}

#[inline(always)]
pub(super) fn add(to: &mut Six, gain: f64, from: &Six) {
    for (to, from) in to.iter_mut().zip(from) {
        *to += gain * from;
    }
}

#[inline(always)]
pub(super) fn sum(a: &Six, b: &Six) -> Six {
    let mut sum = *a;
    add(&mut sum, 1.0, b);
    sum
}
