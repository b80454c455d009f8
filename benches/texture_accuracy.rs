//! Accuracy of texture depths: δ_n of coarse meshes with textures compared with that of the meshes at full
//! resolution, by brute force, at random contacts, by the size of the grid; with the time of a depth with its
//! derivatives.
//!
//! `cargo bench -p palpate-benches --bench texture_accuracy`. The pairs are those of Table 4.1, with the
//! models' detail baked onto coarse meshes, and a ball on plates displaced by height maps, if the optional
//! shared models are present.
//!
//! The brute force measures, along n at each vertex of either full mesh, its depth in the other. Where edges
//! cross the overlap may be larger; that is neglected, since full meshes are fine. Contacts with the largest
//! overlap at the border of the grid are left out.

#![allow(missing_docs, clippy::print_stdout, reason = "it prints tables")]

use std::error::Error;
use std::f64::consts::PI;
use std::sync::Arc;
use std::time::Instant;

use clap::Parser;
use palpate::core::mesh::UvMesh;
use palpate::glam::{DMat3, DQuat, DVec2, DVec3};
use palpate::models::Model;
use palpate::texture_pd::{
    BakeOptions, CpuBackend, DepthQuery, DepthSettings, Domain, HeightImage, HeightOptions, SurfaceSet,
    TextureContact, TextureFilter, TexturedSurface, Wrap, bake,
};
use palpate::{Pose, TriMesh};
use palpate_measure::quantile;
use palpate_tests::shared;
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

#[derive(Parser)]
#[command(about = "Accuracy of texture depths")]
struct Arguments {
    /// Contacts of each pair
    #[arg(long, default_value_t = 40)]
    contacts: usize,
    /// Argument that cargo passes to every benchmark
    #[arg(long, hide = true)]
    bench: bool,
}

const SEED: u64 = 0x7E47;
const GRIDS: [u32; 3] = [50, 128, 256];
/// Share of the grid, from its middle, in which the largest overlap has to be.
const INNER_SHARE: f64 = 0.9;
/// Angle from which edges of coarse meshes are creases, rad.
const CREASE: f64 = 0.6;

/// Surface at full resolution, and coarse with its detail as a texture.
struct Body {
    full: TriMesh,
    coarse: TriMesh,
    textured: Arc<TexturedSurface>,
    /// Half the side of its grids, m: a few features wide.
    half: f64,
}

impl Body {
    /// Returns a built-in model, coarse and baked with texels of a size (m).
    fn baked(model: &str, coarse: usize, texel: f64, half: f64) -> Result<Self, Box<dyn Error>> {
        let (model, full) = Model::parse(model)?;
        let (full, coarse) = (model.generate(full)?, model.generate(coarse)?);
        let options = BakeOptions { texel, reach: None, crease: CREASE };
        let baked = bake(&coarse, &full, &options, &mut |_| std::ops::ControlFlow::Continue(()))?;
        let textured = Arc::new(TexturedSurface::textured(&baked.mesh, &baked.image, CREASE)?);
        println!(
            "{}: {} of {} triangles. {}",
            model.name(),
            coarse.triangles().len(),
            full.triangles().len(),
            baked.report
        );
        Ok(Self { full, coarse, textured, half })
    }
}

impl Body {
    /// Returns a plate of 5 cm displaced by a height map with that many metres from black to white.
    fn displaced(file: &str, amplitude: f64) -> Result<Option<Self>, Box<dyn Error>> {
        let Some(path) = shared(&format!("models/good/height/{file}")) else { return Ok(None) };
        let options = HeightOptions { wrap: [Wrap::Clamp; 2], ..HeightOptions::new(amplitude) };
        let (image, _) = HeightImage::open(&path, &options)?;
        let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(DVec2::from);
        let triangles = vec![[0, 1, 2], [0, 2, 3]];
        let at = |index: u32| 0.5 * (corners[index as usize] + 1.0);
        let coordinates = triangles.iter().map(|triangle: &[u32; 3]| triangle.map(at)).collect();
        let vertices = corners.map(|corner| (corner * PLATE).extend(0.0)).to_vec();
        let coarse = TriMesh::new(vertices, triangles)?;
        let mesh = UvMesh::new(coarse.clone(), coordinates)?;
        let textured = Arc::new(TexturedSurface::textured(&mesh, &image, CREASE)?);
        Ok(Some(Self { full: relief(&image)?, coarse, textured, half: 0.002 }))
    }

    /// Returns a ball without a texture.
    fn ball(radius: f64) -> Result<Self, Box<dyn Error>> {
        let (rings, around) = (300_u32, 600_u32);
        let vertices = (0..=rings).flat_map(|ring| {
            let (sin, cos) = (PI * f64::from(ring) / f64::from(rings)).sin_cos();
            (0..around).map(move |i| {
                let turn = DVec2::from_angle(2.0 * PI * f64::from(i) / f64::from(around));
                radius * DVec3::new(sin * turn.x, sin * turn.y, cos)
            })
        });
        let triangles = (0..rings).flat_map(|ring| {
            (0..around).flat_map(move |i| {
                let [a, b] = [i, (i + 1) % around].map(|i| ring * around + i);
                [[a, a + around, b], [b, a + around, b + around]]
            })
        });
        let full = TriMesh::new(vertices.collect(), triangles.collect())?;
        let textured = Arc::new(TexturedSurface::plain(&full)?);
        Ok(Self { coarse: full.clone(), full, textured, half: f64::INFINITY })
    }

    /// Returns a point of the coarse surface and the normal there.
    fn point(&self, random: &mut StdRng) -> (DVec3, DVec3) {
        let [a, b, c] = self.coarse.corners(random.random_range(0..self.coarse.triangles().len()));
        let (u, v): (f64, f64) = (random.random_range(0.0..1.0), random.random_range(0.0..1.0));
        (a + u.min(v) * (b - a) + (1.0 - u.max(v)) * (c - a), (b - a).cross(c - a).normalize())
    }
}

/// Half the side of the plates, m.
const PLATE: f64 = 0.025;

/// Returns a mesh with a vertex at the middle of each texel.
fn relief(image: &HeightImage) -> Result<TriMesh, Box<dyn Error>> {
    let (width, height) = (image.width(), image.height());
    let at = |index: u32, count: u32| ((f64::from(index) + 0.5) / f64::from(count) * 2.0 - 1.0) * PLATE;
    let vertices = image.displacements().iter().zip(0..).map(|(&displacement, i)| {
        DVec3::new(at(i % width, width), at(i / width, height), displacement.into())
    });
    let cells = (0..(width - 1) * (height - 1)).flat_map(|i| {
        let first = i / (width - 1) * width + i % (width - 1);
        [[first, first + 1, first + width + 1], [first, first + width + 1, first + width]]
    });
    Ok(TriMesh::new(vertices.collect(), cells.collect())?)
}

/// Triangles of a full mesh that face along n (or against it) within a contact's grid, in its frame, by
/// cells.
struct Seen {
    triangles: Vec<[DVec3; 3]>,
    cells: Vec<Vec<u32>>,
    half: f64,
    side: f64,
}

/// Number of cells along a side.
const CELLS: usize = 64;

impl Seen {
    fn new(mesh: &TriMesh, pose: &Pose, contact: &TextureContact, side: f64) -> Self {
        let (u, v) = contact.normal.any_orthonormal_pair();
        let axes = DMat3::from_cols(u, v, contact.normal).transpose();
        let half = contact.half_size;
        let mut seen = Self { triangles: Vec::new(), cells: vec![Vec::new(); CELLS * CELLS], half, side };
        for triangle in 0..mesh.triangles().len() {
            let corners = mesh.corners(triangle);
            // In the contact's frame: u, v along the grid, z along the normal.
            let [a, b, c] = corners.map(|corner| axes * (pose.transform_point(corner) - contact.point));
            let (low, high) = (a.min(b).min(c), a.max(b).max(c));
            let inside = low.truncate().max_element() < half && high.truncate().min_element() > -half;
            let near = low.z < contact.reach && high.z > -contact.reach;
            if inside && near && side * (b - a).cross(c - a).z > 0.0 {
                let [from, to] = [low, high].map(|at| [at.x, at.y].map(|x| seen.cell(x)));
                for row in from[1]..=to[1] {
                    for column in from[0]..=to[0] {
                        seen.cells[row * CELLS + column].push(seen.triangles.len() as u32);
                    }
                }
                seen.triangles.push([a, b, c]);
            }
        }
        seen
    }

    fn cell(&self, at: f64) -> usize {
        ((at / self.half + 1.0) * 0.5 * CELLS as f64).clamp(0.0, CELLS as f64 - 1.0) as usize
    }

    /// Returns the height of the outermost surface at a place.
    fn height(&self, at: DVec2) -> Option<f64> {
        let cell = &self.cells[self.cell(at.y) * CELLS + self.cell(at.x)];
        let height = |&index: &u32| {
            let [a, b, c] = self.triangles[index as usize];
            // Barycentric weights of the place in the triangle's projection.
            let area = (b - a).truncate().perp_dot((c - a).truncate());
            let [p, q, r] = [a, b, c].map(|corner| corner.truncate() - at);
            let weights = [q.perp_dot(r), r.perp_dot(p), p.perp_dot(q)].map(|weight| weight / area);
            let inside = weights.iter().all(|weight| *weight >= -1e-9);
            inside.then_some(weights[0] * a.z + weights[1] * b.z + weights[2] * c.z)
        };
        cell.iter().filter_map(height).max_by(|x, y| (self.side * x).total_cmp(&(self.side * y)))
    }

    /// Returns the largest overlap with another surface at this one's vertices, and its place.
    fn largest(&self, other: &Self, field: f64) -> (f64, DVec2) {
        let mut largest = (f64::NEG_INFINITY, DVec2::ZERO);
        for corner in self.triangles.iter().flatten() {
            let at = corner.truncate();
            if at.abs().max_element() > field {
                continue;
            }
            let (Some(own), Some(others)) = (self.height(at), other.height(at)) else { continue };
            let overlap = self.side * own + other.side * others;
            if overlap > largest.0 {
                largest = (overlap, at);
            }
        }
        largest
    }
}

/// Returns a contact at random places of both coarse surfaces, pressed in by the surfaces' detail.
fn random_contact(
    [a, b]: [&Body; 2],
    ids: [palpate::texture_pd::SurfaceId; 2],
    random: &mut StdRng,
) -> TextureContact {
    let ((on_a, normal_a), (on_b, normal_b)) = (a.point(random), b.point(random));
    let facing = DQuat::from_rotation_arc(normal_a, -normal_b);
    let turn = DQuat::from_axis_angle(normal_b, random.random_range(0.0..2.0 * PI)) * facing;
    let turn = turn.normalize();
    let half_size = a.half.min(b.half);
    TextureContact {
        a: ids[0],
        pose_a: Pose::new(on_b - turn * on_a, turn),
        center: on_b,
        b: ids[1],
        pose_b: Pose::IDENTITY,
        normal: -normal_b,
        point: on_b,
        half_size,
        // As sessions have it: flat triangles may be further away than what they are displaced to.
        reach: half_size + a.textured.amplitude() + b.textured.amplitude(),
        domain: Domain::WHOLE,
    }
}

/// Prints errors and times of a pair by grid, m and s.
fn compare(name: &str, bodies: [&Body; 2], contacts: usize) -> Result<(), Box<dyn Error>> {
    let mut random = StdRng::seed_from_u64(SEED);
    let mut surfaces = SurfaceSet::default();
    let ids = [surfaces.add(&bodies[0].textured)?, surfaces.add(&bodies[1].textured)?];
    let (mut query, mut backend) = (DepthQuery::new(), CpuBackend::new());
    let mut errors = [const { Vec::new() }; GRIDS.len()];
    let mut times = [const { Vec::new() }; GRIDS.len()];
    let mut left_out = 0;
    for _ in 0..contacts {
        let contact = random_contact(bodies, ids, &mut random);
        let seen = [(bodies[0], &contact.pose_a, 1.0), (bodies[1], &contact.pose_b, -1.0)]
            .map(|(body, pose, side)| Seen::new(&body.full, pose, &contact, side));
        let [a, b] =
            [seen[0].largest(&seen[1], contact.half_size), seen[1].largest(&seen[0], contact.half_size)];
        let (depth, at) = if a.0 > b.0 { a } else { b };
        if !depth.is_finite() || at.abs().max_element() > INNER_SHARE * contact.half_size {
            left_out += 1;
            continue;
        }
        for ((grid, errors), times) in GRIDS.into_iter().zip(&mut errors).zip(&mut times) {
            let settings = DepthSettings { grid, filter: TextureFilter::Finest, ..DepthSettings::default() };
            let start = Instant::now();
            let found = query.run(&surfaces, &[contact], &settings, &mut backend)?[0];
            times.push(start.elapsed().as_secs_f64());
            errors.push(found.map_or(f64::INFINITY, |found| (found.depth - depth).abs()));
        }
    }
    let half = 2e3 * bodies[0].half.min(bodies[1].half);
    let amplitude = 1e6 * (bodies[0].textured.amplitude() + bodies[1].textured.amplitude());
    for ((grid, errors), times) in GRIDS.into_iter().zip(&mut errors).zip(&mut times) {
        let micro = |values: &[f64], fraction| 1e6 * quantile(values, fraction);
        println!(
            "| {name} | {half:.0} | {amplitude:.0} | {} ({left_out}) | {grid} | {:.2} | {:.1} | {:.0} | {:.0} |",
            errors.len(),
            micro(errors, 0.5),
            micro(errors, 0.9),
            micro(errors, 1.0),
            micro(times, 0.5)
        );
    }
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = Arguments::parse();
    // Coarse sizes are near those of Table 4.1, or the smallest of the models.
    let block = Body::baked("block", 300, 0.0001, 0.004)?;
    let gear = Body::baked("gear", 1_600, 0.0002, 0.004)?;
    let hammer = Body::baked("hammer", 804, 0.0002, 0.004)?;
    let torus = Body::baked("torus", 532, 0.0002, 0.008)?;
    let file = Body::baked("file", 632, 0.0001, 0.002)?;
    let part = Body::baked("cad-part", 8_008, 0.0002, 0.002)?;
    println!(
        "\n| pair | grid, mm | largest detail, µm | contacts (left out) | grid | error, median, µm | 90 % | largest | time, µm |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for (name, bodies) in [
        ("block on block", [&block, &block]),
        ("block on gear", [&block, &gear]),
        ("hammer on torus", [&hammer, &torus]),
        ("file on CAD part", [&file, &part]),
    ] {
        compare(name, bodies, arguments.contacts)?;
    }
    let ball = Body::ball(0.005)?;
    for file in ["CorrugatedSteel003", "DiamondPlate001", "Fabric061", "Leather031", "Rock003"] {
        match Body::displaced(&format!("{file}_1K_Displacement.png"), 0.0005)? {
            Some(plate) => compare(&format!("ball on {file}"), [&ball, &plate], arguments.contacts)?,
            None => println!("{file}: skipped, the optional models are not there"),
        }
    }
    Ok(())
}
