//! Map of the device's port: where a session, with the device, is passive for whatever hand holds it.
//!
//! TODO

mod certificate;
mod driven;
mod multisine;
mod states;

use palpate::device::Emulation;

use super::grid::Plan;
use super::page::{Section, Table, row};
use certificate::Certificate;
use multisine::Design;
use states::Conditions;

pub fn map(plan: &Plan) -> Result<Section, String> {
    let sceneries = states::sceneries(plan)?;
    let states = states::draw(if plan.quick { 6 } else { 100 });
    let handle = Emulation::default().handle;
    let cases: Vec<(usize, Conditions)> = (0..states.len())
        .flat_map(|i| {
            [false, true].map(|encoders| {
                (
                    i,
                    Conditions {
                        delay: [0.0, 1e-3, 2e-3, 5e-3, 0.5e-3][i % 5],
                        encoders,
                        rate: [500.0, 50.0, 100.0, 1000.0][i % 4],
                        stiffness: None,
                    },
                )
            })
        })
        .collect();
    let found = plan.each("port", &cases, |(index, conditions)| {
        let start = std::time::Instant::now();
        let Some((mut session, about)) = states[*index].reach(&sceneries, conditions)? else {
            return Ok(None);
        };
        let t1 = start.elapsed();
        let design = Design { amplitude: if conditions.encoders { 2e-5 } else { 2e-6 }, sets: 1 };
        let response = multisine::measure(&mut session, &about, &design, *index as u64);
        let c = Certificate::of(&response, &handle, conditions.delay);
        eprintln!("{} {conditions:?} {:?} {:?} {:?} waited {} {:?} {:?}", sceneries[states[*index].scenery].name, t1, start.elapsed(), c, session.haptic().telemetry().events.waited, session.haptic().telemetry().contacts_now, session.cost());
        Ok(Some(c))
    })?;
    let rows = cases.iter().zip(&found).map(|(c, f)| row![c.0, c.1.delay, f.map_or(9.0, |f| f.least)]).collect();
    Ok(Section {
        title: "Port: passive for every hand",
        tables: vec![Table { name: "port".to_owned(), columns: vec!["state", "delay", "least"], rows }],
        ..Section::default()
    })
}
