//! Joysticks and wheels with force feedback: HID's physical interface devices (PID).
//!
//! One constant-force effect is kept for each driven axis, up to two, and its magnitude follows the wrench.
//! An effect ends by itself 50 ms after its last start ("Duration" of "Set Effect"), or after the next longer
//! time that the device knows, and is started anew every 20 ms: so no force stays if the host is killed.
//! Starting an effect that is playing restarts its duration. On a device that does not do so, as in early
//! releases of OpenFFBoard, the force drops for up to 20 ms whenever the effect has ended. No device states
//! the force of its largest magnitude: [`PEAK_FORCE`] is assumed. x is to the right, y away from the user
//! (HID's points at the user). Read from the standard and from OpenFFBoard's sources; not tried with a unit
//! here, the sign of the force included.

mod layout;

use std::time::Duration;

use glam::DVec3;
use palpate_core::{Pose, Twist, Wrench};

use self::layout::{AXES, EFFECT_DURATION, Form, Layout};
use super::LONGEST_HID_REPORT;
use crate::link::{
    Codec, LONGEST_REPORT, Link, Malformed, Motion, REST_SILENCE, Report, Transport, TransportError,
};
use crate::velocity::AdaptiveWindow;
use crate::{Axes, Specification};

/// Force assumed for the largest magnitude, N.
pub const PEAK_FORCE: f64 = 3.0;
/// Displacement of the handle at an axis' end, m.
const TRAVEL: f64 = 0.05;
/// Signs of the handle's x and y along HID's axes.
const SIGNS: [f64; AXES] = [1.0, -1.0];
/// Value of "Trigger Button" for an effect that no button triggers.
const NO_TRIGGER: i32 = 0xff;
/// Period in which each effect's magnitude is repeated and the effect started anew, in turns, s. It has to be
/// well below [`EFFECT_DURATION`], so that neither a lost report nor a late round lets a force end.
const RENEWAL_PERIOD: f64 = 0.02;

/// The error for a device whose report descriptor is not that of a force feedback device with constant
/// forces.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("no force feedback device ({0})")]
pub struct NotPid(String);

/// State of the handle as the reports give it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stick {
    /// Position along each axis, −1 to 1.
    pub axes: [f32; AXES],
    /// Buttons held down, the first in bit 0.
    pub buttons: u32,
}

/// Decoder and encoder of the device's reports.
#[derive(Clone, Debug)]
pub struct PidCodec {
    layout: Layout,
    /// Index of each axis' effect, once it is loaded, and the magnitude set last.
    effects: [Option<(i32, i32)>; AXES],
    /// Pump's time, and the time at which the next turn is due, s.
    now: f64,
    due: f64,
    /// Index of the next turn in [`RENEWALS`].
    turn: usize,
}

/// Repeated reports, an axis' magnitude first: an effect must not start with a magnitude that was withdrawn.
const RENEWALS: [(usize, Renewal); 2 * AXES] =
    [(0, Renewal::Magnitude), (0, Renewal::Start), (1, Renewal::Magnitude), (1, Renewal::Start)];

/// A repeated report.
#[derive(Clone, Copy, Debug)]
enum Renewal {
    Magnitude,
    Start,
}

impl PidCodec {
    /// A codec for the device with this report descriptor.
    ///
    /// # Errors
    /// If the device is not a force feedback device with constant forces.
    pub fn new(descriptor: &[u8]) -> Result<Self, NotPid> {
        let layout = Layout::parse(descriptor).map_err(NotPid)?;
        Ok(Self { layout, effects: [None; AXES], now: 0.0, due: 0.0, turn: 0 })
    }

    /// Axes that are sensed, and axes that are driven.
    fn axes(&self) -> [[bool; AXES]; 2] {
        [self.layout.axes.map(|axis| axis.is_some()), self.layout.enabled.map(|axis| axis.is_some())]
    }

    /// Creates an axis' effect on the device and starts it with magnitude 0.
    fn load(&mut self, axis: usize, transport: &mut dyn Transport) -> Result<(), TransportError> {
        let layout = &self.layout;
        let mut create = blank(layout.create);
        layout.create_constant.put(&mut create);
        transport.set_feature(&create[..layout.create.length])?;
        let mut loaded = [0; LONGEST_REPORT];
        loaded[0] = layout.load.number;
        let length = transport.get_feature(&mut loaded)?;
        let loaded = &loaded[..length.min(LONGEST_REPORT)];
        let success = layout.load_success.slot.get(loaded) == Some(layout.load_success.value);
        let index = layout.load_index.get(loaded).filter(|_| success).ok_or(TransportError::Failed)?;

        let mut effect = blank(layout.effect);
        layout.effect_index.put(&mut effect, index);
        if let Some(constant) = &layout.effect_constant {
            constant.put(&mut effect);
        }
        // Full gain, no trigger button.
        layout.duration.put(&mut effect, EFFECT_DURATION);
        if let Some(gain) = &layout.gain {
            gain.put(&mut effect, gain.maximum);
        }
        if let Some(trigger) = &layout.trigger {
            trigger.put(&mut effect, NO_TRIGGER);
        }
        if let Some(enabled) = &layout.enabled[axis] {
            enabled.put(&mut effect, 1);
        }
        transport.write(&effect[..layout.effect.length])?;
        transport.write(self.magnitude(index, 0).bytes())?;
        transport.write(self.operation(index).bytes())?;
        self.effects[axis] = Some((index, 0));
        Ok(())
    }

    /// The report that starts an effect once.
    fn operation(&self, index: i32) -> Report {
        let layout = &self.layout;
        let mut operation = blank(layout.operation);
        layout.operation_index.put(&mut operation, index);
        layout.start.put(&mut operation);
        if let Some(loops) = &layout.loops {
            loops.put(&mut operation, 1);
        }
        Report::new(&operation, layout.operation.length)
    }

    /// Time from one turn to the next, s.
    fn turn_time(&self) -> f64 {
        RENEWAL_PERIOD / (2 * self.effects.iter().flatten().count()) as f64
    }

    /// The report that is due to be repeated, if any.
    fn renewal(&mut self) -> Option<Report> {
        if self.effects == [None; AXES] || self.now < self.due {
            return None;
        }
        // Missed turns are made up for, one a round.
        self.due = (self.due + self.turn_time()).max(self.now - RENEWAL_PERIOD);
        loop {
            let (axis, what) = RENEWALS[self.turn];
            self.turn = (self.turn + 1) % RENEWALS.len();
            if let Some((index, magnitude)) = self.effects[axis] {
                return Some(match what {
                    Renewal::Magnitude => self.magnitude(index, magnitude),
                    Renewal::Start => self.operation(index),
                });
            }
        }
    }

    /// The report that sets an effect's magnitude.
    fn magnitude(&self, index: i32, magnitude: i32) -> Report {
        let mut report = blank(self.layout.force);
        self.layout.force_index.put(&mut report, index);
        self.layout.magnitude.put(&mut report, magnitude);
        Report::new(&report, self.layout.force.length)
    }
}

/// A report of zeros with its number.
fn blank(form: Form) -> [u8; LONGEST_HID_REPORT] {
    let mut report = [0; LONGEST_HID_REPORT];
    report[0] = form.number;
    report
}

impl Codec for PidCodec {
    type Sample = Stick;

    fn begin_round(&mut self, now: f64) {
        self.now = now;
    }

    fn decode(&mut self, report: &[u8], sample: &mut Stick) -> Result<(), Malformed> {
        let number = *report.first().ok_or(Malformed)?;
        let mut next = *sample;
        for (axis, place) in self.layout.axes.iter().enumerate() {
            let Some((_, slot)) = place.filter(|(form, _)| *form == number) else { continue };
            let value = f64::from(slot.get(report).ok_or(Malformed)?);
            let (low, high) = (f64::from(slot.minimum), f64::from(slot.maximum));
            next.axes[axis] = (2.0 * (value - low) / (high - low) - 1.0) as f32;
        }
        for (bit, (form, slot)) in self.layout.buttons.iter().enumerate() {
            if *form == number {
                let held = slot.get(report).ok_or(Malformed)? != 0;
                next.buttons = next.buttons & !(1 << bit) | u32::from(held) << bit;
            }
        }
        // Reports about ended effects, and others, are ignored.
        *sample = next;
        Ok(())
    }

    fn encode(&mut self, wrench: &Wrench, _: &Stick, say: &mut dyn FnMut(Report)) {
        let force = [wrench.force.x, wrench.force.y];
        for axis in 0..AXES {
            let Some((index, last)) = self.effects[axis] else { continue };
            let slot = self.layout.magnitude;
            let part = (SIGNS[axis] * force[axis] / PEAK_FORCE).clamp(-1.0, 1.0);
            let largest = f64::from(if part < 0.0 { slot.minimum } else { slot.maximum });
            let magnitude = (part.abs() * largest) as i32;
            if magnitude != last {
                self.effects[axis] = Some((index, magnitude));
                say(self.magnitude(index, magnitude));
            }
        }
        if let Some(renewal) = self.renewal() {
            say(renewal);
        }
    }

    fn start(&mut self, transport: &mut dyn Transport) -> Result<(), TransportError> {
        self.effects = [None; AXES];
        if let Some(control) = self.layout.control {
            for choice in [control.stop, control.enable] {
                let mut report = blank(control.form);
                choice.put(&mut report);
                transport.write(&report[..control.form.length])?;
            }
        }
        if let Some((form, gain)) = self.layout.device_gain {
            let mut report = blank(form);
            gain.put(&mut report, gain.maximum);
            transport.write(&report[..form.length])?;
        }
        let driven = self.axes()[1];
        (0..AXES).filter(|axis| driven[*axis]).try_for_each(|axis| self.load(axis, transport))?;
        self.due = self.now + self.turn_time();
        Ok(())
    }

    fn stop(&mut self, transport: &mut dyn Transport) -> Result<(), TransportError> {
        let Some(control) = self.layout.control else { return Ok(()) };
        let mut report = blank(control.form);
        control.stop.put(&mut report);
        transport.write(&report[..control.form.length])
    }
}

/// Motion of the handle from its axes.
#[derive(Clone, Debug)]
pub struct StickMotion {
    velocity: AdaptiveWindow,
    place: DVec3,
    twist: Twist,
    /// Time of the last report, s.
    heard: f64,
}

impl Motion for StickMotion {
    type Sample = Stick;

    fn advance(&mut self, sample: &Stick, came: Option<f64>, now: f64) -> (Pose, Twist, u32) {
        if let Some(time) = came {
            let [x, y] = sample.axes.map(f64::from);
            self.place = DVec3::new(SIGNS[0] * x, SIGNS[1] * y, 0.0) * TRAVEL;
            self.twist = Twist::new(self.velocity.push(time, self.place), DVec3::ZERO);
            self.heard = time;
        } else if now - self.heard > REST_SILENCE {
            self.twist = Twist::ZERO;
        }
        (Pose::from_translation(self.place), self.twist, sample.buttons)
    }

    fn restart(&mut self) {
        self.velocity.clear();
    }
}

impl Link<PidCodec, StickMotion> {
    /// Link for a joystick with force feedback with this name.
    pub fn pid(name: &str, codec: PidCodec) -> Self {
        let steps = codec
            .layout
            .axes
            .iter()
            .flatten()
            .map(|(_, slot)| 2.0 * TRAVEL / (f64::from(slot.maximum) - f64::from(slot.minimum)));
        let step = steps.fold(0.0, f64::max);
        let [sensed, driven] =
            codec.axes().map(|[x, y]| Axes { translation: [x, y, false], rotation: [false; 3] });
        let specification = Specification {
            name: name.to_owned(),
            peak_force: PEAK_FORCE,
            continuous_force: PEAK_FORCE,
            peak_torque: 0.0,
            continuous_torque: 0.0,
            stiffness: 300.0,
            angular_stiffness: 0.0,
            damping: 1.0,
            angular_damping: 0.0,
            // Radius to the corners.
            workspace_radius: 1.5 * TRAVEL,
            encoder_step: step,
            angular_encoder_step: 0.0,
            velocity_delay: 4e-3,
            // A round of the pump, which waits at most 1 ms for a report, and a 1 ms frame of the bus.
            delay: 2e-3,
            sensed,
            actuated: driven,
            handle: None,
        };
        Link {
            motion: StickMotion {
                velocity: AdaptiveWindow::new(step),
                place: DVec3::ZERO,
                twist: Twist::ZERO,
                heard: f64::NEG_INFINITY,
            },
            codec,
            specification,
            read_timeout: Duration::from_millis(1),
            silence: f64::INFINITY,
        }
    }
}
