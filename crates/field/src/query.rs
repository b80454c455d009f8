//! Representative contacts: integrals over the area of contact, a cell of the probe's surroundings and a direction at a time.
//!
//! Samples of either surface are asked for their distance from the other body. Spheres around samples that are provably out of
//! reach are left out.

use glam::{DAffine3, DMat3, DVec3, UVec3, Vec3A};
use palpate_core::{Contact, Pose, TriMesh};
use wide::{f32x4, i32x4};

use crate::area_law::AreaContact;
use crate::bricks::DistanceField;
use crate::exact::ExactDistance;
use crate::samples::SurfaceSamples;

/// What interpolated distances may change by more than points are apart, in lattice constants: they bend near creases.
const SLACK: f32 = 0.25;
/// Of a sample that was not read.
const NO_CUBE: i32 = -1;
/// No cell yet.
const NONE: u32 = u32::MAX;

/// Levels of samples above this one are not read: too few points to stand for a contact.
const COARSEST: usize = 4;

/// A body prepared for queries.
#[derive(Clone, Debug)]
pub struct FieldBody {
    center: DVec3,
    radius: f64,
    field: DistanceField,
    samples: SurfaceSamples,
}

impl FieldBody {
    /// Of a mesh, with `cells` lattice cells across its bounding sphere, a band (m) that holds the tolerance of all queries, and
    /// samples so far apart (m).
    pub fn new(mesh: &TriMesh, cells: u32, band: f64, spacing: f64) -> Self {
        let exact = ExactDistance::new(mesh);
        let sphere = mesh.bounding_sphere();
        Self {
            center: sphere.center,
            radius: sphere.radius,
            field: DistanceField::new(mesh, &exact, cells, band),
            samples: SurfaceSamples::new(mesh, spacing),
        }
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        self.field.bytes() + self.samples.bytes()
    }
}

/// What a query asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FieldSettings {
    /// d: surfaces closer than this are in contact, m. No more than the fields' bands.
    pub tolerance: f64,
    /// Samples in contact around each place, within the law's reach.
    pub samples: f32,
}

/// What a query took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FieldOutcome {
    /// Fours of spheres and of samples asked for their distances.
    pub spheres: usize,
    /// See [`Self::spheres`].
    pub samples: usize,
    /// Samples in contact.
    pub contacts: usize,
}

/// Sums over the area of contact in a cell, in the probe's frame from its centre, m.
#[derive(Clone, Copy, Debug)]
struct Cell {
    slot: u32,
    /// Σ a (δ + d), and the moment of it.
    pressure: f32,
    moment: Vec3A,
    /// Σ a (δ + d)² **n**.
    push: Vec3A,
    /// δ + d of the deepest sample.
    reach: f32,
    point: Vec3A,
    normal: Vec3A,
}

/// The cells that hold contacts.
#[derive(Clone, Debug)]
struct Sums {
    /// By place and direction.
    table: Vec<u32>,
    cells: Vec<Cell>,
    contacts: usize,
}

impl Sums {
    fn clear(&mut self) {
        for cell in self.cells.drain(..) {
            self.table[cell.slot as usize] = NONE;
        }
        self.contacts = 0;
    }

    #[inline]
    fn count(&mut self, touch: &Touch, share: f32) {
        self.contacts += 1;
        let size = touch.normal.abs();
        let axis = if size.x >= size.y && size.x >= size.z {
            0
        } else if size.y >= size.z {
            1
        } else {
            2
        };
        let direction = 2 * axis as u32 + u32::from(touch.normal[axis] < 0.0);
        let slot = touch.cube * 6 + direction;
        let entry = &mut self.table[slot as usize];
        if *entry == NONE {
            *entry = self.cells.len() as u32;
            self.cells.push(Cell {
                slot,
                pressure: 0.0,
                moment: Vec3A::ZERO,
                push: Vec3A::ZERO,
                reach: 0.0,
                point: touch.point,
                normal: touch.normal,
            });
        }
        let cell = &mut self.cells[*entry as usize];
        let pressure = share * touch.weight * touch.reach;
        cell.pressure += pressure;
        cell.moment += pressure * touch.point;
        cell.push += pressure * touch.reach * touch.normal;
        if touch.reach > cell.reach {
            (cell.reach, cell.point, cell.normal) = (touch.reach, touch.point, touch.normal);
        }
    }
}

/// What there is in a cube of the probe's surroundings.
#[derive(Clone, Copy, Debug, Default)]
struct Cube {
    /// Σ p of the samples that count, for p = w a (δ + d), and of those of the present level.
    settled: f32,
    present: f32,
    /// Σ p² / w, likewise.
    settled_squares: f32,
    present_squares: f32,
    /// How much of what the samples of the present level push with counts.
    share: f32,
    is_used: bool,
}

/// Four samples of a level, and how much of what they push with may count.
#[derive(Clone, Copy, Debug)]
struct Four {
    index: u32,
    weight: f32,
    /// Of each.
    cubes: [i32; 4],
}

/// A sample in contact, in the probe's frame from its centre, m.
#[derive(Clone, Copy, Debug)]
struct Touch {
    point: Vec3A,
    normal: Vec3A,
    reach: f32,
    weight: f32,
    cube: u32,
}

/// One body's samples in the other's field.
struct Side<'a> {
    samples: &'a SurfaceSamples,
    field: &'a DistanceField,
    /// Rows of the map from the body to the lattice.
    to_lattice: [[f32; 4]; 3],
    /// From the lattice to the probe's frame, from its centre.
    to_probe: [[f32; 4]; 3],
    /// Likewise of unit vectors, from the field's body outwards to the scene object's outwards.
    turn: [[f32; 4]; 3],
    is_probe: bool,
}

/// The workspace of queries between two bodies.
#[derive(Clone, Debug)]
pub struct FieldQuery {
    /// Edge of a cell, m.
    edge: f64,
    /// Cells along each axis.
    across: u32,
    sums: Sums,
    cubes: Vec<Cube>,
    /// Cubes that hold contacts.
    used: Vec<u32>,
    /// Fours of each side that are to be read, and those of the next level.
    now: [Vec<Four>; 2],
    next: [Vec<Four>; 2],
    touching: [Vec<Touch>; 2],
    outcome: FieldOutcome,
}

impl FieldQuery {
    /// For a probe; cells are cubes with an edge of a part of its radius.
    pub fn new(probe: &FieldBody, edge: f64) -> Self {
        let half = (1.0 / edge).ceil() as u32 + 1;
        let across = 2 * half;
        Self {
            edge: edge * probe.radius,
            across,
            sums: Sums {
                table: vec![NONE; (6 * across * across * across) as usize],
                cells: Vec::with_capacity(1024),
                contacts: 0,
            },
            cubes: vec![Cube::default(); (across * across * across) as usize],
            used: Vec::with_capacity((across * across * across) as usize),
            now: std::array::from_fn(|_| Vec::with_capacity(8192)),
            next: std::array::from_fn(|_| Vec::with_capacity(8192)),
            touching: std::array::from_fn(|_| Vec::with_capacity(8192)),
            outcome: FieldOutcome::default(),
        }
    }

    /// What the last query took.
    pub fn outcome(&self) -> FieldOutcome {
        FieldOutcome { contacts: self.sums.contacts, ..self.outcome }
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        size_of::<Self>()
            + self.sums.table.capacity() * size_of::<u32>()
            + self.sums.cells.capacity() * size_of::<Cell>()
            + self.cubes.capacity() * size_of::<Cube>()
            + self.used.capacity() * size_of::<u32>()
            + self
                .now
                .iter()
                .chain(&self.next)
                .map(|fours| fours.capacity() * size_of::<Four>())
                .sum::<usize>()
            + self.touching.iter().map(|touching| touching.capacity() * size_of::<Touch>()).sum::<usize>()
    }

    /// Integrates over the area of contact.
    pub fn run(
        &mut self,
        probe: &FieldBody,
        scene: &FieldBody,
        probe_pose: &Pose,
        scene_pose: &Pose,
        settings: &FieldSettings,
    ) {
        self.sums.clear();
        self.outcome = FieldOutcome::default();
        let tolerance = settings.tolerance.min(probe.field.band()).min(scene.field.band());
        let settings = &FieldSettings { tolerance, ..*settings };
        let to_scene = scene_pose.inverse() * *probe_pose;
        let sides = [
            Side::new(&probe.samples, &scene.field, &to_scene, true, probe.center),
            Side::new(&scene.samples, &probe.field, &to_scene.inverse(), false, probe.center),
        ];
        for cube in self.used.drain(..) {
            self.cubes[cube as usize] = Cube::default();
        }
        for (now, side) in self.now.iter_mut().zip(&sides) {
            now.clear();
            if !side.samples.levels.is_empty() {
                now.push(Four { index: 0, weight: 1.0, cubes: [NO_CUBE; 4] });
            }
        }
        let most = sides.iter().map(|side| side.samples.levels.len()).max().unwrap_or(0);
        // Bodies of different sizes begin at levels of their own, and end together.
        for level in (0..most).rev() {
            let is_sampled = level <= COARSEST;
            for (index, side) in sides.iter().enumerate() {
                self.touching[index].clear();
                if is_sampled && level < side.samples.levels.len() {
                    self.read(index, side, level, settings);
                }
            }
            if is_sampled && level > 0 {
                self.share(settings);
            }
            for (index, side) in sides.iter().enumerate() {
                if level < side.samples.levels.len() {
                    for touch in &self.touching[index] {
                        let share = self.cubes[touch.cube as usize].share;
                        if share > 0.0 {
                            self.sums.count(touch, share);
                        }
                    }
                    self.descend(index, side, level, settings);
                }
            }
        }
    }

    /// Reads the samples of a level.
    fn read(&mut self, index: usize, side: &Side, level: usize, settings: &FieldSettings) {
        let h = side.field.spacing() as f32;
        let tolerance = settings.tolerance as f32 / h;
        let area = side.samples.area * (1 << (2 * level)) as f32;
        let middle = f32x4::splat((self.across / 2) as f32);
        let last = f32x4::splat((self.across - 1) as f32);
        let per_edge = f32x4::splat(1.0 / self.edge as f32);
        let across = i32x4::splat(self.across as i32);
        self.outcome.samples += self.now[index].len();
        let samples = &side.samples.levels[level].samples;
        for four in &mut self.now[index] {
            let at = side.place(&samples[four.index as usize]);
            let [distance, x, y, z] = side.field.read::<true>(&at);
            let reach = f32x4::splat(tolerance) - distance;
            let touching = reach.simd_gt(f32x4::ZERO).to_bitmask();
            if touching == 0 && level == 0 {
                continue;
            }
            let size = (x * x + y * y + z * z).fast_max(f32x4::splat(f32::MIN_POSITIVE)).sqrt();
            let out = [x / size, y / size, z / size];
            // On the probe's surface.
            let place = if side.is_probe {
                at
            } else {
                [at[0] - distance * out[0], at[1] - distance * out[1], at[2] - distance * out[2]]
            };
            let point = mapped(&side.to_probe, &place);
            let cube =
                |x: f32x4| (x * per_edge + middle).fast_max(f32x4::ZERO).fast_min(last).fast_trunc_int();
            let cube: i32x4 = (cube(point[2]) * across + cube(point[1])) * across + cube(point[0]);
            let cubes = cube.to_array();
            four.cubes = cubes;
            if touching == 0 {
                continue;
            }
            let normal = mapped(&side.turn, &out);
            let normal = [normal[0].to_array(), normal[1].to_array(), normal[2].to_array()];
            let point = [point[0].to_array(), point[1].to_array(), point[2].to_array()];
            let reach = (reach * f32x4::splat(h)).to_array();
            for lane in (0..4).filter(|lane| touching & 1 << lane != 0) {
                let touch = Touch {
                    point: Vec3A::new(point[0][lane], point[1][lane], point[2][lane]),
                    normal: Vec3A::new(normal[0][lane], normal[1][lane], normal[2][lane]),
                    reach: reach[lane],
                    weight: four.weight * area,
                    cube: cubes[lane] as u32,
                };
                if level == 0 {
                    self.sums.count(&touch, 1.0);
                    continue;
                }
                let cube = &mut self.cubes[touch.cube as usize];
                if !cube.is_used {
                    cube.is_used = true;
                    self.used.push(touch.cube);
                }
                let pressure = touch.weight * touch.reach;
                cube.present += pressure;
                cube.present_squares += pressure * area * touch.reach;
                self.touching[index].push(touch);
            }
        }
    }

    /// Decides how much counts of the samples of the present level, by how many are in contact around each place.
    fn share(&mut self, settings: &FieldSettings) {
        let n = self.across;
        for index in &self.used {
            let at = UVec3::new(index % n, index / n % n, index / (n * n));
            let (low, high) = (at.saturating_sub(UVec3::ONE), (at + 1).min(UVec3::splat(n - 1)));
            let (mut sum, mut squares) = (0.0, 0.0);
            for z in low.z..=high.z {
                for y in low.y..=high.y {
                    let row = ((z * n + y) * n) as usize;
                    for cube in &self.cubes[row + low.x as usize..=row + high.x as usize] {
                        sum += cube.settled + cube.present;
                        squares += cube.settled_squares + cube.present_squares;
                    }
                }
            }
            let in_contact = if squares > 0.0 { sum * sum / squares } else { 0.0 };
            self.cubes[*index as usize].share = (in_contact / settings.samples - 1.0).clamp(0.0, 1.0);
        }
        for index in &self.used {
            let cube = &mut self.cubes[*index as usize];
            cube.settled += cube.share * cube.present;
            cube.settled_squares += cube.share * cube.present_squares;
            (cube.present, cube.present_squares) = (0.0, 0.0);
        }
    }

    /// Goes on to the samples of the next level, where there are not enough of this one and there may be some within reach.
    fn descend(&mut self, index: usize, side: &Side, level: usize, settings: &FieldSettings) {
        let scale = 1.0 / side.field.spacing() as f32;
        let tolerance = settings.tolerance as f32 * scale + SLACK;
        let (now, next) = (&mut self.now[index], &mut self.next[index]);
        next.clear();
        if level > 0 {
            let spheres = &side.samples.levels[level].spheres;
            for four in now.iter() {
                let share = |cube: i32| if cube == NO_CUBE { 0.0 } else { self.cubes[cube as usize].share };
                let shares = four.cubes.map(share);
                if shares.iter().all(|share| *share == 1.0) {
                    continue;
                }
                self.outcome.spheres += 1;
                let [x, y, z, radius] = spheres[four.index as usize];
                let [distance, ..] = side.field.read::<false>(&side.place(&[x, y, z]));
                let in_reach =
                    distance.simd_le(radius * f32x4::splat(scale) + f32x4::splat(tolerance)).to_bitmask();
                for (lane, share) in shares.into_iter().enumerate() {
                    if in_reach & 1 << lane != 0 && share < 1.0 {
                        let weight = (1.0 - share) * four.weight;
                        next.push(Four { index: 4 * four.index + lane as u32, weight, cubes: [NO_CUBE; 4] });
                    }
                }
            }
        }
        std::mem::swap(now, next);
    }

    /// The contacts of the last query, which was at this pose of the probe: one a cell, at the centre of its pressure, with the
    /// depth, the direction and the area that push as all of the cell does by the [`AreaLaw`](crate::AreaLaw); and its deepest
    /// sample, with no area.
    pub fn append_contacts(
        &self,
        probe: &FieldBody,
        pose: &Pose,
        tolerance: f64,
        into: &mut Vec<AreaContact>,
    ) {
        let place = |point: Vec3A, normal: Vec3A, depth: f64, area: f64| {
            let point = pose.transform_point(probe.center + point.as_dvec3());
            let normal = pose.transform_vector(normal.as_dvec3().normalize_or_zero());
            AreaContact {
                contact: Contact { point, scene_point: point - depth * normal, normal, depth },
                area,
            }
        };
        for cell in &self.sums.cells {
            let pressure = f64::from(cell.pressure);
            // In double precision, for squares of what barely touches would vanish in single.
            let reach = cell.push.as_dvec3().length() / pressure;
            if !(reach > 0.0 && reach.is_finite()) {
                continue;
            }
            into.push(place(cell.moment / cell.pressure, cell.push, reach - tolerance, pressure / reach));
            into.push(place(cell.point, cell.normal, f64::from(cell.reach) - tolerance, 0.0));
        }
    }
}

impl<'a> Side<'a> {
    fn new(
        samples: &'a SurfaceSamples,
        field: &'a DistanceField,
        to_field: &Pose,
        is_probe: bool,
        center: DVec3,
    ) -> Self {
        let spacing = field.spacing();
        let affine = |pose: &Pose| DAffine3::from_rotation_translation(pose.rotation, pose.translation);
        let lattice =
            DAffine3::from_mat3_translation(DMat3::from_diagonal(DVec3::splat(spacing)), field.origin());
        let from_field = if is_probe { affine(&to_field.inverse()) } else { DAffine3::IDENTITY };
        // Out of the probe is into the scene object.
        let sign = if is_probe { -1.0 } else { 1.0 };
        Self {
            samples,
            field,
            to_lattice: rows(lattice.inverse() * affine(to_field)),
            to_probe: rows(DAffine3::from_translation(-center) * from_field * lattice),
            turn: rows(DAffine3::from_mat3(from_field.matrix3 * sign)),
            is_probe,
        }
    }

    /// Four points of the body in the field's lattice.
    #[inline]
    fn place(&self, points: &[f32x4; 3]) -> [f32x4; 3] {
        mapped(&self.to_lattice, points)
    }
}

/// Rows of a matrix, each with its part of the translation.
fn rows(map: DAffine3) -> [[f32; 4]; 3] {
    [0, 1, 2].map(|axis| {
        let row = map.matrix3.row(axis);
        [row.x, row.y, row.z, map.translation[axis]].map(|x| x as f32)
    })
}

#[inline]
fn mapped(rows: &[[f32; 4]; 3], [x, y, z]: &[f32x4; 3]) -> [f32x4; 3] {
    let row = |[a, b, c, d]: [f32; 4]| {
        f32x4::splat(a) * *x + f32x4::splat(b) * *y + f32x4::splat(c) * *z + f32x4::splat(d)
    };
    [row(rows[0]), row(rows[1]), row(rows[2])]
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use palpate_core::glam::DQuat;

    use super::*;
    use crate::area_law::AreaLaw;

    const REACH: f64 = 0.25;

    /// A sphere of an octahedron's faces, each cut into four `levels` times.
    fn ball(radius: f64, levels: u32) -> TriMesh {
        let mut triangles = Vec::new();
        for octant in 0..8u32 {
            let sign = |bit: u32| if octant >> bit & 1 == 0 { 1.0 } else { -1.0 };
            let [x, y, z] = [DVec3::X * sign(0), DVec3::Y * sign(1), DVec3::Z * sign(2)];
            let outwards = sign(0) * sign(1) * sign(2) > 0.0;
            triangles.push(if outwards { [x, y, z] } else { [x, z, y] });
        }
        for _ in 0..levels {
            triangles = triangles
                .into_iter()
                .flat_map(|[a, b, c]| {
                    let [ab, bc, ca] = [(a + b), (b + c), (c + a)].map(DVec3::normalize);
                    [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
                })
                .collect();
        }
        let (mut vertices, mut indices) = (Vec::new(), HashMap::new());
        let mut index = |v: DVec3| {
            *indices.entry((v + 0.0).to_array().map(f64::to_bits)).or_insert_with(|| {
                vertices.push(radius * v);
                vertices.len() as u32 - 1
            })
        };
        let triangles = triangles.into_iter().map(|triangle| triangle.map(&mut index)).collect();
        TriMesh::new(vertices, triangles).expect("a mesh")
    }

    /// A block between two corners.
    fn block(low: DVec3, high: DVec3) -> TriMesh {
        let corner = |i: u32| {
            let part = DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2));
            low + (high - low) * part
        };
        #[rustfmt::skip]
        let triangles = vec![
            [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
            [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
        ];
        TriMesh::new((0..8).map(corner).collect(), triangles).expect("a mesh")
    }

    fn force(
        query: &mut FieldQuery,
        probe: &FieldBody,
        scene: &FieldBody,
        pose: &Pose,
        d: f64,
    ) -> (DVec3, f64) {
        let settings = FieldSettings { tolerance: d, samples: 64.0 };
        query.run(probe, scene, pose, &Pose::IDENTITY, &settings);
        let mut contacts = Vec::new();
        query.append_contacts(probe, pose, d, &mut contacts);
        let mut law = AreaLaw::new(probe.center, probe.radius, REACH);
        let deepest = contacts.iter().map(|found| found.contact.depth).fold(f64::NEG_INFINITY, f64::max);
        (law.wrench(&contacts, d, pose, pose.translation).force, deepest)
    }

    #[test]
    fn no_sample_in_contact_is_left_out() {
        let (d, mut found) = (0.01, 0);
        let body = FieldBody::new(&ball(1.0, 4), 96, 2.0 * d, 0.02);
        let mut query = FieldQuery::new(&body, REACH);
        for step in 0..20 {
            let turn = DQuat::from_scaled_axis(DVec3::new(0.3, 0.2, 1.0) * f64::from(step));
            // From apart to deep inside.
            let pose = Pose::new(turn * DVec3::X * (2.02 - 0.06 * f64::from(step)), turn);
            let settings = FieldSettings { tolerance: d, samples: f32::INFINITY };
            query.run(&body, &body, &pose, &Pose::IDENTITY, &settings);
            let mut all = 0;
            for (to_field, is_probe) in [(pose, true), (pose.inverse(), false)] {
                let side = Side::new(&body.samples, &body.field, &to_field, is_probe, body.center);
                for four in &body.samples.levels[0].samples {
                    let [distance, ..] = side.field.read::<false>(&side.place(four));
                    let reach = f32x4::splat((d / body.field.spacing()) as f32) - distance;
                    all += reach.simd_gt(f32x4::ZERO).to_bitmask().count_ones() as usize;
                }
            }
            assert_eq!(query.outcome().contacts, all, "step {step}");
            found += all;
        }
        assert!(found > 10_000, "{found} contacts");
    }

    #[test]
    fn a_ball_on_a_block_pushes_by_two_thirds_of_its_reach() {
        let (radius, d) = (1.0, 0.01);
        let probe = FieldBody::new(&ball(radius, 6), 128, 2.0 * d, 0.01);
        let scene = FieldBody::new(
            &block(DVec3::new(-2.0, -2.0, -1.0), DVec3::new(2.0, 2.0, 0.0)),
            256,
            2.0 * d,
            0.01,
        );
        let mut query = FieldQuery::new(&probe, REACH);
        for depth in [-0.005, 0.0, 0.004] {
            for turn in [DVec3::ZERO, DVec3::new(0.3, 0.2, 1.0)] {
                let pose = Pose::new(DVec3::new(0.13, -0.21, radius - depth), DQuat::from_scaled_axis(turn));
                let (found, deepest) = force(&mut query, &probe, &scene, &pose, d);
                let wanted = 2.0 / 3.0 * (depth + d) * DVec3::Z;
                assert!(found.distance(wanted) < 0.05 * wanted.length(), "{depth}: {found} for {wanted}");
                assert!((deepest - depth).abs() < 5e-4, "{deepest} for {depth}");
                let again = force(&mut query, &probe, &scene, &pose, d);
                assert_eq!(again, (found, deepest), "the same every time");
            }
        }
        let (found, _) = force(&mut query, &probe, &scene, &Pose::from_translation(1.02 * DVec3::Z), d);
        assert_eq!(found, DVec3::ZERO, "out of reach");
    }
}
