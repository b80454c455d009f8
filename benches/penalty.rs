//! Contact force by a penalty k (δ + d) at each cluster of contacts (§3.5.3, §5.5.1).

use palpate::collide::{Clustering, PatchContact};
use palpate::glam::DVec3;
use palpate::{Pose, Wrench};

/// Number of contact clusters (§5.5.1).
const CLUSTERS: usize = 5;

/// Clusters of contacts that are followed from pose to pose.
#[derive(Clone, Debug)]
pub struct Penalty {
    clustering: Clustering,
}

impl Default for Penalty {
    fn default() -> Self {
        Self { clustering: Clustering::new(CLUSTERS) }
    }
}

impl Penalty {
    /// Returns the wrench on the probe for stiffness 1, about the position of a point of the probe (m, its
    /// own frame).
    pub fn wrench(&mut self, contacts: &[PatchContact], tolerance: f64, pose: &Pose, about: DVec3) -> Wrench {
        let about = pose.transform_point(about);
        let mut sum = Wrench::ZERO;
        for cluster in self.clustering.run(contacts, tolerance, pose) {
            let force = -cluster.contact.normal * (cluster.contact.depth + tolerance).max(0.0);
            sum.force += force;
            sum.torque += (cluster.contact.point - about).cross(force);
        }
        sum
    }
}
