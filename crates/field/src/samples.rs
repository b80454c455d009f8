//! Points evenly spread over a surface, in several densities.

use glam::{DVec3, Vec3};
use palpate_core::TriMesh;
use rand::rngs::SmallRng;
use rand::{RngExt as _, SeedableRng as _};
use wide::f32x4;

/// A surface is cut into fragments no longer than this part of the samples' spacing, so that its parts have equal areas.
const FRAGMENT: f64 = 0.75;
/// Places that are drawn in each part, of which one becomes a sample.
const DRAWN: usize = 8;
/// Choices of four samples that are compared.
const CHOICES: usize = 64;
/// Of the samples' places.
const SEED: u64 = 0x5A3B;

/// Points on a surface in levels, of which each has a quarter of the points of the one below, and each of its points stands for
/// an equal part of the surface: point i for what the points 4 i to 4 i + 3 of the level below stand for.
///
/// Each part has one point, anywhere in it: the mean over a surface of any function is that of its samples, but for noise. There
/// is less of it as four points that are together are chosen to have the centroid and the spread of what they stand for.
#[derive(Clone, Debug)]
pub struct SurfaceSamples {
    /// The finest first; the coarsest has four points at most.
    pub(crate) levels: Vec<Level>,
    /// That a sample of the finest level stands for, m².
    pub(crate) area: f32,
    count: usize,
}

/// A level's points, and spheres around the finest samples of the parts that they stand for, four by four. Those that there are
/// not have radii of −∞, and are too far away for everything.
#[derive(Clone, Debug)]
pub(crate) struct Level {
    pub samples: Vec<[f32x4; 3]>,
    /// Centres and radii, m.
    pub spheres: Vec<[f32x4; 4]>,
}

impl SurfaceSamples {
    /// Of a mesh's surface, the finest so far apart (m).
    pub fn new(mesh: &TriMesh, spacing: f64) -> Self {
        let mut fragments = Vec::with_capacity(mesh.triangles().len());
        for index in 0..mesh.triangles().len() {
            cut(mesh.corners(index), FRAGMENT * spacing, &mut fragments);
        }
        let whole: f64 = fragments.iter().map(area).sum();
        let count = ((whole / (spacing * spacing)).round() as usize).max(1);
        let mut points = Vec::with_capacity(DRAWN * count);
        let mut rng = SmallRng::seed_from_u64(SEED);
        if whole > 0.0 {
            spread(&mut fragments, count, &mut points, &mut rng);
        }
        let points = chosen(&points, DRAWN, &mut rng);
        let mut levels = Vec::new();
        let mut parts = 1;
        while !points.is_empty() {
            levels.push(Level::new(&points, parts, &mut rng));
            if points.len() <= 4 * parts {
                break;
            }
            parts *= 4;
        }
        Self { levels, area: (whole / count as f64) as f32, count }
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Bytes of memory held.
    pub fn bytes(&self) -> usize {
        let of = |level: &Level| {
            level.samples.capacity() * size_of::<[f32x4; 3]>()
                + level.spheres.capacity() * size_of::<[f32x4; 4]>()
        };
        size_of::<Self>() + self.levels.iter().map(of).sum::<usize>()
    }
}

impl Level {
    /// Of parts with so many points each.
    fn new(points: &[Vec3], parts: usize, rng: &mut SmallRng) -> Self {
        let none = (Vec3::splat(f32::MAX.sqrt()), Vec3::ZERO, f32::NEG_INFINITY);
        let own: Vec<(Vec3, Vec3, f32)> = points
            .chunks(parts)
            .zip(chosen(points, parts, rng))
            .map(|(part, sample)| {
                let low = part.iter().copied().fold(Vec3::INFINITY, Vec3::min);
                let high = part.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max);
                let center = low.midpoint(high);
                let radius = part.iter().map(|point| point.distance(center)).fold(0.0, f32::max);
                (sample, center, radius)
            })
            .collect();
        let lanes = |four: &[(Vec3, Vec3, f32)], of: &dyn Fn(&(Vec3, Vec3, f32)) -> f32| {
            f32x4::new(std::array::from_fn(|i| of(four.get(i).unwrap_or(&none))))
        };
        Self {
            samples: own
                .chunks(4)
                .map(|four| [0, 1, 2].map(|axis| lanes(four, &|one| one.0[axis])))
                .collect(),
            // Of single points there is nothing more to know.
            spheres: if parts == 1 {
                Vec::new()
            } else {
                let sphere = |four| {
                    let [x, y, z] = [0, 1, 2].map(|axis| lanes(four, &|one| one.1[axis]));
                    [x, y, z, lanes(four, &|one| one.2)]
                };
                own.chunks(4).map(sphere).collect()
            },
        }
    }
}

fn area([a, b, c]: &[DVec3; 3]) -> f64 {
    (b - a).cross(c - a).length() / 2.0
}

/// Puts a sample anywhere in each of so many parts of equal area. Parts with a power of two of them are together.
fn spread(fragments: &mut [[DVec3; 3]], count: usize, points: &mut Vec<Vec3>, rng: &mut SmallRng) {
    if count > 1 {
        let first = count.next_power_of_two() / 2;
        let counts = [first, count - first];
        let middle = halve(fragments, counts);
        let (one, other) = fragments.split_at_mut(middle);
        spread(one, counts[0], points, rng);
        spread(other, counts[1], points, rng);
        return;
    }
    let whole: f64 = fragments.iter().map(area).sum();
    for _ in 0..DRAWN {
        let mut left = rng.random_range(0.0..1.0) * whole;
        let drawn = fragments.iter().find(|fragment| {
            left -= area(fragment);
            left < 0.0
        });
        let [a, b, c] = *drawn.unwrap_or(&fragments[fragments.len() - 1]);
        let (mut u, mut v): (f64, f64) = (rng.random_range(0.0..1.0), rng.random_range(0.0..1.0));
        if u + v > 1.0 {
            (u, v) = (1.0 - u, 1.0 - v);
        }
        points.push((a + u * (b - a) + v * (c - a)).as_vec3());
    }
}

/// One point of each part of so many: of several choices for four parts, the one that has their centroid and spread best.
fn chosen(points: &[Vec3], parts: usize, rng: &mut SmallRng) -> Vec<Vec3> {
    let mut found = Vec::with_capacity(points.len().div_ceil(parts));
    for four in points.chunks(4 * parts) {
        let centroid = |points: &[Vec3]| points.iter().sum::<Vec3>() / points.len() as f32;
        let middle = centroid(four);
        let spread = |points: &[Vec3]| {
            points.iter().map(|point| point.distance_squared(middle)).sum::<f32>() / points.len() as f32
        };
        let wanted = spread(four).max(f32::MIN_POSITIVE);
        let (mut best, mut least) = ([Vec3::ZERO; 4], f32::INFINITY);
        let count = four.len().div_ceil(parts);
        for _ in 0..CHOICES {
            let mut own = [Vec3::ZERO; 4];
            for (own, part) in own.iter_mut().zip(four.chunks(parts)) {
                *own = part[rng.random_range(0..part.len())];
            }
            let own = &own[..count];
            let off = centroid(own).distance_squared(middle) / wanted + (spread(own) / wanted - 1.0).powi(2);
            if off < least {
                least = off;
                best[..count].copy_from_slice(own);
            }
        }
        found.extend_from_slice(&best[..count]);
    }
    found
}

/// Sorts fragments into two parts, the first with its share of the area; how many it has.
fn halve(fragments: &mut [[DVec3; 3]], counts: [usize; 2]) -> usize {
    let corners = || fragments.iter().flatten().copied();
    let low = corners().fold(DVec3::INFINITY, DVec3::min);
    let high = corners().fold(DVec3::NEG_INFINITY, DVec3::max);
    let axis = (high - low).max_position();
    let key = |[a, b, c]: &[DVec3; 3]| a[axis] + b[axis] + c[axis];
    fragments.sort_unstable_by(|s, t| key(s).total_cmp(&key(t)));
    let whole: f64 = fragments.iter().map(area).sum();
    let share = whole * counts[0] as f64 / (counts[0] + counts[1]) as f64;
    let mut sum = 0.0;
    let found = fragments.iter().position(|fragment| {
        sum += area(fragment);
        sum > share
    });
    let last = fragments.len() - 1;
    found.unwrap_or(last).clamp(1, last.max(1))
}

/// Halves a triangle's longest edge until it is short.
fn cut(corners: [DVec3; 3], longest: f64, into: &mut Vec<[DVec3; 3]>) {
    let mut stack = vec![corners];
    while let Some([a, b, c]) = stack.pop() {
        let [ab, bc, ca] = [a.distance(b), b.distance(c), c.distance(a)];
        let most = ab.max(bc).max(ca);
        if most.is_nan() || most <= longest {
            into.push([a, b, c]);
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

    fn points(fours: &[[f32x4; 3]], count: usize) -> Vec<Vec3> {
        let all = fours.iter().flat_map(|four| {
            let [x, y, z] = four.map(f32x4::to_array);
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
            whole += area(&triangle);
            moment += area(&triangle) * (triangle[0] + triangle[1] + triangle[2]) / 3.0;
        }
        assert!((f64::from(samples.area) * samples.count() as f64 / whole - 1.0).abs() < 1e-5);
        let mut count = samples.count();
        let finest = points(&samples.levels[0].samples, count);
        for (level, of) in samples.levels.iter().enumerate() {
            let own = points(&of.samples, count);
            let mean = own.iter().sum::<Vec3>().as_dvec3() / own.len() as f64;
            let off = mean.distance(moment / whole) / radius;
            // The last part of a level stands for less than the others.
            assert!(off < 0.02 + 1.0 / count as f64, "level {level}: {off}");
            for (index, part) in finest.chunks(1 << (2 * level)).enumerate().filter(|_| level > 0) {
                let [x, y, z, radius] = of.spheres[index / 4].map(|lanes| lanes.to_array()[index % 4]);
                for point in part {
                    assert!(point.distance(Vec3::new(x, y, z)) <= radius * (1.0 + 1e-6));
                }
                assert!(part.contains(&own[index]));
            }
            count = count.div_ceil(4);
        }
        assert!(count <= 1, "{count} above the coarsest level");
    }
}
