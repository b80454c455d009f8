//! Addresses of emulated devices, as written on a command line: `emulated:PRESET,KEY=VALUE,…`.

use std::path::Path;

use serde_json::{Map, Value};

use super::{EmulatedDevice, Emulation, GripperEmulation};
use crate::{AnglePath, DeviceError, Hand, IntendedPath, Interpolation, MotionPath, Task, TaskParameters};

/// Name of this kind of device in an address.
pub(crate) const KIND: &str = "emulated";

/// An emulated device and the task or path of its hand, parsed from an address.
#[derive(Clone, Debug)]
pub struct EmulatedHand {
    /// The device and the hand.
    pub emulation: Emulation,
    /// Task of the hand, if the address names one.
    pub task: Option<Task>,
    /// How the hand does its task.
    pub task_parameters: TaskParameters,
    /// Intended path of the hand (device axes), if the address names a file.
    pub path: Option<MotionPath>,
    /// Intended angle of the gripper, if the address names a file; the device then has a gripper.
    pub gripper: Option<AnglePath>,
}

impl EmulatedHand {
    /// Parses `emulated`, `emulated:PRESET`, or either with settings: `emulated:PRESET,KEY=VALUE,…`. Gives
    /// `None` if the address is not that of an emulated device.
    ///
    /// Keys are `hand` (name of a [`Hand`]), `task` (name of a [`Task`]), `path` (file of poses, see
    /// [`MotionPath::load`]; it takes the rest of the address), `gripper` (file of angles, see
    /// [`AnglePath::load`]; the name cannot have a comma), the numbers of a
    /// [`Specification`](crate::Specification) (`peak_force`, `encoder_step`, …; `inf` for no limit),
    /// `handle.mass` and the other parameters of a [`Handle`](crate::Handle), `hand.mass` and those of a
    /// [`Hand`], `task.turns` and those of [`TaskParameters`], `substep` and `catch_up`.
    ///
    /// # Errors
    /// If there is no such key, or its value is not valid.
    pub fn at(address: &str) -> Option<Result<Self, DeviceError>> {
        let which = match address.strip_prefix(KIND)? {
            "" => None,
            rest => Some(rest.strip_prefix(':')?),
        };
        Self::named(which)
    }

    /// Parses the part of an address after `emulated:`.
    pub(crate) fn named(which: Option<&str>) -> Option<Result<Self, DeviceError>> {
        let (preset, settings) = match which {
            None => (None, ""),
            Some(which) => {
                let (first, rest) = which.split_once(',').unwrap_or((which, ""));
                if first.contains('=') { (None, which) } else { (Some(first), rest) }
            }
        };
        let emulation = preset.map_or_else(|| Some(Emulation::default()), Emulation::preset)?;
        let task_parameters = TaskParameters::default();
        Some(Self { emulation, task: None, task_parameters, path: None, gripper: None }.with(settings))
    }

    /// Opens the device with a path for the hand, and with a gripper if the address names one.
    ///
    /// # Errors
    /// As [`Emulation::open`] and [`EmulatedDevice::with_gripper`].
    pub fn open(self, path: impl Into<IntendedPath>) -> Result<EmulatedDevice, DeviceError> {
        let device = self.emulation.open(path)?;
        match self.gripper {
            Some(angles) => device.with_gripper(GripperEmulation::default(), angles),
            None => Ok(device),
        }
    }

    /// Applies settings, `KEY=VALUE,…`.
    fn with(mut self, mut settings: &str) -> Result<Self, DeviceError> {
        while !settings.is_empty() {
            if let Some(file) = settings.strip_prefix("path=") {
                self.path = Some(MotionPath::load(Path::new(file), Interpolation::Smooth)?);
                break;
            }
            let (setting, rest) = settings.split_once(',').unwrap_or((settings, ""));
            self.set(setting)?;
            settings = rest;
        }
        if self.task.is_some() && self.path.is_some() {
            return Err(refused("task, path", "one of the two: a hand follows a path or does a task".into()));
        }
        Ok(self)
    }

    fn set(&mut self, setting: &str) -> Result<(), DeviceError> {
        let (key, value) =
            setting.split_once('=').ok_or_else(|| refused(setting, "KEY=VALUE, such as hand=firm".into()))?;
        match key {
            "hand" => {
                let hand = Hand::preset(value);
                self.emulation.hand = hand.ok_or_else(|| refused(setting, names(&Hand::PRESETS)))?;
            }
            "task" => {
                let task = Task::named(value);
                self.task = Some(task.ok_or_else(|| refused(setting, names(&Task::ALL)))?);
            }
            "gripper" => self.gripper = Some(AnglePath::load(Path::new(value))?),
            _ => {
                (self.emulation, self.task_parameters) =
                    with_number((&self.emulation, &self.task_parameters), key, setting, value)?
            }
        }
        Ok(())
    }
}

/// The emulation and the task's parameters with one of their numbers replaced.
///
/// Numbers are found by their field names through serde, so that a new field needs no entry here.
fn with_number(
    (emulation, task): (&Emulation, &TaskParameters),
    key: &str,
    setting: &str,
    value: &str,
) -> Result<(Emulation, TaskParameters), DeviceError> {
    let unusable = |error: serde_json::Error| refused(setting, error.to_string());
    let mut all = serde_json::to_value(emulation).map_err(unusable)?;
    let task = serde_json::to_value(task).map_err(unusable)?;
    if let Some(all) = all.as_object_mut() {
        all.insert("task".into(), task);
    }
    let keys = keys(&all);
    let known =
        || refused(setting, format!("one of {} = a number; hand, task, gripper or path", keys.join(", ")));
    let number: f64 = value.parse().map_err(|_| refused(setting, "a number after `=`".into()))?;
    // JSON has no infinity; null stands for it.
    let number = match number {
        f64::INFINITY => Value::Null,
        number => Value::from(number),
    };
    if !keys.iter().any(|known| known == key) {
        return Err(known());
    }
    let path = key.replace('.', "/");
    // The specification states the handle's mechanics as well.
    for place in [format!("/{path}"), format!("/specification/{path}")] {
        if let Some(entry) = all.pointer_mut(&place) {
            *entry = number.clone();
        }
    }
    let not_finite = |_| refused(setting, "a finite number after `=`".into());
    let task = all.as_object_mut().and_then(|all| all.remove("task")).unwrap_or_default();
    let task = serde_json::from_value(task).map_err(not_finite)?;
    Ok((serde_json::from_value(all).map_err(not_finite)?, task))
}

/// Keys of all numbers of an emulation and of a task.
fn keys(emulation: &Value) -> Vec<String> {
    let numbers = |entries: Option<&Map<String, Value>>, prefix: &str| -> Vec<String> {
        let named = entries.into_iter().flatten().filter(|(_, value)| value.is_number() || value.is_null());
        named.map(|(name, _)| format!("{prefix}{name}")).filter(|name| name != "handle").collect()
    };
    let part = |name: &str| emulation.get(name).and_then(Value::as_object);
    [
        numbers(part("specification"), ""),
        numbers(part("handle"), "handle."),
        numbers(part("hand"), "hand."),
        numbers(part("task"), "task."),
        numbers(emulation.as_object(), ""),
    ]
    .concat()
}

fn names<T>(named: &[(&'static str, T)]) -> String {
    format!("one of {}", named.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", "))
}

fn refused(setting: &str, expected: String) -> DeviceError {
    DeviceError::Setting { setting: setting.chars().take(80).collect(), expected }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::HapticDevice as _;

    fn parsed(address: &str) -> EmulatedHand {
        EmulatedHand::at(address).expect(address).unwrap_or_else(|error| panic!("{address}: {error}"))
    }

    #[test]
    fn settings_replace_those_of_the_preset() {
        assert_eq!(parsed("emulated").emulation, Emulation::default());
        assert_eq!(parsed("emulated:omega").emulation, Emulation::preset("omega").unwrap());
        let hand =
            parsed("emulated:touch,hand=firm,hand.stiffness=900,peak_force=inf,encoder_step=0,task=tap");
        let touch = Emulation::preset("touch").unwrap();
        let specification =
            crate::Specification { peak_force: f64::INFINITY, encoder_step: 0.0, ..touch.specification };
        let expected = Emulation { specification, hand: Hand { stiffness: 900.0, ..Hand::FIRM }, ..touch };
        assert_eq!(hand.emulation, expected);
        assert_eq!(hand.task, Some(Task::Tap));

        let late = parsed("emulated:premium-1.5,delay=2e-3").emulation;
        assert_eq!(late.specification.delay, 2e-3);

        // The specification changes with the setting.
        let heavy = parsed("emulated:handle.mass=0.5,substep=5e-5").emulation;
        assert_eq!(heavy.handle.mass, 0.5);
        assert_eq!(heavy.specification.handle, Some(heavy.handle));
        assert_eq!(heavy.substep, 5e-5);
    }

    /// Every number of an emulation can be set, and setting it changes nothing else.
    #[test]
    fn every_number_has_a_key() {
        let emulation = Emulation::default();
        let all = serde_json::to_value(&emulation).unwrap();
        let keys = keys(&all);
        assert!(keys.len() > 24, "{keys:?}");
        for key in keys {
            let changed = parsed(&format!("emulated:{key}=0.5")).emulation;
            let values = serde_json::to_value(&changed).unwrap();
            let path = key.replace('.', "/");
            let place = [format!("/{path}"), format!("/specification/{path}")];
            assert!(place.iter().any(|place| values.pointer(place) == Some(&Value::from(0.5))), "{key}");
            assert_ne!(changed, emulation, "{key}");
        }
    }

    #[test]
    fn a_task_has_parameters() {
        let hand =
            parsed("emulated:task=turn-nut,task.turns=2,task.turn_rate=0.5,hand.tremor=3e-4,task.tilt=0.03");
        assert_eq!(hand.task, Some(Task::TurnNut));
        let expected = TaskParameters { turns: 2.0, turn_rate: 0.5, tilt: 0.03, ..TaskParameters::default() };
        assert_eq!(hand.task_parameters, expected);
        assert_eq!(hand.emulation.hand, Hand { tremor: 3e-4, ..Hand::default() });
        for key in ["turns", "turn_rate", "pitch", "press", "tilt"] {
            assert_ne!(
                parsed(&format!("emulated:task.{key}=0.5")).task_parameters,
                TaskParameters::default()
            );
        }
        let error = EmulatedHand::at("emulated:task.speed=1").unwrap().unwrap_err().to_string();
        assert!(error.contains("task.turn_rate"), "{error}");
        assert!(EmulatedHand::at("emulated:task.turns=inf").unwrap().is_err());
    }

    #[test]
    fn a_path_takes_the_rest() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a,b=c.csv");
        std::fs::write(&file, format!("{}\n0,0,0,0,0,0,0,1\n1,0,0,1,0,0,0,1\n", crate::PATH_HEADER)).unwrap();
        let hand = parsed(&format!("emulated:hand=light,path={}", file.display()));
        assert_eq!(hand.path.unwrap().duration(), 1.0);
        assert_eq!(hand.emulation.hand, Hand::LIGHT);
    }

    #[test]
    fn a_gripper_goes_with_a_task_or_a_path() {
        let folder = tempfile::tempdir().unwrap();
        let (angles, poses) = (folder.path().join("grip.csv"), folder.path().join("path.csv"));
        std::fs::write(&angles, "t,angle\n0,0.6\n2,0\n").unwrap();
        std::fs::write(&poses, format!("{}\n0,0,0,0,0,0,0,1\n", crate::PATH_HEADER)).unwrap();
        let (angles, poses) = (angles.display(), poses.display());
        for rest in [format!("hand=firm,path={poses}"), "task=press".into(), "hand=firm".into()] {
            let hand = parsed(&format!("emulated:omega,gripper={angles},{rest}"));
            assert_eq!(hand.gripper.as_ref().unwrap().duration(), 2.0);
            let mut device = hand.open(palpate_core::Pose::IDENTITY).unwrap();
            assert_eq!(device.gripper().unwrap().read(0.0).unwrap().angle, 0.6);
        }
        let error = EmulatedHand::at(&format!("emulated:gripper={poses}")).unwrap().unwrap_err().to_string();
        assert!(error.contains("path.csv:1; let the file begin with the line t,angle"), "{error}");
    }

    #[test]
    fn invalid_settings_are_named() {
        for (address, expected) in [
            ("emulated:touch,hand=strong", "`hand=strong`: give one of none, light"),
            ("emulated:task=fly", "one of explore, press, stroke, scrub, tap, peg-insertion, turn-nut, file"),
            ("emulated:omega,firm", "KEY=VALUE"),
            ("emulated:mass=1", "handle.mass"),
            ("emulated:name=1", "encoder_step"),
            ("emulated:handle=1", "hand, task, gripper or path"),
            ("emulated:gripper=no/such.csv,path=p.csv", "no/such.csv"),
            ("emulated:hand.mass=heavy", "a number after"),
            ("emulated:hand.mass=inf", "a finite number"),
            ("emulated:hand.mass=nan", "a finite number"),
            ("emulated:path=no/such.csv", "no/such.csv"),
            ("emulated:omega,,", "KEY=VALUE"),
        ] {
            let error = EmulatedHand::at(address).expect(address).expect_err(address).to_string();
            assert!(error.contains(expected), "{address}: {error}");
        }
        for address in
            ["emulated:", "emulated:phantom", "emulated:phantom,hand=firm", "replay:x", "emulatedx"]
        {
            assert!(EmulatedHand::at(address).is_none(), "{address}");
        }
        // Values that no emulation can have are refused when it is opened.
        let hand = parsed("emulated:substep=-1");
        assert!(hand.emulation.open(palpate_core::Pose::IDENTITY).is_err());
    }
}
