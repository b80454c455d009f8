//! The contact set of two objects: a query's contacts between patches, reduced to those of the whole
//! surfaces.
//!
//! It is for inspection of a single pose or a recorded path: places, number and depths of the contacts of two
//! objects. The command `palpate query` prints it at full resolution. Sessions do not use it. A force needs
//! contacts that do not jump from pose to pose, and a set jumps when a region divides or two join;
//! [clusters](crate::Clustering) change smoothly. The first run prepares a surface of each shape, which takes
//! more memory than the shape.
//!
//! A [query](crate::ContactQuery) treats surfaces patch by patch. A contact of two patches may not be a local
//! minimum of the objects' distance, since a neighbouring patch may be closer; and one region of intersection
//! has a contact for each pair of patches in it, with the depth of the two pieces only.
//! Here:
//!
//! - A separated contact is kept if it is a local minimum of the distance between the surfaces: no triangle
//!   at its point on one surface, of any patch, is closer to a triangle at its point on the other.
//! - Penetrating contacts become one for each connected [region](crate::contact_set::regions) of
//!   intersection, at its deepest place: the vertex of either surface that is furthest from the other
//!   surface, or the deepest pair of patches if that is deeper. This can happen with crossing edges, where no
//!   vertex needs to be inside; when one enters, the depth does not jump. With a
//!   [spacing](ContactSetSettings::spacing), further local maxima of the depth are kept as well.
//! - A connected part of either surface that is [wholly inside](containment) the other solid is a region of
//!   its own, with one contact. It has none of the others.
//! - Of minima close to one another, or to a deep place of a region, the closest (deepest) is kept.
//!
//! Contacts between coarser nodes are treated likewise, on the surfaces of their levels, each of which is
//! closed; nodes of different levels are neighbours if the finer one's ancestor is a neighbour.
//!
//! If an object bounds no solid, nothing is inside it; if neither does, a region is as deep as its
//! deepest pair of patches.

mod containment;
mod inside;
mod minima;
mod pairs;
mod regions;
mod settings;
mod sides;
mod spacing;

use palpate_core::{Contact, Pose};

use self::containment::Meeting;
use self::inside::Measures;
use self::minima::MinimumTest;
use self::regions::{Deep, Place, Regions};
use self::sides::Side;
use self::spacing::Spaced;
use crate::contact::{PatchContact, to_world};
use crate::convex::Placement;
use crate::error::ContactSetError;
use crate::shape::Shape;
use crate::tolerances::{COORDINATE_ROUNDING, PRECISION, SAME_CONTACT, SAME_POINT};

pub use self::containment::Containment;
pub use self::settings::{ContactSetOutcome, ContactSetSettings};

/// Largest distance that is not felt, as a fraction of the objects' radii: §3.5.2 finds detail of 2.5 to 5
/// % unnoticed.
const MAX_UNNOTICED: f64 = 0.05;

/// Label of the contacts that separated ones are compared with: all of them.
const ANY: u32 = 0;

/// The workspace for contact sets of two objects.
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
    containment: Containment,
    regions: Regions,
    /// Separated minima: indices of contacts.
    minima: Vec<u32>,
    minimum_test: MinimumTest,
    /// Deep places of regions.
    deep: Vec<Deep>,
    maxima: Spaced,
    kept: Spaced,
    contacts: Vec<PatchContact>,
    outcome: ContactSetOutcome,
}

impl ContactSet {
    /// Makes a workspace for two objects. The first one for an object finds the neighbours of its patches.
    pub fn new(probe: &Shape, scene: &Shape) -> Self {
        Self {
            containment: Containment::new(probe, scene),
            regions: Regions::new(probe, scene),
            probe: probe.clone(),
            scene: scene.clone(),
            minima: Vec::new(),
            minimum_test: MinimumTest::default(),
            deep: Vec::new(),
            maxima: Spaced::default(),
            kept: Spaced::default(),
            contacts: Vec::new(),
            outcome: ContactSetOutcome::default(),
        }
    }

    /// A spacing of maxima in a region, m: 5 % of the smaller object's radius. Contacts that are closer
    /// cannot be distinguished by feel (§3.5.2).
    pub fn noticeable_spacing(&self) -> f64 {
        MAX_UNNOTICED * self.probe.clod().bounding_radius().min(self.scene.clod().bounding_radius())
    }

    /// Memory held by the workspace, bytes.
    pub fn bytes(&self) -> usize {
        self.containment.bytes()
            + self.regions.bytes()
            + self.maxima.capacity()
            + self.kept.capacity()
            + self.minima.capacity() * size_of::<u32>()
            + self.minimum_test.bytes()
            + self.deep.capacity() * size_of::<Deep>()
            + self.contacts.capacity() * size_of::<PatchContact>()
    }

    /// Makes the contact set of a query's contacts at the same poses (object frame to world), in world axes
    /// and by decreasing depth. Each contact has the nodes whose patches its points are on. The weight of a
    /// region's contact is 1, and that of a merged one is the sum, up to 1.
    ///
    /// The cost grows with the number of contacts, and of vertices in and next to the regions.
    ///
    /// # Errors
    /// If a pose or a setting is not valid, or a contact is not finite or has nodes that are not patches of
    /// these objects. The set is empty then.
    pub fn run(
        &mut self,
        contacts: &[PatchContact],
        probe_pose: &Pose,
        scene_pose: &Pose,
        settings: &ContactSetSettings,
    ) -> Result<&[PatchContact], ContactSetError> {
        let capacities = self.capacities();
        self.contacts.clear();
        self.containment.clear();
        self.outcome = ContactSetOutcome::default();
        self.check(contacts, [probe_pose, scene_pose], settings)?;
        let (probe, scene) = (self.probe.clone(), self.scene.clone());
        let placement = Placement::between(probe_pose, scene_pose);
        let sides = Side::both(&probe, &scene, placement);
        let coordinates =
            probe.coordinates() + scene.coordinates() + placement.translation.abs().max_element();
        let world = [probe_pose, scene_pose].map(|pose| pose.translation.abs().max_element());
        let precision = PRECISION * coordinates + COORDINATE_ROUNDING * world[0].max(world[1]);

        self.find_contained(contacts, probe_pose, &sides, settings, precision);
        self.find_regions(contacts, probe_pose, &sides, settings, precision);
        if !self.containment.contacts().is_empty() {
            self.contacts.sort_unstable_by(|x, y| y.contact.depth.total_cmp(&x.contact.depth));
        }
        self.outcome.penetrating = self.contacts.len();
        self.find_minima(contacts, probe_pose, &sides, precision);
        self.merge(contacts, settings.merge.max(SAME_CONTACT * precision));
        self.outcome.separated = self.contacts.len() - self.outcome.penetrating;
        self.outcome.reallocated = self.capacities() != capacities;
        Ok(&self.contacts)
    }

    /// The contacts of the last run; none after an error.
    pub fn contacts(&self) -> &[PatchContact] {
        &self.contacts
    }

    /// Results and costs of the last run.
    pub fn outcome(&self) -> &ContactSetOutcome {
        &self.outcome
    }

    /// Capacities of all buffers, which show whether one has grown.
    fn capacities(&self) -> ([usize; 7], [usize; 3]) {
        let Self { containment, regions, minima, minimum_test, deep, maxima, kept, contacts, .. } = self;
        let own = [
            containment.capacity(),
            regions.capacity(),
            minima.capacity(),
            deep.capacity(),
            maxima.capacity(),
            kept.capacity(),
            contacts.capacity(),
        ];
        (own, minimum_test.capacities())
    }

    fn check(
        &self,
        contacts: &[PatchContact],
        poses: [&Pose; 2],
        settings: &ContactSetSettings,
    ) -> Result<(), ContactSetError> {
        ContactSetError::check_poses(poses)?;
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

    /// Whether a contact is finite and its nodes are patches of these objects.
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

    /// Adds the contacts of the parts that are wholly inside the other object.
    fn find_contained(
        &mut self,
        contacts: &[PatchContact],
        probe_pose: &Pose,
        sides: &[Side; 2],
        settings: &ContactSetSettings,
        precision: f64,
    ) {
        let bounds = (precision, settings.max_vertices);
        self.containment.find(sides, probe_pose, Meeting::All(contacts), bounds);
        self.contacts.extend_from_slice(self.containment.contacts());
        self.outcome.contained = self.containment.parts();
        self.outcome.measured = self.containment.count;
        self.outcome.truncated = self.containment.truncated;
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
        let max_vertices = settings.max_vertices - self.containment.count;
        let measures = Measures { precision, same, max_vertices, maxima };
        let containment = &self.containment;
        self.deep.clear();
        self.deep.extend_from_slice(self.regions.run(contacts, sides, &measures, |c| containment.holds(c)));
        self.outcome.regions = self.regions.len() + self.containment.contacts().len();
        self.outcome.measured += self.regions.inside.measured;
        self.outcome.inside = self.regions.inside.found.len();
        self.outcome.truncated |= self.regions.inside.truncated;
        // The deepest place of a region comes before the others, which may be equally deep.
        self.deep.sort_unstable_by(|x, y| {
            y.depth.total_cmp(&x.depth).then(y.deepest.cmp(&x.deepest)).then(x.at.cmp(&y.at))
        });
        self.maxima.clear(settings.spacing.clamp(SAME_CONTACT * precision, f64::MAX), self.deep.len());
        for &Deep { region, deepest, at, .. } in &self.deep {
            let found = match at {
                Place::Patches(index) => PatchContact { weight: 1.0, ..contacts[index as usize] },
                Place::Vertex(index) => {
                    let deepest = self.regions.inside.contact(index, sides);
                    PatchContact { contact: to_world(&deepest.contact, probe_pose), ..deepest }
                }
            };
            // The deepest vertices of both objects may be the same place.
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
            if found.contact.depth < 0.0
                && !self.containment.holds(found)
                && self.minimum_test.is_minimum(found, &to_probe, sides, precision)
            {
                self.minima.push(index);
            }
        }
        self.minima.sort_unstable_by(|i, j| {
            let depth = |index: &u32| contacts[*index as usize].contact.depth;
            depth(j).total_cmp(&depth(i)).then(i.cmp(j))
        });
        self.outcome.minima = self.minima.len();
    }

    /// Adds the minima that are not within `reach` of a contact already in the set.
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
