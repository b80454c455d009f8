//! The contact loop's part of contacts as constraints: which points of the surfaces the haptic loop has to
//! guard, and how far the body may move before it could touch another one.
//!
//! Points start at the nearest of the fields' samples in each small cell of the region of contact, or of the
//! contacts of patches at full resolution where there are no fields. Each descends to a local minimum of the
//! distance between the surfaces.

use std::collections::HashMap;
use std::sync::Arc;

use palpate_collide::{ObjectHandle, QuerySettings};
use palpate_core::Pose;
use palpate_core::glam::DVec3;
use palpate_dynamics::{BodyState, MAX_UNILATERAL, MotionBound, MovingBody};
use palpate_field::{FeatureMesh, FieldQuery, SurfacePoint};

use super::ContactLoop;
use super::assemble::counterpart;
use super::by_fields::in_steps;
use super::geometry::{ContactGeometry, MAX_POINTS, NearObject};
use super::guarded_point::GuardedPoint;
use super::proxy::{LevelFinder, QueryReport};
use crate::scene::field::new_fine_query;
use crate::settings::Response;

/// Edge of the cells in each of which a point starts, in bounding radii of the body. With larger cells, local
/// minima of the distance are missed; with smaller ones there are more points.
const CELL: f64 = 0.02;

/// Distance of surfaces up to which cells have that edge, as a fraction of it; twice as far they are twice as
/// large. With less, points that are soon needed are missing; with more, there are more points.
const NEAR: f64 = 0.25;

/// Distance at which surfaces are held apart, in bounding radii of the body. Without it rounding lets them
/// overlap, and directions between them are lost.
const MARGIN: f64 = 7e-5;

/// Smallest distance within which points are guarded, in tolerances d. With less, a body at rest is held where
/// it is when it starts to move.
const MIN_REACH: f64 = 2.0;

/// Time of motion within which a step may meet a point, s: two haptic periods. With more, cells are larger than
/// they need to be.
const NEAR_TIME: f64 = 3e-3;

/// The same for a body at rest, in tolerances d.
const MIN_NEAR: f64 = 0.1;

/// Largest number of points that near: some fewer than a step takes, since others come near until the next
/// query.
const MAX_NEAR: usize = 3 * MAX_UNILATERAL / 4;

/// Largest number of times that cells are doubled.
const MAX_DOUBLINGS: u32 = 8;

/// Largest number of cells whose points are made, some of which come out as the same. With more, a query takes
/// longer.
const MAX_CELLS: usize = 2 * MAX_POINTS;

/// Points that there is room for from the start.
const RESERVED: usize = 2048;

/// A place at which a guarded point may start.
#[derive(Clone, Copy, Debug)]
struct Start {
    /// Position in the mesh's frame of its own body, m.
    home: DVec3,
    is_probe: bool,
    /// Distance from the other surface, approximately, m.
    distance: f64,
    /// Index of the scene object among those near.
    object: u8,
    /// Place on the body in the hand, in its axes, m.
    at: DVec3,
    /// Normal out of the body in the hand, in its axes.
    normal: DVec3,
}

/// The workspace.
#[derive(Debug, Default)]
pub(super) struct Guard {
    /// Queries in the fields of the scene objects, by their places.
    queries: Vec<Option<FieldQuery>>,
    starts: Vec<Start>,
    /// Indices of the nearest start of each cell.
    cells: HashMap<[i32; 5], usize>,
    points: Vec<GuardedPoint>,
}

/// Limits on the guarded points of a geometry.
#[derive(Clone, Copy, Debug)]
struct Limits {
    /// Distance within which points are guarded, m.
    reach: f64,
    /// Edge of the smallest cells, m.
    edge: f64,
    /// Distance within which at most [`MAX_UNILATERAL`] points are, since a step may meet all of them, m.
    near: f64,
}

impl Start {
    /// The cell, with an edge (m) where surfaces are near each other, and larger further away.
    fn cell(&self, edge: f64) -> [i32; 5] {
        let size = ((self.distance / (NEAR * edge)).max(1.0).log2() as i32).min(8);
        let [x, y, z] = (self.at / (edge * f64::from(1 << size))).floor().to_array().map(|at| at as i32);
        let axis = self.normal.abs().max_position();
        let side = 2 * axis as i32 + i32::from(self.normal[axis] < 0.0);
        [x, y, z, side + 6 * size, 2 * i32::from(self.object) + i32::from(self.is_probe)]
    }
}

impl Guard {
    pub fn new() -> Self {
        Self {
            queries: Vec::new(),
            starts: Vec::with_capacity(RESERVED),
            cells: HashMap::with_capacity(RESERVED),
            points: Vec::with_capacity(RESERVED),
        }
    }

    /// Makes the points of the starts: one for each cell. Where surfaces lie along each other, cells are made
    /// larger until there is room.
    fn fill(&mut self, geometry: &mut ContactGeometry, mesh: &Pose, limits: &Limits) {
        let mut edge = limits.edge;
        for _ in 0..MAX_DOUBLINGS {
            self.choose(edge);
            if self.cells.len() > MAX_CELLS {
                edge *= 2.0;
                continue;
            }
            self.make(geometry, mesh, limits.reach, edge);
            let near = self.points.iter().filter(|point| f64::from(point.slack) < limits.near).count();
            if self.points.len() <= MAX_POINTS && near <= MAX_NEAR {
                break;
            }
            edge *= 2.0;
        }
        geometry.points.extend(self.points.iter().take(MAX_POINTS).copied());
    }

    /// Chooses the nearest start of each cell.
    fn choose(&mut self, edge: f64) {
        self.cells.clear();
        for (index, start) in self.starts.iter().enumerate() {
            let nearest = self.cells.entry(start.cell(edge)).or_insert(index);
            if start.distance < self.starts[*nearest].distance {
                *nearest = index;
            }
        }
    }

    /// Makes the points of the chosen starts within a reach (m), the nearest first.
    fn make(&mut self, geometry: &ContactGeometry, mesh: &Pose, reach: f64, edge: f64) {
        self.points.clear();
        for &index in self.cells.values() {
            let Start { home, is_probe, object, .. } = self.starts[index];
            let NearObject { surface, pose, .. } = &geometry.objects[usize::from(object)];
            let (probe, scene) = ((&*geometry.probe, mesh), (&**surface, pose));
            let point = GuardedPoint::new((home, edge), is_probe, object, probe, scene);
            if f64::from(point.slack) < reach {
                self.points.push(point);
            }
        }
        let order = |a: &GuardedPoint, b: &GuardedPoint| {
            a.slack.total_cmp(&b.slack).then_with(|| a.place_key().cmp(&b.place_key()))
        };
        self.points.sort_unstable_by(order);
        self.points.dedup_by_key(|point| point.place_key());
    }
}

impl ContactLoop {
    /// Whether contacts with the object at a place are constraints. Contacts with objects that they push, and
    /// with textured ones, are penalty contacts.
    pub(super) fn is_guarded(&self, place: usize) -> bool {
        let pushed =
            self.objects.get(place).and_then(Option::as_ref).and_then(|object| object.moving.as_ref());
        self.response == Response::Constraints
            && !pushed.is_some_and(|moving| moving.0.is_pushed())
            && !self.textures.as_ref().is_some_and(|textures| textures.has(place))
    }

    /// Whether contacts with all objects are constraints.
    pub(super) fn guards_all(&self) -> bool {
        (0..self.objects.len()).all(|place| self.objects[place].is_none() || self.is_guarded(place))
    }

    /// Finds what the haptic loop needs to hold the body out of the objects that are guarded; `None` if the
    /// body has no surface.
    pub(super) fn guard(&mut self, body: &BodyState, interval: f64) -> Option<ContactGeometry> {
        let tolerance = self.parameters.tolerance;
        let ahead = self.lookahead.horizon(interval);
        let motion = self.lookahead.motion_bound(&body.twist, self.fastest, ahead);
        let reach = in_steps(tolerance + motion, tolerance).max(MIN_REACH * tolerance).min(self.max_reach());
        let radius = self.probe.bounding_radius();
        let mut geometry = ContactGeometry {
            probe: self.probe.features()?,
            center_of_mass: self.center_of_mass,
            objects: Default::default(),
            points: Default::default(),
            bound: MotionBound { from: body.pose, room: reach, step: f64::INFINITY, radius: self.radius },
            friction: self.parameters.friction,
            margin: (MARGIN * radius).min(0.05 * tolerance),
            age: 0.0,
        };
        let mesh = body.pose * Pose::from_translation(-self.center_of_mass);
        let mut guard = std::mem::take(&mut self.guard);
        guard.starts.clear();
        let mut report = QueryReport::default();
        let edge = CELL * radius;
        let speed = body.twist.linear.length() + body.twist.angular.length() * self.radius + self.fastest;
        let room = if self.is_by_fields() {
            let reaches = (reach, (reach + 2.0 * motion).max(reach));
            self.start_in_fields(&mut guard, &mut geometry, &mesh, reaches, &mut report)
        } else {
            self.start_at_patches(&mut guard, &mut geometry, &mesh, reach, &mut report)
        };
        let near = MIN_NEAR * tolerance + speed * NEAR_TIME;
        guard.fill(&mut geometry, &mesh, &Limits { reach, edge, near });
        geometry.bound.room = if report.refused { 0.0 } else { room };
        self.guard = guard;
        let events = &mut self.telemetry.events;
        events.contact_refused += u64::from(report.refused);
        events.contact_overflow += report.dropped as u64;
        events.not_converged += report.not_converged as u64;
        Some(geometry)
    }

    /// A scene object near the body, by its place; `None` if it is not guarded.
    fn near_object(&self, handle: ObjectHandle) -> Option<NearObject> {
        let place = handle.place();
        if !self.is_guarded(place) {
            return None;
        }
        let surface: Arc<FeatureMesh> = self.objects.get(place)?.as_ref()?.object.features()?;
        let pose = *self.scene.pose(handle)?;
        let motion: MovingBody = counterpart(&self.objects, &self.scene, Some(place)).body();
        let radius = self.objects.get(place)?.as_ref()?.object.bounding_radius();
        let center = motion.twist.velocity_at(pose.translation);
        let speed = center.length() + motion.twist.angular.length() * radius;
        Some(NearObject { surface, pose, motion, speed })
    }

    /// Starts points at the nearest samples in fields within the first of two reaches (m). Returns how far the
    /// body may move before it could touch something else, up to the second, m.
    fn start_in_fields(
        &mut self,
        guard: &mut Guard,
        geometry: &mut ContactGeometry,
        mesh: &Pose,
        (reach, enough): (f64, f64),
        report: &mut QueryReport,
    ) -> f64 {
        let Guard { queries, starts, .. } = guard;
        let Ok(invalid) = self.scene.find_near(mesh, enough) else {
            report.refused = true;
            return 0.0;
        };
        report.refused |= invalid > 0;
        let mut room = enough;
        let handles: arrayvec::ArrayVec<ObjectHandle, 64> = self.scene.near().take(64).collect();
        for handle in handles {
            let Some(object) = self.near_object(handle) else { continue };
            let Ok(fields) = &self.by_fields else { continue };
            let Some((probe, field)) = fields.fields(handle.place()) else { continue };
            let to_object = object.pose.inverse() * *mesh;
            let clearance = probe.body().clearance(field.body(), &to_object, enough);
            if clearance > reach || geometry.objects.is_full() {
                room = room.min(clearance);
                continue;
            }
            room = room.min(reach);
            if queries.len() <= handle.place() {
                queries.resize_with(handle.place() + 1, || None);
            }
            let query = queries[handle.place()].get_or_insert_with(|| new_fine_query(probe, field));
            let settings = fields.needs.settings(reach);
            query.run(probe.body(), field.body(), mesh, &object.pose, &settings);
            let (first, second) = ((probe.body(), mesh), (field.body(), &object.pose));
            let index = geometry.objects.len() as u8;
            query.surface_points(first, second, |sample| {
                let &SurfacePoint { point, is_probe, distance, on_probe, normal } = sample;
                let (at, normal) = (on_probe.as_dvec3(), normal.as_dvec3());
                starts.push(Start { home: point.as_dvec3(), is_probe, distance, object: index, at, normal });
            });
            geometry.objects.push(object);
        }
        room
    }

    /// Starts points at the contacts of patches within a reach (m). Returns how far the body may move before
    /// it could touch something else, m.
    fn start_at_patches(
        &mut self,
        guard: &mut Guard,
        geometry: &mut ContactGeometry,
        mesh: &Pose,
        reach: f64,
        report: &mut QueryReport,
    ) -> f64 {
        let settings = QuerySettings { tolerance: reach, ..QuerySettings::new(reach) };
        let mut finder = LevelFinder { scene: &mut self.scene, settings };
        let complete = crate::contact::proxy::ContactFinder::find(&mut finder, mesh, report);
        let to_probe = mesh.inverse();
        let mut room = if complete { reach } else { 0.0 };
        for found in self.scene.contacts() {
            let Some(object) = self.near_object(found.object) else { continue };
            if geometry.objects.is_full() {
                room = 0.0;
                break;
            }
            let index = geometry.objects.len() as u8;
            let to_object = object.pose.inverse();
            for patch in found.contacts {
                let contact = patch.contact;
                let on_probe = to_probe.transform_point(contact.point);
                let (at, normal) = (on_probe, to_probe.transform_vector(contact.normal));
                let on_scene = to_object.transform_point(contact.scene_point);
                for (home, is_probe) in [(on_probe, true), (on_scene, false)] {
                    let distance = -contact.depth;
                    guard.starts.push(Start { home, is_probe, distance, object: index, at, normal });
                }
            }
            geometry.objects.push(object);
        }
        room
    }
}
