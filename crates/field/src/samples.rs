//! Points evenly spread over a surface, in several densities.
//!
//! Positions are in single precision, about the centre of the surface: a mesh may be far from its own origin.

use glam::{DVec3, Vec3};
use palpate_core::TriMesh;
use rand::rngs::SmallRng;
use rand::{RngExt as _, SeedableRng as _};
use rayon::prelude::*;
use wide::{f32x4, i32x4};

use crate::format::{FormatError, Reader, Writer};

/// Longest edge of a fragment, as a fraction of the samples' spacing: a surface is cut into fragments so that
/// its parts can have equal areas.
const MAX_FRAGMENT_EDGE: f64 = 0.75;
/// Smallest area that a fragment represents, as a fraction of the squared spacing.
const MIN_FRAGMENT_AREA: f64 = 0.03;
/// Number of points drawn in each part, of which one becomes a sample.
const CANDIDATES: usize = 8;
/// Number of random choices of four samples that are compared.
const CHOICES: usize = 128;
/// Seed of the samples' positions.
const SEED: u64 = 0x5A3B;
/// Number of fragments above which the two halves are processed in parallel.
const MIN_PARALLEL_FRAGMENTS: usize = 4096;

/// A sample of a body's surface.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// Its level, 0 for the finest.
    pub level: u8,
    /// Index among the samples of the level.
    pub index: u32,
}

/// Points on a surface in levels, of which each has a quarter of the points of the one below. Each point of a
/// level represents an equal part of the surface: point i the parts of the points 4 i to 4 i + 3 of the level
/// below.
///
/// Each part has one point, anywhere in it (stratified sampling): the mean of any function over the surface
/// is that of its samples, but for noise. Four neighbouring points are chosen to have the centroid and the
/// spread of the surface that they represent, which reduces the noise.
#[derive(Clone, Debug)]
pub struct SurfaceSamples {
    /// Centre of the surface in the mesh's frame, m: all positions are about it.
    center: DVec3,
    /// Levels, the finest first, whose samples are in `finest`; the coarsest has four points at most.
    pub(crate) levels: Vec<Level>,
    finest: Finest,
    /// Area that a sample of the finest level represents, m².
    pub(crate) area: f32,
    count: usize,
}

/// A level's points, and spheres around the finest samples of their parts, four by four. The last four is
/// filled up with points too far away to matter, with radii of −∞.
#[derive(Clone, Debug)]
pub(crate) struct Level {
    /// Positions about the surface's centre, m. Empty for the finest level.
    pub samples: Vec<[f32x4; 3]>,
    /// Centres, about that of the surface, and radii of the spheres, m. Empty for the finest level, which has
    /// single points.
    pub spheres: Vec<[f32x4; 4]>,
}

/// The finest samples four by four, x, y and z, in steps from the centres of the spheres around them; 127
/// steps, the largest i8, make a sphere's radius. So they take a quarter of the memory, with an error of at
/// most 0.4 % of the radius.
#[derive(Clone, Debug)]
pub(crate) struct Finest(Vec<[[i8; 4]; 3]>);

/// Number of steps in a sphere's radius: the largest i8.
const MAX_STEPS: f32 = 127.0;
/// Factor on the radii of spheres, for the rounding of the finest samples.
const RADIUS_MARGIN: f32 = 1.01;

impl Finest {
    /// Rounds points to steps, given the level above, whose parts have four of them; moves the points to
    /// their rounded positions.
    fn new(points: &mut [Vec3], above: &Level) -> Self {
        let fours = points.chunks_mut(4).enumerate().map(|(four, points)| {
            let (center, radius) = above.sphere(four);
            let mut kept = [[0; 4]; 3];
            for (lane, point) in points.iter_mut().enumerate() {
                let steps = ((*point - center) * (MAX_STEPS / radius)).round().to_array();
                for (kept, steps) in kept.iter_mut().zip(steps) {
                    // Casts saturate, and 0/0, for points that coincide, becomes 0.
                    kept[lane] = steps as i8;
                }
                *point = center + Vec3::from(kept.map(|steps| f32::from(steps[lane]))) * (radius / MAX_STEPS);
            }
            kept
        });
        Self(fours.collect())
    }

    /// Four samples, m.
    #[inline]
    pub fn four(&self, four: usize, above: &Level) -> [f32x4; 3] {
        let sphere = &above.spheres[four / 4];
        let lane = |x: &f32x4| x.as_array()[four % 4];
        let step = f32x4::splat(lane(&sphere[3]) * (1.0 / MAX_STEPS));
        let [x, y, z] = self.0[four].map(|axis| i32x4::new(axis.map(i32::from)).round_float());
        let [cx, cy, cz] = [lane(&sphere[0]), lane(&sphere[1]), lane(&sphere[2])].map(f32x4::splat);
        [cx + step * x, cy + step * y, cz + step * z]
    }

    /// Number of fours.
    pub fn len(&self) -> usize {
        self.0.len()
    }
}

impl SurfaceSamples {
    /// Samples a mesh's surface; `spacing` is that of the finest samples, m.
    pub fn new(mesh: &TriMesh, spacing: f64) -> Self {
        let center = mesh.bounding_sphere().center;
        let mut fragments = Fragments::new((MIN_FRAGMENT_AREA * spacing * spacing) as f32);
        for index in 0..mesh.triangles().len() {
            let corners = mesh.corners(index).map(|corner| corner - center);
            cut(corners, MAX_FRAGMENT_EDGE * spacing, &mut fragments);
        }
        let mut fragments = fragments.finish();
        let whole: f64 = fragments.iter().map(|fragment| f64::from(fragment.area)).sum();
        let count = ((whole / (spacing * spacing)).round() as usize).max(1);
        let mut drawn = vec![Vec3::ZERO; if whole > 0.0 { CANDIDATES * count } else { 0 }];
        if whole > 0.0 {
            spread(&mut fragments, &mut drawn, 0);
        }
        drop(fragments);
        let mut points = chosen(&drawn, CANDIDATES);
        drop(drawn);
        let mut levels = vec![Level { samples: Vec::new(), spheres: Vec::new() }];
        let mut finest = Finest(Vec::new());
        let mut parts = 4;
        while !points.is_empty() {
            let level = Level::new(&points, parts);
            if parts == 4 {
                finest = Finest::new(&mut points, &level);
            }
            levels.push(level);
            if points.len() <= 4 * parts {
                break;
            }
            parts *= 4;
        }
        Self { center, levels, finest, area: (whole / count as f64) as f32, count }
    }

    /// Smallest spacing (m) of samples that take no more than `bytes`, for a surface's area (m²).
    pub fn spacing(area: f64, bytes: f64) -> f64 {
        // Three bytes a sample, and a third as many samples in the levels above, with a sphere each.
        let each = 3.0 + (size_of::<[f32; 3]>() + size_of::<[f32; 4]>()) as f64 / 3.0;
        (area * each / bytes).sqrt()
    }

    pub(crate) fn write(&self, to: &mut Writer) {
        to.vec(self.center);
        to.f64([f64::from(self.area)]);
        to.u32([self.count as u32, self.levels.len() as u32]);
        to.u8(self.finest.0.iter().flatten().flatten().map(|step| step.cast_unsigned()));
        for level in &self.levels[1..] {
            to.u32([level.samples.len() as u32]);
            to.fours(&level.samples);
            to.fours(&level.spheres);
        }
    }

    pub(crate) fn read_from(from: &mut Reader) -> Result<Self, FormatError> {
        let center = from.vec()?;
        let area = from.f64()? as f32;
        let (count, levels) = (from.u32()? as usize, from.u32()?);
        // Each level has a quarter of the fours of the one below, and the last has one.
        let mut fours = if levels > 1 { count.div_ceil(4) } else { 0 };
        let finest = from.bytes(fours, 12)?.as_chunks::<12>().0.iter();
        let finest = finest
            .map(|bytes| [0, 1, 2].map(|axis| [0, 1, 2, 3].map(|lane| bytes[4 * axis + lane].cast_signed())));
        let finest = Finest(finest.collect());
        let mut all = vec![Level { samples: Vec::new(), spheres: Vec::new() }];
        for _ in 1..levels {
            let kept = from.u32()? as usize;
            fours = fours.div_ceil(4);
            if kept != fours {
                return Err(FormatError::Damaged);
            }
            all.push(Level { samples: from.fours(kept)?, spheres: from.fours(kept)? });
        }
        if levels == 0 || fours > 1 {
            return Err(FormatError::Damaged);
        }
        Ok(Self { center, levels: all, finest, area, count })
    }

    /// Centre of the surface in the mesh's frame, m: all positions are about it.
    pub(crate) fn center(&self) -> DVec3 {
        self.center
    }

    /// Four samples of a level, about the centre, m.
    #[inline]
    pub(crate) fn four(&self, level: usize, four: usize) -> [f32x4; 3] {
        if level == 0 { self.finest.four(four, &self.levels[1]) } else { self.levels[level].samples[four] }
    }

    /// A sample, about the centre, m.
    pub(crate) fn point(&self, sample: Sample) -> Vec3 {
        let four = self.four(sample.level.into(), sample.index as usize / 4);
        Vec3::from(four.map(|axis| axis.as_array()[sample.index as usize % 4]))
    }

    /// Number of fours of samples of a level.
    pub(crate) fn fours(&self, level: usize) -> usize {
        if level == 0 { self.finest.len() } else { self.levels[level].samples.len() }
    }

    /// Number of samples of the finest level.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        let of = |level: &Level| {
            level.samples.capacity() * size_of::<[f32x4; 3]>()
                + level.spheres.capacity() * size_of::<[f32x4; 4]>()
        };
        size_of::<Self>()
            + self.finest.0.capacity() * size_of::<[[i8; 4]; 3]>()
            + self.levels.iter().map(of).sum::<usize>()
    }
}

impl Level {
    /// The level of parts with `parts` points each.
    fn new(points: &[Vec3], parts: usize) -> Self {
        let none = (Vec3::splat(f32::MAX.sqrt()), Vec3::ZERO, f32::NEG_INFINITY);
        let spheres = points.par_chunks(parts).map(|part| {
            let low = part.iter().copied().fold(Vec3::INFINITY, Vec3::min);
            let high = part.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max);
            let center = low.midpoint(high);
            (center, part.iter().map(|point| point.distance(center)).fold(0.0, f32::max) * RADIUS_MARGIN)
        });
        let spheres: Vec<(Vec3, f32)> = spheres.collect();
        let samples = chosen(points, parts);
        let own: Vec<(Vec3, Vec3, f32)> = samples
            .into_iter()
            .zip(spheres)
            .map(|(sample, (center, radius))| (sample, center, radius))
            .collect();
        let lanes = |four: &[(Vec3, Vec3, f32)], of: &dyn Fn(&(Vec3, Vec3, f32)) -> f32| {
            f32x4::new(std::array::from_fn(|i| of(four.get(i).unwrap_or(&none))))
        };
        Self {
            samples: own
                .chunks(4)
                .map(|four| [0, 1, 2].map(|axis| lanes(four, &|one| one.0[axis])))
                .collect(),
            spheres: own
                .chunks(4)
                .map(|four| {
                    let [x, y, z] = [0, 1, 2].map(|axis| lanes(four, &|one| one.1[axis]));
                    [x, y, z, lanes(four, &|one| one.2)]
                })
                .collect(),
        }
    }

    /// A sphere's centre and radius, m.
    fn sphere(&self, part: usize) -> (Vec3, f32) {
        let [x, y, z, radius] = self.spheres[part / 4].map(|lanes| lanes.to_array()[part % 4]);
        (Vec3::new(x, y, z), radius)
    }
}

/// A piece of a triangle.
struct Fragment {
    corners: [Vec3; 3],
    /// Area that it represents, m².
    area: f32,
}

/// Collected pieces of triangles. A sliver, of which there may be very many, also represents the ones before
/// it.
struct Fragments {
    kept: Vec<Fragment>,
    /// Smallest area that a fragment represents, m².
    least: f32,
    /// Area of pieces that the next fragment will represent, m².
    area: f32,
}

impl Fragments {
    fn new(least: f32) -> Self {
        Self { kept: Vec::new(), least, area: 0.0 }
    }

    fn push(&mut self, corners: [Vec3; 3]) {
        let [a, b, c] = corners;
        self.area += (b - a).cross(c - a).length() / 2.0;
        if self.area >= self.least || self.kept.is_empty() {
            self.kept.push(Fragment { corners, area: std::mem::take(&mut self.area) });
        }
    }

    /// All fragments; the last also represents the pieces after it.
    fn finish(mut self) -> Vec<Fragment> {
        if let Some(last) = self.kept.last_mut() {
            last.area += self.area;
        }
        self.kept
    }
}

/// Draws points in parts of equal area, [`CANDIDATES`] in each. The fragments are halved along the longest
/// axis, recursively, so that parts with neighbouring numbers are neighbours; `first` is the number of the
/// first point.
fn spread(fragments: &mut [Fragment], points: &mut [Vec3], first: usize) {
    let count = points.len() / CANDIDATES;
    let whole: f64 = fragments.iter().map(|fragment| f64::from(fragment.area)).sum();
    if count > 1 {
        let half = count.next_power_of_two() / 2;
        let middle = divide(fragments, whole * half as f64 / count as f64);
        let (one, other) = fragments.split_at_mut(middle);
        let (of_one, of_other) = points.split_at_mut(CANDIDATES * half);
        let (mut near, mut far) =
            (|| spread(one, of_one, first), || spread(other, of_other, first + CANDIDATES * half));
        if middle > MIN_PARALLEL_FRAGMENTS {
            rayon::join(near, far);
        } else {
            near();
            far();
        }
        return;
    }
    let mut rng = SmallRng::seed_from_u64(SEED ^ first as u64);
    for point in points {
        let mut left = rng.random_range(0.0..1.0) * whole;
        let drawn = fragments.iter().find(|fragment| {
            left -= f64::from(fragment.area);
            left < 0.0
        });
        let [a, b, c] = drawn.unwrap_or(&fragments[fragments.len() - 1]).corners;
        let (mut u, mut v): (f32, f32) = (rng.random_range(0.0..1.0), rng.random_range(0.0..1.0));
        if u + v > 1.0 {
            (u, v) = (1.0 - u, 1.0 - v);
        }
        *point = a + u * (b - a) + v * (c - a);
    }
}

/// Second moments of points about a middle: the means of x², y², z², and of yz, zx, xy.
struct Spread([Vec3; 2]);

impl Spread {
    fn of(points: &[Vec3], middle: Vec3) -> Self {
        let mut sums = [Vec3::ZERO; 2];
        for point in points {
            let p = *point - middle;
            sums[0] += p * p;
            sums[1] += Vec3::new(p.y * p.z, p.z * p.x, p.x * p.y);
        }
        Self(sums.map(|sum| sum / points.len() as f32))
    }

    fn trace(&self) -> f32 {
        self.0[0].element_sum()
    }

    /// Squared Frobenius norm of the difference of two symmetric matrices.
    fn distance_squared(&self, other: &Self) -> f32 {
        self.0[0].distance_squared(other.0[0]) + 2.0 * self.0[1].distance_squared(other.0[1])
    }
}

/// Chooses one point of each part of `parts` points: of several random choices for four parts, the one that
/// best matches their centroid and spread.
fn chosen(points: &[Vec3], parts: usize) -> Vec<Vec3> {
    let fours = points.par_chunks(4 * parts).enumerate().flat_map_iter(|(index, four)| {
        let mut rng = SmallRng::seed_from_u64(SEED ^ (index as u64) << 32 ^ parts as u64);
        let centroid = |points: &[Vec3]| points.iter().sum::<Vec3>() / points.len() as f32;
        let middle = centroid(four);
        let wanted = Spread::of(four, middle);
        let size = wanted.trace().max(f32::MIN_POSITIVE);
        let (mut best, mut least) = ([Vec3::ZERO; 4], f32::INFINITY);
        let count = four.len().div_ceil(parts);
        for _ in 0..CHOICES {
            let mut own = [Vec3::ZERO; 4];
            for (own, part) in own.iter_mut().zip(four.chunks(parts)) {
                *own = part[rng.random_range(0..part.len())];
            }
            let own = &own[..count];
            let centered = centroid(own).distance_squared(middle) / size;
            let off = centered + Spread::of(own, middle).distance_squared(&wanted) / (size * size);
            if off < least {
                least = off;
                best[..count].copy_from_slice(own);
            }
        }
        best.into_iter().take(count)
    });
    fours.collect()
}

/// Reorders fragments along the longest axis of their box so that the first ones have an area of `share`;
/// returns their number.
fn divide(fragments: &mut [Fragment], share: f64) -> usize {
    let corners = || fragments.iter().flat_map(|fragment| fragment.corners);
    let low = corners().fold(Vec3::INFINITY, Vec3::min);
    let high = corners().fold(Vec3::NEG_INFINITY, Vec3::max);
    let axis = (high - low).max_position();
    let key = |Fragment { corners: [a, b, c], .. }: &Fragment| a[axis] + b[axis] + c[axis];
    // Quickselect by area: fragments before `first` are among the first ones, those from `end` on are not.
    let (mut first, mut end, mut left) = (0, fragments.len(), share);
    while end - first > 1 {
        let own = &mut fragments[first..end];
        let middle = own.len() / 2;
        own.select_nth_unstable_by(middle, |s, t| key(s).total_cmp(&key(t)));
        let below: f64 = own[..middle].iter().map(|fragment| f64::from(fragment.area)).sum();
        if below <= left {
            (first, left) = (first + middle, left - below);
        } else {
            end = first + middle;
        }
    }
    first.clamp(1, (fragments.len() - 1).max(1))
}

/// Halves a triangle's longest edge until no edge is longer than `longest`.
fn cut(corners: [DVec3; 3], longest: f64, into: &mut Fragments) {
    let mut stack = vec![corners];
    while let Some([a, b, c]) = stack.pop() {
        let [ab, bc, ca] = [a.distance(b), b.distance(c), c.distance(a)];
        let most = ab.max(bc).max(ca);
        if most.is_nan() || most <= longest {
            into.push([a, b, c].map(|corner| corner.as_vec3()));
            continue;
        }
        let [p, q, r] = if ab == most {
            [a, b, c]
        } else if bc == most {
            [b, c, a]
        } else {
            [c, a, b]
        };
        let middle = p.midpoint(q);
        stack.extend([[p, middle, r], [middle, q, r]]);
    }
}

#[cfg(test)]
mod tests {
    use palpate_models::Model;

    use super::*;

    fn points(samples: &SurfaceSamples, level: usize, count: usize) -> Vec<Vec3> {
        let all = (0..samples.fours(level)).flat_map(|four| {
            let [x, y, z] = samples.four(level, four).map(f32x4::to_array);
            (0..4).map(move |lane| Vec3::new(x[lane], y[lane], z[lane]))
        });
        all.take(count).collect()
    }

    #[test]
    fn every_level_stands_for_the_whole_surface() {
        let mesh = Model::Torus.generate(6000).expect("in range");
        let radius = mesh.bounding_sphere().radius;
        let samples = SurfaceSamples::new(&mesh, 0.01 * radius);
        let (mut whole, mut moment) = (0.0, DVec3::ZERO);
        for triangle in (0..mesh.triangles().len()).map(|t| mesh.corners(t)) {
            let [a, b, c] = triangle;
            let own = (b - a).cross(c - a).length() / 2.0;
            whole += own;
            moment += own * (triangle[0] + triangle[1] + triangle[2]) / 3.0;
        }
        assert!((f64::from(samples.area) * samples.count() as f64 / whole - 1.0).abs() < 1e-5);
        let mut count = samples.count();
        let finest = points(&samples, 0, count);
        for (level, of) in samples.levels.iter().enumerate() {
            let own = points(&samples, level, count);
            let mean = samples.center + own.iter().sum::<Vec3>().as_dvec3() / own.len() as f64;
            let off = mean.distance(moment / whole) / radius;
            // The last part of a level is smaller than the others.
            assert!(off < 0.02 + 1.0 / count as f64, "level {level}: {off}");
            for (index, part) in finest.chunks(1 << (2 * level)).enumerate().filter(|_| level > 0) {
                let [x, y, z, radius] = of.spheres[index / 4].map(|lanes| lanes.to_array()[index % 4]);
                for point in part {
                    assert!(point.distance(Vec3::new(x, y, z)) <= radius * (1.0 + 1e-6));
                }
                let nearest = part.iter().map(|p| p.distance(own[index])).fold(f32::INFINITY, f32::min);
                // The level above the finest was chosen before these were rounded.
                assert!(nearest <= 0.01 * radius, "{nearest}");
            }
            count = count.div_ceil(4);
        }
        assert!(count <= 1, "{count} above the coarsest level");
    }
}
