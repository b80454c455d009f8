//! Queries for representative contacts: integrals over the area of contact, by cube of the probe's
//! surroundings and direction.
//!
//! The distances of samples of either surface are read in the other body's field: of those samples that were
//! [selected](crate::selector) at a pose that the bodies have not moved far from.

use std::time::{Duration, Instant};

use glam::Vec3A;
use palpate_core::{Contact, Pose};
use wide::f32x4;

use crate::area_law::AreaContact;
use crate::body::FieldBody;
use crate::cells::{Cell, Cells, ContactSample};
use crate::deepest::{Bodies, DeepestPlaces, MAX_PLACES, Measured};
use crate::front::{Front, MAX_SLOPE, NEAR_MARGIN, SLACK};
use crate::selection::{Held, SelectedFour};
use crate::selector::{Limit, Selector};
use crate::side::Side;
use crate::slack::{changes, motion_bound};
use crate::steady::Steady;

/// Smallest weight of a cell that counts for the error, as a fraction of the largest.
const MIN_COUNTED_WEIGHT: f32 = 0.1;

/// Distance beyond the tolerance up to which samples are selected, as a fraction of it. A larger one makes
/// selections hold longer, and read more samples.
const SELECTION_MARGIN: f64 = 0.5;
/// Largest depth δ + d, in tolerances, that a sample that was left out may reach while a selection holds.
/// With 1, none penetrates but for the error of interpolated distances, which [`SLACK`] covers.
const MAX_MISSED_REACH: f64 = 1.0;
/// Largest approach of a selected sample while a selection holds, as a fraction of the margin: samples nearby
/// that were left out will hardly have approached by more.
const MAX_APPROACH: f64 = 0.75;
/// Largest number of queries, approximately, in the course of which a selection is made.
const MAX_SELECTION_QUERIES: f64 = 8.0;
/// Largest fraction of the time that a selection holds in which the next one is made.
const TIME_SHARE: f64 = 0.8;
/// Lead of the pose that a selection is made for, as a fraction of the motion for which it holds; also the
/// smallest lead, in queries.
const LEAD: f64 = 0.5;
/// Largest lead, in queries.
const MAX_LEAD: f64 = 64.0;
/// Largest number of queries over which a selection fades in.
const MAX_FADE: f64 = 64.0;
/// Time over which a selection fades in, as a fraction of the time that it holds at the present speed.
const FADE_SHARE: f64 = 0.04;
/// Smallest number of queries of a fade. If it would be shorter, the selection counts at once: at such a
/// speed the force changes more by the motion than from one selection to the next.
const MIN_FADE: f64 = 4.0;

/// Default of the largest work of a query. With more, queries take longer where bodies are fast; with less,
/// forces there are less accurate.
const MAX_EFFORT: usize = 1500;

/// The same for the first query and after a leap, in efforts of others: these are to be accurate, though they
/// take longer.
const FIRST_EFFORT: usize = 32;

/// Smallest motion from one query to the next that is a leap, in motions for which a selection holds.
const MIN_LEAP: f64 = 4.0;

/// Rounding of bounds in single precision, as a fraction of them.
const ROUNDING: f64 = 1e-5;

/// Settings of a query.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FieldSettings {
    /// d: surfaces closer than this are in contact, m. At most the tolerance that the bodies were prepared
    /// for.
    pub tolerance: f64,
    /// EPS: largest error of the depth by which each cell pushes, m. It determines the number of samples
    /// read.
    pub error: f64,
    /// Largest number of contacts reported, at least 16. If there are more, those of neighbouring cells are
    /// joined.
    pub max_contacts: usize,
    /// Largest work of a query on choosing samples, in units of about one reading of a sample. What would
    /// take longer is left to the next queries: until then, there are fewer samples, and the error is
    /// larger. The first query and those after a leap may take 32 times as long.
    pub effort: usize,
    /// Time limit of a query, if there is one: samples for which there is no time are left out, the finest
    /// first.
    pub budget: Option<Duration>,
}

impl FieldSettings {
    /// Settings for at most 256 contacts within a tolerance (d, m), to an error of 5 % of it, without a time
    /// limit.
    pub fn new(tolerance: f64) -> Self {
        Self { tolerance, error: 0.05 * tolerance, max_contacts: 256, effort: MAX_EFFORT, budget: None }
    }

    /// Number of samples in contact needed around a place: depths have a standard deviation of about half the
    /// tolerance, and the mean of stratified samples has about 0.8 of the standard error of random ones.
    fn samples(&self) -> f32 {
        let spread = 0.5 * 0.8 * self.tolerance;
        (spread / self.error).powi(2) as f32
    }
}

/// Results and cost of a query.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FieldOutcome {
    /// EPS reached, m, the error of the depths by which cells push: the larger field's
    /// [error](FieldBody::error) plus the largest standard error of a cell with at least a tenth of the
    /// largest weight. 0 without contacts.
    pub error: f64,
    /// Whether all samples needed were read; false if there was no work or time left for the finest.
    pub is_complete: bool,
    /// Whether a sample is deeper than the fields' band, so that it pushes by less than its depth.
    pub is_too_deep: bool,
    /// Number of spheres whose distances were read.
    pub spheres: usize,
    /// Number of samples whose distances were read.
    pub samples: usize,
    /// Number of samples in contact.
    pub contacts: usize,
}

/// The workspace of queries between two bodies. It keeps the selections of earlier queries, so that results
/// depend on these, within the error.
#[derive(Clone, Debug)]
pub struct FieldQuery {
    selector: Selector,
    /// The selection in use.
    held: Held,
    /// The selection before it, which fades out.
    fading: Held,
    /// Weight of the fading selection.
    part: f64,
    /// Decrease of that weight in each query, and the fraction of its motion that was used up when it began
    /// to fade.
    fade: (f64, f64),
    /// Purpose of the selections.
    purpose: Purpose,
    /// Work that the last selection took.
    effort: usize,
    /// Largest approach and largest recession of a sample from query to query, m.
    rates: [f64; 2],
    /// The pose of the last query, probe to scene object.
    last: Option<Pose>,
    cells: Cells,
    deepest: DeepestPlaces,
    /// Edge of a cube, m.
    edge: f64,
    outcome: FieldOutcome,
}

/// Purpose of a selection.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Purpose {
    /// d, m.
    tolerance: f64,
    /// Distance up to which surfaces are selected, m.
    reach: f64,
    /// Largest change of any distance between the surfaces while a selection holds, m.
    allowed: f64,
    /// Largest approach of a selected sample while a selection holds, m.
    changeable: f64,
    /// Number of samples within reach needed around a place.
    needed: f32,
}

impl Purpose {
    fn new(settings: &FieldSettings, probe: &FieldBody, scene: &FieldBody) -> Self {
        let band = probe.field.band().min(scene.field.band());
        let tolerance = settings.tolerance.min(band);
        let reach = (tolerance * (1.0 + SELECTION_MARGIN)).min(band);
        let margin = reach - tolerance;
        let spacing = probe.field.spacing().max(scene.field.spacing());
        let allowed = (margin - f64::from(SLACK) * spacing).max(margin / f64::from(MAX_SLOPE))
            + MAX_MISSED_REACH * tolerance;
        // Some of the samples within reach are not in contact, so that more are needed.
        let needed = settings.samples() * (reach / tolerance).powf(1.5) as f32;
        Self { tolerance, reach, allowed, changeable: MAX_APPROACH * margin, needed }
    }
}

impl FieldQuery {
    /// A query between a probe and a scene object; `edge` is that of the cubes, in radii of the probe.
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
            deepest: DeepestPlaces::default(),
            edge: edge * probe.radius,
            outcome: FieldOutcome::default(),
        }
    }

    /// Forgets earlier queries.
    pub fn reset(&mut self) {
        self.selector.reset();
        self.held.at = None;
        self.fading.at = None;
        self.part = 0.0;
        self.rates = [0.0; 2];
        self.last = None;
        self.deepest.clear();
    }

    /// Results and cost of the last query.
    pub fn outcome(&self) -> FieldOutcome {
        self.outcome
    }

    /// The deepest samples by the fields alone.
    #[cfg(test)]
    pub(crate) fn samples(&self) -> impl Iterator<Item = &ContactSample> {
        self.cells.deepest().chain(self.cells.iter().map(|cell| &cell.deepest))
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
        let time = settings.budget.map(|budget| (Instant::now(), budget));
        let limit = Limit { effort: settings.effort, time };
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
            // The readings show that the selection does not hold here.
            self.select(probe, scene, &motion, limit);
            self.evaluate(&sides);
        }
        self.bound(settings.max_contacts);
        self.measure((probe, scene), &motion, &sides);
        self.conclude(probe, scene);
    }

    /// Sums up the selected samples that are in contact.
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
                self.rates = [0, 1].map(|sign| (changes[sign] - before[sign]).max(0.0));
            }
            self.outcome.samples += held.len();
        }
    }

    /// Whether a selected sample has approached by more than a selection allows.
    fn has_changed(&self) -> bool {
        self.held.changes.is_some_and(|[nearer, _]| nearer > self.purpose.changeable)
    }

    /// How many times the work of other queries this one may take.
    fn factor(&self, motion: &Steady) -> usize {
        if motion.step < MIN_LEAP * self.purpose.allowed { 1 } else { FIRST_EFFORT }
    }

    /// Ensures that there is a selection that holds at the present pose.
    fn select(&mut self, probe: &FieldBody, scene: &FieldBody, motion: &Steady, limit: Limit) {
        let Purpose { allowed, changeable, .. } = self.purpose;
        let to_scene = &motion.pose;
        // Fractions of the motion for which a selection holds: used up so far, and in each query.
        let moved = self.moved(&self.held, probe, scene, to_scene);
        let [nearer, _] = self.held.changes.unwrap_or_default();
        let step = motion.step / allowed;
        let fades = Some((FADE_SHARE / step).min(MAX_FADE)).filter(|fades| *fades >= MIN_FADE).unwrap_or(0.0);
        // The selection is made for a later pose, so that it holds before and after that, unless the bodies
        // jump.
        let [approach, recession] = self.rates;
        let lead = (LEAD / step).min(0.5 * changeable / recession).min(MAX_LEAD);
        let lead = if lead < LEAD || self.has_changed() { 0.0 } else { lead };
        let apart = |from: &Pose| motion_bound(from, to_scene, probe.center, probe.radius);
        let holds = moved <= 1.0 && !self.has_changed();
        if holds {
            // The next selection is made while this one holds, as late as its making and fading in allow; at
            // once, if this one has too few samples.
            let steps = (TIME_SHARE * (1.0 + LEAD) / step).floor().clamp(1.0, MAX_SELECTION_QUERIES);
            if self.selector.pose().is_none() {
                let then = 1.25 * steps + fades + 1.0;
                if !self.held.is_complete
                    || nearer + then * approach > changeable
                    || self.moved(&self.held, probe, scene, &motion.after(then)) > 1.0
                {
                    self.begin(probe, scene, &motion.after(steps + lead));
                }
            }
            let each = if self.held.is_complete { (self.effort as f64 / steps) as usize } else { usize::MAX };
            self.go_on(probe, scene, each.min(limit.effort), limit.time);
        } else {
            let left = self.effort.saturating_sub(self.selector.effort());
            if left > limit.effort
                || step >= MIN_LEAP
                || self.selector.pose().is_none_or(|begun| apart(begun) >= allowed)
            {
                self.begin(probe, scene, &motion.after(lead));
            }
            let effort = limit.effort.saturating_mul(self.factor(motion));
            self.selector.limit(Limit { effort, ..limit });
            self.go_on(probe, scene, usize::MAX, None);
        }
        let is_nearer = |made: &Pose| apart(made) < self.held.at.as_ref().map_or(allowed, apart).min(allowed);
        let is_better = !holds || !self.held.is_complete || self.selector.pose().is_some_and(is_nearer);
        if self.selector.is_done() && is_better {
            let effort = self.selector.effort();
            std::mem::swap(&mut self.held, &mut self.fading);
            self.selector.finish(&mut self.held);
            self.effort = if self.held.is_complete { effort } else { effort.max(self.effort) };
            self.part = if fades > 0.0 && moved < 1.0 { 1.0 } else { 0.0 };
            self.fade = (1.0 / fades, moved);
        }
        if self.part > 0.0 {
            // The weight of the fading selection reaches 0 before that selection stops holding.
            let moved = self.moved(&self.fading, probe, scene, to_scene);
            let (step, from) = self.fade;
            self.part = (self.part - step).min((1.0 - moved) / (1.0 - from)).max(0.0);
        }
    }

    /// Fraction used up of the motion for which a selection holds.
    fn moved(&self, held: &Held, probe: &FieldBody, scene: &FieldBody, to_scene: &Pose) -> f64 {
        let Some(from) = &held.at else { return f64::INFINITY };
        let Purpose { tolerance, reach, allowed, .. } = self.purpose;
        let changes = changes(from, to_scene, probe.center, probe.radius, tolerance);
        let levels = self.selector.region_levels();
        let sides = held.sides.iter().zip([probe, scene]).zip(levels).zip(&changes);
        let moved = sides.map(|(((selection, body), level), change)| {
            let [near, most] = selection.moved(&body.samples, level, change, tolerance);
            (near / allowed).max(most / (allowed + f64::from(NEAR_MARGIN) * reach))
        });
        moved.fold(0.0, f64::max)
    }

    /// Begins a selection at a pose.
    fn begin(&mut self, probe: &FieldBody, scene: &FieldBody, to_scene: &Pose) {
        let reach = self.purpose.reach;
        let sides = self.sides(probe, scene, to_scene, reach);
        self.selector.begin(to_scene, (probe.center, probe.radius), reach, &sides);
    }

    /// Continues the selection in progress, by at least a step, until it is done, `effort` has been spent, or
    /// the time is over.
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

    /// Both bodies' samples in the other's field at a pose, probe to scene object, for surfaces within
    /// `reach`, m.
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

    /// Bounds the number of contacts.
    fn bound(&mut self, most: usize) {
        self.cells.bound(most / 2, self.selector.across());
        let reported: usize = self.cells.iter().map(|cell| 1 + usize::from(!cell.penetrates())).sum();
        self.cells.keep_deepest(most.saturating_sub(reported + MAX_PLACES));
    }

    /// Measures the deepest places on the meshes.
    fn measure(&mut self, (probe, scene): (&FieldBody, &FieldBody), motion: &Steady, sides: &[Side<'_>; 2]) {
        let part = self.cells.part();
        let lengths = (self.purpose.tolerance, 2.0 * f64::from(part));
        if self.factor(motion) > 1 {
            self.deepest.clear();
        }
        let bodies = Bodies::new([probe, scene], &motion.pose, lengths);
        self.deepest.measure(
            self.cells.deepest(),
            &bodies,
            sides,
            (0.5 * part, probe.error.max(scene.error)),
        );
    }

    /// Sets the outcome's error and counts.
    fn conclude(&mut self, probe: &FieldBody, scene: &FieldBody) {
        self.outcome.contacts = self.cells.contacts();
        self.outcome.is_complete = self.held.is_complete;
        let Purpose { tolerance, .. } = self.purpose;
        let strongest = self.cells.iter().map(|cell| cell.weight).fold(0.0, f32::max);
        let counted = self.cells.iter().filter(|cell| cell.weight > MIN_COUNTED_WEIGHT * strongest);
        let error = counted.map(Cell::error).reduce(f32::max);
        self.outcome.error =
            error.map_or(0.0, |error| f64::from(error) * tolerance + probe.error.max(scene.error));
        let band = probe.field.band().min(scene.field.band());
        let depth = |touch: &ContactSample| (f64::from(touch.reach) - 1.0) * tolerance;
        self.outcome.is_too_deep =
            self.cells.iter().any(|cell| depth(&cell.deepest) > (1.0 - ROUNDING) * band);
    }

    /// Appends the contacts of the last query, which was at this pose of the probe. One for each cell, at the
    /// centre of its pressure, has the depth, the direction and the area with which it pushes as the whole
    /// cell does by the [`AreaLaw`](crate::AreaLaw); another is at the cell's deepest sample, with no area.
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
        let depth = |reach: f64| (reach - 1.0) * tolerance;
        for cell in self.cells.iter() {
            let pressure = f64::from(cell.pressure);
            // In double precision: in single precision, squares of contacts that barely touch would
            // underflow.
            let reach = cell.push.as_dvec3().length() / pressure;
            if !(reach > 0.0 && reach.is_finite()) {
                continue;
            }
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
        for Measured { point, normal, depth } in self.deepest.iter() {
            into.push(place(*point, *normal, *depth, 0.0));
        }
        let deepest = if self.deepest.is_known() { self.deepest.deepest() } else { f64::INFINITY };
        let measured = |touch: &&ContactSample| !self.deepest.covers(touch.point, self.cells.part());
        for touch in self.cells.deepest().filter(|touch| touch.reach > 1.0).filter(measured) {
            // The places that were not measured are not the deepest.
            let depth = depth(f64::from(touch.reach)).min(deepest);
            into.push(place(touch.point, touch.normal, depth, 0.0));
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
            let settings = FieldSettings { error: 1e-9 * d, effort: usize::MAX, ..FieldSettings::new(d) };
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

    /// In and out again, sideways by `across` radians for each radian of that motion, with a jump now and
    /// then.
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
    fn no_penetrating_sample_is_left_out_while_bodies_move() {
        let d = 0.01;
        let body = FieldBody::with(&ball(1.0, 4), 0.01, (d, 2.0 * d), 0.02);
        // All samples are to be read.
        let settings = FieldSettings { error: 1e-9 * d, effort: usize::MAX, ..FieldSettings::new(d) };
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
        // Powers of two are exact: with other factors, the cuts of surfaces may depend on rounding, as on a
        // ball.
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
    fn depth_beyond_the_field_is_reported() {
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
    fn contacts_are_bounded_and_push_equally() {
        let d = 0.02;
        let body = FieldBody::with(&ball(1.0, 4), 0.02, (d, 2.0 * d), 0.02);
        // One ball nearly in the other's place, shifted by d: the half that is ahead is in contact all over.
        let pose = Pose::from_translation(DVec3::X * 1.8);
        let [free, bounded] = [256, 16].map(|max_contacts| {
            let mut query = FieldQuery::new(&body, &body, REACH);
            query.run(
                &body,
                &body,
                &pose,
                &Pose::IDENTITY,
                &FieldSettings { max_contacts, ..FieldSettings::new(d) },
            );
            let mut contacts = Vec::new();
            query.append_contacts(&body, &pose, &mut contacts);
            assert!(contacts.len() <= max_contacts, "{} contacts", contacts.len());
            let pressures = contacts
                .iter()
                .map(|found| found.area * (found.contact.depth + d).powi(2) * found.contact.normal);
            (contacts.len(), pressures.sum::<DVec3>())
        });
        assert!(free.0 > 16, "{} contacts", free.0);
        assert!(free.1.distance(bounded.1) < 1e-4 * free.1.length(), "{} {}", free.1, bounded.1);
    }

    #[test]
    fn a_budget_ends_a_query_and_that_is_reported() {
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
    fn fast_bodies_take_no_more_work_and_resting_ones_are_refined() {
        let (d, effort) = (0.01, 1000);
        let body = FieldBody::with(&ball(1.0, 5), 0.01, (d, 2.0 * d), 0.005);
        let run = |effort: usize| {
            let mut query = FieldQuery::new(&body, &body, REACH);
            let settings = FieldSettings { effort, error: 0.01 * d, ..FieldSettings::new(d) };
            // By half of the tolerance in each query, on the other ball, and then at rest for as long as one
            // selection fades into the next.
            let (mut most, mut coarse, mut outcomes) = (0, 0, Vec::new());
            for step in 0..220 {
                let angle = 0.5 * d * f64::from(step.min(100));
                let pose = Pose::from_translation(1.99 * DVec3::new(angle.cos(), angle.sin(), 0.0));
                query.run(&body, &body, &pose, &Pose::IDENTITY, &settings);
                let outcome = query.outcome();
                if step > 0 {
                    most = most.max(outcome.spheres + outcome.samples - query.held.len());
                    coarse += usize::from(!outcome.is_complete);
                }
                outcomes.push(outcome);
            }
            (most, coarse, outcomes)
        };
        let (most, coarse, bounded) = run(effort);
        assert!(coarse > 50, "{coarse} queries had too few samples");
        // A level of samples is ended before twice the work, and one of spheres is as large again.
        assert!(most < 4 * effort, "{most} readings");
        let (unbounded, none, whole) = run(usize::MAX);
        assert!(none == 0 && unbounded > 8 * effort, "{none} were coarse, {unbounded} readings");
        let (last, wanted) = (bounded[219], whole[219]);
        assert!(last.is_complete && last.error < 1.2 * wanted.error, "{last:?} for {wanted:?}");
        assert!(bounded[90].error > 1.5 * last.error, "{:?}, and {last:?} at rest", bounded[90]);
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
