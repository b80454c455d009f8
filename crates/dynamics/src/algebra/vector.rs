//! Vectors of N numbers: of twists or momenta of one or several bodies.

pub(crate) type Vector<const N: usize> = [f64; N];
pub(crate) type Six = Vector<6>;

#[inline(always)]
pub(crate) fn dot<const N: usize>(a: &Vector<N>, b: &Vector<N>) -> f64 {
    // Two lanes.
    let mut lanes = [0.0; 2];
    for (index, (a, b)) in a.iter().zip(b).enumerate() {
        lanes[index & 1] += a * b;
    }
    lanes[0] + lanes[1]
}

#[inline(always)]
pub(crate) fn add<const N: usize>(to: &mut Vector<N>, gain: f64, from: &Vector<N>) {
    for (to, from) in to.iter_mut().zip(from) {
        *to += gain * from;
    }
}

#[inline(always)]
pub(crate) fn sum<const N: usize>(a: &Vector<N>, b: &Vector<N>) -> Vector<N> {
    let mut sum = *a;
    add(&mut sum, 1.0, b);
    sum
}

/// The identity matrix.
pub(crate) fn identity<const N: usize>() -> [Vector<N>; N] {
    std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j))))
}
