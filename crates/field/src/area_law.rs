//! A force law that converges as both surfaces are sampled more densely.
//!
//! The dissertation weighs the contacts of a cluster by δ + d (Eqs. 5.33–5.35), so that the force depends on
//! how many contacts happen to be reported, and where. Here each contact represents an area a, and a smooth
//! neighbourhood takes the place of a cluster. With contacts i of depth δᵢ at points **x**ᵢ of the probe,
//! with normals **n**ᵢ,
//!
//! > **F** = −k Σᵢ wᵢ (δᵢ + d) **n**ᵢ,  wᵢ = aᵢ (δᵢ + d) Σ_c φ_c(**x**ᵢ, **n**ᵢ) / Z̃_c,  Z̃_c = Σ_c′~c Σⱼ aⱼ
//! > (δⱼ + d) φ_c′(**x**ⱼ, **n**ⱼ).
//!
//! A cell c is a node of a cubic lattice in the probe's frame with one of the six directions of its axes. φ_c
//! is the product of the trilinear hat function of the node and the square of the normal's component along
//! the direction: both sum to one. Two cells are neighbours, c ~ c′, if their nodes are no further apart than
//! one lattice constant along any axis and their directions are not opposite. All sums are integrals over the
//! surfaces in the limit.
//!
//! Consequences:
//!
//! - Contacts within one lattice constant that push in the same direction have a total weight of one,
//!   wherever they are on the lattice and however many they are: a tip pushes with k(δ + d) averaged over its
//!   area of contact. Larger areas of contact push in proportion to their area, and contacts further apart
//!   than three lattice constants push independently. So do opposite walls.
//! - The wrench is continuous: contacts appear and disappear at δ = −d, where their force and weight are 0,
//!   and nothing depends on which of two is deeper, or on earlier poses.

use palpate_core::glam::{DVec3, UVec3};
use palpate_core::{Contact, Pose, Wrench};

/// Directions of the axes: x, −x, y, −y, z, −z.
const DIRECTIONS: usize = 6;

/// A contact and the area of the surfaces that it represents.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AreaContact {
    /// The contact, in world axes.
    pub contact: Contact,
    /// Area of the surface of either body, m².
    pub area: f64,
}

/// The force law, which weights contacts by the area that they represent. It keeps its memory from call to
/// call.
#[derive(Clone, Debug)]
pub struct AreaLaw {
    /// Lattice constant, m.
    reach: f64,
    /// Position of the first node in the probe's frame, m.
    origin: DVec3,
    /// Nodes along each axis.
    nodes: u32,
    /// Σⱼ aⱼ (δⱼ + d) φ_c(**x**ⱼ, **n**ⱼ) of each cell.
    sums: Vec<[f64; DIRECTIONS]>,
    /// Z̃_c of the cells of the nodes in use.
    totals: Vec<[f64; DIRECTIONS]>,
    /// Nodes whose sums are not 0.
    used: Vec<u32>,
    weights: Vec<f64>,
}

/// Nodes of the cube that a contact is in, with their interpolation weights.
type Shares = [(u32, f64); 8];

impl AreaLaw {
    /// The law for contacts of a probe whose surface is within a sphere (m, in its frame), with a lattice
    /// constant of `reach` radii of the sphere.
    ///
    /// # Panics
    /// If the radius is not finite and above 0, or `reach` is not 1/32 to 1.
    pub fn new(center: DVec3, radius: f64, reach: f64) -> Self {
        assert!(radius.is_finite() && radius > 0.0, "a radius of {radius} m");
        assert!((1.0 / 32.0..=1.0).contains(&reach), "a lattice constant of {reach} radii");
        // A node beyond the sphere on either side, so that all contacts are between nodes.
        let half = (1.0 / reach).ceil() as u32 + 1;
        let nodes = 2 * half + 1;
        let count = (nodes * nodes * nodes) as usize;
        let reach = reach * radius;
        Self {
            reach,
            origin: center - DVec3::splat(f64::from(half) * reach),
            nodes,
            sums: vec![[0.0; DIRECTIONS]; count],
            totals: vec![[0.0; DIRECTIONS]; count],
            used: Vec::with_capacity(count),
            weights: Vec::new(),
        }
    }

    /// The weights wᵢ of contacts within the tolerance (d, m) of a probe at a pose; 0 for contacts out of
    /// reach.
    pub fn weights(&mut self, contacts: &[AreaContact], tolerance: f64, pose: &Pose) -> &[f64] {
        for node in self.used.drain(..) {
            self.sums[node as usize] = [0.0; DIRECTIONS];
        }
        let to_probe = pose.inverse();
        let place = |found: &AreaContact| {
            let Contact { point, normal, depth, .. } = found.contact;
            let pressure = found.area * (depth + tolerance).max(0.0);
            (pressure, to_probe.transform_point(point), by_direction(to_probe.transform_vector(normal)))
        };
        for (pressure, point, directions) in contacts.iter().map(place) {
            if pressure > 0.0 {
                for (node, share) in self.shares(point).into_iter().filter(|(_, share)| *share > 0.0) {
                    let sums = &mut self.sums[node as usize];
                    if sums.iter().all(|sum| *sum == 0.0) {
                        self.used.push(node);
                    }
                    for (sum, direction) in sums.iter_mut().zip(directions) {
                        *sum += pressure * share * direction;
                    }
                }
            }
        }
        for index in 0..self.used.len() {
            let node = self.used[index];
            self.totals[node as usize] = self.total(node);
        }
        self.weights.clear();
        for found in contacts {
            let (pressure, point, directions) = place(found);
            let mut weight = 0.0;
            if pressure > 0.0 {
                for (node, share) in self.shares(point) {
                    let totals = &self.totals[node as usize];
                    for (total, direction) in totals.iter().zip(directions) {
                        // The total may be 0 where the contact has no share in the cell.
                        if share * direction > 0.0 {
                            weight += share * direction / total;
                        }
                    }
                }
            }
            self.weights.push(pressure * weight);
        }
        &self.weights
    }

    /// The wrench on the probe for a stiffness of 1 N/m, about a point in world axes (m).
    pub fn wrench(&mut self, contacts: &[AreaContact], tolerance: f64, pose: &Pose, about: DVec3) -> Wrench {
        let weights = self.weights(contacts, tolerance, pose);
        let mut sum = Wrench::ZERO;
        for (AreaContact { contact, .. }, weight) in contacts.iter().zip(weights) {
            let force = -contact.normal * weight * (contact.depth + tolerance).max(0.0);
            sum.force += force;
            sum.torque += (contact.point - about).cross(force);
        }
        sum
    }

    fn shares(&self, point: DVec3) -> Shares {
        let last = f64::from(self.nodes - 1);
        let at = ((point - self.origin) / self.reach).clamp(DVec3::ZERO, DVec3::splat(last));
        let first = at.floor().min(DVec3::splat(last - 1.0));
        let (inside, first) = (at - first, first.as_uvec3());
        std::array::from_fn(|corner| {
            let step = UVec3::new(corner as u32 & 1, corner as u32 >> 1 & 1, corner as u32 >> 2);
            let part = |axis: usize| if step[axis] == 1 { inside[axis] } else { 1.0 - inside[axis] };
            (self.index(first + step), part(0) * part(1) * part(2))
        })
    }

    fn index(&self, node: UVec3) -> u32 {
        (node.z * self.nodes + node.y) * self.nodes + node.x
    }

    /// Z̃_c of a node's cells.
    fn total(&self, node: u32) -> [f64; DIRECTIONS] {
        let n = self.nodes;
        let node = UVec3::new(node % n, node / n % n, node / (n * n));
        let (low, high) = (node.saturating_sub(UVec3::ONE), (node + 1).min(UVec3::splat(n - 1)));
        let mut near = [0.0; DIRECTIONS];
        for z in low.z..=high.z {
            for y in low.y..=high.y {
                let row = self.index(UVec3::new(low.x, y, z)) as usize;
                for sums in &self.sums[row..=row + (high.x - low.x) as usize] {
                    near.iter_mut().zip(sums).for_each(|(near, sum)| *near += sum);
                }
            }
        }
        let all: f64 = near.iter().sum();
        std::array::from_fn(|direction| all - near[direction ^ 1])
    }
}

/// Squares of a unit vector's components along each direction.
fn by_direction(normal: DVec3) -> [f64; DIRECTIONS] {
    let part = |x: f64, positive: bool| if (x > 0.0) == positive { x * x } else { 0.0 };
    let DVec3 { x, y, z } = normal;
    [part(x, true), part(x, false), part(y, true), part(y, false), part(z, true), part(z, false)]
}

#[cfg(test)]
mod tests {
    use palpate_core::glam::DQuat;
    use rand::rngs::StdRng;
    use rand::{RngExt as _, SeedableRng as _};

    use super::*;

    const SEED: u64 = 0xA2EA;
    const D: f64 = 0.01;
    const REACH: f64 = 0.25;

    fn law() -> AreaLaw {
        AreaLaw::new(DVec3::ZERO, 1.0, REACH)
    }

    fn contact(point: DVec3, normal: DVec3, depth: f64, area: f64) -> AreaContact {
        AreaContact { contact: Contact { point, scene_point: point - depth * normal, normal, depth }, area }
    }

    fn vector(rng: &mut StdRng) -> DVec3 {
        DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)))
    }

    /// A disc in contact, sampled on rings: its depth falls from `deepest` to −d at its rim, like a
    /// paraboloid's.
    fn tip(center: DVec3, normal: DVec3, radius: f64, deepest: f64, rings: usize) -> Vec<AreaContact> {
        let (across, along) = normal.any_orthonormal_pair();
        let ring = |index: usize| {
            let (inner, outer) = (index as f64 / rings as f64, (index + 1) as f64 / rings as f64);
            let r = f64::midpoint(inner, outer);
            let count = 6 * (2 * index + 1);
            let area = std::f64::consts::PI * radius * radius * (outer * outer - inner * inner);
            (0..count).map(move |step| {
                let (sine, cosine) = (std::f64::consts::TAU * step as f64 / count as f64).sin_cos();
                let at = center + radius * r * (cosine * across + sine * along);
                contact(at, normal, (deepest + D) * (1.0 - r * r) - D, area / count as f64)
            })
        };
        (0..rings).flat_map(ring).collect()
    }

    fn force(contacts: &[AreaContact]) -> DVec3 {
        law().wrench(contacts, D, &Pose::IDENTITY, DVec3::ZERO).force
    }

    #[test]
    fn a_tip_pushes_equally_wherever_it_is_and_however_it_is_sampled() {
        // ∫(δ + d)² dA / ∫(δ + d) dA of a paraboloid is 2/3 of the largest δ + d.
        let mut rng = StdRng::seed_from_u64(SEED);
        for round in 0..200 {
            let normal = vector(&mut rng).normalize();
            let center = 0.7 * vector(&mut rng) / 3.0_f64.sqrt();
            let deepest = rng.random_range(-0.9 * D..2.0 * D);
            for rings in [8, 32] {
                let found = force(&tip(center, normal, 1e-3, deepest, rings));
                let wanted = -2.0 / 3.0 * (deepest + D) * normal;
                let off = found.distance(wanted) / wanted.length();
                let most = 0.02 + 1.0 / f64::from(rings as u32).powi(2);
                assert!(off < most, "round {round}, {rings} rings: {found} for {wanted}");
            }
        }
    }

    #[test]
    fn a_wide_contact_pushes_in_proportion_to_its_area() {
        // A face at depth δ, sampled evenly: away from its rim each lattice square pushes with a ninth of k(δ
        // + d).
        let side = 6.0 * REACH;
        let count = 400;
        let step = side / f64::from(count);
        let at = |i: i32| (f64::from(i) + 0.5) * step - side / 2.0;
        let face: Vec<_> = (0..count * count)
            .map(|i| contact(DVec3::new(at(i % count), at(i / count), 0.1), DVec3::Z, D, step * step))
            .collect();
        let mut law = law();
        let weights = law.weights(&face, D, &Pose::IDENTITY);
        let middle: f64 = face
            .iter()
            .zip(weights)
            .filter(|(found, _)| found.contact.point.truncate().abs().max_element() < REACH / 2.0)
            .map(|(_, weight)| weight)
            .sum();
        // The face ends three lattice constants away, which affects the weights in the middle a little.
        assert!((middle - 1.0 / 9.0).abs() < 0.03 / 9.0, "{middle}");
    }

    #[test]
    fn opposite_walls_push_independently_and_distant_tips_too() {
        let one = tip(DVec3::new(0.1, 0.2, 0.0), DVec3::Z, 1e-3, D, 16);
        let alone = force(&one);
        let opposite = tip(DVec3::new(0.1, 0.2, 0.01), DVec3::NEG_Z, 1e-3, 0.5 * D, 16);
        let both = force(&[one.clone(), opposite.clone()].concat());
        assert!(both.distance(alone + force(&opposite)) < 1e-12, "{both}");
        let far = tip(DVec3::new(0.1 - 3.01 * REACH, 0.2, 0.0), DVec3::Z, 1e-3, D, 16);
        let both = force(&[one.clone(), far].concat());
        assert!(both.distance(2.0 * alone) < 1e-2 * alone.length(), "{both} for twice {alone}");
        let near = tip(DVec3::new(0.1, 0.2, 0.0), DVec3::Z, 1e-3, D, 16);
        let both = force(&[one, near].concat());
        assert!(both.distance(alone) < 1e-12, "the same twice: {both} for {alone}");
    }

    #[test]
    fn wrench_is_continuous() {
        const EPSILON: f64 = 1e-7;
        let mut rng = StdRng::seed_from_u64(SEED + 1);
        let mut largest: f64 = 0.0;
        for _ in 0..500 {
            let contacts: Vec<AreaContact> = (0..rng.random_range(1..40))
                .map(|_| {
                    let normal = vector(&mut rng).normalize();
                    contact(0.5 * vector(&mut rng), normal, D * rng.random_range(-1.0..2.0), 1e-4)
                })
                .collect();
            let mut changed = contacts.clone();
            for AreaContact { contact, area } in &mut changed {
                contact.point += EPSILON * vector(&mut rng);
                contact.normal = (contact.normal + EPSILON * vector(&mut rng)).normalize();
                contact.depth += EPSILON * D * rng.random_range(-1.0..1.0);
                *area *= 1.0 + EPSILON * rng.random_range(-1.0..1.0);
            }
            // A contact that is about to begin.
            changed.push(contact(
                0.5 * vector(&mut rng),
                vector(&mut rng).normalize(),
                EPSILON * D - D,
                1e-4,
            ));
            let [before, after] =
                [&contacts, &changed].map(|contacts| law().wrench(contacts, D, &Pose::IDENTITY, DVec3::ZERO));
            let change = before.force.distance(after.force) + before.torque.distance(after.torque);
            largest = largest.max(change / (EPSILON * D));
        }
        // A contact's weight changes by 1 within a lattice constant, at most 4 a metre, and there are up to
        // 40 of up to 3 d.
        assert!(largest < 4000.0, "{largest} EPSILON D");
    }

    #[test]
    fn poses_and_scales_change_nothing_else() {
        let mut rng = StdRng::seed_from_u64(SEED + 2);
        let contacts: Vec<AreaContact> = (0..30)
            .map(|_| {
                let normal = vector(&mut rng).normalize();
                contact(0.5 * vector(&mut rng), normal, D * rng.random_range(-1.0..2.0), 1e-4)
            })
            .collect();
        let here = law().wrench(&contacts, D, &Pose::IDENTITY, DVec3::ZERO);
        let scale = 1e-3;
        let pose = Pose::new(DVec3::new(3.0, -2.0, 1.0), DQuat::from_scaled_axis(vector(&mut rng)));
        let moved: Vec<AreaContact> = contacts
            .iter()
            .map(|AreaContact { contact: found, area }| {
                let (point, normal) =
                    (pose.transform_point(scale * found.point), pose.rotation * found.normal);
                contact(point, normal, scale * found.depth, scale * scale * area)
            })
            .collect();
        let mut law = AreaLaw::new(DVec3::ZERO, scale, REACH);
        for _ in 0..2 {
            let there = law.wrench(&moved, scale * D, &pose, pose.translation);
            assert!(there.force.distance(scale * (pose.rotation * here.force)) < 1e-12 * scale);
            assert!(there.torque.distance(scale * scale * (pose.rotation * here.torque)) < 1e-12 * scale);
        }
    }
}
