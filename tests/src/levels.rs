//! Checks a hierarchy's levels of detail from its file alone, against the mesh that it was built from.
//!
//! Nothing of the builder is used: level meshes are assembled from the nodes' patches, surfaces are sampled
//! densely, distances come from [`TriangleTree`], and distances to hulls from the contact query's GJK.
//! Samples can only find faults; the builder's own tests show that s and h hold between the samples.

use std::collections::{BTreeMap, HashSet};

use palpate::collide::convex::gjk::{self, Limits, Separation, Start};
use palpate::collide::convex::{Hull, Placement, Polytope, SupportMap};
use palpate::core::clod::{Node, Parts};
use palpate::glam::DVec3;
use palpate::mesh_io::{self_intersections, weld};
use palpate::{Pose, TriMesh};
use rand::rngs::StdRng;
use rand::{RngExt, SeedableRng};
use rayon::prelude::*;

use crate::triangle_tree::TriangleTree;

/// Rounding error, relative to the bounding radius.
const ROUNDING: f64 = 1e-10;

/// Distance from a hull, relative to the bounding radius, below which a point counts as on it: GJK's distance
/// to a nearly flat hull is only accurate to this.
const HULL_ROUNDING: f64 = 1e-8;

/// Number of faults of one kind on one level that are described; the others are only counted.
const MAX_DESCRIBED: usize = 3;

/// Parameters of an examination.
#[derive(Clone, Copy, Debug)]
pub struct Examination {
    /// Number of random points on each level, besides every triangle's corners, centre and edge midpoints.
    pub samples: usize,
    /// Number of random points inside each hull.
    pub hull_samples: usize,
    /// Tolerance that the hierarchy was built with, relative to the bounding radius.
    pub tolerance: f64,
    /// Seed of the random points.
    pub seed: u64,
}

/// Result of an examination.
#[derive(Clone, Debug, Default)]
pub struct Findings {
    /// Faults, one line each.
    pub faults: Vec<String>,
    /// Summary of each level that is not free: its size, and how close measurements come to its bounds.
    pub levels: Vec<String>,
    /// Number of times that each check was made.
    pub checks: BTreeMap<&'static str, usize>,
}

impl Findings {
    fn fault(&mut self, text: String) {
        self.faults.push(text);
    }

    /// Adds the result of a check on parts of a level: the faults, and the number of parts checked.
    fn take(&mut self, place: &str, what: &'static str, checked: usize, faults: Vec<String>) {
        *self.checks.entry(what).or_default() += checked;
        let count = faults.len();
        self.faults
            .extend(faults.into_iter().take(MAX_DESCRIBED).map(|fault| format!("{place}: {what}: {fault}")));
        if count > MAX_DESCRIBED {
            self.fault(format!("{place}: {what}: {} more like these", count - MAX_DESCRIBED));
        }
    }
}

/// Assembled level.
struct Level<'a> {
    clod: &'a Parts,
    nodes: &'a [Node],
    mesh: TriMesh,
    tree: TriangleTree,
    /// Sampled points on each node's patch.
    samples: Vec<Vec<DVec3>>,
}

/// Returns the corners of a patch's triangles, m.
fn patch<'a>(clod: &'a Parts, node: &'a Node) -> impl Iterator<Item = [DVec3; 3]> + 'a {
    clod.patch(node).iter().map(|t| t.map(|v| clod.hull(node)[v as usize]))
}

/// Returns the mesh of a level, with exactly equal vertices joined.
///
/// # Panics
/// If the level has too many triangles for a mesh.
pub fn level_mesh(clod: &Parts, level: usize) -> TriMesh {
    let corners: Vec<DVec3> =
        clod.level(level).iter().flat_map(|n| patch(clod, n)).collect::<Vec<_>>().into_flattened();
    let triangles = (0..corners.len() as u32 / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    weld(&TriMesh::new(corners, triangles).expect("indices are in range"))
}

/// Returns the triangles of a mesh by position, in an order that depends on nothing else.
fn sorted_triangles(mesh: &TriMesh) -> Vec<[[u64; 3]; 3]> {
    let mut triangles: Vec<_> = (0..mesh.triangles().len())
        .map(|t| {
            // Both signed zeros are the same position.
            let mut corners = mesh.corners(t).map(|p| (p + DVec3::ZERO).to_array().map(f64::to_bits));
            let first = (0..3).min_by_key(|k| corners[*k]).unwrap_or(0);
            corners.rotate_left(first);
            corners
        })
        .collect();
    triangles.sort_unstable();
    triangles
}

fn euler(mesh: &TriMesh) -> i64 {
    let edges = mesh.adjacency().edges().len();
    mesh.vertices().len() as i64 - edges as i64 + mesh.triangles().len() as i64
}

impl Examination {
    /// Examines the hierarchy of a mesh that is closed, 2-manifold, oriented, free of self-intersections and
    /// welded.
    pub fn of(&self, mesh: &TriMesh, clod: &Parts) -> Findings {
        let mut findings = Findings::default();
        if let Err(error) = clod.validate() {
            findings.fault(error.to_string());
            return findings;
        }
        if !clod.source.solid {
            findings.fault("said not to be solid".to_owned());
        }
        let regular = clod.levels.iter().filter(|level| !level.free).count();
        let euler_of_mesh = euler(mesh);
        let components = mesh.validate().components;
        let mut finest: Option<Level<'_>> = None;
        for index in 0..regular {
            let surface = level_mesh(clod, index);
            if index == 0 && sorted_triangles(&surface) != sorted_triangles(mesh) {
                findings.fault("level 0: is not the mesh".to_owned());
            }
            self.check_surface(clod, index, &surface, (euler_of_mesh, components), &mut findings);
            let level = self.level(clod, index, surface);
            self.check_patches(index, &level, &mut findings);
            self.check_hulls(index, &level, &mut findings);
            self.check_deviation(index, &level, finest.as_ref().unwrap_or(&level), &mut findings);
            if finest.is_none() {
                finest = Some(level);
            }
        }
        self.check_hausdorff(clod, &mut findings);
        check_added(clod, &mut findings);
        check_spheres(clod, &mut findings);
        findings
    }

    fn level<'a>(&self, clod: &'a Parts, index: usize, mesh: TriMesh) -> Level<'a> {
        let nodes = clod.level(index);
        let area = |[a, b, c]: [DVec3; 3]| 0.5 * (b - a).cross(c - a).length();
        let total: f64 = nodes.iter().flat_map(|n| patch(clod, n)).map(area).sum();
        let mut random = StdRng::seed_from_u64(self.seed + index as u64);
        let samples = nodes
            .iter()
            .map(|node| {
                let mut points = Vec::new();
                for triangle @ [a, b, c] in patch(clod, node) {
                    points.extend([a, b, c, (a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0, (a + b + c) / 3.0]);
                    let wanted = self.samples as f64 * area(triangle) / total;
                    let count = wanted as usize + usize::from(random.random::<f64>() < wanted.fract());
                    points.extend((0..count).map(|_| {
                        let (u, v): (f64, f64) = (random.random(), random.random());
                        let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                        a + (b - a) * u + (c - a) * v
                    }));
                }
                points
            })
            .collect();
        let tree = TriangleTree::new(&mesh);
        Level { clod, nodes, mesh, tree, samples }
    }

    /// Checks that the level is a closed, oriented 2-manifold without self-intersections, has the mesh's
    /// topology, and is coarser than the level before.
    fn check_surface(
        &self,
        clod: &Parts,
        index: usize,
        surface: &TriMesh,
        (euler_of_mesh, components): (i64, usize),
        findings: &mut Findings,
    ) {
        let level = &clod.levels[index];
        let mut faults = Vec::new();
        let report = surface.validate();
        if !report.is_solid() || report.degenerate > 0 || report.duplicate > 0 || report.volume <= 0.0 {
            faults.push(format!("{report:?}"));
        }
        let (own, parts) = (euler(surface), report.components);
        if own != euler_of_mesh || parts != components {
            faults.push(format!(
                "Euler characteristic {own} where the mesh has {euler_of_mesh}, {parts} components of {components}"
            ));
        }
        let crossings = self_intersections(surface);
        if crossings.count > 0 {
            let [first, second] = crossings.first.unwrap_or_default();
            faults.push(format!(
                "{} pairs of triangles intersect, first {:?} and {:?}",
                crossings.count,
                surface.corners(first as usize),
                surface.corners(second as usize)
            ));
        }
        if level.triangles as usize != surface.triangles().len() {
            faults.push(format!("{} triangles are {}", level.triangles, surface.triangles().len()));
        }
        if let Some(finer) = index.checked_sub(1).map(|k| &clod.levels[k]) {
            if level.resolution > finer.resolution || level.resolution <= 0.0 {
                faults.push(format!("resolution {} after {}", level.resolution, finer.resolution));
            }
            if level.triangles >= finer.triangles || level.nodes.len() > finer.nodes.len() {
                faults.push(format!("no coarser than the last: {level:?} after {finer:?}"));
            }
        }
        findings.take(&format!("level {index}"), "surface", 1, faults);
    }

    /// Checks that every patch is convex: no corner lies above the plane of one of its triangles by more than
    /// the tolerance. Triangles narrower than the tolerance are skipped, since their planes are not well
    /// defined.
    fn check_patches(&self, index: usize, level: &Level<'_>, findings: &mut Findings) {
        let clod = level.clod;
        let tolerance = self.tolerance * clod.bounding_radius() * (1.0 + 1e-6);
        let faults = each(level.nodes, |k, node| {
            let mut worst = (0.0, DVec3::ZERO);
            for [a, b, c] in patch(clod, node) {
                let longest = (b - a).length().max((c - b).length()).max((a - c).length());
                let normal = (b - a).cross(c - a);
                if normal.length() <= longest * tolerance {
                    continue;
                }
                let normal = normal.normalize();
                for p in patch(clod, node).flatten() {
                    if normal.dot(p - a) > worst.0 {
                        worst = (normal.dot(p - a), p);
                    }
                }
            }
            (worst.0 > tolerance).then(|| {
                format!("patch {k} has {} {:e} above a plane, tolerance {tolerance:e}", worst.1, worst.0)
            })
        });
        findings.take(&format!("level {index}"), "convex patches", level.nodes.len(), faults);
    }

    /// Checks that no hull protrudes: points inside it are inside the level's surface, or outside by at most
    /// twice the tolerance (the builder measures heights above planes, and beside narrow triangles the
    /// surface is further away than these). No other point of the surface may be deeper inside a hull than
    /// the tolerance. Every hull encloses its patch.
    fn check_hulls(&self, index: usize, level: &Level<'_>, findings: &mut Findings) {
        let place = format!("level {index}");
        let clod = level.clod;
        let tolerance = self.tolerance * clod.bounding_radius() * (1.0 + 1e-6);
        let faults = each(level.nodes, |k, node| {
            (!node.contained).then(|| format!("patch {k} of a closed mesh is not said to be contained"))
        });
        findings.take(&place, "hulls said to be contained", level.nodes.len(), faults);

        let faults = each(level.nodes, |k, node| {
            let points: Vec<DVec3> = patch(clod, node).flatten().collect();
            let mut random = StdRng::seed_from_u64(self.seed ^ (index as u64) << 32 ^ k as u64);
            (0..self.hull_samples).find_map(|_| {
                // Combinations of a few corners come near all of the hull's faces.
                let mut weights = [0; 5].map(|_| random.random::<f64>());
                let sum: f64 = weights.iter().sum();
                weights.iter_mut().for_each(|w| *w /= sum);
                let p: DVec3 =
                    weights.iter().map(|w| *w * points[random.random_range(0..points.len())]).sum();
                if level.tree.winding(p) > 0 {
                    return None;
                }
                let outside = level.tree.distance(p);
                (outside > 2.0 * tolerance)
                    .then(|| format!("that of patch {k} holds {p}, {outside:e} outside"))
            })
        });
        findings.take(&place, "hulls inside the object", level.nodes.len() * self.hull_samples, faults);

        let (checked, faults) = self.intrusions(level, tolerance);
        findings.take(&place, "surface outside the hulls", checked, faults);

        let faults = each(level.nodes, |k, node| {
            let hull = Target::new(clod.extreme(node));
            let far = patch(clod, node).flatten().find(|p| !hull.within(*p, tolerance));
            far.map(|p| format!("that of patch {k} does not enclose its corner {p}"))
        });
        findings.take(&place, "hulls enclosing their patches", level.nodes.len(), faults);
    }

    /// Returns points of the surface that are deeper inside another patch's hull than the tolerance, and the
    /// number of points checked.
    fn intrusions(&self, level: &Level<'_>, tolerance: f64) -> (usize, Vec<String>) {
        let clod = level.clod;
        // All points sorted along an axis, to find those in a box.
        let mut points: Vec<DVec3> = level.samples.iter().flatten().copied().collect();
        points.sort_unstable_by(|p, q| p.x.total_cmp(&q.x));
        let found: Vec<(usize, Option<String>)> = level
            .nodes
            .par_iter()
            .enumerate()
            .map(|(k, node)| {
                let own: Vec<[DVec3; 3]> = patch(clod, node).collect();
                if own.len() == 1 {
                    return (0, None);
                }
                let corners = own.as_flattened();
                let low = corners.iter().copied().fold(DVec3::INFINITY, DVec3::min);
                let high = corners.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
                let planes: Vec<(DVec3, DVec3)> =
                    own.iter().map(|[a, b, c]| ((b - a).cross(c - a).normalize_or_zero(), *a)).collect();
                let (mut checked, mut worst) = (0, (tolerance, DVec3::ZERO));
                let target = Target::new(corners);
                let mut polytope = None;
                let from = points.partition_point(|p| p.x < low.x);
                for p in points[from..].iter().take_while(|p| p.x <= high.x) {
                    if p.cmplt(low).any() || p.cmpgt(high).any() {
                        continue;
                    }
                    checked += 1;
                    // The depth in the hull is at most the depth below any plane that bounds it.
                    if planes.iter().any(|(n, a)| n.dot(*p - *a) >= -tolerance) || !target.within(*p, 0.0) {
                        continue;
                    }
                    let polytope = polytope.get_or_insert_with(Polytope::new);
                    let depth = target.depth(*p, polytope);
                    if depth > worst.0 {
                        worst = (depth, *p);
                    }
                }
                let fault = (worst.0 > tolerance)
                    .then(|| format!("{} is {:e} deep in the hull of patch {k}", worst.1, worst.0));
                (checked, fault)
            })
            .collect();
        let checked = found.iter().map(|f| f.0).sum();
        (checked, found.into_iter().filter_map(|f| f.1).collect())
    }

    /// Checks s: no point of a patch is further than s from the mesh, and no point of the mesh region that it
    /// represents is further than s from the level.
    fn check_deviation(&self, index: usize, level: &Level<'_>, finest: &Level<'_>, findings: &mut Findings) {
        let clod = level.clod;
        let slack = ROUNDING * clod.bounding_radius();
        let first = clod.levels[index].nodes.start;
        let measured: Vec<(f64, f64, usize)> = level
            .samples
            .par_iter()
            .enumerate()
            .map(|(k, own)| {
                let there = farthest(own, &finest.tree);
                let leaves = leaves_below(clod, first + k as u32);
                let below: Vec<DVec3> =
                    leaves.into_iter().flat_map(|leaf| finest.samples[leaf].iter().copied()).collect();
                (there, farthest(&below, &level.tree), own.len() + below.len())
            })
            .collect();
        let faults = measured
            .iter()
            .zip(level.nodes)
            .enumerate()
            .filter(|(_, ((there, back, _), node))| there.max(*back) > node.deviation + slack)
            .map(|(k, ((there, back, _), node))| {
                format!(
                    "patch {k} is {there:e} from the mesh, which is {back:e} from the level, where s is {:e}",
                    node.deviation
                )
            })
            .collect();
        let checked = measured.iter().map(|m| m.2).sum();
        findings.take(&format!("level {index}"), "surface deviation", checked, faults);
        let radius = clod.bounding_radius();
        let most = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, f64::max) / radius;
        findings.levels.push(format!(
            "level {index}: {} triangles, {} patches, r {:.2}, s {:.5} (measured {:.5} there, {:.5} back), h {:.5}",
            level.mesh.triangles().len(),
            level.nodes.len(),
            clod.levels[index].resolution * radius,
            most(&mut level.nodes.iter().map(|n| n.deviation)),
            most(&mut measured.iter().map(|m| m.0)),
            most(&mut measured.iter().map(|m| m.1)),
            most(&mut level.nodes.iter().map(|n| n.hausdorff)),
        ));
    }

    /// Checks h: no extreme point of a descendant's hull is further than h from the node's bounding hull. By
    /// convexity no other point is either.
    fn check_hausdorff(&self, clod: &Parts, findings: &mut Findings) {
        let slack = HULL_ROUNDING * clod.bounding_radius();
        for level in 1..clod.levels.len() {
            let found: Vec<(usize, Option<String>)> = clod
                .level(level)
                .par_iter()
                .enumerate()
                .map(|(k, node)| {
                    let target = Target::new(clod.bounding_hull(node));
                    let mut checked = 0;
                    let mut below: Vec<u32> = node.children.clone().collect();
                    while let Some(index) = below.pop() {
                        let descendant = &clod.nodes[index as usize];
                        below.extend(descendant.children.clone());
                        let points = clod.extreme(descendant);
                        checked += points.len();
                        if let Some(p) = points.iter().find(|p| !target.within(**p, node.hausdorff + slack)) {
                            let (far, h) = (target.distance(*p), node.hausdorff);
                            let fault =
                                format!("node {k} is {far:e} from {p} of node {index}, where h is {h:e}");
                            return (checked, Some(fault));
                        }
                    }
                    (checked, None)
                })
                .collect();
            let checked = found.iter().map(|f| f.0).sum();
            let faults = found.into_iter().filter_map(|f| f.1).collect();
            findings.take(&format!("level {level}"), "Hausdorff distance", checked, faults);
        }
    }
}

/// Checks that points added to a hull, to bound its descendants better, are points of the descendants: the
/// hull is no larger than necessary.
fn check_added(clod: &Parts, findings: &mut Findings) {
    let bits = |p: &DVec3| p.to_array().map(f64::to_bits);
    for level in 1..clod.levels.len() {
        let faults = each(clod.level(level), |k, node| {
            let added = &clod.bounding_hull(node)[..node.added as usize];
            if added.is_empty() {
                return None;
            }
            let below: HashSet<[u64; 3]> =
                descendants(clod, node).flat_map(|n| clod.extreme(n)).map(bits).collect();
            let foreign = added.iter().find(|p| !below.contains(&bits(p)))?;
            Some(format!("node {k} is given {foreign}, which is not of its descendants"))
        });
        findings.take(&format!("level {level}"), "added points", clod.level(level).len(), faults);
    }
}

/// Checks that the sphere of a node encloses its bounding hull and all its descendants' hulls.
fn check_spheres(clod: &Parts, findings: &mut Findings) {
    let slack = ROUNDING * clod.bounding_radius();
    for level in 0..clod.levels.len() {
        let faults = each(clod.level(level), |k, node| {
            let below = descendants(clod, node).flat_map(|n| clod.extreme(n));
            let mut points = clod.bounding_hull(node).iter().chain(below);
            let outside = points.find(|p| p.distance(node.center) > node.radius + slack)?;
            let off = outside.distance(node.center);
            Some(format!(
                "node {k} has {outside} {off:e} off its centre, where the radius is {:e}",
                node.radius
            ))
        });
        findings.take(&format!("level {level}"), "spheres", clod.level(level).len(), faults);
    }
}

/// Returns all nodes below a node.
fn descendants<'a>(clod: &'a Parts, node: &Node) -> impl Iterator<Item = &'a Node> + use<'a> {
    let mut waiting: Vec<u32> = node.children.clone().collect();
    std::iter::from_fn(move || {
        let next = &clod.nodes[waiting.pop()? as usize];
        waiting.extend(next.children.clone());
        Some(next)
    })
}

fn each(nodes: &[Node], check: impl Fn(usize, &Node) -> Option<String> + Sync) -> Vec<String> {
    nodes.par_iter().enumerate().filter_map(|(k, node)| check(k, node)).collect()
}

fn farthest(points: &[DVec3], from: &TriangleTree) -> f64 {
    points.iter().map(|p| from.distance(*p)).fold(0.0, f64::max)
}

/// Returns the leaves below a node, by their index among the leaves; for a leaf, itself.
fn leaves_below(clod: &Parts, index: u32) -> Vec<usize> {
    let (mut leaves, mut stack) = (Vec::new(), vec![index]);
    while let Some(index) = stack.pop() {
        let node = &clod.nodes[index as usize];
        stack.extend(node.children.clone());
        if node.children.is_empty() {
            leaves.push((index - clod.levels[0].nodes.start) as usize);
        }
    }
    leaves
}

/// Hull that points are compared with.
struct Target<'a> {
    points: &'a [DVec3],
    map: Option<SupportMap>,
    size: f64,
}

impl<'a> Target<'a> {
    fn new(points: &'a [DVec3]) -> Self {
        let map = (points.len() >= SupportMap::MIN_POINTS).then(|| SupportMap::new(points));
        let size = points.iter().map(|p| p.distance(points[0])).fold(0.0, f64::max);
        Self { points, map, size }
    }

    fn ask(&self, p: DVec3, enough: f64) -> gjk::Distance {
        let hull = Hull::with_map(self.points, self.map.as_ref());
        let precision = 1e-13 * (self.size + p.distance(self.points[0]));
        let limits = Limits { beyond: f64::INFINITY, share: 0.0, enough, precision };
        let point = [DVec3::ZERO];
        // The point is the origin of the other hull's frame.
        let placement = Placement::between(&Pose::IDENTITY, &Pose { translation: p, ..Pose::IDENTITY });
        let start = Start::Axis(self.points[0] - p);
        gjk::distance(&hull, &Hull::new(&point), &placement, start, &limits)
    }

    /// Returns whether a point is no further from the hull than `reach`, m.
    fn within(&self, p: DVec3, reach: f64) -> bool {
        if self.points.contains(&p) {
            return true;
        }
        let found = self.ask(p, reach);
        found.separation == Separation::Overlapping || found.distance <= reach
    }

    /// Returns an upper bound on the distance of a point from the hull, m: the distance itself where the
    /// search converges.
    fn distance(&self, p: DVec3) -> f64 {
        self.ask(p, -1.0).distance
    }

    /// Returns the depth of a point inside the hull, m.
    fn depth(&self, p: DVec3, polytope: &mut Polytope) -> f64 {
        let hull = Hull::with_map(self.points, self.map.as_ref());
        let point = [DVec3::ZERO];
        let placement = Placement::between(&Pose::IDENTITY, &Pose { translation: p, ..Pose::IDENTITY });
        polytope.penetration(&hull, &Hull::new(&point), &placement, &[], 1e-12 * self.size).depth
    }
}
