//! The test whether a separated contact is a local minimum of the distance between two surfaces.
//!
//! The surfaces at a contact's points are the triangles that meet there, of any patches. The contact is not a
//! minimum if a triangle at one point is closer to the other point, or to a triangle at the other point.

use palpate_core::Pose;
use palpate_core::glam::DVec3;

use super::sides::Side;
use crate::contact::PatchContact;
use crate::convex::{Hull, Limits, Placement, Separation, Start, gjk, nearest_on_triangle};
use crate::patch::in_box;
use crate::patchwork::{NearestSearch, Patchwork};
use crate::tolerances::SAME_POINT;

/// A triangle at a contact's point.
#[derive(Clone, Copy, Debug)]
struct AtPoint {
    /// Corners in its body's frame, m.
    corners: [DVec3; 3],
    /// Whether its nearest point to the contact's other point is not the contact's own point.
    slides: bool,
}

/// The workspace of the test.
#[derive(Clone, Debug, Default)]
pub(crate) struct MinimumTest {
    /// Triangles at a contact's points on either surface.
    at_points: [Vec<AtPoint>; 2],
    search: NearestSearch,
}

impl MinimumTest {
    /// Capacities of the buffers, which show whether one has grown.
    pub fn capacities(&self) -> [usize; 3] {
        let [probe, scene] = &self.at_points;
        [probe.capacity(), scene.capacity(), self.search.capacity()]
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> usize {
        self.at_points.iter().map(|list| list.capacity() * size_of::<AtPoint>()).sum()
    }

    /// Whether no triangle at a contact's point on one surface is closer to those at its point on the other.
    /// `precision`: smallest length that counts as more than zero, m.
    pub fn is_minimum(
        &mut self,
        found: &PatchContact,
        to_probe: &Pose,
        [probe, scene]: &[Side; 2],
        precision: f64,
    ) -> bool {
        let PatchContact { contact, probe_node, scene_node, .. } = found;
        let radii = probe.own.node(*probe_node).radius + scene.own.node(*scene_node).radius;
        let same = SAME_POINT * radii + precision;
        let limits = Undercut { same, slide: precision, closer: contact.distance() - same };
        let points = [contact.point, contact.scene_point].map(|point| to_probe.transform_point(point));
        let in_scene = points.map(|point| probe.to_other.point(point));
        let Self { at_points: [at_probe, at_scene], search } = self;
        let surfaces = [probe.own.patchwork(), scene.own.patchwork()];
        if limits.one_sided(search, surfaces[0], *probe_node, points, at_probe)
            || limits.one_sided(search, surfaces[1], *scene_node, [in_scene[1], in_scene[0]], at_scene)
        {
            return false;
        }
        // On surfaces that slope a little, both points together may slide further than either one.
        at_probe.iter().all(|a| {
            at_scene.iter().all(|b| {
                !(a.slides || b.slides)
                    || !limits.has(&a.corners, points[0])
                    || !limits.has(&b.corners, in_scene[1])
                    || !limits.joint(&a.corners, &b.corners, &scene.to_other, precision)
            })
        })
    }
}

/// Lengths that decide whether surfaces are closer than a contact.
#[derive(Clone, Copy, Debug)]
struct Undercut {
    /// Largest distance of points that are the same, m.
    same: f64,
    /// Distance beyond which a nearest point differs from the contact's, m.
    slide: f64,
    /// Distance below which surfaces are closer than the contact, m.
    closer: f64,
}

impl Undercut {
    /// Whether a triangle at a contact's point on a surface is closer to the other point (both in the
    /// surface's frame). If none is, lists the triangles of all patches that may have the point.
    fn one_sided(
        &self,
        search: &mut NearestSearch,
        surface: &Patchwork,
        node: u32,
        [own, other]: [DVec3; 2],
        at: &mut Vec<AtPoint>,
    ) -> bool {
        at.clear();
        let neighbours = &surface.neighbours;
        let Some(found) = search.on_patch(surface, node, own, 2.0 * self.same) else { return false };
        let towards = other - own;
        for &triangle in neighbours.around(found.nearest_vertex(surface)) {
            let corners = neighbours.corners(triangle);
            // A triangle at the point has closer points only if one of its corners lies on that side.
            let slides = corners.iter().any(|corner| (corner - own).dot(towards) > 0.0);
            if slides && !self.has(&corners, own) {
                continue;
            }
            let nearest = if slides { nearest_on(&corners, other) } else { own };
            if nearest.distance(other) < self.closer {
                return true;
            }
            at.push(AtPoint { corners, slides: nearest.distance(own) > self.slide });
        }
        false
    }

    /// Whether a point lies on a triangle.
    fn has(&self, corners: &[DVec3; 3], point: DVec3) -> bool {
        in_box(point, *corners, self.same) && nearest_on(corners, point).distance(point) <= self.same
    }

    /// Whether two triangles, each in its body's frame, are closer to one another.
    fn joint(&self, a: &[DVec3; 3], b: &[DVec3; 3], to_probe: &Placement, precision: f64) -> bool {
        let limits = Limits { beyond: self.closer.max(0.0), share: 0.0, enough: -1.0, precision };
        let start = Start::Axis(a[0] - to_probe.point(b[0]));
        let found = gjk::distance(&Hull::new(a), &Hull::new(b), to_probe, start, &limits);
        found.separation != Separation::Beyond && found.distance < self.closer
    }
}

/// The point of a triangle nearest to another point.
fn nearest_on(corners: &[DVec3; 3], point: DVec3) -> DVec3 {
    let (p, q, r) = (corners[0] - point, corners[1] - point, corners[2] - point);
    let [u, v, w] = nearest_on_triangle(p, q, r);
    point + u * p + v * q + w * r
}
