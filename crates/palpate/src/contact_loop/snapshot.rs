//! The touching patches in snapshots for contact monitors.

use palpate_collide::PatchContact;
use palpate_core::Pose;

use super::ContactLoop;
use super::monitor::TouchingPatches;
use super::touching::MAX_SHOWN;
use crate::constraints::geometry::ContactGeometry;
use crate::penalties::in_scene::InScene;
use crate::penalties::proxy::ProxyContact;

impl ContactLoop {
    /// Begins a snapshot at a time (s).
    pub(super) fn begin_snapshot(&mut self, time: f64) {
        if let Some(monitored) = &mut self.shown.monitored {
            monitored.begin(time);
        }
    }

    /// Begins a snapshot at a time (s) with the patches that touch. For textured objects these are the coarse
    /// patches, for contacts in fields the patches at the deepest contacts.
    pub(super) fn show_patches(&mut self, time: f64) {
        let is_by_fields = self.is_by_fields();
        let Some(monitored) = &mut self.shown.monitored else { return };
        let snapshot = monitored.begin(time);
        let is_near = |found: &&ProxyContact| found.contact.contact.depth > -self.parameters.tolerance;
        if !is_by_fields {
            for found in self.penalties.proxy.contacts().filter(is_near) {
                let PatchContact { probe_node, scene_node, weight, .. } = found.contact;
                let object = self.scene.get(found.object);
                let object = object.map_or(found.object, |object| object.id.0);
                snapshot.add_patches(TouchingPatches { object, probe_node, scene_node, weight });
            }
            return;
        }
        self.shown.patches.choose(self.penalties.proxy.contacts().filter(is_near));
        let probe = (*self.penalties.proxy.pose() * Pose::from_translation(-self.center_of_mass)).inverse();
        for index in 0..self.shown.patches.deepest.len() {
            let ProxyContact { contact: PatchContact { contact, .. }, object, .. } =
                self.shown.patches.deepest[index];
            let Some(InScene { id, handle, object, .. }) = self.scene.get(object) else {
                continue;
            };
            let Some(scene) = self.scene.query.pose(*handle) else { continue };
            let own = self.shown.patches.leaf_at(&self.probe.clod, probe.transform_point(contact.point));
            let at = scene.inverse().transform_point(contact.scene_point);
            let other = self.shown.patches.leaf_at(&object.clod, at);
            if let (Some(probe_node), Some(scene_node)) = (own, other) {
                snapshot.add_patches(TouchingPatches { object: id.0, probe_node, scene_node, weight: 1.0 });
            }
        }
    }

    /// Adds the patches at the nearest guarded points to the snapshot, with the mesh's frame at a pose.
    pub(super) fn show_guarded(&mut self, geometry: &ContactGeometry, mesh: &Pose) {
        let Some(monitored) = &mut self.shown.monitored else { return };
        let snapshot = monitored.snapshot();
        let frames = geometry.frames(mesh);
        // They are sorted by distance.
        let near = geometry.points.iter().filter(|point| f64::from(point.slack) < self.parameters.tolerance);
        for point in near.take(MAX_SHOWN) {
            let at = usize::from(point.object);
            let (Some(frames), Some(near)) = (frames.get(at), geometry.objects.get(at)) else { continue };
            let Some(InScene { id, object, .. }) = self.scene.get(near.place) else { continue };
            let [on_probe, on_object] = point.ends(frames);
            let own = self.shown.patches.leaf_at(&self.probe.clod, on_probe);
            let other = self.shown.patches.leaf_at(&object.clod, on_object);
            if let (Some(probe_node), Some(scene_node)) = (own, other) {
                snapshot.add_patches(TouchingPatches { object: id.0, probe_node, scene_node, weight: 1.0 });
            }
        }
    }
}
