//! The proxy against planes: known answers, without a contact query.

use palpate_collide::PatchContact;
use palpate_core::glam::{DMat3, DVec3};
use palpate_core::{Contact, Pose};
use palpate_dynamics::Body;

use super::*;

const TOLERANCE: f64 = 1e-3;
const RADIUS: f64 = 0.01;

/// A ball against planes `normal · x ≥ offset`, each a scene object that contacts are found with within the
/// reach.
struct Planes {
    planes: Vec<(DVec3, f64)>,
    reach: f64,
    center: DVec3,
}

impl Planes {
    fn new(planes: &[(DVec3, f64)]) -> Self {
        Self { planes: planes.to_vec(), reach: 5.0 * TOLERANCE, center: DVec3::ZERO }
    }

    /// Depth of the ball in a plane, m.
    fn depth(&self, (normal, offset): (DVec3, f64)) -> f64 {
        offset + RADIUS - normal.dot(self.center)
    }
}

impl ContactFinder for Planes {
    const CONTACTS_JUMP: bool = false;

    fn reach(&self) -> f64 {
        self.reach
    }

    fn find(&mut self, mesh: &Pose, _: &mut QueryReport) -> bool {
        self.center = mesh.translation;
        true
    }

    fn contacts(&self) -> impl Iterator<Item = ProxyContact> {
        let near = self.planes.iter().enumerate().filter(|(_, plane)| self.depth(**plane) > -self.reach);
        near.map(|(object, &(normal, offset))| {
            let depth = self.depth((normal, offset));
            // A contact's normal points out of the ball.
            let point = self.center - normal * RADIUS;
            let contact = Contact { point, scene_point: point + normal * depth, normal: -normal, depth };
            let node = object as u32;
            let contact = PatchContact { contact, probe_node: node, scene_node: node, weight: 1.0 };
            ProxyContact::new(contact, object)
        })
    }

    fn depths(&self) -> impl Iterator<Item = (usize, f64)> {
        self.planes.iter().enumerate().map(|(object, plane)| (object, self.depth(*plane)))
    }
}

fn proxy(enabled: bool) -> Proxy {
    let body = Body::new(0.1, DMat3::from_diagonal(DVec3::splat(4e-6))).expect("a body");
    Proxy::new(body, DVec3::ZERO, RADIUS, TOLERANCE, Vec::new(), enabled)
}

fn at(x: f64, z: f64) -> Pose {
    Pose::from_translation(DVec3::new(x, 0.0, z))
}

/// Follows a goal through some contact steps.
fn follow(proxy: &mut Proxy, goal: &Pose, planes: &mut Planes, steps: usize) {
    for _ in 0..steps {
        proxy.follow(goal, planes);
    }
}

/// Pressed onto a floor, it stays on it, and slides along as the object does.
#[test]
fn the_proxy_stays_on_a_floor_and_slides_along() {
    let mut planes = Planes::new(&[(DVec3::Z, 0.0)]);
    let mut proxy = proxy(true);
    follow(&mut proxy, &at(0.0, RADIUS), &mut planes, 1);
    assert_eq!(proxy.pose(), &at(0.0, RADIUS));
    for step in 1..=50 {
        let goal = at(1e-3 * f64::from(step), RADIUS - 4e-4 * f64::from(step));
        follow(&mut proxy, &goal, &mut planes, 1);
        let depth = RADIUS - proxy.pose().translation.z;
        assert!((0.0..=0.25 * TOLERANCE + 1e-12).contains(&depth), "step {step}: {depth} m deep");
    }
    let found = proxy.pose().translation;
    assert!((found.x - 0.05).abs() < 1e-6, "{found}");
    assert!((proxy.lag() - found.distance(DVec3::new(0.05, 0.0, RADIUS - 0.02))).abs() < 1e-9);
}

/// A wall of no thickness that the object has passed in one step is not passed by the proxy.
#[test]
fn the_proxy_stays_before_a_wall_that_the_object_has_passed() {
    let wall = [(DVec3::NEG_X, 0.0)];
    for enabled in [true, false] {
        let mut planes = Planes::new(&wall);
        let mut proxy = proxy(enabled);
        follow(&mut proxy, &at(-2.0 * RADIUS, 0.0), &mut planes, 1);
        follow(&mut proxy, &at(5.0 * RADIUS, 0.0), &mut planes, 20);
        let x = proxy.pose().translation.x;
        // Without a proxy contacts are those at the object, behind the wall.
        assert_eq!(x <= -RADIUS + 0.25 * TOLERANCE + 1e-12, enabled, "{x} m");
    }
}

/// A plane that moves against the proxy pushes it along and is not passed.
#[test]
fn the_proxy_is_pushed_by_a_plane_that_moves() {
    let mut planes = Planes::new(&[(DVec3::Z, 0.0)]);
    let mut proxy = proxy(true);
    let goal = at(0.0, RADIUS);
    follow(&mut proxy, &goal, &mut planes, 1);
    for step in 1..=20 {
        let up = 0.5 * TOLERANCE;
        planes.planes[0].1 = up * f64::from(step);
        let height = |step: i32| Pose::from_translation(DVec3::Z * up * f64::from(step));
        proxy.object_has_moved(0, &height(step - 1), &height(step));
        follow(&mut proxy, &goal, &mut planes, 1);
        let depth = planes.planes[0].1 + RADIUS - proxy.pose().translation.z;
        assert!(depth <= 0.25 * TOLERANCE + 1e-12, "step {step}: {depth} m deep");
    }
}

/// Between two closing planes it restarts at the object, and its side is known again when they open.
#[test]
fn the_proxy_restarts_between_closing_planes() {
    let mut planes = Planes::new(&[(DVec3::Z, -RADIUS), (DVec3::NEG_Z, -RADIUS)]);
    let mut proxy = proxy(true);
    let goal = at(0.0, 0.0);
    follow(&mut proxy, &goal, &mut planes, 1);
    assert_eq!(proxy.side, Side::Kept);
    planes.planes.iter_mut().for_each(|plane| plane.1 += 2.0 * TOLERANCE);
    proxy.scene_has_changed();
    follow(&mut proxy, &goal, &mut planes, 1);
    assert_eq!((proxy.side, proxy.pose()), (Side::Unknown, &goal));
    planes.planes.iter_mut().for_each(|plane| plane.1 -= 2.0 * TOLERANCE);
    proxy.scene_has_changed();
    follow(&mut proxy, &goal, &mut planes, 1);
    assert_eq!(proxy.side, Side::Kept);
}

/// It sinks into the coarse mesh of a textured object by the recess, and no further.
#[test]
fn the_proxy_sinks_in_by_the_recess() {
    let mut planes = Planes::new(&[(DVec3::Z, 0.0)]);
    let mut proxy = proxy(true);
    let recess = 3.0 * TOLERANCE;
    proxy.set_recesses(vec![recess]);
    follow(&mut proxy, &at(0.0, RADIUS), &mut planes, 1);
    follow(&mut proxy, &at(0.0, 0.0), &mut planes, 20);
    let depth = RADIUS - proxy.pose().translation.z;
    assert!((recess..=recess + 0.25 * TOLERANCE + 1e-12).contains(&depth), "{depth} m deep");
}
