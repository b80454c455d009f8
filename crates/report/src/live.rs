//! Live view of a running session from its records, for terminals and windows.

use std::collections::VecDeque;

use palpate::device::Specification;
use palpate::{Record, Wrench};

/// Time over which rates are counted, s.
const RATE_WINDOW: f64 = 0.5;
/// Length of a column of the history, s.
pub const COLUMN: f64 = 0.05;
/// Number of columns of the history.
const COLUMNS: usize = 200;

/// Rates over the last half second.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rates {
    /// Haptic rate, Hz.
    pub haptic: f64,
    /// Number of periods without a step, per second.
    pub missed: f64,
    /// Rate at which new contact models came into use, Hz.
    pub contact: f64,
}

/// Largest force and depth in some time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Extremes {
    /// Largest force, N.
    pub force: f64,
    /// Largest penetration depth, m.
    pub depth: f64,
}

/// Live view of a running session.
#[derive(Clone, Debug)]
pub struct Live {
    /// Name of the device.
    pub device: String,
    /// Peak force (N) and torque (N·m) of the device, or a default scale if it has none.
    pub peak: (f64, f64),
    /// Record of the last step.
    pub latest: Option<Record>,
    /// Rates over the last half second.
    pub rates: Rates,
    /// Columns of [`COLUMN`] seconds over the last ten, the oldest first.
    pub history: VecDeque<Extremes>,
    /// Extremes of the whole session.
    pub most: Extremes,
    period: f64,
    /// Time at which the current count began (s), and the counts since.
    counted: (f64, Rates),
    column: (f64, Extremes),
}

impl Live {
    /// Creates a view for a device with a haptic period (s).
    pub fn new(specification: &Specification, period: f64) -> Self {
        let full = |peak: f64, otherwise: f64| if peak > 0.0 && peak.is_finite() { peak } else { otherwise };
        Self {
            device: specification.name.clone(),
            peak: (full(specification.peak_force, 10.0), full(specification.peak_torque, 1.0)),
            latest: None,
            rates: Rates::default(),
            history: VecDeque::with_capacity(COLUMNS + 1),
            most: Extremes::default(),
            period,
            counted: (0.0, Rates::default()),
            column: (0.0, Extremes::default()),
        }
    }

    /// Adds a step.
    pub fn take(&mut self, record: &Record) {
        let earlier = self.latest.replace(*record);
        let since = record.time - earlier.map_or(0.0, |earlier| earlier.time);
        let model_time = |record: &Record| record.time - record.model_age;
        let news = earlier.is_none_or(|earlier| {
            let (before, now) = (model_time(&earlier), model_time(record));
            (before - now).abs() > 1e-9 || before.is_nan() != now.is_nan()
        });

        let (begun, counted) = &mut self.counted;
        counted.haptic += 1.0;
        counted.missed += (since / self.period - 1.0).round().max(0.0);
        counted.contact += f64::from(u8::from(news && record.model_age.is_finite()));
        let elapsed = record.time - *begun;
        if elapsed >= RATE_WINDOW - 1e-9 {
            let Rates { haptic, missed, contact } = std::mem::take(counted);
            self.rates =
                Rates { haptic: haptic / elapsed, missed: missed / elapsed, contact: contact / elapsed };
            *begun = record.time;
        }

        let now = Extremes { force: record.coupling.force.length(), depth: record.depth };
        let (begun, column) = &mut self.column;
        for extremes in [column, &mut self.most] {
            extremes.force = extremes.force.max(now.force);
            extremes.depth = extremes.depth.max(now.depth);
        }
        if record.time - *begun >= COLUMN - 1e-9 {
            *begun = record.time;
            self.history.push_back(std::mem::take(&mut self.column.1));
            if self.history.len() > COLUMNS {
                self.history.pop_front();
            }
        }
    }

    /// Returns the latest wrench at the device.
    pub fn wrench(&self) -> Wrench {
        self.latest.map_or(Wrench::ZERO, |record| record.coupling)
    }
}

#[cfg(test)]
mod tests {
    use palpate::Pose;
    use palpate::device::Emulation;
    use palpate::glam::DVec3;

    use super::*;

    fn record(time: f64, force: f64, model_age: f64) -> Record {
        Record {
            time,
            device: Pose::IDENTITY,
            handle: Pose::IDENTITY,
            object: Pose::IDENTITY,
            coupling: Wrench::new(DVec3::Z * force, DVec3::ZERO),
            contact: Wrench::ZERO,
            depth: 1e-3 * force,
            contacts: 3,
            model_age,
        }
    }

    /// Two steps are missing in half a second, and a model comes with every fourth step.
    #[test]
    fn rates_are_counted() {
        let mut live = Live::new(&Emulation::default().specification, 1e-3);
        for step in (1..=1000_u32).filter(|step| step % 500 != 7 && step % 500 != 9) {
            let age = f64::from(step % 4) * 1e-3;
            let force = if step == 300 { 5.0 } else { 1.0 };
            live.take(&record(f64::from(step) * 1e-3, force, age));
        }
        let Rates { haptic, missed, contact } = live.rates;
        assert!((haptic - 996.0).abs() < 1e-6 && (missed - 4.0).abs() < 1e-6, "{haptic} {missed}");
        assert!((contact - 250.0).abs() < 5.0, "{contact}");
        assert_eq!(live.most, Extremes { force: 5.0, depth: 5e-3 });
        assert_eq!(live.history.len(), 20);
        assert_eq!(live.history.iter().filter(|column| column.force == 5.0).count(), 1);
    }

    #[test]
    fn history_is_limited_and_a_device_without_force_has_a_scale() {
        let specification = Specification {
            peak_force: 0.0,
            peak_torque: f64::INFINITY,
            ..Emulation::default().specification
        };
        let mut live = Live::new(&specification, 1e-3);
        assert_eq!(live.peak, (10.0, 1.0));
        for step in 1..=20_000_u32 {
            live.take(&record(f64::from(step) * 1e-3, 1.0, f64::NAN));
        }
        assert_eq!(live.history.len(), COLUMNS);
        assert_eq!(live.rates.contact, 0.0);
    }
}
