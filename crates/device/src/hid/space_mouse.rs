//! The SpaceMouse family of 3Dconnexion: a cap that is pushed and turned in six degrees of freedom, without
//! force.
//!
//! It reports how far the cap is deflected, up to ±350 along and about each axis, for as long as it is
//! deflected. A deflection is taken as a velocity, and the handle's pose is its integral, inside a ball
//! ([`Specification::workspace_radius`]).
//!
//! Two report layouts are known: `01 X Y Z` and `02 Rx Ry Rz` in turn, and both in one `01 X Y Z Rx Ry Rz`,
//! in numbers of 16 bits; `03` and a mask are the buttons, `17` the battery. The device's x is to the right,
//! y towards the user and z down; those of the handle are to the right, away from the user and up. Known from
//! spacenavd, PySpaceMouse and others; not tried with a unit here.

use std::time::Duration;

use glam::{DQuat, DVec3};
use palpate_core::{Pose, Twist, Wrench};

use crate::link::{Codec, Link, Malformed, Motion, Report, Transport, TransportError};
use crate::{Axes, Specification};

/// Deflection of a cap at its stop, counts.
const FULL_DEFLECTION: f64 = 350.0;
/// Dead zone: largest deflection that a cap at rest may report, counts.
const DEAD_ZONE: f64 = 7.0;
/// Linear and angular velocity at full deflection, m/s and rad/s.
const SPEED: f64 = 0.1;
const ANGULAR_SPEED: f64 = 1.0;
/// Radius of the workspace, m.
const WORKSPACE_RADIUS: f64 = 0.1;
/// Time after which a deflection that is not repeated counts as ended, s. A deflected cap sends every 8 to 16
/// ms.
const REPEAT_TIMEOUT: f64 = 0.15;

/// Known vendor and product numbers.
pub(super) const KNOWN: [(u16, u16, &str); 15] = [
    (0x046d, 0xc626, "SpaceNavigator"),
    (0x046d, 0xc627, "SpaceExplorer"),
    (0x046d, 0xc628, "SpaceNavigator for Notebooks"),
    (0x046d, 0xc629, "SpacePilot Pro"),
    (0x046d, 0xc62b, "SpaceMouse Pro"),
    (0x256f, 0xc62e, "SpaceMouse Wireless (cable)"),
    (0x256f, 0xc62f, "SpaceMouse Wireless"),
    (0x256f, 0xc631, "SpaceMouse Pro Wireless (cable)"),
    (0x256f, 0xc632, "SpaceMouse Pro Wireless"),
    (0x256f, 0xc633, "SpaceMouse Enterprise"),
    (0x256f, 0xc635, "SpaceMouse Compact"),
    (0x256f, 0xc636, "SpaceMouse Module"),
    (0x256f, 0xc638, "SpaceMouse Pro Wireless (Bluetooth)"),
    (0x256f, 0xc63a, "SpaceMouse Wireless (Bluetooth)"),
    (0x256f, 0xc652, "3Dconnexion Universal Receiver"),
];

/// State of the cap as its reports give it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Deflection {
    /// Deflection along the device's x, y and z, up to ±350.
    pub translation: [i16; 3],
    /// Deflection about the same axes.
    pub rotation: [i16; 3],
    /// Buttons held down, the first in bit 0.
    pub buttons: u32,
    /// Battery charge, %.
    pub battery: Option<u8>,
}

/// Decoder of the cap's reports.
#[derive(Clone, Copy, Debug, Default)]
pub struct SpaceMouseCodec;

impl Codec for SpaceMouseCodec {
    type Sample = Deflection;

    fn decode(&mut self, report: &[u8], sample: &mut Deflection) -> Result<(), Malformed> {
        let axes = |bytes: &[u8]| -> Option<[i16; 3]> {
            let (words, _) = bytes.as_chunks::<2>();
            let [x, y, z, ..] = *words else { return None };
            Some([x, y, z].map(i16::from_le_bytes))
        };
        match report {
            [1, all @ ..] if all.len() >= 12 => {
                sample.translation = axes(all).ok_or(Malformed)?;
                sample.rotation = axes(&all[6..]).ok_or(Malformed)?;
            }
            [1, shift @ ..] => sample.translation = axes(shift).ok_or(Malformed)?,
            [2, turn @ ..] => sample.rotation = axes(turn).ok_or(Malformed)?,
            [3, mask @ ..] if !mask.is_empty() => {
                let mut bytes = [0; 4];
                bytes.iter_mut().zip(mask).for_each(|(to, from)| *to = *from);
                sample.buttons = u32::from_le_bytes(bytes);
            }
            [0x17, percent, ..] => sample.battery = Some(*percent),
            _ => return Err(Malformed),
        }
        Ok(())
    }

    fn encode(&mut self, _: &Wrench, _: &Deflection, _: &mut dyn FnMut(Report)) {}

    /// Switches its light on. Not every cap has one.
    fn start(&mut self, transport: &mut dyn Transport) -> Result<(), TransportError> {
        set_light(transport, 1)
    }

    fn stop(&mut self, transport: &mut dyn Transport) -> Result<(), TransportError> {
        set_light(transport, 0)
    }
}

fn set_light(transport: &mut dyn Transport, light: u8) -> Result<(), TransportError> {
    match transport.write(&[4, light]) {
        Err(TransportError::Failed) => Ok(()),
        result => result,
    }
}

/// Integrates deflections to a pose.
#[derive(Clone, Debug)]
pub struct RateControl {
    pose: Pose,
    /// Driver's times of the last step and of the last report, s.
    now: f64,
    heard: f64,
}

impl Default for RateControl {
    fn default() -> Self {
        Self { pose: Pose::IDENTITY, now: 0.0, heard: f64::NEG_INFINITY }
    }
}

impl RateControl {
    /// Velocities for a deflection, in the handle's axes.
    fn rate(sample: &Deflection) -> Twist {
        let part = |[x, y, z]: [i16; 3]| {
            let part = |axis: i16| {
                let beyond = (f64::from(axis).abs() - DEAD_ZONE).max(0.0) / (FULL_DEFLECTION - DEAD_ZONE);
                beyond.min(1.0).copysign(f64::from(axis))
            };
            DVec3::new(part(x), -part(y), -part(z))
        };
        Twist::new(part(sample.translation) * SPEED, part(sample.rotation) * ANGULAR_SPEED)
    }
}

impl Motion for RateControl {
    type Sample = Deflection;

    fn advance(&mut self, sample: &Deflection, came: Option<f64>, now: f64) -> (Pose, Twist, u32) {
        self.heard = came.unwrap_or(self.heard);
        let time = now - std::mem::replace(&mut self.now, now);
        let rate = if now - self.heard > REPEAT_TIMEOUT { Twist::ZERO } else { Self::rate(sample) };
        let before = self.pose.translation;
        let turn = DQuat::from_scaled_axis(rate.angular * time);
        self.pose = Pose {
            translation: (before + rate.linear * time).clamp_length_max(WORKSPACE_RADIUS * (1.0 - 1e-9)),
            rotation: (turn * self.pose.rotation).normalize(),
        };
        // The pose stops at the border of the workspace.
        let linear = if time > 0.0 { (self.pose.translation - before) / time } else { DVec3::ZERO };
        (self.pose, Twist::new(linear, rate.angular), sample.buttons)
    }

    fn restart(&mut self) {
        self.heard = f64::NEG_INFINITY;
    }
}

impl Link<SpaceMouseCodec, RateControl> {
    /// Link for a cap with this name.
    pub fn space_mouse(name: &str) -> Self {
        let specification = Specification {
            name: name.to_owned(),
            peak_force: 0.0,
            continuous_force: 0.0,
            peak_torque: 0.0,
            continuous_torque: 0.0,
            stiffness: 0.0,
            angular_stiffness: 0.0,
            damping: 0.0,
            angular_damping: 0.0,
            workspace_radius: WORKSPACE_RADIUS,
            encoder_step: 0.0,
            angular_encoder_step: 0.0,
            velocity_delay: 0.0,
            // Without force there is no wrench to be delayed.
            delay: 0.0,
            sensed: Axes::ALL,
            actuated: Axes::NONE,
            handle: None,
        };
        Link {
            codec: SpaceMouseCodec,
            motion: RateControl::default(),
            specification,
            read_timeout: Duration::from_millis(10),
            silence: f64::INFINITY,
        }
    }
}
