//! Thermal model of a device's actuators, and the limit that it sets to the wrench.

/// Thermal model of actuators: share of the temperature rise of the windings over the housing, and of the
/// housing over the room, each with its time constant, s. Typical of the small brushed motors of haptic
/// devices by their makers' data sheets, not measured on one device.
pub const ACTUATOR_HEATING: [(f64, f64); 2] = [(0.2, 15.0), (0.8, 600.0)];

/// Warmth above which the actuators get less than the peak. The limit falls to the continuous load at warmth
/// 1; with a higher threshold it falls faster, which a hand feels.
const DERATING_START: f64 = 0.5;

/// Estimated temperature rise of actuators over the room: 0 when cold, 1 for the steady state at the
/// continuous load.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Warmth([f64; 2]);

impl Warmth {
    pub const COLD: Self = Self([0.0; 2]);

    /// Advances by a time under a load, in continuous loads: τ ẇ = share load² − w for windings and housing.
    pub fn pass(&mut self, load: f64, time: &HeatingTime) {
        for ((warmth, (share, _)), approach) in self.0.iter_mut().zip(ACTUATOR_HEATING).zip(time.0) {
            *warmth += (share * load * load - *warmth) * approach;
        }
    }

    pub fn total(&self) -> f64 {
        self.0[0] + self.0[1]
    }
}

/// A time in which actuators warm up or cool down: the shares of their ways to the steady state, of windings
/// and housing. They are the same for all actuators, and take long to compute.
#[derive(Clone, Copy, Debug)]
pub(crate) struct HeatingTime([f64; 2]);

impl HeatingTime {
    pub fn new(seconds: f64) -> Self {
        Self(ACTUATOR_HEATING.map(|(_, time)| -(-seconds / time).exp_m1()))
    }
}

/// Limit of actuators by their warmth.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Heat {
    /// Continuous load, N or N·m.
    continuous: f64,
    peak: f64,
    warmth: Warmth,
}

impl Heat {
    pub fn new(continuous: f64, peak: f64) -> Self {
        Self { continuous, peak, warmth: Warmth::COLD }
    }

    /// Largest load allowed now, N or N·m.
    pub fn allowed(&self) -> f64 {
        if !is_limited(self.continuous, self.peak) {
            return self.peak;
        }
        let room = ((1.0 - self.warmth.total()) / (1.0 - DERATING_START)).clamp(0.0, 1.0);
        self.continuous + (self.peak - self.continuous) * room
    }

    /// Whether the actuators get less than the peak.
    pub fn is_hot(&self) -> bool {
        self.warmth.total() > DERATING_START
    }

    /// Advances by a time with a load `held`, N or N·m.
    pub fn pass(&mut self, held: f64, time: &HeatingTime) {
        if is_limited(self.continuous, self.peak) {
            self.warmth.pass(held / self.continuous, time);
        }
    }
}

/// Whether the continuous load (N, N·m) is known and less than the peak. A driver that does not know it
/// reports 0.
pub(crate) fn is_limited(continuous: f64, peak: f64) -> bool {
    continuous > 0.0 && continuous < peak && peak.is_finite()
}
