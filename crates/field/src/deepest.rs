//! The deepest places of contact, measured on the meshes: a coarse field does not decide how deep they are.
//!
//! A place starts from a sample, goes to the deepest of the finest samples around it, and from there over the
//! features of both meshes to the deepest feature ([`FeatureMesh::descend`]). It is followed from query to
//! query, so that most places take a single measurement.

use std::cell::Cell;

use arrayvec::ArrayVec;
use glam::{DAffine3, DQuat, DVec3, Vec3A};
use palpate_core::Pose;
use wide::f32x4;

use crate::body::FieldBody;
use crate::cells::ContactSample;
use crate::features::{ClosestPoint, FeatureMesh, Leash, MeshFeature, Place, lowest_share};
use crate::samples::Sample;
use crate::side::Side;

/// Index of no sample.
const NONE: u32 = u32::MAX;

/// Largest number of places that are followed. With fewer, those of jaws are started again and again.
pub const MAX_PLACES: usize = 32;

/// Largest number of vertices around a place that it looks at: those up to two edges away, of most meshes.
const MAX_AROUND: usize = 24;

/// Number of queries in which one place looks around. With more, places stay behind ridges for longer; with
/// fewer, there are fewer measurements for following them.
const EXPLORED: usize = 4;

/// Largest number of measurements on a mesh in a query. With fewer, the deepest place is followed later where
/// bodies are fast.
const MAX_MEASUREMENTS: u32 = 24;

/// Number of measurements that have to be left for a place to start, or to look around.
const MIN_LEFT: u32 = 8;

/// Smallest gain of depth that a place moves for, in tolerances.
const MIN_GAIN: f64 = 1e-4;

/// Factor on the fraction of an edge that a place tries, after a move that leads to a deeper one.
const LONGER: f64 = 4.0;

/// How much deeper than a place a sample near it has to be to start another one, in tolerances.
const MIN_DEEPER: f64 = 0.05;

/// A place on the features of one body.
#[derive(Clone, Copy, Debug)]
struct Followed {
    is_probe: bool,
    place: Place,
    /// The part of the surface that it stays in.
    leash: Leash,
    /// Face of the other body near it.
    face: u32,
    /// Fraction of the way along an edge that it tries next.
    stride: f32,
    /// As it was when it was measured, and the position of the leash's home in the other body's frame then.
    measured: Measured,
    home: DVec3,
    turned: DQuat,
    /// What its depth may have become since, m.
    bound: f64,
    /// Whether it was measured in this query.
    is_new: bool,
    /// Whether it was the deepest around then.
    is_settled: bool,
}

/// A place with its depth, in the probe's frame from its centre.
#[derive(Clone, Copy, Debug)]
pub struct Measured {
    /// Point of the probe's surface, m.
    pub point: Vec3A,
    /// Unit normal out of the probe.
    pub normal: Vec3A,
    /// δ, m.
    pub depth: f64,
}

/// The deepest places of contact between two bodies.
#[derive(Clone, Debug, Default)]
pub struct DeepestPlaces {
    followed: ArrayVec<Followed, MAX_PLACES>,
    /// Number of queries.
    queries: usize,
}

/// Two bodies at their poses.
pub struct Bodies<'a> {
    bodies: [&'a FieldBody; 2],
    /// From the frame of each to that of the other.
    to_other: [DAffine3; 2],
    turn: DQuat,
    /// Tolerance d, m.
    tolerance: f64,
    /// Length of a leash, m.
    leash: f64,
    /// Number of measurements that are left.
    left: Cell<u32>,
}

impl<'a> Bodies<'a> {
    /// A probe and a scene object, with the probe's pose in the object's frame; `leash` (m) is how far a
    /// place follows its body's surface.
    pub fn new(bodies: [&'a FieldBody; 2], to_scene: &Pose, (tolerance, leash): (f64, f64)) -> Self {
        let affine = |pose: &Pose| DAffine3::from_rotation_translation(pose.rotation, pose.translation);
        Self {
            bodies,
            to_other: [affine(to_scene), affine(&to_scene.inverse())],
            turn: to_scene.rotation,
            tolerance,
            leash,
            left: Cell::new(MAX_MEASUREMENTS),
        }
    }

    /// Measures a point of one body on the other, from a face nearby.
    fn measure(&self, other: &FeatureMesh, point: DVec3, face: u32) -> ClosestPoint {
        self.left.set(self.left.get().saturating_sub(1));
        other.walk(point, face)
    }

    /// Whether so many measurements are left.
    fn has(&self, measurements: u32) -> bool {
        self.left.get() >= measurements
    }

    /// The body that a place is on, the other one, and the maps to and from the latter's frame.
    fn of(&self, is_probe: bool) -> (&'a FeatureMesh, &'a FeatureMesh, &DAffine3, &DAffine3) {
        let (own, other) = if is_probe { (0, 1) } else { (1, 0) };
        (&self.bodies[own].features, &self.bodies[other].features, &self.to_other[own], &self.to_other[other])
    }
}

impl DeepestPlaces {
    /// Forgets all places.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// Measures the places of which one may be the deepest: those that are followed, and those that start at
    /// samples, given the deepest first, whose depths have an error (m). A place is for what is within
    /// `nearby` (m) of it.
    pub fn measure<'s>(
        &mut self,
        samples: impl Iterator<Item = &'s ContactSample>,
        bodies: &Bodies<'_>,
        [own, other]: &[Side<'_>; 2],
        (nearby, error): (f32, f64),
    ) {
        self.follow(bodies);
        self.explore(bodies);
        for sample in samples {
            let depth = f64::from(sample.reach - 1.0) * bodies.tolerance;
            if !bodies.has(MIN_LEFT) || depth + error <= self.deepest() {
                break;
            }
            let is_near = |place: &Followed| {
                place.measured.point.distance_squared(sample.point) < nearby * nearby
                    && depth < place.bound + MIN_DEEPER * bodies.tolerance
            };
            if self.followed.iter().any(is_near) {
                continue;
            }
            if self.followed.is_full() {
                let bounds = self.followed.iter().enumerate().map(|(index, place)| (index, place.bound));
                let Some((least, bound)) = bounds.min_by(|a, b| a.1.total_cmp(&b.1)) else { break };
                if bound >= depth {
                    break;
                }
                self.followed.swap_remove(least);
            }
            let deepest = deepest_around(if sample.is_probe { own } else { other }, sample);
            for started in Followed::at(&deepest, bodies) {
                let is_same =
                    |other: &Followed| other.is_probe == started.is_probe && other.place == started.place;
                if !self.followed.is_full() && !self.followed.iter().any(is_same) {
                    self.followed.push(started);
                }
            }
        }
    }

    /// Moves places of earlier queries to where they are deepest now, as long as one may be the deepest.
    fn follow(&mut self, bodies: &Bodies<'_>) {
        for place in &mut self.followed {
            place.expect(bodies);
        }
        self.followed.retain(|place| place.bound > -bodies.tolerance);
        while bodies.has(1) {
            let others = self.followed.iter().enumerate().filter(|(_, place)| !place.is_new);
            let next = others.max_by(|a, b| a.1.bound.total_cmp(&b.1.bound));
            let Some((index, _)) = next.filter(|(_, place)| place.bound > self.deepest()) else { break };
            self.followed[index].settle(bodies);
            let Followed { is_probe, place, .. } = self.followed[index];
            let is_same = |other: &&Followed| other.is_probe == is_probe && other.place == place;
            if self.followed.iter().filter(is_same).count() > 1 {
                self.followed.swap_remove(index);
            }
        }
    }

    /// Looks around one of the places that were measured, in some of the queries, each in turn.
    fn explore(&mut self, bodies: &Bodies<'_>) {
        self.queries = self.queries.wrapping_add(1);
        let measured = self.iter().count();
        if measured > 0 && bodies.has(MIN_LEFT) && self.queries.is_multiple_of(EXPLORED) {
            let next = self.queries / EXPLORED % measured;
            if let Some(place) = self.followed.iter_mut().filter(|place| place.is_new).nth(next) {
                place.explore(bodies);
            }
        }
    }

    /// The largest depth that was measured in this query, m; −∞ if none was.
    pub fn deepest(&self) -> f64 {
        self.iter().map(|measured| measured.depth).fold(f64::NEG_INFINITY, f64::max)
    }

    /// Whether no place can be deeper than those that were measured.
    pub fn is_known(&self) -> bool {
        let deepest = self.deepest();
        self.followed.iter().all(|place| place.bound <= deepest)
    }

    /// Whether one of the places that were measured is the deepest within a distance of a point, m.
    pub fn covers(&self, point: Vec3A, nearby: f32) -> bool {
        let mut settled = self.followed.iter().filter(|place| place.is_new && place.is_settled);
        settled.any(|place| place.measured.point.distance_squared(point) < nearby * nearby)
    }

    /// The places that were measured in this query.
    pub fn iter(&self) -> impl Iterator<Item = &Measured> {
        self.followed.iter().filter(|place| place.is_new).map(|followed| &followed.measured)
    }
}

impl Followed {
    /// The places that a sample leads to on either body.
    fn at(sample: &ContactSample, bodies: &Bodies<'_>) -> [Self; 2] {
        let (own, other, to_other, _) = bodies.of(sample.is_probe);
        // The probe's point of a contact, and from there to the body that the sample is on.
        let on_probe = bodies.bodies[0].center + sample.point.as_dvec3();
        let depth = f64::from(sample.reach - 1.0) * bodies.tolerance;
        let point = if sample.is_probe {
            on_probe
        } else {
            bodies.to_other[0].transform_point3(on_probe - depth * sample.normal.as_dvec3())
        };
        let closest = other.nearest(to_other.transform_point3(point));
        let face = own.face_near(point, 0);
        let places = [
            (sample.is_probe, own.place_beside(face, point), point, closest.face),
            (!sample.is_probe, other.place_beside(closest.face, closest.point), closest.point, face),
        ];
        let mut started = places.map(|(is_probe, place, home, face)| {
            let mut started = Self {
                is_probe,
                place,
                leash: Leash { home, length: bodies.leash as f32 },
                face,
                stride: 1.0,
                measured: Measured { point: Vec3A::ZERO, normal: Vec3A::ZERO, depth: f64::NEG_INFINITY },
                home: DVec3::ZERO,
                turned: DQuat::IDENTITY,
                bound: f64::NEG_INFINITY,
                is_new: true,
                is_settled: false,
            };
            started.settle(bodies);
            started
        });
        let deeper = usize::from(started[1].measured.depth > started[0].measured.depth);
        started[deeper].explore(bodies);
        started
    }

    /// Finds what the depth may be now: no place within the leash is deeper by more than it has moved.
    fn expect(&mut self, bodies: &Bodies<'_>) {
        let (.., to_other, _) = bodies.of(self.is_probe);
        let moved = to_other.transform_point3(self.leash.home).distance(self.home);
        let turned = 2.0 * (self.turned.dot(bodies.turn).abs()).min(1.0).acos();
        self.bound = self.most() + moved + turned * f64::from(self.leash.length);
        self.is_new = false;
    }

    /// Goes to the deepest place around, and measures it.
    fn settle(&mut self, bodies: &Bodies<'_>) {
        let closest = self.descend(bodies);
        self.measured = self.measure(&closest, bodies);
        if let MeshFeature::Vertex(vertex) = closest.feature {
            // The other body's vertex may be deeper than what is around it.
            let (own, ..) = bodies.of(self.is_probe);
            let mut across = Self {
                is_probe: !self.is_probe,
                place: Place::Vertex(vertex),
                leash: Leash { home: closest.point, length: self.leash.length },
                face: own.face_at(self.place.into()),
                stride: 1.0,
                ..*self
            };
            let found = across.descend(bodies);
            let measured = across.measure(&found, bodies);
            if measured.depth > self.measured.depth + MIN_GAIN * bodies.tolerance {
                *self = Self { measured, ..across };
            }
        }
        let (.., to_other, _) = bodies.of(self.is_probe);
        self.home = to_other.transform_point3(self.leash.home);
        self.turned = bodies.turn;
        (self.bound, self.is_new) = (self.most(), true);
    }

    /// The largest depth within the leash when it was measured, m.
    fn most(&self) -> f64 {
        let left = if self.is_settled { 0.0 } else { 2.0 * f64::from(self.leash.length) };
        self.measured.depth + left
    }

    /// Looks beyond the ridges around the place: goes on from a vertex two edges away if that is deeper.
    fn explore(&mut self, bodies: &Bodies<'_>) {
        let (own, other, to_other, _) = bodies.of(self.is_probe);
        let mut deeper = (-self.measured.depth - MIN_GAIN * bodies.tolerance, None);
        let mut seen = ArrayVec::<u32, MAX_AROUND>::new();
        let around = own.vertices_beside(self.place);
        for vertex in around.flat_map(|near| own.vertices_beside(Place::Vertex(near))) {
            if !bodies.has(1) || seen.contains(&vertex) || seen.try_push(vertex).is_err() {
                continue;
            }
            let place = Place::Vertex(vertex);
            let at = to_other.transform_point3(own.position(&place));
            let found = bodies.measure(other, at, self.face);
            if found.distance < deeper.0 {
                deeper = (found.distance, Some((place, found.face)));
            }
        }
        if let Some((place, face)) = deeper.1 {
            let leash = Leash { home: own.position(&place), ..self.leash };
            let mut other = Self { place, face, leash, stride: 1.0, ..*self };
            other.settle(bodies);
            if other.measured.depth > self.measured.depth {
                *self = other;
            }
        }
    }

    /// Moves over the body's own vertices and edges to where they are deepest.
    fn descend(&mut self, bodies: &Bodies<'_>) -> ClosestPoint {
        let (own, other, to_other, to_own) = bodies.of(self.is_probe);
        let least = MIN_GAIN * bodies.tolerance;
        let mut position = own.position(&self.place);
        let mut closest = bodies.measure(other, to_other.transform_point3(position), self.face);
        let (mut stride, mut is_settled) = (f64::from(self.stride), false);
        while bodies.has(1) {
            let normal = to_own.transform_vector3(closest.normal);
            let Some(place) = own.descend(&self.place, normal, stride, &self.leash) else {
                is_settled = true;
                break;
            };
            let next = own.position(&place);
            let found = bodies.measure(other, to_other.transform_point3(next), closest.face);
            let way = next - position;
            let fallen = closest.distance - found.distance;
            if fallen > least {
                (self.place, position, closest) = (place, next, found);
                stride = (LONGER * stride).min(1.0);
                continue;
            }
            let is_across = matches!((self.place, place), (Place::Edge(a, _), Place::Edge(b, _)) if a != b);
            let slopes = [normal, to_own.transform_vector3(found.normal)].map(|normal| normal.dot(way));
            let share = lowest_share(-fallen, slopes);
            if is_across || -slopes[0] * share <= least {
                is_settled = true;
                break;
            }
            stride *= share;
        }
        self.stride = stride.max(FeatureMesh::MIN_STRIDE) as f32;
        self.is_settled = is_settled;
        if closest.distance < 0.0 {
            // Another side of a wall may be nearer than the one that it came in through.
            closest = other.nearer(to_other.transform_point3(position), -closest.distance).unwrap_or(closest);
        }
        self.face = closest.face;
        closest
    }

    fn measure(&self, closest: &ClosestPoint, bodies: &Bodies<'_>) -> Measured {
        let (own, .., to_own) = bodies.of(self.is_probe);
        let center = bodies.bodies[0].center;
        // Normals out of the probe point into the scene object.
        let (point, normal) = if self.is_probe {
            (own.position(&self.place), -to_own.transform_vector3(closest.normal))
        } else {
            (closest.point, closest.normal)
        };
        let relative: DVec3 = point - center;
        Measured { point: relative.as_vec3a(), normal: normal.as_vec3a(), depth: -closest.distance }
    }
}

/// Finds the deepest sample around one that is in contact, from its own level to the finest, among those
/// below it and its three neighbours. It follows the deepest two of each level.
fn deepest_around(side: &Side, touch: &ContactSample) -> ContactSample {
    let mut best = *touch;
    let first = touch.sample.index & !3;
    let mut followed = [first, first + 1, first + 2, first + 3];
    for level in (0..touch.sample.level).rev() {
        let mut next = [(f32::NEG_INFINITY, NONE); 2];
        for parent in followed {
            // Fours below neighbours at the end of a level may not exist.
            if parent as usize >= side.samples.fours(level.into()) {
                continue;
            }
            let points = side.samples.four(level.into(), parent as usize);
            let read = side.read(&points);
            for (lane, inside) in (0..).zip(read.inside.to_array()) {
                let found = (inside, 4 * parent + lane);
                if inside > next[0].0 {
                    next = [found, next[0]];
                } else if inside > next[1].0 {
                    next[1] = found;
                }
            }
            if read.in_contact != 0 && read.inside.simd_gt(f32x4::splat(best.reach * side.reach())).any() {
                side.contacts(&points, &read, |lane, found| {
                    if found.reach > best.reach {
                        let index = 4 * parent + lane as u32;
                        best = ContactSample { sample: Sample { level, index }, ..found };
                    }
                });
            }
        }
        followed = [next[0].1, next[1].1, NONE, NONE];
    }
    best
}

#[cfg(test)]
mod tests {
    use palpate_core::TriMesh;
    use palpate_models::Model;

    use super::*;
    use crate::body::FieldOptions;
    use crate::query::{FieldQuery, FieldSettings};

    /// A cube whose corners are at ±1 m.
    fn cube() -> TriMesh {
        let corner = |i: u32| {
            let at = |bit: u32| if i >> bit & 1 == 0 { -1.0 } else { 1.0 };
            DVec3::new(at(0), at(1), at(2))
        };
        #[rustfmt::skip]
        let triangles = vec![
            [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
            [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
        ];
        TriMesh::new((0..8).map(corner).collect(), triangles).expect("a mesh")
    }

    /// A lattice of 4 cm rounds off the corner of a cube; what is told of it is as deep as the corner is.
    #[test]
    fn a_corner_is_as_deep_as_the_mesh_says() {
        let d = 0.02;
        let body = FieldBody::with(&cube(), 0.04, (d, 4.0 * d), 0.02);
        let mut query = FieldQuery::new(&body, &body, 0.25);
        let corner_down = DQuat::from_rotation_arc(DVec3::ONE.normalize(), DVec3::NEG_Z);
        let (mut measured, mut by_field) = (0.0_f64, 0.0_f64);
        for step in 0..200 {
            // It slides over the upper face, at different depths, and turns about the vertical.
            let time = 0.01 * f64::from(step);
            let wanted = 0.5 * d * (3.0 * time).sin();
            let turn = DQuat::from_rotation_z(0.3 * time) * corner_down;
            let pose =
                Pose::new(DVec3::new(0.2 * time, 0.1 - 0.3 * time, 1.0 + 3.0_f64.sqrt() - wanted), turn);
            query.run(&body, &body, &pose, &Pose::IDENTITY, &FieldSettings::new(d));
            let mut found = Vec::new();
            query.append_contacts(&body, &pose, &mut found);
            let deepest = found.iter().map(|found| found.contact.depth).fold(f64::NEG_INFINITY, f64::max);
            measured = measured.max((deepest - wanted).abs());
            let samples = query.samples().map(|sample| f64::from(sample.reach - 1.0) * d);
            by_field = by_field.max((samples.fold(f64::NEG_INFINITY, f64::max) - wanted).abs());
        }
        assert!(measured < 1e-6 * d, "{measured} m off");
        assert!(by_field > 0.05 * d, "samples alone are {by_field} m off");
    }

    /// The places that are followed are the deepest of all vertices, wherever the bodies go.
    #[test]
    fn no_vertex_is_deeper_than_is_told() {
        let mesh = Model::Gear.generate(3000).expect("in range");
        let radius = mesh.bounding_sphere().radius;
        let d = 0.01 * radius;
        let body = FieldBody::new(&mesh, &FieldOptions { memory: 1_000_000, ..FieldOptions::new(d) });
        let mut query = FieldQuery::new(&body, &body, 0.25);
        let deepest_at = |pose: &Pose| {
            let depths = [*pose, pose.inverse()].into_iter().flat_map(|to_other| {
                let place = move |vertex: &DVec3| to_other.transform_point(*vertex);
                let exact = &body.features.exact;
                mesh.vertices().iter().map(move |vertex| -exact.nearest(place(vertex), 0).distance)
            });
            depths.fold(0.0, f64::max)
        };
        // How far apart they overlap by a tolerance.
        let mut apart = 2.0 * radius;
        while deepest_at(&Pose::from_translation(DVec3::X * apart)) < d {
            apart -= 0.1 * d;
        }
        let (mut off, mut inside, mut missed) = (0.0_f64, 0, 0);
        for step in 0..300 {
            let time = 0.01 * f64::from(step);
            let turn = DQuat::from_rotation_z(0.02 * time.sin()) * DQuat::from_rotation_x(0.02 * time);
            let away = apart + 0.5 * d * (5.0 * time).sin();
            let pose = Pose::new(DVec3::new(away, 0.01 * time * radius, 0.0), turn);
            query.run(&body, &body, &pose, &Pose::IDENTITY, &FieldSettings::new(d));
            let mut found = Vec::new();
            query.append_contacts(&body, &pose, &mut found);
            let told = found.iter().map(|found| found.contact.depth).fold(0.0, f64::max);
            let deepest = deepest_at(&pose);
            off = off.max(deepest - told);
            inside += usize::from(deepest > 0.1 * d);
            missed += usize::from(deepest > told + 0.05 * d);
        }
        assert!(inside > 100, "{inside} poses overlap");
        assert!(missed == 0, "{missed} of {inside} poses are deeper than is told, by up to {off} m");
    }
}
