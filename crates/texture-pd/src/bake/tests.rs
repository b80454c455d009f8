use glam::DVec3;

use super::*;

/// A grid of points on the unit square from `point`, as triangles facing up.
fn grid(cells: u32, point: impl Fn(f64, f64) -> DVec3) -> TriMesh {
    let side = cells + 1;
    let at = |i: u32| f64::from(i) / f64::from(cells);
    let vertices = (0..side * side).map(|i| point(at(i % side), at(i / side))).collect();
    let cell = |i: u32| {
        let first = i / cells * side + i % cells;
        [[first, first + 1, first + side + 1], [first, first + side + 1, first + side]]
    };
    TriMesh::new(vertices, (0..cells * cells).flat_map(cell).collect()).unwrap()
}

/// Triangles of an octahedron, split in four `levels` times, with `map` applied to points of the unit sphere.
fn sphere(levels: u32, map: impl Fn(DVec3) -> DVec3) -> TriMesh {
    let mut triangles: Vec<[DVec3; 3]> = (0..8)
        .map(|i| {
            let sign = |bit: usize| if i >> bit & 1 == 0 { 1.0 } else { -1.0 };
            let [a, b, c] = [DVec3::X * sign(0), DVec3::Y * sign(1), DVec3::Z * sign(2)];
            if sign(0) * sign(1) * sign(2) > 0.0 { [a, b, c] } else { [a, c, b] }
        })
        .collect();
    for _ in 0..levels {
        triangles = triangles
            .into_iter()
            .flat_map(|[a, b, c]| {
                let [d, e, f] = [(a + b).normalize(), (b + c).normalize(), (c + a).normalize()];
                [[a, d, f], [d, b, e], [f, e, c], [d, e, f]]
            })
            .collect();
    }
    let mut vertices = Vec::new();
    let mut index = std::collections::HashMap::new();
    let mut name = |p: DVec3| {
        // Adding 0 turns −0 into 0, so both give the same key.
        *index.entry((p + DVec3::ZERO).to_array().map(f64::to_bits)).or_insert_with(|| {
            vertices.push(map(p));
            vertices.len() as u32 - 1
        })
    };
    let triangles = triangles.into_iter().map(|corners| corners.map(&mut name)).collect();
    TriMesh::new(vertices, triangles).unwrap()
}

fn options(texel: f64) -> BakeOptions {
    BakeOptions { texel, reach: None, crease: 0.9 }
}

fn unwatched(_: f64) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

#[expect(clippy::print_stdout, reason = "measured figures, shown by --nocapture or on failure")]
fn baked(coarse: &TriMesh, detailed: &TriMesh, options: &BakeOptions) -> Baked {
    let baked = bake(coarse, detailed, options, &mut unwatched).unwrap();
    println!("{}\n", baked.report);
    baked
}

const RADIUS: f64 = 0.05;

/// A sphere with waves of a millimetre.
fn wavy(p: DVec3) -> DVec3 {
    let wave = (9.0 * p.x).sin() * (7.0 * p.y + 1.0).sin() * (8.0 * p.z).cos();
    p * (RADIUS + 1e-3 * wave)
}

/// A dome 1 cm wide, with waves 5 mm long of the height `waves`; `beyond` widens it.
fn dome(cells: u32, beyond: f64, waves: f64) -> TriMesh {
    grid(cells, |x, y| {
        let [x, y] = [x, y].map(|x| 0.01 * beyond * (x - 0.5));
        let k = std::f64::consts::TAU / 0.005;
        let wave = (k * x + 0.3).sin() * (k * y).cos();
        DVec3::new(x, y, -(x * x + y * y) / (2.0 * 0.02) + waves * wave)
    })
}

#[test]
fn error_falls_with_the_fourth_power_of_the_texel() {
    // With 130 triangles along a wave, the error of the detailed mesh is a ten-thousandth of a wave's height.
    let (coarse, detailed) = (dome(3, 1.0, 0.0), dome(360, 1.4, 2e-4));
    let reports =
        [1.25e-3, 0.625e-3, 0.3125e-3].map(|texel| baked(&coarse, &detailed, &options(texel)).report);
    for (pair, factor) in reports.windows(2).zip([9.0, 3.0]) {
        let [wide, narrow] = [&pair[0], &pair[1]];
        assert!(wide.largest_deviation > factor * narrow.largest_deviation, "{wide}\n{narrow}");
        assert!(wide.largest_seam > factor * narrow.largest_seam, "{wide}\n{narrow}");
    }
    assert!(reports[2].largest_vertex_deviation < 2e-7, "{}", reports[2]);
    assert_eq!((reports[2].missed, reports[2].folded, reports[2].smooth_edges), (0, 0, 21));
}

#[test]
fn levels_of_a_hierarchy_get_the_same_surface() {
    let detailed = sphere(7, wavy);
    for levels in [1, 2] {
        let coarse = sphere(levels, |p| p * RADIUS);
        let report = baked(&coarse, &detailed, &BakeOptions { crease: 1.5, ..options(1e-3) }).report;
        for length in [report.largest_deviation, report.largest_vertex_deviation, report.largest_seam] {
            assert!(length < 1e-5, "{report}");
        }
        assert!((report.distortion - 1.0).abs() < 1e-9 && report.used > 0.3, "{report}");
        assert_eq!((report.missed, report.beside, report.without_area), (0, 0, 0));
        assert_eq!(report.smooth_edges, coarse.triangles().len() * 3 / 2);
    }
}

/// A cube, 2 cm wide, with a relief (m) on its faces, which have `cells` squares along a side. Faces share no
/// vertices.
fn cube(cells: u32, relief: impl Fn(f64, f64) -> f64) -> TriMesh {
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for axis in 0..6 {
        let normal = DVec3::AXES[axis / 2] * if axis % 2 == 0 { 1.0 } else { -1.0 };
        let along = DVec3::AXES[(axis / 2 + 1) % 3];
        let across = normal.cross(along);
        let face = grid(cells, |x, y| {
            0.01 * (normal + (2.0 * x - 1.0) * along + (2.0 * y - 1.0) * across) + relief(x, y) * normal
        });
        let first = vertices.len() as u32;
        vertices.extend(face.vertices());
        triangles.extend(face.triangles().iter().map(|t| t.map(|v| v + first)));
    }
    TriMesh::new(vertices, triangles).unwrap()
}

/// Waves that end before the edges of a cube's face.
fn waves(x: f64, y: f64) -> f64 {
    3e-4 * (16.0 * x * (1.0 - x) * y * (1.0 - y)).powi(2) * (11.0 * x).sin() * (9.0 * y).cos()
}

/// Ridges over a cube's face, up to a tenth from its edges.
fn ridges(x: f64, y: f64) -> f64 {
    let border = |x: f64| (10.0 * x.min(1.0 - x)).min(1.0);
    let smooth = |x: f64| x * x * (3.0 - 2.0 * x);
    1e-3 * (25.0 * x).cos() * smooth(border(x)) * smooth(border(y))
}

#[test]
fn relief_around_a_corner_belongs_to_another_face() {
    let (coarse, detailed) = (cube(2, |_, _| 0.0), cube(120, ridges));
    let report = baked(&coarse, &detailed, &options(1.5e-4)).report;
    assert_eq!(report.smooth_edges, 6 * 8);
    assert!(report.reach > 1.5e-3, "too near to see the ridges beyond an edge: {report}");
    assert!(report.largest_seam < 5e-5 && report.largest_deviation < 1e-4, "{report}");
    assert!(report.unreached == 0, "{report}");
}

#[test]
fn surfaces_meet_at_steps() {
    // A wall, half a texel wide, across the coarse plate's triangles.
    let coarse = grid(2, |x, y| 0.02 * DVec3::new(x, y, 0.0));
    let step = |x: f64, y: f64| {
        let across = (0.02 * (x + 0.3 * y - 0.6) / 1e-4).clamp(0.0, 1.0);
        0.02 * DVec3::new(x, y, 0.0) + 1e-3 * across * DVec3::Z
    };
    let report = baked(&coarse, &grid(400, step), &options(2e-4)).report;
    assert!(report.largest_seam < 4e-5, "{report}");
    assert!(report.unreached > 0 && report.unreached < report.vertices / 50, "{report}");
}

#[test]
fn sharp_edges_stay_sharp() {
    let report = baked(&cube(1, |_, _| 0.0), &cube(100, waves), &options(4e-4)).report;
    assert!(report.largest_deviation < 2e-6 && report.largest_vertex_deviation < 2e-6, "{report}");
    assert_eq!((report.missed, report.beside), (0, 0), "{report}");
    // Along the cube's edges rays graze the waves of the next face.
    assert!(report.folded < 20, "{report}");
    // The diagonals: the faces do not share vertices.
    assert_eq!(report.smooth_edges, 6);
    assert!(report.largest_seam < 2e-6, "{report}");
}

#[test]
fn number_of_threads_changes_nothing() {
    let (coarse, detailed) = (sphere(1, |p| p * RADIUS), sphere(5, wavy));
    let [alone, together] = [1, 3].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| baked(&coarse, &detailed, &options(2e-3)))
    });
    assert_eq!(alone, together);
}

#[test]
fn holes_are_filled_and_folded_texels_are_counted() {
    let coarse = grid(2, |x, y| 0.02 * DVec3::new(x, y, 0.0));
    let whole = grid(40, |x, y| DVec3::new(0.02 * x, 0.02 * y, 1e-3 * x));
    let hole = |t: &&[u32; 3]| whole.vertices()[t[0] as usize].distance(DVec3::splat(0.01)) > 0.0118;
    let pierced: Vec<[u32; 3]> = whole.triangles().iter().filter(hole).copied().collect();
    assert!(pierced.len() < whole.triangles().len());
    let pierced = TriMesh::new(whole.vertices().to_vec(), pierced).unwrap();
    let wanted = BakeOptions { reach: Some(5e-3), ..options(2e-4) };
    let filled = baked(&coarse, &pierced, &wanted);
    assert!(filled.report.missed > 100 && filled.report.folded == 0, "{}", filled.report);
    let [low, high] = filled.image.range();
    assert!(low > -1e-4 && high < 1.1e-3, "{low} {high}");

    // A second plate above a quarter, within reach; the nearer one counts.
    let mut vertices = whole.vertices().to_vec();
    let mut triangles = whole.triangles().to_vec();
    let first = vertices.len() as u32;
    vertices.extend(whole.vertices().iter().map(|p| 0.5 * *p + 4e-3 * DVec3::Z));
    triangles.extend(whole.triangles().iter().map(|t| t.map(|v| v + first)));
    let layered = baked(&coarse, &TriMesh::new(vertices, triangles).unwrap(), &wanted);
    let texels = 1e4 / 4.0;
    assert!((layered.report.folded as f64 / texels - 1.0).abs() < 0.1, "{}", layered.report);
    assert!(layered.report.largest_deviation < 1e-8, "{}", layered.report);
}

#[test]
fn texels_larger_than_triangles_do_not_blow_up() {
    let (coarse, detailed) = (sphere(3, |p| p * RADIUS), sphere(5, wavy));
    for texel in [5e-3, 0.02, RADIUS] {
        let report = baked(&coarse, &detailed, &options(texel)).report;
        assert!(report.largest_deviation < 4e-3, "{report}");
        assert!(report.largest_seam < 3e-3 && report.points >= 512, "{report}");
    }
}

#[test]
fn unusable_input_is_refused_or_counted() {
    let (coarse, detailed) = (sphere(1, |p| p * RADIUS), sphere(3, wavy));
    let wanted = options(5e-3);
    let refused = |coarse: &TriMesh, detailed: &TriMesh, options: &BakeOptions| {
        bake(coarse, detailed, options, &mut unwatched).unwrap_err()
    };
    let empty = TriMesh::default();
    assert_eq!(refused(&empty, &detailed, &wanted), BakeError::NoSurface { which: "coarse" });
    assert_eq!(refused(&coarse, &empty, &wanted), BakeError::NoSurface { which: "detailed" });
    let line = TriMesh::new(vec![DVec3::ZERO, DVec3::X, DVec3::X * 2.0], vec![[0, 1, 2]]).unwrap();
    assert_eq!(refused(&line, &detailed, &wanted), BakeError::NoSurface { which: "coarse" });
    assert!(matches!(refused(&coarse, &line, &wanted), BakeError::NothingWithinReach { .. }));

    let mut vertices = detailed.vertices().to_vec();
    vertices[7].y = f64::NAN;
    let triangle = detailed.triangles().iter().position(|t| t.contains(&7)).unwrap();
    let broken = TriMesh::new(vertices, detailed.triangles().to_vec()).unwrap();
    let error = BakeError::Detailed(MeshError::NonFinite { triangle, vertex: 7 });
    assert_eq!(refused(&coarse, &broken, &wanted), error);
    assert!(matches!(refused(&broken, &detailed, &wanted), BakeError::Coarse(MeshError::NonFinite { .. })));

    let away = sphere(3, |p| wavy(p) + DVec3::X);
    assert!(matches!(refused(&coarse, &away, &wanted), BakeError::NothingWithinReach { .. }));
    for texel in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e30] {
        assert!(matches!(refused(&coarse, &detailed, &options(texel)), BakeError::BadOption { .. }));
    }
    for crease in [-1.0, f64::NAN] {
        let wanted = BakeOptions { crease, ..wanted };
        assert!(matches!(refused(&coarse, &detailed, &wanted), BakeError::BadOption { .. }));
    }
    let huge = sphere(1, |p| p * 1e200);
    assert_eq!(refused(&huge, &detailed, &wanted), BakeError::Coarse(MeshError::OutOfRange));
    let mut broke_off =
        |done: f64| if done > 0.3 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
    assert_eq!(bake(&coarse, &detailed, &wanted, &mut broke_off), Err(BakeError::Cancelled));

    let mut triangles = coarse.triangles().to_vec();
    triangles.extend([[0, 0, 1], [2, 2, 2]]);
    let degenerate = TriMesh::new(coarse.vertices().to_vec(), triangles).unwrap();
    let report = baked(&degenerate, &detailed, &wanted).report;
    assert_eq!(report.without_area, 2);
    assert!(report.largest_deviation < 1e-3, "{report}");
}
