//! Bounds on clearance against exact distances.

use glam::{DQuat, DVec3};
use palpate_core::{Pose, TriMesh};
use palpate_models::Model;
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};

use super::*;
use crate::body::FieldOptions;
use crate::exact::ExactDistance;

fn random(rng: &mut StdRng) -> DVec3 {
    DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..1.0)))
}

struct Shape {
    mesh: TriMesh,
    exact: ExactDistance,
    body: FieldBody,
    radius: f64,
}

impl Shape {
    fn new(model: Model, triangles: usize) -> Self {
        let mesh = model.generate(triangles).expect("in range");
        let radius = mesh.bounding_sphere().radius;
        let options = FieldOptions { memory: 4_000_000, ..FieldOptions::new(0.02 * radius) };
        let body = FieldBody::new(&mesh, &options);
        Self { exact: ExactDistance::new(&mesh), body, mesh, radius }
    }

    /// Points of the surface: vertices, and points of edges and faces.
    fn points(&self) -> impl Iterator<Item = DVec3> {
        let inner = (0..self.mesh.triangles().len()).flat_map(|t| {
            let [a, b, c] = self.mesh.corners(t);
            [
                (a + b + c) / 3.0,
                a.lerp(b, 0.5),
                b.lerp(c, 0.5),
                c.lerp(a, 0.5),
                a.lerp(b, 0.25),
                b.lerp(c, 0.25),
            ]
        });
        self.mesh.vertices().iter().copied().chain(inner)
    }

    /// Signed distance of the surface's points from another shape at a relative pose: a little more than that
    /// of the surfaces, m.
    fn apart(&self, other: &Self, to_other: &Pose) -> f64 {
        let mut hint = 0;
        let distance = |p: DVec3| {
            let found = other.exact.nearest(to_other.transform_point(p), hint);
            hint = found.hint;
            found.distance
        };
        self.points().map(distance).fold(f64::INFINITY, f64::min)
    }
}

/// Pairs of shapes at poses from apart to overlapping, with the least distance of points of both.
fn pairs(mut check: impl FnMut(&Shape, &Shape, &Pose, f64)) {
    let mut rng = StdRng::seed_from_u64(0xC1EA);
    let shapes = [(Model::Gear, 2000), (Model::Torus, 1000)].map(|(m, n)| Shape::new(m, n));
    for first in &shapes {
        for second in &shapes {
            for _ in 0..30 {
                let turn = DQuat::from_scaled_axis(random(&mut rng) * 2.0);
                let away = random(&mut rng).normalize() * (first.radius + second.radius);
                let pose = Pose::new(away * rng.random_range(0.3..1.2), turn);
                let least = first.apart(second, &pose).min(second.apart(first, &pose.inverse()));
                check(first, second, &pose, least);
            }
        }
    }
}

#[test]
fn clearance_is_below_the_distance() {
    let (mut apart, mut touching, mut near, mut over) = (0, 0, 0, 0);
    pairs(|first, second, pose, least| {
        let enough = 0.05 * first.radius;
        let clearance = first.body.clearance(&second.body, pose, (0.0, enough));
        assert!(clearance <= least.max(0.0) * (1.0 + 1e-4), "{clearance} m, but {least} m apart");
        // Negative control: the distance of the body's centre is no bound.
        let center = pose.transform_point(first.mesh.bounding_sphere().center);
        over += u32::from(second.exact.nearest(center, 0).distance > least.max(0.0));
        if least <= 0.0 {
            assert_eq!(clearance, 0.0, "{least} m apart");
            touching += 1;
        }
        // Where bodies are apart by as much as is asked for, the bound is known to be useful. Beyond the band
        // fields are bounds themselves.
        if least > 3.0 * enough {
            apart += 1;
            assert!(clearance > 0.0, "{least} m apart");
            near += u32::from(clearance >= enough);
        }
    });
    assert!(apart > 20 && touching > 20, "{apart} apart, {touching} touching");
    assert!(over > 20, "{over} distances of centres are larger");
    assert!(near * 10 >= apart * 8, "{near} of {apart} bounds are enough");
}

/// Numbers tell the samples of a body apart, whatever their level.
#[test]
fn samples_have_numbers_of_their_own() {
    let shape = Shape::new(Model::Torus, 1000);
    let samples = &shape.body.samples;
    let mut known = vec![false; shape.body.samples()];
    let mut last = None;
    for level in 0..samples.levels.len() as u8 {
        for index in 0..4 * samples.fours(level.into()) as u32 {
            let number = samples.number(Sample { level, index });
            assert!(!std::mem::replace(&mut known[number], true), "level {level}, {index}: {number} again");
            last = Some(number);
        }
    }
    assert!(known.iter().all(|known| *known) && last == Some(known.len() - 1));
}

#[test]
fn parts_within_make_up_the_surface_there() {
    let (mut kept, mut left_out, mut refused) = (0, 0, 0);
    pairs(|first, second, pose, _| {
        let (least, largest) = (0.1 * first.radius, 0.5 * first.radius);
        let mut parts = Vec::new();
        let limits = (0.2 * first.radius, 100_000);
        let all = first.body.parts_within(&second.body, pose, (least, largest), limits, |part| {
            parts.push(*part);
        });
        assert!(all && parts.iter().all(|part| part.radius < 0.25 * first.radius));
        let mut hint = 0;
        for point in first.points().step_by(7) {
            let found = second.exact.nearest(pose.transform_point(point), hint);
            hint = found.hint;
            let is_kept = parts.iter().any(|part| part.center.distance(point) <= part.radius * (1.0 + 1e-6));
            if found.distance >= least && found.distance <= largest {
                assert!(is_kept, "{point} at {} m is in no part", found.distance);
                kept += 1;
            } else {
                left_out += u32::from(!is_kept);
            }
        }
        let few = (limits.0, parts.len().saturating_sub(1));
        let fits = first.body.parts_within(&second.body, pose, (least, largest), few, |_| ());
        refused += u32::from(!fits);
    });
    assert!(kept > 1000 && left_out > 1000 && refused > 50, "{kept}, {left_out}, {refused}");
}
