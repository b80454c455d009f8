//! One body's samples in the other's field.

use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3A};
use palpate_core::Pose;
use wide::f32x4;

use crate::bricks::DistanceField;
use crate::cells::ContactSample;
use crate::samples::{Sample, SurfaceSamples};

/// One body's samples in the other's field.
pub struct Side<'a> {
    pub samples: &'a SurfaceSamples,
    pub field: &'a DistanceField,
    /// d, in lattice constants.
    reach: f32,
    /// Rows of the map from the body, about the centre of its samples, to the lattice.
    to_lattice: Map,
    /// Map from the body to the cubes of the probe's surroundings.
    to_cubes: Map,
    /// Columns of `to_cubes`.
    cube_columns: [f32x4; 4],
    /// Map from the body to the probe's axes, about the probe's centre.
    to_probe: Map,
    /// Map from outward normals of the field's body to normals out of the probe, in the probe's axes.
    turn: Map,
    /// Area of one of the finest samples, as a fraction of a cell's squared edge.
    area: f32,
    /// Cubes along each axis.
    across: u32,
    is_probe: bool,
}

impl<'a> Side<'a> {
    pub fn new(
        samples: &'a SurfaceSamples,
        field: &'a DistanceField,
        to_field: &Pose,
        is_probe: bool,
        tolerance: f64,
        (center, across, edge): (DVec3, u32, f64),
    ) -> Self {
        let spacing = field.spacing();
        let affine = |pose: &Pose| DAffine3::from_rotation_translation(pose.rotation, pose.translation);
        let lattice =
            DAffine3::from_mat3_translation(DMat3::from_diagonal(DVec3::splat(spacing)), field.origin());
        let from_field = if is_probe { affine(&to_field.inverse()) } else { DAffine3::IDENTITY };
        let from_body = if is_probe { DAffine3::IDENTITY } else { affine(to_field) };
        // Composed in double precision, so that only short distances are left for single precision.
        let placed = DAffine3::from_translation(samples.center());
        let from_body = from_body * placed;
        let cubes = DAffine3::from_scale_rotation_translation(
            DVec3::splat(1.0 / edge),
            DQuat::IDENTITY,
            DVec3::splat(f64::from(across / 2)) - center / edge,
        );
        let to_cubes = rows(cubes * from_body);
        // Normals out of the probe point into the scene object.
        let sign = if is_probe { -1.0 } else { 1.0 };
        Self {
            samples,
            field,
            reach: (tolerance / spacing) as f32,
            to_lattice: rows(lattice.inverse() * affine(to_field) * placed),
            to_cubes,
            cube_columns: [0, 1, 2, 3].map(|column| {
                let [x, y, z] = to_cubes.map(|row| row[column].as_array()[0]);
                f32x4::new([x, y, z, 0.0])
            }),
            to_probe: rows(DAffine3::from_translation(-center) * from_body),
            turn: rows(DAffine3::from_mat3(from_field.matrix3 * sign)),
            area: (f64::from(samples.area) / (edge * edge)) as f32,
            across,
            is_probe,
        }
    }

    /// Area that a sample of a level represents, as a fraction of a cell's squared edge.
    pub fn area(&self, level: usize) -> f32 {
        self.area * (1 << (2 * level)) as f32
    }

    /// d, in lattice constants.
    pub fn reach(&self) -> f32 {
        self.reach
    }

    /// Distances of four points of the body from the other, in lattice constants.
    #[inline]
    pub fn distances(&self, points: &[f32x4; 3]) -> f32x4 {
        let [distance, ..] = self.field.read::<false>(&mapped(&self.to_lattice, points));
        distance
    }

    /// Reads the distances of four points of the body from the other, and their gradients.
    #[inline]
    pub fn read(&self, points: &[f32x4; 3]) -> Reading {
        let [distance, x, y, z] = self.field.read::<true>(&mapped(&self.to_lattice, points));
        let inside = f32x4::splat(self.reach) - distance;
        Reading {
            distance,
            gradient: [x, y, z],
            inside,
            in_contact: inside.simd_gt(f32x4::ZERO).to_bitmask(),
        }
    }

    /// Passes on those of four points that are in contact, each with its place among the four.
    #[inline]
    pub fn contacts(&self, points: &[f32x4; 3], read: &Reading, mut to: impl FnMut(usize, ContactSample)) {
        let [x, y, z] = read.gradient;
        let size = (x * x + y * y + z * z).fast_max(f32x4::splat(f32::MIN_POSITIVE)).sqrt();
        let inverse = f32x4::ONE / size;
        let normal = mapped(&self.turn, &[x * inverse, y * inverse, z * inverse]);
        let cubes = self.cubes(points);
        let mut point = mapped(&self.to_probe, points);
        if !self.is_probe {
            // Contact points are on the probe's surface.
            let apart = read.distance * f32x4::splat(self.field.spacing() as f32);
            point = [0, 1, 2].map(|axis| point[axis] - normal[axis] * apart);
        }
        let [point, normal] = [point, normal].map(|[x, y, z]| f32x4::transpose([x, y, z, f32x4::ZERO]));
        let reach = read.inside * f32x4::splat(1.0 / self.reach);
        let vector = |four: &f32x4| Vec3A::from_vec4(glam::Vec4::from_array(four.to_array()));
        for lane in bits(read.in_contact) {
            let found = ContactSample {
                point: vector(&point[lane]),
                normal: vector(&normal[lane]),
                reach: reach.as_array()[lane],
                area: 0.0,
                cube: cubes[lane],
                is_probe: self.is_probe,
                sample: Sample { level: 0, index: 0 },
            };
            to(lane, found);
        }
    }

    /// Distances of four points of the body inside the limit of reach, δ + d, in lattice constants.
    #[inline]
    pub fn inside(&self, points: &[f32x4; 3]) -> f32x4 {
        f32x4::splat(self.reach) - self.distances(points)
    }

    /// The cubes that four points of the body are in; for points beyond all cubes, the nearest one.
    #[inline]
    fn cubes(&self, points: &[f32x4; 3]) -> [u32; 4] {
        let last = f32x4::splat((self.across - 1) as f32);
        let [x, y, z] = mapped(&self.to_cubes, points)
            .map(|at| at.fast_max(f32x4::ZERO).fast_min(last).fast_trunc_int().to_array());
        [0, 1, 2, 3].map(|lane| {
            let [x, y, z] = [x[lane], y[lane], z[lane]].map(i32::cast_unsigned);
            (z * self.across + y) * self.across + x
        })
    }

    /// The cube that the first of four points of the body is in.
    #[inline]
    pub fn cube(&self, [x, y, z]: &[f32x4; 3]) -> u32 {
        let [x, y, z] = [x, y, z].map(|axis| f32x4::splat(axis.as_array()[0]));
        let last = f32x4::splat((self.across - 1) as f32);
        let [a, b, c, d] = self.cube_columns;
        let at = a * x + b * y + c * z + d;
        let [x, y, z, _] = at.fast_max(f32x4::ZERO).fast_min(last).fast_trunc_int().to_array();
        (z.cast_unsigned() * self.across + y.cast_unsigned()) * self.across + x.cast_unsigned()
    }
}

/// Distances of four points of a body in the other's field.
#[derive(Clone, Copy, Debug)]
pub struct Reading {
    /// Distances, in lattice constants.
    distance: f32x4,
    gradient: [f32x4; 3],
    /// Distances inside the limit of reach, δ + d, in lattice constants.
    pub inside: f32x4,
    /// Bit mask of the points in contact.
    pub in_contact: u32,
}

/// Places of the bits that are set, of four.
#[inline]
pub fn bits(mut bits: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lane = bits.trailing_zeros() as usize;
        bits &= bits.wrapping_sub(1);
        (lane < 4).then_some(lane)
    })
}

/// An affine map of four points at a time: the rows of its matrix, each with its part of the translation, in
/// all lanes.
type Map = [[f32x4; 4]; 3];

fn rows(map: DAffine3) -> Map {
    [0, 1, 2].map(|axis| {
        let row = map.matrix3.row(axis);
        [row.x, row.y, row.z, map.translation[axis]].map(|x| f32x4::splat(x as f32))
    })
}

#[inline]
fn mapped(rows: &Map, [x, y, z]: &[f32x4; 3]) -> [f32x4; 3] {
    let row = |[a, b, c, d]: &[f32x4; 4]| *a * *x + *b * *y + *c * *z + *d;
    [row(&rows[0]), row(&rows[1]), row(&rows[2])]
}
