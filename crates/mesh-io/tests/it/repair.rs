//! Repair against validation and the exact intersection test, on files and on meshes broken on purpose.

#![expect(clippy::print_stdout, reason = "what each file lost, and what was skipped, is the test's report")]

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use palpate_core::TriMesh;
use palpate_core::glam::DVec3;
use palpate_mesh_io::{LoadOptions, RepairSummary, load, repair, weld};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};

use crate::shapes::{assert_sound, ball, repaired, together};

fn models() -> Option<PathBuf> {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/models"));
    if !folder.is_dir() {
        // Directly to the stream: the test runner captures the output of the print macros.
        let _ = writeln!(std::io::stderr(), "skipped: {} is absent", folder.display());
        return None;
    }
    Some(folder.to_path_buf())
}

/// Beginnings of file names, with the largest loss of surface that could be touched, in percent of the area.
const LOSSES: [(&str, f64); 9] = [
    ("huge_offset_12shells", 0.1),
    ("inverted_degenerate_sphere", 0.0),
    ("nonmanifold_flipped_skull", 1.5),
    ("nonmanifold_openscad_crash", 40.0),
    ("open_76shells_maxilla", 6.0),
    ("overlapping_23shells_dog_jaw", 2.0),
    ("selfintersect_closed", 1.0),
    ("soup_100tri", 85.0),
    ("tjunction_cracks_nut", 0.0),
];

/// Files that enclose a volume once they are repaired.
const SOLID: [&str; 3] = ["huge_offset_12shells", "inverted_degenerate_sphere", "tjunction_cracks_nut"];

#[test]
fn nasty_files_are_sound_after_repair() {
    let Some(models) = models() else { return };
    for folder in ["nasty", "nasty/loader"] {
        let mut files: Vec<PathBuf> =
            fs::read_dir(models.join(folder)).unwrap().map(|entry| entry.unwrap().path()).collect();
        files.sort();
        for path in files {
            let Ok(loaded) = load(&path, &LoadOptions::default()) else { continue };
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            let before = loaded.mesh;
            // Faces that lie on each other all over, where another repair finds more.
            let tangled =
                ["nonmanifold_openscad_crash", "open_76shells"].iter().any(|start| name.starts_with(start));
            let (after, summary) = if tangled { repair(&before) } else { repaired(&before, &name) };
            assert_sound(&after, &name);
            let mended = load(&path, &LoadOptions { repair: true, ..LoadOptions::default() });
            let effect = mended.ok().and_then(|mended| mended.effect).unwrap_or_default();
            let lost = 100.0 * effect.lost_area / effect.area_before.max(f64::MIN_POSITIVE);
            let (triangles, left) = (before.triangles().len(), after.triangles().len());
            println!(
                "{name}: {triangles} triangles before, {left} after, {lost:.3} % of the area lost: {summary}"
            );
            if let Some((_, most)) = LOSSES.iter().find(|(start, _)| name.starts_with(start)) {
                assert!(lost <= most + 1e-9, "{name}: {lost} %");
            }
            if SOLID.iter().any(|start| name.starts_with(start)) {
                assert!(after.validate().is_solid(), "{name}");
            }
        }
    }
}

/// The triangles dropped are those that the files' published figures count as defects.
#[test]
fn dropped_triangles_match_the_figures() {
    let Some(models) = models() else { return };
    let figures: serde_json::Map<String, serde_json::Value> =
        serde_json::from_str(&fs::read_to_string(models.join("figures.json")).unwrap()).unwrap();
    // Without the slowest files, which the other test covers.
    let files = figures.iter().filter(|(name, _)| name.starts_with("nasty/") && !name.contains("huge"));
    for (name, figure) in files {
        let mesh = load(&models.join(name), &LoadOptions::default()).unwrap().mesh;
        let (repaired, summary) = repair(&mesh);
        let number = |key: &str| figure[key].as_u64().unwrap() as usize;
        // Low triangles along cracks go as well.
        assert!(summary.degenerate_triangles >= number("idxdeg") + number("zeroarea"), "{name}");
        assert!(summary.duplicate_triangles >= number("dupF"), "{name}");
        assert_eq!(
            summary.intersecting_triangles + summary.cut_triangles > 0,
            number("selfint") > 0 && !name.contains("tjunction"),
            "{name}"
        );
        if name.contains("inverted_degenerate_sphere") {
            assert_eq!((summary.inverted_components, summary.flipped_triangles), (1, 3840), "{name}");
            let volume = repaired.mass_properties(1.0).unwrap().volume;
            assert!((volume + figure["vol"].as_f64().unwrap()).abs() < 1e-9 * volume, "{name}: {volume}");
        }
        if name.contains("tjunction") {
            // The same nut, with its cracks, is among the good models.
            let whole = load(&models.join("good/nut_m16.obj"), &LoadOptions::default()).unwrap().mesh;
            let [ours, theirs] = [&repaired, &whole].map(|m| m.mass_properties(1.0).unwrap().volume);
            assert!((ours - theirs).abs() < 1e-9 * theirs, "{name}: {ours} against {theirs}");
        }
    }
}

#[test]
fn a_sound_mesh_is_left_alone() {
    for mesh in [
        ball(8, DVec3::ZERO, 1.0),
        together(&[ball(6, DVec3::ZERO, 1.0), ball(5, DVec3::X * 3.0, 0.5)]),
        // Open.
        TriMesh::new(vec![DVec3::ZERO, DVec3::X, DVec3::Y], vec![[0, 1, 2]]).unwrap(),
    ] {
        assert_eq!(repair(&mesh), (mesh, RepairSummary::default()));
    }
}

/// Breaks a mesh in every way at once, at random.
#[test]
fn meshes_broken_at_random_are_sound_after_repair() {
    let seed = 73;
    println!("seed {seed}");
    let mut random = StdRng::seed_from_u64(seed);
    let mut total = [0usize; 9];
    for round in 0..150 {
        let shells: Vec<TriMesh> = (0..1 + round % 3)
            .map(|_| {
                let mut axis = || random.random_range(-1.0..1.0);
                ball(6, DVec3::new(axis(), axis(), axis()) * 0.8, 1.0)
            })
            .collect();
        let mesh = weld(&together(&shells));
        let (mut vertices, mut triangles) = (mesh.vertices().to_vec(), mesh.triangles().to_vec());
        let mut any = |count: usize| random.random_range(0..count);
        for _ in 0..any(6) {
            let t = any(triangles.len());
            let [a, b, c] = triangles[t];
            match any(8) {
                0 => triangles.push([a, b, a]),
                1 => triangles.push([b, a, c]),
                2 => triangles[t] = [b, a, c],
                3 => vertices[a as usize] *= 0.1 * any(20) as f64,
                4 => triangles[t] = [a, any(vertices.len()) as u32, c],
                5 => {
                    triangles.remove(t);
                }
                6 => {
                    // A sliver between two triangles, or a crack.
                    let middle = vertices.len() as u32;
                    vertices.push(0.5 * (vertices[a as usize] + vertices[b as usize]));
                    triangles[t] = [a, middle, c];
                    triangles.push([middle, b, c]);
                    if any(2) == 0 {
                        triangles.push([a, b, middle]);
                    }
                }
                _ => triangles.push([a, b, any(vertices.len()) as u32]),
            }
        }
        let broken = weld(&TriMesh::new(vertices, triangles).unwrap());
        let (_, s) = repaired(&broken, &format!("seed {seed}, round {round}"));
        let counts = [
            s.degenerate_triangles,
            s.duplicate_triangles,
            s.split_triangles,
            s.flipped_triangles,
            s.duplicated_vertices,
            s.unparted_triangles,
            s.united_components,
            s.cut_triangles,
            s.hidden_triangles,
        ];
        for (sum, count) in total.iter_mut().zip(counts) {
            *sum += count;
        }
    }
    println!("{total:?}");
    assert!(total.iter().all(|count| *count > 0), "every kind of repair is met: {total:?}");
}

#[test]
fn any_tangle_is_sound_after_repair() {
    let seed = 79;
    println!("seed {seed}");
    let mut random = StdRng::seed_from_u64(seed);
    let mut changed_again = 0;
    for round in 0..100 {
        let count = 3 + round % 40;
        // On a coarse lattice, so that vertices coincide, line up and share planes; or anywhere.
        let lattice = round % 2 == 0;
        let mut coordinate =
            || if lattice { f64::from(random.random_range(-2..=2)) } else { random.random_range(-1.0..1.0) };
        let vertices = (0..count).map(|_| DVec3::new(coordinate(), coordinate(), coordinate())).collect();
        let triangles =
            (0..2 * count).map(|_| [0; 3].map(|_| random.random_range(0..count as u32))).collect();
        let mesh = TriMesh::new(vertices, triangles).unwrap();
        let name = format!("seed {seed}, round {round}");
        // Also where equal positions are not the same vertex.
        for mesh in [weld(&mesh), mesh] {
            let (result, _) = repair(&mesh);
            assert_sound(&result, &name);
            changed_again += usize::from(repair(&result).0 != result);
        }
    }
    println!("{changed_again} of 200 are changed by another repair");
    assert!(changed_again <= 10, "{changed_again}");
}

#[test]
fn sheets_that_meet_are_parted_and_lose_nothing() {
    // Two cubes that share an edge; and two that share a corner.
    let cube = |shift: DVec3| {
        let corners =
            (0..8).map(|i| shift + DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2)));
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles = quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
        TriMesh::new(corners.collect(), triangles).unwrap()
    };
    for (shift, copies) in [(DVec3::new(1.0, 1.0, 0.0), 2), (DVec3::ONE, 1)] {
        let mesh = weld(&together(&[cube(DVec3::ZERO), cube(shift)]));
        assert!(!mesh.validate().manifold);
        let (parted, summary) = repaired(&mesh, "cubes");
        assert_eq!(summary, RepairSummary { duplicated_vertices: copies, ..RepairSummary::default() });
        let report = parted.validate();
        assert!(report.is_solid() && report.components == 2 && report.volume == 2.0, "{report:?}");
    }
}
