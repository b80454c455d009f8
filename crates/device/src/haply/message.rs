//! Messages of Haply's service.

use serde_json::{Value, json};

/// Form of forces in messages, which depends on the service's version.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Dialect {
    /// Field `vector`: from service 3.2 on.
    #[default]
    Vector,
    /// Field `values`: service 3.1.
    Values,
}

impl Dialect {
    /// Dialect of a service with this version, such as `3.1.0`.
    pub fn of(version: &str) -> Self {
        let mut parts = version.split('.').map(|part| part.trim().parse::<u32>().ok());
        match (parts.next().flatten(), parts.next().flatten()) {
            (Some(3), Some(0 | 1)) => Self::Values,
            _ => Self::Vector,
        }
    }
}

/// State of an Inverse3 from a message, in its axes: x to the right, y away from the user, z up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inverse3State {
    /// Position of the cursor, m.
    pub position: [f32; 3],
    /// Velocity of the cursor, m/s.
    pub velocity: [f32; 3],
    /// Unit quaternion x, y, z, w: orientation of the grip if there is one, else of the device's body.
    pub orientation: [f32; 4],
    /// Buttons of the grip, the first in bit 0.
    pub buttons: u32,
    /// Whether it is calibrated and accepts forces.
    pub ready: bool,
}

impl Default for Inverse3State {
    fn default() -> Self {
        Self {
            position: [0.0; 3],
            velocity: [0.0; 3],
            orientation: [0.0, 0.0, 0.0, 1.0],
            buttons: 0,
            ready: false,
        }
    }
}

/// Size of a state as a report, bytes.
const BYTES: usize = 45;

impl Inverse3State {
    fn numbers(&self) -> impl Iterator<Item = f32> {
        self.position.into_iter().chain(self.velocity).chain(self.orientation)
    }

    fn is_sound(&self) -> bool {
        let square: f32 = self.orientation.iter().map(|part| part * part).sum();
        self.numbers().all(f32::is_finite) && (0.9..1.1).contains(&square)
    }

    /// The state as a report of fixed size.
    #[cfg(feature = "haply")]
    pub(super) fn to_report(self) -> [u8; BYTES] {
        let mut report = [0; BYTES];
        let words = report.as_chunks_mut::<4>().0;
        words.iter_mut().zip(self.numbers()).for_each(|(to, number)| *to = number.to_le_bytes());
        words[10] = self.buttons.to_le_bytes();
        report[44] = self.ready.into();
        report
    }

    /// Decodes a report; `None` if a number is not finite or the orientation is not a unit quaternion.
    pub(super) fn from_report(report: &[u8]) -> Option<Self> {
        let report: &[u8; BYTES] = report.try_into().ok()?;
        let (words, _) = report.as_chunks::<4>();
        let number = |index: usize| f32::from_le_bytes(words[index]);
        let state = Self {
            position: [0, 1, 2].map(number),
            velocity: [3, 4, 5].map(number),
            orientation: [6, 7, 8, 9].map(number),
            buttons: u32::from_le_bytes(words[10]),
            ready: report[44] == 1,
        };
        state.is_sound().then_some(state)
    }
}

/// Number and state of the first Inverse3 in a message of the service; `None` if there is none or a number is
/// not finite.
pub fn parse_state(message: &str) -> Option<(String, Inverse3State)> {
    let message: Value = serde_json::from_str(message).ok()?;
    let device = message["inverse3"].as_array()?.first()?;
    let number = device["device_id"].as_str()?.to_owned();
    let state = &device["state"];
    let grips = ["verse_grip", "wireless_verse_grip"].map(|kind| &message[kind][0]["state"]);
    let grip = grips.into_iter().find(|state| state.is_object());
    let orientation = grip.map_or(&state["body_orientation"], |grip| &grip["orientation"]);
    let part = |value: &Value, name: &str| value[name].as_f64().map(|part| part as f32);
    let vector = |value: &Value| Some([part(value, "x")?, part(value, "y")?, part(value, "z")?]);
    // Some grips report a list of buttons, others an object or a number.
    let held = |value: &Value| value.as_bool().or(value.as_i64().map(|value| value != 0)).unwrap_or(false);
    let buttons = match grip.map(|grip| &grip["buttons"]) {
        Some(Value::Array(all)) => bits(all.iter().map(held)),
        Some(Value::Object(all)) => bits(all.values().map(held)),
        Some(value) => value.as_u64().map_or_else(|| u32::from(held(value)), |bits| bits as u32),
        None => 0,
    };
    let status = &device["status"];
    let found = Inverse3State {
        position: vector(&state["cursor_position"])?,
        velocity: vector(&state["cursor_velocity"]).unwrap_or_default(),
        orientation: match (vector(orientation), part(orientation, "w")) {
            (Some([x, y, z]), Some(w)) => [x, y, z, w],
            _ => Inverse3State::default().orientation,
        },
        buttons,
        // A flag that is absent counts as true.
        ready: ["calibrated", "ready"].iter().all(|flag| status[*flag].as_bool().unwrap_or(true)),
    };
    found.is_sound().then_some((number, found))
}

fn bits(held: impl Iterator<Item = bool>) -> u32 {
    held.take(32).zip(0..).fold(0, |bits, (held, bit)| bits | u32::from(held) << bit)
}

/// The message that commands a force, N, on a device.
pub fn force_message(device: &str, force: [f32; 3], dialect: Dialect) -> String {
    let [x, y, z] = force;
    let vector = json!({"x": x, "y": y, "z": z});
    let command = match dialect {
        Dialect::Vector => json!({"vector": vector}),
        Dialect::Values => json!({"values": vector}),
    };
    json!({"inverse3": [{"device_id": device, "commands": {"set_cursor_force": command}}]}).to_string()
}
