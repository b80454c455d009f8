//! What becomes of contacts that there is no room for: near ones are merged, and none is lost that stands alone.

use palpate_core::glam::DVec3;

use crate::PatchContact;

/// Room that there has to be for contacts, at least.
pub(crate) const LEAST_ROOM: usize = 16;

/// Keeps the deepest contact of every cube of a grid, for each octant that normals point to, where the grid is the finest,
/// no finer than `spacing` (m) and by factors of 2, that leaves half of the room free. Returns the grid's spacing.
///
/// So every contact that goes is within √3 times the spacing of a deeper one that stays, with a normal in the same octant.
/// Does not allocate. What remains depends on the contacts alone, not on their order.
pub(crate) fn thin(contacts: &mut Vec<PatchContact>, spacing: f64) -> f64 {
    let room = contacts.capacity() / 2;
    let points = || contacts.iter().map(|found| found.contact.point);
    let low = points().fold(DVec3::INFINITY, DVec3::min);
    let extent = (points().fold(DVec3::NEG_INFINITY, DVec3::max) - low).max_element();
    // Where there is no extent one cube holds all.
    let mut spacing = spacing.max(extent * 1e-15).max(f64::MIN_POSITIVE);
    loop {
        let cell = |found: &PatchContact| {
            let cube = ((found.contact.point - low) / spacing).floor();
            (cube.to_array().map(|x| x as u64), found.contact.normal.signum().to_array().map(|x| x < 0.0))
        };
        contacts.sort_unstable_by(|a, b| {
            cell(a)
                .cmp(&cell(b))
                .then_with(|| b.contact.depth.total_cmp(&a.contact.depth))
                .then_with(|| (a.probe_node, a.scene_node).cmp(&(b.probe_node, b.scene_node)))
        });
        contacts.dedup_by(|later, kept| cell(later) == cell(kept));
        // A single cube holds one contact for each octant.
        if contacts.len() <= room || spacing > extent {
            return spacing;
        }
        spacing *= 2.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate_core::Contact;
    use rand::{RngExt, SeedableRng, rngs::StdRng};

    #[test]
    fn no_region_is_lost() {
        let mut rng = StdRng::seed_from_u64(0x0007_4135);
        for round in 0..50 {
            let mut vector = || DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
            let mut contacts = Vec::with_capacity(64);
            while contacts.len() < contacts.capacity() {
                let normal = vector().normalize();
                // Most in a bunch, some far apart.
                let point = if contacts.len() % 8 == 0 { 10.0 * vector() } else { 0.1 * vector() };
                let depth = vector().x;
                let contact = Contact { point, scene_point: point - depth * normal, normal, depth };
                contacts.push(PatchContact { contact, probe_node: 0, scene_node: 0, weight: 1.0 });
            }
            let all = contacts.clone();
            let spacing = thin(&mut contacts, 1e-3);
            assert!(contacts.len() <= 32 && contacts.capacity() == all.capacity(), "round {round}");
            for lost in &all {
                let stands_for = |kept: &PatchContact| {
                    kept.contact.point.distance(lost.contact.point) <= 3f64.sqrt() * spacing
                        && kept.contact.depth >= lost.contact.depth
                        && kept.contact.normal.signum() == lost.contact.normal.signum()
                };
                assert!(contacts.iter().any(stands_for), "round {round}, spacing {spacing}: {lost:?}");
            }
        }
    }
}
