//! WoodenHaptics and its relatives (Forsslund Systems): open hardware with three motors and capstans, some
//! with a sensed wrist.
//!
//! The device sends its encoders' counts and waits for the motors' currents: one report in each direction in
//! turn. Its firmware switches the currents off after half a second of silence. Report layout, kinematics,
//! models and constants are those of the makers' library (haptikfabrikenapi); not tried with a unit here. The
//! kinematics of the later Polhems (`variant` 3) are not public: such a model is refused.
//!
//! Joint angles are θ = ±2π · counts / counts per turn · ∅ capstan / ∅ body. With r = L_b sin θ_b + L_c sin
//! θ_c the handle is at (r cos θ_a, r sin θ_a, L_a + L_b cos θ_b − L_c cos θ_c) from the base, and motor
//! torques follow from forces by the Jacobian's transpose. The axes are the makers': x away from the base, z
//! up.

use std::f64::consts::{FRAC_PI_2, TAU};
use std::path::Path;
use std::time::Duration;

use glam::{DQuat, DVec3};
use palpate_core::{Pose, Twist, Wrench};
use serde::Deserialize;

use crate::link::{Codec, Link, Malformed, Motion, Report};
use crate::velocity::AdaptiveWindow;
use crate::{Axes, DeviceError, Specification};

/// Vendor and product number of the USB board, which other devices use as well.
pub(super) const KNOWN: (u16, u16, &str) = (0x16c0, 0x0486, "WoodenHaptics (or another Teensy)");

/// Size of a report that is read, and of one that is written with its number, bytes.
const READ_BYTES: usize = 14;
const WRITTEN_BYTES: usize = 65;
/// Count of encoder d above which the button is held, and the offset that the button adds to it.
const PRESSED_ABOVE: i16 = 5000;
const PRESS_OFFSET: i16 = 10_000;
/// Info code by which the device asks for its encoders to be set.
const CALIBRATION_REQUEST: i16 = 1;
/// Largest current that the amplifiers sustain, A.
const MAX_CURRENT: f64 = 1.999;
/// Longest wait of a round for a report, after which the device gets a command regardless; and the silence
/// after which it counts as lost, s.
const READ_TIMEOUT: Duration = Duration::from_millis(5);
const SILENCE_TIMEOUT: f64 = 0.01;

/// Construction of a unit, as in the makers' `woodenhaptics.json`, with their names. Lengths in m, for bodies
/// and motors a, b and c; counts per turn for the encoders of the wrist too, 0 if there is none.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[expect(missing_docs, reason = "the makers' names")]
pub struct WoodenHapticsModel {
    pub variant: f64,
    pub diameter_capstan_a: f64,
    pub diameter_capstan_b: f64,
    pub diameter_capstan_c: f64,
    pub length_body_a: f64,
    pub length_body_b: f64,
    pub length_body_c: f64,
    pub diameter_body_a: f64,
    pub diameter_body_b: f64,
    pub diameter_body_c: f64,
    pub workspace_origin_x: f64,
    pub workspace_origin_y: f64,
    pub workspace_origin_z: f64,
    pub workspace_radius: f64,
    pub torque_constant_motor_a: f64,
    pub torque_constant_motor_b: f64,
    pub torque_constant_motor_c: f64,
    pub cpr_encoder_a: f64,
    pub cpr_encoder_b: f64,
    pub cpr_encoder_c: f64,
    #[serde(default)]
    pub cpr_encoder_d: f64,
    #[serde(default)]
    pub cpr_encoder_e: f64,
    #[serde(default)]
    pub cpr_encoder_f: f64,
    pub max_linear_force: f64,
    pub max_linear_stiffness: f64,
    pub max_linear_damping: f64,
    #[serde(default)]
    pub calibrate_enc_a: f64,
    #[serde(default)]
    pub calibrate_enc_b: f64,
    #[serde(default)]
    pub calibrate_enc_c: f64,
    #[serde(default)]
    pub calibrate_enc_d: f64,
    #[serde(default)]
    pub calibrate_enc_e: f64,
    #[serde(default)]
    pub calibrate_enc_f: f64,
    #[serde(default)]
    pub motor_and_body_aligned_a: bool,
    #[serde(default)]
    pub motor_and_body_aligned_b: bool,
    #[serde(default)]
    pub motor_and_body_aligned_c: bool,
    #[serde(default)]
    pub enc_and_body_aligned_d: bool,
    #[serde(default)]
    pub enc_and_body_aligned_e: bool,
    #[serde(default)]
    pub enc_and_body_aligned_f: bool,
}

impl WoodenHapticsModel {
    /// WoodenHaptics of 2015: three encoders.
    pub const WOODEN_HAPTICS: Self = Self {
        variant: 0.0,
        diameter_capstan_a: 0.010,
        diameter_capstan_b: 0.010,
        diameter_capstan_c: 0.010,
        length_body_a: 0.080,
        length_body_b: 0.205,
        length_body_c: 0.245,
        diameter_body_a: 0.160,
        diameter_body_b: 0.120,
        diameter_body_c: 0.120,
        workspace_origin_x: 0.220,
        workspace_origin_y: 0.0,
        workspace_origin_z: 0.080,
        workspace_radius: 0.1,
        torque_constant_motor_a: 0.0259,
        torque_constant_motor_b: 0.0259,
        torque_constant_motor_c: 0.0259,
        cpr_encoder_a: 2000.0,
        cpr_encoder_b: 2000.0,
        cpr_encoder_c: 2000.0,
        cpr_encoder_d: 0.0,
        cpr_encoder_e: 0.0,
        cpr_encoder_f: 0.0,
        max_linear_force: 5.0,
        max_linear_stiffness: 1000.0,
        max_linear_damping: 8.0,
        calibrate_enc_a: 0.0,
        calibrate_enc_b: 0.0,
        calibrate_enc_c: 6000.0,
        calibrate_enc_d: 0.0,
        calibrate_enc_e: 0.0,
        calibrate_enc_f: 0.0,
        motor_and_body_aligned_a: false,
        motor_and_body_aligned_b: false,
        motor_and_body_aligned_c: false,
        enc_and_body_aligned_d: false,
        enc_and_body_aligned_e: false,
        enc_and_body_aligned_f: false,
    };
    /// The first Polhem: six encoders.
    pub const POLHEM: Self = Self {
        variant: 2.0,
        length_body_a: 0.058,
        length_body_b: 0.174,
        length_body_c: 0.133,
        diameter_body_a: 0.180,
        diameter_body_b: 0.100,
        diameter_body_c: 0.100,
        workspace_origin_x: 0.140,
        workspace_origin_z: 0.100,
        torque_constant_motor_a: 0.0538,
        torque_constant_motor_b: 0.0538,
        torque_constant_motor_c: 0.0538,
        cpr_encoder_d: 1024.0,
        cpr_encoder_e: 1024.0,
        cpr_encoder_f: 1024.0,
        max_linear_stiffness: 800.0,
        calibrate_enc_c: -5000.0,
        motor_and_body_aligned_a: true,
        motor_and_body_aligned_b: true,
        motor_and_body_aligned_c: true,
        enc_and_body_aligned_e: true,
        ..Self::WOODEN_HAPTICS
    };
    /// AluHaptics.
    pub const ALU_HAPTICS: Self = Self {
        variant: 1.0,
        diameter_capstan_a: 0.0138,
        diameter_capstan_b: 0.0098,
        diameter_capstan_c: 0.0098,
        length_body_a: 0.111,
        length_body_b: 0.140,
        length_body_c: 0.111,
        diameter_body_a: 0.116,
        diameter_body_b: 0.076,
        diameter_body_c: 0.076,
        workspace_origin_x: 0.140,
        workspace_origin_z: 0.0,
        calibrate_enc_c: 0.0,
        ..Self::WOODEN_HAPTICS
    };

    /// Named models.
    pub const MODELS: [(&'static str, Self); 3] = [
        ("woodenhaptics", Self::WOODEN_HAPTICS),
        ("polhem", Self::POLHEM),
        ("aluhaptics", Self::ALU_HAPTICS),
    ];

    /// The model with this name, or the one described by a `woodenhaptics.json`.
    ///
    /// # Errors
    /// If the file cannot be read or does not describe a usable model.
    pub fn open(name: &str) -> Result<Self, DeviceError> {
        if let Some((_, model)) = Self::MODELS.iter().find(|(known, _)| *known == name) {
            return Ok(*model);
        }
        let refused = |reason: String| DeviceError::Model {
            file: name.into(),
            reason,
            remedy: "give woodenhaptics, polhem, aluhaptics or a woodenhaptics.json",
        };
        let text = std::fs::read_to_string(Path::new(name)).map_err(|error| refused(error.to_string()))?;
        let model: Self = serde_json::from_str(&text).map_err(|error| refused(error.to_string()))?;
        model.check().map_err(refused)?;
        Ok(model)
    }

    fn check(&self) -> Result<(), String> {
        if self.variant == 3.0 {
            return Err("the kinematics of variant 3 (Polhem 2 and 3) are not public".into());
        }
        let [capstans, bodies, constants] =
            [self.capstans(), self.diameters(), self.torque_constants()].map(|values| values.to_array());
        let lengths = [self.length_body_a, self.length_body_b, self.length_body_c, self.workspace_radius];
        let counts = [self.cpr_encoder_a, self.cpr_encoder_b, self.cpr_encoder_c];
        let limits = [self.max_linear_force, self.max_linear_stiffness, self.max_linear_damping];
        let positive = capstans.into_iter().chain(bodies).chain(constants).chain(lengths).chain(counts);
        if let Some(value) = positive.chain(limits).find(|value| !(1e-6..1e6).contains(value)) {
            return Err(format!("{value} is not a length, count, constant or limit (from 1e-6 to 1e6)"));
        }
        let wrist = [self.cpr_encoder_d, self.cpr_encoder_e, self.cpr_encoder_f];
        let origin = self.origin().to_array();
        let free = wrist.into_iter().chain(origin).chain(self.calibration().map(f64::from));
        if let Some(value) = free.into_iter().find(|value| !(-1e6..1e6).contains(value)) {
            return Err(format!("{value} is not a count or position"));
        }
        Ok(())
    }

    fn capstans(&self) -> DVec3 {
        DVec3::new(self.diameter_capstan_a, self.diameter_capstan_b, self.diameter_capstan_c)
    }

    fn diameters(&self) -> DVec3 {
        DVec3::new(self.diameter_body_a, self.diameter_body_b, self.diameter_body_c)
    }

    fn torque_constants(&self) -> DVec3 {
        DVec3::new(self.torque_constant_motor_a, self.torque_constant_motor_b, self.torque_constant_motor_c)
    }

    fn origin(&self) -> DVec3 {
        DVec3::new(self.workspace_origin_x, self.workspace_origin_y, self.workspace_origin_z)
    }

    /// Counts to which the encoders are set when the device asks for it.
    fn calibration(&self) -> [i16; 6] {
        let counts = [
            self.calibrate_enc_a,
            self.calibrate_enc_b,
            self.calibrate_enc_c,
            self.calibrate_enc_d,
            self.calibrate_enc_e,
            self.calibrate_enc_f,
        ];
        counts.map(|count| count as i16)
    }

    /// Joint angle per motor angle, a signed ratio.
    fn gears(&self) -> DVec3 {
        let aligned =
            [self.motor_and_body_aligned_a, self.motor_and_body_aligned_b, self.motor_and_body_aligned_c];
        let signs = DVec3::from_array(aligned.map(|aligned| if aligned { -1.0 } else { 1.0 }));
        signs * self.capstans() / self.diameters()
    }

    /// Joint angles θ_a, θ_b and θ_c, rad.
    fn joints(&self, [a, b, c, ..]: &[i16; 6]) -> DVec3 {
        let counts = DVec3::new((*a).into(), (*b).into(), (*c).into());
        let turns = counts / DVec3::new(self.cpr_encoder_a, self.cpr_encoder_b, self.cpr_encoder_c);
        self.gears() * turns * TAU
    }

    /// Whether the wrist is sensed.
    fn has_wrist(&self) -> bool {
        [self.cpr_encoder_d, self.cpr_encoder_e, self.cpr_encoder_f].iter().all(|counts| *counts != 0.0)
    }

    /// Pose of the handle relative to the middle of the workspace, from the encoders' counts.
    pub fn pose(&self, counts: &[i16; 6]) -> Pose {
        let DVec3 { x: a, y: b, z: c } = self.joints(counts);
        let (long, short) = (self.length_body_b, self.length_body_c);
        let reach = long * b.sin() + short * c.sin();
        let height = self.length_body_a + long * b.cos() - short * c.cos();
        let translation = DVec3::new(reach * a.cos(), reach * a.sin(), height) - self.origin();
        if !self.has_wrist() {
            return Pose::from_translation(translation);
        }
        // The wrist's encoders come in the order f, e, d.
        let [.., f, e, d] = *counts;
        let aligned = [self.enc_and_body_aligned_d, self.enc_and_body_aligned_e, self.enc_and_body_aligned_f];
        let turns = [(f, self.cpr_encoder_d), (e, self.cpr_encoder_e), (d, self.cpr_encoder_f)]
            .map(|(count, turn)| f64::from(count) / turn * TAU);
        let [d, e, f] =
            [0, 1, 2].map(|joint: usize| if aligned[joint] { turns[joint] } else { -turns[joint] });
        let arm = DQuat::from_rotation_z(a) * DQuat::from_rotation_y(FRAC_PI_2 - c);
        let wrist = DQuat::from_rotation_x(d) * DQuat::from_rotation_y(e) * DQuat::from_rotation_x(f);
        Pose::new(translation, (arm * wrist).normalize())
    }

    /// Motor currents, A, for a force on the hand, N, at the encoders' counts. If one exceeds its limit, all
    /// are scaled down together, so that the force keeps its direction.
    pub fn currents(&self, force: DVec3, counts: &[i16; 6]) -> DVec3 {
        let DVec3 { x: a, y: b, z: c } = self.joints(counts);
        let (long, short) = (self.length_body_b, self.length_body_c);
        let reach = long * b.sin() + short * c.sin();
        let outwards = DVec3::new(a.cos(), a.sin(), 0.0);
        // Columns of the Jacobian: the motion of the handle for each joint.
        let columns = [
            reach * DVec3::new(-a.sin(), a.cos(), 0.0),
            long * (b.cos() * outwards - b.sin() * DVec3::Z),
            short * (c.cos() * outwards + c.sin() * DVec3::Z),
        ];
        let torques = DVec3::from_array(columns.map(|column| column.dot(force)));
        let currents = torques * self.gears() / self.torque_constants();
        let largest = currents.abs().max_element();
        if !currents.is_finite() {
            DVec3::ZERO
        } else if largest > MAX_CURRENT {
            currents * (MAX_CURRENT / largest)
        } else {
            currents
        }
    }

    /// Largest motion of the handle for one count of an encoder, m.
    fn step(&self) -> f64 {
        let arms = DVec3::new(self.workspace_origin_x.abs(), self.length_body_b, self.length_body_c);
        let counts = DVec3::new(self.cpr_encoder_a, self.cpr_encoder_b, self.cpr_encoder_c);
        (self.gears().abs() * arms / counts * TAU).max_element()
    }

    fn specification(&self, name: &str) -> Specification {
        let wrist = self.has_wrist();
        Specification {
            name: name.to_owned(),
            peak_force: self.max_linear_force,
            continuous_force: self.max_linear_force,
            peak_torque: 0.0,
            continuous_torque: 0.0,
            stiffness: self.max_linear_stiffness,
            angular_stiffness: 0.0,
            damping: self.max_linear_damping,
            angular_damping: 0.0,
            workspace_radius: self.workspace_radius,
            encoder_step: self.step(),
            angular_encoder_step: if wrist { TAU / self.cpr_encoder_d.abs() } else { 0.0 },
            // Half of the longest window would be 16 ms; in fast motion the window is a few readings.
            velocity_delay: 2e-3,
            // A report in each 1 ms frame of the bus; the currents that answer it go out in the frame after
            // the next report.
            delay: 2e-3,
            sensed: if wrist { Axes::ALL } else { Axes::TRANSLATION },
            actuated: Axes::TRANSLATION,
            handle: None,
        }
    }
}

/// State of the device as its reports give it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Encoders {
    /// Encoder counts, a to f.
    pub counts: [i16; 6],
    /// Whether the button is held.
    pub pressed: bool,
    /// Whether the device asks for its encoders to be set.
    pub lost: bool,
}

/// Decoder and encoder of the device's reports.
#[derive(Clone, Copy, Debug)]
pub struct WoodenHapticsCodec {
    /// Construction of the unit.
    pub model: WoodenHapticsModel,
}

impl Codec for WoodenHapticsCodec {
    type Sample = Encoders;

    fn decode(&mut self, report: &[u8], sample: &mut Encoders) -> Result<(), Malformed> {
        let report = report.get(..READ_BYTES).ok_or(Malformed)?;
        let (words, _) = report.as_chunks::<2>();
        let [a, b, c, d, e, f, info] = *words else { return Err(Malformed) };
        let [a, b, c, d, e, f, info] = [a, b, c, d, e, f, info].map(i16::from_le_bytes);
        let pressed = d > PRESSED_ABOVE;
        let d = if pressed { d - PRESS_OFFSET } else { d };
        *sample = Encoders { counts: [a, b, c, d, e, f], pressed, lost: info == CALIBRATION_REQUEST };
        Ok(())
    }

    fn is_enabled(&self, sample: &Encoders) -> bool {
        !sample.lost
    }

    fn encode(&mut self, wrench: &Wrench, sample: &Encoders, say: &mut dyn FnMut(Report)) {
        let mut words = [0; 7];
        if sample.lost {
            let [a, b, c, d, e, f] = self.model.calibration();
            words = [d, e, f, 1, a, b, c];
        } else {
            let currents = self.model.currents(wrench.force, &sample.counts) * 1000.0;
            words[..3].copy_from_slice(&currents.to_array().map(|current| current as i16));
        }
        let mut bytes = [0; 15];
        bytes[1..]
            .as_chunks_mut::<2>()
            .0
            .iter_mut()
            .zip(words)
            .for_each(|(to, word)| *to = word.to_le_bytes());
        say(Report::new(&bytes, WRITTEN_BYTES));
    }
}

/// Motion of the handle from its encoders.
#[derive(Clone, Debug)]
pub struct EncodedMotion {
    model: WoodenHapticsModel,
    pose: Pose,
    /// Rotation accumulated about the device's axes, rad.
    turned: DVec3,
    linear: AdaptiveWindow,
    angular: AdaptiveWindow,
    twist: Twist,
}

impl EncodedMotion {
    /// Motion of a unit of this model.
    pub fn new(model: WoodenHapticsModel) -> Self {
        let specification = model.specification("");
        Self {
            model,
            pose: Pose::IDENTITY,
            turned: DVec3::ZERO,
            linear: AdaptiveWindow::new(specification.encoder_step),
            angular: AdaptiveWindow::new(specification.angular_encoder_step),
            twist: Twist::ZERO,
        }
    }
}

impl Motion for EncodedMotion {
    type Sample = Encoders;

    fn advance(&mut self, sample: &Encoders, came: Option<f64>, _: f64) -> (Pose, Twist, u32) {
        if let Some(now) = came.filter(|_| !sample.lost) {
            let before = std::mem::replace(&mut self.pose, self.model.pose(&sample.counts));
            self.turned += before.rotation_vector_to(&self.pose);
            self.twist =
                Twist::new(self.linear.push(now, self.pose.translation), self.angular.push(now, self.turned));
        }
        (self.pose, self.twist, sample.pressed.into())
    }

    fn restart(&mut self) {
        self.linear.clear();
        self.angular.clear();
    }
}

impl Link<WoodenHapticsCodec, EncodedMotion> {
    /// Link for a unit of this model with this name.
    pub fn wooden_haptics(name: &str, model: WoodenHapticsModel) -> Self {
        Link {
            codec: WoodenHapticsCodec { model },
            motion: EncodedMotion::new(model),
            specification: model.specification(name),
            read_timeout: READ_TIMEOUT,
            silence: SILENCE_TIMEOUT,
        }
    }
}
