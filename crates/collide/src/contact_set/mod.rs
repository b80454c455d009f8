//! The contact set of two objects: what is left of a query's contacts between patches when the pieces are put together.
//!
//! It is for inspection, of a single pose or of a recorded path: where two objects touch, how often, and how deep. The command
//! `palpate query` prints it at full resolution. Sessions do not use it. A force needs contacts that do not jump from pose to
//! pose, and a set does where a region divides or two join; [clusters](crate::Clustering) go over smoothly. The first run
//! prepares a surface of each shape, which takes more memory than the shape does.
//!
//! A [query](crate::ContactQuery) takes surfaces patch by patch. A contact of two patches may be no local minimum of the
//! objects' distance, since a neighbouring patch comes closer; and one region of intersection is cut into as many
//! contacts as pairs of patches meet in it, each with the depth of the two pieces only. Here:
//!
//! - A separated contact stays if it is a local minimum of the distance between the surfaces: no triangle at its point
//!   on one surface, of whichever patch, is closer to a triangle at its point on the other.
//! - Penetrating contacts become one for each connected [region](crate::contact_set::regions) of intersection, at the place where it
//!   is deepest: the vertex of either surface that is furthest from the other surface, or the deepest pair of patches
//!   where that is deeper. Crossing edges may be so: no vertex needs to be inside, and while one enters, the depth does
//!   not jump. With a [spacing](ContactSetSettings::spacing), further local maxima of the depth are kept as well.
//! - Of minima that are near one another, or near where a region is deep, the closest (deepest) stays.
//!
//! Contacts between coarser nodes are treated likewise, on the surfaces of their levels, each of which is closed; nodes of
//! different levels are neighbours where the finer one's ancestor is.
//!
//! Where an object bounds no solid, nothing is inside it; where neither does, a region is as deep as its deepest pair of
//! patches.

mod pairs;
mod regions;
mod spacing;

use palpate_core::glam::DVec3;
use palpate_core::{Contact, Pose};

use self::regions::{Deep, Measures, Place, Regions, Side};
use self::spacing::Spaced;
use crate::contact::{PatchContact, to_world};
use crate::convex::{Hull, Limits, Placement, Separation, Start, gjk, nearest_on_triangle};
use crate::error::{ContactSetError, QueryObject};
use crate::patchwork::NearestSearch;
use crate::shape::Shape;
use crate::tolerances::{COORDINATE_ROUNDING, PRECISION, SAME_CONTACT, SAME_POINT};

/// Vertices whose distance from the other surface a run may measure, by default.
const MOST_VERTICES: usize = 1 << 16;

/// What is noticed at all, as a fraction of the objects' radii: §3.5.2 finds detail of 2.5 to 5 % unnoticed.
const NOTICED: f64 = 0.05;

/// Label of what separated contacts are compared with.
const ANY: u32 = 0;

/// What makes a contact set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactSetSettings {
    /// Separated contacts whose points on both surfaces are no further than this from those of a closer contact that
    /// stays are dropped, m. Not negative; 0 drops equal ones only.
    pub merge: f64,
    /// Local maxima of the depth in one region stay if they are further apart than this, m. Infinite (the default): one
    /// contact for each region. Not negative.
    ///
    /// A region that goes around something, as that of a peg in a tight hole does, needs several to be pushed back
    /// right. [`ContactSet::noticeable_spacing`] is a value for that.
    pub spacing: f64,
    /// Vertices whose distance from the other surface may be measured. Beyond, depths are lower bounds, and
    /// [`ContactSetOutcome::truncated`] says so.
    pub most_vertices: usize,
}

impl ContactSetSettings {
    /// Settings with a distance (m) within which separated contacts are merged, and defaults for the rest.
    pub fn new(merge: f64) -> Self {
        Self { merge, spacing: f64::INFINITY, most_vertices: MOST_VERTICES }
    }
}

/// What a run found and what it cost.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ContactSetOutcome {
    /// Connected regions of intersection.
    pub regions: usize,
    /// Contacts of the regions: one each, and the further maxima.
    pub penetrating: usize,
    /// Separated contacts that are local minima, before they are merged.
    pub minima: usize,
    /// Separated contacts that stay.
    pub separated: usize,
    /// Regions whose depth is that of a vertex, rather than of two patches.
    pub by_vertices: usize,
    /// Vertices whose distance was measured.
    pub measured: usize,
    /// Vertices found inside the other object.
    pub inside: usize,
    /// Whether there were more vertices to measure than [`ContactSetSettings::most_vertices`].
    pub truncated: bool,
    /// Whether a buffer grew: there was more to do than ever before.
    pub reallocated: bool,
}

/// The workspace: makes contact sets of two objects.
///
/// ```
/// use palpate_collide::{ContactQuery, ContactSet, ContactSetSettings, QuerySettings, Shape};
/// use palpate_core::Pose;
/// use palpate_core::glam::DVec3;
///
/// # use palpate_clod_build::{BuildOptions, build, unwatched};
/// # use palpate_core::TriMesh;
/// # let corner = |i: u32| DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2)) * 0.1;
/// # let cube = TriMesh::new((0..8).map(corner).collect(), vec![
/// #     [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
/// #     [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
/// # ])?;
/// # let tips = [DVec3::X, -DVec3::X, DVec3::Y, -DVec3::Y, DVec3::Z, -DVec3::Z].map(|tip| 0.05 * tip);
/// # let octahedron = TriMesh::new(tips.to_vec(), vec![
/// #     [0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5],
/// # ])?;
/// # let shape_of = |mesh: &TriMesh| build(mesh, &BuildOptions::default(), &mut unwatched).map(Shape::new);
/// # let (octahedron, cube) = (shape_of(&octahedron)?, shape_of(&cube)?);
/// let tolerance = 0.002;
/// let mut query = ContactQuery::new(&octahedron, &cube);
/// let mut set = ContactSet::new(&octahedron, &cube);
/// let probe_pose = Pose::from_translation(DVec3::new(0.04, 0.05, 0.149));
/// query.run(&probe_pose, &Pose::IDENTITY, &QuerySettings::new(tolerance))?;
///
/// // However many pairs of patches meet there, it is one region, as deep as its deepest vertex.
/// let merged = ContactSetSettings::new(0.1 * tolerance);
/// let contacts = set.run(query.contacts(), &probe_pose, &Pose::IDENTITY, &merged)?;
/// assert_eq!(contacts.len(), 1);
/// assert!((contacts[0].contact.depth - 0.001).abs() < 1e-9);
/// assert_eq!(set.outcome().regions, 1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct ContactSet {
    probe: Shape,
    scene: Shape,
    regions: Regions,
    /// Separated minima: indices of contacts.
    minima: Vec<u32>,
    /// Triangles at a contact's points on either surface.
    at_points: [Vec<AtPoint>; 2],
    search: NearestSearch,
    /// Places where regions are deep.
    deep: Vec<Deep>,
    maxima: Spaced,
    kept: Spaced,
    contacts: Vec<PatchContact>,
    outcome: ContactSetOutcome,
}

impl ContactSet {
    /// A workspace for two objects. The first for an object finds out which of its patches are neighbours.
    pub fn new(probe: &Shape, scene: &Shape) -> Self {
        Self {
            regions: Regions::new(probe, scene),
            probe: probe.clone(),
            scene: scene.clone(),
            minima: Vec::new(),
            at_points: [Vec::new(), Vec::new()],
            search: NearestSearch::default(),
            deep: Vec::new(),
            maxima: Spaced::default(),
            kept: Spaced::default(),
            contacts: Vec::new(),
            outcome: ContactSetOutcome::default(),
        }
    }

    /// A spacing of maxima in a region, m: 5 % of the smaller object's radius. Contacts that are closer act at places
    /// that cannot be felt apart (§3.5.2).
    pub fn noticeable_spacing(&self) -> f64 {
        NOTICED * self.probe.clod().bounding_radius().min(self.scene.clod().bounding_radius())
    }

    /// Bytes of memory held by the workspace.
    pub fn bytes(&self) -> usize {
        self.regions.bytes()
            + self.maxima.capacity()
            + self.kept.capacity()
            + self.minima.capacity() * size_of::<u32>()
            + self.at_points.iter().map(|list| list.capacity() * size_of::<AtPoint>()).sum::<usize>()
            + self.deep.capacity() * size_of::<Deep>()
            + self.contacts.capacity() * size_of::<PatchContact>()
    }

    /// The contact set of a query's contacts, at the same poses (object frame to world), in world axes and by decreasing
    /// depth. Each comes with the nodes whose patches its points are on. The weight of a region's contact is 1, and that
    /// of a merged one the sum, up to 1.
    ///
    /// The cost grows with the number of contacts, and of vertices in and next to the regions.
    ///
    /// # Errors
    /// If a pose or a setting is not valid, or a contact is not finite or has nodes that are not patches of these objects.
    /// The set is empty then.
    pub fn run(
        &mut self,
        contacts: &[PatchContact],
        probe_pose: &Pose,
        scene_pose: &Pose,
        settings: &ContactSetSettings,
    ) -> Result<&[PatchContact], ContactSetError> {
        let buffers = self.buffers();
        self.contacts.clear();
        self.outcome = ContactSetOutcome::default();
        self.check(contacts, [probe_pose, scene_pose], settings)?;
        let (probe, scene) = (self.probe.clone(), self.scene.clone());
        let placement = Placement::between(probe_pose, scene_pose);
        let sides = Side::both(&probe, &scene, placement);
        let coordinates =
            probe.coordinates() + scene.coordinates() + placement.translation.abs().max_element();
        let world = [probe_pose, scene_pose].map(|pose| pose.translation.abs().max_element());
        let precision = PRECISION * coordinates + COORDINATE_ROUNDING * world[0].max(world[1]);

        self.find_regions(contacts, probe_pose, &sides, settings, precision);
        self.outcome.penetrating = self.contacts.len();
        self.find_minima(contacts, probe_pose, &sides, precision);
        self.merge(contacts, settings.merge.max(SAME_CONTACT * precision));
        self.outcome.separated = self.contacts.len() - self.outcome.penetrating;
        self.outcome.reallocated = self.buffers() != buffers;
        Ok(&self.contacts)
    }

    /// The contacts of the last run; none after an error.
    pub fn contacts(&self) -> &[PatchContact] {
        &self.contacts
    }

    /// What the last run found and what it cost.
    pub fn outcome(&self) -> &ContactSetOutcome {
        &self.outcome
    }

    fn buffers(&self) -> [usize; 9] {
        let Self { regions, minima, at_points, search, deep, maxima, kept, contacts, .. } = self;
        [
            regions.capacity(),
            minima.capacity(),
            at_points[0].capacity(),
            at_points[1].capacity(),
            search.capacity(),
            deep.capacity(),
            maxima.capacity(),
            kept.capacity(),
            contacts.capacity(),
        ]
    }

    fn check(
        &self,
        contacts: &[PatchContact],
        poses: [&Pose; 2],
        settings: &ContactSetSettings,
    ) -> Result<(), ContactSetError> {
        for (pose, object) in poses.into_iter().zip([QueryObject::Probe, QueryObject::Scene]) {
            if !pose.is_valid() {
                return Err(ContactSetError::Pose { object });
            }
        }
        let ContactSetSettings { merge, spacing, .. } = *settings;
        if !(merge.is_finite() && merge >= 0.0) {
            return Err(ContactSetError::Merge { given: merge });
        }
        if spacing.is_nan() || spacing < 0.0 {
            return Err(ContactSetError::Spacing { given: spacing });
        }
        match contacts.iter().position(|contact| !self.knows(contact)) {
            Some(index) => Err(ContactSetError::Contact { index }),
            None => Ok(()),
        }
    }

    /// Whether a contact may be one of these objects.
    fn knows(&self, found: &PatchContact) -> bool {
        let Contact { point, scene_point, normal, depth } = found.contact;
        point.is_finite()
            && scene_point.is_finite()
            && normal.is_finite()
            && depth.is_finite()
            && found.weight.is_finite()
            && self.probe.has_patch(found.probe_node)
            && self.scene.has_patch(found.scene_node)
    }

    /// Adds the contacts of the regions.
    fn find_regions(
        &mut self,
        contacts: &[PatchContact],
        probe_pose: &Pose,
        sides: &[Side; 2],
        settings: &ContactSetSettings,
        precision: f64,
    ) {
        let maxima = settings.spacing < f64::INFINITY;
        let radii = sides.iter().map(|side| side.own.clod().bounding_radius()).sum::<f64>();
        let same = SAME_POINT * radii + precision;
        let measures = Measures { precision, same, most_vertices: settings.most_vertices, maxima };
        self.deep.clear();
        self.deep.extend_from_slice(self.regions.run(contacts, sides, &measures));
        self.outcome.regions = self.regions.len();
        self.outcome.measured = self.regions.measured;
        self.outcome.inside = self.regions.inside();
        self.outcome.truncated = self.regions.truncated;
        // The deepest of a region goes before the others, which may be equally deep.
        self.deep.sort_unstable_by(|x, y| {
            y.depth.total_cmp(&x.depth).then(y.deepest.cmp(&x.deepest)).then(x.at.cmp(&y.at))
        });
        self.maxima.clear(settings.spacing.clamp(SAME_CONTACT * precision, f64::MAX), self.deep.len());
        for &Deep { region, deepest, at, .. } in &self.deep {
            let found = match at {
                Place::Patches(index) => PatchContact { weight: 1.0, ..contacts[index as usize] },
                Place::Vertex(index) => {
                    let deepest = self.regions.contact(index, sides);
                    PatchContact { contact: to_world(&deepest.contact, probe_pose), ..deepest }
                }
            };
            // One object's deepest vertex and the other's are the same place.
            let points = [found.contact.point; 2];
            if deepest || self.maxima.near(points, region).is_none() {
                self.outcome.by_vertices += usize::from(deepest && matches!(at, Place::Vertex(_)));
                self.maxima.choose(points, region);
                self.contacts.push(found);
            }
        }
    }

    /// Lists the separated contacts that are local minima, the closest first.
    fn find_minima(
        &mut self,
        contacts: &[PatchContact],
        probe_pose: &Pose,
        sides: &[Side; 2],
        precision: f64,
    ) {
        let to_probe = probe_pose.inverse();
        self.minima.clear();
        for (index, found) in (0u32..).zip(contacts) {
            if found.contact.depth < 0.0 && self.is_minimum(found, &to_probe, sides, precision) {
                self.minima.push(index);
            }
        }
        self.minima.sort_unstable_by(|i, j| {
            let depth = |index: &u32| contacts[*index as usize].contact.depth;
            depth(j).total_cmp(&depth(i)).then(i.cmp(j))
        });
        self.outcome.minima = self.minima.len();
    }

    /// Whether no triangle at a contact's point on one surface is closer to those at its point on the other.
    fn is_minimum(
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
        let Self { at_points: [at_probe, at_scene], search, .. } = self;
        if limits.one_sided(search, probe.own, *probe_node, points, at_probe)
            || limits.one_sided(search, scene.own, *scene_node, [in_scene[1], in_scene[0]], at_scene)
        {
            return false;
        }
        // Where one surface slopes a little, both points together may slide further than either one.
        at_probe.iter().all(|a| {
            at_scene.iter().all(|b| {
                !(a.slides || b.slides)
                    || !limits.has(&a.corners, points[0])
                    || !limits.has(&b.corners, in_scene[1])
                    || !limits.joint(&a.corners, &b.corners, &scene.to_other, precision)
            })
        })
    }

    /// Adds those minima that are not within `reach` of a contact that is there already.
    fn merge(&mut self, contacts: &[PatchContact], reach: f64) {
        self.kept.clear(reach, self.contacts.len() + self.minima.len());
        let points = |found: &PatchContact| [found.contact.point, found.contact.scene_point];
        self.contacts.iter().for_each(|found| self.kept.choose(points(found), ANY));
        for &index in &self.minima {
            let found = &contacts[index as usize];
            match self.kept.near(points(found), ANY) {
                // Weights of one contact at several resolutions add up to 1.
                Some(near) => {
                    let weight = &mut self.contacts[near].weight;
                    *weight = (*weight + found.weight).min(1.0);
                }
                None => {
                    self.kept.choose(points(found), ANY);
                    self.contacts.push(*found);
                }
            }
        }
    }
}

/// A triangle at a contact's point.
#[derive(Clone, Copy, Debug)]
struct AtPoint {
    /// In its body's frame, m.
    corners: [DVec3; 3],
    /// Whether its nearest point to the contact's other point is another one.
    slides: bool,
}

/// What counts as closer than a contact.
#[derive(Clone, Copy, Debug)]
struct Undercut {
    /// Points that are this near are the same, m.
    same: f64,
    /// Nearest points that are further away than this are others, m.
    slide: f64,
    /// m.
    closer: f64,
}

impl Undercut {
    /// Whether a triangle at a contact's point on a surface is closer to the other point (both in its frame). Lists the
    /// triangles that may have the point, of whichever patch, unless one is.
    fn one_sided(
        &self,
        search: &mut NearestSearch,
        shape: &Shape,
        node: u32,
        [own, other]: [DVec3; 2],
        at: &mut Vec<AtPoint>,
    ) -> bool {
        at.clear();
        let neighbours = &shape.patchwork().neighbours;
        let Some(found) = search.on_patch(shape.patchwork(), node, own, 2.0 * self.same) else {
            return false;
        };
        let towards = other - own;
        for &triangle in neighbours.around(found.nearest_vertex(shape.patchwork())) {
            let corners = neighbours.corners(triangle);
            // A triangle with the point has closer ones only if one of its corners lies on that side.
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

    /// Whether a triangle has a point.
    fn has(&self, corners: &[DVec3; 3], point: DVec3) -> bool {
        let [p, q, r] = *corners;
        let in_box = point.clamp(p.min(q).min(r) - self.same, p.max(q).max(r) + self.same) == point;
        in_box && nearest_on(corners, point).distance(point) <= self.same
    }

    /// Whether two triangles, each in its body's frame, are closer to one another.
    fn joint(&self, a: &[DVec3; 3], b: &[DVec3; 3], to_probe: &Placement, precision: f64) -> bool {
        let limits = Limits { beyond: self.closer.max(0.0), share: 0.0, enough: -1.0, precision };
        let start = Start::Axis(a[0] - to_probe.point(b[0]));
        let found = gjk::distance(&Hull::new(a), &Hull::new(b), to_probe, start, &limits);
        found.separation != Separation::Beyond && found.distance < self.closer
    }
}

/// The point of a triangle nearest to another.
fn nearest_on(corners: &[DVec3; 3], point: DVec3) -> DVec3 {
    let (p, q, r) = (corners[0] - point, corners[1] - point, corners[2] - point);
    let [u, v, w] = nearest_on_triangle(p, q, r);
    point + u * p + v * q + w * r
}
