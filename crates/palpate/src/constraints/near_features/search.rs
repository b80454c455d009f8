//! What a query reads of a region.

use palpate_core::Pose;
use palpate_core::glam::DVec3;
use palpate_field::{FeatureMesh, FeatureNode, FeatureTree, Place};

use super::feature::Reaches;
use super::region::{Region, Sphere, Within, ends_of_part};

/// Radius of spheres that one start stands for, as fractions of their distance and of the cells' edge.
/// With more, minima of the distance are missed; with less, there are more starts.
const SHARE: (f64, f64) = (0.4, 0.5);

/// Motion after which the distance of a start is read again, as a fraction of that distance. With more,
/// starts are chosen by older distances; with less, more distances are read.
const STALE: f64 = 0.3;

/// The same beyond that, as fractions of the reach, and of the reach or the smallest cells' edge, which is
/// less: a little of a long reach is much of a cell.
const LATE: (f64, f64) = (0.05, 0.25);

/// Rounding of distances in single precision, as a fraction of them.
const ROUNDING: f64 = 1e-6;

/// The distance of a region's centre from the other surface.
#[derive(Clone, Copy, Debug)]
pub struct Reading {
    /// m.
    pub distance: f32,
    pub hint: u32,
    /// Motion at which it was read, m; NaN before.
    pub at: f64,
}

/// The feature of a region nearest to the other surface.
#[derive(Clone, Copy, Debug)]
pub struct Nearest {
    pub place: Place,
    /// m.
    pub point: DVec3,
    pub is_tip: bool,
    pub reading: Reading,
}

/// One body's surface, and the other's.
pub struct Side<'a> {
    pub own: &'a FeatureMesh,
    pub other: &'a FeatureMesh,
    pub to_other: Pose,
    pub to_own: Pose,
}

/// A query.
pub struct Search<'a> {
    /// The scene object's side, and the probe's.
    pub sides: [Side<'a>; 2],
    pub reaches: Reaches,
    /// Sum of the motions so far, m.
    pub moved: f64,
    /// Number of readings that are left.
    pub left: usize,
}

impl Reading {
    /// No reading yet.
    pub fn from(hint: u32) -> Self {
        Self { distance: 0.0, hint, at: f64::NAN }
    }

    /// Distance, and how much the true one may differ from it, after motions of so much (m).
    pub fn known(&self, moved: f64) -> (f64, f64) {
        let gone = moved - self.at;
        let distance = f64::from(self.distance);
        (distance, if gone.is_nan() { f64::INFINITY } else { gone + ROUNDING * distance.abs() })
    }
}

impl Search<'_> {
    pub fn side(&self, is_probe: bool) -> &Side<'_> {
        &self.sides[usize::from(is_probe)]
    }

    pub fn tree(&self, region: Region) -> &FeatureTree {
        self.side(region.is_probe).own.tree()
    }

    pub fn sphere(&self, region: Region) -> Sphere {
        region.sphere(self.side(region.is_probe).own, self.reaches.long)
    }

    /// Reads the distance of a point of one body (in its frame, m) from the other surface. Behind an open
    /// surface it counts as positive: there is no inside. Returns the nearest point of that surface, too, in
    /// the same frame.
    pub fn read(&mut self, is_probe: bool, p: DVec3, hint: u32) -> (Reading, DVec3) {
        self.left = self.left.saturating_sub(1);
        let Side { other, to_other, to_own, .. } = self.side(is_probe);
        let near = other.nearest_from(to_other.transform_point(p), hint);
        let distance = if other.is_closed() { near.distance } else { near.distance.abs() };
        let reading = Reading { distance: distance as f32, hint: near.hint, at: self.moved };
        (reading, to_own.transform_point(near.point))
    }

    pub fn is_stale(&self, reading: &Reading) -> bool {
        let Reaches { reach, edge, .. } = self.reaches;
        let late = (LATE.0 * reach).max(LATE.1 * reach.min(edge));
        self.moved - reading.at > STALE * f64::from(reading.distance).abs() + late
    }

    /// Whether one start may stand for a region at least so far away (m).
    pub fn is_one(&self, region: Region, sphere: &Sphere, least: f64) -> bool {
        let Sphere { radius, has_tip, is_single, .. } = *sphere;
        let is_inner = |node: u32| !self.tree(region).edges[node as usize].children.is_empty();
        match region.within {
            Within::Edges(node) if is_inner(node) => false,
            _ => is_single || !has_tip && self.is_small(radius, least),
        }
    }

    pub fn is_small(&self, radius: f64, least: f64) -> bool {
        radius <= (SHARE.0 * least).max(SHARE.1 * self.reaches.cell)
    }

    /// The feature of a region nearest to a point (own frame, m), with a reading there. That of the region's
    /// centre is known.
    pub fn nearest(&mut self, region: Region, sphere: &Sphere, (reading, to): (&Reading, DVec3)) -> Nearest {
        let own = self.side(region.is_probe).own;
        let tree = own.tree();
        let on_edge = |node: u32, share: f64| {
            let place = own.place_at(tree.edges[node as usize].feature, share);
            Nearest { place, point: sphere.center, is_tip: false, reading: *reading }
        };
        let mut node = match region.within {
            Within::Vertices(node) => node,
            Within::Edges(node) => return on_edge(node, 0.5),
            Within::Part(node, part) => {
                let [first, last] = ends_of_part(part);
                return on_edge(node, 0.5 * (first + last));
            }
        };
        let nodes = &tree.vertices;
        let apart = |node: &u32| {
            let FeatureNode { center, radius, .. } = nodes[*node as usize];
            center.distance(to) - radius
        };
        let below =
            |node: u32| nodes[node as usize].children.clone().min_by(|a, b| apart(a).total_cmp(&apart(b)));
        while let Some(nearer) = below(node) {
            node = nearer;
        }
        let FeatureNode { center: point, has_tip: is_tip, feature, .. } = nodes[node as usize];
        let reading = match sphere.is_single {
            true => *reading,
            false => self.read(region.is_probe, point, reading.hint).0,
        };
        Nearest { place: Place::Vertex(feature), point, is_tip, reading }
    }
}
