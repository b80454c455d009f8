//! `palpate devices`.

use crate::arguments::DevicesArguments;
use crate::failure::Failure;
use crate::output;

pub fn run(arguments: &DevicesArguments) -> Result<(), Failure> {
    let devices = palpate::device::list();
    output::result(&arguments.json, &devices, |table| {
        for device in &devices {
            table.row([&device.address, &device.description]);
        }
    })
}
