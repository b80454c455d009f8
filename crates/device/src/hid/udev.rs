//! udev rules that permit opening HID devices on Linux.

use std::fmt::Write as _;

use super::known;

/// udev rules that let the user at the machine open the devices that have a driver here, for a file such as
/// `/etc/udev/rules.d/70-palpate.rules`.
pub fn udev_rules() -> String {
    let mut rules = String::from(
        "# Haptic devices and 3D mice that palpate drives: whoever sits at the machine may open them.\n\
         # Put this in /etc/udev/rules.d/70-palpate.rules, run `udevadm control --reload`, and plug the device in again.\n",
    );
    for (vendor, product, name, _) in known() {
        // Over Bluetooth, only the parent's name has the numbers.
        let device = if name.contains("Bluetooth") {
            format!("KERNELS==\"0005:{vendor:04X}:{product:04X}.*\"")
        } else {
            format!("ATTRS{{idVendor}}==\"{vendor:04x}\", ATTRS{{idProduct}}==\"{product:04x}\"")
        };
        // Writing to a String cannot fail.
        let _ = writeln!(rules, "# {name}\nKERNEL==\"hidraw*\", {device}, TAG+=\"uaccess\"");
    }
    rules
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rules_are_those_that_ship() {
        let shipped = include_str!("../../udev/70-palpate.rules");
        assert_eq!(
            udev_rules(),
            shipped,
            "write them anew: `palpate devices --udev > crates/device/udev/70-palpate.rules`"
        );
        assert!(shipped.contains("046d") && shipped.contains("16c0"));
    }
}
