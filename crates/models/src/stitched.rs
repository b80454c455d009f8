//! Meshes stitched together from structured patches: rings of vertices joined by bands, caps and tubes.
//!
//! A closed surface whose patches share their border vertices is closed by construction, its number of
//! triangles is known before it is built (see [`fit`]), and its triangles are as regular as its
//! parametrisation.
//!
//! Orientation: a band lies to the left of the ring it starts from, seen from outside. Around the z axis, a
//! ring that runs counter-clockwise seen from above and a second ring above it give a band that faces away
//! from the axis.

use palpate_core::{TriMesh, glam::DVec3};

/// A mesh under construction. Coordinates are in whatever unit the model is written in.
#[derive(Default)]
pub(crate) struct Stitched {
    vertices: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
}

impl Stitched {
    /// Adds a vertex.
    pub(crate) fn vertex(&mut self, position: DVec3) -> u32 {
        self.vertices.push(position);
        self.vertices.len() as u32 - 1
    }

    /// Position of a vertex.
    pub(crate) fn position(&self, vertex: u32) -> DVec3 {
        self.vertices[vertex as usize]
    }

    /// Adds a ring of `count` vertices; `place` gets the turn of each, from 0 up to below 1.
    pub(crate) fn ring(&mut self, count: usize, place: impl Fn(f64) -> DVec3) -> Vec<u32> {
        (0..count).map(|index| self.vertex(place(index as f64 / count as f64))).collect()
    }

    /// Adds a triangle, counter-clockwise seen from outside.
    pub(crate) fn triangle(&mut self, corners: [u32; 3]) {
        self.triangles.push(corners);
    }

    /// Adds a quadrilateral, counter-clockwise seen from outside, as two triangles: across the diagonal that
    /// leaves the larger smallest angle.
    pub(crate) fn quad(&mut self, [a, b, c, d]: [u32; 4]) {
        let [p, q, r, s] = [a, b, c, d].map(|vertex| self.position(vertex));
        let across_first = least_angle_cosine(p, q, r).max(least_angle_cosine(p, r, s));
        let across_second = least_angle_cosine(q, r, s).max(least_angle_cosine(q, s, p));
        // Rounding must not decide between equals, or mirrored parts would come out different at random.
        if across_first <= across_second + 1e-9 {
            self.triangle([a, b, c]);
            self.triangle([a, c, d]);
        } else {
            self.triangle([b, c, d]);
            self.triangle([b, d, a]);
        }
    }

    /// Joins two closed rings with equally many vertices: `2 n` triangles.
    pub(crate) fn band(&mut self, from: &[u32], to: &[u32]) {
        debug_assert_eq!(from.len(), to.len(), "a band joins rings of equal length");
        for index in 0..from.len() {
            let next = (index + 1) % from.len();
            self.quad([from[index], from[next], to[next], to[index]]);
        }
    }

    /// Continues a ring by further rings of as many vertices, `rows` bands in all, and gives the last.
    /// `place` gets the row (1 to `rows`) and the index in the ring.
    pub(crate) fn tube(
        &mut self,
        from: &[u32],
        rows: usize,
        place: impl Fn(usize, usize) -> DVec3,
    ) -> Vec<u32> {
        let mut last = from.to_vec();
        for row in 1..=rows {
            let next: Vec<u32> = (0..from.len()).map(|index| self.vertex(place(row, index))).collect();
            self.band(&last, &next);
            last = next;
        }
        last
    }

    /// Joins two closed rings that may differ in their number of vertices, each given with the turns of its
    /// vertices (increasing, over one full turn): as many triangles as vertices in both.
    ///
    /// Each edge is joined to the vertex of the other ring nearest in turn to its middle. For rings in
    /// parallel planes on a sphere this is their convex hull.
    pub(crate) fn gather(&mut self, from: (&[u32], &[f64]), to: (&[u32], &[f64])) {
        let middle = |turns: &[f64], index: usize| {
            let wrapped = |index: usize| turns[index % turns.len()] + (index / turns.len()) as f64;
            0.5 * (wrapped(index) + wrapped(index + 1))
        };
        let (count_from, count_to) = (from.0.len(), to.0.len());
        // Start from the vertex of `to` nearest to the middle of the first edge of `from`.
        let start = middle(from.1, 0);
        let distance = |turn: f64| (turn - start - (turn - start).round()).abs();
        let nearest =
            (0..count_to).min_by(|a, b| distance(to.1[*a]).total_cmp(&distance(to.1[*b]))).unwrap_or(0);
        let shift = (start - to.1[nearest]).round();
        let (mut index_from, mut index_to) = (0, nearest);
        while index_from < count_from || index_to < nearest + count_to {
            let from_first = index_to >= nearest + count_to
                || index_from < count_from && middle(from.1, index_from) <= middle(to.1, index_to) + shift;
            let (a, c) = (from.0[index_from % count_from], to.0[index_to % count_to]);
            if from_first {
                index_from += 1;
                self.triangle([a, from.0[index_from % count_from], c]);
            } else {
                index_to += 1;
                self.triangle([a, to.0[index_to % count_to], c]);
            }
        }
    }

    /// Closes a ring by a disc to its left: rings of fewer and fewer vertices around a centre. `place` gets
    /// the radius (1 at the ring, 0 at the centre) and the turn.
    pub(crate) fn cap(&mut self, ring: &[u32], shape: &Cap, place: impl Fn(f64, f64) -> DVec3) {
        let mut outer = ring.to_vec();
        let mut outer_turns: Vec<f64> =
            (0..ring.len()).map(|index| index as f64 / ring.len() as f64).collect();
        for (index, &count) in shape.counts.iter().enumerate() {
            let radius = 1.0 - (index + 1) as f64 / (shape.counts.len() + 1) as f64;
            // Half a step off on every second ring: triangles, where rings are equally divided, rather than
            // right angles.
            let offset = if index % 2 == 0 { 0.5 } else { 0.0 };
            let turns: Vec<f64> = (0..count).map(|index| (index as f64 + offset) / count as f64).collect();
            let inner: Vec<u32> = turns.iter().map(|&turn| self.vertex(place(radius, turn))).collect();
            self.gather((&outer, &outer_turns), (&inner, &turns));
            (outer, outer_turns) = (inner, turns);
        }
        let center = self.vertex(place(0.0, 0.0));
        for index in 0..outer.len() {
            self.triangle([outer[index], outer[(index + 1) % outer.len()], center]);
        }
    }

    /// The finished mesh, its coordinates multiplied by `unit` (m).
    pub(crate) fn finish(self, unit: f64) -> TriMesh {
        let vertices = self.vertices.into_iter().map(|vertex| unit * vertex).collect();
        TriMesh::new(vertices, self.triangles).expect("patches refer to their own vertices")
    }
}

/// The ring in the opposite direction, from the same vertex.
pub(crate) fn reversed(ring: &[u32]) -> Vec<u32> {
    ring[..1].iter().chain(ring[1..].iter().rev()).copied().collect()
}

/// Division of a disc: the numbers of vertices of its inner rings, from the border to the centre.
pub(crate) struct Cap {
    border: usize,
    counts: Vec<usize>,
}

impl Cap {
    /// A disc inside a ring of `border` vertices with `steps` steps from the border to the centre.
    pub(crate) fn new(border: usize, steps: usize) -> Self {
        let steps = steps.max(1);
        let fewest = border.min(6);
        let count =
            |step: usize| ((border as f64 * (1.0 - step as f64 / steps as f64)).round() as usize).max(fewest);
        Self { border, counts: (1..steps).map(count).collect() }
    }

    /// Number of triangles.
    pub(crate) fn triangles(&self) -> usize {
        self.border + 2 * self.counts.iter().sum::<usize>()
    }
}

/// Cosine of the smallest angle of a triangle.
fn least_angle_cosine(a: DVec3, b: DVec3, c: DVec3) -> f64 {
    let cosine = |p: DVec3, q: DVec3| p.dot(q) / (p.length() * q.length()).max(f64::MIN_POSITIVE);
    cosine(b - a, c - a).max(cosine(c - b, a - b)).max(cosine(a - c, b - c))
}

/// Finds the plan of a model whose number of triangles is nearest to the one asked for.
///
/// `plan` makes a plan from an edge length and a stretch (about 1) of the edges in one direction over the
/// other; stretches are tried only as far as needed to meet the number within half a percent. `area` is about
/// the area of the surface, in the unit of the edge length squared.
pub(crate) fn fit<P>(
    triangles: usize,
    area: f64,
    plan: impl Fn(f64, f64) -> P,
    count: impl Fn(&P) -> usize,
) -> P {
    let off = |plan: &P| (count(plan) as f64 / triangles as f64).ln().abs();
    // The number of triangles falls as the edges grow; the first guess may be far off where a plan has fewest
    // cells.
    let guess = (2.0 * area / triangles as f64).sqrt();
    let (mut short, mut long) = (guess / 16.0, guess * 16.0);
    for _ in 0..40 {
        let middle = (short * long).sqrt();
        if count(&plan(middle, 1.0)) > triangles {
            short = middle;
        } else {
            long = middle;
        }
    }
    let edge = (short * long).sqrt();
    let mut best = plan(edge, 1.0);
    for step in 0..12 {
        for sign in [1.0, -1.0] {
            let stretch = (sign * 0.025 * f64::from(step)).exp();
            for shift in -60..=60 {
                let candidate = plan(edge * (f64::from(shift) * 0.005).exp(), stretch);
                if off(&candidate) < off(&best) {
                    best = candidate;
                }
            }
            if off(&best) < 0.005 {
                return best;
            }
        }
    }
    best
}

/// Number of cells of about `edge` along `length`, at least `fewest`.
pub(crate) fn cells(length: f64, edge: f64, fewest: usize) -> usize {
    ((length / edge).round() as usize).max(fewest)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// Rings of given (height, count, turn of the first vertex) on the unit sphere.
    fn on_sphere(mesh: &mut Stitched, height: f64, count: usize, offset: f64) -> (Vec<u32>, Vec<f64>) {
        let turns: Vec<f64> = (0..count).map(|index| offset + index as f64 / count as f64).collect();
        let radius = (1.0 - height * height).sqrt();
        let place = |turn: &f64| DVec3::new(radius * (TAU * turn).cos(), radius * (TAU * turn).sin(), height);
        let ring = turns.iter().map(|turn| mesh.vertex(place(turn))).collect();
        (ring, turns)
    }

    #[test]
    fn gathered_rings_are_their_convex_hull() {
        for (low, high, offset) in [(7, 11, 0.013), (12, 5, 0.4), (9, 9, 0.05), (3, 20, 0.771), (20, 3, -3.3)]
        {
            let mut mesh = Stitched::default();
            let (lower, lower_turns) = on_sphere(&mut mesh, -0.2, low, 0.0);
            let (upper, upper_turns) = on_sphere(&mut mesh, 0.3, high, offset);
            mesh.gather((&lower, &lower_turns), (&upper, &upper_turns));
            assert_eq!(mesh.triangles.len(), low + high);
            for corners in &mesh.triangles {
                let [a, b, c] = corners.map(|vertex| mesh.position(vertex));
                let normal = (b - a).cross(c - a);
                for vertex in &mesh.vertices {
                    assert!(
                        normal.dot(*vertex - a) < 1e-9,
                        "{low} and {high}: {corners:?} is no face of the hull"
                    );
                }
            }
        }
    }

    #[test]
    fn a_capped_tube_is_closed_and_has_the_triangles_foreseen() {
        for (around, rows, steps) in [(3, 1, 1), (17, 4, 3), (40, 2, 9)] {
            let mut mesh = Stitched::default();
            let point = |radius: f64, turn: f64, z: f64| {
                DVec3::new(radius * (TAU * turn).cos(), radius * (TAU * turn).sin(), z)
            };
            let bottom = mesh.ring(around, |turn| point(1.0, turn, 0.0));
            let top = mesh.tube(&bottom, rows, |row, index| {
                point(1.0, index as f64 / around as f64, row as f64 / rows as f64)
            });
            let cap = Cap::new(around, steps);
            mesh.cap(&top, &cap, |radius, turn| point(radius, turn, 1.0));
            mesh.cap(&reversed(&bottom), &cap, |radius, turn| point(radius, -turn, 0.0));
            let mesh = mesh.finish(1.0);
            assert_eq!(mesh.triangles().len(), 2 * around * rows + 2 * cap.triangles());
            let report = mesh.validate();
            assert!(
                report.closed && report.manifold && report.oriented && report.zero_area == 0,
                "{report:?}"
            );
            let area = 0.5 * around as f64 * (TAU / around as f64).sin();
            assert!((report.volume - area).abs() < 1e-12, "{} for a prism of {area}", report.volume);
        }
    }

    #[test]
    fn a_quadrilateral_is_cut_where_angles_stay_large() {
        // A kite much longer than wide, from either side of the list of corners.
        for turn in 0..2 {
            let mut mesh = Stitched::default();
            let mut corners = [(0.0, 0.0), (5.0, -1.0), (6.0, 0.0), (5.0, 1.0)]
                .map(|(x, y)| mesh.vertex(DVec3::new(x, y, 0.0)));
            corners.rotate_left(turn);
            mesh.quad(corners);
            let cut = mesh.triangles.iter().filter(|triangle| triangle.contains(&1) && triangle.contains(&3));
            assert_eq!(cut.count(), 2, "cut across the short diagonal");
        }
    }

    #[test]
    fn fitting_meets_the_number_of_triangles() {
        // A grid of 2 a b triangles on a rectangle of 3 by 1.
        for asked in [100, 999, 12_345, 1_000_000] {
            let plan =
                |edge: f64, stretch: f64| (cells(3.0, edge * stretch, 1), cells(1.0, edge / stretch, 1));
            let (a, b) = fit(asked, 3.0, plan, |(a, b)| 2 * a * b);
            let off = (2 * a * b) as f64 / asked as f64 - 1.0;
            assert!(off.abs() < 0.01, "{a} by {b} for {asked}");
        }
    }
}
