//! Steps with more contacts than impulses are found for.

use super::*;

/// Points on a half sphere that a body is pressed with onto random planes that touch it: many more contacts
/// than a step solves for.
fn touching(rng: &mut StdRng, count: usize) -> Vec<Constraint> {
    let touching = |rng: &mut StdRng| {
        let direction = random_direction(rng);
        let normal = DVec3::new(direction.x, direction.y, -direction.z.abs());
        Constraint::new(normal * 0.02 + random_vector(rng, 2e-3), normal, rng.random_range(0.0..2e-5))
    };
    (0..count).map(|_| touching(rng)).collect()
}

/// Whatever the number of contacts, none is passed and those that push are closed. The first 64 alone would
/// let others pass: the negative control.
#[test]
fn no_contact_is_passed_however_many_there_are() {
    let seed = 304;
    let mut rng = StdRng::seed_from_u64(seed);
    let (mut pushing, mut passed_by_the_first, mut held_back) = (0, 0, 0);
    for case in 0..200 {
        let rig = Rig::random(&mut rng);
        let mut contacts = touching(&mut rng, 300);
        let size = largest_approach(&rig, &contacts);
        let passes = |contact: &Constraint, twist: &Twist| {
            contact.normal.dot(twist.velocity_at(contact.arm)) - contact.gap / DT
        };
        let mut first = contacts[..MAX_CONSTRAINTS].to_vec();
        let by_the_first = rig.step(&mut first).step.state.twist;
        let others = &contacts[MAX_CONSTRAINTS..];
        passed_by_the_first += u32::from(others.iter().any(|c| passes(c, &by_the_first) > 1e-2 * size));

        let step = rig.step(&mut contacts);
        assert!(step.step.status.is_ok(), "seed {seed}, case {case}");
        held_back += u32::from(step.held_back);
        let twist = step.step.state.twist;
        for contact in &contacts {
            let (passed, impulse) = (passes(contact, &twist), contact.normal.dot(contact.impulse));
            assert!(impulse >= 0.0 && passed < 1e-2 * size, "seed {seed}, case {case}: {passed} m/s");
            pushing += u32::from(impulse > 0.0);
        }
    }
    assert!(pushing > 300, "{pushing} push");
    assert!(passed_by_the_first > 100, "{passed_by_the_first} of 200: the cases show nothing");
    assert!(held_back < 10, "{held_back} steps were shortened");
}

/// A block on a plane at 400 points weighs and slides as one on its four corners does.
#[test]
fn a_block_on_many_points_slides_as_on_its_corners() {
    let friction = 0.3;
    let slid = |side: u32| {
        let mut rig = Rig::free();
        rig.gravity = DVec3::new(0.5, 0.1, -1.0) * GRAVITY;
        rig.state.pose.translation.z = 0.02;
        let at =
            |i: u32| DVec3::new(f64::from(i % side), f64::from(i / side), 0.0) * 0.04 / f64::from(side - 1);
        let mut contacts: Vec<Constraint> = (0..side * side)
            .map(|i| Constraint {
                friction,
                key: i as u16,
                ..Constraint::new(DVec3::ZERO, DVec3::NEG_Z, 0.0)
            })
            .collect();
        for _ in 0..200 {
            for contact in &mut contacts {
                contact.arm = rig.state.pose.transform_vector(at(contact.key.into()) - DVec3::splat(0.02));
                contact.gap = (rig.state.pose.translation + contact.arm).z;
            }
            let step = rig.step(&mut contacts);
            assert!(!step.held_back && step.step.status.failure.is_none());
            rig.state = step.step.state;
        }
        (rig.state.twist, rig.state.pose.translation)
    };
    let ((corners, at_corners), (many, at_many)) = (slid(2), slid(20));
    assert!(
        (corners.linear - many.linear).length() < 0.01 * corners.linear.length(),
        "{corners:?}, {many:?}"
    );
    assert!(at_corners.distance(at_many) < 0.01 * at_corners.truncate().length());
    assert!((at_many.z - 0.02).abs() < 1e-6 && many.angular.length() < 1e-2, "{at_many}, {many:?}");
}
