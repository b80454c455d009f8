//! Whatever is finite builds, and what is not is refused with a reason.

#![allow(
    clippy::print_stdout,
    reason = "seeds, figures and what was skipped, shown by --nocapture or on failure"
)]

mod shapes;

use glam::{DMat3, DVec3};
use palpate_clod_build::{BuildError, BuildOptions, build, unwatched};
use palpate_core::TriMesh;
use palpate_mesh_io::{LoadOptions, load};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use shapes::{built, cube, globe, mapped, shared};

fn mesh(vertices: Vec<DVec3>, triangles: Vec<[u32; 3]>) -> TriMesh {
    TriMesh::new(vertices, triangles).expect("indices are in range")
}

fn refused(mesh: &TriMesh) -> BuildError {
    build(mesh, &BuildOptions::default(), &mut unwatched).expect_err("the mesh is refused")
}

#[test]
fn nasty_files_build_with_and_without_repair() {
    let Some(folder) = shared("models/nasty") else { return };
    let mut files: Vec<_> = ["", "loader"]
        .iter()
        .flat_map(|sub| std::fs::read_dir(folder.join(sub)).expect("the folder can be read"))
        .map(|entry| entry.expect("the folder can be read").path())
        .filter(|path| path.is_file())
        .collect();
    files.sort();
    let mut count = 0;
    for path in files {
        let mut before = None;
        for repair in [false, true] {
            let Ok(loaded) = load(&path, &LoadOptions { repair, ..LoadOptions::default() }) else { continue };
            if before.as_ref() == Some(&loaded.mesh) {
                continue;
            }
            before = Some(loaded.mesh.clone());
            match build(&loaded.mesh, &BuildOptions::default(), &mut unwatched) {
                Ok(clod) => {
                    clod.validate().unwrap_or_else(|e| panic!("{}: {e}", path.display()));
                    count += 1;
                    let solid = clod.source.solid;
                    assert!(solid || clod.leaves().iter().all(|n| !n.contained), "{}", path.display());
                }
                Err(e) => println!("{}: {e}", path.display()),
            }
        }
    }
    println!("{count} builds");
    assert!(count >= 15);
}

#[test]
fn refusals_say_why() {
    let p = |x: f64| DVec3::new(x, 1.0, 2.0);
    assert_eq!(refused(&mesh(vec![p(0.0)], vec![])), BuildError::Empty { vertices: 1 });
    let e = refused(&mesh(vec![p(0.0), p(1.0), p(f64::NAN), DVec3::ZERO], vec![[0, 1, 3], [0, 3, 2]]));
    assert!(matches!(e, BuildError::NonFinite { vertex: 2, triangle: 1, .. }), "{e}");
    assert!(e.to_string().contains("--repair"), "{e}");
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
    for (triangles, patches) in [
        (vec![[0, 1, 2]], 1),
        // The same triangle twice and back to back: non-manifold edges, or a sheet whose two sides do not join.
        (vec![[0, 1, 2], [0, 1, 2]], 2),
        (vec![[0, 1, 2], [0, 2, 1]], 2),
        // On a line, and beside a triangle.
        (vec![[0, 3, 1]], 1),
        (vec![[0, 1, 2], [1, 0, 3]], 1),
        (vec![[0, 1, 2], [0, 0, 1], [2, 2, 2]], 1),
    ] {
        let clod = built(&mesh(corner.clone(), triangles.clone()));
        assert_eq!(clod.leaves().len(), patches, "{triangles:?}");
        assert!(clod.leaves().iter().all(|n| !n.contained && !n.all_real));
    }
    // A thousand triangles around one edge.
    let mut vertices = vec![DVec3::ZERO, DVec3::Z];
    vertices.extend((0..1000).map(|k| DVec3::new(f64::from(k).cos(), f64::from(k).sin(), 0.5)));
    let clod = built(&mesh(vertices, (0..1000).map(|k| [0, 1, 2 + k]).collect()));
    assert_eq!(clod.leaves().len(), 1000);
}

#[test]
fn random_triangles() {
    let seed = 31;
    println!("seed {seed}");
    let mut rng = StdRng::seed_from_u64(seed);
    for round in 0..200 {
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
        let triangles: Vec<[u32; 3]> =
            (0..2 * count).map(|_| std::array::from_fn(|_| rng.random_range(0..count as u32))).collect();
        let options = BuildOptions { simplify: true, ..BuildOptions::default() };
        match build(&mesh(vertices, triangles), &options, &mut unwatched) {
            Ok(clod) => clod.validate().unwrap_or_else(|e| panic!("round {round}: {e}")),
            Err(e) => println!("round {round}: {e}"),
        }
    }
}

#[test]
fn sizes_from_atoms_to_planets_and_far_from_the_origin() {
    let bumpy = globe(12, |p| 0.1 * (5.0 * p.x).sin());
    for (scale, shift) in
        [(1e-45, 0.0), (1e-9, 0.0), (1e45, 0.0), (1.0, 1e6), (1e-3, 1e9), (1.0, 1e15), (1.0, 1e16)]
    {
        built(&mapped(&bumpy, DMat3::IDENTITY * scale, DVec3::splat(shift)));
    }
}

#[test]
fn needles_and_noise() {
    let mut rng = StdRng::seed_from_u64(32);
    println!("seed 32");
    for exponent in [3, 6, 9, 12, 15] {
        // A flattened globe: thousands of slivers in two nearly coplanar sheets.
        let flat = DMat3::from_diagonal(DVec3::new(1.0, 1.0, 10f64.powi(-exponent)));
        built(&mapped(&globe(20, |_| 0.0), flat, DVec3::ZERO));
        let needle = DMat3::from_diagonal(DVec3::new(1.0, 10f64.powi(-exponent), 10f64.powi(-exponent)));
        built(&mapped(&globe(20, |_| 0.0), needle, DVec3::ZERO));
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
