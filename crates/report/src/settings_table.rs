//! Settings of a session as readable rows.

use palpate::Settings;
use serde_json::Value;

/// Unit of each setting, by its group and field. Empty for numbers without a unit.
const UNITS: [(&str, &str); 35] = [
    ("timing.rate", "Hz"),
    ("tool.mass", "kg"),
    ("contact.response", ""),
    ("contact.stiffness", "N/m"),
    ("contact.damping", "N·s/m"),
    ("contact.friction", ""),
    ("contact.static_friction", ""),
    ("coupling.stiffness", "N/m"),
    ("coupling.damping", "N·s/m"),
    ("coupling.angular_stiffness", "N·m/rad"),
    ("coupling.angular_damping", "N·m·s/rad"),
    ("search.tolerance", "m"),
    ("search.method", ""),
    ("search.representative_error", "m"),
    ("detail.error", "m"),
    ("detail.interpolation", ""),
    ("detail.query_budget", "s"),
    ("search.clusters", ""),
    ("search.braking", ""),
    ("search.proxy", ""),
    ("textures.grid", "texels"),
    ("textures.half_size", "m"),
    ("textures.temperature", "m"),
    ("textures.backend", ""),
    ("tool.grasp", "m, quaternion"),
    ("tool.handle", ""),
    ("timing.contact_timeout", "s"),
    ("timing.engagement", "s"),
    ("device.workspace_scale", ""),
    ("device.frame", "m, quaternion"),
    ("device.clutch_button", ""),
    ("output.force_slew", "N/s"),
    ("output.torque_slew", "N·m/s"),
    ("output.passivity_controller", ""),
    ("tool.unusual_size", ""),
];

/// Returns a row per setting: label and value with unit.
pub(crate) fn rows(settings: &Settings) -> Vec<(String, String)> {
    let values = serde_json::to_value(settings).unwrap_or_default();
    UNITS
        .iter()
        .filter_map(|(name, unit)| {
            let value = name.split('.').try_fold(&values, |value, field| value.get(field))?;
            let label = name.replace('_', " ").replace('.', ": ");
            let shown = match value {
                Value::Null => "none".to_owned(),
                value => format!("{} {unit}", words(value)).trim_end().to_owned(),
            };
            Some((label, shown))
        })
        .collect()
}

/// Formats a JSON value as text.
fn words(value: &Value) -> String {
    match value {
        Value::Bool(true) => "on".to_owned(),
        Value::Bool(false) => "off".to_owned(),
        Value::Number(number) => number.as_f64().map_or_else(|| number.to_string(), short),
        Value::String(text) => text.clone(),
        Value::Array(values) => format!("({})", values.iter().map(words).collect::<Vec<_>>().join(", ")),
        Value::Object(fields) => {
            let fields: Vec<String> =
                fields.iter().map(|(name, value)| format!("{name} {}", words(value))).collect();
            fields.join(", ")
        }
        // An infinite limit is serialized as null.
        Value::Null => "none".to_owned(),
    }
}

/// Formats a number with at most six significant digits.
fn short(number: f64) -> String {
    format!("{number:.5e}").parse::<f64>().unwrap_or(number).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate::settings::CouplingSettings;

    #[test]
    fn each_setting_has_a_row() {
        let values = serde_json::to_value(Settings::default()).expect("JSON");
        let mut fields: Vec<String> = Vec::new();
        for (group, values) in values.as_object().expect("groups") {
            fields.extend(values.as_object().expect("fields").keys().map(|field| format!("{group}.{field}")));
        }
        for field in &fields {
            assert!(UNITS.iter().any(|(name, _)| name == field), "{field}: give its unit in UNITS");
        }
        assert_eq!(rows(&Settings::default()).len(), fields.len());
    }

    #[test]
    fn values_are_short_and_have_units() {
        let settings = Settings {
            coupling: CouplingSettings { stiffness: Some(1_234.567_89), ..CouplingSettings::default() },
            ..Settings::default()
        };
        let rows = rows(&settings);
        let value = |name: &str| &rows.iter().find(|(label, _)| label == name).expect(name).1;
        assert_eq!(value("timing: rate"), "1000 Hz");
        assert_eq!(value("coupling: stiffness"), "1234.57 N/m");
        assert_eq!(value("textures: grid"), "50 texels");
        assert_eq!(value("device: clutch button"), "none");
        assert_eq!(value("search: proxy"), "on");
    }
}
