//! Bodies that slide, rest, overlap and are squeezed: against theory, bounds and unusable numbers.

use super::*;

/// Corners of the bottom of a cube that is at a height (m) over the plane z = 0.
fn bottom(pose: &Pose, friction: f64) -> Vec<Constraint> {
    let corner = |i: u32| DVec3::new(f64::from(i & 1), f64::from(i >> 1), 0.0) * 0.04 - 0.02;
    let at = |i: u32| {
        let arm = pose.transform_vector(corner(i));
        Constraint { friction, ..Constraint::new(arm, DVec3::NEG_Z, (pose.translation + arm).z) }
    };
    (0..4).map(at).collect()
}

/// Twist of a cube after some time (s) on an incline of an angle (rad), that starts at a speed along x.
/// Returns the largest gap or overlap as well.
fn slide(angle: f64, friction: f64, speed: f64, seconds: f64) -> (Twist, f64) {
    let mut rig = Rig::free();
    rig.gravity = DVec3::new(angle.sin(), 0.0, -angle.cos()) * GRAVITY;
    rig.state.pose.translation.z = 0.02;
    rig.state.twist.linear.x = speed;
    let mut contacts = bottom(&rig.state.pose, friction);
    let mut off: f64 = 0.0;
    for _ in 0..(seconds / DT).round() as u32 {
        let next = bottom(&rig.state.pose, friction);
        for (contact, next) in contacts.iter_mut().zip(next) {
            *contact = Constraint { impulse: contact.impulse, ..next };
            off = off.max(contact.gap.abs());
        }
        let step = rig.step(&mut contacts);
        assert!(step.step.status.failure.is_none());
        rig.state = step.step.state;
    }
    (rig.state.twist, off)
}

#[test]
fn a_block_slides_above_the_angle_of_friction() {
    for friction in [0.1_f64, 0.3, 0.6] {
        let slope = |factor: f64| (factor * friction).atan();
        let (still, off) = slide(slope(0.99), friction, 0.0, 0.3);
        assert!(still.linear.length() < 1e-4, "μ {friction}: creeps at {} m/s", still.linear);
        assert!(off < 1e-5, "μ {friction}: {off} m");
        // A tenth of the acceleration of a block without friction.
        let angle = slope(1.1);
        let wanted = GRAVITY * (angle.sin() - friction * angle.cos());
        let (twist, off) = slide(angle, friction, 0.0, 0.3);
        let found = twist.linear.x / 0.3;
        assert!((found - wanted).abs() < 0.01 * wanted, "μ {friction}: {found}, not {wanted} m/s²");
        assert!(off < 1e-5 && twist.angular.length() < 1e-3, "μ {friction}: {off} m, {}", twist.angular);
    }
}

#[test]
fn a_sliding_block_slows_down_and_stops() {
    for (angle, friction) in [(0.0, 0.2), (0.2, 0.5), (-0.3, 0.1)] {
        let wanted = GRAVITY * (f64::sin(angle) - friction * f64::cos(angle));
        let (twist, _) = slide(angle, friction, 0.5, 0.1);
        let found = (twist.linear.x - 0.5) / 0.1;
        assert!(
            (found - wanted).abs() < 0.01 * wanted.abs(),
            "{angle}, μ {friction}: {found}, not {wanted} m/s²"
        );
    }
    let (stopped, _) = slide(0.0, 0.2, 0.5, 0.4);
    assert!(stopped.linear.length() < 1e-4, "goes on at {}", stopped.linear);
    let (_, off) = slide(0.0, 0.2, 0.5, 0.4);
    assert!(off < 1e-5, "{off} m");
}

#[test]
fn redundant_contacts_carry_the_load() {
    for (count, friction) in [(4, 0.0), (4, 0.3), (32, 0.0), (32, 0.3)] {
        let mut rig = Rig::free();
        rig.gravity = DVec3::NEG_Z * GRAVITY;
        let around = |i: usize| {
            let turn = DQuat::from_rotation_z(i as f64 * std::f64::consts::TAU / count as f64);
            let arm = turn * (DVec3::X * 0.03) - DVec3::Z * 0.02;
            Constraint { friction, ..Constraint::new(arm, DVec3::NEG_Z, 0.0) }
        };
        let mut contacts: Vec<_> = (0..count).map(around).collect();
        let step = rig.step(&mut contacts);
        assert!(!step.step.status.unconverged, "{count} contacts, μ {friction}");
        let load = step.step.contact.force;
        let wanted = DVec3::Z * (rig.body.mass * GRAVITY);
        assert!(load.distance(wanted) < 2e-3 * wanted.z, "{count} contacts: {load} N, not {wanted}");
        let twist = step.step.state.twist;
        assert!(twist.linear.length() < 2e-3 * GRAVITY * DT && twist.angular.length() < 1e-6, "{twist:?}");
        let shares = contacts.iter().map(|c| -c.impulse.z / DT);
        let most = shares.clone().fold(0.0, f64::max);
        assert!(shares.clone().all(|share| share >= 0.0) && most < 2.0 * wanted.z / count as f64, "{most} N");
    }
}

/// Heights (m), speeds (m/s) and kinetic energies (J) after each step of `dt` (s) of a body that rests in a
/// floor at first, at a depth of `overlap` (m).
fn recovered(overlap: f64, damping: f64, dt: f64) -> impl Iterator<Item = (f64, f64, f64)> {
    let mut rig = Rig::free();
    rig.coupling.linear_damping = damping;
    rig.state.pose.translation = DVec3::Z * (0.02 - overlap);
    std::iter::from_fn(move || {
        let ConstrainedStep { step, recovery, .. } = rig.step_of(dt, &mut bottom(&rig.state.pose, 0.0));
        (rig.state, rig.recovery) = (step.state, recovery);
        let height = step.state.pose.translation.z - 0.02;
        Some((height, step.state.twist.linear.z, rig.body.kinetic_energy(&step.state)))
    })
}

#[test]
fn an_overlap_gives_the_recovery_velocity_and_no_more() {
    let mass = Rig::free().body.mass;
    for overlap in [3e-4, 1e-3, 1e-2] {
        for (damping, wanted) in [(0.0, RECOVERY), (1.0, RECOVERY), (10.0, 0.005)] {
            let mut most: f64 = 0.0;
            for (_, speed, energy) in recovered(overlap, damping, DT).take(100) {
                assert!(energy <= 0.5 * mass * wanted * wanted * (1.0 + 1e-9), "{overlap} m: {energy} J");
                most = most.max(speed);
            }
            assert!(most <= wanted * (1.0 + 1e-9), "{overlap} m: {most} m/s");
            assert!(overlap < 5e-4 || most > 0.99 * wanted, "{overlap} m: {most} m/s");
        }
    }
    // Against the law in continuous time, T = 5 ms: ẋ = −min(x/T, r) and T ṙ = x/T − r.
    let (mut depth, mut recovery, dt, fine) = (1e-5, 0.0, 1e-4, 1e-7);
    for (height, ..) in recovered(1e-5, 1.0, dt).take(300) {
        for _ in 0..1000 {
            recovery += fine / 5e-3 * (depth / 5e-3 - recovery);
            depth -= fine * f64::min(depth / 5e-3, recovery);
        }
        // A body that nothing slows down does not wait for the recovery velocity to fall again.
        let least = -0.02 * depth - 1e-9;
        let most = if recovery < depth / 5e-3 { 0.02 * depth } else { f64::INFINITY };
        assert!((least..=most).contains(&(height + depth)), "{height} m, not {} m", -depth);
    }
    assert!(depth < 0.1e-5, "{depth} m");
    // A spring gives more.
    let mut rig = Rig::free();
    let parameters =
        ContactParameters { stiffness: 5e3, damping: 0.0, tolerance: 0.0, friction: Friction::NONE };
    let touch =
        Contact { point: DVec3::ZERO, scene_point: DVec3::Z * 1e-3, normal: DVec3::NEG_Z, depth: 1e-3 };
    rig.contacts = LinearContactModel::from_contacts([touch], &Pose::IDENTITY, &parameters, 0.0);
    let sprung = rig.step(&mut []).step.state.twist.linear.z;
    assert!(sprung > 2.0 * RECOVERY, "{sprung} m/s");
}

/// A body that leaves faster than it is recovered is left alone; one that comes in loses energy.
#[test]
fn contacts_add_no_kinetic_energy() {
    let seed = 304;
    let mut rng = StdRng::seed_from_u64(seed);
    for case in 0..500 {
        let mut rig = Rig::free();
        rig.state.twist = random_twist(&mut rng, 0.3, 5.0);
        let all = random_contacts(&mut rng, 12, 0.4);
        let mut contacts: Vec<_> =
            all.iter().map(|c| Constraint { velocity: DVec3::ZERO, gap: c.gap.max(0.0), ..*c }).collect();
        // Without contacts the carried momentum changes the energy, a little.
        let before = rig.body.kinetic_energy(&rig.step(&mut []).step.state);
        let after = rig.body.kinetic_energy(&rig.step(&mut contacts).step.state);
        assert!(after <= before * (1.0 + 1e-6), "seed {seed}, case {case}: {before} J to {after} J");
    }
    let mut rig = Rig::free();
    rig.state.twist.linear.z = 0.1;
    let step = rig.step(&mut bottom(&Pose::IDENTITY, 0.0)).step;
    assert_eq!(step.state.twist.linear.z, 0.1, "deep, and on its way out");
}

#[test]
fn no_point_moves_beyond_the_bound() {
    let seed = 305;
    let mut rng = StdRng::seed_from_u64(seed);
    let (mut held_back, mut free, mut beyond) = (0, 0, 0);
    for case in 0..2000 {
        let mut rig = Rig::random(&mut rng);
        rig.state.twist = random_twist(&mut rng, 1.0, 30.0);
        let radius = 0.03;
        let away = random_twist(&mut rng, 5e-4, 0.02);
        let from = rig.state.pose.moved(&away, 1.0);
        let bound = MotionBound {
            from,
            room: rng.random_range(0.0..3e-3),
            step: if case % 2 == 0 { rng.random_range(0.0..2e-3) } else { f64::INFINITY },
            radius,
        };
        let mut contacts = random_contacts(&mut rng, 4, 0.3);
        let found =
            constrained_step(&rig.frame(), &rig.state, &mut contacts, &[], &bound, &rig.recovered(), DT);
        let next = found.step.state.pose;
        let was_beyond = bound.displacement(&rig.state.pose) > bound.room;
        beyond += u32::from(was_beyond);
        held_back += u32::from(found.held_back);
        free += u32::from(!found.held_back);
        for _ in 0..20 {
            let point = random_direction(&mut rng) * (radius * rng.random_range(0.0..1.0));
            let moved = |from: &Pose| from.transform_point(point).distance(next.transform_point(point));
            let most = if was_beyond { f64::INFINITY } else { bound.room };
            assert!(moved(&from) <= most + 1e-12, "seed {seed}, case {case}: {} m", moved(&from));
            assert!(moved(&rig.state.pose) <= bound.step + 1e-12, "seed {seed}, case {case}");
            if was_beyond && !found.held_back {
                assert!(moved(&from) <= bound.room + 1e-12, "seed {seed}, case {case}: further away");
            }
        }
        // The velocity is that of the motion, so that nothing is stored up.
        let Twist { linear, .. } = found.step.state.twist;
        let went = next.translation - rig.state.pose.translation;
        assert!(went.distance(linear * DT) < 1e-12, "seed {seed}, case {case}");
    }
    assert!(
        held_back > 300 && free > 300 && beyond > 100,
        "{held_back} held back, {free} free, {beyond} beyond"
    );
}

#[test]
fn displacements_are_those_of_points_at_the_radius() {
    let bound = MotionBound { radius: 0.03, ..MotionBound::NONE };
    let turned = Pose::new(DVec3::X * 0.01, DQuat::from_rotation_z(0.5 * std::f64::consts::PI));
    // The chord of a quarter turn.
    let wanted = 0.01 + 2.0_f64.sqrt() * 0.03;
    assert!((bound.displacement(&turned) - wanted).abs() < 1e-12, "{}", bound.displacement(&turned));
}

/// Between plates that close there is no solution: the body stays between them, and nothing is infinite.
#[test]
fn closing_plates_squeeze_the_body() {
    for (gap, speed, friction) in [(0.0, 0.05, 0.0), (-1e-3, 0.0, 0.3), (-1e-3, 0.5, 0.3), (-0.02, 5.0, 1.0)]
    {
        let mut rig = Rig::free();
        let plate = |side: f64| Constraint {
            velocity: DVec3::Z * (-side * speed),
            friction,
            ..Constraint::new(DVec3::Z * (side * 0.02), DVec3::Z * side, gap)
        };
        let mut contacts = [plate(1.0), plate(-1.0)];
        for _ in 0..100 {
            let ConstrainedStep { step, .. } = rig.step(&mut contacts);
            assert!(step.status.failure.is_none() && step.contact.is_finite());
            assert!(contacts.iter().all(|contact| contact.impulse.is_finite()));
            rig.state = step.state;
        }
        assert!(rig.state.twist.linear.length() < 1e-6, "gap {gap}: {}", rig.state.twist.linear);
        assert!(rig.state.pose.translation.length() < 1e-6, "gap {gap}: {}", rig.state.pose.translation);
        // Plates at rest hold the body without pressing on it.
        assert!(contacts.iter().all(|contact| (contact.impulse.length() > 0.0) == (speed > 0.0)));
    }
}

#[test]
fn unusable_inputs_are_refused_as_by_other_steps() {
    for bad in [f64::NAN, f64::INFINITY] {
        let changes: [fn(&mut Rig, f64); 8] = [
            |rig, bad| rig.state.twist.angular.x = bad,
            |rig, bad| rig.state.pose.translation.y = bad,
            |rig, bad| rig.device.pose.translation.y = bad,
            |rig, bad| rig.device.twist.linear.z = bad,
            |rig, bad| rig.coupling.linear_stiffness = bad,
            |rig, bad| rig.coupling.angular_damping = bad,
            |rig, bad| rig.gravity.z = bad,
            |rig, bad| rig.body.mass = bad,
        ];
        for change in changes {
            let mut rig = Rig::random(&mut StdRng::seed_from_u64(306));
            change(&mut rig, bad);
            let mut contacts = bottom(&Pose::IDENTITY, 0.3);
            let Rig { body, state, device, coupling, contacts: none, gravity, .. } = &rig;
            let other = semi_implicit_step(body, state, device, coupling, none, *gravity, DT);
            let found = rig.step(&mut contacts);
            assert!(other.status.failure.is_some());
            assert_eq!(found, ConstrainedStep::from(other));
        }
    }
    for dt in [0.0, -1e-3, f64::NAN, f64::INFINITY] {
        let rig = Rig::free();
        let mut contacts = bottom(&Pose::IDENTITY, 0.3);
        let found = rig.step_of(dt, &mut contacts);
        assert_eq!(found.step.status.failure, Some(StepFailure::TimeStep));
    }
}

/// Contacts with numbers that are not finite do not reach the state or the wrenches, nor the next step.
#[test]
fn unusable_contacts_do_not_reach_the_state() {
    let changes: [fn(&mut Constraint, f64); 6] = [
        |contact, bad| contact.arm.x = bad,
        |contact, bad| contact.normal.y = bad,
        |contact, bad| contact.gap = bad,
        |contact, bad| contact.velocity.z = bad,
        |contact, bad| contact.friction = bad,
        |contact, bad| contact.impulse.x = bad,
    ];
    for (index, change) in changes.iter().enumerate() {
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300] {
            let mut rig = Rig::free();
            rig.gravity = DVec3::NEG_Z * GRAVITY;
            rig.state.pose.translation.z = 0.02;
            let mut contacts = bottom(&rig.state.pose, 0.3);
            change(&mut contacts[1], bad);
            let ConstrainedStep { step, .. } = rig.step(&mut contacts);
            assert!(step.state.is_valid() && step.contact.is_finite(), "change {index} to {bad}: {step:?}");
            assert!(step.coupling.is_finite(), "change {index} to {bad}");
            let finite = contacts.iter().all(|contact| contact.impulse.is_finite());
            assert!(finite, "change {index} to {bad}: impulses {contacts:?}");
        }
    }
}
