//! Bodies that overlap surfaces on opposite sides: parts in a press fit, stored poses that intersect, wedges.
//! No velocity undoes all of their overlaps. They are held where they are in the directions that surfaces
//! face, are free in the others, and are given no energy.

use super::*;

/// A place on a surface: where it is (m), its normal out of the body, and the overlap at the start, m.
type Wall = (DVec3, DVec3, f64);

/// Contacts of a body with walls, flat near the body, that it was at rest in at the origin.
fn contacts(walls: &[Wall], pose: &Pose) -> Vec<Constraint> {
    let turn = pose.rotation.to_scaled_axis();
    let at = |(place, normal, overlap): &Wall| {
        let arm = place - pose.translation;
        let moved = pose.translation + turn.cross(*place);
        Constraint::new(arm, *normal, -overlap - normal.dot(moved))
    };
    walls.iter().map(at).collect()
}

/// The walls of a hole around a shaft along z of 10 mm, where it is too narrow by an overlap (m) on each
/// side. Its normals are off by up to a spread, as those of coarse meshes are.
fn hole(overlap: f64, spread: f64, rng: &mut StdRng) -> Vec<Wall> {
    let mut walls = Vec::new();
    for side in [DVec3::X, DVec3::Y, DVec3::NEG_X, DVec3::NEG_Y] {
        for _ in 0..12 {
            let along = DVec3::Z.cross(side) * rng.random_range(-4e-3..4e-3);
            let place = side * 5e-3 + along + DVec3::Z * rng.random_range(-7e-3..7e-3);
            walls.push((place, (side + random_direction(rng) * spread).normalize(), overlap));
        }
    }
    walls
}

/// A shaft of 50 g in a hand at rest at its place.
fn held() -> Rig {
    let mut rig = Rig::free();
    rig.body = Body::new(0.05, DMat3::from_diagonal(DVec3::new(7e-6, 7e-6, 1e-6))).expect("a shaft");
    rig.coupling = VirtualCoupling::critically_damped(&rig.body, Pose::IDENTITY, 1000.0, 0.3);
    rig.device = DeviceMotion::at_rest(Pose::IDENTITY);
    rig
}

/// Takes a step among walls. Returns the sum of the impulses' sizes, N·s.
fn advance(rig: &mut Rig, walls: &[Wall]) -> f64 {
    let mut near = contacts(walls, &rig.state.pose);
    let ConstrainedStep { step, recovery, .. } = rig.step(&mut near);
    assert!(step.status.is_ok());
    (rig.state, rig.recovery) = (step.state, recovery);
    near.iter().map(|contact| contact.impulse.length()).sum()
}

#[test]
#[expect(clippy::print_stdout, reason = "measured figures, shown by --nocapture")]
fn a_shaft_in_a_press_fit_stays_and_is_free_along_its_hole() {
    let seed = 311;
    let mut rng = StdRng::seed_from_u64(seed);
    for (overlap, spread) in [(5e-6, 0.02), (5e-5, 0.0), (5e-5, 0.02), (5e-5, 0.1), (1e-3, 0.02)] {
        let walls = hole(overlap, spread, &mut rng);
        let mut rig = held();
        let (mut strayed, mut force) = (0.0_f64, 0.0_f64);
        for _ in 0..500 {
            force = force.max(advance(&mut rig, &walls) / DT);
            strayed = strayed.max(rig.state.pose.translation.length());
        }
        println!("{overlap} m, normals off by {spread}: strays by {strayed:.2e} m, {force:.2e} N");
        // The hand's force on it would be a hundredth of a newton.
        assert!(strayed < 1e-5, "seed {seed}, {overlap} m, {spread}: strays by {strayed} m at rest");
        assert!(force < 1.0, "seed {seed}, {overlap} m, {spread}: {force} N between the walls");
        if spread > 0.05 {
            continue;
        }
        // Along the hole as in free space, where normals along it let it.
        let mut free = held();
        let mut apart = 0.0_f64;
        for step in 0..500 {
            let place = DVec3::Z * 2e-5 * f64::from(step.min(250)) * f64::from(u8::from(spread == 0.0));
            for rig in [&mut rig, &mut free] {
                rig.device = DeviceMotion::at_rest(Pose::from_translation(place));
            }
            advance(&mut rig, &walls);
            advance(&mut free, &[]);
            apart = apart.max((rig.state.pose.translation - free.state.pose.translation).z.abs());
        }
        assert!(apart < 1e-5, "seed {seed}, {overlap} m: {apart} m from where it is without walls");
    }
}

/// Between plates that overlap it a body comes out of a floor.
#[test]
fn what_can_be_undone_is_undone_beside_what_cannot() {
    let plates = [1.0, -1.0].map(|side| (DVec3::X * 5e-3 * side, DVec3::X * side, 5e-5));
    let floor = [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)]
        .map(|(x, y)| (DVec3::new(4e-3 * x, 4e-3 * y, -5e-3), DVec3::NEG_Z, 5e-5));
    for count in [0, 1, 3] {
        let walls: Vec<Wall> =
            floor.into_iter().chain(plates.iter().copied().cycle().take(2 * count)).collect();
        let mut rig = held();
        for _ in 0..100 {
            advance(&mut rig, &walls);
        }
        let z = rig.state.pose.translation.z;
        assert!(z > 4.5e-5 && z < 5.5e-5, "{count} plates: {z} m up");
        assert!(rig.state.pose.translation.truncate().length() < 1e-6, "{}", rig.state.pose.translation);
    }
}

/// A body is not driven out of a slender wedge against the hand, and comes out of a blunt one slowly.
#[test]
#[expect(clippy::print_stdout, reason = "measured figures, shown by --nocapture")]
fn wedges_do_not_shoot_out_what_overlaps_them() {
    for (angle, shoots) in [(0.5_f64, false), (2.0, false), (5.0, false), (20.0, true), (45.0, true)] {
        let (s, c) = angle.to_radians().sin_cos();
        // Both walls push along x.
        let walls: Vec<Wall> = [1.0, -1.0]
            .into_iter()
            .flat_map(|side| {
                let normal = DVec3::new(-s, side * c, 0.0);
                (0..8)
                    .map(move |i| (DVec3::new(0.0, side * 5e-3, 1e-3 * f64::from(i) - 3.5e-3), normal, 2e-4))
            })
            .collect();
        let mut rig = held();
        let (mut fastest, mut furthest) = (0.0_f64, 0.0_f64);
        for _ in 0..500 {
            advance(&mut rig, &walls);
            fastest = fastest.max(rig.state.twist.linear.length());
            furthest = furthest.max(rig.state.pose.translation.x);
        }
        println!("{angle}°: {fastest:.2e} m/s, {furthest:.2e} m out");
        assert!(fastest < 3.0 * RECOVERY, "{angle}°: {fastest} m/s");
        assert!(shoots || furthest < 1e-6, "{angle}°: {furthest} m");
        assert!(!shoots || furthest > 2e-4, "{angle}°: {furthest} m: the case shows nothing");
    }
}

/// A body that is pressed into a wedge in which it overlaps both walls does not creep into them, and is given
/// no more than the wedge makes of the hand's force.
#[test]
#[expect(clippy::print_stdout, reason = "measured figures, shown by --nocapture")]
fn a_body_does_not_creep_into_a_wedge() {
    let (s, c) = 5.0_f64.to_radians().sin_cos();
    let walls = [1.0, -1.0].map(|side| (DVec3::Y * (5e-3 * side), DVec3::new(-s, side * c, 0.0), 1e-5));
    let mut rig = held();
    rig.device = DeviceMotion::at_rest(Pose::from_translation(DVec3::NEG_X * 2e-3));
    let mut near = contacts(&walls, &rig.state.pose);
    for _ in 0..1000 {
        for (contact, new) in near.iter_mut().zip(contacts(&walls, &rig.state.pose)) {
            *contact = Constraint { impulse: contact.impulse, ..new };
        }
        let ConstrainedStep { step, recovery, .. } = rig.step(&mut near);
        assert!(step.status.is_ok());
        (rig.state, rig.recovery) = (step.state, recovery);
    }
    let force = near.iter().map(|contact| contact.impulse.length()).sum::<f64>() / DT;
    let grown =
        contacts(&walls, &rig.state.pose).iter().map(|contact| -contact.gap - 1e-5).fold(0.0, f64::max);
    let pressed = rig.coupling.linear_stiffness * 2e-3 / s;
    println!("{grown:.1e} m deeper after a second, {force:.1} N of {pressed:.1} N");
    // At rest each wall yields 1e-4 of an impulse's own motion in a step: 2.3e-5 m in a second.
    assert!(grown < 5e-6, "{grown} m deeper after a second");
    assert!((force / pressed - 1.0).abs() < 0.02, "{force} N where {pressed} N hold the hand");
}

/// Whatever overlaps, impulses are those that the recovery velocity needs, and a body at rest gets about that
/// velocity: its surfaces, the energy that goes with it.
#[test]
#[expect(clippy::print_stdout, reason = "measured figures, shown by --nocapture")]
fn overlaps_from_all_sides_give_no_more_than_the_recovery_velocity() {
    let seed = 312;
    let mut rng = StdRng::seed_from_u64(seed);
    let (mut fastest, mut strongest) = (0.0_f64, 0.0_f64);
    for case in 0..2000 {
        let mut rig = Rig::free();
        rig.recovery = RECOVERY;
        let mut all = random_contacts(&mut rng, [2, 6, 30, MAX_CONSTRAINTS][case % 4], 0.0);
        for contact in &mut all {
            contact.gap = if rng.random_range(0..4) == 0 { 1e-5 } else { -rng.random_range(0.0..1e-3_f64) };
            contact.velocity = DVec3::ZERO;
        }
        let step = rig.step(&mut all);
        assert!(step.step.status.is_ok(), "seed {seed}, case {case}");
        let twist = step.step.state.twist;
        let speed = all.iter().map(|c| twist.velocity_at(c.arm).length()).fold(0.0, f64::max);
        let impulse = all.iter().map(|c| c.impulse.length()).sum::<f64>();
        let needed = rig.body.mass * RECOVERY;
        fastest = fastest.max(speed / RECOVERY);
        strongest = strongest.max(impulse / needed);
    }
    println!("{fastest:.2} times the recovery velocity, {strongest:.2} times its momentum");
    assert!(fastest < 5.0, "seed {seed}: {fastest} times the recovery velocity");
    assert!(strongest < 200.0, "seed {seed}: {strongest} times its momentum");
}
