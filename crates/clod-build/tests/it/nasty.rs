//! Meshes that are not oriented 2-manifolds without self-intersection are refused with a reason and the first
//! offending element, and build once they are repaired.

#![allow(
    clippy::print_stdout,
    reason = "seeds, figures and what was skipped, shown by --nocapture or on failure"
)]

use std::ops::ControlFlow;

use crate::shapes::{built, cube, globe, inverted, mapped, plain, shared, together};
use glam::{DMat3, DVec3};
use palpate_clod_build::{BuildError, BuildOptions, Stage, build, unwatched};
use palpate_core::TriMesh;
use palpate_mesh_io::{LoadOptions, load, repair, self_intersections, weld};
use palpate_models::Model;
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

fn mesh(vertices: Vec<DVec3>, triangles: Vec<[u32; 3]>) -> TriMesh {
    TriMesh::new(vertices, triangles).expect("indices are in range")
}

fn refused(mesh: &TriMesh) -> BuildError {
    build(mesh, &BuildOptions::default(), &mut unwatched).expect_err("the mesh is refused")
}

/// Builds a mesh in which validation and the independent intersection test find no defect; else checks that
/// it is refused for the first defect that they find.
fn built_or_rightly_refused(mesh: &TriMesh, options: &BuildOptions, name: &str) -> bool {
    let report = mesh.validate();
    let first = report.first.clone();
    let crossings = self_intersections(mesh);
    let outcome = build(mesh, options, &mut unwatched);
    if let Ok(clod) = &outcome {
        clod.parts().validate().unwrap_or_else(|e| panic!("{name}: {e}"));
        assert!(report.is_solid() || !clod.source.solid, "{name}");
        assert!(clod.source.solid || clod.leaves().iter().all(|n| !n.contained), "{name}");
    } else if let Err(e) = &outcome {
        let text = e.to_string();
        let hopeless = matches!(e, BuildError::NoSurface { .. } | BuildError::Extent { .. });
        assert!(hopeless || e.is_mended_by_repair() && text.contains("repair the mesh"), "{name}: {text}");
        assert!(text.len() < 300 && !text.contains('\n'), "{name}: {text}");
    }
    let expected = if let Some(triangle) = first.degenerate {
        matches!(outcome, Err(BuildError::Degenerate { count, triangle: t, .. })
            if (count, t) == (report.degenerate, triangle))
            || matches!(outcome, Err(BuildError::NoSurface { .. } | BuildError::Extent { .. }))
    } else if let Some(triangle) = first.duplicate {
        matches!(outcome, Err(BuildError::Duplicate { count, triangle: t, .. })
            if (count, t) == (report.duplicate, triangle))
    } else if let Some(wanted) = first.nonmanifold_edge {
        matches!(outcome, Err(BuildError::NonManifoldEdge { count, edge, .. })
            if (count, edge) == (report.nonmanifold_edges, wanted))
    } else if let Some(wanted) = first.misoriented_edge {
        matches!(outcome, Err(BuildError::Misoriented { count, edge, .. })
            if (count, edge) == (report.misoriented_edges, wanted))
    } else if let Some(wanted) = first.nonmanifold_vertex {
        matches!(outcome, Err(BuildError::NonManifoldVertex { count, vertex, position })
            if (count, vertex) == (report.nonmanifold_vertices, wanted)
                && position == mesh.vertices()[wanted as usize])
    } else if report.closed && report.volume < 0.0 {
        matches!(outcome, Err(BuildError::InsideOut { volume }) if volume == report.volume)
    } else if let Some(wanted) = crossings.first {
        matches!(outcome, Err(BuildError::SelfIntersecting { count, triangles, .. })
            if triangles == wanted && (2..=2 * crossings.count).contains(&count))
    } else {
        outcome.is_ok()
    };
    assert!(expected, "{name}: {:?}, but {report:?}, {crossings:?}", outcome.err());
    outcome.is_ok()
}

/// Size of a file, in bytes, above which it takes seconds in a development build.
const LARGE_FILE_BYTES: u64 = 400_000;

#[test]
fn nasty_files_are_refused_or_build_and_build_after_repair() {
    nasty_files([15, 5], |bytes| bytes <= LARGE_FILE_BYTES);
}

#[test]
#[ignore = "for a release build: cargo test --release -p palpate-clod-build --test it -- --ignored"]
fn nasty_files_of_full_size_are_refused_or_build_and_build_after_repair() {
    nasty_files([0, 5], |bytes| bytes > LARGE_FILE_BYTES);
}

/// Checks the files of some sizes; at least `least[0]` of them are accepted, and `least[1]` repaired.
fn nasty_files(least: [usize; 2], size: impl Fn(u64) -> bool) {
    let Some(folder) = shared("models/nasty") else { return };
    let mut files: Vec<_> = ["", "loader"]
        .iter()
        .flat_map(|sub| std::fs::read_dir(folder.join(sub)).expect("the folder can be read"))
        .map(|entry| entry.expect("the folder can be read").path())
        .filter(|path| path.metadata().is_ok_and(|file| file.is_file() && size(file.len())))
        .collect();
    files.sort();
    let options = plain();
    let (mut accepted, mut mended) = (0, 0);
    for path in files {
        let name = path.display().to_string();
        let Ok(loaded) = load(&path, &LoadOptions::default()) else { continue };
        if built_or_rightly_refused(&loaded.mesh, &options, &name) {
            accepted += 1;
            continue;
        }
        match load(&path, &LoadOptions { repair: true, ..LoadOptions::default() }) {
            Ok(repaired) => {
                let clod = build(&repaired.mesh, &options, &mut unwatched);
                let clod = clod.unwrap_or_else(|e| panic!("{name}: {e}"));
                clod.parts().validate().unwrap_or_else(|e| panic!("{name}: {e}"));
                let summary = repaired.repairs.expect("repair was asked for");
                println!("{name}: {} patches once repaired: {summary}", clod.leaves().len());
                mended += 1;
            }
            // A single triangle without area.
            Err(e) => assert!(name.contains("degenerate_mesh.obj"), "{e}"),
        }
    }
    println!("{accepted} accepted, {mended} mended");
    assert!(accepted >= least[0] && mended >= least[1], "{accepted}, {mended}");
}

#[test]
fn refusals_say_why() {
    let p = |x: f64| DVec3::new(x, 1.0, 2.0);
    assert_eq!(refused(&mesh(vec![p(0.0)], vec![])), BuildError::Empty { vertices: 1 });
    let e = refused(&mesh(vec![p(0.0), p(1.0), p(f64::NAN), DVec3::ZERO], vec![[0, 1, 3], [0, 3, 2]]));
    assert!(matches!(e, BuildError::NonFinite { vertex: 2, triangle: 1, .. }), "{e}");
    assert!(e.is_mended_by_repair() && e.to_string().contains("repair the mesh"), "{e}");
    let e = refused(&mesh(vec![p(1.0), p(1.0), p(1.0)], vec![[0, 1, 2]]));
    assert!(matches!(e, BuildError::Extent { radius: 0.0, .. }), "{e}");
    let e = refused(&mesh(vec![p(1.0), p(2.0)], vec![[0, 1, 1]]));
    assert_eq!(e, BuildError::NoSurface { triangles: 1 });
    for scale in [1e-60, 1e60, 1e200] {
        let e = refused(&mapped(&cube(1), DMat3::IDENTITY * scale, DVec3::ZERO));
        assert!(matches!(e, BuildError::Extent { .. }), "{e}");
    }
    for tolerance in [-1e-9, 0.2, f64::NAN, f64::INFINITY] {
        let options = BuildOptions { tolerance, ..BuildOptions::default() };
        let e = build(&cube(1), &options, &mut unwatched).expect_err("out of range");
        assert!(matches!(e, BuildError::Option { option: "tolerance", .. }), "{e}");
    }
    // A vertex that no triangle uses may be anything.
    built(&mesh(vec![p(0.0), p(1.0), DVec3::ZERO, p(f64::NAN)], vec![[0, 1, 2]]));
}

#[test]
fn small_and_degenerate_meshes() {
    let corner = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::X * 0.5];
    let built_of = |triangles: Vec<[u32; 3]>| built(&mesh(corner.clone(), triangles));
    let clod = built_of(vec![[0, 1, 2]]);
    assert_eq!(clod.leaves().len(), 1);
    assert!(clod.leaves().iter().all(|n| !n.contained && !n.all_real));
    // The same triangle twice and back to back; on a line, and beside a triangle; between fewer than three
    // vertices.
    for (triangles, offender) in [
        (
            vec![[0, 1, 2], [0, 1, 2]],
            BuildError::Duplicate { count: 1, triangle: 1, position: DVec3::ONE / 3.0 },
        ),
        (
            vec![[0, 1, 2], [0, 2, 1]],
            BuildError::Duplicate { count: 1, triangle: 1, position: DVec3::ONE / 3.0 },
        ),
        (vec![[0, 3, 1]], BuildError::Degenerate { count: 1, triangle: 0, position: DVec3::X / 2.0 }),
        (
            vec![[0, 1, 2], [1, 0, 3]],
            BuildError::Degenerate { count: 1, triangle: 1, position: DVec3::X / 2.0 },
        ),
        (
            vec![[0, 1, 2], [0, 0, 1], [2, 2, 2]],
            BuildError::Degenerate { count: 2, triangle: 1, position: DVec3::X / 3.0 },
        ),
    ] {
        let found = refused(&mesh(corner.clone(), triangles.clone()));
        let place = |e: &BuildError| match e {
            BuildError::Duplicate { position, .. } | BuildError::Degenerate { position, .. } => *position,
            other => panic!("{other}"),
        };
        assert_eq!(std::mem::discriminant(&found), std::mem::discriminant(&offender), "{found}");
        let off = place(&found) - place(&offender);
        assert!(off.truncate().length() < 1e-12, "{found} instead of {offender}");
    }
    // A thousand triangles around one edge.
    let mut vertices = vec![DVec3::ZERO, DVec3::Z];
    vertices.extend((0..1000).map(|k| DVec3::new(f64::from(k).cos(), f64::from(k).sin(), 0.5)));
    let book = mesh(vertices, (0..1000).map(|k| [0, 1, 2 + k]).collect());
    let e = refused(&book);
    assert!(
        matches!(e, BuildError::NonManifoldEdge { count: 1, edge, position }
        if edge.vertices == [0, 1] && edge.triangle == 0 && position == DVec3::Z / 2.0),
        "{e}"
    );
    let (repaired, summary) = repair(&book);
    assert_eq!((summary.duplicated_vertices, summary.intersecting_triangles), (2 * 999, 0), "{summary}");
    assert_eq!(built(&repaired).leaves().len(), 1000);
}

#[test]
fn each_defect_is_refused_at_its_first_element_and_gone_after_repair() {
    type Refused = fn(&BuildError) -> bool;
    let ball = globe(8, |_| 0.0);
    let (vertices, triangles) = (ball.vertices().to_vec(), ball.triangles().to_vec());
    let options = BuildOptions::default();
    let [a, b, c] = triangles[40];
    let change = |index: usize, to: [u32; 3]| {
        let mut changed = triangles.clone();
        changed[index] = to;
        mesh(vertices.clone(), changed)
    };
    let add = |more: &[[u32; 3]]| mesh(vertices.clone(), [triangles.clone(), more.to_vec()].concat());
    // Moved through the other side.
    let mut spiked = vertices.clone();
    spiked[0] = DVec3::new(0.03, 0.02, -1.4);
    let cases: [(&str, TriMesh, Refused); 9] = [
        ("turned", change(40, [b, a, c]), |e| matches!(e, BuildError::Misoriented { count: 3, .. })),
        ("inside out", inverted(&ball), |e| matches!(e, BuildError::InsideOut { volume } if *volume < -3.0)),
        ("twice", add(&[[c, b, a]]), |e| matches!(e, BuildError::Duplicate { triangle: 224, .. })),
        ("collapsed", add(&[[a, b, b]]), |e| matches!(e, BuildError::Degenerate { triangle: 224, .. })),
        ("branching", add(&[[a, b, 0]]), |e| matches!(e, BuildError::NonManifoldEdge { .. })),
        ("spiked", mesh(spiked, triangles.clone()), |e| matches!(e, BuildError::SelfIntersecting { .. })),
        (
            "overlapping",
            together(&[ball.clone(), mapped(&ball, DMat3::IDENTITY, DVec3::new(0.9, 0.1, 0.2))]),
            |e| matches!(e, BuildError::SelfIntersecting { .. }),
        ),
        ("touching", weld(&together(&[ball.clone(), mapped(&ball, DMat3::IDENTITY, 2.0 * DVec3::Z)])), |e| {
            matches!(e, BuildError::NonManifoldVertex { count: 1, vertex: 0, .. })
        }),
        (
            "moebius",
            mesh(
                (0..5).map(|i| DVec3::new(f64::from(i), f64::from(i * i), f64::from(i * i * i))).collect(),
                (0..5).map(|i| [i, (i + 1) % 5, (i + 2) % 5]).collect(),
            ),
            |e| matches!(e, BuildError::Misoriented { .. }),
        ),
    ];
    for (name, broken, is_it) in cases {
        let e = refused(&broken);
        assert!(is_it(&e), "{name}: {e}");
        assert!(!built_or_rightly_refused(&broken, &options, name));
        let (repaired, summary) = repair(&broken);
        println!("{name}: {e}; {summary}");
        assert!(built_or_rightly_refused(&repaired, &options, name), "{name}: {summary}");
    }
    // Touching where positions are equal is not intersecting.
    let apart = together(&[ball.clone(), mapped(&ball, DMat3::IDENTITY, 2.0 * DVec3::Z)]);
    assert!(built_or_rightly_refused(&apart, &options, "touching, not welded"));
    // Neither is a heap of triangles that are neighbours by position only.
    let heap: Vec<DVec3> = (0..triangles.len()).flat_map(|t| ball.corners(t)).collect();
    let loose = mesh(heap, (0..triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect());
    assert!(built_or_rightly_refused(&loose, &options, "not welded"));
}

/// Checks a mesh with the builder's checks, without building it.
fn accepted(mesh: &TriMesh) -> Result<(), BuildError> {
    let stop = |stage, _| {
        if stage == Stage::Mesh { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    };
    match build(mesh, &BuildOptions::default(), &mut { stop }) {
        Err(BuildError::Cancelled) => Ok(()),
        Err(e) => Err(e),
        Ok(_) => panic!("the build ends after the mesh is looked at"),
    }
}

#[test]
fn good_meshes_are_accepted() {
    for model in Model::ALL {
        let mesh = model.generate(3000).or_else(|_| model.generate(20_000)).expect("within range");
        accepted(&mesh).unwrap_or_else(|e| panic!("{}: {e}", model.name()));
    }
}

#[test]
#[ignore = "for a release build: cargo test --release -p palpate-clod-build --test it -- --ignored"]
fn good_meshes_of_full_size_are_accepted() {
    for folder in ["models/good", "models/scenarios"] {
        let Some(folder) = shared(folder) else { return };
        let files = std::fs::read_dir(folder).expect("the folder can be read");
        for path in files.map(|entry| entry.expect("the folder can be read").path()) {
            let Ok(loaded) = load(&path, &LoadOptions::default()) else { continue };
            accepted(&loaded.mesh).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        }
    }
}

#[test]
fn random_triangles() {
    let seed = 31;
    println!("seed {seed}");
    let mut rng = StdRng::seed_from_u64(seed);
    let mut accepted = 0;
    for round in 0..400 {
        let count = 3 + round % 40;
        // On a coarse lattice, so that vertices coincide, line up and share planes; or anywhere.
        let lattice = round % 2 == 0;
        let vertices: Vec<DVec3> = (0..count)
            .map(|_| {
                DVec3::from_array(std::array::from_fn(|_| {
                    if lattice { f64::from(rng.random_range(-2..=2)) } else { rng.random_range(-1.0..1.0) }
                }))
            })
            .collect();
        let triangles: Vec<[u32; 3]> = (0..1 + count / 2 * (round % 4))
            .map(|_| std::array::from_fn(|_| rng.random_range(0..count as u32)))
            .collect();
        let options = BuildOptions::default();
        let broken = weld(&mesh(vertices, triangles));
        let name = format!("seed {seed}, round {round}");
        accepted += usize::from(built_or_rightly_refused(&broken, &options, &name));
        let (repaired, summary) = repair(&broken);
        if !repaired.triangles().is_empty() {
            assert!(built_or_rightly_refused(&repaired, &options, &name), "{name}: {summary}");
        }
    }
    assert!((30..300).contains(&accepted), "{accepted} accepted");
}

#[test]
fn sizes_from_atoms_to_planets_and_far_from_the_origin() {
    let bumpy = globe(12, |p| 0.1 * (5.0 * p.x).sin());
    for (scale, shift) in [
        (1e-45, 0.0),
        (1e-9, 0.0),
        (1e45, 0.0),
        (1.0, 1e6),
        (1.0, 1e9),
        (1e-3, 1e9),
        (1.0, 1e15),
        (1.0, 1e16),
    ] {
        let moved = mapped(&bumpy, DMat3::IDENTITY * scale, DVec3::splat(shift));
        if shift == 0.0 || shift / scale <= 1e6 {
            built(&moved);
            continue;
        }
        // Rounding of the positions folds and collapses what is small.
        let name = format!("times {scale:e}, at {shift:e}");
        built_or_rightly_refused(&moved, &BuildOptions::default(), &name);
        let (repaired, summary) = repair(&moved);
        println!("{name}: {summary}");
        if !repaired.triangles().is_empty() {
            assert!(built_or_rightly_refused(&repaired, &BuildOptions::default(), &name), "{summary}");
        }
    }
}

#[test]
fn needles_and_noise() {
    let mut rng = StdRng::seed_from_u64(32);
    println!("seed 32");
    for exponent in [3, 6, 9, 12, 15] {
        // A flattened globe: thousands of slivers in two nearly coplanar sheets.
        let flat = DMat3::from_diagonal(DVec3::new(1.0, 1.0, 10f64.powi(-exponent)));
        let sheets = mapped(&globe(20, |_| 0.0), flat, DVec3::ZERO);
        let needle = DMat3::from_diagonal(DVec3::new(1.0, 10f64.powi(-exponent), 10f64.powi(-exponent)));
        let needle = mapped(&globe(20, |_| 0.0), needle, DVec3::ZERO);
        for (name, thin) in [("sheets", &sheets), ("needle", &needle)] {
            let name = format!("{name} of 1e-{exponent}");
            let accepted = built_or_rightly_refused(thin, &BuildOptions::default(), &name);
            assert!(accepted || exponent > 9, "{name}");
            let (repaired, summary) = repair(thin);
            println!("{name}: {summary}");
            if !repaired.triangles().is_empty() {
                assert!(built_or_rightly_refused(&repaired, &BuildOptions::default(), &name), "{summary}");
            }
        }
        let noise = 10f64.powi(-exponent);
        let rough = cube(12);
        let vertices = rough
            .vertices()
            .iter()
            .map(|p| *p + noise * DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0))))
            .collect();
        let clod = built(&mesh(vertices, rough.triangles().to_vec()));
        if exponent >= 9 {
            assert_eq!(clod.leaves().len(), 1, "noise of {noise:e} is within the tolerance");
        }
    }
}
