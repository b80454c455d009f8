//! Force and torque are the negative gradient of the energy: sign, frame and size, compared with differences
//! of the energy, for each method of differentiation.

use crate::common::{Plates, moved, turned_over};
use glam::{DQuat, DVec2, DVec3};
use palpate_core::Pose;
use palpate_texture_pd::{CpuBackend, DepthQuery, DepthSettings, TextureContact, TextureForce};
use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

const STIFFNESS: f64 = 2000.0;
const TOLERANCE: f64 = 0.0003;

#[test]
fn wrench_is_the_gradient_of_the_energy_in_any_frame() {
    let seed = 91;
    let mut rng = StdRng::seed_from_u64(seed);
    let bump = |at: DVec2| -10.0 * at.length_squared() + 0.0001 * (1500.0 * at.x + 400.0 * at.y).sin();
    let ridges = |at: DVec2| 0.0003 * (900.0 * at.x - 200.0 * at.y).cos();
    let plates = Plates { half: 0.02, relief_a: &bump, relief_b: &ridges };
    let (surfaces, ids) = plates.surfaces(256);
    let mut query = DepthQuery::new();
    let smooth = DepthSettings { grid: 100, temperature: 1e-5, ..DepthSettings::default() };
    let step = 1e-4;
    let methods = [(smooth, 1e-3), (DepthSettings { temperature: 0.0, ..smooth }, 1e-3)];
    let mut checked = 0;
    for case in 0..20 {
        let mut vector =
            |most: f64| DVec3::from_array(std::array::from_fn(|_| rng.random_range(-most..most)));
        // The whole scene is rotated and moved: force and torque are in world axes.
        let frame = Pose::new(vector(0.5), DQuat::from_scaled_axis(vector(2.0)));
        let place = vector(0.003).truncate();
        let pose = turned_over(place, 0.0, vector(0.03));
        let plain = plates.contact(ids, pose, 0.006);
        let contact = TextureContact {
            pose_a: frame * plain.pose_a,
            pose_b: frame * plain.pose_b,
            center: frame.transform_point(plain.center),
            normal: frame.transform_vector(plain.normal).normalize(),
            point: frame.transform_point(plain.point),
            ..plain
        };
        for (method, (settings, within)) in methods.iter().enumerate() {
            let mut force = |contact: TextureContact, settings: &DepthSettings| {
                let found = query.run(&surfaces, &[contact], settings, &mut CpuBackend::new()).unwrap()[0];
                TextureForce::new(&found.unwrap(), STIFFNESS, TOLERANCE)
            };
            let here = force(contact, settings);
            if here.energy == 0.0 {
                continue;
            }
            checked += 1;
            let mut energy = |shift: DVec3, turn: DVec3| {
                let pose_a = moved(&contact.pose_a, contact.center, shift, turn);
                force(TextureContact { pose_a, ..contact }, settings).energy
            };
            let lever = 0.01;
            for axis in DVec3::AXES {
                let shift = axis * step * 0.05;
                let found =
                    (energy(-shift, DVec3::ZERO) - energy(shift, DVec3::ZERO)) / (2.0 * shift.length());
                let size = here.wrench.force.length();
                let error = (found - here.wrench.force.dot(axis)).abs() / size;
                assert!(error < *within, "seed {seed}, case {case}, method {method}: {error} along {axis}");
                let turn = axis * step * 0.5;
                let found = (energy(DVec3::ZERO, -turn) - energy(DVec3::ZERO, turn)) / (2.0 * turn.length());
                let error = (found - here.wrench.torque.dot(axis)).abs() / (size * lever);
                assert!(error < *within, "seed {seed}, case {case}, method {method}: {error} about {axis}");
            }
        }
    }
    assert!(checked > 30, "{checked}");
}
