//! Pairwise merging of patches up to a single root (§3.3.3): the free levels of detail.
//!
//! In each pass neighbours are paired, those whose hulls grow least in surface area first (on large levels,
//! those with the smallest common bounding sphere); then those left over that have a neighbour in common. A
//! node without a partner becomes an only child. Connected pieces of surface that have merged to one node
//! wait until there are more of them than of other nodes, and are then paired by proximity. The hull of a
//! pair is that of the children's extreme points.

use glam::DVec3;
use palpate_core::mesh::Adjacency;
use rayon::prelude::*;

use crate::convexity::HULL_THICKNESS;
use crate::decomposition::Decomposition;
use crate::enclosing::smallest_sphere;
use crate::hull::{HullBuilder, Shape};
use crate::progress::{Cancelled, Progress};
use crate::surface::GRAIN;

/// Largest number of pieces of which all pairs are candidates; of more, only those near each other along a
/// space-filling curve.
const MAX_PIECES_ALL_PAIRS: usize = 256;

/// Largest number of clusters of a level whose pairs are chosen by the growth of their hulls, which takes
/// long on larger levels.
const MAX_CLUSTERS_BY_GROWTH: usize = 2048;

/// Largest ratio of the common sphere of two clusters to the larger of their own, as long as nearer pairs
/// exist.
const MAX_SPHERE_GROWTH: f64 = 8.0;

/// Number of places along the curve within which pairs are candidates.
const CURVE_WINDOW: usize = 8;

/// A hull of the hierarchy.
#[derive(Clone, Debug)]
pub(crate) struct Cluster {
    /// Its extreme points, as mesh vertices.
    pub extreme: Vec<u32>,
    /// Centre of its smallest bounding sphere, in unit coordinates.
    pub center: DVec3,
    /// Radius of that sphere, in unit coordinates.
    pub radius: f64,
    /// One or two clusters of the level below; empty for a patch.
    pub children: Vec<u32>,
}

/// Merges patches to a root. Returns the levels, patches first, the root's last. `radius` is the object's, in
/// unit coordinates.
pub(crate) fn merge_to_root(
    points: &[DVec3],
    decomposition: &Decomposition,
    adjacency: &Adjacency,
    radius: f64,
    progress: &mut Progress<'_>,
) -> Result<Vec<Vec<Cluster>>, Cancelled> {
    let leaves = leaves(points, decomposition);
    let mut links = patch_links(decomposition, adjacency);
    let mut levels = vec![leaves];
    while let Some(level) = levels.last()
        && level.len() > 1
    {
        let partner = pair(points, level, &links, radius);
        let mut parents: Vec<Vec<u32>> = Vec::with_capacity(level.len() / 2 + 1);
        let mut parent_of = vec![0u32; level.len()];
        for (k, &other) in partner.iter().enumerate() {
            let k = k as u32;
            if other < k {
                continue;
            }
            parent_of[k as usize] = parents.len() as u32;
            parent_of[other as usize] = parents.len() as u32;
            parents.push(if other == k { vec![k] } else { vec![k, other] });
        }
        let next: Vec<Cluster> = parents
            .par_iter()
            .map_init(HullBuilder::default, |hulls, children| parent(points, level, children, hulls))
            .collect();
        let mut next_links: Vec<(u32, u32)> = links
            .iter()
            .map(|(a, b)| (parent_of[*a as usize], parent_of[*b as usize]))
            .filter(|(a, b)| a != b)
            .map(|(a, b)| (a.min(b), a.max(b)))
            .collect();
        next_links.par_sort_unstable();
        next_links.dedup();
        links = next_links;
        progress.at(1.0 - (next.len() as f64).log2() / (levels[0].len() as f64).log2())?;
        levels.push(next);
    }
    Ok(levels)
}

/// The hulls of patches, without children.
pub(crate) fn leaves(points: &[DVec3], decomposition: &Decomposition) -> Vec<Cluster> {
    decomposition
        .patches
        .par_iter()
        .map(|patch| {
            let (center, radius) = smallest_sphere(&gather(points, &patch.extreme));
            Cluster { extreme: patch.extreme.clone(), center, radius, children: Vec::new() }
        })
        .collect()
}

fn gather(points: &[DVec3], vertices: &[u32]) -> Vec<DVec3> {
    vertices.iter().map(|v| points[*v as usize]).collect()
}

/// Pairs of patches with a common edge, the smaller index first, in ascending order.
fn patch_links(decomposition: &Decomposition, adjacency: &Adjacency) -> Vec<(u32, u32)> {
    let patch = |t: u32| decomposition.patch_of[t as usize];
    let mut links = Vec::new();
    for edge in 0..adjacency.edges().len() as u32 {
        let sides = adjacency.edge_sides(edge);
        for side in &sides[1..] {
            let (a, b) = (patch(sides[0].triangle()), patch(side.triangle()));
            if a != b {
                links.push((a.min(b), a.max(b)));
            }
        }
    }
    links.par_sort_unstable();
    links.dedup();
    links
}

/// The partner of each cluster: the cluster itself where it has none.
fn pair(points: &[DVec3], level: &[Cluster], links: &[(u32, u32)], radius: f64) -> Vec<u32> {
    let mut connected = vec![false; level.len()];
    for &(a, b) in links {
        connected[a as usize] = true;
        connected[b as usize] = true;
    }
    let pieces: Vec<u32> = (0..level.len() as u32).filter(|k| !connected[*k as usize]).collect();
    let mut candidates: Vec<(u32, u32)> = links.to_vec();
    if 2 * pieces.len() > level.len() {
        candidates.extend(near_pieces(level, pieces));
    }
    let near = |(a, b): &(u32, u32)| {
        let (a, b) = (&level[*a as usize], &level[*b as usize]);
        common_radius(a, b) <= MAX_SPHERE_GROWTH * a.radius.max(b.radius)
    };
    if candidates.iter().any(near) {
        candidates.retain(near);
    }
    let mut partner: Vec<u32> = (0..level.len() as u32).collect();
    pair_smallest(points, level, candidates, radius, &mut partner);
    // Many patches around a large one, such as teeth on a flat side, have no other neighbour: only one of
    // them would find a partner in each pass. The rest are paired with each other.
    let rest = pairs_with_a_common_neighbour(level, links, &partner);
    pair_smallest(points, level, rest, radius, &mut partner);
    partner
}

/// Pairs the candidates that have no partner yet, the smallest first.
fn pair_smallest(
    points: &[DVec3],
    level: &[Cluster],
    candidates: Vec<(u32, u32)>,
    radius: f64,
    partner: &mut [u32],
) {
    let by_growth = level.len() <= MAX_CLUSTERS_BY_GROWTH;
    let areas: Vec<f64> = if by_growth {
        level
            .par_iter()
            .map_init(HullBuilder::default, |hulls, c| hull_area(&gather(points, &c.extreme), hulls))
            .collect()
    } else {
        Vec::new()
    };
    let cost = |hulls: &mut HullBuilder, a: u32, b: u32| {
        let (first, second) = (&level[a as usize], &level[b as usize]);
        if !by_growth {
            return (common_radius(first, second) / (GRAIN * radius)).round();
        }
        let mut union = gather(points, &first.extreme);
        union.extend(gather(points, &second.extreme));
        let growth = hull_area(&union, hulls) - areas[a as usize] - areas[b as usize];
        (growth / (GRAIN * radius * radius)).round()
    };
    let mut ranked: Vec<(f64, u32, u32)> = candidates
        .into_par_iter()
        .map_init(HullBuilder::default, |hulls, (a, b)| (cost(hulls, a, b), a, b))
        .collect();
    ranked.par_sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
    for (_, a, b) in ranked {
        if partner[a as usize] == a && partner[b as usize] == b {
            partner[a as usize] = b;
            partner[b as usize] = a;
        }
    }
}

/// Candidate pairs among clusters without a partner: clusters near each other around the same neighbour.
fn pairs_with_a_common_neighbour(
    level: &[Cluster],
    links: &[(u32, u32)],
    partner: &[u32],
) -> Vec<(u32, u32)> {
    let alone = |k: u32| partner[k as usize] == k;
    let mut around: Vec<(u32, u64, u32)> = links
        .iter()
        .flat_map(|&(a, b)| [(a, b), (b, a)])
        .filter(|(_, k)| alone(*k))
        .map(|(hub, k)| (hub, curve(level[k as usize].center), k))
        .collect();
    around.par_sort_unstable();
    let mut pairs = Vec::new();
    for siblings in around.chunk_by(|a, b| a.0 == b.0) {
        for (k, &(_, _, a)) in siblings.iter().enumerate() {
            pairs.extend(siblings[k + 1..].iter().take(CURVE_WINDOW).map(|&(_, _, b)| (a.min(b), a.max(b))));
        }
    }
    pairs
}

/// Surface area of the hull of some points; both sides of a flat one.
fn hull_area(points: &[DVec3], hulls: &mut HullBuilder) -> f64 {
    let hull = hulls.hull(points, HULL_THICKNESS);
    let doubled = |[a, b, c]: [u32; 3]| {
        let [a, b, c] = [a, b, c].map(|v| points[v as usize]);
        (b - a).cross(c - a).length()
    };
    if hull.shape == Shape::Polygon {
        let first = hull.extreme[0];
        return hull.extreme[1..].windows(2).map(|w| doubled([first, w[0], w[1]])).sum();
    }
    0.5 * hull.faces.iter().copied().map(doubled).sum::<f64>()
}

/// The radius of the smallest sphere around the spheres of two clusters.
fn common_radius(a: &Cluster, b: &Cluster) -> f64 {
    let between = a.center.distance(b.center);
    (0.5 * (between + a.radius + b.radius)).max(a.radius).max(b.radius)
}

/// Candidate pairs among clusters that are not connected to others.
fn near_pieces(level: &[Cluster], mut pieces: Vec<u32>) -> Vec<(u32, u32)> {
    let window = if pieces.len() <= MAX_PIECES_ALL_PAIRS { pieces.len() } else { CURVE_WINDOW };
    pieces.sort_by_cached_key(|k| (curve(level[*k as usize].center), *k));
    let mut pairs = Vec::new();
    for (k, &a) in pieces.iter().enumerate() {
        pairs.extend(pieces[k + 1..].iter().take(window).map(|&b| (a.min(b), a.max(b))));
    }
    pairs
}

/// Place along the Z-order curve through the cube from -1 to 1, 21 bits an axis.
fn curve(p: DVec3) -> u64 {
    let spread = |x: f64| {
        let cell = ((x + 1.0) * f64::from(1 << 20)).clamp(0.0, f64::from((1 << 21) - 1)) as u64;
        (0..21).fold(0u64, |bits, k| bits | (cell >> k & 1) << (3 * k))
    };
    spread(p.x) | spread(p.y) << 1 | spread(p.z) << 2
}

fn parent(points: &[DVec3], level: &[Cluster], children: &[u32], hulls: &mut HullBuilder) -> Cluster {
    if let [only] = *children {
        let child = &level[only as usize];
        return Cluster { children: vec![only], ..child.clone() };
    }
    let mut vertices: Vec<u32> = children.iter().flat_map(|k| &level[*k as usize].extreme).copied().collect();
    vertices.sort_unstable();
    vertices.dedup();
    let hull = hulls.hull(&gather(points, &vertices), HULL_THICKNESS);
    let extreme: Vec<u32> = hull.extreme.iter().map(|k| vertices[*k as usize]).collect();
    let (center, radius) = smallest_sphere(&gather(points, &extreme));
    Cluster { extreme, center, radius, children: children.to_vec() }
}

#[cfg(test)]
mod tests {
    use palpate_core::mesh::TriMesh;

    use super::*;
    use crate::decomposition::decompose;
    use crate::progress::unwatched;
    use crate::surface::Surface;

    fn levels_of(mesh: &TriMesh) -> (Surface, Vec<Vec<Cluster>>) {
        let sphere = mesh.bounding_sphere();
        let surface = Surface::new(mesh, sphere.center, sphere.radius);
        let adjacency = mesh.adjacency();
        let decomposition = decompose(&surface, &adjacency, 1e-6, &mut Progress::new(&mut unwatched))
            .expect("nobody cancels");
        let levels = merge_to_root(
            &surface.points,
            &decomposition,
            &adjacency,
            1.0,
            &mut Progress::new(&mut unwatched),
        )
        .expect("nobody cancels");
        (surface, levels)
    }

    /// Largest distance of some vertices outside the hull of a cluster.
    fn farthest_outside(surface: &Surface, cluster: &Cluster, vertices: &[u32]) -> f64 {
        let points = gather(&surface.points, &cluster.extreme);
        let hull = HullBuilder::default().hull(&points, HULL_THICKNESS);
        if hull.shape != Shape::Polytope {
            return 0.0;
        }
        let planes: Vec<_> = hull.planes(&points).collect();
        let height =
            |v: &u32| planes.iter().map(|p| p.height(surface.points[*v as usize])).fold(f64::MIN, f64::max);
        vertices.iter().map(height).fold(f64::MIN, f64::max)
    }

    #[test]
    fn every_ancestor_contains_its_descendants() {
        let mesh = palpate_models::Model::GolfBall.generate(3000).expect("within range");
        let (surface, levels) = levels_of(&mesh);
        assert!(levels.len() > 8);
        let mut outside = f64::MIN;
        for k in 1..levels.len() {
            for cluster in &levels[k] {
                // All patches below.
                let mut below = cluster.children.clone();
                for finer in levels[1..k].iter().rev() {
                    below = below.iter().flat_map(|c| &finer[*c as usize].children).copied().collect();
                }
                for leaf in below {
                    outside =
                        outside.max(farthest_outside(&surface, cluster, &levels[0][leaf as usize].extreme));
                }
                let reach =
                    cluster.extreme.iter().map(|v| surface.points[*v as usize].distance(cluster.center));
                assert!(reach.fold(0.0, f64::max) <= cluster.radius);
            }
        }
        assert!(outside < 1e-13, "{outside:e}");
    }

    #[test]
    fn each_cluster_has_one_parent() {
        let mesh = palpate_models::Model::Torus.generate(3000).expect("within range");
        let (_, levels) = levels_of(&mesh);
        assert_eq!(levels.last().map(Vec::len), Some(1));
        for pair in levels.windows(2) {
            let mut children: Vec<u32> = pair[1].iter().flat_map(|c| &c.children).copied().collect();
            children.sort_unstable();
            assert!(children.iter().copied().eq(0..pair[0].len() as u32));
        }
    }

    #[test]
    fn curve_orders_neighbouring_cells() {
        assert_eq!(curve(DVec3::splat(-1.0)), 0);
        assert_eq!(curve(DVec3::splat(5.0)), (1 << 63) - 1);
        assert!(curve(DVec3::new(-0.5, -0.5, -0.5)) < curve(DVec3::new(-1.0, -1.0, 0.5)));
    }
}
