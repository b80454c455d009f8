//! Representative contacts: integrals over the area of contact, a cell of the probe's surroundings and a direction at a time.
//!
//! Samples of either surface are asked for their distance from the other body: those that were [selected](crate::selector) at a pose
//! that the bodies have not moved far from.

use std::time::{Duration, Instant};

use glam::Vec3A;
use palpate_core::{Contact, Pose};
use wide::f32x4;

use crate::area_law::AreaContact;
use crate::body::FieldBody;
use crate::cells::{Cell, Cells, ContactSample};
use crate::deepest::deepest_around;
use crate::front::{FURTHER, Front, SLACK, STEEPEST};
use crate::selection::{Held, SelectedFour};
use crate::selector::Selector;
use crate::side::Side;
use crate::slack::{changes, motion_bound};
use crate::steady::Steady;

/// Cells that push by less than this part of the strongest do not count for the error.
const WEAK: f32 = 0.1;

/// So many of the deepest places are looked for among the finest samples.
const REFINED: usize = 8;

/// Samples are selected up to this part of the tolerance beyond it.
const MARGIN: f64 = 0.5;
/// A selection holds until something that was left out may be in contact by this part of the tolerance: 1 would be until it may
/// penetrate, but for what interpolated distances are off by, which [`SLACK`] sees to.
const LATE: f64 = 1.0;
/// And until a selected sample has come nearer by this part of the margin: what was left out nearby will hardly have come nearer by
/// more.
const CHANGED: f64 = 0.75;
/// A selection is made in the course of at most about so many queries, and in no more than this part of the time that it holds for.
const STEPS: f64 = 8.0;
const AHEAD: f64 = 0.8;
/// A selection is made for a pose that is this part of the motion that it holds for ahead, but no more than so many queries.
const LEAD: f64 = 0.5;
const LONGEST_LEAD: f64 = 64.0;
/// It fades in over so many queries, or in this part of the time that it holds for as fast as bodies move; where that is short, at once,
/// for the force changes by more as they move so fast than it does from one selection to the next.
const FADE: f64 = 64.0;
const FADED: f64 = 0.04;
const SHORT: f64 = 4.0;

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

/// The workspace of queries between two bodies. It keeps what the last queries selected to read, so that results depend on these, within
/// the error.
#[derive(Clone, Debug)]
pub struct FieldQuery {
    selector: Selector,
    /// What is read, and what was read before it, which counts for a part that fades.
    held: Held,
    fading: Held,
    part: f64,
    /// By how much less it counts in each query, and what part of its motion was used up when it began to fade.
    fade: (f64, f64),
    /// What they were selected for.
    purpose: Purpose,
    /// That it took to make the last selection.
    effort: usize,
    /// By how much a sample comes nearer, and by how much one goes further away, from query to query, m.
    rates: [f64; 2],
    /// The pose of the last query, probe to scene object.
    last: Option<Pose>,
    cells: Cells,
    /// Edge of a cube, m.
    edge: f64,
    outcome: FieldOutcome,
}

/// What a selection is made for.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Purpose {
    /// d, m.
    tolerance: f64,
    /// Surfaces as close as this are selected, m.
    reach: f64,
    /// No distance between the surfaces may have changed by more, m.
    allowed: f64,
    /// And no selected sample may have come nearer by more, m.
    changeable: f64,
    /// Samples within reach that there are to be around a place.
    needed: f32,
}

impl Purpose {
    fn new(settings: &FieldSettings, probe: &FieldBody, scene: &FieldBody) -> Self {
        let band = probe.field.band().min(scene.field.band());
        let tolerance = settings.tolerance.min(band);
        let reach = (tolerance * (1.0 + MARGIN)).min(band);
        let margin = reach - tolerance;
        let spacing = probe.field.spacing().max(scene.field.spacing());
        let allowed =
            (margin - f64::from(SLACK) * spacing).max(margin / f64::from(STEEPEST)) + LATE * tolerance;
        // Of those within reach some are not in contact.
        let needed = settings.samples() * (reach / tolerance).powf(1.5) as f32;
        Self { tolerance, reach, allowed, changeable: CHANGED * margin, needed }
    }
}

impl FieldQuery {
    /// Between a probe and a scene object; cells are cubes with an edge of a part of the probe's radius.
    pub fn new(probe: &FieldBody, scene: &FieldBody, edge: f64) -> Self {
        let across = 2 * ((1.0 / edge).ceil() as u32 + 1);
        Self {
            selector: Selector::new([probe, scene].map(|body| Front::new(&body.samples)), across),
            held: Held::new(),
            fading: Held::new(),
            part: 0.0,
            fade: (0.0, 0.0),
            purpose: Purpose::default(),
            effort: 0,
            rates: [0.0; 2],
            last: None,
            cells: Cells::new(across, edge * probe.radius),
            edge: edge * probe.radius,
            outcome: FieldOutcome::default(),
        }
    }

    /// Forgets what earlier queries found.
    pub fn reset(&mut self) {
        self.selector.reset();
        self.held.at = None;
        self.fading.at = None;
        self.part = 0.0;
        self.rates = [0.0; 2];
        self.last = None;
    }

    /// What the last query took.
    pub fn outcome(&self) -> FieldOutcome {
        self.outcome
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        size_of::<Self>()
            + self.cells.bytes()
            + self.selector.bytes()
            + self.held.bytes()
            + self.fading.bytes()
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
        let limit = settings.budget.map(|budget| (Instant::now(), budget));
        let purpose = Purpose::new(settings, probe, scene);
        if self.purpose != purpose {
            self.purpose = purpose;
            self.reset();
        }
        self.outcome = FieldOutcome::default();
        let to_scene = scene_pose.inverse() * *probe_pose;
        let motion = Steady::new(self.last.replace(to_scene), &to_scene, probe);
        let before = self.held.at;
        self.select(probe, scene, &motion, limit);
        let sides = self.sides(probe, scene, &to_scene, purpose.tolerance);
        self.evaluate(&sides);
        if self.held.at == before && self.has_changed() {
            // It does not hold here after all.
            self.select(probe, scene, &motion, limit);
            self.evaluate(&sides);
        }
        self.bound(settings.most, &sides);
        self.conclude(probe, scene);
    }

    /// Sums up what is in contact of the selected samples.
    fn evaluate(&mut self, sides: &[Side; 2]) {
        let purpose = self.purpose;
        self.cells.clear();
        for (held, part) in [(&mut self.held, 1.0 - self.part), (&mut self.fading, self.part)] {
            if part == 0.0 {
                continue;
            }
            let mut changes = [f32x4::ZERO; 2];
            for (side, selection) in sides.iter().zip(&held.sides) {
                let per_unit = f32x4::splat((side.field.spacing() / purpose.reach) as f32);
                let further = f32x4::splat((1.0 - purpose.tolerance / purpose.reach) as f32);
                for SelectedFour { points, areas, reaches, samples } in selection.fours() {
                    let read = side.read(&points);
                    let nearer = read.inside * per_unit + further - reaches;
                    changes = [changes[0].fast_max(nearer), changes[1].fast_max(-nearer)];
                    if read.in_contact != 0 {
                        side.contacts(&points, &read, |lane, found| {
                            if let (Some(area), Some(sample)) = (areas.get(lane), samples.get(lane)) {
                                let found = ContactSample { area: *area, sample: *sample, ..found };
                                self.cells.add(&found, part as f32);
                            }
                        });
                    }
                }
            }
            let changes = changes
                .map(|four| purpose.reach * f64::from(four.to_array().into_iter().fold(0.0, f32::max)));
            if let Some(before) = held.changes.replace(changes) {
                self.rates = [0, 1].map(|way| (changes[way] - before[way]).max(0.0));
            }
            self.outcome.samples += held.len();
        }
    }

    /// Whether a selected sample has come nearer by more than a selection holds for.
    fn has_changed(&self) -> bool {
        self.held.changes.is_some_and(|[nearer, _]| nearer > self.purpose.changeable)
    }

    /// Sees to it that there is a selection that holds where bodies have come to.
    fn select(
        &mut self,
        probe: &FieldBody,
        scene: &FieldBody,
        motion: &Steady,
        limit: Option<(Instant, Duration)>,
    ) {
        let Purpose { allowed, changeable, .. } = self.purpose;
        let to_scene = &motion.pose;
        // Parts of what a selection holds for that are used up so far, and in each query.
        let moved = self.moved(&self.held, probe, scene, to_scene);
        let [nearer, _] = self.held.changes.unwrap_or_default();
        let step = motion.step / allowed;
        let fades = Some((FADED / step).min(FADE)).filter(|fades| *fades >= SHORT).unwrap_or(0.0);
        // It is made for where the bodies will be, so that it holds before and after, unless they leap.
        let [approach, recession] = self.rates;
        let lead = (LEAD / step).min(0.5 * changeable / recession).min(LONGEST_LEAD);
        let lead = if lead < LEAD || self.has_changed() { 0.0 } else { lead };
        let is_complete = self.selector.is_complete();
        let apart = |from: &Pose| motion_bound(from, to_scene, probe.center, probe.radius);
        let holds = moved <= 1.0 && !self.has_changed() && is_complete;
        if holds {
            // The next one is made while this one holds, as late as that can be, but for the time that it takes to fade in.
            let steps = (AHEAD * (1.0 + LEAD) / step).floor().clamp(1.0, STEPS);
            if self.selector.pose().is_none() {
                let then = 1.25 * steps + fades + 1.0;
                if nearer + then * approach > changeable
                    || self.moved(&self.held, probe, scene, &motion.after(then)) > 1.0
                {
                    self.begin(probe, scene, &motion.after(steps + lead));
                }
            }
            self.go_on(probe, scene, (self.effort as f64 / steps) as usize, limit);
        } else {
            if !is_complete || self.selector.pose().is_none_or(|begun| apart(begun) >= allowed) {
                let lead = if limit.is_none() { lead } else { 0.0 };
                self.begin(probe, scene, &motion.after(lead));
            }
            self.selector.limit(limit);
            self.go_on(probe, scene, usize::MAX, None);
        }
        let is_nearer = |made: &Pose| apart(made) < self.held.at.as_ref().map_or(allowed, apart).min(allowed);
        if self.selector.is_done() && (!holds || self.selector.pose().is_some_and(is_nearer)) {
            self.effort = self.selector.effort();
            std::mem::swap(&mut self.held, &mut self.fading);
            self.selector.finish(&mut self.held);
            self.part = if fades > 0.0 && moved < 1.0 && is_complete { 1.0 } else { 0.0 };
            self.fade = (1.0 / fades, moved);
        }
        if self.part > 0.0 {
            // Nothing of what was read before is left where it holds no longer.
            let moved = self.moved(&self.fading, probe, scene, to_scene);
            let (step, from) = self.fade;
            self.part = (self.part - step).min((1.0 - moved) / (1.0 - from)).max(0.0);
        }
    }

    /// What part has been used up of the motion that a selection holds for.
    fn moved(&self, held: &Held, probe: &FieldBody, scene: &FieldBody, to_scene: &Pose) -> f64 {
        let Some(from) = &held.at else { return f64::INFINITY };
        let Purpose { tolerance, reach, allowed, .. } = self.purpose;
        let changes = changes(from, to_scene, probe.center, probe.radius, tolerance);
        let levels = self.selector.region_levels();
        let sides = held.sides.iter().zip([probe, scene]).zip(levels).zip(&changes);
        let moved = sides.map(|(((selection, body), level), change)| {
            let [near, most] = selection.moved(&body.samples, level, change, tolerance);
            (near / allowed).max(most / (allowed + f64::from(FURTHER) * reach))
        });
        moved.fold(0.0, f64::max)
    }

    /// Begins a selection at a pose.
    fn begin(&mut self, probe: &FieldBody, scene: &FieldBody, to_scene: &Pose) {
        let reach = self.purpose.reach;
        let sides = self.sides(probe, scene, to_scene, reach);
        self.selector.begin(to_scene, (probe.center, probe.radius), reach, &sides);
    }

    /// Goes on with a selection that was begun by at least a step, until it is done, some effort has been made, or time is over.
    fn go_on(
        &mut self,
        probe: &FieldBody,
        scene: &FieldBody,
        effort: usize,
        limit: Option<(Instant, Duration)>,
    ) {
        let Some(pose) = self.selector.pose().copied() else { return };
        let Purpose { reach, needed, .. } = self.purpose;
        let sides = self.sides(probe, scene, &pose, reach);
        let (before, [spheres, samples]) = (self.selector.effort(), self.selector.read());
        while !self.selector.is_done() && self.selector.effort() - before < effort {
            self.selector.step(&sides, reach, needed);
            if limit.is_some_and(|(begun, budget)| begun.elapsed() >= budget) {
                break;
            }
        }
        let read = self.selector.read();
        self.outcome.spheres += read[0] - spheres;
        self.outcome.samples += read[1] - samples;
    }

    /// Both bodies' samples in the other's field at a pose, probe to scene object, for surfaces within a distance, m.
    fn sides<'a>(
        &self,
        probe: &'a FieldBody,
        scene: &'a FieldBody,
        to_scene: &Pose,
        reach: f64,
    ) -> [Side<'a>; 2] {
        let place = (probe.center, self.selector.across(), self.edge);
        [
            Side::new(&probe.samples, &scene.field, to_scene, true, reach, place),
            Side::new(&scene.samples, &probe.field, &to_scene.inverse(), false, reach, place),
        ]
    }

    /// Bounds the number of contacts, and looks for the deepest of them among the finest samples.
    fn bound(&mut self, most: usize, [own, other]: &[Side; 2]) {
        self.cells.bound(most / 2, self.selector.across());
        let told: usize = self.cells.iter().map(|cell| 1 + usize::from(!cell.penetrates())).sum();
        for touch in self.cells.keep_deepest(most.saturating_sub(told), REFINED).take(REFINED) {
            *touch = deepest_around(if touch.is_probe { own } else { other }, touch);
        }
    }

    /// Tells how far off the contacts are.
    fn conclude(&mut self, probe: &FieldBody, scene: &FieldBody) {
        self.outcome.contacts = self.cells.contacts();
        self.outcome.is_complete = self.selector.is_complete();
        let Purpose { tolerance, .. } = self.purpose;
        let strongest = self.cells.iter().map(|cell| cell.weight).fold(0.0, f32::max);
        let counted = self.cells.iter().filter(|cell| cell.weight > WEAK * strongest);
        let error = counted.map(Cell::error).reduce(f32::max);
        self.outcome.error =
            error.map_or(0.0, |error| f64::from(error) * tolerance + probe.error.max(scene.error));
        let band = probe.field.band().min(scene.field.band());
        let depth = |touch: &ContactSample| (f64::from(touch.reach) - 1.0) * tolerance;
        self.outcome.is_too_deep =
            self.cells.iter().any(|cell| depth(&cell.deepest) > (1.0 - ROUNDING) * band);
    }

    /// The contacts of the last query, which was at this pose of the probe: one a cell, at the centre of its push, with the
    /// depth, the direction and the area that push as all of the cell does by the [`AreaLaw`](crate::AreaLaw); and its deepest
    /// sample, with no area.
    pub fn append_contacts(&self, probe: &FieldBody, pose: &Pose, into: &mut Vec<AreaContact>) {
        let (tolerance, unit_area) = (self.purpose.tolerance, self.edge * self.edge);
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

    use glam::{DQuat, DVec3};
    use palpate_core::TriMesh;

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

    /// In, across by some radians for each of the way in and out, and out again, with a leap now and then.
    fn path(steps: u32, speed: f64, across: f64) -> impl Iterator<Item = Pose> {
        (0..steps).map(move |step| {
            let phase = speed * f64::from(step);
            let turn = DQuat::from_scaled_axis(DVec3::new(0.3, 0.2, 1.0) * across * phase);
            let leap = if step % 400 == 399 { 0.5 } else { 0.0 };
            Pose::new(turn * DVec3::X * (1.98 + 0.05 * (3.0 * phase).sin() + leap), DQuat::IDENTITY)
        })
    }

    #[test]
    fn queries_agree_with_those_from_scratch_and_repeat_bit_by_bit() {
        let (d, error) = (0.01, 0.06 * 0.01);
        let body = FieldBody::with(&ball(1.0, 4), 0.02, (d, 2.0 * d), 0.02);
        let [mut tracked, mut again, mut cold] = [0; 3].map(|_| FieldQuery::new(&body, &body, REACH));
        let settings = FieldSettings { error, ..FieldSettings::new(d) };
        let mut law = AreaLaw::new(body.center, body.radius, REACH);
        let (mut read, mut touching) = ([0; 2], 0);
        for (step, pose) in path(2000, 1e-3, 1.0).enumerate() {
            cold.reset();
            let [own, other, fresh] = [&mut tracked, &mut again, &mut cold].map(|query| {
                query.run(&body, &body, &pose, &Pose::IDENTITY, &settings);
                let mut found = Vec::new();
                query.append_contacts(&body, &pose, &mut found);
                found
            });
            assert_eq!(own, other, "step {step}");
            let [own, fresh] = [own, fresh].map(|found| law.wrench(&found, d, &pose, pose.translation).force);
            assert!(own.distance(fresh) < 2.0 * error, "step {step}: {own} for {fresh}");
            touching += usize::from(own.length() > 0.1 * d);
            for (read, query) in read.iter_mut().zip([&tracked, &cold]) {
                *read += query.outcome().spheres + query.outcome().samples;
            }
        }
        assert!(touching > 500 && 3 * read[0] < read[1], "{touching} touching, {read:?} read");
    }

    #[test]
    fn one_selection_fades_into_the_next() {
        let d = 0.01;
        let body = FieldBody::with(&ball(1.0, 5), 0.01, (d, 2.0 * d), 0.004);
        let settings = FieldSettings { error: 0.1 * d, ..FieldSettings::new(d) };
        // The largest change of the force right after another selection has been made.
        let largest = |fades: bool| {
            let mut query = FieldQuery::new(&body, &body, REACH);
            let mut law = AreaLaw::new(body.center, body.radius, REACH);
            let (mut last, mut was_new, mut largest, mut selections) = (DVec3::ZERO, false, 0.0_f64, 0);
            for index in 0..2000 {
                let across = 2e-3 * d * f64::from(index);
                let pose = Pose::from_translation(DVec3::new(2.0 + 0.5 * d - 0.5 * across, across, 0.0));
                let before = query.held.at;
                query.run(&body, &body, &pose, &Pose::IDENTITY, &settings);
                let mut found = Vec::new();
                query.append_contacts(&body, &pose, &mut found);
                let force = law.wrench(&found, d, &pose, pose.translation).force;
                if was_new {
                    largest = largest.max(last.distance(force));
                }
                last = force;
                was_new = query.held.at != before && index > 0;
                selections += usize::from(was_new);
                if !fades {
                    query.part = 0.0;
                }
            }
            assert!(selections > 4, "{selections} selections");
            largest / d
        };
        let (faded, sudden) = (largest(true), largest(false));
        assert!(5.0 * faded < sudden, "by {faded} k d, and suddenly by {sudden} k d");
    }

    #[test]
    fn nothing_that_penetrates_is_left_out_while_bodies_move() {
        let d = 0.01;
        let body = FieldBody::with(&ball(1.0, 4), 0.01, (d, 2.0 * d), 0.02);
        // All samples are to be read.
        let settings = FieldSettings { error: 1e-9 * d, ..FieldSettings::new(d) };
        let (mut found, mut kept) = (0, 0);
        for (speed, across) in [(1e-3, 1.0), (3e-3, 1.0), (1e-2, 0.0), (3e-2, 0.0), (0.1, 0.0)] {
            let mut query = FieldQuery::new(&body, &body, REACH);
            for (step, pose) in path(300, speed, across).enumerate() {
                let before = query.held.at;
                query.run(&body, &body, &pose, &Pose::IDENTITY, &settings);
                kept += usize::from(query.held.at == before);
                let sides = query.sides(&body, &body, &pose, d);
                for (side, selection) in sides.iter().zip(&query.held.sides) {
                    let penetrating = |points: [f32x4; 3], lanes: usize| {
                        let inside = side.distances(&points).to_array();
                        inside[..lanes].iter().filter(|distance| **distance < 0.0).count()
                    };
                    let all: usize = (0..body.samples.fours(0))
                        .map(|four| penetrating(body.samples.four(0, four), 4))
                        .sum();
                    let selected: usize =
                        selection.fours().map(|four| penetrating(four.points, four.samples.len())).sum();
                    assert_eq!(selected, all, "speed {speed}, step {step}");
                    found += all;
                }
            }
        }
        assert!(found > 10_000 && kept > 300, "{found} penetrating, {kept} selections kept");
    }

    #[test]
    fn a_long_and_thin_body_takes_no_more_room() {
        // A needle along a diagonal, and contacts that are close in comparison with it.
        let needle = block(-DVec3::splat(1e-4), DVec3::new(1e-4, 1e-4, 2.0));
        let turn = DQuat::from_rotation_arc(DVec3::Z, DVec3::ONE.normalize());
        let vertices = needle.vertices().iter().map(|v| turn * *v).collect();
        let needle = TriMesh::new(vertices, needle.triangles().to_vec()).expect("a mesh");
        let options = FieldOptions { memory: 1_000_000, ..FieldOptions::new(1e-5) };
        let body = FieldBody::new(&needle, &options);
        assert!(body.bytes() < 50_000_000, "{} bytes", body.bytes());
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
