//! Directions of displacement of a coarse mesh.

use std::collections::HashMap;

use glam::DVec3;
use palpate_core::TriMesh;

/// Returns the unit directions of displacement at the corners of each triangle, mesh axes.
///
/// The direction at a vertex is the mean normal of the triangles there, weighted by their angles. Only
/// triangles whose normal is within the angle `crease` (rad) of the triangle's own count, so sharp edges stay
/// sharp. Within a triangle directions are interpolated linearly and *not* normalized: the displaced surface
/// is then a polynomial in the position on the triangle and the displacement, and surfaces of neighbours meet
/// where there is no crease. A triangle without area has zero directions.
pub fn corner_directions(mesh: &TriMesh, crease: f64) -> Vec<[DVec3; 3]> {
    let normals: Vec<DVec3> = (0..mesh.triangles().len())
        .map(|triangle| {
            let [a, b, c] = mesh.corners(triangle);
            (b - a).cross(c - a).normalize_or_zero()
        })
        .collect();
    let mut around: HashMap<u32, Vec<(usize, f64)>> = HashMap::new();
    for (triangle, vertices) in mesh.triangles().iter().enumerate() {
        let corners = mesh.corners(triangle);
        for (at, &vertex) in vertices.iter().enumerate() {
            let [here, next, last] = [0, 1, 2].map(|step| corners[(at + step) % 3]);
            let angle = (next - here).angle_between(last - here);
            around.entry(vertex).or_default().push((triangle, if angle.is_finite() { angle } else { 0.0 }));
        }
    }
    let min_cosine = crease.cos();
    let direction = |triangle: usize, vertex: u32| {
        let own = normals[triangle];
        let smooth = around[&vertex].iter().filter(|(other, _)| normals[*other].dot(own) >= min_cosine);
        let sum = smooth.fold(DVec3::ZERO, |sum, &(other, angle)| sum + normals[other] * angle);
        sum.try_normalize().unwrap_or(own)
    };
    mesh.triangles()
        .iter()
        .enumerate()
        .map(|(triangle, vertices)| vertices.map(|vertex| direction(triangle, vertex)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn roof_is_smooth_up_to_the_angle_of_its_ridge() {
        // Two unit squares' halves that meet at a ridge along y, each sloping by 0.3 rad.
        let (run, rise) = (0.3_f64.cos(), 0.3_f64.sin());
        let vertices = vec![
            DVec3::new(0.0, -1.0, 0.0),
            DVec3::new(0.0, 1.0, 0.0),
            DVec3::new(run, 0.0, -rise),
            DVec3::new(-run, 0.0, -rise),
        ];
        let roof = TriMesh::new(vertices, vec![[0, 2, 1], [0, 1, 3]]).unwrap();
        let smooth = corner_directions(&roof, 0.7);
        for at in [smooth[0][0], smooth[0][2], smooth[1][0], smooth[1][1]] {
            assert!(at.distance(DVec3::Z) < 1e-12, "{at}");
        }
        let sharp = corner_directions(&roof, 0.5);
        for (triangle, side) in [(0, 1.0), (1, -1.0)] {
            for at in sharp[triangle] {
                assert!(at.distance(DVec3::new(side * rise, 0.0, run)) < 1e-12, "{at}");
            }
        }
    }

    #[test]
    fn triangle_without_area_is_not_displaced() {
        let flat = TriMesh::new(vec![DVec3::ZERO, DVec3::X, DVec3::X * 2.0], vec![[0, 1, 2]]).unwrap();
        assert_eq!(corner_directions(&flat, 1.0), [[DVec3::ZERO; 3]]);
    }
}
