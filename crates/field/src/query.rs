//! Representative contacts: integrals over the area of contact, a cell of the probe's surroundings and a direction at a time.
//!
//! Samples of either surface are asked for their distance from the other body. Spheres around samples that are provably out of
//! reach are left out.

use std::time::{Duration, Instant};

use glam::{DVec3, Vec3A};
use palpate_core::{Contact, Pose};

use crate::area_law::AreaContact;
use crate::body::FieldBody;
use crate::cells::{Cell, Cells, ContactSample};
use crate::deepest::deepest_around;
use crate::front::{COARSEST, Front};
use crate::sampling::Sampling;
use crate::side::Side;
use crate::slack::Motion;

/// Cells that push by less than this part of the strongest do not count for the error.
const WEAK: f32 = 0.1;

/// So many of the deepest places are looked for among the finest samples.
const REFINED: usize = 8;

/// Of bounds in single precision, as a part of them.
const ROUNDING: f64 = 1e-5;

/// What a query asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FieldSettings {
    /// d: surfaces closer than this are in contact, m. No more than the bodies were made for.
    pub tolerance: f64,
    /// EPS: how far off the depth may be that each cell pushes by, m. It decides how many samples are read.
    pub error: f64,
    /// Contacts that may be reported at most, at least 16. Where there are more, those of neighbouring cells are joined.
    pub most: usize,
    /// Time for a query, if it is limited: samples that there is no time for are left out, the finest first.
    pub budget: Option<Duration>,
}

impl FieldSettings {
    /// For contacts within a tolerance (d, m), to an error of 5 % of that, 256 at most, without limit of time.
    pub fn new(tolerance: f64) -> Self {
        Self { tolerance, error: 0.05 * tolerance, most: 256, budget: None }
    }

    /// How many samples in contact there are to be around a place. Depths are spread by some half of the tolerance, and the mean of
    /// stratified samples is off by some 0.8 of what that of random ones would be.
    fn samples(&self) -> f32 {
        let spread = 0.5 * 0.8 * self.tolerance;
        (spread / self.error).powi(2) as f32
    }
}

/// What a query found, and what it took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FieldOutcome {
    /// EPS reached, m: how far off the depths are that cells push by, the field's [error](FieldBody::error) and the largest standard
    /// error of a cell that pushes by at least a tenth of what the strongest does. 0 without contacts.
    pub error: f64,
    /// Whether all samples were read that the settings ask for; not so where the budget ended the query.
    pub is_complete: bool,
    /// Whether a sample is deeper inside than the fields reach, so that it pushes by less than its depth.
    pub is_too_deep: bool,
    /// Spheres asked for their distances.
    pub spheres: usize,
    /// Samples asked for their distances.
    pub samples: usize,
    /// Samples in contact.
    pub contacts: usize,
}

/// The workspace of queries between two bodies. It remembers what the last query found to be out of reach, and by how much; the
/// result does not depend on that.
#[derive(Clone, Debug)]
pub struct FieldQuery {
    motion: Motion,
    fronts: [Front; 2],
    sampling: Sampling,
    cells: Cells,
    /// Edge of a cube, m.
    edge: f64,
    /// Of the last query, m.
    tolerance: f64,
    outcome: FieldOutcome,
}

impl FieldQuery {
    /// Between a probe and a scene object; cells are cubes with an edge of a part of the probe's radius.
    pub fn new(probe: &FieldBody, scene: &FieldBody, edge: f64) -> Self {
        let across = 2 * ((1.0 / edge).ceil() as u32 + 1);
        Self {
            motion: Motion::new(),
            fronts: [probe, scene].map(|body| Front::new(&body.samples)),
            sampling: Sampling::new(across),
            cells: Cells::new(across, edge * probe.radius),
            edge: edge * probe.radius,
            tolerance: 0.0,
            outcome: FieldOutcome::default(),
        }
    }

    /// Forgets what earlier queries found.
    pub fn reset(&mut self) {
        self.motion.reset();
    }

    /// What the last query took.
    pub fn outcome(&self) -> FieldOutcome {
        self.outcome
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        size_of::<Self>()
            + self.cells.bytes()
            + self.sampling.bytes()
            + self.fronts.iter().map(Front::bytes).sum::<usize>()
    }

    /// Integrates over the area of contact between the bodies that this query was made for.
    pub fn run(
        &mut self,
        probe: &FieldBody,
        scene: &FieldBody,
        probe_pose: &Pose,
        scene_pose: &Pose,
        settings: &FieldSettings,
    ) {
        self.cells.clear();
        self.sampling.clear();
        self.outcome = FieldOutcome::default();
        let tolerance = settings.tolerance.min(probe.field.band()).min(scene.field.band());
        let begun = settings.budget.map(|budget| (Instant::now(), budget));
        let samples = settings.samples();
        self.tolerance = tolerance;
        let to_scene = scene_pose.inverse() * *probe_pose;
        let sides = [
            Side::new(&probe.samples, &scene.field, &to_scene, true, tolerance, self.place(probe)),
            Side::new(&scene.samples, &probe.field, &to_scene.inverse(), false, tolerance, self.place(probe)),
        ];
        self.move_on(&to_scene, probe, &sides);
        for (front, side) in self.fronts.iter_mut().zip(&sides) {
            front.begin(side.samples);
        }
        let levels = sides.iter().map(|side| side.samples.levels.len()).max().unwrap_or(0);
        let mut last = Duration::ZERO;
        self.outcome.is_complete = true;
        // Bodies of different sizes begin at levels of their own, and end together.
        for level in (0..levels).rev() {
            let Self { fronts, sampling, cells, outcome, .. } = &mut *self;
            let mut own: [_; 2] = std::array::from_fn(|_| None);
            for ((own, front), side) in own.iter_mut().zip(fronts).zip(&sides) {
                *own = (level < side.samples.levels.len()).then_some((front, side));
            }
            for (front, side) in own.iter_mut().flatten() {
                front.visit(side, level, tolerance);
            }
            if level <= COARSEST {
                for (front, side) in own.iter_mut().flatten() {
                    front.add_to(sampling, 2.0 * side.area(level));
                }
                sampling.settle(samples, 0);
                own.iter_mut().flatten().for_each(|(front, _)| front.count(sampling));
                for (front, side) in own.iter_mut().flatten() {
                    front.visit_others(side, level, sampling, tolerance);
                }
                for (front, side) in own.iter_mut().flatten() {
                    front.add_to(sampling, side.area(level));
                }
                if level > 0 {
                    sampling.settle(samples, 1);
                } else {
                    sampling.end();
                }
                if let Some((begun, budget)) = begun.filter(|_| level > 0) {
                    // The next level takes about as long as all before it.
                    let spent = begun.elapsed();
                    if spent + spent.saturating_sub(last) > budget {
                        outcome.is_complete = sampling.end();
                    }
                    last = spent;
                }
                for (front, _) in own.iter_mut().flatten() {
                    front.count(sampling);
                    front
                        .in_contact
                        .iter()
                        .filter(|touch| touch.counted > 0.0)
                        .for_each(|touch| cells.add(touch));
                }
            }
            if level == 0 || sampling.is_ended() {
                break;
            }
            for (front, side) in own.iter_mut().flatten() {
                front.descend(side, level, sampling, tolerance);
            }
        }
        self.outcome.spheres = self.fronts.iter().map(|front| front.read[0]).sum();
        self.outcome.samples = self.fronts.iter().map(|front| front.read[1]).sum();
        self.bound(settings.most, &sides);
        self.conclude(probe, scene);
    }

    /// Where the cubes of the probe's surroundings are: around a point of its frame (m), how many along each axis, and their edge (m).
    fn place(&self, probe: &FieldBody) -> (DVec3, u32, f64) {
        (probe.center, self.sampling.across(), self.edge)
    }

    /// Counts how far the bodies have moved, or forgets what is known where they have moved too far.
    fn move_on(&mut self, to_scene: &Pose, probe: &FieldBody, sides: &[Side; 2]) {
        let changes = self.motion.advance(to_scene, probe.center, probe.radius, self.tolerance);
        let mut fronts = self.fronts.iter_mut().zip(sides).zip(changes);
        if !fronts.all(|((front, side), change)| front.clocks.advance(side.samples, &change)) {
            self.fronts.iter_mut().for_each(Front::forget);
        }
    }

    /// Bounds the number of contacts, and looks for the deepest of them among the finest samples.
    fn bound(&mut self, most: usize, [own, other]: &[Side; 2]) {
        self.cells.bound(most / 2, self.sampling.across());
        let told: usize = self.cells.iter().map(|cell| 1 + usize::from(!cell.penetrates())).sum();
        for touch in self.cells.keep_deepest(most.saturating_sub(told), REFINED).take(REFINED) {
            *touch = deepest_around(if touch.sample.is_probe { own } else { other }, touch);
        }
    }

    /// Tells how far off the contacts are.
    fn conclude(&mut self, probe: &FieldBody, scene: &FieldBody) {
        self.outcome.contacts = self.cells.contacts();
        let strongest = self.cells.iter().map(|cell| cell.weight).fold(0.0, f32::max);
        let counted = self.cells.iter().filter(|cell| cell.weight > WEAK * strongest);
        let error = counted.map(Cell::error).reduce(f32::max);
        self.outcome.error =
            error.map_or(0.0, |error| f64::from(error) * self.tolerance + probe.error.max(scene.error));
        let band = probe.field.band().min(scene.field.band());
        let depth = |touch: &ContactSample| (f64::from(touch.reach) - 1.0) * self.tolerance;
        self.outcome.is_too_deep =
            self.cells.iter().any(|cell| depth(&cell.deepest) > (1.0 - ROUNDING) * band);
    }

    /// The contacts of the last query, which was at this pose of the probe: one a cell, at the centre of its push, with the
    /// depth, the direction and the area that push as all of the cell does by the [`AreaLaw`](crate::AreaLaw); and its deepest
    /// sample, with no area.
    pub fn append_contacts(&self, probe: &FieldBody, pose: &Pose, into: &mut Vec<AreaContact>) {
        let (tolerance, unit_area) = (self.tolerance, self.edge * self.edge);
        let place = |point: Vec3A, normal: Vec3A, depth: f64, area: f64| {
            let point = pose.transform_point(probe.center + point.as_dvec3());
            let normal = pose.transform_vector(normal.as_dvec3().normalize_or_zero());
            AreaContact {
                contact: Contact { point, scene_point: point - depth * normal, normal, depth },
                area,
            }
        };
        for cell in self.cells.iter() {
            let pressure = f64::from(cell.pressure);
            // In double precision, for squares of what barely touches would vanish in single.
            let reach = cell.push.as_dvec3().length() / pressure;
            if !(reach > 0.0 && reach.is_finite()) {
                continue;
            }
            let depth = |reach: f64| (reach - 1.0) * tolerance;
            into.push(place(
                cell.moment / cell.weight,
                cell.push,
                depth(reach),
                unit_area * pressure / reach,
            ));
            if !cell.penetrates() {
                let ContactSample { point, normal, reach, .. } = cell.deepest;
                into.push(place(point, normal, depth(f64::from(reach)), 0.0));
            }
        }
        for touch in self.cells.deepest() {
            into.push(place(touch.point, touch.normal, (f64::from(touch.reach) - 1.0) * tolerance, 0.0));
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use glam::DQuat;
    use palpate_core::TriMesh;
    use wide::f32x4;

    use super::*;
    use crate::area_law::AreaLaw;
    use crate::body::FieldOptions;

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
        let settings = FieldSettings { error: 0.03 * d, ..FieldSettings::new(d) };
        query.run(probe, scene, pose, &Pose::IDENTITY, &settings);
        let mut contacts = Vec::new();
        query.append_contacts(probe, pose, &mut contacts);
        let mut law = AreaLaw::new(probe.center, probe.radius, REACH);
        let deepest = contacts.iter().map(|found| found.contact.depth).fold(f64::NEG_INFINITY, f64::max);
        (law.wrench(&contacts, d, pose, pose.translation).force, deepest)
    }

    #[test]
    fn no_sample_in_contact_is_left_out() {
        let (d, mut found) = (0.01, 0);
        let body = FieldBody::with(&ball(1.0, 4), 0.02, (d, 2.0 * d), 0.02);
        let mut query = FieldQuery::new(&body, &body, REACH);
        for step in 0..20 {
            let turn = DQuat::from_scaled_axis(DVec3::new(0.3, 0.2, 1.0) * f64::from(step));
            // From apart to deep inside.
            let pose = Pose::new(turn * DVec3::X * (2.02 - 0.06 * f64::from(step)), turn);
            let settings = FieldSettings { error: 1e-9 * d, ..FieldSettings::new(d) };
            query.run(&body, &body, &pose, &Pose::IDENTITY, &settings);
            let mut all = 0;
            for (to_field, is_probe) in [(pose, true), (pose.inverse(), false)] {
                let side =
                    Side::new(&body.samples, &body.field, &to_field, is_probe, d, (body.center, 10, REACH));
                for four in 0..body.samples.fours(0) {
                    let distance = side.distances(&body.samples.four(0, four));
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
    fn what_is_remembered_does_not_change_the_result() {
        let (d, mut contacts) = (0.01, 0);
        let body = FieldBody::with(&ball(1.0, 4), 0.02, (d, 2.0 * d), 0.02);
        let [mut tracked, mut cold] = [0; 2].map(|_| FieldQuery::new(&body, &body, REACH));
        let settings = FieldSettings { error: 0.06 * d, ..FieldSettings::new(d) };
        let mut read = [0; 2];
        for step in 0..2000 {
            let phase = 2e-3 * f64::from(step);
            let turn = DQuat::from_scaled_axis(DVec3::new(0.3, 0.2, 1.0) * phase);
            // In, across, and out again, with a leap now and then.
            let leap = if step % 400 == 399 { 0.5 } else { 0.0 };
            let pose =
                Pose::new(turn * DVec3::X * (1.98 + 0.05 * (3.0 * phase).sin() + leap), DQuat::IDENTITY);
            cold.reset();
            for query in [&mut tracked, &mut cold] {
                query.run(&body, &body, &pose, &Pose::IDENTITY, &settings);
            }
            let found = [&tracked, &cold].map(|query| {
                let mut found = Vec::new();
                query.append_contacts(&body, &pose, &mut found);
                found
            });
            assert_eq!(found[0], found[1], "step {step}");
            contacts += tracked.outcome().contacts;
            for (read, query) in read.iter_mut().zip([&tracked, &cold]) {
                *read += query.outcome().spheres + query.outcome().samples;
            }
        }
        assert!(contacts > 10_000 && 2 * read[0] < read[1], "{contacts} contacts, {read:?} read");
    }

    #[test]
    fn scale_changes_nothing_else() {
        // By powers of two, which round nothing: where surfaces are cut in two may else depend on rounding, as on a ball.
        let forces = [1.0 / 1024.0, 1.0, 1024.0].map(|scale: f64| {
            let d = 0.02 * scale;
            let body =
                FieldBody::new(&ball(scale, 4), &FieldOptions { memory: 1_000_000, ..FieldOptions::new(d) });
            let mut query = FieldQuery::new(&body, &body, REACH);
            let turn = DQuat::from_scaled_axis(DVec3::new(0.3, 0.2, 1.0));
            let pose = Pose::new(turn * DVec3::X * 1.995 * scale, turn);
            query.run(&body, &body, &pose, &Pose::IDENTITY, &FieldSettings::new(d));
            let mut contacts = Vec::new();
            query.append_contacts(&body, &pose, &mut contacts);
            let mut law = AreaLaw::new(body.center, body.radius, REACH);
            let FieldOutcome { error, contacts: count, .. } = query.outcome();
            (law.wrench(&contacts, d, &pose, pose.translation).force / scale, error / scale, count)
        });
        let (wanted, error, count) = forces[1];
        assert!(wanted.length() > 0.01 && error > 0.0 && error.is_finite(), "{wanted} {error}");
        for (force, other, others) in forces {
            assert!(force.distance(wanted) < 1e-6 * wanted.length(), "{force} for {wanted}");
            assert!((other - error).abs() < 1e-6 * error, "{other} for {error}");
            assert_eq!(others, count);
        }
    }

    #[test]
    fn what_is_deeper_than_the_field_is_told() {
        let d = 0.02;
        let body = FieldBody::with(&ball(1.0, 4), 0.02, (d, 2.0 * d), 0.02);
        let mut query = FieldQuery::new(&body, &body, REACH);
        for (depth, wanted) in [(1.5 * d, false), (2.5 * d, true)] {
            let pose = Pose::from_translation(DVec3::X * (2.0 - depth));
            query.run(&body, &body, &pose, &Pose::IDENTITY, &FieldSettings::new(d));
            assert_eq!(query.outcome().is_too_deep, wanted, "{depth}");
        }
    }

    #[test]
    fn contacts_are_bounded_and_push_alike() {
        let d = 0.02;
        let body = FieldBody::with(&ball(1.0, 4), 0.02, (d, 2.0 * d), 0.02);
        // One ball nearly in the other's place, shifted by d: the half that is ahead is in contact all over.
        let pose = Pose::from_translation(DVec3::X * 1.8);
        let [free, bounded] = [256, 16].map(|most| {
            let mut query = FieldQuery::new(&body, &body, REACH);
            query.run(&body, &body, &pose, &Pose::IDENTITY, &FieldSettings { most, ..FieldSettings::new(d) });
            let mut contacts = Vec::new();
            query.append_contacts(&body, &pose, &mut contacts);
            assert!(contacts.len() <= most, "{} contacts", contacts.len());
            let pressures = contacts
                .iter()
                .map(|found| found.area * (found.contact.depth + d).powi(2) * found.contact.normal);
            (contacts.len(), pressures.sum::<DVec3>())
        });
        assert!(free.0 > 16, "{} contacts", free.0);
        assert!(free.1.distance(bounded.1) < 1e-4 * free.1.length(), "{} {}", free.1, bounded.1);
    }

    #[test]
    fn a_budget_ends_a_query_and_that_is_told() {
        let d = 0.02;
        let body = FieldBody::with(&ball(1.0, 5), 0.02, (d, 2.0 * d), 0.01);
        let pose = Pose::from_translation(DVec3::X * 1.98);
        let run = |budget| {
            let mut query = FieldQuery::new(&body, &body, REACH);
            let settings = FieldSettings { budget, error: 0.01 * d, ..FieldSettings::new(d) };
            query.run(&body, &body, &pose, &Pose::IDENTITY, &settings);
            query.outcome()
        };
        let (whole, cut) = (run(None), run(Some(Duration::ZERO)));
        assert!(whole.is_complete && !cut.is_complete);
        assert!(cut.contacts > 0 && cut.contacts < whole.contacts / 4, "{cut:?} {whole:?}");
        assert!(cut.error > 1.5 * whole.error, "{cut:?} {whole:?}");
        assert!(run(Some(Duration::from_secs(3600))).is_complete);
    }

    #[test]
    fn a_ball_on_a_block_pushes_by_two_thirds_of_its_reach() {
        let (radius, d) = (1.0, 0.01);
        let probe = FieldBody::with(&ball(radius, 6), 0.015, (d, 2.0 * d), 0.01);
        let scene = FieldBody::with(
            &block(DVec3::new(-2.0, -2.0, -1.0), DVec3::new(2.0, 2.0, 0.0)),
            0.02,
            (d, 2.0 * d),
            0.01,
        );
        let mut query = FieldQuery::new(&probe, &scene, REACH);
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
