//! The log of a session holds its records and contacts.

use std::collections::BTreeMap;
use std::sync::atomic::AtomicBool;

use palpate::device::{Emulation, Task};
use palpate::glam::DVec3;
use palpate::{
    ContactForce, ContactSnapshot, ContactTiming, HapticRenderer, Object, Pose, Record, Scene, SceneId,
    Settings, TouchingPatches, explore,
};
use palpate_rerun::re_sdk::log::{Chunk, LogMsg};
use palpate_rerun::re_sdk::sink::MemorySinkStorage;
use palpate_rerun::re_sdk::{RecordingStreamBuilder, Timeline};
use palpate_rerun::{ARROW, LogError, SessionLog, TIMELINE};
use re_sdk_types::archetypes::{Arrows3D, Clear, Mesh3D, Scalars, Transform3D};

/// Returns the logged chunks, by entity.
fn chunks(storage: &MemorySinkStorage) -> BTreeMap<String, Vec<Chunk>> {
    let mut chunks: BTreeMap<String, Vec<Chunk>> = BTreeMap::new();
    for message in storage.take() {
        if let LogMsg::ArrowMsg(_, message) = message {
            let chunk = Chunk::from_arrow_msg(&message).expect("a chunk");
            chunks.entry(chunk.entity_path().to_string()).or_default().push(chunk);
        }
    }
    chunks
}

/// Returns the times of an entity's rows, ns, with a component of it as slices.
fn rows<const N: usize>(
    chunks: &[Chunk],
    component: palpate_rerun::re_sdk::ComponentDescriptor,
) -> Vec<(i64, Vec<[f32; N]>)> {
    let timeline = Timeline::new_duration(TIMELINE);
    let of_chunk = |chunk: &Chunk| {
        let times = chunk
            .iter_component_indices(*timeline.name(), component.component)
            .map(|(time, _)| time.as_i64());
        let values = chunk.iter_slices::<[f32; N]>(component.component).map(<[[f32; N]]>::to_vec);
        times.zip(values).collect::<Vec<_>>()
    };
    chunks.iter().flat_map(of_chunk).collect()
}

fn nanoseconds(time: f64) -> i64 {
    (1e9 * time).round() as i64
}

fn log_of(probe: &Object, scene: &Scene) -> (SessionLog, MemorySinkStorage) {
    let (stream, storage) = RecordingStreamBuilder::new("test").memory().expect("a stream");
    (SessionLog::new(stream, probe, scene).expect("a log"), storage)
}

#[test]
fn every_step_is_logged_as_it_was() {
    let probe = Object::model("ellipsoid@500").expect("the probe");
    let scene = Scene::new().with(Object::model("golf-ball@2000").expect("a ball"), Pose::IDENTITY);
    let path = explore::path(Task::default(), &probe, &scene).expect("a path");
    let device = Emulation::default().open(path).expect("a device");
    let mut renderer =
        HapticRenderer::new(probe.clone(), scene.clone(), Box::new(device), Settings::default())
            .expect("a session");
    let mut contacts = renderer.contact_monitor();
    let (mut log, storage) = log_of(&probe, &scene);
    let mut records: Vec<Record> = Vec::new();
    let ran = renderer.run_lockstep(4.0, ContactTiming::busy(500.0), &AtomicBool::new(false), |record| {
        records.push(*record);
        log.contacts(contacts.latest())?;
        log.record(record)
    });
    assert!(ran.is_ok());
    log.finish().expect("a finished log");
    let pressed = records.iter().filter(|record| record.contact.force.length() > 0.1).count();
    assert!(pressed > 100, "{pressed}");

    let logged = chunks(&storage);
    let poses = rows::<3>(&logged["/world/grasped"], Transform3D::descriptor_translation());
    assert_eq!(poses.len(), records.len());
    let turns = rows::<4>(&logged["/world/grasped"], Transform3D::descriptor_quaternion());
    let timeline = Timeline::new_duration(TIMELINE);
    let scalars = Scalars::descriptor_scalars().component;
    let forces: Vec<(i64, Vec<f64>)> = logged["/contact/force"]
        .iter()
        .flat_map(|chunk| {
            let times =
                chunk.iter_component_indices(*timeline.name(), scalars).map(|(time, _)| time.as_i64());
            times.zip(chunk.iter_slices::<f64>(scalars).map(<[f64]>::to_vec)).collect::<Vec<_>>()
        })
        .collect();
    assert_eq!((turns.len(), forces.len()), (records.len(), records.len()));
    for (record, ((pose, turn), force)) in records.iter().zip(poses.iter().zip(&turns).zip(&forces)) {
        assert_eq!((pose.0, turn.0, force.0), (nanoseconds(record.time), pose.0, pose.0));
        assert_eq!(pose.1, [record.object.translation.as_vec3().to_array()]);
        assert_eq!(turn.1, [record.object.rotation.as_quat().to_array()]);
        assert_eq!(force.1, record.contact.force.to_array());
    }
    // Complete meshes.
    for (entity, object) in
        [("/world/grasped", &probe), ("/world/scene/0 golf-ball@2000", &scene.objects()[0].object)]
    {
        let escaped = logged.keys().find(|name| name.replace('\\', "") == entity).expect("an entity");
        let triangles: usize = logged[escaped]
            .iter()
            .flat_map(|chunk| chunk.iter_slices::<[u32; 3]>(Mesh3D::descriptor_triangle_indices().component))
            .map(<[[u32; 3]]>::len)
            .sum();
        assert_eq!(triangles, object.clod.source.triangles as usize, "{entity}");
    }
    // Sixty snapshots a second of the contacts, with patches in contact while it presses.
    let pushes = rows::<3>(&logged["/world/pushes"], Arrows3D::descriptor_vectors());
    assert!((200..=240).contains(&pushes.len()), "{}", pushes.len());
    assert!(logged.keys().any(|name| name.starts_with("/world/scene") && name.ends_with("/touching")));
}

#[test]
fn arrows_end_where_they_push_and_contacts_end() {
    let probe = Object::model("ellipsoid@500").expect("the probe");
    let (mut log, storage) = log_of(&probe, &Scene::new());
    let mut sight = ContactSnapshot::default();
    log.contacts(&sight).expect("nothing is there before the first");
    let (point, force) = (DVec3::new(0.01, 0.02, 0.03), DVec3::new(0.0, 0.0, 3.0));
    let push = ContactForce { point, normal: -DVec3::Z, force, depth: 1e-3 };
    sight.time = 0.5;
    sight.forces.push(push);
    let leaf = probe.clod.levels[0].nodes.start;
    sight.patches.push(TouchingPatches { object: 7, probe_node: leaf, scene_node: 0, weight: 1.0 });
    log.contacts(&sight).expect("a look");
    // Too soon, and then over.
    sight.time = 0.501;
    log.contacts(&sight).expect("a look that is passed over");
    sight = ContactSnapshot { time: 0.6, ..ContactSnapshot::default() };
    log.contacts(&sight).expect("a look");
    log.finish().expect("a finished log");

    let logged = chunks(&storage);
    let arrows = &logged["/world/pushes"];
    let vectors = rows::<3>(arrows, Arrows3D::descriptor_vectors());
    let origins = rows::<3>(arrows, Arrows3D::descriptor_origins());
    assert_eq!(vectors.iter().map(|row| row.0).collect::<Vec<_>>(), [0.5, 0.6].map(nanoseconds));
    let (vector, origin) = (vectors[0].1[0], origins[0].1[0]);
    assert!((f64::from(vector[2]) - 3.0 * ARROW * probe.bounding_radius()).abs() < 1e-6);
    for axis in 0..3 {
        assert!((f64::from(origin[axis] + vector[axis]) - push.point[axis]).abs() < 1e-6);
    }
    assert!(vectors[1].1.is_empty());
    let touching = &logged["/world/grasped/touching"];
    let shown = touching.iter().filter(|chunk| {
        chunk
            .iter_slices::<[u32; 3]>(Mesh3D::descriptor_triangle_indices().component)
            .any(|triangles| !triangles.is_empty())
    });
    assert_eq!(shown.count(), 1);
    let cleared =
        |chunk: &Chunk| chunk.iter_slices::<bool>(Clear::descriptor_is_recursive().component).count();
    assert_eq!(touching.iter().map(cleared).sum::<usize>(), 1);
}

#[test]
fn objects_come_move_and_go() {
    let probe = Object::model("ellipsoid@500").expect("the probe");
    let (mut log, storage) = log_of(&probe, &Scene::new());
    let (id, unknown) = (SceneId(3), SceneId(4));
    let at = |x: f64| Pose::from_translation(DVec3::X * x);
    log.add(id, &probe, &at(0.1), 1.0).expect("an object");
    log.set_pose(id, &at(0.2), 1.5).expect("a pose");
    log.set_pose(unknown, &at(0.2), 1.5).expect("nothing");
    log.remove(id, 2.0).expect("an object less");
    log.set_pose(id, &at(0.3), 2.5).expect("nothing");
    log.finish().expect("a finished log");
    let logged = chunks(&storage);
    let mut of_scene = logged.iter().filter(|(name, _)| name.starts_with("/world/scene"));
    let (_, of_it) = of_scene.next().expect("an object");
    assert!(of_scene.next().is_none());
    let poses = rows::<3>(of_it, Transform3D::descriptor_translation());
    assert_eq!(poses, [(nanoseconds(1.0), vec![[0.1, 0.0, 0.0]]), (nanoseconds(1.5), vec![[0.2, 0.0, 0.0]])]);
    let cleared =
        |chunk: &Chunk| chunk.iter_slices::<bool>(Clear::descriptor_is_recursive().component).count();
    assert_eq!(of_it.iter().map(cleared).sum::<usize>(), 1);
}

/// A file contains the log even if nobody finishes it.
#[test]
fn a_log_that_is_dropped_is_in_its_file() -> Result<(), LogError> {
    let folder = tempfile::tempdir().expect("a folder");
    let probe = Object::model("ellipsoid@500").expect("the probe");
    let log_to = |name: &str, records: usize, finished: bool| {
        let file = folder.path().join(name);
        let stream = RecordingStreamBuilder::new("test").save(&file).expect("a file");
        let mut log = SessionLog::new(stream, &probe, &Scene::new())?;
        for step in 0..records {
            log.record(&record(1e-3 * step as f64))?;
        }
        if finished {
            log.finish()?;
        } else {
            drop(log);
        }
        Ok::<u64, LogError>(std::fs::metadata(&file).expect("a file").len())
    };
    let (none, dropped) = (log_to("none.rrd", 0, true)?, log_to("dropped.rrd", 100, false)?);
    let finished = log_to("finished.rrd", 100, true)?;
    assert!(
        none < dropped && finished.abs_diff(dropped) < finished / 10,
        "{none}, {dropped} and {finished} bytes"
    );
    Ok(())
}

fn record(time: f64) -> Record {
    Record {
        time,
        device: Pose::IDENTITY,
        handle: Pose::IDENTITY,
        object: Pose::IDENTITY,
        coupling: palpate::Wrench::ZERO,
        contact: palpate::Wrench::ZERO,
        depth: 0.0,
        contacts: 0,
        model_age: f64::NAN,
    }
}
