//! The models that are stitched from structured patches: topology, number of triangles, size and shape of the
//! triangles, from the coarsest mesh to the dissertation's.

use palpate_core::{
    Pose, TriMesh,
    glam::{DQuat, DVec3},
};
use palpate_mesh_io::{intersecting_pairs, self_intersections};
use palpate_models::Model;

/// Models, each with its genus.
const STITCHED: [(Model, i64); 15] = [
    (Model::Cup, 1),
    (Model::CupLow, 1),
    (Model::Spoon, 0),
    (Model::SpoonLow, 0),
    (Model::Ellipsoid, 0),
    (Model::Block, 0),
    (Model::Gear, 0),
    (Model::Hammer, 0),
    (Model::CadPart, 8),
    (Model::File, 0),
    (Model::Torus, 1),
    (Model::Bolt, 0),
    (Model::Nut, 1),
    (Model::Peg, 0),
    (Model::Hole, 1),
];

/// Smallest number of triangles of a model.
fn fewest(model: Model) -> usize {
    (1..).find(|count| model.generate(*count).is_ok()).unwrap()
}

fn default_mesh(model: Model) -> TriMesh {
    model.generate(model.default_triangles()).unwrap()
}

/// The longest edge over the shortest height of the worst triangle: 1.15 for an equilateral one.
fn worst_aspect(mesh: &TriMesh) -> f64 {
    let aspect = |triangle: usize| {
        let [a, b, c] = mesh.corners(triangle);
        let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
        longest * longest / (b - a).cross(c - a).length()
    };
    (0..mesh.triangles().len()).map(aspect).fold(0.0, f64::max)
}

fn extent(mesh: &TriMesh) -> DVec3 {
    let lowest = mesh.vertices().iter().copied().fold(DVec3::INFINITY, DVec3::min);
    let highest = mesh.vertices().iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
    highest - lowest
}

/// Checks the properties of a model that hold at any resolution.
fn check(model: Model, genus: i64, count: usize) {
    let mesh = model.generate(count).unwrap();
    let name = format!("{}@{count}", model.name());
    let report = mesh.validate();
    assert!(report.closed && report.manifold && report.oriented, "{name}: {report:?}");
    assert_eq!(
        (report.degenerate, report.duplicate, report.nonfinite, report.unreferenced, report.components),
        (0, 0, 0, 0, 1),
        "{name}: {report:?}"
    );
    assert!(report.volume > 0.0, "{name} is inside out: {} m³", report.volume);
    let triangles = mesh.triangles().len();
    assert_eq!(report.vertices as i64 - triangles as i64 / 2, 2 - 2 * genus, "{name}: genus");
    let off = triangles as f64 / count as f64 - 1.0;
    assert!(off.abs() < 0.02, "{name} has {triangles} triangles, {:+.1} %", 100.0 * off);
    let aspect = worst_aspect(&mesh);
    assert!(aspect < 16.0, "{name}: worst aspect {aspect}");
    let crossing = self_intersections(&mesh);
    assert_eq!(crossing.count, 0, "{name}: first {:?}", crossing.first);
}

#[test]
fn sound_at_the_dissertations_sizes() {
    for (model, genus) in STITCHED {
        check(model, genus, model.default_triangles());
    }
}

#[test]
fn sound_from_coarse_to_fine() {
    for (model, genus) in STITCHED {
        let low = fewest(model);
        for step in 0..14 {
            check(model, genus, (low as f64 * 1.27_f64.powi(step)) as usize);
        }
    }
}

#[test]
fn the_same_every_time() {
    for (model, _) in STITCHED {
        let count = 2 * fewest(model);
        assert!(model.generate(count).unwrap() == model.generate(count).unwrap(), "{}", model.name());
    }
}

#[test]
fn relief_leaves_the_coarse_model_and_is_there_in_the_fine_one() {
    // Volume and extent of the shapes under the relief, m; the relief changes the extent by about its height.
    for (model, plain, relief) in [
        (Model::Block, DVec3::new(0.080, 0.064, 0.036), DVec3::new(0.5, 0.5, 1.4) * 2e-3),
        (Model::Torus, DVec3::new(0.168, 0.168, 0.048), DVec3::splat(2.2e-3)),
        (Model::File, DVec3::new(0.235, 0.024, 0.0055), DVec3::new(0.0, 0.0, 1.4e-3)),
    ] {
        let coarse = extent(&model.generate(4 * fewest(model)).unwrap());
        let fine = extent(&default_mesh(model));
        assert!((coarse - plain).abs().max_element() < 1e-3, "{}: {coarse} against {plain}", model.name());
        let off = fine - plain - relief;
        assert!(off.abs().max_element() < 3e-4, "{}: {fine} against {plain} + {relief}", model.name());
    }
}

#[test]
fn sizes() {
    for model in [Model::Cup, Model::CupLow] {
        let radius = default_mesh(model).bounding_sphere().radius;
        assert!((radius - 0.08).abs() < 1e-3, "{}: radius {radius} m", model.name());
    }
    for model in [Model::Spoon, Model::SpoonLow] {
        let length = extent(&default_mesh(model)).x;
        assert!((length - 0.2).abs() < 1.2e-3, "{}: {length} m long", model.name());
    }
}

#[test]
fn the_ellipsoid_is_strictly_convex() {
    for count in [60, 100, 778, 2000, 5000] {
        let mesh = Model::Ellipsoid.generate(count).unwrap();
        let size = extent(&mesh);
        assert!(size.x > 1.2 * size.y && size.y > 1.2 * size.z, "three different axes, not {size}");
        for (triangle, corners) in mesh.triangles().iter().enumerate() {
            let [a, b, c] = mesh.corners(triangle);
            let normal = (b - a).cross(c - a).normalize();
            for (index, vertex) in (0..).zip(mesh.vertices()) {
                let height = normal.dot(*vertex - a);
                assert!(
                    corners.contains(&index) || height < -1e-10,
                    "{count} triangles: vertex {index} is {height} m over triangle {triangle}"
                );
            }
        }
    }
}

#[test]
fn the_block_meshes_with_the_gear_and_with_itself() {
    // The gear's axis along the block's ridges, a tooth over a valley of the block's top.
    let (block, gear) = (default_mesh(Model::Block), default_mesh(Model::Gear));
    let radius = 24.0 * 0.008 / std::f64::consts::TAU;
    let turned = |teeth: f64| {
        let axis = DQuat::from_rotation_y(std::f64::consts::FRAC_PI_2);
        axis * DQuat::from_rotation_z(std::f64::consts::TAU * teeth / 24.0)
    };
    let at = |teeth: f64, gap: f64| Pose {
        translation: DVec3::new(0.0, 0.0, 0.018 + radius + gap),
        rotation: turned(teeth),
    };
    let hits = |pose: &Pose| !intersecting_pairs(&gear, pose, &block, &Pose::IDENTITY, 1).is_empty();
    // A crest on a crest touches where the two amplitudes add up; a tooth in a valley goes deeper.
    assert!(hits(&at(0.0, 0.002)) && !hits(&at(0.0, 0.0029)));
    assert!(!hits(&at(0.5, 0.0015)));

    let stacked = |shift: f64, gap: f64| Pose {
        translation: DVec3::new(0.0, shift, 0.036 + gap),
        rotation: DQuat::IDENTITY,
    };
    let hits = |pose: &Pose| !intersecting_pairs(&block, pose, &block, &Pose::IDENTITY, 1).is_empty();
    assert!(!hits(&stacked(0.0, 0.0004)), "ridges in valleys");
    assert!(hits(&stacked(0.004, 0.002)), "ridges on ridges");
}

#[test]
fn the_spoon_passes_through_the_handle_of_the_cup() {
    for (spoon, cup) in [(Model::Spoon, Model::Cup), (Model::SpoonLow, Model::CupLow)] {
        let (spoon, cup) = (default_mesh(spoon), default_mesh(cup));
        // It goes through along y, its broad side upright; a little further out or up, it meets the handle.
        let lengthwise = DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2);
        let upright = DQuat::from_rotation_y(std::f64::consts::FRAC_PI_2);
        let meets = |offset: DVec3| {
            let pose = Pose { translation: opening(&cup) + offset, rotation: upright * lengthwise };
            !intersecting_pairs(&spoon, &pose, &cup, &Pose::IDENTITY, 1).is_empty()
        };
        for step in -12..=12 {
            let along = DVec3::new(0.0, 0.01 * f64::from(step), 0.0);
            assert!(!meets(along), "the spoon meets the cup at {along}");
        }
        assert!(meets(0.02 * DVec3::X) && meets(-0.03 * DVec3::X) && meets(0.03 * DVec3::Z));
    }
}

/// The middle of the opening between the cup's handle and its wall, for a spoon whose own middle lies lower.
fn opening(cup: &TriMesh) -> DVec3 {
    let handle = cup.vertices().iter().map(|vertex| vertex.x).fold(0.0, f64::max);
    let top = cup.vertices().iter().map(|vertex| vertex.z).fold(0.0, f64::max);
    DVec3::new(handle - 0.028, 0.0, 0.52 * top)
}
