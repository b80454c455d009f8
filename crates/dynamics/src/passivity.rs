//! Energy at the device's port, and damping when more comes out than was stored (Hannaford and Ryu 2002).
//!
//! A force f that is held from one sample to the next takes the work −f · Δx from the hand over the measured
//! displacement Δx: exactly the energy that flowed, whatever happened between the samples. Translation and
//! rotation are two such ports, with force and displacement, or torque and rotation vector.
//!
//! Encoder steps bias the sum: the force responds to a step Δ only after all of it was measured,
//! so that a spring K seems to create K Δ²/2 at each step, in both directions. Up to one step, a displacement
//! is therefore charged with the mean of the forces before and after it.

use glam::DVec3;
use palpate_core::{Twist, Wrench};

/// Largest rounding of a displacement by encoders on three axes, in encoder steps: √3.
const DIAGONAL: f64 = 1.732_050_807_568_877_2;

/// Account of the energy that flows in at a port.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PassivityObserver {
    /// Resolution of the displacement, m or rad.
    step: f64,
    energy: f64,
    /// Force held at the port, N or N·m.
    held: DVec3,
    /// The last displacement, limited to the resolution, to which the force has not responded yet.
    unanswered: DVec3,
}

impl PassivityObserver {
    /// An account without energy and without a force held. `step` is the smallest displacement that is
    /// sensed, m or rad.
    pub fn new(step: f64) -> Self {
        Self { step, ..Self::default() }
    }

    /// Accounts for the displacement (m, rad) since the last call under the force held. Returns the energy
    /// (J) that flowed in, −f · Δx.
    pub fn observe(&mut self, displacement: DVec3) -> f64 {
        let length = displacement.length();
        if !length.is_finite() {
            self.unanswered = DVec3::ZERO;
            return 0.0;
        }
        let resolution = DIAGONAL * self.step;
        self.unanswered =
            if length > resolution { displacement * (resolution / length) } else { displacement };
        self.add(-self.held.dot(displacement))
    }

    /// Sets the force (N, N·m) held from now on. Returns the correction (J) of the last displacement's
    /// energy, −½ (f' − f) · Δx for a displacement of at most one encoder step.
    pub fn hold(&mut self, force: DVec3) -> f64 {
        let answer = if self.step > 0.0 { (force - self.held).dot(self.unanswered) } else { 0.0 };
        self.held = force;
        self.add(-0.5 * answer)
    }

    /// Force held, N or N·m.
    pub fn held(&self) -> DVec3 {
        self.held
    }

    /// Energy that has flowed in, J. Negative if more came out than went in.
    pub fn energy(&self) -> f64 {
        self.energy
    }

    fn add(&mut self, energy: f64) -> f64 {
        if energy.is_finite() {
            self.energy += energy;
            energy
        } else {
            0.0
        }
    }
}

/// The time-domain passivity controller of Hannaford and Ryu, which damps a device that receives more energy
/// than it gave, with three bounds.
///
/// - Only energy that can still come back counts: energy that flowed in beyond `stored` has been dissipated
///   and is dropped, so that a session that dissipated much cannot create as much later.
/// - The damping never exceeds a maximum, to be chosen so that a damper of that size is itself passive at the
///   port.
/// - Energy that rounding of the position may explain, √3 Δ ‖f‖, is not damped.
///
/// Translation and rotation have an observer each but share one reserve, since a body may give back by
/// turning the energy that it received by moving.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PassivityController {
    translation: PassivityObserver,
    rotation: PassivityObserver,
    max_damping: (f64, f64),
    /// Energy that may come out, J; negative if energy was created.
    reserve: f64,
    damping: Wrench,
    dissipated: f64,
}

impl PassivityController {
    /// A controller on positions in steps of `steps` (m, rad), with damping of at most `max_damping` (N·s/m,
    /// N·m·s/rad): none where that is not a positive number.
    pub fn new(max_damping: (f64, f64), steps: (f64, f64)) -> Self {
        let mut controller = Self {
            translation: PassivityObserver::new(steps.0),
            rotation: PassivityObserver::new(steps.1),
            max_damping: (0.0, 0.0),
            reserve: 0.0,
            damping: Wrench::ZERO,
            dissipated: 0.0,
        };
        controller.set_max_damping(max_damping);
        controller
    }

    /// Sets the largest damping from now on.
    pub fn set_max_damping(&mut self, (linear, angular): (f64, f64)) {
        let usable = |damping: f64| if damping.is_finite() { damping.max(0.0) } else { 0.0 };
        self.max_damping = (usable(linear), usable(angular));
    }

    /// Accounts for the displacement (m, rad) since the last call. `stored` is the largest energy (J) that
    /// the rendered springs hold now and may give back.
    pub fn observe(&mut self, displacement: &Twist, stored: f64) {
        let work = -self.damping.power(displacement);
        self.dissipated += if work.is_finite() { work } else { 0.0 };
        self.reserve += self.translation.observe(displacement.linear);
        self.reserve += self.rotation.observe(displacement.angular);
        self.reserve = self.reserve.min(stored.max(0.0));
    }

    /// Accounts for energy (J) that flowed into the session at another port, as at a gripper: it may come out
    /// here. To be called before [`Self::observe`], which drops the energy that cannot come back.
    pub fn exchange(&mut self, energy: f64) {
        self.reserve += if energy.is_finite() { energy } else { 0.0 };
    }

    /// The wrench (N, N·m) to add at a handle that moves at `twist` (m/s, rad/s) and is sampled again in `dt`
    /// (s). It opposes the motion and takes out the created energy in that time, within the largest damping.
    pub fn damping(&mut self, twist: &Twist, dt: f64) -> Wrench {
        let created = self.created();
        let most = Wrench::new(twist.linear * -self.max_damping.0, twist.angular * -self.max_damping.1);
        let taken = -most.power(twist) * dt;
        self.damping = if created > 0.0 && taken > 0.0 && taken.is_finite() {
            most * (created / taken).min(1.0)
        } else {
            Wrench::ZERO
        };
        self.damping
    }

    /// Energy (J) that came out beyond the stored energy and that rounding of the position does not explain;
    /// 0 if there is none.
    pub fn created(&self) -> f64 {
        let hidden = |observer: &PassivityObserver| DIAGONAL * observer.step * observer.held.length();
        (-self.reserve - hidden(&self.translation) - hidden(&self.rotation)).max(0.0)
    }

    /// Clears the created energy, once the wrench that created it is dropped.
    pub fn forgive(&mut self) {
        self.reserve = self.reserve.max(0.0);
    }

    /// Restarts the account: no energy is left that may come out.
    pub fn restart(&mut self) {
        self.reserve = 0.0;
    }

    /// Stops damping and returns a zero wrench, when no wrench is wanted.
    pub fn rest(&mut self) -> Wrench {
        self.damping = Wrench::ZERO;
        Wrench::ZERO
    }

    /// Sets the wrench (N, N·m) held from now on.
    pub fn hold(&mut self, wrench: &Wrench) {
        self.reserve += self.translation.hold(wrench.force);
        self.reserve += self.rotation.hold(wrench.torque);
    }

    /// Energy that has flowed in, J: [`PassivityObserver::energy`] of translation and rotation together.
    pub fn energy(&self) -> f64 {
        self.translation.energy() + self.rotation.energy()
    }

    /// The observers of translation and of rotation.
    pub fn observers(&self) -> (&PassivityObserver, &PassivityObserver) {
        (&self.translation, &self.rotation)
    }

    /// Energy that the damping has taken out, J.
    pub fn dissipated(&self) -> f64 {
        self.dissipated
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng as _, rngs::StdRng};

    use super::*;

    fn along(x: f64) -> Twist {
        Twist::new(DVec3::X * x, DVec3::ZERO)
    }

    fn pushing(force: f64) -> Wrench {
        Wrench::new(DVec3::X * force, DVec3::ZERO)
    }

    /// A handle with the spring that is rendered on it.
    struct Port {
        mass: f64,
        viscous: f64,
        stiffness: f64,
        /// Samples by which the spring's force is late.
        delay: usize,
        step: f64,
        limit: f64,
    }

    /// State of a port at the end of a run.
    struct Outcome {
        /// Largest distance from the spring's rest in the last fifth, m.
        swing: f64,
        /// Energy given to the handle in truth up to the last sample, J.
        created: f64,
        controller: PassivityController,
        largest_damping_force: f64,
    }

    /// Four seconds at 1 kHz, the handle let go at 5 mm.
    fn run(port: &Port, max_damping: f64) -> Outcome {
        let (period, substeps) = (1e-3, 10);
        let mut controller = PassivityController::new((max_damping, 0.0), (port.step, 0.0));
        let rounded = |x: f64| if port.step > 0.0 { (x / port.step).round() * port.step } else { x };
        let (mut x, mut v, mut force) = (5e-3, 0.0, 0.0);
        let mut seen = vec![rounded(x); port.delay + 1];
        let (mut velocity, mut swing, mut largest) = (0.0, 0.0_f64, 0.0_f64);
        let (mut work, mut created) = (0.0, 0.0);
        for tick in 0..4000 {
            created = work;
            let reading = rounded(x);
            let displacement = reading - seen[seen.len() - 1];
            seen.push(reading);
            velocity += 0.5 * (displacement / period - velocity);
            controller.observe(&along(displacement), 0.5 * port.stiffness * reading * reading);
            let damping = controller.damping(&along(velocity), period).force.x;
            assert!(
                damping * velocity <= 0.0 && damping.abs() <= max_damping * velocity.abs() * (1.0 + 1e-12)
            );
            largest = largest.max(damping.abs());
            let spring = (-port.stiffness * seen[seen.len() - 1 - port.delay]).clamp(-port.limit, port.limit);
            force = spring + damping;
            controller.hold(&pushing(force));
            for _ in 0..substeps {
                let h = period / f64::from(substeps);
                v = (v + h / port.mass * force) / (1.0 + h * port.viscous / port.mass);
                x += h * v;
                work += force * v * h;
            }
            if tick >= 3200 {
                swing = swing.max(x.abs());
            }
        }
        assert!(force.is_finite());
        Outcome { swing, created, controller, largest_damping_force: largest }
    }

    #[test]
    fn a_late_spring_swings_for_ever_without_the_controller_and_settles_with_it() {
        let seed = 81;
        let mut rng = StdRng::seed_from_u64(seed);
        for case in 0..60 {
            let mut port = Port {
                mass: rng.random_range(0.05..0.2),
                viscous: rng.random_range(0.05..0.3),
                stiffness: rng.random_range(150.0..400.0),
                delay: rng.random_range(3..=6),
                step: [0.0, 1e-5, 3e-5][case % 3],
                limit: 2.0,
            };
            // Late by t, a spring K acts as a damping of −K t.
            let late = port.stiffness * (port.delay as f64 + 0.5) * 1e-3;
            port.viscous = port.viscous.min(0.3 * late);
            let without = run(&port, 0.0);
            assert!(without.swing > 4e-3, "seed {seed}, case {case}: swings by {} m", without.swing);
            assert!(without.created > 1e-3, "seed {seed}, case {case}: created {} J", without.created);
            assert_eq!((without.controller.dissipated(), without.largest_damping_force), (0.0, 0.0));
            let with = run(&port, 2.0 * late);
            let settled = 2e-4 + 10.0 * port.step;
            assert!(with.swing < settled, "seed {seed}, case {case}: swings by {} m", with.swing);
            assert!(with.controller.dissipated() > 0.0, "seed {seed}, case {case}");
        }
    }

    #[test]
    fn the_observer_counts_the_work_on_the_handle() {
        let port = Port { mass: 0.1, viscous: 0.1, stiffness: 200.0, delay: 4, step: 0.0, limit: 2.0 };
        let run = run(&port, 0.0);
        let seen = run.controller.energy();
        assert!((seen + run.created).abs() < 1e-9 * run.created, "{seen} of {}", -run.created);
    }

    #[test]
    fn steps_of_the_position_create_nothing_to_the_observer() {
        // Slow to and fro on a spring: in steps, hundreds of them a period; undelayed, so nearly nothing is
        // created.
        let (stiffness, step) = (400.0, 3e-5);
        let mut observer = PassivityObserver::new(step);
        let mut naive = 0.0;
        let mut last = 0.0;
        for tick in 0..20_000 {
            let x: f64 = 3e-3 * (f64::from(tick) * 1e-3).sin();
            let reading = (x / step).round() * step;
            naive -= observer.held().x * (reading - last);
            observer.observe(DVec3::X * (reading - last));
            observer.hold(DVec3::X * (-stiffness * reading));
            last = reading;
        }
        let stored = 0.5 * stiffness * last * last;
        assert!((observer.energy() - stored).abs() < 1e-9, "{} J of {stored}", observer.energy());
        assert!(naive < stored - 1e-4, "the plain sum misses by {} J", naive - stored);
    }

    #[test]
    fn a_passive_spring_is_left_alone_and_old_dissipation_is_no_credit() {
        let step = 1e-4;
        let mut controller = PassivityController::new((5.0, 0.1), (0.0, 0.0));
        let mut last = 0.0;
        // Pressed in against 300 N/m and friction, then let out slowly without the friction.
        for tick in 0..2000 {
            let x: f64 = if tick < 1000 { f64::from(tick) * 1e-5 } else { f64::from(2000 - tick) * 1e-5 };
            controller.observe(&along(x - last), 0.5 * 300.0 * x * x + 300.0 * 1e-5 * x);
            let damping = controller.damping(&along((x - last) / 1e-3), 1e-3);
            assert_eq!(damping, Wrench::ZERO, "tick {tick}");
            controller.hold(&pushing(-300.0 * x - if tick < 1000 { 1.0 } else { 0.0 }));
            last = x;
        }
        assert!(controller.energy() > 5e-3, "{}", controller.energy());
        // At rest nothing is stored: a force that drives the hand from here creates, whatever was dissipated
        // before.
        controller.observe(&Twist::ZERO, 0.0);
        controller.hold(&pushing(1.0));
        controller.observe(&along(step), 0.0);
        let damping = controller.damping(&along(0.1), 1e-3).force;
        assert!((damping.x + 0.5).abs() < 1e-9, "the most that it may: {damping}");
    }

    #[test]
    fn energy_put_in_by_moving_may_come_out_by_turning() {
        let mut controller = PassivityController::new((5.0, 0.1), (0.0, 0.0));
        controller.hold(&Wrench::new(DVec3::X * -1.0, DVec3::Z));
        controller.observe(&along(1e-2), 1e-2);
        let turn = Twist::new(DVec3::ZERO, DVec3::Z * 9e-3);
        controller.observe(&turn, 1e-3);
        assert_eq!(controller.damping(&turn, 1e-3), Wrench::ZERO);
        assert!((controller.observers().1.energy() + 9e-3).abs() < 1e-15);
        // But no more than that.
        controller.observe(&turn, 0.0);
        let damping = controller.damping(&turn, 1e-3);
        assert!(damping.torque.z < 0.0 && damping.force == DVec3::ZERO, "{damping:?}");
    }

    #[test]
    fn nonsense_is_not_counted() {
        let mut controller = PassivityController::new((f64::INFINITY, f64::NAN), (1e-5, 1e-4));
        controller.hold(&pushing(1.0));
        controller.observe(&Twist::new(DVec3::NAN, DVec3::NAN), f64::NAN);
        controller.observe(&Twist::new(DVec3::splat(f64::INFINITY), DVec3::ZERO), 1.0);
        controller.hold(&Wrench::new(DVec3::NAN, DVec3::NAN));
        controller.observe(&along(1e-3), 1.0);
        assert_eq!(controller.damping(&Twist::new(DVec3::NAN, DVec3::NAN), 1e-3), Wrench::ZERO);
        assert!(controller.energy().is_finite() && controller.dissipated() == 0.0);
    }
}
