//! How warm a device's actuators are, and what they may be asked for.

/// How actuators warm up: the share of their warmth that windings have over the housing and the housing has over the room, each with
/// its time constant, s. Typical of the small brushed motors of haptic devices, by their makers' data sheets; not of one device.
pub const WARMTH: [(f64, f64); 2] = [(0.2, 15.0), (0.8, 600.0)];

/// From this warmth on the actuators get less than the peak: at 1, what they stand for long.
const WARM: f64 = 0.5;

/// How warm actuators are over the room, by what they were asked for: 0 where they are cold, and 1 where they are as warm as what they
/// can keep up makes them in the end.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Warmth([f64; 2]);

impl Warmth {
    pub const COLD: Self = Self([0.0; 2]);

    /// Passes some seconds under `load` times what can be kept up: τ ẇ = share load² − w for windings and housing.
    pub fn pass(&mut self, load: f64, seconds: f64) {
        for (warmth, (share, time)) in self.0.iter_mut().zip(WARMTH) {
            *warmth += (share * load * load - *warmth) * -(-seconds / time).exp_m1();
        }
    }

    pub fn total(&self) -> f64 {
        self.0[0] + self.0[1]
    }
}

/// What heat lets actuators do.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Heat {
    /// What can be kept up, N or N·m.
    continuous: f64,
    peak: f64,
    warmth: Warmth,
}

impl Heat {
    pub fn new(continuous: f64, peak: f64) -> Self {
        Self { continuous, peak, warmth: Warmth::COLD }
    }

    /// What the actuators may be asked for now, N or N·m.
    pub fn allowed(&self) -> f64 {
        if !is_limited(self.continuous, self.peak) {
            return self.peak;
        }
        let room = ((1.0 - self.warmth.total()) / (1.0 - WARM)).clamp(0.0, 1.0);
        self.continuous + (self.peak - self.continuous) * room
    }

    /// Whether the actuators get less than the peak.
    pub fn is_hot(&self) -> bool {
        self.warmth.total() > WARM
    }

    /// Passes `seconds` of something held, N or N·m.
    pub fn pass(&mut self, held: f64, seconds: f64) {
        if is_limited(self.continuous, self.peak) {
            self.warmth.pass(held / self.continuous, seconds);
        }
    }
}

/// Whether what can be kept up (N, N·m) is known, and less than the peak. A driver that says nothing of it says 0.
pub(crate) fn is_limited(continuous: f64, peak: f64) -> bool {
    continuous > 0.0 && continuous < peak && peak.is_finite()
}
