//! An emulated hand turns a nut M16 on a bolt by four turns and off again, and the example prints how far
//! the nut went in a turn and what was felt.
//!
//! `cargo run --release --example nut_on_bolt`, on a simulated clock; `-- --turn-rate 2` turns faster,
//! `-- --friction 0` without friction. A row per step goes to `target/nut_on_bolt/recording.csv`.

use std::error::Error;
use std::f64::consts::TAU;
use std::path::PathBuf;

use palpate::device::{Emulation, IntendedPath, Task, TaskParameters, TaskSite};
use palpate::glam::DVec3;
use palpate::models::MetricThread;
use palpate::{HandlePlacement, Record};
use palpate_examples::{CommandLine, assembly, open_all, say};

const HELP: [&str; 3] = [
    "--turn-rate R  Turns a second [default: 1]",
    "--friction MU  Coefficient of friction [default: 0.15]",
    "--output DIR   Write the recording there [default: target/nut_on_bolt]",
];

/// Number of turns on and off, and those after which the chamfers of nut and bolt leave a full turn of
/// thread.
const TURNS: f64 = 4.0;
const ENGAGED: f64 = 2.0;

fn main() -> Result<(), Box<dyn Error>> {
    let mut line = CommandLine::new("Turns a nut on a bolt and off, and prints what is felt", &HELP);
    let turn_rate = line.value("--turn-rate", 1.0)?;
    let friction = line.value("--friction", 0.15)?;
    let output = line.value("--output", PathBuf::from("target/nut_on_bolt"))?;
    line.finish()?;
    let [nut, bolt] = open_all(["nut@7000", "bolt@12000"])?;
    let thread = MetricThread::M16;
    let hand = TaskParameters { turns: TURNS, turn_rate, pitch: thread.pitch, ..TaskParameters::default() };
    let settings = assembly::steel(&nut, friction);
    let emulation = Emulation::default();

    // The nut comes down from above the bolt's end.
    let touch = DVec3::Z * (thread.bolt_length() + 0.5 * thread.nut_height());
    let site = TaskSite { touch, pivot: DVec3::ZERO, size: thread.diameter };
    let placement = HandlePlacement::new(&settings, &nut, &emulation.specification);
    let seconds = hand.cycle(Task::TurnNut);
    let path =
        IntendedPath::cycle(seconds, |time| placement.device_pose(&hand.pose(Task::TurnNut, time, &site)))?;
    let records = assembly::render((&nut, &bolt), (emulation, path), settings, seconds)?;
    tell(&records, &hand, thread.pitch)?;
    let end = records.last().map_or(0.0, |last| last.object.translation.z);
    let off = if end > touch.z { "off the bolt" } else { "still on the bolt" };
    say("in the end the nut is", format_args!("{off}, {:.2} mm above first touch", 1e3 * (end - touch.z)))?;
    assembly::report(&nut, &bolt, &records)?;
    assembly::write(&output, &records)
}

/// Prints how far the nut was turned, and its travel in a turn, on and off.
fn tell(records: &[Record], hand: &TaskParameters, pitch: f64) -> std::io::Result<()> {
    let [on, turned_on, off, turned_off] = hand.turning();
    let engaging = ENGAGED / hand.turn_rate;
    for (name, from, to) in [("on", on + engaging, turned_on), ("off", off, turned_off - engaging)] {
        let part: Vec<&Record> = records.iter().filter(|record| (from..to).contains(&record.time)).collect();
        let turns = part
            .windows(2)
            .map(|pair| pair[0].object.rotation_vector_to(&pair[1].object).z / TAU)
            .sum::<f64>();
        let (Some(first), Some(last)) = (part.first(), part.last()) else { continue };
        let travel = last.object.translation.z - first.object.translation.z;
        let torque = part.iter().map(|record| record.coupling.torque.z).sum::<f64>() / part.len() as f64;
        say(
            &format!("turned {name}, once engaged"),
            format_args!(
                "{:.2} turns, {:.2} mm: {:.3} mm a turn ({:+.1} % off the pitch), {:.1} mN·m",
                turns.abs(),
                1e3 * travel.abs(),
                1e3 * travel / turns,
                100.0 * (travel / turns / pitch - 1.0),
                1e3 * torque.abs()
            ),
        )?;
    }
    Ok(())
}
