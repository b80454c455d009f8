//! Common contact query of haptic rendering: the probe is a shell of points, the scene object a signed
//! distance grid (voxmap and point shell: W. A. McNeely, K. D. Puterbaugh and J. J. Troy, *Six
//! degree-of-freedom haptic rendering using voxel sampling*, SIGGRAPH 1999; with distances and a sphere tree
//! over the points: J. Barbič and D. L. James, *Six-DoF haptic rendering of contact between geometrically
//! complex reduced deformable models*, IEEE Transactions on Haptics, 2008).
//!
//! Here the points are the probe's vertices and, optionally, the nearest points of its edges, as in Newton
//! (NVIDIA, 2026). A query reports all of them that are closer than d, with the depth and its gradient as
//! normal, both interpolated trilinearly. A sphere of points is skipped if the distance at its centre exceeds
//! its radius by d.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Read, Write};
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Instant;

use palpate::glam::{Affine3A, DAffine3, DMat3, DVec3, Vec3, Vec3A};
use palpate::{Contact, Pose, TriMesh};
use palpate_field::AreaContact;

use crate::method::Method;

/// Samples along an edge of a block; the samples of a block are measured together or not at all.
const BLOCK: usize = 4;

/// Largest number of points in a leaf of the sphere tree.
const MAX_LEAF_POINTS: usize = 8;

/// Signed distances (negative inside) from a surface at the points of a grid.
#[derive(Clone, Debug, PartialEq)]
pub struct DistanceGrid {
    /// Number of samples along each axis.
    samples: usize,
    /// Position of the first sample, m.
    origin: DVec3,
    /// Distance of neighbouring samples along each axis, m.
    spacing: DVec3,
    /// Smallest distance of the surface from the grid's boundary, m.
    margin: f64,
    /// Distances, m; x varies fastest.
    values: Vec<f32>,
    /// Build time, s.
    seconds: f64,
}

impl DistanceGrid {
    /// Builds a grid of n³ samples over the bounding box of a mesh, grown by a margin (m), from a function
    /// for the signed distance (m). Where the distance exceeds `band`, the sample is a lower bound on it.
    ///
    /// # Panics
    /// If n is not a multiple of 4.
    pub fn new(
        mesh: &TriMesh,
        samples: usize,
        margin: f64,
        band: f64,
        distance: impl Fn(DVec3) -> f64 + Sync,
    ) -> Self {
        assert!(samples > 0 && samples.is_multiple_of(BLOCK), "{samples} samples");
        let begun = Instant::now();
        let low = mesh.vertices().iter().copied().fold(DVec3::INFINITY, DVec3::min) - margin;
        let high = mesh.vertices().iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max) + margin;
        let spacing = (high - low) / (samples - 1) as f64;
        let mut grid =
            Self { samples, origin: low, spacing, margin, values: vec![0.0; samples.pow(3)], seconds: 0.0 };
        // Corners of all blocks; those of the last blocks are beyond the grid.
        let corners = samples / BLOCK + 1;
        let mut coarse = vec![0.0f64; corners * corners * corners];
        in_parallel(coarse.chunks_mut(corners * corners).enumerate(), |(z, layer)| {
            for (index, value) in layer.iter_mut().enumerate() {
                let cell = [index % corners, index / corners, z].map(|i| (i * BLOCK) as f64);
                *value = distance(low + spacing * DVec3::from(cell));
            }
        });
        let layers = grid.values.chunks_mut(BLOCK * samples * samples).enumerate();
        in_parallel(layers, |(z, layer)| {
            for block in 0..(corners - 1) * (corners - 1) {
                fill(
                    layer,
                    [block % (corners - 1), block / (corners - 1), z],
                    samples,
                    &coarse,
                    (low, spacing, band),
                    &distance,
                );
            }
        });
        grid.seconds = begun.elapsed().as_secs_f64();
        grid
    }

    /// Reads the grid from a file if there is one, or else builds it and writes the file.
    ///
    /// # Errors
    /// If the file can be neither read nor written.
    pub fn cached(file: &Path, build: impl FnOnce() -> Self) -> io::Result<Self> {
        if file.exists() {
            return Self::read(&mut BufReader::new(File::open(file)?));
        }
        let grid = build();
        let partial = file.with_extension("partial");
        let mut written = BufWriter::new(File::create(&partial)?);
        grid.write(&mut written)?;
        written.flush()?;
        std::fs::rename(&partial, file)?;
        Ok(grid)
    }

    fn write(&self, to: &mut impl Write) -> io::Result<()> {
        to.write_all(&(self.samples as u64).to_le_bytes())?;
        let (o, s) = (self.origin, self.spacing);
        for number in [o.x, o.y, o.z, s.x, s.y, s.z, self.margin, self.seconds] {
            to.write_all(&number.to_le_bytes())?;
        }
        self.values.iter().try_for_each(|value| to.write_all(&value.to_le_bytes()))
    }

    fn read(from: &mut impl Read) -> io::Result<Self> {
        let mut word = [0; 8];
        from.read_exact(&mut word)?;
        let samples = u64::from_le_bytes(word) as usize;
        let mut numbers = [0.0; 8];
        for number in &mut numbers {
            from.read_exact(&mut word)?;
            *number = f64::from_le_bytes(word);
        }
        let mut bytes = Vec::new();
        from.read_to_end(&mut bytes)?;
        let (values, _) = bytes.as_chunks();
        let values: Vec<f32> = values.iter().map(|value| f32::from_le_bytes(*value)).collect();
        if samples.checked_pow(3) != Some(values.len()) {
            return Err(io::Error::new(
                io::ErrorKind::InvalidData,
                "the file is not a complete distance grid",
            ));
        }
        let [a, b, c, d, e, f, margin, seconds] = numbers;
        let (origin, spacing) = (DVec3::new(a, b, c), DVec3::new(d, e, f));
        Ok(Self { samples, origin, spacing, margin, values, seconds })
    }

    /// Returns the build time, s.
    pub fn build_seconds(&self) -> f64 {
        self.seconds
    }

    /// Returns the bytes of memory held.
    pub fn bytes(&self) -> usize {
        size_of::<Self>() + self.values.capacity() * size_of::<f32>()
    }

    /// Returns the samples at the corners of a cell, x varying fastest, and the position of a point in it (0
    /// to 1). The point, in units of the spacing, must be in the grid.
    #[inline]
    fn cell(&self, at: Vec3A) -> ([f32; 8], Vec3) {
        let cell = at.floor().min(Vec3A::splat((self.samples - 2) as f32));
        let [x, y, z] = cell.as_uvec3().to_array().map(|i| i as usize);
        let n = self.samples;
        let first = (z * n + y) * n + x;
        let row = |from: usize| [self.values[from], self.values[from + 1]];
        let [[a, b], [c, d], [e, f], [g, h]] =
            [row(first), row(first + n), row(first + n * n), row(first + n * n + n)];
        ([a, b, c, d, e, f, g, h], Vec3::from(at - cell))
    }

    fn contains(&self, at: Vec3A) -> bool {
        at.cmpge(Vec3A::ZERO).all() && at.cmple(Vec3A::splat((self.samples - 1) as f32)).all()
    }
}

/// Measures a block of samples, or fills it with lower bounds.
fn fill(
    layer: &mut [f32],
    block: [usize; 3],
    samples: usize,
    coarse: &[f64],
    (origin, spacing, band): (DVec3, DVec3, f64),
    distance: &impl Fn(DVec3) -> f64,
) {
    let corners = samples / BLOCK + 1;
    let place = |cell: [usize; 3]| origin + spacing * DVec3::from(cell.map(|i| i as f64));
    let known: [(DVec3, f64); 8] = std::array::from_fn(|corner| {
        let [x, y, z] = [0, 1, 2].map(|axis| block[axis] + (corner >> axis & 1));
        (place([x, y, z].map(|i| i * BLOCK)), coarse[(z * corners + y) * corners + x])
    });
    let half_diagonal = (spacing * BLOCK as f64 / 2.0).length();
    let far = known.iter().all(|(_, value)| value.abs() - half_diagonal > band);
    for inner in 0..BLOCK * BLOCK * BLOCK {
        let [x, y, z] = [inner % BLOCK, inner / BLOCK % BLOCK, inner / (BLOCK * BLOCK)];
        let cell = [block[0] * BLOCK + x, block[1] * BLOCK + y, block[2] * BLOCK + z];
        let point = place(cell);
        let value = if far {
            // The distance changes by no more than the displacement.
            let bound = known.iter().map(|(corner, value)| value.abs() - corner.distance(point));
            bound.fold(0.0, f64::max).copysign(known[0].1)
        } else {
            distance(point)
        };
        layer[(z * samples + cell[1]) * samples + cell[0]] = value as f32;
    }
}

/// Distributes items to as many threads as there are cores.
fn in_parallel<T: Send>(items: impl Iterator<Item = T> + Send, work: impl Fn(T) + Sync) {
    let items = Mutex::new(items);
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                loop {
                    let Some(item) = items.lock().ok().and_then(|mut items| items.next()) else { break };
                    work(item);
                }
            });
        }
    });
}

/// Number of bisections of an edge in search of its nearest point.
const HALVINGS: usize = 4;

/// Features of a mesh whose distances are queried.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Features {
    /// Vertices alone.
    Vertices,
    /// Vertices, and the nearest point of each edge.
    VerticesAndEdges,
}

/// Point of the probe closer than d to the scene object, in scene axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShellContact {
    /// Index of the probe's vertex, or the number of vertices plus the index of the edge.
    pub feature: u32,
    /// Position, m.
    pub point: Vec3,
    /// Unit normal that points out of the probe: against the gradient of the distance.
    pub normal: Vec3,
    /// Penetration depth, m: the negative distance.
    pub depth: f32,
}

/// Vertices of a probe, and optionally its edges, in a tree of spheres.
#[derive(Clone, Debug)]
pub struct PointShell {
    /// Nodes, depth first.
    nodes: Vec<Sphere>,
    /// Points in the order of the leaves.
    points: Vec<Vec3A>,
    /// Vectors from the edges' midpoints to their ends, in the order of the leaves; 0 for vertices. `None`
    /// without edges.
    halves: Option<Vec<Vec3A>>,
    features: Vec<u32>,
    /// Share of each feature of the mesh in the areas of the triangles around it, m².
    areas: Vec<f64>,
}

#[derive(Clone, Copy, Debug)]
struct Sphere {
    center: Vec3,
    radius: f32,
    /// Next node that is not below this one.
    skip: u32,
    /// Range of the points of a leaf; empty for inner nodes.
    first: u32,
    end: u32,
}

impl PointShell {
    /// Builds a shell of the features that a mesh's triangles use.
    pub fn new(mesh: &TriMesh, kind: Features) -> Self {
        let vertices = mesh.vertices().len();
        let adjacency = mesh.adjacency();
        let edges = if kind == Features::Vertices { &[][..] } else { adjacency.edges() };
        let ends = |edge: &[u32; 2]| edge.map(|v| mesh.vertices()[v as usize]);
        let middles = edges.iter().map(|edge| ends(edge)[0].midpoint(ends(edge)[1]));
        let halves = edges.iter().map(|edge| (ends(edge)[1] - ends(edge)[0]) / 2.0);
        let places: Vec<DVec3> = mesh.vertices().iter().copied().chain(middles).collect();
        let halves: Vec<DVec3> = std::iter::repeat_n(DVec3::ZERO, vertices).chain(halves).collect();
        // Each triangle's area is split among its vertices, or among its vertices and edges.
        let share = if edges.is_empty() { 3.0 } else { 6.0 };
        let mut areas = vec![0.0; places.len()];
        for (index, triangle) in mesh.triangles().iter().enumerate() {
            let [a, b, c] = mesh.corners(index);
            let area = (b - a).cross(c - a).length() / 2.0 / share;
            triangle.iter().for_each(|v| areas[*v as usize] += area);
            if !edges.is_empty() {
                adjacency.triangle_edges()[index].iter().for_each(|e| areas[vertices + *e as usize] += area);
            }
        }
        let mut features: Vec<u32> = mesh.triangles().iter().flatten().copied().collect();
        features.sort_unstable();
        features.dedup();
        features.extend((0..edges.len()).map(|edge| (vertices + edge) as u32));
        let mut nodes = Vec::new();
        split(&places, &halves, &mut features, 0, &mut nodes);
        let in_order = |of: &[DVec3]| features.iter().map(|f| of[*f as usize].as_vec3a()).collect();
        Self {
            nodes,
            points: in_order(&places),
            halves: (!edges.is_empty()).then(|| in_order(&halves)),
            features,
            areas,
        }
    }

    /// Returns the bytes of memory held.
    pub fn bytes(&self) -> usize {
        size_of::<Self>()
            + self.nodes.capacity() * size_of::<Sphere>()
            + self.points.capacity() * size_of::<Vec3A>()
            + self.halves.as_ref().map_or(0, |halves| halves.capacity() * size_of::<Vec3A>())
            + self.features.capacity() * size_of::<u32>()
    }

    /// Finds the points closer than a tolerance (m) to the scene object, which stands at the origin. Does not
    /// allocate unless there are more contacts than ever before.
    pub fn query(&self, pose: &Pose, scene: &DistanceGrid, tolerance: f64, contacts: &mut Vec<ShellContact>) {
        contacts.clear();
        let to_grid = DAffine3::from_mat3_translation(DMat3::from_diagonal(1.0 / scene.spacing), DVec3::ZERO)
            * DAffine3::from_rotation_translation(pose.rotation, pose.translation - scene.origin);
        let to_grid =
            Affine3A::from_mat3_translation(to_grid.matrix3.as_mat3(), to_grid.translation.as_vec3());
        let (origin, spacing) = (scene.origin.as_vec3(), scene.spacing.as_vec3a());
        let (tolerance, margin) = (tolerance as f32, scene.margin as f32);
        let last = Vec3A::splat((scene.samples - 1) as f32);
        let inverse_spacing = Vec3::ONE / Vec3::from(spacing);
        let mut index = 0;
        while let Some(node) = self.nodes.get(index) {
            // Outside the grid, the distance to its box plus the margin is a lower bound.
            let at = to_grid.transform_point3a(node.center.into());
            let nearest = at.clamp(Vec3A::ZERO, last);
            let distance = if nearest == at {
                let (corners, within) = scene.cell(at);
                interpolated(&corners, within)
            } else {
                ((at - nearest) * spacing).length() + margin
            };
            // No point of the sphere is within d if the distance at its centre exceeds its radius by d.
            if distance > node.radius + tolerance {
                index = node.skip as usize;
                continue;
            }
            for point in node.first as usize..node.end as usize {
                let mut at = to_grid.transform_point3a(self.points[point]);
                let half = self.halves.as_ref().map_or(Vec3A::ZERO, |halves| halves[point]);
                if half != Vec3A::ZERO {
                    let Some(nearest) =
                        nearest_of_edge(scene, at, to_grid.transform_vector3a(half), tolerance)
                    else {
                        continue;
                    };
                    at = nearest;
                }
                if !scene.contains(at) {
                    continue;
                }
                let (corners, within) = scene.cell(at);
                let distance = interpolated(&corners, within);
                if distance < tolerance {
                    // From the cell's unit to metres: ∂/∂x = (1/spacing) ∂/∂u.
                    let gradient = gradient(&corners, within) * inverse_spacing;
                    contacts.push(ShellContact {
                        feature: self.features[point],
                        point: Vec3::from(at * spacing) + origin,
                        normal: -gradient.normalize_or_zero(),
                        depth: -distance,
                    });
                }
            }
            index += 1;
        }
    }
}

/// Returns the nearest point of an edge, given by its midpoint and half of it, in units of the grid; `None`
/// if it is out of reach. By bisection: the distance from a convex piece of surface has one minimum along a
/// line.
#[inline]
fn nearest_of_edge(grid: &DistanceGrid, middle: Vec3A, half: Vec3A, tolerance: f32) -> Option<Vec3A> {
    let last = Vec3A::splat((grid.samples - 1) as f32);
    let spacing = grid.spacing.as_vec3a();
    let (mut at, mut step) = (middle, half);
    for round in 0..HALVINGS {
        let (corners, within) = grid.cell(at.clamp(Vec3A::ZERO, last));
        if round == 0 && interpolated(&corners, within) > (half * spacing).length() + tolerance {
            return None;
        }
        step *= 0.5;
        let rising = Vec3A::from(gradient(&corners, within)).dot(half) > 0.0;
        at += if rising { -step } else { step };
    }
    Some(at)
}

/// Query of a probe's shell in a scene object's distance grid, and optionally of the scene object's shell in
/// the probe's grid.
#[derive(Clone, Debug)]
pub struct ShellInGrid {
    forth: (Arc<PointShell>, Arc<DistanceGrid>),
    back: Option<(Arc<PointShell>, Arc<DistanceGrid>)>,
    tolerance: f64,
    found: [Vec<ShellContact>; 2],
}

impl ShellInGrid {
    /// Returns a query for contacts within a tolerance, m, of the probe's shell in the scene object's grid.
    pub fn new(shell: Arc<PointShell>, grid: Arc<DistanceGrid>, tolerance: f64) -> Self {
        Self { forth: (shell, grid), back: None, tolerance, found: [Vec::new(), Vec::new()] }
    }

    /// Adds the scene object's shell in the probe's grid.
    pub fn both_ways(self, shell: Arc<PointShell>, grid: Arc<DistanceGrid>) -> Self {
        Self { back: Some((shell, grid)), ..self }
    }
}

impl Method for ShellInGrid {
    fn run(&mut self, pose: &Pose) {
        let (shell, grid) = &self.forth;
        shell.query(pose, grid, self.tolerance, &mut self.found[0]);
        if let Some((shell, grid)) = &self.back {
            shell.query(&pose.inverse(), grid, self.tolerance, &mut self.found[1]);
        }
    }

    fn append_contacts(&self, pose: &Pose, found: &mut Vec<AreaContact>) {
        let of = |shell: &PointShell, found: &ShellContact| {
            let (point, normal) = (found.point.as_dvec3(), found.normal.as_dvec3());
            let depth = f64::from(found.depth);
            let contact = Contact { point, scene_point: point - depth * normal, normal, depth };
            AreaContact { contact, area: shell.areas[found.feature as usize] }
        };
        found.extend(self.found[0].iter().map(|contact| of(&self.forth.0, contact)));
        if let Some((shell, _)) = &self.back {
            found.extend(self.found[1].iter().map(|back| {
                let AreaContact { contact, area } = of(shell, back);
                let Contact { point, scene_point, normal, depth } = contact.swapped();
                let world = |p| pose.transform_point(p);
                let normal = pose.transform_vector(normal);
                AreaContact {
                    contact: Contact { point: world(point), scene_point: world(scene_point), normal, depth },
                    area,
                }
            }));
        }
    }

    fn bytes(&self) -> usize {
        let of = |(shell, grid): &(Arc<PointShell>, Arc<DistanceGrid>)| shell.bytes() + grid.bytes();
        of(&self.forth) + self.back.as_ref().map_or(0, of)
    }
}

/// Interpolates trilinearly between the values at the corners of a cell.
#[inline]
fn interpolated(&[a, b, c, d, e, f, g, h]: &[f32; 8], at: Vec3) -> f32 {
    let mix = |p: f32, q: f32, t: f32| p + (q - p) * t;
    let low = mix(mix(a, b, at.x), mix(c, d, at.x), at.y);
    let high = mix(mix(e, f, at.x), mix(g, h, at.x), at.y);
    mix(low, high, at.z)
}

/// Returns the gradient of the interpolated value, per unit of the cell.
#[inline]
fn gradient(&[a, b, c, d, e, f, g, h]: &[f32; 8], at: Vec3) -> Vec3 {
    let mix = |p: f32, q: f32, t: f32| p + (q - p) * t;
    let x = mix(mix(b - a, d - c, at.y), mix(f - e, h - g, at.y), at.z);
    let y = mix(mix(c - a, d - b, at.x), mix(g - e, h - f, at.x), at.z);
    let z = mix(mix(e - a, f - b, at.x), mix(g - c, h - d, at.x), at.y);
    Vec3::new(x, y, z)
}

fn split(points: &[DVec3], halves: &[DVec3], own: &mut [u32], first: usize, nodes: &mut Vec<Sphere>) {
    let place = |v: &u32| points[*v as usize];
    let low = own.iter().map(place).fold(DVec3::INFINITY, DVec3::min);
    let high = own.iter().map(place).fold(DVec3::NEG_INFINITY, DVec3::max);
    let center = low.midpoint(high);
    let reach = |v: &u32| place(v).distance(center) + halves[*v as usize].length();
    let radius = own.iter().map(reach).fold(0.0, f64::max);
    let index = nodes.len();
    let (center, radius) = (center.as_vec3(), (radius * (1.0 + 1e-6)) as f32);
    nodes.push(Sphere { center, radius, skip: 0, first: first as u32, end: first as u32 });
    if own.len() <= MAX_LEAF_POINTS {
        nodes[index].end += own.len() as u32;
    } else {
        let axis = (high - low).max_position();
        let middle = own.len() / 2;
        own.select_nth_unstable_by(middle, |v, w| place(v)[axis].total_cmp(&place(w)[axis]));
        let (left, right) = own.split_at_mut(middle);
        split(points, halves, left, first, nodes);
        split(points, halves, right, first + middle, nodes);
    }
    nodes[index].skip = nodes.len() as u32;
}

#[cfg(test)]
mod tests {
    use palpate::glam::DQuat;
    use palpate::models::Model;

    use super::*;

    const RADIUS: f64 = 0.02;
    const CENTER: DVec3 = DVec3::new(0.1, -0.03, 0.2);
    const MARGIN: f64 = 0.002;

    fn to_sphere(p: DVec3) -> f64 {
        p.distance(CENTER) - RADIUS
    }

    /// Returns a sphere's grid; the mesh only gives the box, which is the sphere's.
    fn sphere_grid(samples: usize) -> DistanceGrid {
        let corners = [DVec3::splat(-RADIUS), DVec3::splat(RADIUS), DVec3::new(RADIUS, 0.0, 0.0)];
        let mesh = TriMesh::new(corners.map(|c| CENTER + c).to_vec(), vec![[0, 1, 2]]).expect("a mesh");
        DistanceGrid::new(&mesh, samples, MARGIN, MARGIN, to_sphere)
    }

    #[test]
    fn samples_are_distances_near_the_surface_and_bounds_elsewhere() {
        let grid = sphere_grid(64);
        let mut bounds = 0;
        for (index, &value) in grid.values.iter().enumerate() {
            let cell = [index % 64, index / 64 % 64, index / 64 / 64].map(|i| i as f64);
            let distance = to_sphere(grid.origin + grid.spacing * DVec3::from(cell));
            let value = f64::from(value);
            if distance.abs() <= MARGIN {
                assert!((value - distance).abs() < 1e-8, "{value} for {distance}");
            } else {
                assert!(value.abs() < distance.abs() + 1e-8 && value * distance >= 0.0);
                bounds += usize::from((value - distance).abs() > 1e-8);
            }
        }
        assert!(bounds > 50_000, "{bounds} samples were not measured");
    }

    #[test]
    fn contacts_with_a_sphere_are_the_vertices_within_reach() {
        let (samples, tolerance) = (128, 0.001);
        let grid = sphere_grid(samples);
        let mesh = Model::Torus.generate(20_000).expect("within range");
        let shell = PointShell::new(&mesh, Features::Vertices);
        let radius = mesh.bounding_sphere().radius;
        // Error of linear interpolation: κ h² / 8 along each axis.
        let error = 3.0 * grid.spacing.max_element().powi(2) / 8.0 / (RADIUS - 2.0 * MARGIN) + 1e-7;
        let (mut contacts, mut found) = (Vec::new(), 0);
        for step in 0..60 {
            let rotation = DQuat::from_scaled_axis(DVec3::new(0.7, 0.2, 0.4) * f64::from(step));
            let away = rotation * DVec3::X * (radius + RADIUS) * f64::from(step) / 60.0;
            let pose = Pose::new(CENTER + away, rotation);
            shell.query(&pose, &grid, tolerance, &mut contacts);
            let mut seen = vec![false; mesh.vertices().len()];
            for contact in &contacts {
                seen[contact.feature as usize] = true;
                let point = pose.transform_point(mesh.vertices()[contact.feature as usize]);
                assert!(contact.point.as_dvec3().distance(point) < 1e-7);
                let (distance, depth) = (to_sphere(point), f64::from(contact.depth));
                if distance > -MARGIN {
                    assert!((depth + distance).abs() < error, "{depth} for {distance}");
                    let outward = (CENTER - point).normalize();
                    assert!(contact.normal.as_dvec3().dot(outward) > 0.999, "{}", contact.normal);
                }
            }
            for (vertex, point) in mesh.vertices().iter().enumerate() {
                if !seen[vertex] {
                    let distance = to_sphere(pose.transform_point(*point));
                    assert!(distance > tolerance - error, "vertex {vertex} at {distance} is missing");
                }
            }
            found += contacts.len();
        }
        assert!(found > 1000, "{found} contacts");
    }

    #[test]
    fn a_grid_survives_its_file() {
        let grid = sphere_grid(8);
        let mut file = Vec::new();
        grid.write(&mut file).expect("memory");
        assert_eq!(DistanceGrid::read(&mut file.as_slice()).expect("whole"), grid);
        file.pop();
        assert!(DistanceGrid::read(&mut file.as_slice()).is_err());
    }
}
