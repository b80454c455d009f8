//! An emulated hand puts a peg of 8 mm into a hole with 0.05 mm of clearance, aslant and trembling, and the
//! example prints how far it went in and what was felt.
//!
//! `cargo run --release --example peg_in_hole`, on a simulated clock; `-- --tilt 0` holds the peg upright,
//! `-- --tremor 0` steadily. A row per step goes to `target/peg_in_hole/recording.csv`.

use std::error::Error;
use std::path::PathBuf;

use palpate::device::{Emulation, Hand, IntendedPath};
use palpate::glam::{DQuat, DVec3};
use palpate::{HandlePlacement, Pose, Twist};
use palpate_examples::{CommandLine, assembly, open_all, say, smooth};

const HELP: [&str; 4] = [
    "--tilt DEGREES Tilt at which the hand holds the peg [default: 2]",
    "--tremor MM    Tremor of the hand to each side at 8 Hz [default: 0.3]",
    "--friction MU  Coefficient of friction [default: 0.1]",
    "--output DIR   Write the recording there [default: target/peg_in_hole]",
];

/// Height of the tip over the mouth at the start, and depth that the hand means to reach, m.
const ABOVE: f64 = 3e-3;
const INSERTION: f64 = 12e-3;
/// Time in which the hand lowers the peg, and length of the session, s.
const LOWERED: f64 = 1.5;
const SECONDS: f64 = 2.5;
/// Part of the depth from which the peg counts as inserted.
const INSERTED: f64 = 0.9;

fn main() -> Result<(), Box<dyn Error>> {
    let mut line = CommandLine::new("Puts a peg into a hole, and prints what is felt", &HELP);
    let tilt: f64 = line.value("--tilt", 2.0)?;
    let tremor: f64 = line.value("--tremor", 0.3)?;
    let friction = line.value("--friction", 0.1)?;
    let output = line.value("--output", PathBuf::from("target/peg_in_hole"))?;
    line.finish()?;
    let [peg, hole] = open_all(["peg", "hole"])?;
    let settings = assembly::steel(&peg, friction);
    let hand = Hand { tremor: 1e-3 * tremor, ..Hand::GRIP };
    let emulation = Emulation { hand, ..Emulation::default() };

    // The hand turns the peg about its tip, which it means to move straight down.
    let placement = HandlePlacement::new(&settings, &peg, &emulation.specification);
    let rotation = DQuat::from_rotation_y(tilt.to_radians());
    let height = |time: f64| ABOVE - (ABOVE + INSERTION) * smooth(time / LOWERED);
    let path = IntendedPath::function(move |time| {
        let pose = placement.device_pose(&Pose::new(DVec3::Z * height(time), rotation));
        // A central difference is close enough for the hand's damper.
        let h = 1e-4;
        let rate = (height(time + h) - height(time - h)) / (2.0 * h);
        (pose, Twist::new(DVec3::Z * rate, DVec3::ZERO))
    });
    let records = assembly::render((&peg, &hole), (emulation, path), settings, SECONDS)?;
    if let Some(last) = records.last() {
        let depth = -last.object.translation.z;
        let word = if depth >= INSERTED * INSERTION { "inserted" } else { "not inserted" };
        say(word, format_args!("{:.2} mm deep of {:.0} mm", 1e3 * depth, 1e3 * INSERTION))?;
        let leaning = (last.object.rotation * DVec3::Z).angle_between(DVec3::Z).to_degrees();
        say("held at, leans by", format_args!("{tilt:.2}°, {leaning:.2}° in the end"))?;
        let force = last.coupling.force;
        say(
            "force in the end",
            format_args!("{:.2} N up, {:.2} N sideways", force.z, force.truncate().length()),
        )?;
    }
    assembly::report(&peg, &hole, &records)?;
    assembly::write(&output, &records)
}
