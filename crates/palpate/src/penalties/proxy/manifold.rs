//! The persistent manifold of the proxy: contacts that stopped it from moving on, and contacts that have
//! jumped between the same two patches.
//!
//! Two convex patches have only one contact at a time, which jumps from corner to corner as they rock on one
//! another. A contact that has jumped persists at its old place, as in the manifolds of rigid-body engines,
//! until the surfaces there are more than d apart or have slid by as much. Its weight falls with the distance
//! slid and with its distance to the patches' present contact.

use palpate_core::Contact;

use super::contact::ProxyContact;

/// Largest number of persistent contacts. With fewer, a faceted object that rests on many facets rocks
/// between them.
const CAPACITY: usize = 64;

/// Smallest cosine of the angle between the normals of two contacts closer than d that are the same contact.
/// With less, contacts on two sides of an edge replace each other.
const SAME_NORMAL: f64 = 0.9;

/// Smallest distance on the proxy, in tolerances d, by which the contact of two patches jumps. With less, a
/// contact that slides leaves copies of itself behind.
const MIN_JUMP: f64 = 0.25;

/// The persistent contacts.
#[derive(Clone, Debug)]
pub(super) struct Manifold {
    contacts: Vec<ProxyContact>,
    /// d, m.
    tolerance: f64,
}

impl Manifold {
    pub fn new(tolerance: f64) -> Self {
        Self { contacts: Vec::with_capacity(CAPACITY), tolerance }
    }

    pub fn contacts(&self) -> &[ProxyContact] {
        &self.contacts
    }

    pub fn contacts_mut(&mut self) -> &mut [ProxyContact] {
        &mut self.contacts
    }

    pub fn clear(&mut self) {
        self.contacts.clear();
    }

    /// Keeps the contacts of `before` within d that have jumped to another place in `found`, the present
    /// contacts, sorted by pairs of patches.
    pub fn keep_jumped(&mut self, before: &[ProxyContact], found: &[ProxyContact]) {
        for earlier in before {
            let near = earlier.contact.contact.depth > -self.tolerance;
            let jumped = |(_, distance): (_, f64)| distance > MIN_JUMP * self.tolerance;
            if near && nearest_of_pair(found, earlier).is_some_and(jumped) {
                self.keep(*earlier);
            }
        }
    }

    /// Removes the contacts that are more than d apart or have slid by d along the surface, and weights the
    /// rest by
    ///
    /// w = w_pair · min(1, |p − p_pair| / d) · (1 − s / d),
    ///
    /// with the weight and the point of the nearest present contact of the same pair, and the distance s
    /// slid.
    pub fn weigh(&mut self, found: &[ProxyContact]) {
        let tolerance = self.tolerance;
        self.contacts.retain_mut(|kept| {
            let Contact { point, scene_point, normal, depth } = kept.contact.contact;
            let slid = (point - scene_point).reject_from(normal).length() / tolerance;
            let (weight, aside) = nearest_of_pair(found, kept).unwrap_or_default();
            kept.contact.weight = weight * (aside / tolerance).min(1.0) * (1.0 - slid).max(0.0);
            depth > -tolerance && slid < 1.0
        });
    }

    /// Keeps a contact, in place of an older copy if there is one. If there is no room, it replaces the
    /// shallowest.
    pub fn keep(&mut self, contact: ProxyContact) {
        let Contact { point, normal, depth, .. } = contact.contact.contact;
        let same = |other: &ProxyContact| {
            let Contact { point: there, normal: towards, .. } = other.contact.contact;
            other.pair() == contact.pair()
                && there.distance(point) < self.tolerance
                && towards.dot(normal) > SAME_NORMAL
        };
        let depth_of = |contact: &ProxyContact| contact.contact.contact.depth;
        let shallower =
            |one: &&mut ProxyContact, other: &&mut ProxyContact| depth_of(one).total_cmp(&depth_of(other));
        if let Some(known) = self.contacts.iter().position(same) {
            self.contacts[known] = contact;
        } else if self.contacts.len() < CAPACITY {
            self.contacts.push(contact);
        } else if let Some(shallowest) = self.contacts.iter_mut().min_by(shallower)
            && depth_of(shallowest) < depth
        {
            *shallowest = contact;
        }
    }
}

/// Finds the contact nearest to an earlier one of the same pair of patches, among contacts sorted by pairs.
/// Returns its weight and its distance from the earlier one on the proxy, m.
fn nearest_of_pair(found: &[ProxyContact], earlier: &ProxyContact) -> Option<(f64, f64)> {
    let pair = earlier.pair();
    let first = found.partition_point(|found| found.pair() < pair);
    let of_pair = found[first..].iter().take_while(|found| found.pair() == pair);
    let point = earlier.contact.contact.point;
    of_pair
        .map(|found| (found.contact.weight, found.contact.contact.point.distance(point)))
        .min_by(|one, other| one.1.total_cmp(&other.1))
}

#[cfg(test)]
mod tests {
    use palpate_collide::PatchContact;
    use palpate_core::glam::DVec3;

    use super::*;

    const TOLERANCE: f64 = 1e-3;

    /// A contact of a pair of patches at a place on the probe, which touched the scene at another.
    fn contact(pair: u32, point: DVec3, scene_point: DVec3, depth: f64) -> ProxyContact {
        let contact = Contact { point, scene_point, normal: DVec3::NEG_Z, depth };
        let contact = PatchContact { contact, probe_node: pair, scene_node: pair, weight: 1.0 };
        ProxyContact { contact, object: 0, recess: 0.0 }
    }

    fn at(pair: u32, point: DVec3) -> ProxyContact {
        contact(pair, point, point, 0.0)
    }

    /// The contact of a rocking block jumps from corner to corner; afterwards both corners have a contact.
    #[test]
    fn a_contact_that_jumps_to_another_corner_persists() {
        let mut manifold = Manifold::new(TOLERANCE);
        let (left, right) = (at(3, DVec3::X * -0.01), at(3, DVec3::X * 0.01));
        manifold.keep_jumped(&[left], &[right]);
        manifold.weigh(&[right]);
        let [kept] = manifold.contacts() else { panic!("{} contacts", manifold.contacts().len()) };
        assert_eq!((kept.contact.contact.point, kept.contact.weight), (DVec3::X * -0.01, 1.0));
        // A contact that creeps, or is of another pair, does not persist.
        let mut still = Manifold::new(TOLERANCE);
        still.keep_jumped(&[left], &[at(3, DVec3::X * (-0.01 + 0.2 * TOLERANCE))]);
        still.keep_jumped(&[left], &[at(4, DVec3::X * 0.01)]);
        assert!(still.contacts().is_empty());
        // Nor does one that was more than d apart.
        still.keep_jumped(&[contact(3, DVec3::ZERO, DVec3::ZERO, -1.1 * TOLERANCE)], &[right]);
        assert!(still.contacts().is_empty());
    }

    #[test]
    fn a_contact_fades_as_it_slides_and_is_removed_beyond_the_tolerance() {
        for (slid, weight) in [(0.0, Some(1.0)), (0.25, Some(0.75)), (0.75, Some(0.25)), (1.0, None)] {
            let mut manifold = Manifold::new(TOLERANCE);
            let place = DVec3::Y * slid * TOLERANCE;
            manifold.keep(contact(1, place, DVec3::ZERO, 0.0));
            manifold.weigh(&[at(1, DVec3::X * 0.02)]);
            let found = manifold.contacts().first().map(|kept| kept.contact.weight);
            assert_eq!(found.is_some(), weight.is_some(), "slid by {slid} d");
            if let (Some(found), Some(weight)) = (found, weight) {
                assert!((found - weight).abs() < 1e-12, "slid by {slid} d: {found}");
            }
        }
        let mut apart = Manifold::new(TOLERANCE);
        apart.keep(contact(1, DVec3::ZERO, DVec3::ZERO, -1.001 * TOLERANCE));
        apart.weigh(&[at(1, DVec3::X * 0.02)]);
        assert!(apart.contacts().is_empty());
    }

    /// If the patches touch at the same place again, the persistent contact has no weight.
    #[test]
    fn a_persistent_contact_has_no_weight_at_the_present_one() {
        let mut manifold = Manifold::new(TOLERANCE);
        manifold.keep(at(1, DVec3::ZERO));
        for (aside, weight) in [(0.0, 0.0), (0.5, 0.5), (2.0, 1.0)] {
            manifold.weigh(&[at(1, DVec3::X * aside * TOLERANCE)]);
            assert!((manifold.contacts()[0].contact.weight - weight).abs() < 1e-12, "{aside} d aside");
        }
    }

    #[test]
    fn a_full_manifold_keeps_the_deepest() {
        let mut manifold = Manifold::new(TOLERANCE);
        let deep = |i: u32| contact(i, DVec3::ZERO, DVec3::ZERO, 1e-6 * f64::from(i));
        // 37 and 100 are coprime: each depth once, out of order.
        (0..100).for_each(|i| manifold.keep(deep((37 * i) % 100)));
        let mut kept: Vec<u32> = manifold.contacts().iter().map(|kept| kept.contact.probe_node).collect();
        kept.sort_unstable();
        assert_eq!(kept, (100 - CAPACITY as u32..100).collect::<Vec<_>>());
        // A newer contact of the same place replaces the older.
        let mut same = Manifold::new(TOLERANCE);
        same.keep(deep(5));
        same.keep(contact(5, DVec3::X * 0.5 * TOLERANCE, DVec3::ZERO, 0.0));
        assert_eq!(same.contacts().len(), 1);
        assert_eq!(same.contacts()[0].contact.contact.depth, 0.0);
    }
}
