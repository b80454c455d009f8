//! The contact loop's part of contacts as constraints: which points of the surfaces the haptic loop has to
//! guard, and how far the body may move before it could touch another one.
//!
//! In fields, points start at the nearest sample in each small cell of the region of contact: samples of
//! surfaces and of their long edges. Where there are no fields, they start at the contacts, corners and
//! crossing edges of patches at full resolution. Each descends to a local minimum of the distance between the
//! surfaces.

use std::collections::HashMap;

use arrayvec::ArrayVec;
use palpate_core::Pose;
use palpate_core::glam::DVec3;
use palpate_dynamics::MAX_UNILATERAL;
use palpate_field::Place;

use super::geometry::{ContactGeometry, MAX_OBJECTS, MAX_POINTS};
use super::guarded_point::{Frames, GuardedPoint};
use super::patch_starts::PatchStarts;

/// Distance of surfaces up to which cells have that edge, as a fraction of it; twice as far they are twice as
/// large. With less, points that are soon needed are missing; with more, there are more points.
const NEAR: f64 = 0.25;

/// Largest number of points that near: some fewer than a step takes, since others come near until the next
/// query.
const MAX_NEAR: usize = 3 * MAX_UNILATERAL / 4;

/// Largest number of times that cells are doubled.
const MAX_DOUBLINGS: u32 = 8;

/// Largest number of cells whose points are made, some of which come out as the same. With more, a query
/// takes longer.
const MAX_CELLS: usize = 2 * MAX_POINTS;

/// The same for points that near.
const MAX_NEAR_CELLS: usize = 3 * MAX_NEAR;

/// Points that there is room for from the start.
const RESERVED: usize = 2048;

/// A place at which a guarded point may start.
#[derive(Clone, Copy, Debug)]
pub(super) struct Start {
    /// Position in the mesh's frame of its own body, m.
    pub home: DVec3,
    /// The place on vertices and edges nearest to it, if that is known.
    pub place: Option<Place>,
    pub is_probe: bool,
    /// Whether it is on an edge that is guarded as such, or on any feature of a face.
    pub is_on_edge: bool,
    /// Largest distance from there, m.
    pub leash: f64,
    /// Distance from the other surface, approximately, m.
    pub distance: f64,
    /// Index of the scene object among those near.
    pub object: u8,
    /// Place on the body in the hand, in its axes, m.
    pub at: DVec3,
    /// Direction by which starts nearby are told apart, in the axes of the body in the hand: the normal out
    /// of it, or the edge.
    pub direction: DVec3,
}

/// The workspace.
#[derive(Debug, Default)]
pub(super) struct Guard {
    pub starts: Vec<Start>,
    /// Indices of the nearest start of each cell.
    cells: HashMap<[i32; 5], usize>,
    /// These indices, the nearest starts first: the order of a hash map is not reproducible.
    chosen: Vec<usize>,
    pub patches: PatchStarts,
    points: Vec<GuardedPoint>,
}

/// Limits on the guarded points of a geometry.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    /// Distance within which points are guarded, m.
    pub reach: f64,
    /// Edge of the smallest cells, m.
    pub edge: f64,
    /// Distance within which at most [`MAX_UNILATERAL`] points are, since a step may meet all of them, m.
    pub near: f64,
}

impl Start {
    /// The cell, with an edge (m) where surfaces are near each other, and larger further away.
    fn cell(&self, edge: f64) -> [i32; 5] {
        let size = ((self.distance / (NEAR * edge)).max(1.0).log2() as i32).min(8);
        let [x, y, z] = (self.at / (edge * f64::from(1 << size))).floor().to_array().map(|at| at as i32);
        let axis = self.direction.abs().max_position();
        let side = 2 * axis as i32 + i32::from(self.direction[axis] < 0.0);
        let kind = 2 * i32::from(self.is_probe) + i32::from(self.is_on_edge);
        [x, y, z, side + 6 * size, 4 * i32::from(self.object) + kind]
    }
}

impl Guard {
    pub fn new() -> Self {
        Self {
            starts: Vec::with_capacity(RESERVED),
            cells: HashMap::with_capacity(RESERVED),
            chosen: Vec::with_capacity(RESERVED),
            patches: PatchStarts::default(),
            points: Vec::with_capacity(RESERVED),
        }
    }

    /// Makes the points of the starts: one for each cell. Where surfaces lie along each other, cells are made
    /// larger until there is room. Returns the distance of the nearest point for which there is none, m, and
    /// the number of these.
    pub fn fill(&mut self, geometry: &mut ContactGeometry, mesh: &Pose, limits: &Limits) -> (f64, usize) {
        let mut edge = limits.edge;
        for doubling in 0..=MAX_DOUBLINGS {
            self.choose(edge);
            if doubling == MAX_DOUBLINGS || !self.are_too_many(limits.near) {
                self.make(geometry, mesh, limits.reach, edge);
                let near = self.points.iter().filter(|point| f64::from(point.slack) < limits.near).count();
                if self.points.len() <= MAX_POINTS && near <= MAX_NEAR {
                    break;
                }
            }
            edge *= 2.0;
        }
        geometry.points.extend(self.points.iter().take(MAX_POINTS).copied());
        let nearest = self.points.get(MAX_POINTS).map_or(f64::INFINITY, |point| point.slack.into());
        (nearest, self.points.len().saturating_sub(MAX_POINTS))
    }

    /// Whether the chosen starts are so many that not all of their points would find room, though some of them
    /// come out as the same.
    fn are_too_many(&self, near: f64) -> bool {
        let within = || self.cells.values().filter(|index| self.starts[**index].distance < near).count();
        self.cells.len() > MAX_CELLS || within() > MAX_NEAR_CELLS
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
        self.chosen.clear();
        self.chosen.extend(self.cells.values());
        let Self { starts, chosen, .. } = &mut *self;
        chosen.sort_unstable_by(|&a, &b| starts[a].distance.total_cmp(&starts[b].distance).then(a.cmp(&b)));
        let frames: ArrayVec<Frames<'_>, MAX_OBJECTS> = geometry.frames(mesh);
        for &index in &self.chosen {
            let Start { home, place, is_probe, leash, object, .. } = self.starts[index];
            let Some(frames) = frames.get(usize::from(object)) else { continue };
            let place = place.unwrap_or_else(|| frames.own(is_probe).place_near(home));
            let point = GuardedPoint::new((place, leash.max(edge)), is_probe, object, frames);
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
