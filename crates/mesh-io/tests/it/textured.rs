//! Meshes with texture coordinates and height textures, from files written here.

use std::fs;
use std::path::PathBuf;

use base64::Engine;
use glam::{DVec2, DVec3};
use palpate_core::glam;
use palpate_mesh_io::{LoadError, LoadOptions, LoadedUvMesh, TextureWrap, load, load_uv};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use serde_json::{Value, json};
use tempfile::TempDir;

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

    fn load(&self, name: &str, content: impl AsRef<[u8]>) -> Result<LoadedUvMesh, LoadError> {
        load_uv(&self.file(name, content), &LoadOptions::default())
    }

    fn expect_error(&self, name: &str, content: impl AsRef<[u8]>, parts: &[&str]) {
        let message = self.load(name, content).unwrap_err().to_string();
        let lacking: Vec<_> = parts.iter().filter(|part| !message.contains(**part)).collect();
        assert!(lacking.is_empty() && !message.contains('\n'), "{name}: {message:?} lacks {lacking:?}");
    }
}

/// Two squares that share the edge x = 1, whose coordinates differ there: a seam. v points up, as in OBJ.
const SEAM: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 2 0 0\nv 2 1 0\n\
    vt 0 0\nvt 0.5 0\nvt 0.5 0.25\nvt 0 0.25\nvt 0.75 0.5\nvt 1 0.5\nvt 1 0.75 7\nvt 0.75 0.75\n\
    f 1/1 2/2/1 3/3 4/4\nf 2/5 5/6 6/-2 3/8\n";

fn uv(u: f64, v: f64) -> DVec2 {
    DVec2::new(u, v)
}

#[test]
fn obj_corners_keep_their_coordinates_at_seams() {
    let loaded = Folder::new().load("seam.obj", SEAM).unwrap();
    let mesh = &loaded.mesh;
    assert_eq!(mesh.mesh().vertices().len(), 6);
    assert_eq!(mesh.mesh().triangles().len(), 4);
    assert!(loaded.height_texture.is_none() && loaded.warnings.is_empty());
    // The position of each corner determines its coordinates, with v turned over.
    for (triangle, coordinates) in mesh.coordinates().iter().enumerate() {
        let first = triangle < 2;
        for (corner, found) in mesh.mesh().corners(triangle).iter().zip(coordinates) {
            let expected = match first {
                true => uv(corner.x / 2.0, 1.0 - corner.y / 4.0),
                false => uv(0.5 + corner.x / 4.0, 0.5 - corner.y / 4.0),
            };
            assert_eq!(*found, expected, "triangle {triangle}, {corner}");
        }
    }
}

#[test]
fn scale_applies_to_positions_only_and_welding_closes_seams() {
    let folder = Folder::new();
    // The seam's vertices are doubled.
    let parted = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 1\nvt .5 1\nvt 0 .5\nvt 1 1\nvt 1 .5\nvt .25 0\n\
        f 1/1 2/2 3/3\nf 4/4 5/5 6/6\n";
    let path = folder.file("parted.obj", parted);
    let with = |options| load_uv(&path, &options).unwrap().mesh;
    let welded = with(LoadOptions { scale: 0.1, ..LoadOptions::default() });
    assert_eq!(welded.mesh().triangles(), [[0, 1, 2], [1, 3, 2]]);
    assert_eq!(welded.mesh().vertices()[1], DVec3::X * 0.1);
    let corners = [[uv(0., 0.), uv(0.5, 0.), uv(0., 0.5)], [uv(1., 0.), uv(1., 0.5), uv(0.25, 1.)]];
    assert_eq!(welded.coordinates(), corners);
    let raw = with(LoadOptions { weld: false, ..LoadOptions::default() });
    assert_eq!((raw.mesh().vertices().len(), raw.coordinates()), (6, corners.as_slice()));
    let repair = load_uv(&path, &LoadOptions { repair: true, ..LoadOptions::default() });
    assert!(repair.unwrap_err().to_string().contains("repair"));
}

#[test]
fn obj_polygons_cut_as_without_coordinates() {
    let folder = Folder::new();
    // Coordinates equal positions, so that every cut can be checked; concave, with a corner that is repeated.
    let outline = [[0., 0.], [4., 0.], [4., 0.], [4., 3.], [2., 1.], [0., 3.], [0., 0.]];
    let mut text = String::new();
    for [x, y] in outline {
        text += &format!("v {x} {y} 0\nvt {x} {}\n", 1.0 - y);
    }
    text += "f 1/1 2/2 2/2 4/4 5/5 6/6 1/1\n";
    let loaded = folder.load("concave.obj", &text).unwrap().mesh;
    assert_eq!(loaded.mesh().triangles().len(), 3);
    for (triangle, coordinates) in loaded.coordinates().iter().enumerate() {
        assert_eq!(
            loaded.mesh().corners(triangle).map(|p| p.truncate()),
            *coordinates,
            "triangle {triangle}"
        );
    }
    let plain = load(&folder.file("concave.obj", &text), &LoadOptions::default()).unwrap();
    assert_eq!(plain.mesh, *loaded.mesh());
}

#[test]
fn obj_faults_are_reported_with_their_line() {
    let folder = Folder::new();
    let square = "v 0 0 0\nv 1 0 0\nv 1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\n";
    let check = |name: &str, faces: &str, parts: &[&str]| {
        folder.expect_error(&format!("{name}.obj"), format!("{square}{faces}"), parts);
    };
    check("none", "f 1 2 3\nf 1//1 2//1 3//1\n", &["line 7", "no face", "unwrap"]);
    check("one", "f 1/1 2/2 3/3\nf 1/1 2/2 3\n", &["line 8", "corner 3", "unwrap"]);
    check("two", "f 1/1 2/2 3/3\nf 1 2/2 3/3\nf 1/ 2/2 3/1\n", &["line 8", "corner 1", "2 faces of 3"]);
    check("far", "f 1/1 2/2 3/4\n", &["line 7", "texture coordinate 4", "has 3"]);
    check("zero", "f 1/0 2/2 3/3\n", &["line 7", "texture coordinate 0"]);
    check("before", "f 1/-4 2/2 3/3\n", &["line 7", "only 3"]);
    check("minus_zero", "f 1/1 2/-0 3/3\n", &["line 7", "texture coordinate 0"]);
    // Twice the index overflows to 0 and to 2⁶³.
    check("farthest", "f 1/-9223372036854775808 2/2 3/3\n", &["line 7", "only 3"]);
    check("half", "f 1/-4611686018427387904 2/2 3/3\n", &["line 7", "only 3"]);
    check("word", "f 1/x 2/2 3/3\n", &["line 7", "texture coordinate index"]);
    check("nan", "vt nan 0\nf 1/4 2/2 3/3\nf 1/1 2/2 3/3\n", &["triangle 0", "not a finite number"]);
    check("text", "vt 0 y\nf 1/1 2/2 3/3\n", &["line 7", "\"y\""]);
    check("empty_vt", "vt\nf 1/1 2/2 3/3\n", &["line 7", "no u"]);
    // Coordinates may come after the faces, and need not be used.
    let late = "v 0 0 0\nv 1 0 0\nv 1 1 0\nvt inf 0\nf 1/2 2/3 3/4\nf 1 2\nvt 0\nvt 1 0\nvt 1 1\n";
    let loaded = folder.load("late.obj", late).unwrap();
    assert_eq!(loaded.mesh.coordinates(), [[uv(0., 1.), uv(1., 1.), uv(1., 0.)]]);
    // None of this matters when loading without coordinates.
    for faces in ["f 1/9 2/x 3/0\n", "vt x\nf 1 2 3\n"] {
        let path = folder.file("plain.obj", format!("{square}{faces}"));
        assert_eq!(load(&path, &LoadOptions::default()).unwrap().mesh.triangles().len(), 1, "{faces}");
    }
    for name in ["some.stl", "some.PLY"] {
        folder.expect_error(name, "solid", &["no texture coordinates", "OBJ or glTF"]);
    }
}

/// A square of two triangles in glTF, its coordinates in the sets that are asked for.
struct Scene {
    data: Vec<u8>,
    file: Value,
}

impl Scene {
    fn new() -> Self {
        let file = json!({
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
            "materials": [{}], "accessors": [], "bufferViews": [], "buffers": [{}],
        });
        let mut scene = Self { data: Vec::new(), file };
        let positions = [[0_f32, 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]];
        scene.accessor(
            &bytes(positions.as_flattened(), f32::to_le_bytes),
            4,
            json!({"componentType": 5126, "type": "VEC3"}),
        );
        scene.accessor(&[0, 1, 2, 0, 2, 3], 6, json!({"componentType": 5121, "type": "SCALAR"}));
        scene
    }

    /// With coordinates equal to x and y in the set `set`.
    fn textured(set: u32) -> Self {
        let mut scene = Self::new();
        scene.set(
            set,
            &bytes(&[0_f32, 0., 1., 0., 1., 1., 0., 1.], f32::to_le_bytes),
            json!({"componentType": 5126}),
        );
        scene
    }

    fn view(&mut self, bytes: &[u8]) -> usize {
        self.data.resize(self.data.len().next_multiple_of(4), 0);
        let view = json!({"buffer": 0, "byteOffset": self.data.len(), "byteLength": bytes.len()});
        self.data.extend_from_slice(bytes);
        let views = self.file["bufferViews"].as_array_mut().unwrap();
        views.push(view);
        views.len() - 1
    }

    fn accessor(&mut self, bytes: &[u8], count: usize, mut about: Value) -> usize {
        about["bufferView"] = json!(self.view(bytes));
        about["count"] = json!(count);
        let accessors = self.file["accessors"].as_array_mut().unwrap();
        accessors.push(about);
        accessors.len() - 1
    }

    fn set(&mut self, set: u32, bytes: &[u8], mut about: Value) {
        about["type"] = json!("VEC2");
        let accessor = self.accessor(bytes, 4, about);
        self.primitive(0)["attributes"][format!("TEXCOORD_{set}")] = json!(accessor);
    }

    fn primitive(&mut self, primitive: usize) -> &mut Value {
        &mut self.file["meshes"][0]["primitives"][primitive]
    }

    fn height(mut self, info: Value) -> Self {
        self.file["materials"][0]["extras"] = json!({"other": [[1]], "heightTexture": info});
        self.file["textures"] = json!([{"source": 0, "sampler": 0}]);
        self.file["samplers"] = json!([{"wrapS": 33071, "wrapT": 33648}]);
        self
    }

    fn text(&self) -> String {
        let mut file = self.file.clone();
        file["buffers"] = json!([{"byteLength": self.data.len(), "uri": data_uri(&self.data)}]);
        file.to_string()
    }
}

fn bytes<T: Copy, const N: usize>(values: &[T], encode: impl Fn(T) -> [u8; N]) -> Vec<u8> {
    values.iter().flat_map(|&value| encode(value)).collect()
}

fn data_uri(bytes: &[u8]) -> String {
    format!(
        "data:application/octet-stream;base64,{}",
        base64::engine::general_purpose::STANDARD.encode(bytes)
    )
}

fn check_square(loaded: &LoadedUvMesh, tolerance: f64, case: &str) {
    assert_eq!(loaded.mesh.mesh().triangles().len(), 2, "{case}");
    for (triangle, coordinates) in loaded.mesh.coordinates().iter().enumerate() {
        for (corner, found) in loaded.mesh.mesh().corners(triangle).iter().zip(coordinates) {
            assert!(corner.truncate().distance(*found) <= tolerance, "{case}: {found} at {corner}");
        }
    }
}

#[test]
fn gltf_coordinates_in_all_their_types() {
    let folder = Folder::new();
    check_square(&folder.load("f32.gltf", Scene::textured(0).text()).unwrap(), 0.0, "f32");
    let mut scene = Scene::new();
    scene.set(0, &[0, 0, 255, 0, 255, 255, 0, 255], json!({"componentType": 5121, "normalized": true}));
    check_square(&folder.load("u8.gltf", scene.text()).unwrap(), 0.0, "u8");
    let mut scene = Scene::new();
    let words = bytes(&[0_u16, 0, 65535, 0, 65535, 65535, 0, 65535], u16::to_le_bytes);
    scene.set(0, &words, json!({"componentType": 5123, "normalized": true}));
    check_square(&folder.load("u16.gltf", scene.text()).unwrap(), 0.0, "u16");
    // Placed in a mirror, corners and coordinates are turned over together.
    let mut scene = Scene::textured(0);
    scene.file["nodes"][0]["scale"] = json!([1, 1, -1]);
    let mirrored = folder.load("mirror.gltf", scene.text()).unwrap();
    check_square(&mirrored, 0.0, "mirror");
    assert_eq!(mirrored.mesh.mesh().triangles()[0], [0, 2, 1]);
    // Strips and fans.
    for (mode, list) in [(5, [0, 1, 3, 2]), (6, [0, 1, 2, 3])] {
        let mut scene = Scene::textured(0);
        let indices = scene.accessor(&list, 4, json!({"componentType": 5121, "type": "SCALAR"}));
        *scene.primitive(0) =
            json!({"attributes": {"POSITION": 0, "TEXCOORD_0": 2}, "indices": indices, "mode": mode});
        check_square(&folder.load("strip.gltf", scene.text()).unwrap(), 0.0, "strip or fan");
    }
    let mut scene = Scene::textured(0);
    scene.file["extensionsUsed"] = json!(["KHR_texture_transform"]);
    let warnings = folder.load("transform.gltf", scene.text()).unwrap().warnings;
    assert!(warnings.iter().any(|w| w.to_string().contains("KHR_texture_transform")), "{warnings:?}");
}

#[test]
fn gltf_faults_of_coordinates() {
    let folder = Folder::new();
    folder.expect_error("none.gltf", Scene::new().text(), &["mesh 0, primitive 0", "TEXCOORD_0", "unwrap"]);
    folder.expect_error("set.gltf", Scene::textured(1).text(), &["TEXCOORD_0"]);
    let mut scene = Scene::textured(0);
    scene.file["accessors"][2]["count"] = json!(3);
    folder.expect_error("count.gltf", scene.text(), &["4 positions", "3 texture"]);
    let mut scene = Scene::textured(0);
    scene.file["accessors"][2]["type"] = json!("VEC3");
    folder.expect_error("type.gltf", scene.text(), &["accessor 2 (TEXCOORD_0)", "VEC2"]);
    let mut scene = Scene::textured(0);
    let at = scene.data.len() - 4;
    scene.data[at..].copy_from_slice(&f32::NAN.to_le_bytes());
    folder.expect_error("nan.gltf", scene.text(), &["triangle 1", "not a finite number"]);
    let mut scene = Scene::textured(0);
    scene.primitive(0)["material"] = json!(4);
    folder.expect_error("material.gltf", scene.text(), &["material 4"]);
}

const IMAGE: &[u8] = b"an image, for all that is known here";

#[test]
fn height_textures_from_views_uris_and_files() {
    let folder = Folder::new();
    folder.file("height map.png", IMAGE);
    let info = json!({"index": 0, "texCoord": 2, "amplitude": 0.004, "midlevel": 0.25, "unknown": {}});
    let with = |image: &dyn Fn(&mut Scene) -> Value| {
        let mut scene = Scene::textured(2).height(info.clone());
        let image = image(&mut scene);
        scene.file["images"] = json!([image]);
        scene.text()
    };
    for (case, name, text) in [
        ("file", "height map.png", with(&|_| json!({"uri": "height%20map.png"}))),
        ("uri", "image 0", with(&|_| json!({"uri": data_uri(IMAGE)}))),
        ("view", "image 0", with(&|scene| json!({"bufferView": scene.view(IMAGE), "mimeType": "image/png"}))),
    ] {
        let loaded = folder.load("height.gltf", text).unwrap();
        check_square(&loaded, 0.0, case);
        let height = loaded.height_texture.unwrap();
        assert_eq!(height.bytes, IMAGE, "{case}");
        assert!(height.name.contains(name), "{case}: {}", height.name);
        assert_eq!((height.amplitude, height.midlevel), (0.004, 0.25), "{case}");
        assert_eq!(height.wrap, [TextureWrap::ClampToEdge, TextureWrap::MirroredRepeat], "{case}");
    }
    let mut scene = Scene::textured(0).height(json!({"index": 0, "amplitude": 1e-3}));
    scene.file["images"] = json!([{"uri": data_uri(IMAGE)}]);
    scene.file["textures"] = json!([{"source": 0}]);
    let height = folder.load("defaults.gltf", scene.text()).unwrap().height_texture.unwrap();
    assert_eq!((height.midlevel, height.wrap), (0.5, [TextureWrap::Repeat; 2]));
    // Extras of others are theirs.
    for extras in [json!("text"), json!([1, 2]), json!({"heightTexture": null}), json!(null), json!({})] {
        let mut scene = Scene::textured(0);
        scene.file["materials"][0]["extras"] = extras;
        assert!(folder.load("extras.gltf", scene.text()).unwrap().height_texture.is_none());
    }
}

#[test]
fn faulty_height_textures_are_refused() {
    let folder = Folder::new();
    let good = || json!({"index": 0, "amplitude": 0.001});
    let check = |change: &dyn Fn(&mut Scene), parts: &[&str]| {
        let mut scene = Scene::textured(0).height(good());
        scene.file["images"] = json!([{"uri": data_uri(IMAGE)}]);
        change(&mut scene);
        folder.expect_error("height.gltf", scene.text(), parts);
    };
    let info = |change: Value| {
        move |scene: &mut Scene| {
            let info = scene.file["materials"][0]["extras"]["heightTexture"].as_object_mut().unwrap();
            info.extend(change.as_object().unwrap().clone());
        }
    };
    check(&info(json!({"amplitude": 0})), &["material 0, heightTexture", "amplitude"]);
    check(&info(json!({"amplitude": -1.0})), &["amplitude"]);
    check(&info(json!({"amplitude": "high"})), &["material 0, extras", "amplitude (m)"]);
    check(&info(json!({"index": 5})), &["texture 5"]);
    check(&info(json!({"index": -1})), &["extras"]);
    check(&info(json!({"texCoord": 3})), &["TEXCOORD_3"]);
    check(
        &info(json!({"extensions": {"KHR_texture_transform": {"scale": [2, 2]}}})),
        &["KHR_texture_transform", "apply"],
    );
    check(&|s| s.file["materials"][0]["extras"]["heightTexture"] = json!({"index": 0}), &["amplitude"]);
    check(&|s| s.file["textures"] = json!([{}]), &["texture 0 has no image"]);
    check(&|s| s.file["textures"] = json!([{"source": 0, "sampler": 9}]), &["sampler 9"]);
    check(&|s| s.file["samplers"] = json!([{"wrapS": 5}]), &["sampler 0", "wrapping"]);
    let image = |image: Value| move |scene: &mut Scene| scene.file["images"] = json!([image]);
    check(&image(json!({})), &["image 0", "needs a uri or a buffer view"]);
    check(&image(json!({"uri": "/etc/hostname"})), &["image uri", "neither relative nor data"]);
    check(&image(json!({"uri": "https://example.org/a.png"})), &["neither relative nor data"]);
    check(&image(json!({"uri": "absent.png"})), &["absent.png", "cannot be read"]);
    check(&image(json!({"uri": ".."})), &["not a regular file"]);
    check(&image(json!({"uri": "data:image/png,abc"})), &["image 0", "not base64"]);
    check(&image(json!({"uri": "data:;base64,"})), &["image 0", "empty"]);
    check(&image(json!({"bufferView": 77})), &["buffer view 77"]);
    check(
        &|s| {
            let view = s.view(IMAGE);
            s.file["bufferViews"][view]["byteLength"] = json!(u64::MAX);
            s.file["images"] = json!([{"bufferView": view}]);
        },
        &["image 0", "there is no buffer view"],
    );
    // A second primitive with another height texture, or none, or the same.
    let second = |material: Value| {
        move |scene: &mut Scene| {
            let mut copy = scene.primitive(0).clone();
            copy["material"] = json!(1);
            scene.file["meshes"][0]["primitives"].as_array_mut().unwrap().push(copy);
            scene.file["materials"].as_array_mut().unwrap().push(material.clone());
        }
    };
    let other = json!({"extras": {"heightTexture": {"index": 0, "amplitude": 0.002}}});
    check(&second(other), &["primitive 1", "primitive 0", "split the model"]);
    check(&second(json!({})), &["primitive 1", "no height texture", "split the model"]);
    let mut scene = Scene::textured(0).height(good());
    scene.file["images"] = json!([{"uri": data_uri(IMAGE)}]);
    second(json!({"extras": {"heightTexture": good()}}))(&mut scene);
    assert_eq!(folder.load("same.gltf", scene.text()).unwrap().mesh.coordinates().len(), 4);
}

#[test]
fn damaged_files_never_panic() {
    let seed = 41;
    let mut random = StdRng::seed_from_u64(seed);
    let folder = Folder::new();
    folder.file("map.png", IMAGE);
    let mut scene = Scene::textured(0).height(json!({"index": 0, "amplitude": 0.001}));
    scene.file["images"] = json!([{"uri": "map.png"}]);
    let files = [("cut.obj", SEAM.to_string()), ("cut.gltf", scene.text())];
    let (mut loaded, mut refused) = (0, 0);
    let mut check = |name: &str, content: &[u8], case: &str| match folder.load(name, content) {
        Ok(found) => {
            let mesh = &found.mesh;
            assert_eq!(mesh.coordinates().len(), mesh.mesh().triangles().len(), "{case}");
            loaded += 1;
        }
        Err(error) => {
            assert!(!error.to_string().contains(['\n', '\r']), "{case}: {error}");
            refused += 1;
        }
    };
    for (name, original) in &files {
        let original = original.as_bytes();
        for length in 0..original.len() {
            check(name, &original[..length], &format!("{name}, {length} bytes"));
        }
        for round in 0..3000 {
            let mut bytes = original.to_vec();
            for _ in 0..random.random_range(1..4) {
                let at = random.random_range(0..bytes.len());
                match random.random_range(0..3) {
                    0 => bytes[at] = random.random_range(0..=255),
                    1 => bytes[at] = b"0123456789-.e/ \n"[random.random_range(0..16)],
                    _ => drop(bytes.remove(at)),
                }
            }
            check(name, &bytes, &format!("seed {seed}, {name}, round {round}"));
        }
    }
    assert!(loaded > 300 && refused > 300, "{loaded} loaded, {refused} refused");
}
