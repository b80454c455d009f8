//! The conditions of theory that simulation is held against.

/// What the conditions speak of: a device with a wall. Units of translation, or their equals in rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SampledWall {
    /// Viscous damping of the device, b, N·s/m.
    pub device_damping: f64,
    /// Coulomb friction of the device, f_c, N.
    pub friction: f64,
    /// K, N/m.
    pub stiffness: f64,
    /// B, N·s/m.
    pub damping: f64,
    /// T, s.
    pub period: f64,
    /// t_d, s.
    pub delay: f64,
    /// Δ, m.
    pub quantum: f64,
}

impl SampledWall {
    /// Colgate and Schenkel 1994: b > K T/2 + |B|. For a velocity that is the backward difference of an exact position,
    /// without delay.
    pub fn colgate_schenkel(&self) -> bool {
        self.device_damping > 0.5 * self.stiffness * self.period + self.damping.abs()
    }

    /// Abbott and Okamura 2005: K ≤ min(2 b/T, 2 f_c/Δ). For a spring alone, with a rounded position, without delay.
    pub fn abbott_okamura(&self) -> bool {
        self.diolaiti_with_delay(0.0)
    }

    /// Diolaiti, Niemeyer, Barbagli and Salisbury 2006: viscous damping makes up for the hold and for the delay, b ≥ K (T/2
    /// + t_d), and friction for rounding, f_c ≥ K Δ/2. For a spring alone.
    pub fn diolaiti(&self) -> bool {
        self.diolaiti_with_delay(self.delay)
    }

    fn diolaiti_with_delay(&self, delay: f64) -> bool {
        self.device_damping >= self.stiffness * (0.5 * self.period + delay)
            && self.friction >= 0.5 * self.stiffness * self.quantum
    }
}
