//! Convex surface patches (§3.3.1), and the test whether the union of two of them is one.
//!
//! A patch is a set of triangles that all lie on the surface of its convex hull: the whole patch lies below
//! the plane of each. This implies the local constraint, that interior edges are convex (Eq. 3.2), but the
//! local constraint does not imply it: all edges of a spiral ramp are convex. The global constraint is that
//! the hull does not protrude from the object. Where its real faces lie on the surface, with the object below
//! them, the hull lies inside the object exactly if no surface reaches into its interior. Ehmann and Lin
//! (2001) test the virtual faces against the surface and so miss a component that lies wholly inside of the
//! hull, such as a small cavity; here the interior itself is tested.
//!
//! All heights have the same tolerance: other vertices of a patch may lie that far above the plane of a
//! triangle, and other surface may reach that deep into the hull. In a hull that is not much thicker than the
//! tolerance, the permitted depth is smaller: no point is deep in it, and walls of a notch that it spans
//! would not be noticed. A hull that is thinner than the tolerance is flat: it has no interior. It protrudes
//! where it spans a notch or a hole of the flat face, whose walls go down from the face's plane. So no
//! surface may reach into the layer just below it, between one and two tolerances deep. The same holds for
//! the layer below a thin hull, since it may be thinner than the tolerance in places.
//!
//! Both constraints are monotone: if two patches fail, so do any two larger ones that contain them. (The one
//! exception is the two sides of a sheet that is thinner than the tolerance: they are never joined.)

use std::borrow::Cow;
use std::f64::consts::FRAC_1_SQRT_2;

use glam::DVec3;

use crate::box_tree::Bounds;
use crate::hull::{Hull, HullBuilder, Plane, Shape, polygon};
use crate::skin::Skin;
use crate::surface::{ReachBuffers, Surface, bounds_of, reaches_below};

/// Height, in unit coordinates, below which hulls drop points: about the rounding of the predicates' inputs.
pub(crate) const HULL_THICKNESS: f64 = 1e-14;

/// Largest number of triangles of a patch, unless the whole mesh is one. Hulls of larger ones are poor bounds
/// of a place on them, and the cost of a collapse grows with the patch.
pub(crate) const MAX_PATCH_TRIANGLES: usize = 256;

/// Ratio of the thickness of a thin hull to the depth to which other surface may reach into it. A smaller one
/// lets hulls span notches.
const THICKNESS_PER_DEPTH: f64 = 12.0;

/// Largest thickness, in tolerances, of hulls that are tested for notches on top of them, which the test of
/// the hull's interior does not find.
const MAX_SHEET_THICKNESS: f64 = 64.0;

/// A convex surface patch.
#[derive(Clone, Debug)]
pub(crate) struct Patch {
    /// Its triangles, as indices into the mesh.
    pub triangles: Vec<u32>,
    /// Mesh vertices: the extreme points of its hull.
    pub extreme: Vec<u32>,
    /// Bounds of the hull, in unit coordinates.
    pub bounds: (DVec3, DVec3),
    /// Whether the hull has no interior, up to the tolerance.
    pub flat: bool,
    /// Its largest triangle.
    pub lead: u32,
}

impl Patch {
    /// Replaces the patch by its union with another, given their common hull.
    pub fn take_in(&mut self, mut other: Self, join: Join, convexity: &Convexity<'_>) {
        if convexity.area(other.lead) > convexity.area(self.lead) {
            self.lead = other.lead;
        }
        self.triangles.append(&mut other.triangles);
        (self.extreme, self.bounds, self.flat) = (join.extreme, join.bounds, join.flat);
    }
}

/// The hull of two patches that may be joined.
pub(crate) struct Join {
    extreme: Vec<u32>,
    bounds: (DVec3, DVec3),
    flat: bool,
}

/// Buffers of the joining test.
#[derive(Debug, Default)]
pub(crate) struct JoinBuffers {
    pub hulls: HullBuilder,
    pub reach: ReachBuffers,
    vertices: Vec<u32>,
    points: Vec<DVec3>,
}

/// The convexity test on one surface.
#[derive(Debug)]
pub(crate) struct Convexity<'a> {
    surface: &'a Surface,
    /// The tolerance, in unit coordinates.
    tolerance: f64,
    /// Planes of the triangles: see [`dependable_planes`].
    planes: Cow<'a, [Plane]>,
}

impl<'a> Convexity<'a> {
    /// Prepares the test; `neighbours` are the triangles across the sides of each, or `u32::MAX`.
    pub fn new(surface: &'a Surface, neighbours: &[[u32; 3]], tolerance: f64) -> Self {
        Self { surface, tolerance, planes: Cow::Owned(dependable_planes(surface, neighbours, tolerance)) }
    }

    /// The test on a surface whose planes are known.
    pub fn with_planes(surface: &'a Surface, planes: &'a [Plane], tolerance: f64) -> Self {
        Self { surface, tolerance, planes: Cow::Borrowed(planes) }
    }

    /// The patch of a single triangle.
    pub fn single(&self, triangle: u32) -> Patch {
        let mut extreme = self.surface.triangles[triangle as usize].to_vec();
        extreme.sort_unstable();
        extreme.dedup();
        let corners = self.surface.corners(triangle);
        Patch { triangles: vec![triangle], extreme, bounds: bounds_of(&corners), flat: true, lead: triangle }
    }

    /// The hull of two patches together, if their union is a convex patch; `mine` are the triangles of the
    /// two.
    pub fn join(
        &self,
        a: &Patch,
        b: &Patch,
        mine: impl Fn(u32) -> bool,
        buffers: &mut JoinBuffers,
    ) -> Option<Join> {
        if a.triangles.len() + b.triangles.len() > MAX_PATCH_TRIANGLES {
            return None;
        }
        let (lead_a, lead_b) = (self.planes[a.lead as usize], self.planes[b.lead as usize]);
        if lead_a.normal == DVec3::ZERO || lead_b.normal == DVec3::ZERO {
            return None;
        }
        // The planes of the largest triangles decide most cases.
        let supports =
            |a: &Patch, b: &Patch| a.triangles.iter().all(|t| self.below(b, &self.planes[*t as usize]));
        if !(self.below(b, &lead_a) && self.below(a, &lead_b) && supports(a, b) && supports(b, a)) {
            return None;
        }
        let flat_on = |patch: &Patch, plane: &Plane| {
            patch.extreme.iter().all(|v| plane.height(self.point(*v)) >= -self.tolerance)
        };
        let lead = if self.area(a.lead) >= self.area(b.lead) { &lead_a } else { &lead_b };
        let flat = a.flat && b.flat && flat_on(a, lead) && flat_on(b, lead);
        if flat && lead_a.normal.dot(lead_b.normal) <= 0.0 {
            // Two sides of a sheet, or of a crack: the vertices do not determine which.
            return None;
        }
        let bounds = (a.bounds.0.min(b.bounds.0), a.bounds.1.max(b.bounds.1));
        buffers.vertices.clear();
        buffers.vertices.extend_from_slice(&a.extreme);
        buffers.vertices.extend_from_slice(&b.extreme);
        let thickness = self.thickness(lead, a.extreme.iter().chain(&b.extreme));
        let depth = self.depth_of(thickness);
        let extreme = self.hull(&[], bounds, flat.then_some(lead), depth, &mine, buffers)?;
        let JoinBuffers { points, reach, .. } = buffers;
        let spans_notch = !flat && self.spans_notch(lead, thickness, points, mine, reach);
        (!spans_notch).then_some(Join { extreme, bounds, flat })
    }

    /// The patch that many triangles make at once; `None` if they do not make one, or it is flat.
    pub fn whole(
        &self,
        triangles: &[u32],
        mine: impl Fn(u32) -> bool,
        buffers: &mut JoinBuffers,
    ) -> Option<Patch> {
        buffers.vertices.clear();
        buffers.vertices.extend(triangles.iter().flat_map(|t| self.surface.triangles[*t as usize]));
        let corners: Vec<DVec3> = buffers.vertices.iter().map(|v| self.point(*v)).collect();
        let bounds = bounds_of(&corners);
        let extreme = self.hull(triangles, bounds, None, self.tolerance, mine, buffers)?;
        let lead = *triangles.iter().max_by(|a, b| self.area(**a).total_cmp(&self.area(**b)))?;
        let plane = self.planes[lead as usize];
        let dependable = triangles.iter().all(|t| self.planes[*t as usize].normal != DVec3::ZERO);
        let flat = extreme.iter().all(|v| plane.height(self.point(*v)) >= -self.tolerance);
        (dependable && !flat).then(|| Patch { triangles: triangles.to_vec(), extreme, bounds, flat, lead })
    }

    /// The patch that a few triangles make, with its skin and its vertices in ascending order; `None` if they
    /// do not make one. `moved` selects the triangles that were not in the patch in their present form, and
    /// names the vertex that has moved: the other triangles are known to support all other vertices. `mine`
    /// are these triangles, and those `others` for which the surface's spatial index is out of date, which
    /// are therefore tested one by one. The rest of the surface is known not to reach into the hull outside
    /// the box `part`; this does not include the layer below a flat one.
    pub fn patch(
        &self,
        triangles: &[u32],
        (moved, vertex): (impl Fn(u32) -> bool, u32),
        mine: impl Fn(u32) -> bool,
        others: impl Iterator<Item = u32>,
        part: Option<Bounds>,
        buffers: &mut JoinBuffers,
    ) -> Option<(Patch, Skin, Vec<u32>)> {
        let JoinBuffers { hulls, reach, vertices, points } = buffers;
        vertices.clear();
        vertices.extend(triangles.iter().flat_map(|t| self.surface.triangles[*t as usize]));
        vertices.sort_unstable();
        vertices.dedup();
        if let [only] = *triangles {
            return Some((self.single(only), Skin::Bare, vertices.clone()));
        }
        points.clear();
        points.extend(vertices.iter().map(|v| self.point(*v)));
        let apex = self.point(vertex);
        let supports = |t: &u32| {
            let plane = &self.planes[*t as usize];
            plane.normal != DVec3::ZERO
                && if moved(*t) {
                    points.iter().all(|p| plane.height(*p) <= self.tolerance)
                } else {
                    plane.height(apex) <= self.tolerance
                }
        };
        let touches = vertices.binary_search(&vertex).is_ok();
        if touches && !triangles.iter().all(supports) {
            return None;
        }
        let lead = *triangles.iter().max_by(|a, b| self.area(**a).total_cmp(&self.area(**b)))?;
        let plane = self.planes[lead as usize];
        let flat = points.iter().all(|p| plane.height(*p) >= -self.tolerance);
        if flat && triangles.iter().any(|t| self.planes[*t as usize].normal.dot(plane.normal) <= 0.0) {
            return None;
        }
        let bounds = bounds_of(points);
        let hull = hulls.hull(points, HULL_THICKNESS);
        let extreme = hull.extreme.iter().map(|k| vertices[*k as usize]).collect();
        let patch = Patch { triangles: triangles.to_vec(), extreme, bounds, flat, lead };
        let skin = self.skin(&patch, &hull, points);
        let (planes, depth) = (skin.planes(), skin.depth());
        if !planes.is_empty() {
            let margin = if flat { self.layer() } else { 0.0 };
            let mut around = (bounds.0 - margin, bounds.1 + margin);
            if let Some(part) = part.filter(|_| !flat) {
                around = (around.0.max(part.0), around.1.min(part.1));
            }
            if { others }.any(|t| reaches_below(&self.surface.corners(t), planes, depth, reach))
                || around.0.cmple(around.1).all()
                    && self.surface.reaches_into(planes.iter().copied(), around, depth, mine, reach)
            {
                return None;
            }
        }
        Some((patch, skin, vertices.clone()))
    }

    /// The polytope that other surface must not reach into; `hull` is that of `points`.
    pub fn skin(&self, patch: &Patch, hull: &Hull, points: &[DVec3]) -> Skin {
        if !patch.flat {
            let thickness = self.thickness(&self.planes[patch.lead as usize], patch.extreme.iter());
            return Skin::of_hull(hull, points, self.depth_of(thickness));
        }
        if patch.triangles.len() == 1 {
            return Skin::Bare;
        }
        let planes = layer_below(&self.planes[patch.lead as usize], points, self.layer()).collect();
        Skin::Layer { planes, depth: self.tolerance }
    }

    /// Largest depth of vertices below a plane.
    fn thickness<'v>(&self, top: &Plane, vertices: impl Iterator<Item = &'v u32>) -> f64 {
        vertices.map(|v| -top.height(self.point(*v))).fold(0.0, f64::max)
    }

    /// Whether a patch may span a notch by now: since it was made, only the interior of its hull was tested.
    pub fn may_span_notch(
        &self,
        patch: &Patch,
        mine: impl Fn(u32) -> bool,
        buffers: &mut JoinBuffers,
    ) -> bool {
        if patch.triangles.len() == 1 {
            return false;
        }
        let JoinBuffers { points, reach, .. } = buffers;
        points.clear();
        points.extend(patch.extreme.iter().map(|v| self.point(*v)));
        let top = &self.planes[patch.lead as usize];
        if patch.flat {
            return self.reached_below(top, points, patch.bounds, mine, reach);
        }
        self.spans_notch(top, self.thickness(top, patch.extreme.iter()), points, mine, reach)
    }

    /// Whether other surface reaches into the layer below a flat hull, which has the plane `top` and these
    /// points.
    fn reached_below(
        &self,
        top: &Plane,
        points: &[DVec3],
        (low, high): Bounds,
        mine: impl Fn(u32) -> bool,
        reach: &mut ReachBuffers,
    ) -> bool {
        let layer = layer_below(top, points, self.layer());
        let around = (low - self.layer(), high + self.layer());
        self.surface.reaches_into(layer, around, self.tolerance, mine, reach)
    }

    /// Whether a hull that is thin, but not flat, spans a notch or a hole of the surface on top of it: that
    /// is, whether there is other surface below it that does not face away, as the other side of a sheet
    /// does. `top` is the plane of one of its triangles, and `thickness` the depth of its vertices, the
    /// `points`, below that plane.
    fn spans_notch(
        &self,
        top: &Plane,
        thickness: f64,
        points: &[DVec3],
        mine: impl Fn(u32) -> bool,
        reach: &mut ReachBuffers,
    ) -> bool {
        if thickness > MAX_SHEET_THICKNESS * self.tolerance {
            return false;
        }
        let below = Plane { offset: top.offset - thickness, ..*top };
        // Near the rim, surface below the hull may be the other side of an edge: the sides of the layer are
        // moved inwards.
        let inset = |(k, p): (usize, Plane)| Plane {
            offset: p.offset - if k < 2 { 0.0 } else { thickness + self.tolerance },
            ..p
        };
        let layer = layer_below(&below, points, self.layer()).enumerate().map(inset);
        let (low, high) = bounds_of(points);
        let margin = thickness + self.layer();
        let faces_away = |t: u32| self.planes[t as usize].normal.dot(top.normal) < -FRAC_1_SQRT_2;
        let skip = |t: u32| mine(t) || faces_away(t);
        self.surface.reaches_into(layer, (low - margin, high + margin), self.tolerance, skip, reach)
    }

    /// Depth to which other surface may reach into a hull of a thickness.
    pub fn depth_of(&self, thickness: f64) -> f64 {
        permitted_depth(self.tolerance, thickness)
    }

    /// Thickness of the layer below a flat patch.
    pub fn layer(&self) -> f64 {
        3.0 * self.tolerance
    }

    /// The surface.
    pub fn surface(&self) -> &Surface {
        self.surface
    }

    /// The tolerance, in unit coordinates.
    pub fn tolerance(&self) -> f64 {
        self.tolerance
    }

    /// Plane of a triangle in the convexity test.
    pub fn plane(&self, triangle: u32) -> Plane {
        self.planes[triangle as usize]
    }

    /// The extreme points of the vertices in the buffers; `None` if their hull protrudes, or does not lie
    /// below the planes of the triangles `walk`. `flat` is the plane of a hull without interior; into any
    /// other hull, other surface may reach to `depth`.
    fn hull(
        &self,
        walk: &[u32],
        bounds: (DVec3, DVec3),
        flat: Option<&Plane>,
        depth: f64,
        mine: impl Fn(u32) -> bool,
        buffers: &mut JoinBuffers,
    ) -> Option<Vec<u32>> {
        let JoinBuffers { hulls, reach, vertices, points } = buffers;
        vertices.sort_unstable();
        vertices.dedup();
        points.clear();
        points.extend(vertices.iter().map(|v| self.point(*v)));
        let hull = hulls.hull(points, HULL_THICKNESS);
        if !walk.is_empty() && !self.supports_by_walking(walk, &hull, vertices, points) {
            return None;
        }
        let protrudes = match flat {
            Some(plane) => self.reached_below(plane, points, bounds, mine, reach),
            None if hull.shape == Shape::Polytope => {
                self.surface.reaches_into(hull.planes(points), bounds, depth, mine, reach)
            }
            None => false,
        };
        if protrudes {
            return None;
        }
        Some(hull.extreme.iter().map(|k| vertices[*k as usize]).collect())
    }

    /// Whether each of two triangles with a common edge lies below the other's plane (Eq. 3.2).
    pub fn is_convex(&self, a: u32, b: u32) -> bool {
        let below = |a: u32, b: u32| {
            let plane = &self.planes[a as usize];
            self.surface.corners(b).iter().all(|p| plane.height(*p) <= self.tolerance)
        };
        below(a, b) && below(b, a)
    }

    fn point(&self, vertex: u32) -> DVec3 {
        self.surface.points[vertex as usize]
    }

    /// Twice the area of a triangle.
    pub fn area(&self, triangle: u32) -> f64 {
        let [a, b, c] = self.surface.corners(triangle);
        (b - a).cross(c - a).length()
    }

    fn below(&self, patch: &Patch, plane: &Plane) -> bool {
        patch.extreme.iter().all(|v| plane.height(self.point(*v)) <= self.tolerance)
    }

    /// Whether the hull lies below the planes of all triangles. For each plane, walks from a nearby vertex of
    /// the hull to ever higher neighbours: on a convex hull, the walk ends at the highest vertex.
    fn supports_by_walking(&self, walk: &[u32], hull: &Hull, vertices: &[u32], points: &[DVec3]) -> bool {
        // Neighbours of each vertex of the hull, grouped by counting sort.
        let mut starts = vec![0u32; points.len() + 1];
        for v in hull.faces.iter().flatten() {
            starts[*v as usize + 1] += 1;
        }
        for k in 0..points.len() {
            starts[k + 1] += starts[k];
        }
        let mut neighbours = vec![0u32; 3 * hull.faces.len()];
        let mut fill = starts.clone();
        for face in &hull.faces {
            for k in 0..3 {
                let slot = &mut fill[face[k] as usize];
                neighbours[*slot as usize] = face[(k + 1) % 3];
                *slot += 1;
            }
        }
        let Some(first) = hull.faces.first().map(|f| f[0]) else { return true };
        let mut last = first;
        for &t in walk {
            let plane = self.planes[t as usize];
            let near = self.surface.triangles[t as usize].iter().find_map(|v| {
                let k = vertices.binary_search(v).ok()?;
                (starts[k] < starts[k + 1]).then_some(k as u32)
            });
            let mut here = near.unwrap_or(last);
            let mut height = plane.height(points[here as usize]);
            loop {
                let around = &neighbours[starts[here as usize] as usize..starts[here as usize + 1] as usize];
                let mut next = here;
                for &n in around {
                    let h = plane.height(points[n as usize]);
                    if h > height {
                        (next, height) = (n, h);
                    }
                }
                if next == here {
                    break;
                }
                here = next;
            }
            if height > self.tolerance {
                return false;
            }
            last = here;
        }
        true
    }
}

/// Depth to which other surface may reach into a hull that is not flat.
pub(crate) fn permitted_depth(tolerance: f64, thickness: f64) -> f64 {
    tolerance.min(thickness / THICKNESS_PER_DEPTH)
}

/// Planes of the layer from the convex polygon around points near a plane down to `thickness` below it.
pub(crate) fn layer_below<'a>(
    plane: &'a Plane,
    points: &'a [DVec3],
    thickness: f64,
) -> impl Iterator<Item = Plane> + 'a {
    let outline = polygon(points, plane.normal);
    let middle = points.iter().sum::<DVec3>() / points.len() as f64;
    let bottom = Plane { normal: -plane.normal, offset: thickness - plane.offset };
    let count = outline.len();
    let sides = (0..count).filter_map(move |k| {
        let [from, to] = [outline[k], outline[(k + 1) % count]].map(|v| points[v as usize]);
        let outward = (to - from).cross(plane.normal).try_normalize()?;
        let side = Plane { normal: outward, offset: outward.dot(from) };
        Some(if side.height(middle) > 0.0 { Plane { normal: -outward, offset: -side.offset } } else { side })
    });
    [*plane, bottom].into_iter().chain(sides)
}

/// Planes that represent the triangles in the convexity test. The normal of a triangle that is narrower than
/// the tolerance is meaningless: it takes that of the neighbour across its longest side, in whose plane it
/// lies to within the tolerance. Triangles without an area or such a neighbour get a zero normal, and remain
/// patches of their own.
pub(crate) fn dependable_planes(surface: &Surface, neighbours: &[[u32; 3]], tolerance: f64) -> Vec<Plane> {
    let width = |t: usize| {
        let corners = surface.corners(t as u32);
        let (side, longest) = longest_side(&corners);
        let area = (corners[1] - corners[0]).cross(corners[2] - corners[0]).length();
        (side, if longest > 0.0 { area / longest } else { 0.0 })
    };
    let mut planes = surface.planes.clone();
    let mut narrow: Vec<(usize, usize)> = (0..planes.len())
        .filter_map(|t| {
            let (side, width) = width(t);
            (width <= tolerance).then_some((t, side))
        })
        .collect();
    let mut dependable = vec![true; planes.len()];
    for (t, _) in &narrow {
        dependable[*t] = false;
    }
    // In a fan of narrow triangles, planes propagate from its rim inwards, by four triangles at most.
    for _ in 0..4 {
        let mut lent = Vec::new();
        narrow.retain(|&(t, side)| {
            let other = neighbours[t][side];
            if other == u32::MAX || !dependable[other as usize] {
                return true;
            }
            lent.push((t, planes[other as usize].normal));
            false
        });
        for (t, normal) in lent {
            let offset =
                surface.corners(t as u32).iter().map(|p| normal.dot(*p)).fold(f64::NEG_INFINITY, f64::max);
            planes[t] = Plane { normal, offset };
            dependable[t] = true;
        }
    }
    planes
}

fn longest_side(corners: &[DVec3; 3]) -> (usize, f64) {
    let mut best = (0, 0.0);
    for k in 0..3 {
        let length = corners[k].distance(corners[(k + 1) % 3]);
        if length > best.1 {
            best = (k, length);
        }
    }
    best
}
