//! Which features of two surfaces touch near a guarded point, and along which normal.
//!
//! Where surfaces touch, the direction between them is a normal of the features on both sides: that of a
//! face, one between those of the faces beside an edge, or in the cone of those around a vertex. Else one of
//! both has a nearer place. A guarded point stays on the vertices and edges of its own surface, so that its
//! nearest point may be off such a place: at an edge inside a flat floor ahead of a body that slides over it,
//! say, the nearest is the body's lower edge in front. A contact along that direction would hold the body in
//! its way (an internal edge or ghost collision), where it just slides over the floor.
//!
//! So each direction is held against the normals of the features on both sides ([`FeatureMesh::rise`]). Where
//! it is not one of them, the features are sought that touch: two edges touch along the normal of both,
//! wherever on them the point has come to rest; else the nearest points of both surfaces are taken in turn.
//! Should neither find any, the surfaces touch elsewhere, where the point's leash or the lack of edges keeps
//! it from. A direction along an edge is no contact then: further along it, another point is nearer. Nor is
//! one that is aslant of an edge which goes on beyond what it is over: it is held across the edge. Any other
//! sharp feature is held as it is, as a place of the body that may not pass the other one. So is a point in a
//! flat part of its surface, unless it is the other surface that ends nearby: then that one's nearest point
//! may not pass the plane of this one, which goes on.

use palpate_core::glam::{DAffine3, DVec3};
use palpate_field::{ClosestPoint, FeatureMesh, MeshFeature, Place, where_nearest};

use super::{Descent, Frames, GuardedPoint, Measured, Sides};

/// Slope up to which a direction is a normal of a feature: twice that at which points leave a vertex. With
/// more, surfaces are pushed sideways by that share of the contact force; with less, points at rest are off
/// the features that touch.
const LEVEL: f64 = 2e-3;

/// Slope from which such a direction gives way to the normal of the surface that goes on beyond the other
/// one. With more, heavy bodies are pushed sideways; with less, steps take longer.
const TILT: f64 = 1e-4;

/// Slope up to which what is beside a face by less than surfaces are apart is over it. With more, edges are
/// held nearer than they are; with less, surfaces that slide over level tiles are pushed sideways.
const STEEP: f64 = 0.1;

/// Slope beyond the normals of a feature, relative to its sharpness, up to which it stands for another one
/// nearby. With more, surfaces are pushed sideways at edges inside bent faces; with less, points on leashes
/// do not hold what touches beside them.
const BLUNT: f64 = 2.0;

/// Slope of a direction along an edge from which the edge comes nearer where it goes on, so that another
/// point is there.
const ALONG_EDGE: f64 = 0.7;

/// The same where only its leash keeps the point from there. With less, an edge that a step turns downwards
/// is held late; with more, surfaces are pushed along edges.
const LEASHED: f64 = 0.3;

/// Number of moves that a point tries beyond those of each step where it is not yet at features that touch.
/// With fewer, features that it only passes are taken for such; with more, steps may take longer.
const MAX_FURTHER_MOVES: u32 = 16;

/// Largest depth of crossing edges relative to that of the point. With less, the edges of sharp wedges do not
/// cross; with more, edges on other sides of the bodies do.
const MAX_CROSSING: f64 = 4.0;

/// Slope of the normal of crossing edges beyond those of their surfaces up to which they hold an overlap.
/// With less, narrow flat parts slip through; with more, edges on other sides of the bodies hold them.
const LEAN: f64 = 0.3;

/// Number of times that the nearest points are taken in turn. With fewer, edges that nearly lie along each
/// other are not held; with more, steps take longer.
const TURNS: u32 = 4;

/// Sine of the angle between faces from which the line along which they meet is told by their normals. With
/// less, it is rounding.
const BENT: f64 = 1e-3;

/// Distance of where the other surface ends from the point that is nearest there, in lengths of the leash and
/// of the distance between the surfaces, up to which it ends nearby. With less, points in flat parts of a
/// surface push sideways at the edges of another one; with more, those inside bent surfaces do.
const NEARBY: f64 = 4.0;

/// Distance of a feature from the other surface up to which it may be where bodies leave an overlap, and
/// distance beside it at which its own surface is looked at, in margins. With more, other places are looked
/// at; with less, bodies are held where they leave each other at a low angle.
const LEAVING: f64 = 128.0;
const BESIDE: f64 = 1024.0;

/// Sharpness from which a feature within an overlap is where bodies leave it, whatever is beside. With less,
/// bent surfaces that start deep in each other stay there; with more, edges hold parts in a press fit.
const SHARP: f64 = 0.5;

/// Depth of an overlap that bodies leave, in margins: more than that to which they yield. With more, bodies
/// are held that leave a small overlap; with less, those that have yielded are let in.
pub(crate) const OVERLAP: f64 = 48.0;

/// Points of both surfaces that touch, in the frame of the guarded point's own body.
#[derive(Clone, Copy, Debug)]
struct Pair {
    /// The point on its own surface, m.
    own: DVec3,
    /// The one on the other surface, m.
    other: DVec3,
    /// Unit normal out of its own surface.
    normal: DVec3,
    /// Signed distance along it, m.
    distance: f64,
}

impl GuardedPoint {
    /// Whether the direction from the other surface is one of the normals there, but for a slight tilt.
    #[inline(always)]
    pub(super) fn is_normal(&self, frames: &Frames<'_>, closest: &ClosestPoint) -> bool {
        let Sides { own, to_own, .. } = frames.sides(self.is_probe);
        own.rise(self.place.into(), -to_own.transform_vector3(closest.normal)) <= TILT
    }

    /// The measurement of a point at the features that touch.
    #[inline(never)]
    pub(super) fn touching(&mut self, frames: &Frames<'_>, descent: &Descent) -> Measured {
        let sides = frames.sides(self.is_probe);
        let outward = |descent: &Descent| -sides.to_own.transform_vector3(descent.closest.normal);
        let (mut descent, mut rise) = (*descent, sides.own.rise(self.place.into(), outward(descent)));
        if rise > LEVEL {
            let Descent { position, closest, .. } = descent;
            let (normal, feature) = (outward(&descent), self.place.into());
            let here = ClosestPoint { point: position, normal, feature, ..closest };
            let is_known = self.trust > 0.0;
            if leaves_an_overlap(&here, is_known, (sides.own, sides.other), sides.to_other, frames.margin) {
                return Measured { distance: f64::INFINITY, ..self.measured(frames, &descent) };
            }
            if !descent.is_settled {
                descent = self.descend(frames, MAX_FURTHER_MOVES, f64::NEG_INFINITY);
                rise = sides.own.rise(self.place.into(), outward(&descent));
            }
        }
        let facing = |within: f64| self.facing((&sides, frames.margin), &descent, (rise / BLUNT, within));
        let Descent { closest, .. } = descent;
        let is_over = matches!(closest.feature, MeshFeature::Face(_));
        if is_over && rise <= TILT {
            return self.measured(frames, &descent);
        }
        if rise <= LEVEL {
            // Over a face, the surface that goes on beyond the other one has the normal; at other features,
            // one that is flat; of edges that may lie along each other, that of the scene, since the probe
            // moves.
            // Where both overlap, the nearest way out may be through another face beside.
            let is_level = |pair: &Pair| pair.normal.dot(outward(&descent)) >= 1.0 - LEVEL;
            let pair =
                if is_over { facing(f64::MAX).filter(is_level) } else { self.level_pair(&sides, &descent) };
            return match pair {
                Some(pair) => self.at_pair(frames, &descent, &pair),
                None if !is_over && (self.is_probe || rise <= TILT) => self.measured(frames, &descent),
                None => self.across(frames, &sides, &descent, true),
            };
        }
        let is_held = rise <= BLUNT * sides.own.sharpness(self.place.into());
        // A sharp feature over a face may not pass that.
        if is_held && closest.distance >= 0.0 && matches!(closest.feature, MeshFeature::Face(_)) {
            // Unless it is an edge that has come to one of that face's.
            return match self.crossing(&sides, &descent) {
                Some(pair) => self.at_pair(frames, &descent, &pair),
                None => self.across(frames, &sides, &descent, true),
            };
        }
        let pair = self.crossing(&sides, &descent).or_else(|| self.in_turn(&sides, &descent));
        let is_held = is_held || closest.distance < 0.0;
        let within = NEARBY * (f64::from(self.leash.length) + closest.distance.abs());
        match pair.or_else(|| if is_held { None } else { facing(within) }) {
            Some(pair) => self.at_pair(frames, &descent, &pair),
            None => self.across(frames, &sides, &descent, is_held),
        }
    }

    /// The measurement of a point on an edge that comes nearer beyond the leash, where others are, or nearby,
    /// where it has not come yet. It is across the edge, which may slide along itself, and across the other
    /// surface's edge if that is nearest; over a face, only if the edge goes on beyond that. An edge inside a
    /// bent surface is as it is: others of that are nearer.
    fn across(&self, frames: &Frames<'_>, sides: &Sides<'_>, descent: &Descent, is_held: bool) -> Measured {
        let measured = self.measured(frames, descent);
        let Place::Edge(edge, _) = self.place else { return measured };
        let Descent { position, closest, .. } = *descent;
        let outward = -sides.to_own.transform_vector3(closest.normal);
        let [from, to] = sides.own.ends(edge);
        let direction = (to - from).normalize_or_zero();
        let slope = outward.dot(direction);
        let far = self.leash.unbounded();
        let goes_on = |leash| sides.own.descend(&self.place, -outward, 1.0, leash).is_some();
        // What is no sharper than its surface beside it touches nothing where it is not level.
        let steep = if is_held { LEASHED } else { LEVEL };
        let is_leashed = || slope.abs() > steep && !goes_on(&self.leash) && goes_on(&far);
        if slope.abs() > ALONG_EDGE || is_leashed() {
            return Measured { distance: f64::INFINITY, ..measured };
        }
        // In an overlap from the start, what is aslant of an edge would hold bodies that leave each other.
        if !is_held || frames.margin.is_some() && closest.distance < 0.0 {
            return measured;
        }
        let level = (outward - direction * slope) / (1.0 - slope * slope).sqrt();
        let across_both =
            |along: DVec3| across(direction, sides.to_own.transform_vector3(along), outward).unwrap_or(level);
        let (normal, distance) = match closest.feature {
            MeshFeature::Face(_) => {
                let lower = if slope > 0.0 { to } else { from };
                let end = sides.other.walk(sides.to_other.transform_point3(lower), closest.face);
                if end.normal.dot(closest.normal) >= 1.0 - LEVEL {
                    return measured;
                }
                let normal = across_both(bend(sides.other, closest.normal, &end));
                (normal, closest.distance / normal.dot(outward))
            }
            MeshFeature::Edge(other) => {
                let [from, to] = sides.other.ends(other);
                let both = across(direction, sides.to_own.transform_vector3(to - from), outward);
                // Of edges that lie nearly along each other, it is across the scene's: the probe moves.
                let normal = both.unwrap_or(if self.is_probe { outward } else { level });
                (normal, closest.distance * normal.dot(outward))
            }
            MeshFeature::Vertex(_) => (level, closest.distance * level.dot(outward)),
        };
        let pair = Pair { own: position, other: position + normal * distance, normal, distance };
        self.at_pair(frames, descent, &pair)
    }

    /// The measurement of a point by two that touch.
    fn at_pair(&self, frames: &Frames<'_>, descent: &Descent, pair: &Pair) -> Measured {
        let Pair { own, other, normal, distance } = *pair;
        let (point, normal) = if self.is_probe {
            let probe = &frames.probe.1;
            (probe.transform_point3(own), probe.transform_vector3(normal))
        } else {
            let object = &frames.object.1;
            (object.transform_point3(other), -object.transform_vector3(normal))
        };
        let Descent { closest, is_settled, .. } = *descent;
        let held = self.held(frames, closest.feature, normal);
        Measured { point, normal, distance, nearest: closest.distance, is_settled, held }
    }

    /// The nearest points along the normal that they are level with.
    fn level_pair(&self, sides: &Sides<'_>, descent: &Descent) -> Option<Pair> {
        let Descent { position, closest, .. } = *descent;
        let outward = -sides.to_own.transform_vector3(closest.normal);
        let normal =
            self.level_normal(sides, (self.place.into(), closest.feature), (outward, closest.distance))?;
        let other = sides.to_own.transform_point3(closest.point);
        Some(Pair { own: position, other, normal, distance: normal.dot(other - position) })
    }

    /// The points where the edge that the point is on crosses one that is nearest, or beside the face that
    /// is.
    fn crossing(&self, sides: &Sides<'_>, descent: &Descent) -> Option<Pair> {
        let Descent { position, closest, .. } = *descent;
        let Place::Edge(edge, _) = self.place else { return None };
        match closest.feature {
            MeshFeature::Edge(other) => {
                // No further from each other than the point is.
                let found = self.crossing_of(sides, edge, other, LEVEL)?;
                (found.distance.abs() <= (1.0 + LEVEL) * closest.distance.abs()).then_some(found)
            }
            MeshFeature::Face(face) => {
                let at = (position, closest.distance);
                let found = self.crossing_at(sides, (edge, face), at, LEVEL);
                if found.is_some() || closest.distance >= 0.0 {
                    return found;
                }
                // In an overlap, edges that nearly have that normal cross, too: an edge inside a narrow flat
                // part has the part's alone, and it is the part's border that crosses.
                self.crossing_at(sides, (edge, face), at, LEAN)
            }
            MeshFeature::Vertex(_) => None,
        }
    }

    /// The points where an edge of its own surface crosses one of the other surface's face that is nearest to
    /// a position at a distance (m). `slope` is that up to which the direction across both is a normal.
    fn crossing_at(
        &self,
        sides: &Sides<'_>,
        (edge, face): (u32, u32),
        (position, distance): (DVec3, f64),
        slope: f64,
    ) -> Option<Pair> {
        let is_there = |other: u32, pair: &Pair| {
            if distance < 0.0 {
                // That of the overlap, and not of other sides of both bodies: the point is beside the other
                // edge, though the way to where they cross may be long.
                let most = -MAX_CROSSING * distance;
                let [from, to] = sides.other.ends(other).map(|end| sides.to_own.transform_point3(end));
                let beside = (position - from).cross((to - from).normalize_or_zero());
                (0.0..=most).contains(&-pair.distance) && beside.length_squared() <= most * most
            } else {
                // Where the edge comes nearer, beyond the leash if that has stopped the point.
                let way = pair.own.distance_squared(position);
                let nearer = distance - pair.distance;
                nearer >= 0.0 && nearer * nearer <= way && way <= f64::from(self.leash.length).powi(2)
            }
        };
        let crossing =
            |other| self.crossing_of(sides, edge, other, slope).filter(|pair| is_there(other, pair));
        let found = sides.other.edges_of(face).into_iter().filter_map(crossing);
        found.max_by(|a, b| a.distance.total_cmp(&b.distance))
    }

    /// The other surface's nearest point with its own nearest on this surface, which is flat there, if it is
    /// the other one that ends nearby: `within` a distance (m), at an edge sharper than `least`.
    fn facing(
        &self,
        (sides, margin): (&Sides<'_>, Option<f64>),
        descent: &Descent,
        (least, within): (f64, f64),
    ) -> Option<Pair> {
        let Sides { own, other, to_own, to_other, .. } = *sides;
        let there = descent.closest;
        let at = to_own.transform_point3(there.point);
        let here = nearest_here(sides, at, own.face_at(self.place.into()), there.distance);
        let ends = other.to_sharp_edge(there.face, there.point, least);
        let ClosestPoint { point, normal, distance, face, .. } = here;
        // Where it ends further away than the point has to go, that does not matter here.
        let is_other = ends <= within && ends <= own.to_sharp_edge(face, point, least);
        let towards = -to_other.transform_vector3(normal);
        let end = ClosestPoint { normal: towards, distance, face, ..there };
        if !is_other || leaves_an_overlap(&end, false, (other, own), to_own, margin) {
            return None;
        }
        // An edge that comes nearer beyond the plane of this surface is held across both.
        let held = match there.feature {
            MeshFeature::Edge(edge) => {
                let [from, to] = other.ends(edge).map(|end| to_own.transform_point3(end));
                let direction = to - from;
                let end = own.walk(if normal.dot(direction) > 0.0 { from } else { to }, face);
                let is_beyond = end.normal.dot(normal) < 1.0 - LEVEL;
                // One that comes along the normal is held by what is beside this surface.
                if is_beyond && direction.dot(normal).abs() > ALONG_EDGE * direction.length() {
                    return None;
                }
                let both = || across(direction, bend(own, normal, &end), normal);
                is_beyond.then(both).flatten().unwrap_or(normal)
            }
            _ => normal,
        };
        Some(Pair { own: point, other: at, normal: held, distance: distance * held.dot(normal) })
    }

    /// The points at which the nearest of each surface, taken in turn, end.
    fn in_turn(&self, sides: &Sides<'_>, descent: &Descent) -> Option<Pair> {
        let Sides { own, other, to_own, to_other, .. } = *sides;
        let (mut there, mut feature) = (descent.closest, MeshFeature::from(self.place));
        for _ in 0..TURNS {
            let at = to_own.transform_point3(there.point);
            let here = nearest_here(sides, at, own.face_at(feature), there.distance);
            feature = here.feature;
            if (there.distance < 0.0) != (here.distance < 0.0) {
                // Through a body, the nearest point may be on its far side.
                return None;
            }
            let inward = -to_other.transform_vector3(here.normal);
            if other.rise(there.feature, inward) <= LEVEL {
                let direction = (here.normal, here.distance);
                let normal =
                    self.level_normal(sides, (feature, there.feature), direction).unwrap_or(here.normal);
                let distance = normal.dot(at - here.point);
                return Some(Pair { own: here.point, other: at, normal, distance });
            }
            if there.distance < 0.0 || here.distance < 0.0 {
                // Inside, the nearest points lead out of an overlap, and not to where it is deepest.
                return None;
            }
            if let (MeshFeature::Edge(edge), MeshFeature::Edge(beyond)) = (feature, there.feature)
                && let Some(pair) = self.crossing_of(sides, edge, beyond, LEVEL)
                && pair.distance.abs() <= (1.0 + LEVEL) * here.distance
            {
                return Some(pair);
            }
            there = other.walk(to_other.transform_point3(here.point), there.face);
            let normal = -to_own.transform_vector3(there.normal);
            if own.rise(feature, normal) <= LEVEL {
                let direction = (normal, there.distance);
                let normal = self.level_normal(sides, (feature, there.feature), direction).unwrap_or(normal);
                let other = to_own.transform_point3(there.point);
                let distance = normal.dot(other - here.point);
                return Some(Pair { own: here.point, other, normal, distance });
            }
        }
        None
    }

    /// The normal that features that touch are level with: that of the one surface that is flat there, if the
    /// other one is not, or of a face of the scene beside an edge. It is out of the guarded point's own
    /// surface, and near a unit vector at a distance (m). That of a wall's far side is not.
    fn level_normal(
        &self,
        sides: &Sides<'_>,
        (here, there): (MeshFeature, MeshFeature),
        (towards, distance): (DVec3, f64),
    ) -> Option<DVec3> {
        let Sides { own, other, to_own, to_other, off_face } = *sides;
        let is_flat = |surface: &FeatureMesh, feature| surface.sharpness(feature) <= TILT;
        let is_own = match (is_flat(own, here), is_flat(other, there)) {
            (true, false) => true,
            (false, true) => false,
            // The probe moves along the scene's faces.
            (false, false) => !self.is_probe,
            (true, true) => return None,
        };
        let normal = if is_own {
            own.normal_near(here, towards)
        } else {
            -to_own.transform_vector3(other.normal_near(there, -to_other.transform_vector3(towards)))
        };
        if normal.dot(towards) <= 0.0 {
            return None;
        }
        // What is beside the scene's face by less than surfaces are apart is over it, if all of it there is
        // above that: a plane aslant would hold it in its way where the floor goes on.
        let slope = normal.cross(towards).length();
        let is_above = || {
            let (surface, feature, down) = if self.is_probe {
                (own, here, normal)
            } else {
                (other, there, -to_other.transform_vector3(normal))
            };
            is_own != self.is_probe && surface.rise(feature, down) <= LEVEL
        };
        let is_level = slope <= LEVEL || (slope <= STEEP && slope * distance.abs() <= off_face && is_above());
        is_level.then_some(normal)
    }

    /// The points at which two edges, of the guarded point's own surface and of the other one, cross, if the
    /// direction across both is a normal of both surfaces there, up to a slope.
    fn crossing_of(&self, sides: &Sides<'_>, edge: u32, other_edge: u32, slope: f64) -> Option<Pair> {
        let Sides { own, other, to_own, to_other, .. } = *sides;
        let [here, there] = [own.ends(edge), other.ends(other_edge).map(|end| to_own.transform_point3(end))];
        let ([s, t], both) = where_nearest(here, there)?;
        if !(0.0..=1.0).contains(&s) || !(0.0..=1.0).contains(&t) {
            return None;
        }
        let normal = both / both.length();
        let normal = if normal.dot(own.out_of(edge)) < 0.0 { -normal } else { normal };
        let inward = -to_other.transform_vector3(normal);
        let is_normal = |surface: &FeatureMesh, edge: u32, normal: DVec3| {
            surface.rise(MeshFeature::Edge(edge), normal) <= slope
        };
        if !is_normal(own, edge, normal) || !is_normal(other, other_edge, inward) {
            return None;
        }
        let features = (MeshFeature::Edge(edge), MeshFeature::Edge(other_edge));
        let normal = self.level_normal(sides, features, (normal, 0.0)).unwrap_or(normal);
        let [own, other] = [(here, s), (there, t)].map(|([from, to], at)| from + (to - from) * at);
        Some(Pair { own, other, normal, distance: normal.dot(other - own) })
    }
}

/// The line along which a surface bends between a face with a normal and what is nearest further on: across
/// the normals of both faces, or if they are one, across the direction from there.
pub(super) fn bend(surface: &FeatureMesh, normal: DVec3, end: &ClosestPoint) -> DVec3 {
    let line = normal.cross(surface.normal_near(end.feature, end.normal));
    if line.length_squared() > BENT * BENT { line } else { normal.cross(end.normal) }
}

/// The unit normal across two edges, towards a unit vector; `None` if it is far from that, as those of edges
/// that lie along each other may be.
fn across(edge: DVec3, other: DVec3, towards: DVec3) -> Option<DVec3> {
    let both = edge.cross(other).normalize_or_zero();
    let facing = both.dot(towards);
    (facing.abs() > ALONG_EDGE).then(|| both * facing.signum())
}

/// Whether a feature of a surface, with the direction towards another one and the nearest face of that, is
/// where bodies that overlap pass out of each other: the surface beside it is well inside, and points there
/// hold that. The distance may be known to be that from the whole of the other surface.
fn leaves_an_overlap(
    at: &ClosestPoint,
    is_known: bool,
    (surface, other): (&FeatureMesh, &FeatureMesh),
    to_other: &DAffine3,
    margin: Option<f64>,
) -> bool {
    let Some(margin) = margin.filter(|margin| at.distance <= LEAVING * margin) else { return false };
    let depth = -OVERLAP * margin;
    // Where a bent surface is no deeper beside, the point holds the overlap itself.
    let is_bent = surface.sharpness(at.feature) <= SHARP && surface.rise(at.feature, at.normal) <= SHARP;
    let is_edge = at.distance < depth && !is_bent;
    let (beside, deeper) = if is_edge {
        (at.point, depth)
    } else {
        let beside = surface.beside(at.feature, at.point, at.normal, BESIDE * margin);
        (beside, at.distance.min(depth))
    };
    let beside = to_other.transform_point3(beside);
    let walked = other.walk(beside, at.face).distance;
    if is_known && walked < 0.0 {
        return walked < deeper;
    }
    #[cfg(test)]
    super::SEARCHES.set(super::SEARCHES.get() + 1);
    // A walk may end on the far side of a wall.
    other.nearer(beside, walked.abs()).map_or(walked, |nearest| nearest.distance) < deeper
}

/// The point of the guarded point's own surface that is nearest to a point of the other one (its frame, m),
/// by a walk from a face. One may end on the far side of a wall, which looks like an overlap: of surfaces
/// that are at a `distance` (m) elsewhere, this is searched for in the whole surface.
fn nearest_here(sides: &Sides<'_>, at: DVec3, face: u32, distance: f64) -> ClosestPoint {
    let here = sides.own.walk(at, face);
    if here.distance >= 0.0 || distance < 0.0 {
        return here;
    }
    sides.own.nearer(at, -here.distance).unwrap_or(here)
}
