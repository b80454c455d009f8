//! Codecs of HID devices: known reports, round trips, and arbitrary bytes.

use glam::DVec3;
use palpate_core::{Twist, Wrench};
use palpate_device::hid::{
    Deflection, EncodedMotion, Encoders, RateControl, SpaceMouseCodec, WoodenHapticsCodec, WoodenHapticsModel,
};
use palpate_device::link::{Codec, Malformed, Motion, Report};
use rand::rngs::StdRng;
use rand::{Rng as _, RngExt as _, SeedableRng as _};

/// Number of random reports.
const FUZZED: usize = 1_000_000;

fn decoded<C: Codec>(codec: &mut C, reports: &[&[u8]]) -> Result<C::Sample, Malformed> {
    let mut sample = C::Sample::default();
    reports.iter().try_for_each(|report| codec.decode(report, &mut sample))?;
    Ok(sample)
}

/// The one report that commands a wrench.
fn encoded<C: Codec>(codec: &mut C, wrench: &Wrench, sample: &C::Sample) -> Report {
    let mut said = None;
    codec.encode(wrench, sample, &mut |report| assert!(said.replace(report).is_none(), "two reports"));
    said.expect("a report")
}

#[test]
fn both_layouts_of_a_cap_agree() {
    let expected = Deflection {
        translation: [350, -2, 256],
        rotation: [-350, 17, -256],
        buttons: 0b10_0000_0001,
        battery: Some(87),
    };
    let shift = [0x5e, 0x01, 0xfe, 0xff, 0x00, 0x01];
    let turn = [0xa2, 0xfe, 0x11, 0x00, 0x00, 0xff];
    let buttons = [3, 0x01, 0x02];
    let battery = [0x17, 87, 0];
    let older: [Vec<u8>; 2] = [[&[1][..], &shift].concat(), [&[2][..], &turn].concat()];
    let newer = [&[1][..], &shift, &turn].concat();
    let found = decoded(&mut SpaceMouseCodec, &[&older[0], &older[1], &buttons, &battery]);
    assert_eq!(found, Ok(expected));
    assert_eq!(decoded(&mut SpaceMouseCodec, &[&newer, &buttons, &battery]), Ok(expected));
    for report in [&[][..], &[1], &[1, 2, 3, 4, 5], &[2, 0], &[3], &[0x17], &[9, 1, 2, 3]] {
        assert_eq!(decoded(&mut SpaceMouseCodec, &[report]), Err(Malformed), "{report:?}");
    }
}

#[test]
fn a_deflected_cap_moves_the_handle_until_it_is_let_go() {
    let mut motion = RateControl::default();
    let full = Deflection { translation: [350, 0, 0], rotation: [0, 0, -350], ..Deflection::default() };
    let mut pose = motion.advance(&full, None, 0.0).0;
    for i in 1..=100 {
        let now = f64::from(i) * 1e-3;
        pose = motion.advance(&full, (i % 10 == 0).then_some(now), now).0;
    }
    // From the first report on, 0.1 m/s and 1 rad/s: the cap's z points down.
    assert!((pose.translation - DVec3::X * 0.0091).length() < 2e-4, "{pose:?}");
    assert!((pose.rotation.to_scaled_axis() - DVec3::Z * 0.091).length() < 2e-3, "{pose:?}");
    // The report of a cap at rest may be lost.
    let twist = motion.advance(&full, None, 0.5).1;
    assert_eq!(twist, Twist::ZERO);
    // A cap at rest may report a small deflection.
    let rest = Deflection { translation: [5, -7, 3], ..Deflection::default() };
    assert_eq!(motion.advance(&rest, Some(0.501), 0.501).1, Twist::ZERO);
    // It does not leave the workspace.
    for i in 0..3000 {
        let now = 0.6 + f64::from(i) * 1e-3;
        pose = motion.advance(&full, Some(now), now).0;
    }
    assert!((0.0999..=0.1).contains(&pose.translation.length()), "{pose:?}");
}

fn report(counts: [i16; 6], info: i16) -> Vec<u8> {
    counts.into_iter().chain([info]).flat_map(i16::to_le_bytes).collect()
}

#[test]
fn wooden_haptics_reports_are_the_makers() {
    let mut codec = WoodenHapticsCodec { model: WoodenHapticsModel::POLHEM };
    let bytes = [1, 0, 0xff, 0xff, 0x10, 0x27, 0x11, 0x27, 5, 0, 6, 0, 0, 0];
    let sample = decoded(&mut codec, &[&bytes]).unwrap();
    assert_eq!(sample, Encoders { counts: [1, -1, 10_000, 1, 5, 6], pressed: true, lost: false });
    let mut long = [7; 64];
    long[..14].copy_from_slice(&bytes);
    assert_eq!(decoded(&mut codec, &[&long]), Ok(sample));
    assert_eq!(decoded(&mut codec, &[&bytes[..13]]), Err(Malformed));
    // Without a force: number 0 and zeros.
    let zero = encoded(&mut codec, &Wrench::ZERO, &sample);
    assert_eq!(zero.bytes(), [0; 65]);
    // The encoders are set when the device asks: d, e, f, the command, a, b, c.
    let lost = decoded(&mut codec, &[&report([0; 6], 1)]).unwrap();
    let set = encoded(&mut codec, &Wrench::new(DVec3::X, DVec3::ZERO), &lost);
    let mut expected = [0; 65];
    (expected[7], expected[13], expected[14]) = (1, 0x78, 0xec); // −5000
    assert_eq!(set.bytes(), expected);
}

/// Counts within the reach of the joints.
fn counts(rng: &mut StdRng) -> [i16; 6] {
    std::array::from_fn(|_| rng.random_range(-4000..4000))
}

/// The currents make the commanded force on the hand: their power is that of the joints, over any small
/// motion.
#[test]
fn currents_do_the_work_of_the_force() {
    let mut rng = StdRng::seed_from_u64(71);
    let mut saturated = 0;
    for (name, model) in WoodenHapticsModel::MODELS {
        let constants = DVec3::new(
            model.torque_constant_motor_a,
            model.torque_constant_motor_b,
            model.torque_constant_motor_c,
        );
        let turn = DVec3::new(model.cpr_encoder_a, model.cpr_encoder_b, model.cpr_encoder_c);
        for _ in 0..1000 {
            let at = counts(&mut rng);
            let force = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-2.0..2.0)));
            let currents = model.currents(force, &at);
            assert!(currents.is_finite() && currents.abs().max_element() < 2.0, "{name}: {currents}");
            if currents.abs().max_element() > 1.99 {
                saturated += 1;
                continue;
            }
            for motor in 0..3 {
                let moved = |by: i16| {
                    let mut counts = at;
                    counts[motor] += by;
                    model.pose(&counts).translation
                };
                let work = force.dot(moved(1) - moved(-1));
                let angle = 2.0 * std::f64::consts::TAU / turn[motor];
                let electric = currents[motor] * constants[motor] * angle;
                assert!((work - electric).abs() < 1e-8, "{name}, motor {motor}: {work} {electric}");
            }
        }
    }
    assert!((1..2500).contains(&saturated), "{saturated}");
}

#[test]
fn kinematics_are_known_at_known_places() {
    // All joints at zero: the first arm points up, the second hangs from it.
    let model = WoodenHapticsModel::WOODEN_HAPTICS;
    let up = model.pose(&[0; 6]).translation + DVec3::new(0.22, 0.0, 0.08);
    assert!((up - DVec3::Z * (0.08 + 0.205 - 0.245)).length() < 1e-12, "{up}");
    // A quarter turn of body b lays it along x: ratio 1 : 12, 2000 counts a turn.
    let flat = model.pose(&[0, 6000, 0, 0, 0, 0]).translation + DVec3::new(0.22, 0.0, 0.08);
    assert!((flat - DVec3::new(0.205, 0.0, 0.08 - 0.245)).length() < 1e-9, "{flat}");
    // A quarter turn of body a (1 : 16) swings that over y.
    let aside = model.pose(&[8000, 6000, 0, 0, 0, 0]).translation + DVec3::new(0.22, 0.0, 0.08);
    assert!((aside - DVec3::new(0.0, 0.205, 0.08 - 0.245)).length() < 1e-9, "{aside}");
}

#[test]
fn the_wrist_is_sensed_where_there_is_one() {
    let (plain, wrist) = (WoodenHapticsModel::WOODEN_HAPTICS, WoodenHapticsModel::POLHEM);
    assert_eq!(plain.pose(&[10, 20, 30, 40, 50, 60]).rotation, glam::DQuat::IDENTITY);
    // The last encoder is the first of the wrist, about the arm.
    let turned = |by: i16| wrist.pose(&[0, 0, 0, 0, 0, by]).rotation;
    let angle = turned(0).angle_between(turned(256));
    assert!((angle - std::f64::consts::FRAC_PI_2).abs() < 1e-9, "{angle}");
}

#[test]
fn velocities_are_those_of_the_motion() {
    let model = WoodenHapticsModel::POLHEM;
    let mut motion = EncodedMotion::new(model);
    let at = |i: i32| [2000 + 3 * i as i16, 1500, -3000, 0, 0, 2 * i as i16];
    let mut found = Twist::ZERO;
    for i in 0..200 {
        let now = f64::from(i) * 1e-3;
        found = motion.advance(&Encoders { counts: at(i), ..Encoders::default() }, Some(now), now).1;
    }
    let (before, after) = (model.pose(&at(190)), model.pose(&at(199)));
    let linear = (after.translation - before.translation) / 9e-3;
    let angular = before.rotation_vector_to(&after) / 9e-3;
    assert!((found.linear - linear).length() < 0.03 * linear.length(), "{found:?} {linear}");
    assert!((found.angular - angular).length() < 0.05 * angular.length(), "{found:?} {angular}");
}

#[test]
fn models_come_from_the_makers_file() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("woodenhaptics.json");
    let open = |text: &str| {
        std::fs::write(&file, text).unwrap();
        WoodenHapticsModel::open(file.to_str().unwrap())
    };
    let text = r#"{
        "variant": 0, "diameter_capstan_a": 0.01, "diameter_capstan_b": 0.01, "diameter_capstan_c": 0.01,
        "length_body_a": 0.08, "length_body_b": 0.205, "length_body_c": 0.245,
        "diameter_body_a": 0.16, "diameter_body_b": 0.12, "diameter_body_c": 0.12,
        "workspace_origin_x": 0.22, "workspace_origin_y": 0, "workspace_origin_z": 0.08, "workspace_radius": 0.1,
        "torque_constant_motor_a": 0.0259, "torque_constant_motor_b": 0.0259, "torque_constant_motor_c": 0.0259,
        "current_for_10_v_signal": 3, "cpr_encoder_a": 2000, "cpr_encoder_b": 2000, "cpr_encoder_c": 2000,
        "max_linear_force": 5, "max_linear_stiffness": 1000, "max_linear_damping": 8, "calibrate_enc_c": 6000
    }"#;
    assert_eq!(open(text).unwrap(), WoodenHapticsModel::WOODEN_HAPTICS);
    for (from, to, what) in [
        ("\"variant\": 0", "\"variant\": 3", "not public"),
        ("\"cpr_encoder_a\": 2000", "\"cpr_encoder_a\": 0", "count"),
        ("\"workspace_origin_x\": 0.22", "\"workspace_origin_x\": 1e300", "position"),
        ("\"variant\": 0,", "", "variant"),
        ("{", "", "expected"),
    ] {
        let error = open(&text.replacen(from, to, 1)).unwrap_err().to_string();
        assert!(error.contains(what) && error.contains("woodenhaptics.json"), "{error}");
    }
    assert!(WoodenHapticsModel::open("no/such.json").is_err());
}

#[test]
fn any_bytes_end_in_a_command_within_the_limits() {
    let mut rng = StdRng::seed_from_u64(72);
    let mut bytes = [0; 65];
    let mut mouse = (SpaceMouseCodec, Deflection::default(), RateControl::default());
    let models = WoodenHapticsModel::MODELS
        .map(|(_, model)| (WoodenHapticsCodec { model }, Encoders::default(), EncodedMotion::new(model)));
    let mut woods = models;
    let (mut understood, mut commands) = (0, 0);
    for i in 0..FUZZED {
        let length = rng.random_range(0..=65);
        rng.fill_bytes(&mut bytes[..length]);
        if length > 0 && i % 2 == 0 {
            bytes[0] = [1, 2, 3, 0x17][i / 2 % 4];
        }
        let now = i as f64 * 1e-3;
        understood += usize::from(mouse.0.decode(&bytes[..length], &mut mouse.1).is_ok());
        let (pose, twist, _) = mouse.2.advance(&mouse.1, Some(now), now);
        assert!(pose.is_valid() && twist.is_finite() && pose.translation.length() <= 0.1);
        let (codec, sample, motion) = &mut woods[i % 3];
        let _ = codec.decode(&bytes[..length], sample);
        let (pose, twist, _) = motion.advance(sample, Some(now), now);
        assert!(pose.is_valid() && twist.is_finite(), "{sample:?}");
        let force = [DVec3::splat(5.0), DVec3::new(1e300, -1e300, 1.0), DVec3::ZERO][i % 3];
        let report = encoded(codec, &Wrench::new(force, DVec3::ZERO), sample);
        assert_eq!((report.bytes().len(), report.bytes()[0]), (65, 0));
        let word = |at: usize| i16::from_le_bytes([report.bytes()[at], report.bytes()[at + 1]]);
        if word(7) == 0 {
            commands += 1;
            assert!([1, 3, 5].iter().all(|at| word(*at).abs() < 2000), "{report:?}");
        }
    }
    assert!(understood > FUZZED / 4 && commands > FUZZED / 2, "{understood} {commands}");
}
