//! `palpate devices`.

use std::io::{Write as _, stdout};

use crate::arguments::DevicesArguments;
use crate::failure::Failure;
use crate::output;

pub fn run(arguments: &DevicesArguments) -> Result<(), Failure> {
    if arguments.udev {
        return stdout()
            .lock()
            .write_all(palpate::device::hid::udev_rules().as_bytes())
            .map_err(|error| Failure::printing(&error));
    }
    let devices = palpate::device::list();
    output::result(&arguments.json, &devices, |table| {
        for device in &devices {
            table.row([&device.address, &device.description]);
        }
    })
}
