//! Shared by the integration tests: optional test data, built-in models, and brute-force oracles.

pub mod brute_force;
pub mod close_pairs;
pub mod faulty_wire;
mod free_body;
pub mod levels;
pub mod random_tree;
pub mod triangle_tree;

/// README, whose example is a test here: a published package does not contain the file.
#[cfg(doctest)]
#[doc = include_str!("../../README.md")]
struct Readme;

use std::collections::{BTreeMap, HashMap};
use std::io::Write as _;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, OnceLock};

use palpate::clod_build::unwatched;
use palpate::collide::{ContactQuery, QuerySettings};
use palpate::core::Clod;
use palpate::core::mesh::UvMesh;
use palpate::glam::{DVec2, DVec3};
use palpate::mesh_io::{LoadOptions, load};
use palpate::models::Model;
use palpate::settings::{ContactSettings, Response};
use palpate::texture_pd::{HeightImage, Wrap};
use palpate::{Object, OpenOptions, Pose, Settings, TriMesh};

pub use free_body::FreeBody;

/// The default settings, with penalty contacts.
pub fn penalties() -> Settings {
    Settings {
        contact: ContactSettings { response: Response::Penalty, ..ContactSettings::default() },
        ..Settings::default()
    }
}

/// Returns the path of a file of the optional test data, in `shared` beside the repository. If it is absent,
/// prints that the test is skipped and returns `None`.
pub fn shared(path: &str) -> Option<PathBuf> {
    let file = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared")).join(path);
    if file.exists() {
        return Some(file);
    }
    // Written to the stream directly, since the test runner captures the print macros.
    let _ = writeln!(std::io::stderr(), "skipped: {} is absent", file.display());
    None
}

/// Loads a mesh of the optional test data, exactly welded.
///
/// # Panics
/// If the file is present but cannot be loaded.
pub fn shared_mesh(path: &str) -> Option<TriMesh> {
    let file = shared(path)?;
    match load(&file, &LoadOptions::default()) {
        Ok(loaded) => Some(loaded.mesh),
        Err(error) => panic!("{error}"),
    }
}

/// Returns a built-in model, built once for all tests of a program, regardless of the user's cache.
///
/// # Panics
/// If there is no such model.
pub fn model(name: &str) -> Object {
    static MODELS: Mutex<BTreeMap<String, Arc<OnceLock<Object>>>> = Mutex::new(BTreeMap::new());
    let model = Arc::clone(MODELS.lock().expect("no panic").entry(name.to_owned()).or_default());
    let open = || {
        let options = OpenOptions { cache: false, ..OpenOptions::default() };
        match Object::open(name, &options, &mut unwatched) {
            Ok(object) => object,
            Err(error) => panic!("{error}"),
        }
    };
    model.get_or_init(open).clone()
}

/// Returns the hierarchy of a [model](model()) with so many triangles.
///
/// # Panics
/// If there is no such model.
pub fn hierarchy(model: Model, triangles: usize) -> Arc<Clod> {
    self::model(&format!("{}@{triangles}", model.name())).clod
}

/// Returns a smooth step from 0 at one time to 1 at another, with zero slope at both.
pub fn smooth(from: f64, to: f64, time: f64) -> f64 {
    let x = ((time - from) / (to - from)).clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

/// Returns the plate of §5.5.4 with sinusoidal ridges across x as a texture, by their height from groove to
/// crest and their distance, m.
///
/// # Panics
/// If such a plate cannot be made.
pub fn ridged_plate(height: f64, spacing: f64) -> Object {
    const TEXELS: u32 = 64;
    let wave = |i: u32| (std::f64::consts::TAU * (f64::from(i) + 0.5) / f64::from(TEXELS)).cos();
    let ridge = (0..TEXELS).map(|i| (0.5 * height * wave(i)) as f32).collect();
    let texel = spacing / f64::from(TEXELS);
    let made = || -> Result<Object, Box<dyn std::error::Error>> {
        let image = HeightImage::new(TEXELS, 1, ridge, [Wrap::Repeat; 2])?;
        let mesh = Model::Plate.generate(Model::Plate.default_triangles())?;
        let mesh = UvMesh::projected(mesh, |corner| DVec2::new(corner.x / spacing, corner.y / texel))?;
        Ok(Object::textured("ridges", &mesh, &image, 0.5)?)
    };
    match made() {
        Ok(object) => object,
        Err(error) => panic!("{error}"),
    }
}

/// Returns the position of a probe's frame at first contact, when the probe is lowered along z above the
/// middle of a scene object.
///
/// # Panics
/// If it never touches.
pub fn first_touch(probe: &Object, scene: &Object) -> DVec3 {
    let settings = QuerySettings::new(0.1 * probe.bounding_radius());
    let mut query = ContactQuery::new(probe.shape(), scene.shape());
    let top = scene.bounding_radius() + probe.bounding_radius();
    let mut position = scene.clod.source.center - probe.clod.source.center + DVec3::Z * top;
    for _ in 0..1000 {
        let pose = Pose::from_translation(position);
        let outcome = query.run(&pose, &Pose::IDENTITY, &settings).expect("valid poses and settings");
        let distance = outcome.smallest_distance.unwrap_or(settings.tolerance);
        if distance < 1e-6 {
            return position;
        }
        position.z -= distance;
    }
    panic!("the probe never touches");
}

/// Returns the leaf that each triangle of a hierarchy's mesh belongs to.
///
/// # Panics
/// If a triangle belongs to none.
pub fn leaf_of_triangle(clod: &Clod, mesh: &TriMesh) -> Vec<u32> {
    let bits = |corners: [DVec3; 3]| {
        let mut keys = corners.map(|corner| corner.to_array().map(|x| (x + 0.0).to_bits()));
        keys.sort_unstable();
        keys
    };
    let mut leaf_of = HashMap::new();
    for (index, leaf) in clod.levels[0].nodes.clone().zip(clod.leaves()) {
        let hull = clod.hull(&leaf);
        for triangle in clod.patch(&leaf) {
            leaf_of.insert(bits(triangle.map(|vertex| hull[vertex as usize])), index);
        }
    }
    (0..mesh.triangles().len()).map(|triangle| leaf_of[&bits(mesh.corners(triangle))]).collect()
}
