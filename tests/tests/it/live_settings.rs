//! Changes of settings while a session runs.

use std::sync::LazyLock;

use palpate::device::{DeviceState, Emulation, IntendedPath, Status};
use palpate::errors::SettingsEditError;
use palpate::glam::DVec3;
use palpate::settings::{
    ContactSearch, ContactSettings, CouplingSettings, DetailSettings, LiveSettings, SearchSettings,
};
use palpate::{
    ContactLoop, HapticLoop, HapticRenderer, Object, Pose, Scene, Settings, SettingsEditor, Twist,
};
use palpate_tests::{model, penalties};

const PERIOD: f64 = 1e-3;

/// Session that a test steps, with the device held still where the probe presses on a ball.
struct Rig {
    haptic: HapticLoop,
    contact: ContactLoop,
    settings: SettingsEditor,
    steps: u32,
}

impl Rig {
    fn new(settings: Settings) -> Self {
        static OBJECTS: LazyLock<[Object; 2]> =
            LazyLock::new(|| [model("ellipsoid@500"), model("golf-ball@5000")]);
        let [probe, ball] = OBJECTS.clone();
        let scene = Scene::new().with(ball.clone(), below(&probe, &ball));
        let device =
            Emulation::default().open(IntendedPath::from(Pose::IDENTITY)).expect("an emulated device");
        let mut renderer = HapticRenderer::new(probe, scene, Box::new(device), settings).expect("renderer");
        let settings = renderer.settings_editor();
        let (haptic, contact, _) = renderer.into_loops();
        Self { haptic, contact, settings, steps: 0 }
    }

    /// Takes some steps and returns the force at the device after each, N.
    fn run(&mut self, steps: u32) -> Vec<DVec3> {
        (0..steps)
            .map(|_| {
                let body = *self.haptic.body_state();
                let now = PERIOD * f64::from(self.steps);
                let update = self.contact.step(&body, now);
                self.steps += 1;
                let (pose, twist) = (Pose::IDENTITY, Twist::ZERO);
                let device = DeviceState { time: now, pose, twist, buttons: 0, status: Status::OK };
                let record = self.haptic.step(&device, now + PERIOD, PERIOD);
                self.haptic.update_contacts(&update);
                record.coupling.force
            })
            .collect()
    }

    /// Runs to rest and returns the force.
    fn rest(&mut self) -> DVec3 {
        let forces = self.run(2000);
        forces[forces.len() - 1]
    }
}

/// Returns a pose of the object half a millimetre into the probe, from below.
fn below(probe: &Object, object: &Object) -> Pose {
    let top = |object: &Object| object.clod.vertices.iter().map(|v| v.z).fold(f64::NEG_INFINITY, f64::max);
    let bottom = probe.clod.vertices.iter().map(|v| v.z).fold(f64::INFINITY, f64::min);
    Pose::from_translation((bottom - top(object) + 5e-4) * DVec3::Z)
}

/// Changed gains blend smoothly to the state of a session that started with them.
#[test]
fn gains_blend_smoothly() {
    // Without a proxy or friction, the state at rest does not depend on the history.
    let soft =
        Settings { search: SearchSettings { proxy: false, ..SearchSettings::default() }, ..penalties() };
    let stiff = Settings {
        contact: ContactSettings { stiffness: 6000.0, damping: Some(40.0), ..soft.contact },
        coupling: CouplingSettings { stiffness: Some(1000.0), angular_stiffness: Some(1.0), ..soft.coupling },
        ..soft
    };
    for (from, to) in [(soft, stiff), (stiff, soft)] {
        let mut rig = Rig::new(from);
        let before = rig.rest();
        rig.settings.set(to.live()).expect("settings");
        assert_eq!(rig.settings.settings(), to);
        let forces = rig.run(1000);
        let after = forces[forces.len() - 1];
        let wanted = Rig::new(to).rest();
        assert!((after - wanted).length() < 0.02 * wanted.length(), "{after} and {wanted} N");
        let change = (after - before).length();
        assert!(change > 0.2 * before.length(), "{before} to {after} N");
        let mut last = before;
        for force in forces {
            let step = (force - last).length();
            assert!(step < 0.03 * change, "a step of {step} N, of {change} N");
            last = force;
        }
    }
}

/// Changed detail blends smoothly, too.
#[test]
fn detail_blends_smoothly() {
    let fine = Settings {
        search: SearchSettings { method: ContactSearch::Levels, proxy: false, ..SearchSettings::default() },
        ..penalties()
    };
    let coarse = Settings { detail: DetailSettings { error: 2e-4, ..fine.detail }, ..fine };
    for (from, to) in [(fine, coarse), (coarse, fine)] {
        let mut rig = Rig::new(from);
        let before = rig.rest();
        rig.settings.set(to.live()).expect("settings");
        let forces = rig.run(2000);
        let after = forces[forces.len() - 1];
        let wanted = Rig::new(to).rest();
        assert!((after - wanted).length() < 0.05 * wanted.length(), "{after} and {wanted} N");
        let mut last = before;
        for force in forces {
            let step = (force - last).length();
            assert!(step < 0.1 * before.length(), "a step of {step} N, of {before} N");
            last = force;
        }
    }
}

/// Settings that are fixed are refused, and nothing changes.
#[test]
fn fixed_settings_are_refused() {
    let mut rig = Rig::new(Settings {
        search: SearchSettings { method: ContactSearch::Representatives, ..SearchSettings::default() },
        ..penalties()
    });
    let made = rig.settings.settings();
    // Contacts found in fields have no detail to leave out.
    let coarse = DetailSettings { error: 1e-4, ..made.detail };
    let refused = rig.settings.set(LiveSettings { detail: coarse, ..made.live() }).expect_err("no detail");
    assert!(matches!(refused, SettingsEditError::Detail), "{refused}");
    assert!(refused.to_string().contains("detail.error"), "{refused}");
    let contact = ContactSettings { stiffness: f64::NAN, ..made.contact };
    let refused = rig.settings.set(LiveSettings { contact, ..made.live() }).expect_err("not a number");
    assert!(refused.to_string().contains("contact-stiffness"), "{refused}");
    assert_eq!(rig.settings.settings(), made);
    let full = (0..1000).find_map(|_| rig.settings.set(made.live()).err());
    assert!(matches!(full, Some(SettingsEditError::Full)), "{full:?}");
    rig.run(1);
    rig.settings.set(made.live()).expect("room again");
}
