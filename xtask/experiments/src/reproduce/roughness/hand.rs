//! Motion of a hand that drags a probe over a texture (Eq. 4.14).

use super::depth::Profile;

/// Mass, stiffness and damping of the hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hand {
    /// Mass m_h, kg.
    pub mass: f64,
    /// Stiffness k_h, N/m.
    pub stiffness: f64,
    /// Damping b_h, N·s/m.
    pub damping: f64,
}

impl Hand {
    /// Hand that verdicts are based on. The dissertation gives only the structure (after Hasser and Cutkosky
    /// 2002); the values are ours, from [`Self::RANGES`]. A weakly damped, stiff hand would resonate within
    /// the sweep, where it meets ridges at its natural frequency, and have its maximum there.
    pub const REFERENCE: Self = Self { mass: 0.1, stiffness: 600.0, damping: 10.0 };

    /// Plausible ranges for a hand that holds a stylus: mass (kg), stiffness (N/m), damping (N·s/m). Also
    /// ours.
    pub const RANGES: [[f64; 2]; 3] = [[0.1, 0.2], [200.0, 1000.0], [2.0, 10.0]];

    /// Returns the hands at the corners of the ranges.
    pub fn corners() -> [Self; 8] {
        let [masses, stiffness, damping] = Self::RANGES;
        std::array::from_fn(|corner| Self {
            mass: masses[corner & 1],
            stiffness: stiffness[corner >> 1 & 1],
            damping: damping[corner >> 2],
        })
    }
}

/// Force and speed at which a probe is dragged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stroke {
    /// Normal force F_n on the plate, N: positive.
    pub force: f64,
    /// Speed v, m/s.
    pub speed: f64,
}

/// Periodic motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vibration {
    /// Largest magnitude of d²u/dt², m/s².
    pub acceleration: f64,
    /// Whether each period of the texture repeats the one before.
    pub periodic: bool,
}

/// Largest time step, s, and smallest number of steps in a period.
const STEP: f64 = 2e-5;
const STEPS: f64 = 500.0;
/// Number of periods that are evaluated, and settling time before them, in time constants 2 m/b.
const EVALUATED_PERIODS: usize = 8;
const SETTLING: f64 = 8.0;
/// Largest number of periods to wait for the motion to become periodic.
const MAX_PERIODS: usize = 400;
/// Change from period to period, relative to spacing and speed, below which a motion counts as periodic.
const MAX_PERIODIC_CHANGE: f64 = 1e-4;

/// Simulates Eq. 4.14 until the motion is periodic, and returns its largest acceleration.
///
/// The texture's force on the probe is −∇U with U = ½ k δ², that is −k δ dδ/du (Eq. 4.12). With the applied
/// force F_n = k δ taken as positive, F_u of Eq. 4.13 is its opposite, and Eq. 4.14 subtracts it: the probe
/// is drawn to where it lies deepest in the texture. (A negative F_n as in Eq. 4.11 would drive it onto the
/// ridges.)
pub fn vibration(hand: &Hand, stroke: &Stroke, profile: &Profile) -> Vibration {
    let period = profile.spacing / stroke.speed;
    let steps = (period / STEP).ceil().max(STEPS);
    let settling = (SETTLING * 2.0 * hand.mass / hand.damping / period).ceil() as usize;
    let mut motion = Motion { hand, stroke, profile, lag: 0.0, speed: stroke.speed };
    let mut last = Vec::new();
    for index in 0..MAX_PERIODS.max(settling + EVALUATED_PERIODS) {
        let before = (motion.lag, motion.speed);
        let most = motion.run(period, steps as usize);
        let changed = ((motion.lag - before.0) / profile.spacing).abs()
            + ((motion.speed - before.1) / stroke.speed).abs();
        last.push((most, changed < MAX_PERIODIC_CHANGE));
        let periodic = last.iter().rev().take(EVALUATED_PERIODS).all(|(_, repeats)| *repeats);
        if periodic && index >= settling + EVALUATED_PERIODS {
            break;
        }
    }
    let last = last.iter().rev().take(EVALUATED_PERIODS);
    Vibration {
        acceleration: last.clone().fold(0.0, |most: f64, (acceleration, _)| most.max(*acceleration)),
        periodic: last.clone().all(|(_, repeats)| *repeats),
    }
}

/// State at the beginning of a period.
struct Motion<'a> {
    hand: &'a Hand,
    stroke: &'a Stroke,
    profile: &'a Profile,
    /// Lag u − v t, m.
    lag: f64,
    /// Speed du/dt, m/s.
    speed: f64,
}

impl Motion<'_> {
    /// Returns d²u/dt² at a time since the period's beginning.
    fn acceleration(&self, time: f64, lag: f64, speed: f64) -> f64 {
        let Hand { mass, stiffness, damping } = self.hand;
        let place = lag + self.stroke.speed * time;
        let texture = self.stroke.force * self.profile.gradient(place);
        (-stiffness * lag + damping * (self.stroke.speed - speed) - texture) / mass
    }

    /// Integrates over one period with RK4, and returns the largest acceleration.
    fn run(&mut self, period: f64, steps: usize) -> f64 {
        let step = period / steps as f64;
        let mut most = 0.0_f64;
        for index in 0..steps {
            let time = index as f64 * step;
            // d(lag)/dt = du/dt − v.
            let rate = |time: f64, lag: f64, speed: f64| {
                (speed - self.stroke.speed, self.acceleration(time, lag, speed))
            };
            let (lag, speed, half) = (self.lag, self.speed, 0.5 * step);
            let first = rate(time, lag, speed);
            let second = rate(time + half, lag + half * first.0, speed + half * first.1);
            let third = rate(time + half, lag + half * second.0, speed + half * second.1);
            let fourth = rate(time + step, lag + step * third.0, speed + step * third.1);
            let mean = |a: f64, b: f64, c: f64, d: f64| (a + 2.0 * (b + c) + d) / 6.0;
            self.lag += step * mean(first.0, second.0, third.0, fourth.0);
            self.speed += step * mean(first.1, second.1, third.1, fourth.1);
            most = most.max(first.1.abs());
        }
        most
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    #[test]
    fn small_force_gives_the_response_of_the_linear_system() {
        let spacing = 2e-3;
        let gradients = (0..400).map(|index| (TAU * f64::from(index) / 400.0).sin()).collect();
        let profile = Profile { spacing, depths: vec![0.0; 400], gradients };
        let hand = Hand::REFERENCE;
        for speed in [0.005, 0.02, 0.1] {
            let stroke = Stroke { force: 1e-4, speed };
            let found = vibration(&hand, &stroke, &profile);
            let frequency = TAU * speed / spacing;
            let elastic = hand.stiffness - hand.mass * frequency * frequency;
            let impedance = elastic.hypot(hand.damping * frequency);
            let exact = stroke.force * frequency * frequency / impedance;
            assert!(found.periodic, "{speed} m/s");
            assert!((found.acceleration / exact - 1.0).abs() < 2e-3, "{speed} m/s: {found:?}, not {exact}");
        }
    }
}
