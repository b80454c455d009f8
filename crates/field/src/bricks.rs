//! A signed distance field in bricks: samples near the surface, and bounds elsewhere.

use glam::{DVec3, UVec3};
use palpate_core::TriMesh;
use rayon::prelude::*;
use wide::{f32x4, i32x4};

use crate::exact::ExactDistance;
use crate::format::{FormatError, Reader, Writer};

/// Number of cells along an edge of a brick.
const CELLS: usize = 8;
/// Number of samples along an edge of a brick: neighbours share those at their faces, each with its own copy.
const SAMPLES: usize = CELLS + 1;
const PER_BRICK: usize = SAMPLES * SAMPLES * SAMPLES;
const BRICK_BYTES: usize = PER_BRICK * size_of::<i16>();
/// Offsets of the four rows along x that hold the corners of a cell.
const ROWS: [usize; 4] = [0, SAMPLES, SAMPLES * SAMPLES, SAMPLES * SAMPLES + SAMPLES];
/// Number of samples from the first corner of a cell to the last.
const CELL_SPAN: usize = ROWS[3] + 2;
/// Largest number of bricks of a field, near and far, approximately: the table of bricks takes memory even
/// where all are far.
const MAX_BRICKS: f64 = 2e6;
/// Entry in the table of bricks for a far brick: it has no samples, only a bound.
const FAR: u32 = u32::MAX;

/// Signed distances (negative inside) from a surface on a lattice, interpolated trilinearly.
#[derive(Clone, Debug)]
pub struct DistanceField {
    /// Position of the first sample, m.
    origin: DVec3,
    /// Lattice constant, m.
    spacing: f64,
    /// Bricks along each axis.
    bricks: UVec3,
    /// The samples of each brick, x varying fastest, or [`FAR`].
    table: Vec<u32>,
    /// Whether each far brick is inside.
    is_inside: Vec<bool>,
    /// Squared distances at the corners of bricks, in squared lattice constants.
    coarse: Vec<f32>,
    coarse_size: UVec3,
    /// Lower bound of the distance of far bricks from the surface, in lattice constants.
    band: f32,
    /// Distances in steps of `step` lattice constants: i16, little-endian.
    samples: Vec<[u8; BRICK_BYTES]>,
    step: f32,
}

impl DistanceField {
    /// The distance of a point that the field of a mesh's surface would give, with a lattice constant and a
    /// band (m), within the band, m. It needs no field.
    pub(crate) fn expected(
        mesh: &TriMesh,
        exact: &ExactDistance,
        (spacing, band): (f64, f64),
    ) -> impl Fn(DVec3) -> f64 {
        let (origin, _) = sampled_box(mesh, spacing, band);
        let step = step(spacing, band);
        move |point| {
            let at = (point - origin) / spacing;
            let (first, part) = (at.floor(), at - at.floor());
            let mut hint = 0;
            let mut sample = |x: f64, y: f64, z: f64| {
                let found = exact.nearest(origin + spacing * (first + DVec3::new(x, y, z)), hint);
                hint = found.hint;
                (found.distance / spacing / step).round() * step
            };
            let mix = |p: f64, q: f64, t: f64| p + (q - p) * t;
            let mut layer = |z: f64| {
                let mut row = |y: f64| mix(sample(0.0, y, z), sample(1.0, y, z), part.x);
                mix(row(0.0), row(1.0), part.y)
            };
            mix(layer(0.0), layer(1.0), part.z) * spacing
        }
    }

    /// Samples the field of a mesh's surface, with a lattice constant (m), as far from the surface as `band`
    /// (m) at least.
    pub fn new(mesh: &TriMesh, exact: &ExactDistance, spacing: f64, band: f64) -> Self {
        let side = spacing * CELLS as f64;
        let (low, high) = sampled_box(mesh, spacing, band);
        let bricks = ((high - low) / side).ceil().max(DVec3::ONE).as_uvec3();
        let count = bricks.x * bricks.y * bricks.z;
        let half_diagonal = side * 0.75f64.sqrt();
        let step = step(spacing, band);
        let corner = |brick: u32| {
            let place =
                UVec3::new(brick % bricks.x, brick / bricks.x % bricks.y, brick / (bricks.x * bricks.y));
            low + side * place.as_dvec3()
        };
        let measured: Vec<(bool, Option<Box<[u8; BRICK_BYTES]>>)> = (0..count)
            .into_par_iter()
            .map(|brick| {
                let corner = corner(brick);
                let middle = exact.nearest(corner + side / 2.0, 0);
                let clear = middle.distance.abs() - half_diagonal;
                if clear > band {
                    return (middle.distance < 0.0, None);
                }
                let mut values = Box::new([0; BRICK_BYTES]);
                let mut hint = middle.hint;
                for (index, value) in values.as_chunks_mut::<2>().0.iter_mut().enumerate() {
                    let at = UVec3::new(
                        (index % SAMPLES) as u32,
                        (index / SAMPLES % SAMPLES) as u32,
                        (index / (SAMPLES * SAMPLES)) as u32,
                    );
                    let found = exact.nearest(corner + spacing * at.as_dvec3(), hint);
                    hint = found.hint;
                    *value = ((found.distance / spacing / step).round() as i16).to_le_bytes();
                }
                (false, Some(values))
            })
            .collect();
        let coarse_size = bricks + 1;
        let mut coarse = vec![0.0; coarse_size.element_product() as usize];
        coarse.par_chunks_mut(coarse_size.x as usize).enumerate().for_each(|(row, values)| {
            let (y, z) = (row as u32 % coarse_size.y, row as u32 / coarse_size.y);
            let mut hint = 0;
            for (x, value) in (0..).zip(values) {
                let place = UVec3::new(x, y, z);
                let found = exact.nearest(low + spacing * CELLS as f64 * place.as_dvec3(), hint);
                hint = found.hint;
                *value = (found.distance / spacing).powi(2) as f32;
            }
        });
        let mut field = Self {
            coarse,
            coarse_size,
            origin: low,
            spacing,
            bricks,
            table: Vec::with_capacity(measured.len()),
            is_inside: Vec::with_capacity(measured.len()),
            samples: Vec::new(),
            step: step as f32,
            band: (band / spacing) as f32,
        };
        for (is_inside, values) in measured {
            field.is_inside.push(is_inside);
            field.table.push(if values.is_some() { field.samples.len() as u32 } else { FAR });
            field.samples.extend(values.map(|values| *values));
        }
        field.samples.shrink_to_fit();
        field
    }

    /// Smallest lattice constant (m) of a field that takes no more than `bytes`, for a surface's area (m²).
    ///
    /// Bricks whose middle is within the band and half a diagonal of the surface, on either side of it, are
    /// kept.
    pub fn lattice(area: f64, band: f64, bytes: f64) -> f64 {
        let needed = |spacing: f64| {
            let side = CELLS as f64 * spacing;
            2.0 * (band + 0.75f64.sqrt() * side) * area / side.powi(3) * BRICK_BYTES as f64
        };
        // Starts from the lattice constant without a band, and enlarges it until the field fits.
        let mut spacing = (2.0 * 0.75f64.sqrt() * area * BRICK_BYTES as f64 / bytes).sqrt() / CELLS as f64;
        while needed(spacing) > bytes {
            spacing *= 1.05;
        }
        spacing
    }

    /// Smallest lattice constant (m) of a field with a band (m) around a mesh with at most about
    /// `MAX_BRICKS` bricks. It matters for long and thin bodies, which fill little of their box.
    pub fn finest_lattice(mesh: &TriMesh, band: f64) -> f64 {
        let (low, high) = bounds(mesh);
        ((high - low + 2.0 * band).element_product() / MAX_BRICKS).cbrt() / CELLS as f64
    }

    /// Lattice constant, m.
    pub fn spacing(&self) -> f64 {
        self.spacing
    }

    /// Position of the first sample, m.
    pub fn origin(&self) -> DVec3 {
        self.origin
    }

    /// Largest distance that is sampled, m.
    pub fn band(&self) -> f64 {
        f64::from(self.band) * self.spacing
    }

    pub(crate) fn write(&self, to: &mut Writer) {
        to.vec(self.origin);
        to.f64([self.spacing, f64::from(self.band), f64::from(self.step)]);
        to.u32(self.bricks.to_array());
        to.u32([self.samples.len() as u32]);
        to.u32(self.table.iter().copied());
        to.u8(self.is_inside.iter().map(|is_inside| u8::from(*is_inside)));
        to.f32(self.coarse.iter().copied());
        to.u8(self.samples.iter().flatten().copied());
    }

    pub(crate) fn read_from(from: &mut Reader) -> Result<Self, FormatError> {
        let (origin, spacing) = (from.vec()?, from.positive()?);
        let [band, step] = [from.positive()? as f32, from.positive()? as f32];
        let (bricks, kept) = (from.uvec()?, from.u32()?);
        let coarse_size = bricks.checked_add(UVec3::ONE).ok_or(FormatError::Damaged)?;
        let product = |size: UVec3| {
            let all = size.as_u64vec3().to_array();
            let all = all.into_iter().try_fold(1u64, u64::checked_mul);
            all.filter(|all| *all > 0).and_then(|all| usize::try_from(all).ok()).ok_or(FormatError::Damaged)
        };
        let count = product(bricks)?;
        let table = from.u32s(count)?;
        if table.iter().any(|slot| *slot != FAR && *slot >= kept) {
            return Err(FormatError::Damaged);
        }
        Ok(Self {
            origin,
            spacing,
            bricks,
            table,
            is_inside: from.bytes(count, 1)?.iter().map(|byte| *byte == 1).collect(),
            coarse: from.f32s(product(coarse_size)?)?,
            coarse_size,
            band,
            samples: from.bytes(kept as usize, BRICK_BYTES)?.as_chunks().0.to_vec(),
            step,
        })
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        size_of::<Self>()
            + self.table.capacity() * size_of::<u32>()
            + self.is_inside.capacity()
            + self.coarse.capacity() * size_of::<f32>()
            + self.samples.capacity() * BRICK_BYTES
    }

    /// Distances of four points, given in lattice constants from the origin, and their gradients: [distance,
    /// x, y, z]. A far point gets a bound of its distance, and a vector approximately along the gradient.
    #[inline]
    pub(crate) fn read<const GRADIENT: bool>(&self, at: &[f32x4; 3]) -> [f32x4; 4] {
        let [nx, ny, nz] = self.bricks.to_array();
        let size = [nx, ny, nz].map(|bricks| f32x4::splat((bricks * CELLS as u32) as f32));
        let clamped = |x: f32x4, most: f32x4| x.fast_max(f32x4::ZERO).fast_min(most);
        let inside = [clamped(at[0], size[0]), clamped(at[1], size[1]), clamped(at[2], size[2])];
        let is_outside =
            (inside[0].simd_ne(at[0]) | inside[1].simd_ne(at[1]) | inside[2].simd_ne(at[2])).to_bitmask();
        let cell = |x: f32x4, size: f32x4| x.fast_min(size - f32x4::ONE).fast_trunc_int();
        let (cx, cy, cz) = (cell(inside[0], size[0]), cell(inside[1], size[1]), cell(inside[2], size[2]));
        let brick: i32x4 =
            ((cz >> 3) * i32x4::splat(ny as i32) + (cy >> 3)) * i32x4::splat(nx as i32) + (cx >> 3);
        let seven = i32x4::splat(7);
        let (ly, lz) = (cy & seven, cz & seven);
        // 9 y and 81 z.
        let first: i32x4 = (cx & seven) + (ly << 3) + ly + (lz << 6) + (lz << 4) + lz;
        let (bricks, firsts) = (brick.to_array(), first.to_array());
        // For each lane, four pairs of samples that follow one another along x. The slot of a far brick is
        // out of range.
        let mut far = is_outside;
        let mut lane = |lane: usize| -> [i32; 4] {
            let slot = self.table[bricks[lane] as usize] as usize;
            let first = firsts[lane] as usize;
            let brick = self.samples.get(slot).and_then(|brick| brick.get(2 * first..));
            let Some(values) = brick.and_then(|values| values.first_chunk::<{ 2 * CELL_SPAN }>()) else {
                far |= 1 << lane;
                return [0; 4];
            };
            // Written out, so that each becomes one load.
            let pair = |row: usize| {
                let byte = 2 * row;
                i32::from_le_bytes([values[byte], values[byte + 1], values[byte + 2], values[byte + 3]])
            };
            [pair(ROWS[0]), pair(ROWS[1]), pair(ROWS[2]), pair(ROWS[3])]
        };
        let lanes = [lane(0), lane(1), lane(2), lane(3)];
        let row = |row: usize| [lanes[0][row], lanes[1][row], lanes[2][row], lanes[3][row]];
        let pairs = [row(0), row(1), row(2), row(3)];
        let low = |pair: [i32; 4]| -> f32x4 {
            let up: i32x4 = i32x4::new(pair) << 16;
            let value: i32x4 = up >> 16;
            value.round_float()
        };
        let high = |pair: [i32; 4]| -> f32x4 {
            let value: i32x4 = i32x4::new(pair) >> 16;
            value.round_float()
        };
        // Trilinear interpolation between the corners a to h: along x, then y, then z.
        let (a, c, e, g) = (low(pairs[0]), low(pairs[1]), low(pairs[2]), low(pairs[3]));
        let (b, d, f, h) = (high(pairs[0]), high(pairs[1]), high(pairs[2]), high(pairs[3]));
        let x = inside[0] - cx.round_float();
        let y = inside[1] - cy.round_float();
        let z = inside[2] - cz.round_float();
        let step = f32x4::splat(self.step);
        let (ab, cd, ef, gh) = (mix(a, b, x), mix(c, d, x), mix(e, f, x), mix(g, h, x));
        let (near, further) = (mix(ab, cd, y), mix(ef, gh, y));
        let mut found = [step * mix(near, further, z), f32x4::ZERO, f32x4::ZERO, f32x4::ZERO];
        if GRADIENT {
            found[1] = step * mix(mix(b - a, d - c, y), mix(f - e, h - g, y), z);
            found[2] = step * mix(cd - ab, gh - ef, z);
            found[3] = step * (further - near);
        }
        if far != 0 {
            self.replace_by_bounds(&mut found, far, is_outside, bricks, at, &inside);
        }
        found
    }

    /// Replaces the distances of far lanes by bounds, and their gradients by the direction in which the
    /// bounds grow.
    ///
    /// D²(**x**) − |**x**|² is a minimum of linear functions of **x**, hence concave, and nowhere below the
    /// interpolation of its values at the corners c of a cell: D² ≥ Σ w_c D_c² − Σ w_c |**x** − **x**_c|²,
    /// with the weights w of linear interpolation. There is no surface outside the box, so that there D² ≥
    /// D²(nearest) + |**x** − nearest|², with the nearest point of the box. And far bricks are beyond the
    /// band.
    fn replace_by_bounds(
        &self,
        found: &mut [f32x4; 4],
        far: u32,
        is_outside: u32,
        bricks: [i32; 4],
        at: &[f32x4; 3],
        inside: &[f32x4; 3],
    ) {
        let [nx, ny, nz] = self.coarse_size.to_array();
        let part = f32x4::splat(1.0 / CELLS as f32);
        let place = [inside[0] * part, inside[1] * part, inside[2] * part];
        // No cell begins at the last sample.
        let cell = |x: f32x4, samples: u32| x.fast_min(f32x4::splat(samples as f32 - 1.5)).fast_trunc_int();
        let (cx, cy, cz) = (cell(place[0], nx), cell(place[1], ny), cell(place[2], nz));
        let first: i32x4 = (cz * i32x4::splat(ny as i32) + cy) * i32x4::splat(nx as i32) + cx;
        let firsts = first.to_array();
        let (row, layer) = (nx as usize, (nx * ny) as usize);
        let mut corners = [[0.0f32; 4]; 8];
        for lane in 0..4 {
            let values = &self.coarse[firsts[lane] as usize..][..layer + row + 2];
            for (corner, from) in [0, row, layer, layer + row].into_iter().enumerate() {
                (corners[2 * corner][lane], corners[2 * corner + 1][lane]) = (values[from], values[from + 1]);
            }
        }
        let [a, b, c, d, e, f, g, h] = corners.map(f32x4::new);
        let (x, y, z) =
            (place[0] - cx.round_float(), place[1] - cy.round_float(), place[2] - cz.round_float());
        let squares = mix(mix(mix(a, b, x), mix(c, d, x), y), mix(mix(e, f, x), mix(g, h, x), y), z);
        let one = f32x4::ONE;
        let spread = (x * (one - x) + y * (one - y) + z * (one - z)) * f32x4::splat((CELLS * CELLS) as f32);
        let (dx, dy, dz) = (at[0] - inside[0], at[1] - inside[1], at[2] - inside[2]);
        let beyond = dx * dx + dy * dy + dz * dz;
        let bounds =
            (squares - spread + beyond).fast_max(f32x4::splat(self.band * self.band)).sqrt().to_array();
        let along = [
            (b - a) + (d - c) + (f - e) + (h - g),
            (c - a) + (d - b) + (g - e) + (h - f),
            (e - a) + (f - b) + (g - c) + (h - d),
        ];
        let [mut distances, mut gx, mut gy, mut gz] = found.map(f32x4::to_array);
        let [ax, ay, az] = along.map(f32x4::to_array);
        for lane in (0..4).filter(|lane| far & 1 << lane != 0) {
            let is_inside = is_outside & 1 << lane == 0 && self.is_inside[bricks[lane] as usize];
            let sign = if is_inside { -1.0 } else { 1.0 };
            distances[lane] = sign * bounds[lane];
            (gx[lane], gy[lane], gz[lane]) = (sign * ax[lane], sign * ay[lane], sign * az[lane]);
        }
        *found = [distances, gx, gy, gz].map(f32x4::new);
    }
}

/// Lower and upper corner of the box in which a field is sampled, with a lattice constant and a band, m.
fn sampled_box(mesh: &TriMesh, spacing: f64, band: f64) -> (DVec3, DVec3) {
    let (low, high) = bounds(mesh);
    (low - band - spacing, high + band + spacing)
}

/// Steps of the samples of a field with a lattice constant and a band (m), in lattice constants: the largest
/// distance of a near brick's samples from the surface is the largest number.
fn step(spacing: f64, band: f64) -> f64 {
    let half_diagonal = spacing * CELLS as f64 * 0.75f64.sqrt();
    (band + 2.0 * half_diagonal) / spacing / f64::from(i16::MAX)
}

/// Lower and upper corner of the box of the vertices that triangles use.
fn bounds(mesh: &TriMesh) -> (DVec3, DVec3) {
    let used = || mesh.triangles().iter().flatten().map(|v| mesh.vertices()[*v as usize]);
    (used().fold(DVec3::INFINITY, DVec3::min), used().fold(DVec3::NEG_INFINITY, DVec3::max))
}

#[inline]
fn mix(p: f32x4, q: f32x4, t: f32x4) -> f32x4 {
    p + (q - p) * t
}

#[cfg(test)]
mod tests {
    use palpate_models::Model;
    use rand::rngs::StdRng;
    use rand::{RngExt as _, SeedableRng as _};

    use glam::Vec3A;

    use super::*;

    #[test]
    fn samples_are_distances_and_bounds_hold() {
        const CELLS_ACROSS: u32 = 96;
        let mut rng = StdRng::seed_from_u64(0xB81C);
        for model in [Model::Torus, Model::Cup] {
            let mesh = model.generate(6000).expect("in range");
            let exact = ExactDistance::new(&mesh);
            let sphere = mesh.bounding_sphere();
            let band = 0.03 * sphere.radius;
            let spacing = 2.0 * sphere.radius / f64::from(CELLS_ACROSS);
            let field = DistanceField::new(&mesh, &exact, spacing, band);
            let (mut near, mut far, mut directed, mut errors) = (0, 0, 0, Vec::new());
            for _ in 0..4000 {
                let direction = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.2..1.2)));
                let point = sphere.center + sphere.radius * direction;
                let truth = exact.nearest(point, 0).distance / field.spacing();
                let at = ((point - field.origin()) / field.spacing()).as_vec3();
                let [distance, x, y, z] =
                    field.read::<true>(&at.to_array().map(f32x4::splat)).map(|four| four.to_array()[0]);
                let gradient = Vec3A::new(x, y, z);
                let cell = at.as_ivec3();
                let size = (field.bricks * CELLS as u32).as_ivec3();
                let is_inside_box = at.cmpge(palpate_core::glam::Vec3::ZERO).all() && cell.cmplt(size).all();
                let brick = (cell / CELLS as i32).as_uvec3();
                let is_far = || {
                    field.table[((brick.z * field.bricks.y + brick.y) * field.bricks.x + brick.x) as usize]
                        == FAR
                };
                if !is_inside_box || is_far() {
                    far += 1;
                    directed += usize::from(gradient.length() > 0.0);
                    assert!(truth.abs() > band / field.spacing());
                    assert!(truth.abs() >= f64::from(distance.abs()) - 1e-4, "{truth} {distance}");
                    assert!(truth * f64::from(distance) >= 0.0, "{truth} {distance}");
                } else {
                    near += 1;
                    errors.push((f64::from(distance) - truth).abs());
                    // It may exceed 1 where the cell holds a crease.
                    assert!(gradient.length() < 1.5, "{gradient}");
                }
            }
            assert!(near > 500 && far > 500, "{near} near, {far} far");
            assert!(directed > far * 9 / 10, "{directed} of {far}");
            // The error of linear interpolation is largest where the distance has a crease: less than half a
            // cell.
            errors.sort_unstable_by(f64::total_cmp);
            assert!(errors[errors.len() / 2] < 0.02 && errors[errors.len() - 1] < 0.5, "{:?}", errors.last());
        }
    }
}
