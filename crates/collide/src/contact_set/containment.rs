//! Parts of one object that are wholly inside the other solid, where no surfaces meet.
//!
//! A [query](crate::ContactQuery) finds surfaces that meet. A ball in the middle of a block of fine mesh
//! touches nothing, and yet it is in the block. So for each connected part of either surface a vertex, its
//! *witness*, is kept that is outside of the other solid: as long as it is, the part is not wholly inside.
//! It has to be measured only after it has moved by its distance from the surface. Where it has come inside,
//! other vertices are tried. If none is outside, and no triangle of the part crosses the other surface, the
//! part is wholly inside.
//!
//! The depth of such a part is an upper bound on the way out and never less than a lower one:
//!
//! - For each direction of the nearest points of the other surface from vertices of the part, the way by
//!   which the part has to move along it to be beyond the plane across that direction through the nearest
//!   point. The least of them is the least motion that ends the penetration if the other object is convex and
//!   the direction was among them. It can be less if the other object's surface is curved inwards there.
//! - The distance of the part's deepest vertex from the other surface. No motion that is less ends the
//!   penetration.
//!
//! The depth is the larger of the two. Of the directions those of the nearest vertex in each of 96 cones are
//! tried.

use palpate_core::glam::DVec3;
use palpate_core::{Contact, Pose};

use super::sides::Side;
use crate::contact::{PatchContact, to_world};
use crate::convex::{Hull, Limits, Placement, Separation, Start, gjk};
use crate::error::ContactSetError;
use crate::patchwork::NearestSearch;
use crate::shape::Shape;
use crate::tolerances::{COORDINATE_ROUNDING, PRECISION, ROUNDING_SLACK};

/// Cells along an edge of the cube of directions.
const CELLS: usize = 4;
/// Number of cones of directions: cells of the cube's faces.
const CONES: usize = 6 * CELLS * CELLS;
/// Number of vertices, spread over a part, that are tried first when its witness has come inside.
const SPREAD: usize = 64;

/// What is known of the surfaces that meet.
#[derive(Clone, Copy, Debug)]
pub(super) enum Meeting<'a> {
    /// Nothing.
    Unknown,
    /// These contacts, of a query at the same poses, are all.
    All(&'a [PatchContact]),
}

/// The vertex of a part that is looked at first.
#[derive(Clone, Copy, Debug)]
struct Witness {
    /// Its place among the vertices of the part.
    place: u32,
    /// Where it was when it was measured, in the other body's frame, m; NaN before.
    at: DVec3,
    /// Signed distance there, negative inside, or a bound that is nearer to 0, m.
    distance: f64,
}

/// A vertex of a part that is inside the other solid.
#[derive(Clone, Copy, Debug)]
struct Measured {
    vertex: u32,
    /// Its position in the other body's frame, m.
    at: DVec3,
    /// Distance of the nearest point of the other surface, m.
    distance: f64,
    /// That point, in the other body's frame, m.
    nearest: DVec3,
    /// Its triangle.
    triangle: u32,
}

/// Finds which connected parts of two objects are wholly inside the other, without a contact query.
///
/// [`ContactSet`](crate::ContactSet) does so at full resolution. This is for contacts found in another way.
#[derive(Clone, Debug)]
pub struct Containment {
    shapes: [Shape; 2],
    /// For each side and part.
    witnesses: [Vec<Witness>; 2],
    /// Whether each part of each side may cross the other surface.
    meets: [Vec<bool>; 2],
    /// Whether each part of each side is wholly inside the other object.
    contained: [Vec<bool>; 2],
    search: NearestSearch,
    /// The vertices of the part in question.
    measured: Vec<Measured>,
    /// One contact for each part that is wholly inside, in world axes.
    contacts: Vec<PatchContact>,
    /// Number of vertices whose distance was measured in the last run.
    pub(super) count: usize,
    /// Whether there were more vertices to measure than allowed.
    pub(super) truncated: bool,
}

impl Containment {
    /// A workspace for two objects. The first one for an object finds its parts.
    pub fn new(probe: &Shape, scene: &Shape) -> Self {
        let unknown = Witness { place: 0, at: DVec3::NAN, distance: 0.0 };
        let shapes = [probe, scene];
        Self {
            witnesses: shapes.map(|shape| vec![unknown; shape.parts().len()]),
            meets: shapes.map(|shape| vec![false; shape.parts().len()]),
            contained: shapes.map(|shape| vec![false; shape.parts().len()]),
            shapes: shapes.map(Shape::clone),
            search: NearestSearch::default(),
            measured: Vec::new(),
            contacts: Vec::new(),
            count: 0,
            truncated: false,
        }
    }

    /// Memory held by the workspace, bytes.
    pub fn bytes(&self) -> usize {
        let [of_probe, of_scene] = &self.witnesses;
        (of_probe.capacity() + of_scene.capacity()) * (size_of::<Witness>() + 2)
            + self.measured.capacity() * size_of::<Measured>()
            + self.contacts.capacity() * size_of::<PatchContact>()
    }

    /// Capacity of all buffers, which shows whether one has grown.
    pub(super) fn capacity(&self) -> usize {
        self.bytes() + self.search.capacity()
    }

    /// Finds the parts of either object that are wholly inside the other, at given poses (object frame to
    /// world). Returns one contact for each, in world axes, those of the probe's parts first.
    ///
    /// # Errors
    /// If a pose is not valid.
    pub fn run(&mut self, probe_pose: &Pose, scene_pose: &Pose) -> Result<&[PatchContact], ContactSetError> {
        self.clear();
        ContactSetError::check_poses([probe_pose, scene_pose])?;
        let [probe, scene] = self.shapes.clone();
        let sides = Side::both(&probe, &scene, Placement::between(probe_pose, scene_pose));
        let coordinates = sides[1].to_other.translation.abs().max_element();
        let precision = PRECISION * (probe.coordinates() + scene.coordinates() + coordinates)
            + COORDINATE_ROUNDING
                * probe_pose.translation.abs().max(scene_pose.translation.abs()).max_element();
        self.find(&sides, probe_pose, Meeting::Unknown, (precision, usize::MAX));
        Ok(&self.contacts)
    }

    /// The contacts of the last run: one for each part that is wholly inside; none after an error.
    pub fn contacts(&self) -> &[PatchContact] {
        &self.contacts
    }

    /// Number of parts of the probe, and of the scene object, that were wholly inside the other one in the
    /// last run.
    pub fn parts(&self) -> [usize; 2] {
        self.contained.each_ref().map(|parts| parts.iter().filter(|contained| **contained).count())
    }

    /// Whether a contact is one of a part that was wholly inside the other object in the last run.
    pub(super) fn holds(&self, found: &PatchContact) -> bool {
        let nodes = [found.probe_node, found.scene_node];
        !self.contacts.is_empty()
            && (0..2).any(|side| {
                let part = self.shapes[side].parts().of_node(nodes[side]);
                part.is_some_and(|part| self.contained[side][part as usize])
            })
    }

    /// Forgets the last run.
    pub(super) fn clear(&mut self) {
        self.contained.iter_mut().for_each(|parts| parts.fill(false));
        self.contacts.clear();
        (self.count, self.truncated) = (0, false);
    }

    /// Finds the parts that are wholly inside the other object. `precision`: largest distance of a vertex
    /// that lies on a surface, m; with the largest number of vertices whose distance may be measured.
    pub(super) fn find(
        &mut self,
        sides: &[Side; 2],
        probe_pose: &Pose,
        meeting: Meeting,
        (precision, most): (f64, usize),
    ) {
        self.mark(meeting);
        for side in sides.iter().filter(|side| side.other.clod().source.solid) {
            for part in 0..side.own.parts().len() as u32 {
                if self.is_inside(side, part, precision, most) {
                    self.contained[side.index][part as usize] = true;
                    if let Some(contact) = self.contact(side, part, sides) {
                        let world = to_world(&contact.contact, probe_pose);
                        self.contacts.push(PatchContact { contact: world, ..contact });
                    }
                }
            }
        }
    }

    /// Marks the parts that may cross the other surface: those with contacts that penetrate.
    fn mark(&mut self, meeting: Meeting) {
        let Meeting::All(contacts) = meeting else {
            self.meets.iter_mut().for_each(|parts| parts.fill(true));
            return;
        };
        self.meets.iter_mut().for_each(|parts| parts.fill(false));
        for found in contacts.iter().filter(|found| found.contact.depth >= 0.0) {
            for (side, node) in [found.probe_node, found.scene_node].into_iter().enumerate() {
                match self.shapes[side].parts().of_node(node) {
                    Some(part) => self.meets[side][part as usize] = true,
                    None => self.meets[side].fill(true),
                }
            }
        }
    }

    /// Whether a part is wholly inside the other object. Its vertices are in `measured` then, all of them
    /// unless there are too many.
    fn is_inside(&mut self, side: &Side, part: u32, precision: f64, most: usize) -> bool {
        self.measured.clear();
        if !self.witness_is_inside(side, part, precision, most) {
            return false;
        }
        let count = side.own.parts().vertices(part).len();
        let meets = self.meets[side.index][part as usize];
        if meets {
            let spread = SPREAD.min(count);
            if !self.are_inside(side, part, (0..spread).map(|i| i * (count / spread)), (precision, most)) {
                return false;
            }
        }
        if !self.are_inside(side, part, 0..count, (precision, most)) || self.measured.is_empty() {
            return false;
        }
        // If no surfaces meet, one vertex is enough.
        !meets || (self.measured.len() == count && !self.crosses(side, precision))
    }

    /// Measures vertices of a part until one is not inside the other object, which becomes the part's
    /// witness. Whether there was none.
    fn are_inside(
        &mut self,
        side: &Side,
        part: u32,
        places: impl Iterator<Item = usize>,
        (precision, most): (f64, usize),
    ) -> bool {
        let vertices = side.own.parts().vertices(part);
        self.measured.clear();
        for place in places {
            if self.count >= most {
                self.truncated = true;
                break;
            }
            match self.measure(side, vertices[place], precision) {
                Ok(measured) => self.measured.push(measured),
                Err(distance) => {
                    let at = side.place(vertices[place]);
                    self.witnesses[side.index][part as usize] = Witness { place: place as u32, at, distance };
                    return false;
                }
            }
        }
        true
    }

    /// Whether the vertex of a part that was outside before is inside the other object.
    fn witness_is_inside(&mut self, side: &Side, part: u32, precision: f64, most: usize) -> bool {
        let witness = self.witnesses[side.index][part as usize];
        let vertex = side.own.parts().vertices(part)[witness.place as usize];
        let at = side.place(vertex);
        if at.distance(witness.at) < witness.distance.abs() * (1.0 - ROUNDING_SLACK) - precision {
            return witness.distance < 0.0;
        }
        if self.count >= most {
            self.truncated = true;
            return false;
        }
        let distance = match self.measure(side, vertex, precision) {
            Ok(measured) => -measured.distance,
            Err(distance) => distance,
        };
        self.witnesses[side.index][part as usize] = Witness { at, distance, ..witness };
        distance < 0.0
    }

    /// Measures a vertex that is inside the other object. If it is not, returns a lower bound on its distance
    /// from it, m.
    fn measure(&mut self, side: &Side, vertex: u32, precision: f64) -> Result<Measured, f64> {
        let at = side.place(vertex);
        let ball = side.other.ball();
        let outside = at.distance(ball.center) - ball.radius;
        if outside.is_nan() || outside > 0.0 {
            return Err(outside.max(0.0));
        }
        self.count += 1;
        let (surface, parts) = (side.other.patchwork(), side.other.parts());
        let hint = self.measured.last().map(|last| last.triangle);
        let bounds = |triangle| parts.bounds(&surface.neighbours, triangle);
        match self.search.among(surface, at, hint, bounds) {
            Some(nearest) if nearest.distance > precision && nearest.is_behind(surface, at) => {
                let (distance, triangle) = (nearest.distance, nearest.triangle);
                Ok(Measured { vertex, at, distance, nearest: nearest.point, triangle })
            }
            nearest => Err(nearest.map_or(0.0, |nearest| nearest.distance)),
        }
    }

    /// Whether a triangle of the part whose vertices were measured crosses the other object's surface.
    fn crosses(&self, side: &Side, precision: f64) -> bool {
        let neighbours = &side.own.patchwork().neighbours;
        let (surface, parts) = (side.other.patchwork(), side.other.parts());
        self.measured.iter().any(|found| {
            // Each triangle is looked at with its first corner.
            let own = neighbours.around(found.vertex).iter().map(|triangle| neighbours.ends(*triangle));
            own.filter(|ends| ends[0] == found.vertex).any(|ends| {
                let corners = ends.map(|end| side.place(end));
                let [p, q, r] = corners;
                if found.distance > p.distance(q).max(p.distance(r)) {
                    return false;
                }
                let hull = Hull::new(&corners);
                let around = [p.min(q).min(r) - precision, p.max(q).max(r) + precision];
                surface.any_in_box(around, &mut |triangle| {
                    parts.bounds(&surface.neighbours, triangle)
                        && meet(&hull, &Hull::new(&surface.neighbours.corners(triangle)), precision)
                })
            })
        })
    }

    /// The contact of the part whose vertices were measured, in the probe's frame.
    fn contact(&self, side: &Side, part: u32, sides: &[Side; 2]) -> Option<PatchContact> {
        let deepest = self.measured.iter().max_by(|x, y| x.distance.total_cmp(&y.distance))?;
        let mut nearest = [None::<&Measured>; CONES];
        for found in &self.measured {
            let best = &mut nearest[cone(found.nearest - found.at)];
            if best.is_none_or(|best| found.distance < best.distance) {
                *best = Some(found);
            }
        }
        let ways = nearest.into_iter().flatten().map(|found| side.way_out(part, found));
        let way =
            ways.min_by(|x, y| x.length.total_cmp(&y.length)).filter(|way| way.length > deepest.distance);
        let Way { length: depth, direction, vertex, triangle } = way.unwrap_or_else(|| deepest.way());
        let own = side.own.patchwork().neighbours.point(vertex);
        let nodes = [
            side.own
                .patchwork()
                .neighbours
                .around(vertex)
                .first()
                .map(|t| side.own.patchwork().neighbours.owner(*t))?,
            side.other.patchwork().neighbours.owner(triangle),
        ];
        let contact = if side.index == 0 {
            let normal = -sides[1].to_other.direction(direction);
            Contact { point: own, scene_point: own - depth * normal, normal, depth }
        } else {
            let scene_point = side.to_other.point(own);
            Contact { point: scene_point + depth * direction, scene_point, normal: direction, depth }
        };
        let [probe_node, scene_node] = if side.index == 0 { nodes } else { [nodes[1], nodes[0]] };
        Some(PatchContact { contact, probe_node, scene_node, weight: 1.0 })
    }
}

/// A motion that may bring a part out of the other object.
#[derive(Clone, Copy, Debug)]
struct Way {
    /// m.
    length: f64,
    /// Unit direction, in the other body's axes.
    direction: DVec3,
    /// The vertex of the part that comes out last.
    vertex: u32,
    /// The triangle of the other surface that it comes out at.
    triangle: u32,
}

impl Measured {
    /// The way of this vertex alone.
    fn way(&self) -> Way {
        let direction = (self.nearest - self.at).normalize_or_zero();
        Way { length: self.distance, direction, vertex: self.vertex, triangle: self.triangle }
    }
}

impl Side<'_> {
    /// A mesh vertex of the own surface in the other body's frame, m.
    fn place(&self, vertex: u32) -> DVec3 {
        self.to_other.point(self.own.patchwork().neighbours.point(vertex))
    }

    /// The way of a whole part beyond the plane through the nearest point of a vertex.
    fn way_out(&self, part: u32, found: &Measured) -> Way {
        let Way { direction, triangle, .. } = found.way();
        let along = self.to_other.direction_to_b(direction);
        let neighbours = &self.own.patchwork().neighbours;
        let (mut lowest, mut last) = (f64::INFINITY, found.vertex);
        for &vertex in self.own.parts().vertices(part) {
            let height = along.dot(neighbours.point(vertex));
            if height < lowest {
                (lowest, last) = (height, vertex);
            }
        }
        let length = direction.dot(found.nearest - self.to_other.translation) - lowest;
        Way { length, direction, vertex: last, triangle }
    }
}

/// Whether two triangles in the same frame meet. `precision`: distance below which they do, m.
fn meet(a: &Hull, b: &Hull, precision: f64) -> bool {
    let limits = Limits { beyond: 0.0, share: 0.0, enough: -1.0, precision };
    let found = gjk::distance(a, b, &Placement::IDENTITY, Start::Axis(a.point(0) - b.point(0)), &limits);
    matches!(found.separation, Separation::Overlapping | Separation::NotConverged)
}

/// The number of the cone that a direction is in.
fn cone(direction: DVec3) -> usize {
    let axis = direction.abs().max_position();
    let (main, [u, v]) = (direction[axis], [1, 2].map(|next| direction[(axis + next) % 3]));
    let [u, v] = [u, v].map(|side| {
        let part = (side / main.abs() + 1.0) / 2.0;
        ((part * CELLS as f64) as usize).min(CELLS - 1)
    });
    let face = 2 * axis + usize::from(main < 0.0);
    (face * CELLS + u) * CELLS + v
}
