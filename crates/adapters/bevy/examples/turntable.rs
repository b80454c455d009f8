//! Gear on a turntable, felt by an emulated hand that holds an ellipsoid against it. It opens no window, and
//! prints the forces.
//!
//! In an application with a window, the same plugins and components go beside Bevy's own plugins; how an
//! entity is drawn is up to it.
//!
//! `cargo run --release -p palpate-bevy --example turntable`

#![allow(clippy::print_stdout, reason = "it prints the forces")]

use std::time::{Duration, Instant};

use bevy_app::{App, AppExit, ScheduleRunnerPlugin, Startup, Update};
use bevy_ecs::prelude::*;
use bevy_math::Quat;
use bevy_transform::TransformPlugin;
use bevy_transform::components::Transform;
use palpate::device::{Emulation, IntendedPath};
use palpate::glam::DVec3;
use palpate::{HapticRenderer, Object, Pose, Twist};
use palpate_bevy::{Felt, Grasped, HapticContacts, HapticPlugins, Haptics};

const FRAME: Duration = Duration::from_millis(16);
const SECONDS: f64 = 6.0;
/// Angular velocity of the turntable, rad/s.
const SPEED: f32 = 1.0;

#[derive(Resource)]
struct Shape(Object);

#[derive(Component)]
struct Turntable;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let (probe, gear) = (Object::model("ellipsoid@500")?, Object::model("gear@5000")?);
    let rim = gear.clod.vertices.iter().map(|vertex| vertex.x).fold(0.0, f64::max);
    let reach = probe.clod.vertices.iter().map(|vertex| vertex.x).fold(0.0, f64::max);
    // The hand comes from the side, and presses on the teeth.
    let path = IntendedPath::function(move |time| {
        let gap = 0.008 - 0.012 * (time / 2.0).clamp(0.0, 1.0);
        (Pose::from_translation(DVec3::X * (rim + reach + gap)), Twist::ZERO)
    });
    let device = Emulation::default().open(path)?;
    let session = HapticRenderer::builder(probe).on(Box::new(device))?.spawn()?;
    App::new()
        .add_plugins((TransformPlugin, HapticPlugins, ScheduleRunnerPlugin::run_loop(FRAME)))
        .insert_resource(Haptics::new(session))
        .insert_resource(Shape(gear))
        .add_systems(Startup, set_up)
        .add_systems(Update, (turn, report))
        .run();
    Ok(())
}

fn set_up(mut commands: Commands, shape: Res<Shape>) {
    commands.spawn((Turntable, Felt::new(shape.0.clone())));
    commands.spawn(Grasped);
}

fn turn(mut turning: Query<&mut Transform, With<Turntable>>, mut begun: Local<Option<Instant>>) {
    let time = begun.get_or_insert_with(Instant::now).elapsed().as_secs_f32();
    for mut transform in &mut turning {
        transform.rotation = Quat::from_rotation_z(SPEED * time);
    }
}

fn report(
    mut haptics: ResMut<Haptics>,
    contacts: Res<HapticContacts>,
    grasped: Query<&Transform, With<Grasped>>,
    mut next: Local<f64>,
    mut exit: MessageWriter<AppExit>,
) {
    let Some(record) = haptics.session().latest().copied() else { return };
    if record.time >= *next {
        *next += 0.5;
        let place = grasped.iter().next().map_or(0.0, |transform| 1e3 * transform.translation.x);
        let [x, y, z] = record.coupling.force.to_array();
        let forces = contacts.forces.len();
        println!("{:4.1} s: held at {place:6.2} mm, {forces} forces, {x:7.3} {y:7.3} {z:7.3} N", record.time);
    }
    if record.time >= SECONDS {
        exit.write(AppExit::Success);
    }
}
