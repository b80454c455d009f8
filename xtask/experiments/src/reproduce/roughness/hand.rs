//! The motion of a hand that drags a probe over a texture (Eq. 4.14).

use super::depth::Profile;

/// Mass, spring and damper of the hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hand {
    /// m_h, kg.
    pub mass: f64,
    /// k_h, N/m.
    pub stiffness: f64,
    /// b_h, N·s/m.
    pub damping: f64,
}

impl Hand {
    /// The hand that verdicts are about. The dissertation gives no values, only the structure (after Hasser and Cutkosky
    /// 2002); ours are chosen from [`Self::RANGES`]. A weakly damped, stiff hand resonates within the sweep, where ridges
    /// are met at its natural frequency, and its maximum is there.
    pub const REFERENCE: Self = Self { mass: 0.1, stiffness: 600.0, damping: 10.0 };

    /// What a hand that holds a stylus may have, least and most: kg, N/m, N·s/m. Ours, too.
    pub const RANGES: [[f64; 2]; 3] = [[0.1, 0.2], [200.0, 1000.0], [2.0, 10.0]];

    /// The hands at the corners of the ranges.
    pub fn corners() -> [Self; 8] {
        let [masses, stiffness, damping] = Self::RANGES;
        std::array::from_fn(|corner| Self {
            mass: masses[corner & 1],
            stiffness: stiffness[corner >> 1 & 1],
            damping: damping[corner >> 2],
        })
    }
}

/// How a probe is moved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stroke {
    /// Force that presses it on the plate, F_n, N: positive.
    pub force: f64,
    /// v, m/s.
    pub speed: f64,
}

/// A motion that repeats itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vibration {
    /// The largest magnitude of d²u/dt², m/s².
    pub acceleration: f64,
    /// Whether each period of the texture is like the one before.
    pub periodic: bool,
}

/// The longest step, s, and the least number of steps in a period.
const STEP: f64 = 2e-5;
const STEPS: f64 = 500.0;
/// Periods that are looked at, and how many times the time constant 2 m/b passes before.
const LAST: usize = 8;
const SETTLING: f64 = 8.0;
/// The most periods to wait for a motion to become periodic.
const MOST: usize = 400;
/// Change from period to period, as a part of the spacing and the speed, at which a motion counts as periodic.
const REPEATS: f64 = 1e-4;

/// Simulates Eq. 4.14 until the motion is periodic, and finds its largest acceleration.
///
/// The texture's force on the probe is −∇U with U = ½ k δ², that is −k δ dδ/du (Eq. 4.12). With the applied force F_n =
/// k δ taken as positive, F_u of Eq. 4.13 is its opposite, and Eq. 4.14 subtracts it: the probe is drawn to where it lies
/// deepest in the texture. (Eq. 4.11's negative F_n would drive it onto the ridges.)
pub fn vibration(hand: &Hand, stroke: &Stroke, profile: &Profile) -> Vibration {
    let period = profile.spacing / stroke.speed;
    let steps = (period / STEP).ceil().max(STEPS);
    let settling = (SETTLING * 2.0 * hand.mass / hand.damping / period).ceil() as usize;
    let mut motion = Motion { hand, stroke, profile, lag: 0.0, speed: stroke.speed };
    let mut last = Vec::new();
    for index in 0..MOST.max(settling + LAST) {
        let before = (motion.lag, motion.speed);
        let most = motion.run(period, steps as usize);
        let changed = ((motion.lag - before.0) / profile.spacing).abs()
            + ((motion.speed - before.1) / stroke.speed).abs();
        last.push((most, changed < REPEATS));
        let periodic = last.iter().rev().take(LAST).all(|(_, repeats)| *repeats);
        if periodic && index >= settling + LAST {
            break;
        }
    }
    let last = last.iter().rev().take(LAST);
    Vibration {
        acceleration: last.clone().fold(0.0, |most: f64, (acceleration, _)| most.max(*acceleration)),
        periodic: last.clone().all(|(_, repeats)| *repeats),
    }
}

/// The state at the beginning of a period.
struct Motion<'a> {
    hand: &'a Hand,
    stroke: &'a Stroke,
    profile: &'a Profile,
    /// u − v t, m.
    lag: f64,
    /// du/dt, m/s.
    speed: f64,
}

impl Motion<'_> {
    /// d²u/dt² at a time since the period's beginning.
    fn acceleration(&self, time: f64, lag: f64, speed: f64) -> f64 {
        let Hand { mass, stiffness, damping } = self.hand;
        let place = lag + self.stroke.speed * time;
        let texture = self.stroke.force * self.profile.gradient(place);
        (-stiffness * lag + damping * (self.stroke.speed - speed) - texture) / mass
    }

    /// Goes on by one period with RK4; the largest acceleration on the way.
    fn run(&mut self, period: f64, steps: usize) -> f64 {
        let step = period / steps as f64;
        let mut most = 0.0_f64;
        for index in 0..steps {
            let time = index as f64 * step;
            // The lag's rate is du/dt − v.
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
