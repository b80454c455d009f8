//! Formatting of quantities: three significant digits, and a suitable prefix of the unit.

/// Number of significant digits.
const DIGITS: i32 = 3;

/// Prefixes and their factors, smallest first.
const PREFIXES: [(&str, f64); 6] = [("n", 1e-9), ("µ", 1e-6), ("m", 1e-3), ("", 1.0), ("k", 1e3), ("M", 1e6)];

/// Formats a quantity in the unit `unit`, with the prefix that leaves one to three digits before the point.
pub(crate) fn quantity(value: f64, unit: &str) -> String {
    with_prefixes(value, unit, &PREFIXES)
}

/// Formats a length given in metres: in millimetres, unless it is much smaller or larger.
pub(crate) fn length(metres: f64) -> String {
    let size = metres.abs();
    match size {
        size if (1e-5..1.0).contains(&size) => format!("{} mm", digits(1e3 * metres)),
        _ => quantity(metres, "m"),
    }
}

/// Formats a force given in newtons: without a prefix, unless it is much smaller or larger.
pub(crate) fn force(newtons: f64) -> String {
    if (1e-2..1e3).contains(&newtons.abs()) {
        format!("{} N", digits(newtons))
    } else {
        quantity(newtons, "N")
    }
}

/// Formats a rate given in Hz.
pub(crate) fn rate(hertz: f64) -> String {
    quantity(hertz, "Hz")
}

/// Formats a number with three significant digits.
pub(crate) fn digits(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return if value == 0.0 { "0".to_owned() } else { value.to_string() };
    }
    let decimals = (DIGITS - 1 - magnitude(value)).max(0) as usize;
    format!("{value:.decimals$}")
}

/// Returns the power of ten of the first digit, after rounding to three digits.
fn magnitude(value: f64) -> i32 {
    let exponent = value.abs().log10().floor() as i32;
    let unit = 10.0_f64.powi(exponent - DIGITS + 1);
    if (value.abs() / unit).round() >= 10.0_f64.powi(DIGITS) { exponent + 1 } else { exponent }
}

fn with_prefixes(value: f64, unit: &str, prefixes: &[(&str, f64)]) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{} {unit}", digits(value));
    }
    let power = magnitude(value);
    let fits = |factor: f64| factor.log10().round() as i32 <= power;
    let chosen = prefixes.iter().rev().find(|(_, factor)| fits(*factor)).or(prefixes.first());
    let (prefix, factor) = chosen.copied().unwrap_or(("", 1.0));
    format!("{} {prefix}{unit}", digits(value / factor))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantities_have_three_digits_and_a_suitable_prefix() {
        for (value, unit, expected) in [
            (16_975e-9, "s", "17.0 µs"),
            (999.96e-6, "s", "1.00 ms"),
            (0.4123, "s", "412 ms"),
            (10.0, "s", "10.0 s"),
            (1000.0, "Hz", "1.00 kHz"),
            (873.4, "Hz", "873 Hz"),
            (0.0, "N", "0 N"),
            (-0.001_234, "J", "-1.23 mJ"),
            (3e-13, "J", "0.000300 nJ"),
            (2.5e7, "N/m", "25.0 MN/m"),
            (f64::NAN, "s", "NaN s"),
        ] {
            assert_eq!(quantity(value, unit), expected);
        }
    }

    #[test]
    fn lengths_are_in_millimetres_and_forces_in_newtons() {
        for (metres, expected) in [
            (4.3e-4, "0.430 mm"),
            (3.8e-3, "3.80 mm"),
            (0.25, "250 mm"),
            (1.5, "1.50 m"),
            (1e-5, "0.0100 mm"),
            (2.34e-7, "234 nm"),
            (0.0, "0 m"),
        ] {
            assert_eq!(length(metres), expected);
        }
        assert_eq!([0.689, 12.34, 0.000_5, 0.0].map(force), ["0.689 N", "12.3 N", "500 µN", "0 N"]);
    }
}
