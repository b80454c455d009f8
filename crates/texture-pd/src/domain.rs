//! The part of its grid that a contact looks at.

use glam::{DMat3, DVec3};

use crate::kernels::{Clips, MAX_CLIPS};

/// Points this close to each other across **n** are not told apart, m.
const SAME: f64 = 1e-6;

/// Directions whose part across **n** is so small lie along it.
const ALONG: f64 = 1e-9;

/// The points p with direction · (p − through) ≤ 0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HalfSpace {
    /// A point of its border, world, m.
    pub through: DVec3,
    /// Out of it, world axes, of any length.
    pub direction: DVec3,
}

/// The domain of a [`TextureContact`](crate::TextureContact), where it looks for overlaps: what of its grid lies, as seen along
/// **n**, in each of a few half-spaces. Contacts side by side see the same place twice, unless each has
/// [its own domain](Self::nearest).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Domain {
    half_spaces: [HalfSpace; MAX_CLIPS],
    count: usize,
}

impl Domain {
    /// The whole grid.
    pub const WHOLE: Self = Self {
        half_spaces: [HalfSpace { through: DVec3::ZERO, direction: DVec3::ZERO }; MAX_CLIPS],
        count: 0,
    };
    /// Half-spaces of a domain, at most.
    pub const MOST: usize = MAX_CLIPS;

    /// What is nearer to `point` than to any of `others` as seen along `normal` (unit): its Voronoi cell, all in world
    /// coordinates. Only the nearest [`MOST`](Self::MOST) of the others count, and those at the same place, within 1 µm, do
    /// not.
    pub fn nearest(point: DVec3, others: impl IntoIterator<Item = DVec3>, normal: DVec3) -> Self {
        let mut domain = Self::WHOLE;
        for other in others {
            let direction = (other - point).reject_from_normalized(normal);
            let distance = direction.length_squared();
            if !direction.is_finite() || distance < SAME * SAME {
                continue;
            }
            let nearer = |known: &&HalfSpace| known.direction.length_squared() <= distance;
            let rank = domain.half_spaces().iter().take_while(nearer).count();
            if rank < Self::MOST {
                domain.count = Self::MOST.min(domain.count + 1);
                domain.half_spaces[rank..domain.count].rotate_right(1);
                domain.half_spaces[rank] = HalfSpace { through: point + 0.5 * direction, direction };
            }
        }
        domain
    }

    /// Keeps only what is in a half-space too. False, and nothing changes, where there are [`MOST`](Self::MOST) already.
    #[must_use]
    pub fn cut(&mut self, half_space: HalfSpace) -> bool {
        let free = self.half_spaces.get_mut(self.count);
        self.count += usize::from(free.is_some());
        free.map(|free| *free = half_space).is_some()
    }

    /// The half-spaces.
    pub fn half_spaces(&self) -> &[HalfSpace] {
        &self.half_spaces[..self.count]
    }

    pub(crate) fn is_finite(&self) -> bool {
        self.half_spaces().iter().all(|half| half.through.is_finite() && half.direction.is_finite())
    }

    /// Seen along n, in the frame with those axes at `origin`. Half-spaces along n cut nothing.
    pub(crate) fn clips(&self, axes: &DMat3, origin: DVec3) -> Clips {
        let mut clips = Clips::default();
        let to_axes = axes.transpose();
        for half in self.half_spaces() {
            let across = (to_axes * half.direction.normalize_or_zero()).truncate();
            let length = across.length();
            if length > ALONG {
                let [u, v] = (across / length).to_array();
                let [x, y] = (to_axes * (half.through - origin)).truncate().to_array();
                clips.push([u as f32, v as f32, (u * x + v * y) as f32]);
            }
        }
        clips
    }
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec2};
    use rand::rngs::StdRng;
    use rand::{RngExt as _, SeedableRng as _};

    use super::*;

    const GRID: u32 = 20;

    /// Where the middle of a texel is, in the contact's frame, m.
    fn place(texel: u32, half: f64) -> DVec2 {
        let at = |index: u32| ((f64::from(index) + 0.5) / f64::from(GRID) * 2.0 - 1.0) * half;
        DVec2::new(at(texel % GRID), at(texel / GRID))
    }

    #[test]
    fn nearest_is_the_voronoi_cell_seen_along_the_normal() {
        let seed = 31;
        let mut rng = StdRng::seed_from_u64(seed);
        let (mut inside, mut all) = (0, 0);
        for case in 0..200 {
            let mut vector = || DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
            let axes = DMat3::from_quat(DQuat::from_scaled_axis(vector()));
            let point = vector();
            let mut others: Vec<_> = (0..case % 10).map(|_| point + 0.01 * vector()).collect();
            // At the same place, but for where along the normal.
            others.push(point + 0.01 * axes.z_axis);
            let across = |other: &DVec3| (axes.transpose() * (*other - point)).truncate();
            let domain = Domain::nearest(point, others.iter().copied(), axes.z_axis);
            others.pop();
            others.sort_by(|a, b| across(a).length().total_cmp(&across(b).length()));
            others.truncate(Domain::MOST);
            assert_eq!(domain.half_spaces().len(), others.len());
            let clips = domain.clips(&axes, point);
            for texel in 0..GRID * GRID {
                let at = place(texel, 0.01);
                let beyond = others.iter().map(|other| at.length() - at.distance(across(other)));
                let beyond = beyond.fold(f64::NEG_INFINITY, f64::max);
                let found = clips.margin(at.x as f32, at.y as f32) >= 0.0;
                assert!(beyond.abs() < 1e-8 || found == (beyond < 0.0), "seed {seed}, case {case}: {at}");
                inside += u32::from(found);
                all += 1;
            }
        }
        assert!((all / 10..all / 2).contains(&inside), "{inside} of {all} are inside");
    }

    #[test]
    fn half_spaces_are_cut_up_to_the_most() {
        let mut domain = Domain::WHOLE;
        for i in 0..Domain::MOST {
            let half = HalfSpace { through: DVec3::X * i as f64, direction: DVec3::Y };
            assert!(domain.cut(half));
            assert_eq!((domain.half_spaces().len(), domain.half_spaces()[i]), (i + 1, half));
        }
        let full = domain;
        assert!(!domain.cut(HalfSpace::default()) && domain == full);
    }

    #[test]
    fn half_spaces_along_the_normal_cut_nothing() {
        let mut domain = Domain::WHOLE;
        for direction in [DVec3::Z, -DVec3::Z, DVec3::ZERO] {
            assert!(domain.cut(HalfSpace { through: DVec3::ONE, direction }));
        }
        assert_eq!(domain.clips(&DMat3::IDENTITY, DVec3::ZERO), Clips::default());
        assert_eq!(Domain::default(), Domain::WHOLE);
    }
}
