//! The part of a contact's grid in which overlaps count.

use glam::{DMat3, DVec3};

use crate::kernels::{Clips, MAX_CLIPS};

/// Distance across **n** below which points count as the same, m. Their bisector would be arbitrary.
const MIN_DISTANCE: f64 = 1e-6;

/// Component across **n** (of a unit vector) below which a direction counts as parallel to **n**. Its
/// half-plane on the grid would be arbitrary.
const MIN_ACROSS: f64 = 1e-9;

/// A half-space: the points p with direction · (p − through) ≤ 0.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HalfSpace {
    /// Point on its border, world, m.
    pub through: DVec3,
    /// Outward direction, world axes, of any length.
    pub direction: DVec3,
}

/// The domain of a [`TextureContact`](crate::TextureContact): the part of its grid that lies, as seen along
/// **n**, in each of a few half-spaces. Only overlaps in the domain count. Contacts side by side would
/// evaluate the same place twice, unless each has [its own domain](Self::nearest).
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
    /// Maximum number of half-spaces of a domain.
    pub const MAX_HALF_SPACES: usize = MAX_CLIPS;

    /// Returns the Voronoi cell of `point` among `others`, as seen along `normal` (unit), all in world
    /// coordinates. Only the nearest [`MAX_HALF_SPACES`](Self::MAX_HALF_SPACES) of the others count, and
    /// those within 1 µm of `point` are ignored.
    pub fn nearest(point: DVec3, others: impl IntoIterator<Item = DVec3>, normal: DVec3) -> Self {
        let mut domain = Self::WHOLE;
        for other in others {
            let direction = (other - point).reject_from_normalized(normal);
            let distance = direction.length_squared();
            if !direction.is_finite() || distance < MIN_DISTANCE * MIN_DISTANCE {
                continue;
            }
            // Insertion sort by distance; the border is half-way to the other point.
            let nearer = |known: &&HalfSpace| known.direction.length_squared() <= distance;
            let rank = domain.half_spaces().iter().take_while(nearer).count();
            if rank < Self::MAX_HALF_SPACES {
                domain.count = Self::MAX_HALF_SPACES.min(domain.count + 1);
                domain.half_spaces[rank..domain.count].rotate_right(1);
                domain.half_spaces[rank] = HalfSpace { through: point + 0.5 * direction, direction };
            }
        }
        domain
    }

    /// Restricts the domain to a half-space. Returns false, and changes nothing, if there are already
    /// [`MAX_HALF_SPACES`](Self::MAX_HALF_SPACES).
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

    /// Returns the half-planes as seen along n, in the frame with these axes at `origin`. Half-spaces
    /// parallel to the grid are ignored.
    pub(crate) fn clips(&self, axes: &DMat3, origin: DVec3) -> Clips {
        let mut clips = Clips::default();
        let to_axes = axes.transpose();
        for half in self.half_spaces() {
            let across = (to_axes * half.direction.normalize_or_zero()).truncate();
            let length = across.length();
            if length > MIN_ACROSS {
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

    /// Returns the centre of a texel in the contact's frame, m.
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
            // A point that differs along the normal only.
            others.push(point + 0.01 * axes.z_axis);
            let across = |other: &DVec3| (axes.transpose() * (*other - point)).truncate();
            let domain = Domain::nearest(point, others.iter().copied(), axes.z_axis);
            others.pop();
            others.sort_by(|a, b| across(a).length().total_cmp(&across(b).length()));
            others.truncate(Domain::MAX_HALF_SPACES);
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
    fn domain_is_cut_up_to_the_maximum_number_of_half_spaces() {
        let mut domain = Domain::WHOLE;
        for i in 0..Domain::MAX_HALF_SPACES {
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
