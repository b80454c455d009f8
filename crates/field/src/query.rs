//! Representative contacts: integrals over the area of contact, a cell of the probe's surroundings and a direction at a time.
//!
//! Samples of either surface are asked for their distance from the other body. Spheres around samples that are provably out of
//! reach are left out.

use std::time::{Duration, Instant};

use glam::{DAffine3, DMat3, DQuat, DVec3, UVec3, Vec3A};
use palpate_core::{Contact, Pose};
use wide::{f32x4, i32x4};

use crate::area_law::AreaContact;
use crate::body::FieldBody;
use crate::bricks::DistanceField;
use crate::cells::{Cell, Cells, Touch};
use crate::samples::SurfaceSamples;
use crate::slack::{Known, Motion, Sphere};

/// What interpolated distances may change by more than points are apart, in lattice constants: they bend near creases.
const SLACK: f32 = 0.25;

/// Samples around each place, at least: fewer may be as deep as one another by chance.
const FEWEST: f32 = 4.0;
/// Cells that push by less than this part of the strongest do not count for the error.
const WEAK: f32 = 0.1;

/// Of bounds in single precision, as a part of them.
const ROUNDING: f64 = 1e-5;

/// Levels of samples above this one are not read: too few points to stand for a contact.
const COARSEST: usize = 5;

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

    /// How many samples in contact there are to be around a place. Depths within the tolerance are spread by some half of it, and the
    /// mean of stratified samples is off by about half of what that of random ones would be.
    fn samples(&self) -> f32 {
        let spread = 0.5 * 0.5 * self.tolerance;
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
    /// Fours of spheres and of samples asked for their distances.
    pub spheres: usize,
    /// See [`Self::spheres`].
    pub samples: usize,
    /// Samples in contact.
    pub contacts: usize,
}

/// What is in contact in each cube of the probe's surroundings, by the samples of the levels so far: with w how much of a sample
/// counts and p = w a (δ + d), the sums of p, p² / w and p (δ + d).
///
/// (Σ p)² / Σ (p² / w) is the number of samples that carry the load, and Σ p (δ + d) / Σ p their mean δ + d.
#[derive(Clone, Debug)]
struct Load {
    /// Cubes along each axis.
    across: u32,
    /// Of the samples that count.
    settled: Vec<f32x4>,
    /// Of those of the present level.
    present: Vec<f32x4>,
    /// How many samples carry the load around each cube, and the mean of their δ + d, in tolerances.
    around: Vec<[f32; 2]>,
    /// How much of what the samples of the present level push with counts.
    share: Vec<f32>,
    is_used: Vec<bool>,
    /// Cubes that hold contacts.
    used: Vec<u32>,
    /// Whether there is no time for another level.
    is_ended: bool,
}

impl Load {
    fn new(across: u32) -> Self {
        let count = (across * across * across) as usize;
        Self {
            across,
            settled: vec![f32x4::ZERO; count],
            present: vec![f32x4::ZERO; count],
            around: vec![[0.0; 2]; count],
            share: vec![0.0; count],
            is_used: vec![false; count],
            used: Vec::with_capacity(count),
            is_ended: false,
        }
    }

    fn clear(&mut self) {
        self.is_ended = false;
        for cube in self.used.drain(..) {
            let cube = cube as usize;
            (self.settled[cube], self.present[cube]) = (f32x4::ZERO, f32x4::ZERO);
            (self.share[cube], self.is_used[cube]) = (0.0, false);
        }
    }

    /// Adds a sample of the present level: `area` is that of all such samples, of which it has a part.
    #[inline]
    fn add(&mut self, touch: &Touch, area: f32) {
        let cube = touch.cube as usize;
        if !self.is_used[cube] {
            self.is_used[cube] = true;
            self.used.push(touch.cube);
        }
        let pressure = touch.area * touch.reach;
        let moment = pressure * touch.reach;
        self.present[cube] += f32x4::new([pressure, moment * area, moment, 0.0]);
    }

    /// Decides how much counts of the samples of the present level: all where there are twice as many around a place as are asked for,
    /// none where there are fewer. Where contacts push by less than elsewhere, proportionally fewer will do: for the error of the
    /// wrench they make up for one another, and it is least for its price so.
    fn settle(&mut self, samples: f32) {
        let n = self.across;
        let mut most = 0.0f32;
        for index in &self.used {
            let at = UVec3::new(index % n, index / n % n, index / (n * n));
            let (low, high) = (at.saturating_sub(UVec3::ONE), (at + 1).min(UVec3::splat(n - 1)));
            let mut sum = f32x4::ZERO;
            for z in low.z..=high.z {
                for y in low.y..=high.y {
                    let row = ((z * n + y) * n) as usize;
                    let row = row + low.x as usize..=row + high.x as usize;
                    for (settled, present) in self.settled[row.clone()].iter().zip(&self.present[row]) {
                        sum += *settled + *present;
                    }
                }
            }
            let [pressure, squares, moment, _] = sum.to_array();
            let (count, mean) =
                if squares > 0.0 { (pressure * pressure / squares, moment / pressure) } else { (0.0, 0.0) };
            self.around[*index as usize] = [count, mean];
            most = most.max(mean);
        }
        for index in &self.used {
            let cube = *index as usize;
            let [count, mean] = self.around[cube];
            let needed = (samples * mean / most).max(FEWEST);
            self.share[cube] = (count / needed - 1.0).clamp(0.0, 1.0);
            self.settled[cube] += std::mem::take(&mut self.present[cube]) * f32x4::splat(self.share[cube]);
        }
    }

    /// Lets all of the samples of the present level count, so that none of the next do. Returns whether that was so anyway.
    fn end(&mut self) -> bool {
        let mut was_enough = true;
        for cube in &self.used {
            was_enough &= self.share[*cube as usize] == 1.0;
            self.share[*cube as usize] = 1.0;
        }
        self.is_ended = true;
        was_enough
    }

    fn bytes(&self) -> usize {
        let each = 2 * size_of::<f32x4>() + size_of::<[f32; 2]>() + size_of::<f32>() + size_of::<u32>() + 1;
        self.share.capacity() * each
    }
}

/// Four samples of a level that something of is to be looked at.
#[derive(Clone, Copy, Debug)]
struct Four {
    index: u32,
    /// How much of what they push with may count.
    weight: f32,
    /// Of each.
    cubes: [i32; 4],
    /// Bit by bit: what may be in reach below these samples.
    open: u32,
}

/// One body's samples in the other's field.
struct Side<'a> {
    samples: &'a SurfaceSamples,
    field: &'a DistanceField,
    /// Rows of the map from the body to the lattice.
    to_lattice: [[f32; 4]; 3],
    /// From the body to the cubes of the probe's surroundings.
    to_cubes: [[f32; 4]; 3],
    /// From the body to the probe's frame, from its centre.
    to_probe: [[f32; 4]; 3],
    /// Of unit vectors from the field's body outwards to the probe's outwards, in the probe's frame.
    turn: [[f32; 4]; 3],
    /// Of one of the finest samples, as a part of a cell's squared edge.
    area: f32,
    is_probe: bool,
}

/// What a query knows of one body's samples, and has yet to look at.
#[derive(Clone, Debug)]
struct Front {
    known: Known,
    /// Of the present level and of the next.
    now: Vec<Four>,
    next: Vec<Four>,
    /// In contact, of the present level.
    touching: Vec<Touch>,
}

impl Front {
    fn new(samples: &SurfaceSamples) -> Self {
        Self {
            known: Known::new(samples),
            now: Vec::with_capacity(8192),
            next: Vec::with_capacity(8192),
            touching: Vec::with_capacity(8192),
        }
    }

    fn bytes(&self) -> usize {
        self.known.bytes()
            + (self.now.capacity() + self.next.capacity()) * size_of::<Four>()
            + self.touching.capacity() * size_of::<Touch>()
    }
}

/// The workspace of queries between two bodies. It remembers what the last query found to be out of reach, and by how much; the
/// result does not depend on that.
#[derive(Clone, Debug)]
pub struct FieldQuery {
    motion: Motion,
    fronts: [Front; 2],
    load: Load,
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
            load: Load::new(across),
            cells: Cells::new((across * across * across) as usize),
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
            + self.load.bytes()
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
        self.load.clear();
        self.outcome = FieldOutcome::default();
        let tolerance = settings.tolerance.min(probe.field.band()).min(scene.field.band());
        let begun = settings.budget.map(|budget| (Instant::now(), budget));
        let samples = settings.samples();
        let settings = &FieldSettings { tolerance, ..*settings };
        self.tolerance = tolerance;
        let to_scene = scene_pose.inverse() * *probe_pose;
        if !self.motion.advance(&to_scene, probe.center, probe.radius, tolerance) {
            self.fronts.iter_mut().for_each(|front| front.known.forget());
        }
        let place = |body, field, to_field, is_probe| {
            Side::new(body, field, to_field, is_probe, (probe.center, self.load.across, self.edge))
        };
        let sides = [
            place(&probe.samples, &scene.field, &to_scene, true),
            place(&scene.samples, &probe.field, &to_scene.inverse(), false),
        ];
        for (front, side) in self.fronts.iter_mut().zip(&sides) {
            front.now.clear();
            if side.samples.levels.len() > 1 {
                front.now.push(Four { index: 0, weight: 1.0, cubes: [0; 4], open: 0 });
            }
        }
        let levels = sides.iter().map(|side| side.samples.levels.len()).max().unwrap_or(0);
        let mut last = Duration::ZERO;
        self.outcome.is_complete = true;
        // Bodies of different sizes begin at levels of their own, and end together.
        for level in (0..levels).rev() {
            for (index, side) in sides.iter().enumerate() {
                self.fronts[index].touching.clear();
                if level < side.samples.levels.len() {
                    self.visit(index, side, level, settings);
                }
            }
            let is_sampled = level <= COARSEST;
            if level > 0 && is_sampled {
                self.load.settle(samples);
            }
            if let Some((begun, budget)) = begun.filter(|_| level > 0 && is_sampled) {
                // The next level takes about as long as all before it.
                let spent = begun.elapsed();
                if spent + spent.saturating_sub(last) > budget {
                    self.outcome.is_complete = self.load.end();
                }
                last = spent;
            }
            for (index, side) in sides.iter().enumerate() {
                if level < side.samples.levels.len() {
                    for touch in &self.fronts[index].touching {
                        let share = self.load.share[touch.cube as usize];
                        if share > 0.0 {
                            self.cells.add(touch, share);
                        }
                    }
                    self.descend(index, side, level, settings);
                }
            }
        }
        self.conclude(probe, scene, settings.most);
    }

    /// Bounds the number of cells, and tells how far off they are.
    fn conclude(&mut self, probe: &FieldBody, scene: &FieldBody, most: usize) {
        self.outcome.contacts = self.cells.contacts();
        self.cells.bound(most / 2, self.load.across);
        let strongest = self.cells.iter().map(|cell| cell.weight).fold(0.0, f32::max);
        let counted = self.cells.iter().filter(|cell| cell.weight > WEAK * strongest);
        let error = counted.map(Cell::error).reduce(f32::max);
        self.outcome.error =
            error.map_or(0.0, |error| f64::from(error) * self.tolerance + probe.error.max(scene.error));
        let band = probe.field.band().min(scene.field.band());
        let depth = |touch: &Touch| (f64::from(touch.reach) - 1.0) * self.tolerance;
        self.outcome.is_too_deep =
            self.cells.iter().any(|cell| depth(&cell.deepest) > (1.0 - ROUNDING) * band);
    }

    /// Looks at the fours of a level: reads their samples where some may be in contact, and leaves those out that neither are nor
    /// have anything in reach below them.
    fn visit(&mut self, index: usize, side: &Side, level: usize, settings: &FieldSettings) {
        let front = &mut self.fronts[index];
        let (known, mut above) = front.known.level(level);
        let moved = self.motion.moved();
        let is_sampled = level <= COARSEST;
        let last = f32x4::splat((self.load.across - 1) as f32);
        let across = i32x4::splat(self.load.across as i32);
        let mut kept = 0;
        for place in 0..front.now.len() {
            let Four { index: four, weight, .. } = front.now[place];
            let asleep = if is_sampled { known.apart[four as usize] } else { u32::MAX };
            let mut until = asleep;
            let mut open = 0;
            if level > 0 {
                for (lane, sphere) in known.spheres[four as usize].iter().enumerate() {
                    let is_closed = !sphere.is_in_reach() && sphere.until() > moved;
                    open |= u32::from(!is_closed) << lane;
                    until = until.min(sphere.until());
                }
            }
            let is_awake = asleep <= moved;
            if !is_awake && open == 0 {
                // Nor need anyone come back before.
                if let Some(above) = &mut above {
                    above.spheres[four as usize / 4][four as usize % 4] =
                        Sphere::new(false, until.min(i32::MAX as u32));
                }
                continue;
            }
            let mut cubes = [0; 4];
            if is_sampled {
                let sample = side.samples.four(level, four as usize);
                let cubes_of = || {
                    let cube = |x: f32x4| x.fast_max(f32x4::ZERO).fast_min(last).fast_trunc_int();
                    let [x, y, z] = mapped(&side.to_cubes, &sample).map(cube);
                    let cube: i32x4 = (z * across + y) * across + x;
                    cube.to_array()
                };
                if is_awake {
                    self.outcome.samples += 1;
                    let area = weight * side.area(level);
                    let touching = &mut front.touching;
                    known.apart[four as usize] =
                        read(side, &sample, area, cubes_of, settings, &self.motion, touching);
                }
                if open != 0 {
                    cubes = cubes_of();
                }
            }
            if open != 0 {
                front.now[kept] = Four { index: four, weight, cubes, open };
                kept += 1;
            }
        }
        front.now.truncate(kept);
        if level == 0 {
            for touch in &front.touching {
                self.cells.add(touch, 1.0);
            }
            front.touching.clear();
        } else {
            let area = side.area(level);
            for touch in &front.touching {
                self.load.add(touch, area);
            }
        }
    }

    /// Goes on to the samples of the next level, where there are not enough of this one and there may be some within reach.
    fn descend(&mut self, index: usize, side: &Side, level: usize, settings: &FieldSettings) {
        let front = &mut self.fronts[index];
        front.next.clear();
        if level > 0 && !self.load.is_ended {
            let scale = 1.0 / side.field.spacing() as f32;
            let tolerance = settings.tolerance as f32 * scale + SLACK;
            let steps = self.motion.per_unit(side.field.spacing());
            let moved = self.motion.moved();
            let is_sampled = level <= COARSEST;
            let spheres = &side.samples.levels[level].spheres;
            let (known, _) = front.known.level(level);
            for four in &front.now {
                let known = &mut known.spheres[four.index as usize];
                let mut shares = [0.0; 4];
                if is_sampled {
                    shares = four.cubes.map(|cube| self.load.share[cube as usize]);
                }
                let wanted = (0..4).filter(|lane| shares[*lane] < 1.0).fold(0, |bits, lane| bits | 1 << lane)
                    & four.open;
                if wanted == 0 {
                    continue;
                }
                if (0..4).any(|lane| wanted & 1 << lane != 0 && known[lane].until() <= moved) {
                    self.outcome.spheres += 1;
                    let [x, y, z, radius] = spheres[four.index as usize];
                    let [distance, ..] = side.field.read::<false>(&side.place(&[x, y, z]));
                    let apart = distance - radius * f32x4::splat(scale) - f32x4::splat(tolerance);
                    let apart = (apart * f32x4::splat(steps)).to_array();
                    for (known, apart) in known.iter_mut().zip(apart) {
                        if known.until() <= moved {
                            *known = Sphere::new(apart <= 0.0, self.motion.after(apart.abs()));
                        }
                    }
                }
                for lane in 0..4 {
                    if wanted & 1 << lane != 0 && known[lane].is_in_reach() {
                        let weight = (1.0 - shares[lane]) * four.weight;
                        let index = 4 * four.index + lane as u32;
                        front.next.push(Four { index, weight, cubes: [0; 4], open: 0 });
                    }
                }
            }
        }
        std::mem::swap(&mut front.now, &mut front.next);
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
            let Touch { point, normal, reach, .. } = cell.deepest;
            into.push(place(point, normal, depth(f64::from(reach)), 0.0));
        }
    }
}

/// Reads four samples, of which each stands for an area (of a cell's squared edge), and appends those in contact, with the cubes that
/// they are in. Returns until when none of them is in contact.
#[inline]
fn read(
    side: &Side,
    sample: &[f32x4; 3],
    area: f32,
    cubes_of: impl Fn() -> [i32; 4],
    settings: &FieldSettings,
    motion: &Motion,
    touching: &mut Vec<Touch>,
) -> u32 {
    let h = side.field.spacing() as f32;
    let [distance, x, y, z] = side.field.read::<true>(&side.place(sample));
    let reach = f32x4::splat(settings.tolerance as f32 / h) - distance;
    let in_contact = reach.simd_gt(f32x4::ZERO).to_bitmask();
    if in_contact == 0 {
        let nearest = reach.to_array().into_iter().fold(f32::NEG_INFINITY, f32::max);
        return motion.after((-nearest - SLACK) * motion.per_unit(f64::from(h)));
    }
    let size = (x * x + y * y + z * z).fast_max(f32x4::splat(f32::MIN_POSITIVE)).sqrt();
    let normal = mapped(&side.turn, &[x / size, y / size, z / size]);
    let mut point = mapped(&side.to_probe, sample);
    if !side.is_probe {
        // On the probe's surface.
        let apart = distance * f32x4::splat(h);
        point = [0, 1, 2].map(|axis| point[axis] - normal[axis] * apart);
    }
    let [point, normal] = [point, normal].map(|vector| vector.map(f32x4::to_array));
    let reach = (reach * f32x4::splat(h / settings.tolerance as f32)).to_array();
    let cubes = cubes_of();
    for lane in (0..4).filter(|lane| in_contact & 1 << lane != 0) {
        touching.push(Touch {
            point: Vec3A::new(point[0][lane], point[1][lane], point[2][lane]),
            normal: Vec3A::new(normal[0][lane], normal[1][lane], normal[2][lane]),
            reach: reach[lane],
            area,
            cube: cubes[lane] as u32,
        });
    }
    motion.moved()
}

impl<'a> Side<'a> {
    fn new(
        samples: &'a SurfaceSamples,
        field: &'a DistanceField,
        to_field: &Pose,
        is_probe: bool,
        (center, across, edge): (DVec3, u32, f64),
    ) -> Self {
        let spacing = field.spacing();
        let affine = |pose: &Pose| DAffine3::from_rotation_translation(pose.rotation, pose.translation);
        let lattice =
            DAffine3::from_mat3_translation(DMat3::from_diagonal(DVec3::splat(spacing)), field.origin());
        let from_field = if is_probe { affine(&to_field.inverse()) } else { DAffine3::IDENTITY };
        let from_body = if is_probe { DAffine3::IDENTITY } else { affine(to_field) };
        let cubes = DAffine3::from_scale_rotation_translation(
            DVec3::splat(1.0 / edge),
            DQuat::IDENTITY,
            DVec3::splat(f64::from(across / 2)) - center / edge,
        );
        // Out of the probe is into the scene object.
        let sign = if is_probe { -1.0 } else { 1.0 };
        Self {
            samples,
            field,
            to_lattice: rows(lattice.inverse() * affine(to_field)),
            to_cubes: rows(cubes * from_body),
            to_probe: rows(DAffine3::from_translation(-center) * from_body),
            turn: rows(DAffine3::from_mat3(from_field.matrix3 * sign)),
            area: (f64::from(samples.area) / (edge * edge)) as f32,
            is_probe,
        }
    }

    /// That a sample of a level stands for, as a part of a cell's squared edge.
    fn area(&self, level: usize) -> f32 {
        self.area * (1 << (2 * level)) as f32
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
                    Side::new(&body.samples, &body.field, &to_field, is_probe, (body.center, 10, REACH));
                for four in 0..body.samples.fours(0) {
                    let [distance, ..] = side.field.read::<false>(&side.place(&body.samples.four(0, four)));
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
