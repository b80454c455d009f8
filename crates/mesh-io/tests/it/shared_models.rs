//! Loading against the figures of the models that lie beside the repository, when they do.

#![expect(clippy::print_stdout, reason = "what each file gave, and what was skipped, is the test's report")]

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;

use palpate_mesh_io::{LoadOptions, LoadWarning, LoadedMesh, load, repair, self_intersections, write_obj};

fn models() -> Option<PathBuf> {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/models"));
    if !folder.is_dir() {
        // Directly to the stream: the test runner captures the output of the print macros.
        let _ = writeln!(std::io::stderr(), "skipped: {} is absent", folder.display());
        return None;
    }
    Some(folder.to_path_buf())
}

fn figures(models: &Path) -> serde_json::Map<String, serde_json::Value> {
    let text = fs::read_to_string(models.join("figures.json")).unwrap();
    serde_json::from_str(&text).unwrap()
}

fn load_default(path: &Path) -> LoadedMesh {
    load(path, &LoadOptions::default()).unwrap()
}

/// One file whose published count of intersecting pairs differs from ours: see
/// `intersections_match_the_figures`.
const COUNTED_DIFFERENTLY: &str = "nasty/nonmanifold_openscad_crash.obj";

#[test]
fn counts_and_radius_match_the_figures() {
    let Some(models) = models() else { return };
    for (name, figure) in figures(&models) {
        let loaded = load_default(&models.join(&name));
        let number = |key: &str| figure[key].as_u64().unwrap() as usize;
        assert_eq!(loaded.raw_vertices, number("V_raw"), "{name}: vertices in the file");
        assert_eq!(loaded.mesh.vertices().len(), number("V"), "{name}: vertices after welding");
        assert_eq!(loaded.mesh.triangles().len(), number("F"), "{name}: triangles");
        let radius = figure["R"].as_f64().unwrap();
        let ours = loaded.mesh.bounding_sphere().radius;
        assert!((ours - radius).abs() <= 1e-12 * radius, "{name}: bounding radius {ours} against {radius}");
        let doubtful = !(5e-4..=5.0).contains(&radius);
        let units: Vec<_> = loaded
            .warnings
            .iter()
            .filter_map(|warning| match warning {
                LoadWarning::Units { suggested, .. } => Some(*suggested),
                _ => None,
            })
            .collect();
        // All models that are not in metres are in millimetres but one, which is too large for that by any
        // measure.
        let expected = if radius > 5e3 { Some(1e-6) } else { Some(1e-3) };
        assert_eq!(units, if doubtful { vec![expected] } else { Vec::new() }, "{name}");
    }
}

/// All files but one match the published counts. In `nonmanifold_openscad_crash.obj`, which has 18
/// non-manifold edges, duplicate and zero-area triangles all over each other, we count 6600 pairs that share
/// no vertex, 887 that share one and 55 that share an edge and are folded flat onto each other, 7542 in all,
/// against 7518 published.
#[test]
fn intersections_match_the_figures() {
    let Some(models) = models() else { return };
    for (name, figure) in figures(&models) {
        let mesh = load_default(&models.join(&name)).mesh;
        let found = self_intersections(&mesh);
        let expected = if name == COUNTED_DIFFERENTLY { 7542 } else { figure["selfint"].as_u64().unwrap() };
        assert_eq!(found.count as u64, expected, "{name}");
        assert_eq!(found.first.is_some(), expected > 0, "{name}");
    }
}

#[test]
fn good_models_need_no_repair() {
    let Some(models) = models() else { return };
    for name in figures(&models).keys().filter(|name| name.starts_with("good/")) {
        let mesh = load_default(&models.join(name)).mesh;
        let (repaired, summary) = repair(&mesh);
        assert_eq!(summary, Default::default(), "{name}");
        assert_eq!(repaired, mesh, "{name}");
    }
}

/// Every file, however broken, soon gives a mesh or an error of one line.
#[test]
fn every_file_loads_or_says_why_not() {
    let Some(models) = models() else { return };
    let mut files: Vec<PathBuf> = ["good", "nasty", "nasty/loader"]
        .iter()
        .flat_map(|folder| fs::read_dir(models.join(folder)).unwrap())
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.is_file())
        .collect();
    files.sort();
    for path in files {
        for repair in [false, true] {
            let start = Instant::now();
            let outcome = load(&path, &LoadOptions { repair, ..LoadOptions::default() });
            let seconds = start.elapsed().as_secs_f64();
            let name = path.strip_prefix(&models).unwrap().display();
            assert!(seconds < 10.0, "{name}: {seconds} s");
            match outcome {
                Ok(loaded) => {
                    let mesh = &loaded.mesh;
                    assert!(
                        !mesh.triangles().is_empty() && mesh.vertices().iter().all(|v| v.is_finite()),
                        "{name}"
                    );
                    assert!(
                        loaded.warnings.iter().all(|w| !w.to_string().contains('\n')),
                        "{name}: {:?}",
                        loaded.warnings
                    );
                    let (v, t) = (mesh.vertices().len(), mesh.triangles().len());
                    println!(
                        "{name}{}: {v} vertices, {t} triangles {:?}",
                        if repair { " (repair)" } else { "" },
                        loaded.warnings
                    );
                }
                Err(error) => {
                    let message = error.to_string();
                    assert!(!message.contains('\n') && message.len() < 500, "{name}: {message}");
                    assert!(
                        message.starts_with(&path.display().to_string()) || message.contains(".bin"),
                        "{message}"
                    );
                    println!("{name}: {}", message.replace(&format!("{}/", models.display()), ""));
                }
            }
        }
    }
}

/// The features that the loader's own small files test, as far as they can be seen from the outside.
#[test]
fn small_files_give_what_they_hold() {
    let Some(models) = models() else { return };
    let folder = models.join("nasty/loader");
    for (name, vertices, triangles) in [
        ("box_without_lineending.obj", 8, 12),
        ("trimesh_negative_indices.obj", 8, 12),
        ("trimesh_nancolor.obj", 8, 12),
        ("trimesh_multi.ply", 4, 2),
        ("cube_binary_header_with_RN_newline.ply", 8, 12),
        ("cube_binary_starts_with_nl.ply", 8, 12),
        ("triangle_with_two_solids.stl", 6, 2),
        ("triangle_with_empty_solid.stl", 3, 1),
        ("trimesh_two_objects_mixed_case_names.stl", 16, 24),
        ("Mesh_PrimitiveMode_05.gltf", 4, 2),
        ("SimpleSparseAccessor.gltf", 14, 12),
        ("eof_test.obj", 3, 1),
        ("multiple_spaces.obj", 3, 1),
        ("leading-decimal-dot-issue-201.obj", 3, 1),
    ] {
        let mesh = load_default(&folder.join(name)).mesh;
        assert_eq!((mesh.vertices().len(), mesh.triangles().len()), (vertices, triangles), "{name}");
    }
    for (name, part) in [
        ("Box_Draco.glb", "KHR_draco_mesh_compression"),
        ("RecursiveNodes.gltf", "reached twice"),
        ("MissingBin.gltf", ".bin"),
        ("AllIndicesOutOfRange.gltf", "names vertex"),
        ("BoxWithInfinites.glb", "repair the mesh"),
        ("box_UTF16BE.obj", "UTF-16"),
        ("malformed.obj", "line 28"),
        ("issue-140-zero-face-idx.obj", "line 16"),
        ("line-prim.obj", "no triangles"),
        ("point_cloud.obj", "no triangles"),
        ("points.ply", "no triangles"),
        ("draco_inf_nan.obj", "vertex 0, used by triangle 0"),
        ("glb_empty_file.glb", "empty"),
        ("trimesh_empty.stl", "no triangles"),
    ] {
        let message = load(&folder.join(name), &LoadOptions::default()).unwrap_err().to_string();
        assert!(message.contains(part), "{name}: {message}");
    }
}

/// For files that plain `tobj` reads correctly, the pass before it changes nothing: the corner positions are
/// the same, triangle for triangle.
#[test]
fn obj_agrees_with_tobj() {
    let Some(models) = models() else { return };
    for name in figures(&models).keys().filter(|name| name.ends_with(".obj")) {
        let path = models.join(name);
        let (parts, _) =
            tobj::load_obj(&path, &tobj::LoadOptions { triangulate: true, ..Default::default() }).unwrap();
        let theirs = parts.iter().flat_map(|part| {
            part.mesh
                .indices
                .iter()
                .map(|&i| [0, 1, 2].map(|axis| part.mesh.positions[3 * i as usize + axis]))
        });
        let mesh = load(&path, &LoadOptions { weld: false, ..LoadOptions::default() }).unwrap().mesh;
        let ours = (0..mesh.triangles().len()).flat_map(|t| mesh.corners(t)).map(|v| v.to_array());
        assert!(ours.eq(theirs), "{name}");
    }
}

#[test]
fn written_meshes_read_back_equal() {
    let Some(models) = models() else { return };
    let folder = tempfile::tempdir().unwrap();
    for name in ["good/bracket.stl", "nasty/huge_offset_12shells.obj"] {
        let mesh = load_default(&models.join(name)).mesh;
        let path = folder.path().join("copy.OBJ");
        write_obj(&mesh, std::io::BufWriter::new(fs::File::create(&path).unwrap())).unwrap();
        assert_eq!(load_default(&path).mesh, mesh, "{name}");
    }
}
