//! On the CPU a query allocates nothing once its workspace has grown.

use crate::common::{Plates, turned_over};
use glam::{DVec2, DVec3};
use palpate_texture_pd::{CpuBackend, DepthQuery, DepthSettings};

#[test]
fn queries_do_not_allocate_once_their_workspace_has_grown() {
    let bump = |at: DVec2| -10.0 * at.length_squared();
    let ridges = |at: DVec2| 0.0003 * (900.0 * at.x).cos();
    let plates = Plates { half: 0.02, relief_a: &bump, relief_b: &ridges };
    let (surfaces, ids) = plates.surfaces(128);
    let settings = DepthSettings { temperature: 1e-5, ..DepthSettings::default() };
    let contacts = |i: u32| {
        let place = DVec2::X * 1e-4 * f64::from(i);
        [plates.contact(ids, turned_over(place, 0.0, DVec3::X * 0.02), 0.006); 3]
    };
    let (mut query, mut backend) = (DepthQuery::new(), CpuBackend::new());
    query.run(&surfaces, &contacts(0), &settings, &mut backend).unwrap();
    let mut run = || {
        for i in 1..20 {
            assert!(query.run(&surfaces, &contacts(i), &settings, &mut backend).unwrap()[0].is_some());
        }
    };
    let counted = allocation_counter::measure(&mut run);
    assert_eq!(counted.count_total, 0);
}
