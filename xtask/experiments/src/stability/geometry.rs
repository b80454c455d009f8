//! Exact contacts of simple shapes.

use palpate::Contact;
use palpate::collide::{Clustering, PatchContact};
use palpate::dynamics::BodyState;
use palpate::glam::DVec3;

/// Radius of the held ball, m.
pub const BALL: f64 = 0.010;
/// Radii of the fixed ball and of the groove, m.
const BUMP: f64 = 0.020;
const GROOVE: f64 = 0.012;
/// Half extents of the flat block, m.
pub const BLOCK: DVec3 = DVec3::new(0.05, 0.05, 0.01);

/// Pairs of shapes. The held body just touches with its centre of mass at the origin, when it comes down
/// along z.
#[derive(Clone, Debug)]
pub enum Geometry {
    /// Ball on a plane.
    Plane,
    /// Ball on a fixed ball.
    Bump,
    /// Ball in a groove along y.
    Groove,
    /// Points of a body, relative to its centre of mass, on a plane through the lowest of them.
    Points(Vec<DVec3>),
    /// Points likewise, with their contacts reduced to a few clusters.
    Clustered { points: Vec<DVec3>, clustering: Clustering, found: Vec<PatchContact> },
    /// No contact.
    Free,
}

impl Geometry {
    /// Returns `count` points spread over the underside of the flat block, clustered to `clusters`.
    pub fn underside(count: usize, clusters: usize) -> Self {
        Self::Clustered {
            points: spread(count),
            clustering: Clustering::new(clusters),
            found: Vec::with_capacity(count),
        }
    }

    /// Finds contacts within `tolerance` (m) at a state of the body.
    pub fn contacts(&mut self, state: &BodyState, tolerance: f64, out: &mut Vec<Contact>) {
        out.clear();
        let center = state.pose.translation;
        match self {
            Self::Free => {}
            Self::Plane => out.push(against(center, DVec3::NEG_Z, BALL, -BALL)),
            Self::Bump => {
                let towards = DVec3::NEG_Z * (BALL + BUMP) - center;
                let distance = towards.length();
                let normal = if distance > 0.0 { towards / distance } else { DVec3::NEG_Z };
                out.push(contact(center + normal * BALL, normal, BALL + BUMP - distance));
            }
            Self::Groove => {
                let axis = DVec3::Z * (GROOVE - BALL);
                let outwards = (center - axis) * DVec3::new(1.0, 0.0, 1.0);
                let distance = outwards.length();
                let normal = if distance > 0.0 { outwards / distance } else { DVec3::NEG_Z };
                out.push(contact(center + normal * BALL, normal, distance + BALL - GROOVE));
            }
            Self::Points(points) => out.extend(on_floor(points, state)),
            Self::Clustered { points, clustering, found } => {
                found.clear();
                let touching = on_floor(points, state).filter(|contact| contact.depth > -tolerance);
                found.extend((0..).zip(touching).map(|(node, contact)| PatchContact {
                    contact,
                    probe_node: node,
                    scene_node: 0,
                    weight: 1.0,
                }));
                out.extend(
                    clustering.run(found, tolerance, &state.pose).iter().map(|cluster| cluster.contact),
                );
                return;
            }
        }
        out.retain(|contact| contact.depth > -tolerance);
    }
}

fn contact(point: DVec3, normal: DVec3, depth: f64) -> Contact {
    Contact { point, scene_point: point - normal * depth, normal, depth }
}

/// Returns the contact of a ball with the half space beyond `height` along z.
fn against(center: DVec3, normal: DVec3, radius: f64, height: f64) -> Contact {
    let point = center + normal * radius;
    contact(point, normal, height - point.z)
}

/// Returns contacts of a body's points with the floor that the lowest of them touches when the body is at the
/// origin.
fn on_floor<'a>(points: &'a [DVec3], state: &'a BodyState) -> impl Iterator<Item = Contact> + 'a {
    let floor = points.iter().fold(f64::INFINITY, |low, point| low.min(point.z));
    points.iter().map(move |point| {
        let point = state.pose.transform_point(*point);
        contact(point, DVec3::NEG_Z, floor - point.z)
    })
}

/// Spreads `count` points over the underside of the block: one in the middle, more on a spiral that fills the
/// square evenly.
fn spread(count: usize) -> Vec<DVec3> {
    const GOLDEN: f64 = 2.399_963_229_728_653;
    let size = count.saturating_sub(1).max(1) as f64;
    (0..count)
        .map(|index| {
            let (radius, angle) = ((index as f64 / size).sqrt(), index as f64 * GOLDEN);
            DVec3::new(radius * angle.cos() * BLOCK.x, radius * angle.sin() * BLOCK.y, -BLOCK.z)
        })
        .collect()
}
