//! Check of HID devices: whether the current user may open them.

use palpate::device::hid::{PluggedIn, plugged_in};

use super::finding::{Finding, Verdict};

const NAME: &str = "HID devices";
const RULES: &str = "let your user open them: `palpate devices --udev | sudo tee /etc/udev/rules.d/70-palpate.rules`, then \
                     `sudo udevadm control --reload`, and plug them in again";

pub fn finding() -> Finding {
    verdict_on(&plugged_in())
}

fn verdict_on(devices: &[PluggedIn]) -> Finding {
    if devices.is_empty() {
        let seen = "no device with a palpate driver is plugged in".to_owned();
        return Finding::new(NAME, Verdict::Unknown, seen).with_remedy(
            "plug one in and switch it on, or use `--device emulated`; the udev rules for permission to open one are \
             printed by `palpate devices --udev`",
        );
    }
    let refused = devices.iter().filter(|device| device.refusal.is_some()).count();
    let seen: Vec<String> = devices
        .iter()
        .map(|device| match &device.refusal {
            None => format!("{} ({}) can be opened", device.name, device.address),
            Some(refusal) => format!("{}: {refusal}", device.address),
        })
        .collect();
    let verdict = match refused {
        0 => Verdict::Good,
        refused if refused < devices.len() => Verdict::CouldBeBetter,
        _ => Verdict::Bad,
    };
    let finding = Finding::new(NAME, verdict, seen.join("; "));
    if refused > 0 { finding.with_remedy(RULES) } else { finding }
}

#[cfg(test)]
mod tests {
    use palpate::device::DeviceError;

    use super::*;

    #[test]
    fn verdicts_follow_which_devices_open() {
        let device = |address: &str, opens: bool| PluggedIn {
            address: address.to_owned(),
            name: "Knob",
            refusal: (!opens).then_some(DeviceError::Closed),
        };
        assert_eq!(verdict_on(&[]).verdict, Verdict::Unknown);
        assert_eq!(verdict_on(&[device("hid:1:1", true)]).verdict, Verdict::Good);
        let one = verdict_on(&[device("hid:1:1", true), device("hid:2:2", false)]);
        assert_eq!(one.verdict, Verdict::CouldBeBetter);
        assert!(one.measured.contains("Knob (hid:1:1) can be opened; hid:2:2: "), "{one:?}");
        assert!(one.remedy.is_some_and(|remedy| remedy.contains("devices --udev")));
        assert_eq!(verdict_on(&[device("hid:2:2", false)]).verdict, Verdict::Bad);
    }
}
