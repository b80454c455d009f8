//! Colliders of objects: their parts, and refused objects.

use std::io::Write as _;
use std::path::PathBuf;

use crate::session::{cuboid, model, vector, world};
use palpate::glam::DVec3;
use palpate::models::Model;
use palpate::{Object, OpenOptions, TriMesh};
use palpate_rapier::rapier3d::prelude::{RigidBodyBuilder, Vector};
use palpate_rapier::{ColliderError, solid_collider, surface_collider};

/// Drops an object onto a floor and checks that it rests there, no lower than f32 and rapier's slack (m)
/// allow.
fn rests_on_the_floor(object: &Object, level: usize, slack: f64) {
    let mut world = world(9.81);
    world.integration_parameters.dt = 5e-3;
    let floor = palpate_rapier::rapier3d::geometry::ColliderBuilder::cuboid(2.0, 2.0, 0.1);
    world.insert(RigidBodyBuilder::fixed(), floor.translation(Vector::new(0.0, 0.0, -0.1)));
    let surface: Vec<DVec3> =
        object.clod.leaves().iter().flat_map(|leaf| object.clod.hull(leaf)).copied().collect();
    let lowest = surface.iter().map(|v| v.z).fold(f64::INFINITY, f64::min);
    let start = Vector::new(0.0, 0.0, (1e-3 - lowest) as f32);
    let collider = solid_collider(object, level, 0.1).expect("a collider");
    let (body, _) = world.insert(RigidBodyBuilder::dynamic().translation(start), collider);
    for _ in 0..400 {
        world.step();
    }
    let pose = *world.bodies[body].position();
    let place = |v: &DVec3| (pose * Vector::new(v.x as f32, v.y as f32, v.z as f32)).z;
    let depth = surface.iter().map(place).fold(f32::INFINITY, f32::min);
    assert!(f64::from(depth) > -slack, "{} at level {level}: {depth} m", object.name);
    assert!(f64::from(depth) < 0.02, "{} at level {level}: {depth} m", object.name);
}

/// Every model that can have few triangles has, at its finest and at its coarsest level, the given mass, with
/// the mesh's distribution.
#[test]
fn models_become_solids() {
    for builtin in Model::ALL {
        let name = builtin.name();
        // The others take long to build.
        let Some(least) = (60..=1000).step_by(60).find(|count| builtin.generate(*count).is_ok()) else {
            continue;
        };
        let object = model(&format!("{name}@{least}"));
        let source = &object.clod.source;
        for level in [0, object.clod.levels.len() - 1] {
            let collider = solid_collider(&object, level, 0.3).expect("a collider").build();
            let properties = collider.mass_properties();
            assert!((properties.mass() - 0.3).abs() < 1e-6, "{name}: {} kg", properties.mass());
            let off = vector(properties.local_com).distance(source.center_of_mass);
            assert!(off < 1e-6 * source.bounding_radius, "{name}: {off} m");
            let parts = collider.shape().as_compound().map_or(0, |compound| compound.shapes().len());
            assert!(parts > 0 && parts <= object.clod.level(level).len(), "{name}: {parts} parts");
        }
        let surface = surface_collider(&object).expect("triangles").build();
        let triangles = surface.shape().as_trimesh().map_or(0, |mesh| mesh.indices().len());
        assert_eq!(triangles, source.triangles as usize, "{name}");
        assert_eq!(surface.mass_properties().mass(), 0.0);
    }
}

#[test]
fn solids_rest_on_a_floor() {
    for name in ["golf-ball@2000", "gear@2000", "cup@2000", "hammer@2000"] {
        let object = model(name);
        rests_on_the_floor(&object, 0, 5e-4);
        // A coarse hull may leave out parts that stand on the floor.
        rests_on_the_floor(&object, object.clod.levels.len() - 1, 0.05 * object.bounding_radius());
    }
}

#[test]
fn a_box_becomes_a_box() {
    let size = DVec3::new(0.06, 0.04, 0.02);
    let collider = solid_collider(&cuboid(size), 0, 1.0).expect("a collider").build();
    let compound = collider.shape().as_compound().expect("a compound");
    assert_eq!(compound.shapes().len(), 1);
    let half = compound.shapes()[0].1.as_cuboid().expect("a box").half_extents;
    assert!((vector(half) * 2.0 - size).length() < 1e-8);
}

#[test]
fn an_object_that_is_not_a_solid_is_refused() {
    let cube = cuboid(DVec3::splat(0.04));
    for mass in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-60, 1e60] {
        assert!(matches!(solid_collider(&cube, 0, mass), Err(ColliderError::Mass { .. })), "{mass}");
    }
    let last = cube.clod.levels.len() - 1;
    assert!(matches!(solid_collider(&cube, last + 1, 1.0), Err(ColliderError::Level { .. })));
    let corners = vec![DVec3::ZERO, DVec3::X * 0.1, DVec3::Y * 0.1];
    let mesh = TriMesh::new(corners, vec![[0, 1, 2]]).expect("a mesh");
    let sheet = Object::from_mesh("sheet", &mesh).expect("a hierarchy");
    let error = solid_collider(&sheet, 0, 1.0).expect_err("it is open");
    assert!(error.to_string().contains("sheet"), "{error}");
    let _ = surface_collider(&sheet).expect("a triangle");
    let tiny = cube.scaled(1e-12).expect("smaller");
    let _ = solid_collider(&tiny, 0, 1.0);
}

/// On the optional real meshes.
#[test]
fn real_meshes_become_solids() {
    for name in ["nut_m16.obj"] {
        let file =
            PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../../shared/models/good")).join(name);
        if !file.exists() {
            let _ = writeln!(std::io::stderr(), "skipped: {} is absent", file.display());
            continue;
        }
        let options = OpenOptions { cache: false, repair: true, ..OpenOptions::default() };
        let path = file.to_string_lossy();
        let object = Object::open(&path, &options, &mut palpate::clod_build::unwatched).expect(name);
        assert!(object.clod.source.solid, "{name}");
        rests_on_the_floor(&object, 0, 5e-4);
        let _ = surface_collider(&object).expect("triangles");
    }
}
