//! Bodies that contacts push, with hosts that answer late.

use super::*;

/// Haptic steps of one run.
const STEPS: u32 = 2000;

/// What a host's world does to a body on a vertical line, beside contacts.
#[derive(Clone, Copy, Debug, PartialEq)]
enum World {
    /// Nothing.
    Free,
    /// A floor holds the body where it starts.
    Floor,
    /// Gravity acts on it.
    Gravity,
}

/// A body below another in the hand (above it in a world with gravity), moved by a host in steps of a period
/// (s) and looked at by contact queries in an interval (s), both multiples of a haptic step.
struct Session {
    rig: Rig,
    world: World,
    period: u32,
    interval: u32,
    mass: f64,
    /// The host's state along z, and the impulse that it has not taken yet.
    at: f64,
    speed: f64,
    waiting: f64,
    told: HostState,
    known: HostState,
    pushed: PushedBody,
    contact: Constraint,
    /// Side of the hand that the body is on.
    side: f64,
    /// Whether the hand does not hear the host.
    is_deaf: bool,
}

/// What a run shows.
#[derive(Debug)]
struct Shown {
    /// Deepest overlap with the host's body, m.
    overlap: f64,
    /// Force in the last quarter, and its standard deviation, N.
    force: f64,
    ripple: f64,
    /// Largest gap in the last quarter, m.
    gap: f64,
    /// Speed of the host's body at the end, away from the hand, m/s.
    speed: f64,
}

fn host(time: f64, at: f64, speed: f64) -> HostState {
    let pose = Pose::from_translation(DVec3::Z * at);
    HostState { time, pose, twist: Twist::new(DVec3::Z * speed, DVec3::ZERO) }
}

fn solid(mass: f64) -> Body {
    Body::new(mass, DMat3::from_diagonal(DVec3::splat(mass * 1e-4))).unwrap()
}

impl Session {
    fn new(world: World, (held, mass): (f64, f64), (period, interval): (u32, u32), start: f64) -> Self {
        let body = solid(held);
        let coupling = VirtualCoupling::critically_damped(&body, Pose::IDENTITY, 500.0, 0.5);
        let rig = Rig { body, coupling, ..Rig::free() };
        let side = if world == World::Gravity { 1.0 } else { -1.0 };
        let told = host(0.0, side * start, 0.0);
        let delay = DT * f64::from(period + interval);
        let mut pushed = PushedBody::new(&solid(mass), &told);
        let load = if world == World::Gravity { DVec3::NEG_Z * GRAVITY } else { DVec3::ZERO };
        pushed.set_delay(delay);
        pushed.set_load(&Twist::new(load, DVec3::ZERO));
        let contact = Constraint { pushed: Some(0), ..Constraint::new(DVec3::ZERO, DVec3::Z * side, 0.0) };
        Self {
            rig,
            world,
            period,
            interval,
            mass,
            at: told.pose.translation.z,
            speed: 0.0,
            waiting: 0.0,
            told,
            known: told,
            pushed,
            contact,
            side,
            is_deaf: false,
        }
    }

    /// Runs with a hand that moves towards the body by `way` (m) in 0.3 s.
    fn run(&mut self, way: f64) -> Shown {
        let mut shown = Shown { overlap: 0.0, force: 0.0, ripple: 0.0, gap: 0.0, speed: 0.0 };
        let mut forces = Vec::new();
        let start = self.at;
        for step in 0..STEPS {
            let now = DT * f64::from(step + 1);
            let hand = self.side * way * ((now - 0.2) / 0.3).clamp(0.0, 1.0);
            self.rig.device = DeviceMotion::at_rest(Pose::from_translation(DVec3::Z * hand));
            if step % self.interval == 0 {
                self.known = self.told;
            }
            if !self.is_deaf {
                self.pushed.apply_host_state(&self.known);
                self.pushed.update_response();
            }
            self.pushed.begin(DT);
            let between = self.pushed.pose().translation.z - self.rig.state.pose.translation.z;
            self.contact.gap = self.side * between;
            self.contact.velocity = self.pushed.surface_twist().linear;
            let pushed = std::slice::from_ref(&self.pushed);
            let contacts = std::slice::from_mut(&mut self.contact);
            let frame = self.rig.frame();
            let step_taken = constrained_step(
                &frame,
                &self.rig.state,
                contacts,
                pushed,
                &MotionBound::NONE,
                &self.rig.recovered(),
                DT,
            );
            assert!(step_taken.step.status.failure.is_none());
            (self.rig.state, self.rig.recovery) = (step_taken.step.state, step_taken.recovery);
            self.pushed.push(self.contact.impulse, self.rig.state.pose.translation);
            self.pushed.end(DT, now);
            self.waiting += self.contact.impulse.z;
            if step % self.period == 0 {
                self.answer(now, start);
            }
            let overlap = self.side * (self.rig.state.pose.translation.z - self.at);
            shown.overlap = shown.overlap.max(overlap);
            if step >= STEPS / 4 * 3 {
                forces.push(self.side * self.contact.impulse.z / DT);
                shown.gap = shown.gap.max(-overlap);
            }
        }
        shown.speed = self.side * self.speed;
        shown.force = forces.iter().sum::<f64>() / forces.len() as f64;
        let square = |force: &f64| (force - shown.force).powi(2);
        shown.ripple = (forces.iter().map(square).sum::<f64>() / forces.len() as f64).sqrt();
        shown
    }

    /// A step of the host's world.
    fn answer(&mut self, now: f64, floor: f64) {
        let dt = DT * f64::from(self.period);
        self.speed += std::mem::take(&mut self.waiting) / self.mass;
        match self.world {
            World::Free => {}
            World::Floor => self.speed = self.speed.max((floor - self.at) / dt),
            World::Gravity => self.speed -= GRAVITY * dt,
        }
        self.at += self.speed * dt;
        self.told = host(now, self.at, self.speed);
    }
}

/// Masses of the body in the hand and of the one that it pushes, kg.
const MASSES: [(f64, f64); 6] = [(0.01, 0.01), (0.1, 0.05), (0.1, 0.1), (0.3, 0.15), (0.01, 1.0), (0.3, 1.0)];

/// Haptic steps to a step of the host, and to a contact query.
const RATES: [(u32, u32); 6] = [(1, 1), (1, 20), (4, 2), (17, 1), (17, 4), (17, 20)];

/// How far the hand moves, m.
const WAY: f64 = 4e-3;

/// Runs all rates and masses in a world, with bodies that start at a distance (m).
fn runs(world: World, start: f64) -> impl Iterator<Item = ((u32, u32), (f64, f64), Shown)> {
    RATES.into_iter().flat_map(move |rates| {
        MASSES.map(|masses| (rates, masses, Session::new(world, masses, rates, start).run(WAY)))
    })
}

// Limits are some 1.5 times what was found.

#[test]
fn a_body_on_a_floor_holds_the_hand() {
    let force = 500.0 * WAY;
    for ((period, interval), masses, shown) in runs(World::Floor, 0.0) {
        let case = format!("{period} and {interval} steps, {masses:?} kg: {shown:?}");
        let late = DT * f64::from(period + interval);
        assert!(shown.overlap < 2e-5 + 0.06 * late, "{case}");
        assert!((shown.force - force).abs() < 0.01 * force && shown.ripple < 0.08 * force, "{case}");
    }
    // A hand that is told nothing of the floor pushes the body through it.
    let mut deaf = Session::new(World::Floor, (0.1, 0.1), (1, 1), 0.0);
    deaf.is_deaf = true;
    let shown = deaf.run(WAY);
    assert!(shown.overlap > 0.9 * WAY, "{shown:?}");
}

#[test]
fn a_free_body_leaves_no_faster_than_it_is_pushed() {
    // A hand of 10 g is thrown forward by its spring.
    let speed = WAY / 0.3;
    for (rates, masses, shown) in runs(World::Free, 0.0) {
        let case = format!("{rates:?} steps, {masses:?} kg: {shown:?}");
        let most = if masses.1 > 10.0 * masses.0 { 2.0 } else { 1.3 };
        assert!(shown.speed < most * speed && shown.overlap < 5e-4, "{case}");
        assert!(shown.speed > 0.9 * speed, "{case}");
    }
}

/// A body falls 2 cm into the hand, and lies there.
#[test]
fn a_body_in_the_hand_weighs_as_much_as_it_does() {
    for ((period, interval), masses, shown) in runs(World::Gravity, 0.02) {
        let case = format!("{period} and {interval} steps, {masses:?} kg: {shown:?}");
        let weight = GRAVITY * masses.1;
        assert!((shown.force - weight).abs() < 0.01 * weight && shown.ripple < 0.04 * weight, "{case}");
        // It neither sinks in nor bounces.
        assert!(shown.gap < 5e-5, "{case}");
    }
}

/// Two bodies meet as inelastic ones do: with the momentum that they had, and the velocity of both.
#[test]
fn a_step_moves_both_bodies() {
    let seed = 311;
    let mut rng = StdRng::seed_from_u64(seed);
    for case in 0..200 {
        let rig = Rig { state: BodyState::default(), ..Rig::free() };
        let (arm, normal) = (random_direction(&mut rng) * 0.02, random_direction(&mut rng));
        let other = Rig::random(&mut rng);
        let pose = Pose { translation: arm + random_direction(&mut rng) * 0.03, ..other.state.pose };
        let told = HostState { time: 0.0, pose, twist: random_twist(&mut rng, 0.1, 2.0) };
        let mut pushed = PushedBody::new(&other.body, &told);
        pushed.begin(DT);
        let before = told.twist;
        let velocity = before.velocity_at(arm - pose.translation);
        let mut contacts =
            [Constraint { velocity, friction: 0.3, pushed: Some(0), ..Constraint::new(arm, normal, 0.0) }];
        let frame = rig.frame();
        let found = constrained_step(
            &frame,
            &rig.state,
            &mut contacts,
            std::slice::from_ref(&pushed),
            &MotionBound::NONE,
            &Recovery::at_scale(1.0),
            DT,
        );
        assert!(!found.step.status.unconverged, "seed {seed}, case {case}");
        let impulse = contacts[0].impulse;
        pushed.push(impulse, arm);
        pushed.end(DT, DT);
        // The other body by its own equations.
        let turn = DMat3::from_quat(pose.rotation);
        let inverse = turn * other.body.inertia.inverse() * turn.transpose();
        let after = Twist::new(
            before.linear + impulse / other.body.mass,
            before.angular + inverse * (arm - pose.translation).cross(impulse),
        );
        let own = pushed.twist();
        assert!((own.linear - after.linear).length() < 1e-12, "seed {seed}, case {case}");
        assert!((own.angular - after.angular).length() < 1e-9, "seed {seed}, case {case}");
        // No approach is left but for the compliance, or there is no impulse.
        let here = found.step.state.twist.velocity_at(arm);
        let apart = normal.dot(here - after.velocity_at(arm - pose.translation));
        let size = velocity.length();
        if impulse == DVec3::ZERO {
            assert!(normal.dot(velocity) >= -1e-12, "seed {seed}, case {case}");
        } else {
            assert!(apart.abs() < 2e-3 * size, "seed {seed}, case {case}: {apart} of {size} m/s");
        }
    }
}

/// A body that its host puts elsewhere is there at once, and one that was pushed with no number is where its
/// host says.
#[test]
fn a_body_that_is_put_elsewhere_is_there() {
    let told = host(0.0, 0.0, 0.1);
    let mut pushed = PushedBody::new(&solid(0.1), &told);
    pushed.set_delay(0.02);
    let step = |pushed: &mut PushedBody, impulse: DVec3| {
        pushed.begin(DT);
        pushed.push(impulse, DVec3::ZERO);
        pushed.end(DT, DT);
        pushed.pose().translation.z
    };
    assert!((step(&mut pushed, DVec3::ZERO) - 0.1 * DT).abs() < 1e-15);
    // A small difference is taken over gradually.
    pushed.apply_host_state(&host(DT, 0.01, 0.1));
    let after = step(&mut pushed, DVec3::ZERO);
    assert!(after > 2e-4 && after < 2e-3, "{after} m");
    pushed.apply_host_state(&host(DT, 0.5, 0.0));
    assert_eq!(pushed.pose().translation.z, 0.5);
    step(&mut pushed, DVec3::NAN);
    assert_eq!(pushed.pose().translation.z, 0.5);
    assert_eq!(step(&mut pushed, DVec3::ZERO), 0.5);
}

/// A body that starts as its host's last states show it goes on as one that was watched for long: one that
/// lies on a table, one that falls, and one that slides down a slope.
#[test]
fn a_body_starts_as_its_host_has_shown_it() {
    let gravity = DVec3::NEG_Z * GRAVITY;
    let down = DVec3::new(1.0, 0.0, -1.0).normalize();
    for shown in [DVec3::ZERO, gravity, down * gravity.dot(down)] {
        let at = |time: f64| HostState {
            time,
            pose: Pose::from_translation(shown * (0.5 * time * time)),
            twist: Twist::new(shown * time, DVec3::ZERO),
        };
        let start = |time: f64, load: DVec3| {
            let mut pushed = PushedBody::new(&solid(0.2), &at(time));
            pushed.set_delay(0.024);
            pushed.set_load(&Twist::new(load, DVec3::ZERO));
            pushed
        };
        let mut watched = start(0.0, gravity);
        for step in 1..=1000 {
            watched.begin(DT);
            watched.end(DT, DT * f64::from(step));
            watched.apply_host_state(&at(DT * f64::from(step)));
            watched.update_response();
        }
        let mut known = start(1.0, gravity);
        known.start_response(&Twist::new(shown, DVec3::ZERO));
        for impulse in [DVec3::X, DVec3::Z, DVec3::new(0.3, -0.5, 0.2)] {
            let [one, other] = [&watched, &known].map(|body| body.change((impulse, DVec3::ZERO)).linear);
            // A step of 1 ms is a 24th of the delay.
            assert!(one.distance(other) < 5.0 / 24.0, "{shown}, {impulse}: {one} and {other} m/s");
        }
        // A wrong acceleration is told from a right one.
        let mut wrong = start(1.0, gravity);
        wrong.start_response(&Twist::new(if shown == gravity { DVec3::ZERO } else { gravity }, DVec3::ZERO));
        let [one, other] = [&watched, &wrong].map(|body| body.change((DVec3::Z, DVec3::ZERO)).linear);
        assert!(one.distance(other) > 0.4 * 5.0, "{shown}: {one} and {other} m/s");
    }
}
