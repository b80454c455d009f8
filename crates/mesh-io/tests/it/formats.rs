//! One cube in every format and variant, written here byte by byte, loads back as the same cube.

use std::fs;
use std::path::PathBuf;

use glam::DVec3;
use palpate_core::{TriMesh, glam};
use palpate_mesh_io::{LoadError, LoadOptions, LoadWarning, LoadedMesh, load};
use serde_json::{Value, json};
use tempfile::TempDir;

/// Corners at (±1, ±1, ±1); corner number i has the signs of i's bits (x lowest).
fn corner(i: u32) -> DVec3 {
    let sign = |bit: u32| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
    DVec3::new(sign(0), sign(1), sign(2))
}

/// Counter-clockwise from outside.
const QUADS: [[u32; 4]; 6] =
    [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];

fn triangles() -> Vec<[u32; 3]> {
    QUADS.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect()
}

/// The triangles as positions, so that the numbering of vertices does not matter; each from its smallest
/// corner on.
fn soup(mesh: &TriMesh) -> Vec<[[i64; 3]; 3]> {
    let mut soup: Vec<_> = (0..mesh.triangles().len())
        .map(|t| {
            let mut corners = mesh.corners(t).map(|p| (p * 1e6).round().to_array().map(|x| x as i64));
            let smallest = (0..3).min_by_key(|&k| corners[k]).unwrap();
            corners.rotate_left(smallest);
            corners
        })
        .collect();
    soup.sort_unstable();
    soup
}

fn cube() -> TriMesh {
    TriMesh::new((0..8).map(corner).collect(), triangles()).unwrap()
}

struct Folder(TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn file(&self, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
        let path = self.0.path().join(name);
        fs::write(&path, content).unwrap();
        path
    }

    fn load(&self, name: &str, content: impl AsRef<[u8]>) -> Result<LoadedMesh, LoadError> {
        load(&self.file(name, content), &LoadOptions::default())
    }

    fn expect_cube(&self, name: &str, content: impl AsRef<[u8]>) -> LoadedMesh {
        let loaded = self.load(name, content).unwrap();
        assert_eq!(loaded.mesh.vertices().len(), 8, "{name}");
        assert_eq!(soup(&loaded.mesh), soup(&cube()), "{name}");
        loaded
    }

    fn expect_error(&self, name: &str, content: impl AsRef<[u8]>, part: &str) {
        let message = self.load(name, content).unwrap_err().to_string();
        assert!(message.contains(part) && !message.contains('\n'), "{name}: {message:?} lacks {part:?}");
    }
}

fn obj_vertices() -> String {
    (0..8).map(corner).map(|v| format!("v {} {} {}\n", v.x, v.y, v.z)).collect()
}

#[test]
fn obj() {
    let folder = Folder::new();
    let quads: String = QUADS
        .iter()
        .map(|q| format!("f {}/1/1 {}//2 {}/3 {}\n", q[0] + 1, q[1] + 1, q[2] + 1, q[3] + 1))
        .collect();
    let relative: String = triangles()
        .iter()
        .map(|t| t.map(|v| (v as i64 - 8).to_string()).join(" "))
        .map(|f| format!("f {f}\n"))
        .collect();
    folder.expect_cube("quads.obj", obj_vertices() + &quads);
    folder.expect_cube("faces_first.Obj", quads.clone() + &obj_vertices());
    folder.expect_cube("relative.OBJ", obj_vertices() + &relative);
    folder.expect_cube("crlf.obj", (obj_vertices() + &quads).replace('\n', "\r\n"));
    folder.expect_cube("old_mac.obj", (obj_vertices() + &quads).replace('\n', "\r"));
    folder.expect_cube("continued.obj", obj_vertices() + &quads.replace(" ", " \\\n"));
    folder.expect_cube(
        "marked.obj",
        [b"\xef\xbb\xbf# caf\xe9\n".as_slice(), (obj_vertices() + &quads).as_bytes()].concat(),
    );
    folder.expect_cube(
        "groups.obj",
        obj_vertices() + "o a\ns 1\nusemtl\n" + &quads.replacen('\n', " # end\ng b\n", 3),
    );
    let loaded = folder.expect_cube("more.obj", obj_vertices() + "l 1 2 3\np 4\nf 1 2\n" + &quads);
    assert_eq!(loaded.warnings.len(), 3, "{:?}", loaded.warnings);
    assert!(loaded.warnings.iter().any(|w| w.to_string().contains("line 11")), "{:?}", loaded.warnings);

    folder.expect_error("zero.obj", obj_vertices() + "f 1 2 0\n", "line 9: the face names vertex 0");
    folder.expect_error(
        "far.obj",
        obj_vertices() + "f 1 2 3\nf 1 2 99\n",
        "line 10: the face names vertex 99",
    );
    folder.expect_error("before.obj", "v 0 0 0\nf -2 1 1\n", "line 2");
    folder.expect_error("huge.obj", obj_vertices() + "f 1 2 99999999999999999999\n", "line 9");
    folder.expect_error("4g.obj", obj_vertices() + "f 1 2 4294967297\n", "4294967297");
    folder.expect_error("word.obj", "v 0 zero 0\n", "line 1: \"zero\" is not a number");
    folder.expect_error("short.obj", "v 0 0\n", "no z");
    folder.expect_error("nan.obj", "v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n", "vertex 2, used by triangle 0");
    folder.expect_error("points.obj", obj_vertices(), "no triangles");
    folder.expect_error("empty.obj", "", "empty");
    folder.expect_error("binary.obj", [0; 100], "text");
}

/// Files that plain `tobj` reads wrongly load as the same tetrahedron, thanks to the pass before it.
#[test]
fn obj_that_tobj_alone_gets_wrong() {
    const VERTICES: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n";
    const FACES: &str = "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";
    let folder = Folder::new();
    let usual = format!("{VERTICES}{FACES}");
    let expected = folder.load("usual.obj", &usual).unwrap().mesh;
    assert_eq!(expected.vertices(), [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z]);
    assert_eq!(expected.triangles(), [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]);
    // With the vertices in one pool in the file's order.
    let plainly_right = |content: &[u8]| {
        let options = tobj::LoadOptions { triangulate: true, ..Default::default() };
        let no_materials = |_: &std::path::Path| Err(tobj::LoadError::OpenFileFailed);
        let Ok((models, _)) = tobj::load_obj_buf(&mut &*content, &options, no_materials) else {
            return false;
        };
        let [model] = models.as_slice() else { return false };
        let corners = model.mesh.indices.iter().map(|&i| &model.mesh.positions[3 * i as usize..][..3]);
        corners.eq((0..4)
            .flat_map(|t| expected.triangles()[t])
            .map(|v| expected.vertices()[v as usize].as_ref()))
    };
    assert!(plainly_right(usual.as_bytes()), "the control tells right from wrong");
    for (name, content) in [
        ("polyline", format!("{usual}l 1 2 3\n").into_bytes()),
        ("groups", format!("{VERTICES}{}", FACES.replacen("\n", "\ng side\n", 2)).into_bytes()),
        ("material", format!("{VERTICES}{}", FACES.replacen("\n", "\nusemtl\n", 1)).into_bytes()),
        ("latin1", [b"# caf\xe9\n".as_slice(), usual.as_bytes()].concat()),
        ("latin1_name", [usual.as_bytes(), b"o caf\xe9\n"].concat()),
        ("comment", usual.replace("f 1 2 4", "f 1 2 4 # side").into_bytes()),
        ("comment_after_vertex", usual.replace("v 1 0 0", "v 1 0 0 # corner").into_bytes()),
        ("continued", usual.replace("f 1 2 4", "f 1 \\\n2 4").into_bytes()),
        ("returns", usual.replace('\n', "\r").into_bytes()),
        ("fo", usual.replace("f 1 2 4", "fo 1 2 4").into_bytes()),
        ("weight", usual.replace("v 1 0 0", "v 1 0 0 2").into_bytes()),
        ("no_weight", usual.replace("v 1 0 0", "v 1 0 0 0").into_bytes()),
        (
            "some_colours",
            usual.replace("v 0 0 1", "v 0 0 1 1 0 0").replace("v 0 0 0\n", "v 0 0 0 1 1 1\n").into_bytes(),
        ),
        ("colour_alpha", usual.replace("v 1 0 0", "v 1 0 0 1 0 0 1").into_bytes()),
        ("texture_index", usual.replace("f 1 2 4", "f 1/x 2/y 4/z").into_bytes()),
        ("texture_u", format!("vt 1\n{usual}").into_bytes()),
        ("normal", format!("vn 1 0 1.#IND\n{usual}").into_bytes()),
        ("unused", format!("{usual}v 7 7 1.#QNAN\n").into_bytes()),
    ] {
        assert!(!plainly_right(&content), "{name} needs no pass");
        assert_eq!(folder.load(&format!("{name}.obj"), content).unwrap().mesh, expected, "{name}");
    }
    // Names of other files do not matter, nor do those that tobj leaves alone.
    folder.load("absent.obj", format!("mtllib absent.mtl\n{usual}")).unwrap();
}

/// Many models' worth of faces, for which the reader starts new models: the vertices stay in one pool, in the
/// file's order.
#[test]
fn obj_of_many_faces_has_one_pool_of_vertices() {
    use std::fmt::Write;
    let folder = Folder::new();
    let count = 20_000_usize;
    let vertex = |i: usize| DVec3::new(i as f64, (i % 7) as f64, 0.25 * (i % 11) as f64);
    // All over the file.
    let face = |i: usize| [i, (i * 7919 + 1) % count, (i * 104_729 + 2) % count];
    let (mut vertices, mut faces, mut relative) = (String::new(), String::new(), String::new());
    for i in 0..count {
        let DVec3 { x, y, z } = vertex(i);
        writeln!(vertices, "v {x} {y} {z}").unwrap();
        let [a, b, c] = face(i);
        writeln!(faces, "f {} {} {}", a + 1, b + 1, c + 1).unwrap();
        writeln!(relative, "f {} {} {}", a as i64 - count as i64, b + 1, c as i64 - count as i64).unwrap();
    }
    let expected = TriMesh::new(
        (0..count).map(vertex).collect(),
        (0..count).map(|i| face(i).map(|v| v as u32)).collect(),
    );
    let expected = expected.unwrap();
    for content in [vertices.clone() + &faces, vertices.clone() + &relative, faces.clone() + &vertices] {
        let loaded = folder.load("many.obj", content).unwrap();
        assert_eq!((loaded.mesh, loaded.raw_vertices), (expected.clone(), count));
    }
    // A vertex that no face names leaves the order of the others alone.
    let loaded = folder.load("unused.obj", "v 5 5 5\nv 1 0 0\nv 0 1 0\nv 0 0 0\nf 2 3 4\n").unwrap();
    assert_eq!(loaded.mesh.vertices(), [DVec3::X, DVec3::Y, DVec3::ZERO]);
    assert_eq!(loaded.raw_vertices, 4);
    // A fault far behind is found.
    folder.expect_error(
        "far.obj",
        format!("{vertices}{faces}f 1 2 20001\n"),
        "line 40001: the face names vertex 20001",
    );
}

/// Faults that `tobj` refuses without naming the line, misreads or overflows on.
#[test]
fn obj_faults_have_their_line_and_remedy() {
    let folder = Folder::new();
    for (name, line, part) in [
        ("short", "v 1 2", "line 9: the vertex has no z coordinate"),
        ("word", "v 1 2 x", "line 9: \"x\" is not a number"),
        ("comma", "v 1,0 2 3", "line 9: \"1,0\" is not a number"),
        ("space", "v 1\u{a0}2 3 4", "line 9: \"1\\u{a0}2\""),
        ("face_space", "f 1 2 3\u{a0}4", "line 9: \"3\\u{a0}4\" is not a vertex index"),
        ("no_vertex", "f /1 /2 /3", "line 9: \"/1\" is not a vertex index"),
        ("fraction", "f 1 2 3.5", "line 9: \"3.5\" is not a vertex index"),
        ("zero", "f 1 2 0", "line 9: the face names vertex 0"),
        ("minus_zero", "f 1 2 -0", "line 9: the face names vertex 0"),
        ("before", "f 1 2 -9", "line 9: the face names vertex -9, but only 8 come before it"),
        ("farthest", "f 1 2 -9223372036854775808", "line 9: the face names vertex -9223372036854775808"),
        ("beyond", "f 1 2 9", "line 9: the face names vertex 9, but the file has 8"),
        ("most", "f 1 2 9223372036854775807", "line 9: the face names vertex 9223372036854775807"),
        ("continued", "f 1 \\\n2 \\\n99", "line 9: the face names vertex 99"),
    ] {
        let content = format!("{}{line}\nf 1 2 3\n", obj_vertices());
        folder.expect_error(&format!("{name}.obj"), &content, part);
        folder.expect_error(&format!("{name}.obj"), &content, "correct that line");
    }
    // A word that cannot be parsed is reported before a vertex that does not exist, as in readers that go
    // line by line.
    folder.expect_error("two.obj", obj_vertices() + "f 1 2 99\nf 1 2 0\n", "line 10");
}

fn stl_facets(triangles: &[[u32; 3]]) -> String {
    let vertex = |&i: &u32| format!("vertex {:e} {} {}\n", corner(i).x, corner(i).y, corner(i).z);
    triangles
        .iter()
        .map(|t| {
            format!(
                "facet normal 0 0 0\nouter loop\n{}endloop\nendfacet\n",
                t.iter().map(vertex).collect::<String>()
            )
        })
        .collect()
}

fn binary_stl(header: &[u8]) -> Vec<u8> {
    let mut bytes = header.to_vec();
    bytes.resize(80, b' ');
    bytes.extend(12_u32.to_le_bytes());
    for t in triangles() {
        bytes.extend([0; 12]);
        bytes.extend(t.iter().flat_map(|&i| corner(i).as_vec3().to_array()).flat_map(f32::to_le_bytes));
        bytes.extend([0; 2]);
    }
    bytes
}

#[test]
fn stl() {
    let folder = Folder::new();
    let all = triangles();
    let loaded =
        folder.expect_cube("ascii.stl", format!("solid a cube\n{}endsolid a cube\n", stl_facets(&all)));
    assert_eq!(loaded.raw_vertices, 36);
    let (first, second) = (stl_facets(&all[..5]), stl_facets(&all[5..]));
    folder.expect_cube("two.stl", format!("SOLID a\n{first}ENDSOLID a\nsolid\n{second}endsolid"));
    folder.expect_cube(
        "upper.STL",
        format!("solid\n{}endsolid", stl_facets(&all)).to_uppercase().replace('\n', "\r\n"),
    );
    folder.expect_cube("binary.stl", binary_stl(b"made here"));
    folder.expect_cube("solid.stl", binary_stl(b"solid but binary"));
    let loaded = folder.expect_cube("longer.stl", [binary_stl(b""), vec![1; 7]].concat());
    assert_eq!(loaded.warnings, [LoadWarning::TrailingBytes { count: 7 }]);
    assert!(loaded.warnings[0].to_string().contains("7 bytes"));

    folder.expect_error("cut.stl", &binary_stl(b"")[..400], "12 triangles");
    folder.expect_error("tiny.stl", [1; 50], "84 bytes");
    folder.expect_error("two_corners.stl", "solid\nfacet\nvertex 0 0 0\nvertex 0 0 1\nendfacet\n", "line 5");
    folder.expect_error(
        "four.stl",
        "solid\nfacet\nvertex 0 0 0\nvertex 0 0 1\nvertex 0 0 1\nvertex 0 0 1\n",
        "line 6",
    );
    folder.expect_error("open.stl", "solid\nfacet\nvertex 0 0 0\n", "not finished");
    folder.expect_error("noise.stl", "solid\nfacte\n", "line 2");
    let mut nan = binary_stl(b"");
    nan[84 + 50 + 12..][..4].copy_from_slice(&f32::NAN.to_le_bytes());
    folder.expect_error("nan.stl", &nan, "used by triangle 1");
    let path = folder.file("nan.stl", nan);
    let repaired = load(&path, &LoadOptions { repair: true, ..LoadOptions::default() }).unwrap();
    assert_eq!(repaired.repairs.unwrap().nonfinite_triangles, 1);
    assert_eq!(repaired.mesh.triangles().len(), 11);
}

#[test]
fn ply() {
    let folder = Folder::new();
    let header = |format: &str, real: &str, list: &str| {
        format!(
            "ply\nformat {format} 1.0\ncomment nothing\nelement vertex 8\nproperty uchar red\nproperty {real} x\nproperty {real} y\n\
             property {real} z\nelement edge 1\nproperty list uchar short odd\nelement face 6\nproperty list {list} vertex_indices\n\
             property float quality\nend_header\n"
        )
    };
    let mut ascii = header("ascii", "float", "uchar int");
    for v in (0..8).map(corner) {
        ascii += &format!("255 {} {:.1} {}\n", v.x, v.y, v.z);
    }
    ascii += "2 5 6\n";
    for [a, b, c, d] in QUADS {
        ascii += &format!("4 {a} {b} {c} {d} .5\n");
    }
    folder.expect_cube("ascii.ply", &ascii);
    folder.expect_cube("ascii_crlf.PLY", ascii.replace('\n', "\r\n"));
    let binary = |big: bool| {
        let put = |bytes: &[u8]| if big { bytes.iter().rev().copied().collect() } else { bytes.to_vec() };
        let format = if big { "binary_big_endian" } else { "binary_little_endian" };
        let mut bytes = header(format, "double", "ushort uint").into_bytes();
        for v in (0..8).map(corner) {
            bytes.push(255);
            v.to_array().iter().for_each(|x| bytes.extend(put(&x.to_le_bytes())));
        }
        bytes.push(2);
        [5_i16, 6].iter().for_each(|i| bytes.extend(put(&i.to_le_bytes())));
        for quad in QUADS {
            bytes.extend(put(&4_u16.to_le_bytes()));
            quad.iter().for_each(|i| bytes.extend(put(&i.to_le_bytes())));
            bytes.extend(put(&0.5_f32.to_le_bytes()));
        }
        bytes
    };
    folder.expect_cube("little.ply", binary(false));
    folder.expect_cube("big.ply", binary(true));

    let little = binary(false);
    folder.expect_error("cut.ply", &little[..little.len() - 3], "\"face\" 5");
    folder.expect_error("range.ply", ascii.replace("4 0 2 3 1", "4 0 2 8 1"), "vertex 8");
    folder.expect_error("negative.ply", ascii.replace("4 0 2 3 1", "4 0 2 -3 1"), "vertex -3");
    folder.expect_error("list.ply", ascii.replace("4 0 2 3 1", "4000000000 0 2 3 1"), "4000000000 entries");
    let many = ascii.replace("element vertex 8", "element vertex 99999999999");
    folder.expect_error("many.ply", many, "99999999999 instances");
    let nothing = "ply\nformat ascii 1.0\nelement ghost 18446744073709551615\nend_header\n";
    folder.expect_error("ghost.ply", nothing, "\"ghost\"");
    folder.expect_error("no_z.ply", ascii.replace("float z", "float w"), "x, y and z");
    folder.expect_error("float_index.ply", ascii.replace("uchar int", "uchar float"), "integers");
    folder.expect_error("no_format.ply", ascii.replace("format", "comment"), "names no format");
    folder.expect_error("not.ply", "plywood\n", "does not start");
}

/// The pieces of a glTF file in the making.
#[derive(Default)]
struct Scene {
    data: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    primitives: Vec<Value>,
    nodes: Vec<Value>,
    required: Vec<&'static str>,
}

impl Scene {
    fn view(&mut self, bytes: impl IntoIterator<Item = u8>, stride: Option<usize>) -> usize {
        self.data.resize(self.data.len().next_multiple_of(4), 0);
        let offset = self.data.len();
        self.data.extend(bytes);
        let mut view = json!({"buffer": 0, "byteOffset": offset, "byteLength": self.data.len() - offset});
        if let Some(stride) = stride {
            view["byteStride"] = json!(stride);
        }
        self.views.push(view);
        self.views.len() - 1
    }

    fn accessor(&mut self, accessor: Value) -> usize {
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    fn positions(&mut self, points: &[DVec3]) -> usize {
        let bytes: Vec<u8> =
            points.iter().flat_map(|p| p.as_vec3().to_array()).flat_map(f32::to_le_bytes).collect();
        let view = self.view(bytes, None);
        self.accessor(
            json!({"bufferView": view, "componentType": 5126, "count": points.len(), "type": "VEC3"}),
        )
    }

    fn indices(&mut self, indices: &[u32]) -> usize {
        let view = self.view(indices.iter().map(|&i| i as u8), None);
        self.accessor(
            json!({"bufferView": view, "componentType": 5121, "count": indices.len(), "type": "SCALAR"}),
        )
    }

    fn primitive(&mut self, positions: usize, indices: Option<usize>, mode: u32) {
        let mut primitive = json!({"attributes": {"POSITION": positions}, "mode": mode});
        if let Some(indices) = indices {
            primitive["indices"] = json!(indices);
        }
        self.primitives.push(primitive);
    }

    fn json(&self, uri: Option<&str>) -> Value {
        let mut buffer = json!({"byteLength": self.data.len()});
        if let Some(uri) = uri {
            buffer["uri"] = json!(uri);
        }
        let nodes = if self.nodes.is_empty() { vec![json!({"mesh": 0})] } else { self.nodes.clone() };
        json!({
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": nodes,
            "meshes": [{"primitives": self.primitives}], "accessors": self.accessors, "bufferViews": self.views,
            "buffers": [buffer], "extensionsUsed": self.required, "extensionsRequired": self.required,
        })
    }

    fn glb(&self) -> Vec<u8> {
        let mut json = self.json(None).to_string().into_bytes();
        json.resize(json.len().next_multiple_of(4), b' ');
        let mut bin = self.data.clone();
        bin.resize(bin.len().next_multiple_of(4), 0);
        let length = 12 + 8 + json.len() + 8 + bin.len();
        let mut bytes = b"glTF".to_vec();
        bytes.extend([2_u32, length as u32, json.len() as u32].iter().flat_map(|n| n.to_le_bytes()));
        bytes.extend(b"JSON");
        bytes.extend(json);
        bytes.extend((bin.len() as u32).to_le_bytes());
        bytes.extend(b"BIN\0");
        bytes.extend(bin);
        bytes
    }
}

fn corners() -> Vec<DVec3> {
    (0..8).map(corner).collect()
}

fn indexed_cube() -> Scene {
    let mut scene = Scene::default();
    let positions = scene.positions(&corners());
    let indices = scene.indices(triangles().as_flattened());
    scene.primitive(positions, Some(indices), 4);
    scene
}

#[test]
fn gltf_containers() {
    let folder = Folder::new();
    let scene = indexed_cube();
    folder.expect_cube("cube.GLB", scene.glb());
    folder.file("the data.bin", &scene.data);
    folder.expect_cube("external.gltf", scene.json(Some("the%20data.bin")).to_string());
    use base64::Engine;
    let base64 = base64::engine::general_purpose::STANDARD.encode(&scene.data);
    let uri = format!("data:application/octet-stream;base64,{base64}");
    folder.expect_cube("embedded.gltf", scene.json(Some(&uri)).to_string());

    folder.expect_error("absent.gltf", scene.json(Some("none.bin")).to_string(), "none.bin");
    folder.expect_error(
        "web.gltf",
        scene.json(Some("https://example.org/a.bin")).to_string(),
        "neither relative",
    );
    folder.expect_error("root.gltf", scene.json(Some("/etc/passwd")).to_string(), "neither relative");
    folder.expect_error("folder.gltf", scene.json(Some("..")).to_string(), "not a regular file");
    folder.expect_error("no_uri.gltf", scene.json(None).to_string(), "buffer 0");
    folder.file("short.bin", &scene.data[..20]);
    folder.expect_error("short.gltf", scene.json(Some("short.bin")).to_string(), "20 bytes");
    folder.expect_error("json.gltf", "{", "JSON");
    folder.expect_error("deep.gltf", "[".repeat(100_000), "JSON");
    for length in 0..scene.glb().len() {
        let cut = &scene.glb()[..length];
        assert!(folder.load("cut.glb", cut).is_err(), "{length} bytes");
    }
}

#[test]
fn gltf_primitives() {
    let folder = Folder::new();
    // No indices.
    let mut scene = Scene::default();
    let points: Vec<DVec3> = triangles().iter().flatten().map(|&i| corner(i)).collect();
    let positions = scene.positions(&points);
    scene.primitive(positions, None, 4);
    assert_eq!(folder.expect_cube("soup.glb", scene.glb()).raw_vertices, 36);
    // A strip for each quad a b c d: a b d c.
    let mut scene = Scene::default();
    let positions = scene.positions(&corners());
    for [a, b, c, d] in QUADS {
        let indices = scene.indices(&[b, c, a, d]);
        scene.primitive(positions, Some(indices), 5);
    }
    assert_eq!(
        folder.expect_cube("strips.glb", scene.glb()).raw_vertices,
        8,
        "shared positions are loaded once"
    );
    // One strip, stitched by repeated corners: six a quad, so that each starts on an even one and faces
    // outwards.
    let mut scene = Scene::default();
    let positions = scene.positions(&corners());
    let next = |i: usize| QUADS[(i + 1) % 6][1];
    let stitched: Vec<u32> =
        QUADS.iter().enumerate().flat_map(|(i, &[a, b, c, d])| [b, c, a, d, d, next(i)]).collect();
    let indices = scene.indices(&stitched);
    scene.primitive(positions, Some(indices), 5);
    folder.expect_cube("strip.glb", scene.glb());
    // Fans of quads, beside points and lines.
    let mut scene = Scene::default();
    let positions = scene.positions(&corners());
    for quad in QUADS {
        let indices = scene.indices(&quad);
        scene.primitive(positions, Some(indices), 6);
    }
    scene.primitive(positions, None, 0);
    scene.primitive(positions, None, 3);
    let loaded = folder.expect_cube("fans.glb", scene.glb());
    assert_eq!(loaded.warnings.len(), 2, "{:?}", loaded.warnings);
    // Corners left over.
    let mut scene = Scene::default();
    let positions = scene.positions(&corners());
    let mut some = triangles().as_flattened().to_vec();
    some.extend([1, 2]);
    let indices = scene.indices(&some);
    scene.primitive(positions, Some(indices), 4);
    assert!(folder.expect_cube("left.glb", scene.glb()).warnings[0].to_string().contains("left over"));

    let mut scene = indexed_cube();
    scene.data[96] = 8;
    folder.expect_error("range.glb", scene.glb(), "index 0 names vertex 8");
    let mut scene = indexed_cube();
    scene.primitive(7, None, 4);
    folder.expect_error("accessor.glb", scene.glb(), "accessor 7");
    let mut scene = indexed_cube();
    scene.primitive(1, None, 4);
    folder.expect_error("type.glb", scene.glb(), "VEC3");
    for (field, value) in [
        ("count", json!(9)),
        ("byteOffset", json!(4)),
        ("count", json!(u64::MAX)),
        ("byteOffset", json!(u64::MAX)),
    ] {
        let mut scene = indexed_cube();
        scene.accessors[0][field] = value;
        assert!(folder.load("beyond.glb", scene.glb()).is_err(), "{field}");
    }
    for (field, value) in [
        ("byteOffset", json!(u64::MAX)),
        ("byteLength", json!(u64::MAX)),
        ("byteStride", json!(u64::MAX)),
        ("byteStride", json!(4)),
        ("buffer", json!(3)),
    ] {
        let mut scene = indexed_cube();
        scene.views[0][field] = value;
        assert!(folder.load("view.glb", scene.glb()).is_err(), "{field}");
    }
}

#[test]
fn gltf_accessors() {
    let folder = Folder::new();
    let indices = triangles();
    // Interleaved with something else.
    let mut scene = Scene::default();
    let bytes: Vec<u8> = (0..8)
        .flat_map(|i| corner(i).as_vec3().to_array().into_iter().chain([7.0, 7.0]))
        .flat_map(f32::to_le_bytes)
        .collect();
    let view = scene.view(bytes, Some(20));
    let positions =
        scene.accessor(json!({"bufferView": view, "componentType": 5126, "count": 8, "type": "VEC3"}));
    let list = scene.indices(indices.as_flattened());
    scene.primitive(positions, Some(list), 4);
    folder.expect_cube("interleaved.glb", scene.glb());

    // Quantised to 8 and 16 bits, as they are and normalised; scaled and moved back by the node.
    let quantised = |component: u32, normalized: bool, encode: &dyn Fn(f64) -> Vec<u8>, node: Value| {
        let mut scene =
            Scene { required: vec!["KHR_mesh_quantization"], nodes: vec![node], ..Scene::default() };
        let width = encode(1.0).len();
        let bytes: Vec<u8> = (0..8)
            .flat_map(|i| {
                let mut element: Vec<u8> = corner(i).to_array().iter().flat_map(|&x| encode(x)).collect();
                element.resize(4 * width, 0);
                element
            })
            .collect();
        let view = scene.view(bytes, Some(4 * width));
        let positions = scene.accessor(
            json!({"bufferView": view, "componentType": component, "normalized": normalized, "count": 8, "type": "VEC3"}),
        );
        let list = scene.indices(triangles().as_flattened());
        scene.primitive(positions, Some(list), 4);
        scene
    };
    let plain = json!({"mesh": 0});
    let halves = json!({"mesh": 0, "scale": [2, 2, 2], "translation": [-1, -1, -1]});
    for (name, scene) in [
        ("i8.glb", quantised(5120, false, &|x| vec![x as i8 as u8], plain.clone())),
        ("i8n.glb", quantised(5120, true, &|x| vec![(x * 127.0) as i8 as u8], plain.clone())),
        ("i8n_low.glb", quantised(5120, true, &|x| vec![if x < 0.0 { 128 } else { 127 }], plain.clone())),
        ("u8n.glb", quantised(5121, true, &|x| vec![if x < 0.0 { 0 } else { 255 }], halves.clone())),
        ("i16.glb", quantised(5122, false, &|x| (x as i16).to_le_bytes().to_vec(), plain.clone())),
        ("i16n.glb", quantised(5122, true, &|x| ((x * 32767.0) as i16).to_le_bytes().to_vec(), plain)),
        ("u16n.glb", quantised(5123, true, &|x| if x < 0.0 { vec![0, 0] } else { vec![255, 255] }, halves)),
    ] {
        folder.expect_cube(name, scene.glb());
    }

    // Sparse: over data, and over nothing (zeros).
    for based in [true, false] {
        let mut scene = Scene::default();
        let wrong: Vec<DVec3> =
            (0..8).map(|i| if i % 3 == 0 { DVec3::splat(9.0) } else { corner(i) }).collect();
        let positions = scene.positions(&wrong);
        let replaced: Vec<u32> = (0..8).filter(|i| !based || i % 3 == 0).collect();
        let at = scene.view(replaced.iter().flat_map(|&i| (i as u16).to_le_bytes()), None);
        let values = replaced.iter().flat_map(|&i| corner(i).as_vec3().to_array()).flat_map(f32::to_le_bytes);
        let values = scene.view(values, None);
        scene.accessors[positions]["sparse"] = json!({
            "count": replaced.len(), "indices": {"bufferView": at, "componentType": 5123}, "values": {"bufferView": values},
        });
        if !based {
            scene.accessors[positions].as_object_mut().unwrap().remove("bufferView");
        }
        let list = scene.indices(indices.as_flattened());
        scene.primitive(positions, Some(list), 4);
        folder.expect_cube("sparse.glb", scene.glb());
        scene.accessors[positions]["sparse"]["count"] = json!(9);
        assert!(folder.load("sparse.glb", scene.glb()).is_err());
        scene.accessors[positions]["sparse"]["count"] = json!(replaced.len());
        scene.accessors[positions]["count"] = json!(3);
        folder.expect_error("sparse.glb", scene.glb(), "sparse");
    }

    // Compressed.
    for name in ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "MY_own_shapes"] {
        let mut scene = indexed_cube();
        scene.required.push(name);
        folder.expect_error("compressed.glb", scene.glb(), name);
    }
    let mut scene = indexed_cube();
    scene.accessors[0].as_object_mut().unwrap().remove("bufferView");
    folder.expect_error("nothing.glb", scene.glb(), "has no data");
}

#[test]
fn gltf_nodes() {
    let folder = Folder::new();
    // Placed by a matrix and, one level down, by parts that undo it.
    let mut scene = indexed_cube();
    let (sin, cos) = (0.6, 0.8);
    scene.nodes = vec![
        json!({"children": [1], "matrix": [0, 2, 0, 0, -2, 0, 0, 0, 0, 0, 2, 0, 5, 6, 7, 1]}),
        json!({"children": [2], "translation": [-3, 2.5, -3.5], "scale": [0.5, 0.5, 0.5]}),
        json!({"mesh": 0, "rotation": [0, 0, -f64::sqrt(0.5), f64::sqrt(0.5)]}),
    ];
    folder.expect_cube("placed.glb", scene.glb());
    // A rotated cube is where it should be.
    scene.nodes = vec![json!({"mesh": 0, "rotation": [0, 0, sin, cos]})];
    let turned = folder.load("turned.glb", scene.glb()).unwrap().mesh;
    let expected = glam::DQuat::from_xyzw(0.0, 0.0, sin, cos) * corner(0);
    let nearest = turned.vertices().iter().map(|v| v.distance(expected)).fold(f64::INFINITY, f64::min);
    assert!(nearest < 1e-7, "{nearest}");
    // A mirrored cube still faces outwards.
    scene.nodes = vec![json!({"mesh": 0, "scale": [-1, 1, 1]})];
    let mirrored = folder.load("mirrored.glb", scene.glb()).unwrap().mesh;
    assert!((mirrored.mass_properties(1.0).unwrap().volume - 8.0).abs() < 1e-12);
    // Two instances.
    scene.nodes = vec![json!({"mesh": 0, "children": [1]}), json!({"mesh": 0, "translation": [4, 0, 0]})];
    assert_eq!(folder.load("twice.glb", scene.glb()).unwrap().mesh.triangles().len(), 24);
    // A long chain is no recursion.
    scene.nodes = (1..=50_000).map(|child| json!({"children": [child]})).collect();
    scene.nodes.push(json!({"mesh": 0}));
    folder.expect_cube("chain.glb", scene.glb());
    for (name, nodes) in [
        ("itself", vec![json!({"children": [0]})]),
        ("loop", vec![json!({"children": [1]}), json!({"children": [0]})]),
        ("two_parents", vec![json!({"children": [1, 2]}), json!({"children": [2]}), json!({"mesh": 0})]),
    ] {
        scene.nodes = nodes;
        folder.expect_error(&format!("{name}.glb"), scene.glb(), "reached twice");
    }
    scene.nodes = vec![json!({"children": [77]})];
    folder.expect_error("child.glb", scene.glb(), "node 77");
    scene.nodes = vec![json!({"mesh": 77})];
    folder.expect_error("mesh.glb", scene.glb(), "mesh 77");
    // Without a scene.
    let mut file = indexed_cube().json(Some("cube.bin"));
    folder.file("cube.bin", indexed_cube().data);
    file.as_object_mut().unwrap().retain(|key, _| !key.starts_with("scene") && key != "nodes");
    folder.expect_cube("no_scene.gltf", file.to_string());
}

#[test]
fn options() {
    let folder = Folder::new();
    let path = folder.file("cube.stl", binary_stl(b""));
    let with = |options: LoadOptions| load(&path, &options);
    let cube = with(LoadOptions { scale: 0.001, ..LoadOptions::default() }).unwrap();
    assert!((cube.mesh.bounding_sphere().radius - 0.001 * 3.0_f64.sqrt()).abs() < 1e-18);
    assert!(cube.warnings.is_empty() && cube.repairs.is_none());
    // The radius of the file's cube, √3, is plausible for something held in centimetres.
    for scale in [1e-6, 100.0] {
        let warnings = with(LoadOptions { scale, ..LoadOptions::default() }).unwrap().warnings;
        let [LoadWarning::Units { radius, suggested: Some(0.01) }] = warnings[..] else {
            panic!("{warnings:?}")
        };
        assert!((radius / scale - 3.0_f64.sqrt()).abs() < 1e-12, "{radius}");
        let line = warnings[0].to_string();
        assert!(line.contains("try a scale of 0.01") && !line.contains('\n'), "{line}");
    }
    let raw = with(LoadOptions { weld: false, ..LoadOptions::default() }).unwrap();
    assert_eq!((raw.mesh.vertices().len(), raw.raw_vertices), (36, 36));
    let repaired = with(LoadOptions { weld: false, repair: true, ..LoadOptions::default() }).unwrap();
    assert_eq!(repaired.mesh.vertices().len(), 8);
    assert_eq!(repaired.repairs, Some(Default::default()));
    for scale in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(
            with(LoadOptions { scale, ..LoadOptions::default() }),
            Err(LoadError::Scale { .. })
        ));
    }
    // Scaled out of the range of numbers.
    assert!(matches!(
        with(LoadOptions { scale: f64::MAX, ..LoadOptions::default() }),
        Ok(_) | Err(LoadError::NonFinite { .. })
    ));
    for name in ["cube.fbx", "cube"] {
        let message = load(&folder.file(name, "x"), &LoadOptions::default()).unwrap_err().to_string();
        assert!(
            [".obj", ".gltf", ".glb", ".stl", ".ply"].iter().all(|known| message.contains(known)),
            "{message}"
        );
    }
    let absent = load(&folder.0.path().join("absent.obj"), &LoadOptions::default()).unwrap_err().to_string();
    assert!(absent.contains("absent.obj: cannot be read"), "{absent}");
    fs::create_dir(folder.0.path().join("folder.obj")).unwrap();
    let message = load(&folder.0.path().join("folder.obj"), &LoadOptions::default()).unwrap_err().to_string();
    assert!(message.contains("not a regular file"), "{message}");
}

/// Thousands of damaged copies of a file in every format each give a mesh or an error.
#[test]
fn damaged_files_never_panic() {
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};
    let seed = 23;
    let mut random = StdRng::seed_from_u64(seed);
    let folder = Folder::new();
    let quads: String = QUADS
        .iter()
        .map(|q| format!("f {}/-1/1 {} {} {}\n", q[0] + 1, q[1] + 1, q[2] + 1, q[3] + 1))
        .collect();
    let ascii_ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n\
                     property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    let mut binary_ply =
        ascii_ply[..ascii_ply.find("0 0 0").unwrap()].replace("ascii", "binary_little_endian").into_bytes();
    binary_ply.extend([0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].iter().flat_map(|x| x.to_le_bytes()));
    binary_ply.push(3);
    binary_ply.extend([0_i32, 1, 2].iter().flat_map(|x| x.to_le_bytes()));
    let files: [(&str, Vec<u8>); 7] = [
        ("damaged.obj", (obj_vertices() + &quads).into_bytes()),
        ("ascii.stl", format!("solid\n{}endsolid", stl_facets(&triangles())).into_bytes()),
        ("binary.stl", binary_stl(b"")),
        ("ascii.ply", ascii_ply.as_bytes().to_vec()),
        ("binary.ply", binary_ply),
        ("damaged.glb", indexed_cube().glb()),
        ("damaged.gltf", indexed_cube().json(Some("cube.bin")).to_string().into_bytes()),
    ];
    folder.file("cube.bin", indexed_cube().data);
    let mut loaded = 0;
    for (name, original) in &files {
        assert!(folder.load(name, original).is_ok(), "{name}");
        for round in 0..400 {
            let mut bytes = original.clone();
            for _ in 0..random.random_range(1..6) {
                let at = random.random_range(0..bytes.len());
                match random.random_range(0..5) {
                    0 => bytes[at] = random.random_range(0..=255),
                    1 => bytes[at] = *b"0123456789-.e/ \n".get(random.random_range(0..16)).unwrap(),
                    2 => bytes.truncate(at.max(1)),
                    3 => {
                        let end = (at + random.random_range(1..20)).min(bytes.len());
                        bytes.drain(at..end);
                    }
                    _ => {
                        let end = (at + random.random_range(1..20)).min(bytes.len());
                        let copy = bytes[at..end].to_vec();
                        let to = random.random_range(0..bytes.len());
                        bytes.splice(to..to, copy);
                    }
                }
                if bytes.is_empty() {
                    bytes.push(b'9');
                }
            }
            let path = folder.file(name, &bytes);
            for repair in [false, true] {
                match load(&path, &LoadOptions { repair, ..LoadOptions::default() }) {
                    Ok(mesh) => {
                        assert!(mesh.mesh.vertices().iter().all(|v| v.is_finite()));
                        palpate_mesh_io::self_intersections(&mesh.mesh);
                        loaded += 1;
                    }
                    Err(error) => {
                        let message = error.to_string();
                        assert!(
                            !message.contains(['\n', '\r']),
                            "seed {seed}, {name}, round {round}: {message:?}"
                        );
                    }
                }
            }
        }
    }
    assert!(loaded > 300, "the damage should leave some files usable: {loaded}");
}
