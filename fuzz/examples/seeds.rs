//! Writes the few small files that fuzzing starts from:
//! `cargo run --manifest-path fuzz/Cargo.toml --example seeds`.

use std::fs;
use std::io;
use std::path::Path;

use image::{ImageFormat, Rgb, RgbImage};
use palpate::TriMesh;
use palpate::clod_build::{BuildOptions, build, unwatched};
use palpate::core::Clod;
use palpate::mesh_io::write_obj;
use palpate::models::Model;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus");
    let [clods, meshes, images] = ["clod_load", "mesh_load", "height_image"].map(|name| corpus.join(name));
    for folder in [&clods, &meshes, &images] {
        fs::create_dir_all(folder)?;
    }
    for (model, triangles, simplify) in [
        (Model::Ellipsoid, 60, false),
        (Model::Ellipsoid, 100, true),
        (Model::Block, 300, false),
        (Model::Torus, 400, true),
    ] {
        let mesh = model.generate(triangles)?;
        let clod = build(&mesh, &BuildOptions { simplify, ..BuildOptions::default() }, &mut unwatched)?;
        let name = format!("{}-{triangles}", model.name());
        clod.write(fs::File::create(clods.join(&name))?)?;
        // With room in the spheres, damaged geometry remains valid and reaches the queries.
        let mut loose = clod.parts();
        loose.nodes.iter_mut().for_each(|node| node.radius *= 1e6);
        Clod::pack(&loose)?.write(fs::File::create(clods.join(name + "-loose"))?)?;
    }
    let mesh = Model::Ellipsoid.generate(60)?;
    let [mut obj, mut stl, mut ply] = [vec![0], vec![1], vec![2]];
    write_obj(&mesh, &mut obj)?;
    write_stl(&mesh, &mut stl)?;
    write_ply(&mesh, &mut ply)?;
    for (name, bytes) in [("obj", obj), ("stl", stl), ("ply", ply), ("glb", glb(&mesh))] {
        fs::write(meshes.join(name), bytes)?;
    }
    let image = RgbImage::from_fn(9, 7, |x, y| Rgb([(28 * x) as u8, (36 * y) as u8, 100]));
    for format in [ImageFormat::Png, ImageFormat::Jpeg, ImageFormat::WebP, ImageFormat::Tiff] {
        image.save_with_format(images.join(format.extensions_str()[0]), format)?;
    }
    Ok(())
}

fn write_stl(mesh: &TriMesh, out: &mut impl io::Write) -> io::Result<()> {
    out.write_all(&[b' '; 80])?;
    out.write_all(&(mesh.triangles().len() as u32).to_le_bytes())?;
    for triangle in 0..mesh.triangles().len() {
        let corners = mesh.corners(triangle).map(|p| p.as_vec3().to_array());
        for number in [0.0; 3].iter().chain(corners.as_flattened()) {
            out.write_all(&number.to_le_bytes())?;
        }
        out.write_all(&[0; 2])?;
    }
    Ok(())
}

fn write_ply(mesh: &TriMesh, out: &mut impl io::Write) -> io::Result<()> {
    let (vertices, triangles) = (mesh.vertices(), mesh.triangles());
    write!(out, "ply\nformat ascii 1.0\nelement vertex {}\n", vertices.len())?;
    write!(out, "property float x\nproperty float y\nproperty float z\nelement face {}\n", triangles.len())?;
    writeln!(out, "property list uchar int vertex_indices\nend_header")?;
    for v in vertices {
        writeln!(out, "{} {} {}", v.x as f32, v.y as f32, v.z as f32)?;
    }
    for [a, b, c] in triangles {
        writeln!(out, "3 {a} {b} {c}")?;
    }
    Ok(())
}

/// A binary glTF file with one mesh, after the byte that chooses the format.
fn glb(mesh: &TriMesh) -> Vec<u8> {
    let indices: Vec<u8> = mesh.triangles().as_flattened().iter().flat_map(|v| v.to_le_bytes()).collect();
    let positions: Vec<u8> =
        mesh.vertices().iter().flat_map(|v| v.as_vec3().to_array()).flat_map(f32::to_le_bytes).collect();
    let mut json = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],"#
    ) + &format!(
        r#""meshes":[{{"primitives":[{{"attributes":{{"POSITION":1}},"indices":0}}]}}],"buffers":[{{"byteLength":{}}}],"#,
        indices.len() + positions.len()
    ) + &format!(
        r#""bufferViews":[{{"buffer":0,"byteLength":{0}}},{{"buffer":0,"byteOffset":{0},"byteLength":{1}}}],"#,
        indices.len(),
        positions.len()
    ) + &format!(
        r#""accessors":[{{"bufferView":0,"componentType":5125,"count":{},"type":"SCALAR"}},{{"bufferView":1,"componentType":5126,"count":{},"type":"VEC3"}}]}}"#,
        indices.len() / 4,
        mesh.vertices().len()
    );
    while json.len() % 4 != 0 {
        json.push(' ');
    }
    let body = [indices, positions].concat();
    let mut bytes = vec![3];
    bytes.extend_from_slice(b"glTF");
    bytes.extend_from_slice(&2u32.to_le_bytes());
    bytes.extend_from_slice(&((28 + json.len() + body.len()) as u32).to_le_bytes());
    for (kind, chunk) in [(b"JSON", json.as_bytes()), (b"BIN\0", &body)] {
        bytes.extend_from_slice(&(chunk.len() as u32).to_le_bytes());
        bytes.extend_from_slice(kind);
        bytes.extend_from_slice(chunk);
    }
    bytes
}
