//! Penetration at recorded poses, by the exact geometry of the meshes.

use palpate::collide::{
    ContactQuery, ContactSet, ContactSetSettings, Containment, PatchContact, QuerySettings,
};
use palpate::mesh_io::intersecting_pairs;
use palpate::{Pose, TriMesh};

use super::Part;

/// Distance within which the query looks at patches, m: only what penetrates matters.
const TOLERANCE: f64 = 1e-6;
/// Poses between two that are judged in the first pass; the deepest ones' neighbours are judged after it.
const STRIDE: usize = 8;
/// Number of poses of the first pass whose neighbours are judged.
const LOOKED_AROUND: usize = 12;

/// Judge of the poses of one part against another, fixed at the origin.
pub struct Exact {
    meshes: [TriMesh; 2],
    containment: Containment,
    query: ContactQuery,
    set: ContactSet,
}

impl Exact {
    pub fn new(moved: &Part, fixed: &Part) -> Self {
        let shapes = [moved.object.shape(), fixed.object.shape()];
        Self {
            meshes: [moved.mesh.clone(), fixed.mesh.clone()],
            containment: Containment::new(shapes[0], shapes[1]),
            query: ContactQuery::new(shapes[0], shapes[1]),
            set: ContactSet::new(shapes[0], shapes[1]),
        }
    }

    /// Depth at a pose, m: that of the deepest region of intersection, at full resolution. Where no triangles
    /// of the two meshes meet it is 0, or the depth of a part that is wholly inside the other.
    ///
    /// # Errors
    /// If the query refuses the pose.
    pub fn depth(&mut self, pose: &Pose) -> Result<f64, String> {
        let [moved, fixed] = &self.meshes;
        if intersecting_pairs(moved, pose, fixed, &Pose::IDENTITY, 1).is_empty() {
            let inside = self.containment.run(pose, &Pose::IDENTITY).map_err(|error| error.to_string())?;
            return Ok(deepest(inside));
        }
        let settings = QuerySettings::new(TOLERANCE);
        self.query.run(pose, &Pose::IDENTITY, &settings).map_err(|error| error.to_string())?;
        let merged = ContactSetSettings::new(TOLERANCE);
        let contacts = self.set.run(self.query.contacts(), pose, &Pose::IDENTITY, &merged);
        let contacts = contacts.map_err(|error| error.to_string())?;
        Ok(deepest(contacts))
    }

    /// Deepest penetration over poses that follow one another, m: at every eighth pose, and at every pose
    /// about the deepest of those.
    ///
    /// # Errors
    /// As [`Exact::depth`].
    pub fn deepest(&mut self, poses: &[Pose]) -> Result<f64, String> {
        let mut judged = Vec::new();
        for index in (0..poses.len()).step_by(STRIDE) {
            judged.push((self.depth(&poses[index])?, index));
        }
        judged.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut deepest = judged.first().map_or(0.0, |first| first.0);
        for (_, index) in judged.into_iter().take(LOOKED_AROUND).filter(|(depth, _)| *depth > 0.0) {
            let around = index.saturating_sub(STRIDE - 1)..(index + STRIDE).min(poses.len());
            for pose in &poses[around] {
                deepest = deepest.max(self.depth(pose)?);
            }
        }
        Ok(deepest)
    }
}

/// Depth of the deepest contact, m.
fn deepest(contacts: &[PatchContact]) -> f64 {
    contacts.iter().map(|found| found.contact.depth).fold(0.0, f64::max)
}
