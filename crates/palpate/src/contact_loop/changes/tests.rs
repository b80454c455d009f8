use std::sync::Arc;

use palpate_core::glam::DVec2;
use palpate_core::mesh::UvMesh;
use palpate_core::{Clod, TriMesh};
use palpate_dynamics::{Body, ContactParameters, Friction};
use palpate_texture_pd::{HeightImage, Wrap};

use super::*;
use crate::constraints::test_meshes;
use crate::contact_loop::{ByLevels, ContactUpdate};
use crate::scene::Placed;
use crate::settings::{ContactSettings, SearchSettings, Settings};

const DOWN: Pose = Pose::from_translation(DVec3::new(0.0, 0.0, -0.0101));

/// A box of 1 cm.
fn block(name: &str) -> Object {
    Object::from_mesh(name, &test_meshes::block(DVec3::splat(0.01))).expect("a box")
}

fn sheet_mesh() -> TriMesh {
    let corners = vec![DVec3::ZERO, DVec3::X * 0.01, DVec3::Y * 0.01];
    TriMesh::new(corners, vec![[0, 1, 2]]).expect("a mesh")
}

/// A sheet, whose surface is open.
fn sheet() -> Object {
    Object::from_mesh("sheet", &sheet_mesh()).expect("a sheet")
}

/// An object with a texture that moves its surface outwards by 0.15 mm.
fn textured(name: &str, mesh: TriMesh) -> Object {
    let mesh = UvMesh::projected(mesh, |corner| DVec2::new(corner.x, corner.y) / 0.01).expect("a mesh");
    let image = HeightImage::new(2, 2, vec![1.5e-4; 4], [Wrap::Clamp; 2]).expect("an image");
    Object::textured(name, &mesh, &image, 1.0).expect("a textured object")
}

/// A box whose hierarchy has lost its triangles: there is no surface that a texture could touch.
fn hollow() -> Object {
    let mut clod = Clod::clone(&block("hollow").clod);
    clod.levels[0].nodes = 0..0;
    Object::from_clod("hollow", clod)
}

/// A contact loop of a box on a box.
fn on_a_block(search: ContactSearch, response: Response) -> ContactLoop {
    with_probe(&block("probe"), search, response)
}

/// The same of another object on a box.
fn with_probe(probe: &Object, search: ContactSearch, response: Response) -> ContactLoop {
    let settings = Settings {
        search: SearchSettings { method: search, ..SearchSettings::default() },
        contact: ContactSettings { response, ..ContactSettings::default() },
        ..Settings::default()
    };
    let body = Body::new(0.1, probe.clod.source.unit_inertia * 0.1).expect("a body");
    let parameters =
        ContactParameters { stiffness: 1000.0, damping: 1.0, tolerance: 2e-4, friction: Friction::NONE };
    let scene = [Placed { object: block("floor"), pose: DOWN }];
    let center = probe.clod.source.center_of_mass;
    ContactLoop::new(probe, body, center, &scene, parameters, &settings).expect("a loop")
}

/// A step at a time (s) with the probe where it begins.
fn step(contact: &mut ContactLoop, time: f64) -> ContactUpdate {
    contact.step(&BodyState::at_rest(Pose::IDENTITY), time)
}

fn near(update: &ContactUpdate) -> usize {
    update.geometry.as_ref().map_or(0, |geometry| geometry.objects.len())
}

/// No field is read for constraints: they took seconds to make before the first touch, and most of a
/// session's memory.
#[test]
fn fields_are_made_for_penalties_alone() {
    let search = |contact: &ContactLoop| contact.search().map_err(Clone::clone);
    let mut contact = on_a_block(ContactSearch::Automatic, Response::Constraints);
    let with_constraints = contact.workspace_bytes();
    assert_eq!(search(&contact), Err(ByLevels::Constraints));
    contact.use_penalties();
    let penalties = search(&on_a_block(ContactSearch::Automatic, Response::Penalty));
    assert!(penalties.is_ok(), "{penalties:?}");
    assert_eq!(search(&contact), penalties);
    assert!(contact.workspace_bytes() > with_constraints + 1_000_000, "fields take memory");
    // By the setting they are made all the same; without a surface there are no constraints.
    assert!(search(&on_a_block(ContactSearch::Representatives, Response::Constraints)).is_ok());
    let lost = search(&with_probe(&hollow(), ContactSearch::Automatic, Response::Constraints));
    assert!(!matches!(lost, Err(ByLevels::Constraints)), "{lost:?}");
}

/// The new object was put in after the old one was deleted, so that nothing was left of both.
#[test]
fn a_replacement_that_is_refused_leaves_the_object_as_it_was() {
    let mut contact = on_a_block(ContactSearch::Representatives, Response::Constraints);
    let mut editor = contact.editor();
    let floor = SceneId(0);
    let body = DynamicBody {
        mass: 1e3,
        inertia: palpate_core::glam::DMat3::from_diagonal(DVec3::splat(1.0)),
        center_of_mass: DVec3::ZERO,
        gravity: DVec3::ZERO,
        period: 1e-3,
    };
    editor.set_dynamics(floor, Some(body)).expect("room");
    assert_eq!(near(&step(&mut contact, 0.0)), 1);
    editor.replace(floor, &sheet(), DOWN).expect("room");
    assert_eq!(near(&step(&mut contact, 1e-3)), 1, "the floor is gone");
    assert_eq!(contact.telemetry().events.edit_refused, 1);
    let kept = contact.scene.iter().next().expect("the floor");
    assert_eq!((kept.id, kept.object.name.as_str()), (floor, "floor"));
    let is_moved = kept.moving.as_ref().is_some_and(|moving| moving.0.center_of_mass().is_some());
    assert!(is_moved && contact.scene.moving.len() == 1, "its dynamics are kept");
    // One that is not refused takes its place, with its dynamics; and it can still be moved and removed.
    editor.replace(floor, &block("other"), DOWN).expect("room");
    assert_eq!(near(&step(&mut contact, 2e-3)), 1);
    let kept = contact.scene.iter().next().expect("the other one");
    let is_moved = kept.moving.as_ref().is_some_and(|moving| moving.0.center_of_mass().is_some());
    assert!(kept.object.name == "other" && is_moved && contact.scene.moving.len() == 1);
    editor.remove(floor).expect("known");
    assert_eq!((near(&step(&mut contact, 3e-3)), contact.scene.moving.len()), (0, 0));
    // An object that is refused leaves nothing behind.
    editor.add(&sheet(), DOWN).expect("room");
    assert_eq!(near(&step(&mut contact, 4e-3)), 0);
    assert_eq!(contact.scene.iter().count(), 0);
    assert_eq!(contact.telemetry().events.edit_refused, 2);
}

/// The new object is refused for its texture, and for its field after the texture was made. Either way the
/// old one is felt as before.
#[test]
fn a_replacement_with_a_texture_that_is_refused_leaves_the_object_as_it_was() {
    let floor = SceneId(0);
    for (probe, search, refused) in [
        (textured("probe", test_meshes::block(DVec3::splat(0.01))), ContactSearch::Levels, hollow()),
        (block("probe"), ContactSearch::Representatives, textured("sheet", sheet_mesh())),
    ] {
        let mut contact = with_probe(&probe, search, Response::Penalty);
        let mut time = 0.0;
        let mut felt = |contact: &mut ContactLoop| {
            // The proxy settles.
            let mut updates = (0..5).map(|_| {
                time += 1e-3;
                step(contact, time)
            });
            let last = updates.next_back().expect("steps");
            let wrench = last.model.wrench(&BodyState::at_rest(Pose::IDENTITY));
            (last.depth, wrench.force, contact.search().is_ok(), contact.texture_backend().map(str::to_owned))
        };
        let before = felt(&mut contact);
        assert!(before.1.z > 0.01, "{before:?}");
        let mut editor = contact.editor();
        editor.replace(floor, &refused, DOWN).expect("room");
        let after = felt(&mut contact);
        assert_eq!(contact.telemetry().events.edit_refused, 1);
        let kept = contact.scene.iter().next().expect("the floor");
        assert_eq!((kept.id, kept.object.name.as_str()), (floor, "floor"));
        let is_as_before = after.1.distance(before.1) < 1e-9 && (after.0 - before.0).abs() < 1e-12;
        assert!(is_as_before && (after.2, &after.3) == (before.2, &before.3), "{after:?}, {before:?}");
        // It can be replaced and removed all the same.
        let other = textured("other", test_meshes::block(DVec3::splat(0.01)));
        editor.replace(floor, &other, DOWN).expect("room");
        let other = felt(&mut contact);
        assert!(other.1.z > 0.01 && other.3.is_some(), "{other:?}");
        editor.remove(floor).expect("known");
        assert_eq!(felt(&mut contact).1, DVec3::ZERO);
        assert_eq!(contact.telemetry().events.edit_refused, 1);
    }
}

/// The features of a large surface take longer than many contact steps.
#[test]
fn contact_steps_find_added_objects_prepared() {
    for search in [ContactSearch::Levels, ContactSearch::Representatives] {
        let mut contact = on_a_block(search, Response::Constraints);
        let mut editor = contact.editor();
        let (added, replaced) = (block("added"), block("replaced"));
        assert!(added.known_features().is_none(), "nothing is made before it is needed");
        editor.add(&added, Pose::from_translation(DVec3::Z * 0.0101)).expect("room");
        editor.replace(SceneId(0), &replaced, DOWN).expect("room");
        let made = [&added, &replaced].map(|object| object.known_features().expect("made by the editor"));
        let update = step(&mut contact, 0.0);
        let found: Vec<_> = update.geometry.iter().flat_map(|geometry| &geometry.objects).collect();
        assert_eq!(found.len(), 2);
        assert!(found.iter().all(|near| made.iter().any(|made| Arc::ptr_eq(made, &near.surface))));
    }
    // Penalties need none, until the settings ask for constraints.
    let mut contact = on_a_block(ContactSearch::Levels, Response::Penalty);
    let mut editor = contact.editor();
    let added = block("added");
    editor.add(&added, DOWN).expect("room");
    assert!(added.known_features().is_none());
    editor.prepare_constraints();
    let of_floor = contact.scene.iter().next().and_then(|floor| floor.object.known_features());
    assert!(added.known_features().is_some() && of_floor.is_some());
}

/// What the haptic loop holds is freed here, after it has let go.
#[test]
fn surfaces_of_removed_objects_are_kept_until_the_haptic_loop_lets_go() {
    let mut contact = on_a_block(ContactSearch::Levels, Response::Constraints);
    let mut editor = contact.editor();
    let update = step(&mut contact, 0.0);
    let surface = |update: &ContactUpdate| {
        let near = update.geometry.as_ref().and_then(|geometry| geometry.objects.first());
        near.map(|near| Arc::downgrade(&near.surface))
    };
    let surface = surface(&update).expect("the floor is near");
    // As the haptic loop does, which holds what it has copied.
    let held = update.geometry.clone();
    drop(update);
    editor.remove(SceneId(0)).expect("known");
    for count in 1..=3 {
        drop(step(&mut contact, 1e-3 * f64::from(count)));
        assert_eq!((surface.strong_count(), contact.scene.on_loan.len()), (2, 1), "held by the two loops");
    }
    drop(held);
    assert_eq!(surface.strong_count(), 1, "the haptic loop was not the last one");
    drop(step(&mut contact, 1.0));
    assert_eq!((surface.strong_count(), contact.scene.on_loan.len()), (0, 0));
}
