//! Device with a delay: the coupling that is chosen for it is stable against a wall, and the one for a device
//! without delay is not.

use std::convert::Infallible;
use std::sync::atomic::AtomicBool;

use palpate::device::{EmulatedHand, IntendedPath};
use palpate::glam::DVec3;
use palpate::settings::CouplingSettings;
use palpate::{ContactTiming, HapticRenderer, Pose, Scene, Settings, Twist};
use palpate_tests::{first_touch, model, penalties, smooth};

const SECONDS: f64 = 3.0;
/// Intended depth behind the surface at the end, m.
const DEPTH: f64 = 5e-3;

/// Presses a ball onto a ball by a soft hand without damping. Returns the range of the force (N) in the last
/// second, and its mean.
fn press(address: &str, settings: Settings) -> (f64, f64) {
    let (probe, wall) = (model("ellipsoid@500"), model("golf-ball@2000"));
    let start = first_touch(&probe, &wall) + DVec3::Z * 1e-3;
    let path = IntendedPath::function(|time| {
        let travel = (1e-3 + DEPTH) * smooth(0.3, 0.8, time);
        (Pose::from_translation(DVec3::NEG_Z * travel), Twist::ZERO)
    });
    let hand = EmulatedHand::at(address).expect("an emulated device").expect("settings of one");
    let device = Box::new(hand.emulation.open(path).expect("an emulation"));
    let scene = Scene::new().with(wall, Pose::from_translation(-start));
    let renderer = HapticRenderer::new(probe, scene, device, settings).expect("renderer");
    let mut forces = Vec::new();
    renderer
        .run_lockstep(SECONDS, ContactTiming::busy(1000.0), &AtomicBool::new(false), |row| {
            if row.time > SECONDS - 1.0 {
                forces.push(row.coupling.force.z);
            }
            Ok::<_, Infallible>(())
        })
        .expect("the sink never fails");
    let mean = forces.iter().sum::<f64>() / forces.len() as f64;
    let (low, high) =
        forces.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), f| (low.min(*f), high.max(*f)));
    (high - low, mean)
}

#[test]
fn a_device_with_delay_is_stable_with_the_coupling_chosen_for_it() {
    // Only the damping of the handle itself brings it to rest.
    for delay in ["0", "1e-3", "2e-3", "5e-3"] {
        let address =
            format!("emulated:premium-1.5,delay={delay},hand=none,hand.stiffness=100,handle.friction=0");
        let (swing, mean) = press(&address, penalties());
        // It may swing by two steps of its encoders, for ever.
        assert!(swing < 0.1 && mean > 0.1, "{delay} s: {swing} N about {mean} N");
    }
}

#[test]
fn the_coupling_of_a_device_without_delay_oscillates_on_one_with_delay() {
    let early = Settings {
        coupling: CouplingSettings { stiffness: Some(400.0), ..CouplingSettings::default() },
        ..penalties()
    };
    let (swing, mean) =
        press("emulated:premium-1.5,delay=5e-3,hand=none,hand.stiffness=100,handle.friction=0", early);
    assert!(swing > 0.5, "{swing} N about {mean} N");
}
