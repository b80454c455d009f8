//! The triangles around an edge, and their change when it collapses (§3.3.4, step 1).

use crate::box_tree::Bounds;

/// A triangle that remains around the merged vertex.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Spoke {
    pub triangle: u32,
    /// Its other two corners, in order.
    pub rim: [u32; 2],
}

/// Largest number of triangles at the ends of an edge that is collapsed: the work around the merged vertex
/// grows with the square of their number, and a vertex of so many triangles is no sample of a surface.
/// Collapses around it reduce the number first.
const MAX_TRIANGLES: usize = 64;

/// The triangles that the collapse of an edge changes.
#[derive(Clone, Debug, Default)]
pub(crate) struct Star {
    /// The vertices of the edge; the first stands for the merged vertex.
    pub ends: [u32; 2],
    /// The triangles at the edge, which are removed.
    pub removed: Vec<u32>,
    /// The triangles that remain.
    pub fan: Vec<Spoke>,
    /// Whether the merged vertex is on the border.
    pub border: bool,
}

/// The triangles around each vertex of a mesh that is 2-manifold, with or without a border.
#[derive(Clone, Debug)]
pub(crate) struct Fans {
    around: Vec<Vec<u32>>,
    /// Whether the mesh has no border: then it never gets one.
    closed: bool,
}

impl Fans {
    /// The fans of triangles; those that name a vertex twice are left out.
    pub fn new(vertices: usize, triangles: &[[u32; 3]]) -> Self {
        let mut around = vec![Vec::new(); vertices];
        for (t, [a, b, c]) in triangles.iter().enumerate() {
            if a != b && b != c && c != a {
                for v in [a, b, c] {
                    around[*v as usize].push(t as u32);
                }
            }
        }
        let mut fans = Self { around, closed: true };
        fans.closed = !(0..vertices as u32).any(|v| fans.on_border(triangles, v));
        fans
    }

    /// The triangles at a vertex.
    pub fn at(&self, vertex: u32) -> &[u32] {
        &self.around[vertex as usize]
    }

    /// The corner opposite to the side that runs from `from` to `to`, and its triangle.
    pub fn across(&self, triangles: &[[u32; 3]], from: u32, to: u32) -> Option<(u32, u32)> {
        self.at(from).iter().find_map(|t| {
            let corners = triangles[*t as usize];
            let k = corners.iter().position(|v| *v == from)?;
            (corners[(k + 1) % 3] == to).then_some((corners[(k + 2) % 3], *t))
        })
    }

    /// Collects the vertices next to one, in ascending order.
    pub fn neighbours(&self, triangles: &[[u32; 3]], vertex: u32, out: &mut Vec<u32>) {
        out.clear();
        let corners = self.at(vertex).iter().flat_map(|t| triangles[*t as usize]);
        out.extend(corners.filter(|v| *v != vertex));
        out.sort_unstable();
        out.dedup();
    }

    /// Whether a vertex is on the border: some side at it has one triangle only.
    fn on_border(&self, triangles: &[[u32; 3]], vertex: u32) -> bool {
        self.at(vertex).iter().any(|t| {
            let corners = triangles[*t as usize];
            let k = corners.iter().position(|v| *v == vertex).unwrap_or(0);
            self.across(triangles, corners[(k + 1) % 3], vertex).is_none()
        })
    }

    /// Collects the triangles that the collapse of an edge changes. False if there is no such edge, it has
    /// too many triangles at its ends, or the collapse would change the topology: the link condition (Dey et
    /// al. 1999), in which the border counts as joined to one more vertex.
    pub fn star(&self, triangles: &[[u32; 3]], ends: [u32; 2], star: &mut Star) -> bool {
        star.ends = ends;
        star.removed.clear();
        star.fan.clear();
        if self.at(ends[0]).len() + self.at(ends[1]).len() > MAX_TRIANGLES {
            return false;
        }
        for (end, other) in [(ends[0], ends[1]), (ends[1], ends[0])] {
            for &t in self.at(end) {
                let corners = triangles[t as usize];
                if corners.contains(&other) {
                    if end == ends[0] {
                        star.removed.push(t);
                    }
                    continue;
                }
                let k = corners.iter().position(|v| *v == end).unwrap_or(0);
                star.fan.push(Spoke { triangle: t, rim: [corners[(k + 1) % 3], corners[(k + 2) % 3]] });
            }
        }
        let borders = ends.map(|v| !self.closed && self.on_border(triangles, v));
        star.border = borders[0] || borders[1];
        // An edge has two triangles, or one on the border; one that joins two border vertices must be on it.
        let sides = star.removed.len();
        if sides == 0 || sides == 1 && borders != [true; 2] || sides == 2 && borders == [true; 2] || sides > 2
        {
            return false;
        }
        // In the fan around the merged vertex each vertex of the rim may follow once and precede once, and no
        // two triangles may be back to back; it is closed unless on the border, where it has one end.
        let fan = &star.fan;
        let unique = |k: usize| (0..fan.len()).all(|i| (0..i).all(|j| fan[i].rim[k] != fan[j].rim[k]));
        let back_to_back =
            (0..fan.len()).any(|i| (0..i).any(|j| fan[i].rim == [fan[j].rim[1], fan[j].rim[0]]));
        let ends_at = fan.iter().filter(|s| fan.iter().all(|o| o.rim[0] != s.rim[1])).count();
        let least = if star.border { 1 } else { 3 };
        fan.len() >= least
            && unique(0)
            && unique(1)
            && !back_to_back
            && ends_at == usize::from(star.border)
            && self.common_neighbours(triangles, star) == sides
    }

    /// Number of vertices next to both ends.
    fn common_neighbours(&self, triangles: &[[u32; 3]], star: &Star) -> usize {
        if self.closed {
            // Around a vertex of a closed surface each neighbour follows it in one triangle.
            let after = |v: u32| {
                self.at(v).iter().map(move |t| {
                    let corners = triangles[*t as usize];
                    let k = corners.iter().position(|c| *c == v).unwrap_or(0);
                    corners[(k + 1) % 3]
                })
            };
            let [p, q] = star.ends;
            return after(p).filter(|v| after(q).any(|w| w == *v)).count();
        }
        let [mut first, mut second] = [Vec::new(), Vec::new()];
        self.neighbours(triangles, star.ends[0], &mut first);
        self.neighbours(triangles, star.ends[1], &mut second);
        first.iter().filter(|v| second.binary_search(v).is_ok()).count()
    }

    /// Records a collapse that has been made in the triangles.
    pub fn collapse(&mut self, star: &Star, rim: &[u32]) {
        for v in rim {
            self.around[*v as usize].retain(|t| !star.removed.contains(t));
        }
        self.around[star.ends[1] as usize] = Vec::new();
        let mut fan: Vec<u32> = star.fan.iter().map(|s| s.triangle).collect();
        fan.sort_unstable();
        self.around[star.ends[0] as usize] = fan;
    }
}

impl Star {
    /// The vertices around the merged one, in ascending order.
    pub fn rim(&self) -> Vec<u32> {
        let mut rim: Vec<u32> = self.fan.iter().flat_map(|s| s.rim).collect();
        rim.sort_unstable();
        rim.dedup();
        rim
    }

    /// The box around the fan.
    pub fn bounds(&self, bounds: impl Fn(u32) -> Bounds) -> Bounds {
        self.fan
            .iter()
            .map(|s| bounds(s.triangle))
            .fold(crate::box_tree::EMPTY, |a, b| (a.0.min(b.0), a.1.max(b.1)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn allowed(triangles: &[[u32; 3]], ends: [u32; 2]) -> bool {
        let count = triangles.iter().flatten().max().map_or(0, |v| *v as usize + 1);
        Fans::new(count, triangles).star(triangles, ends, &mut Star::default())
    }

    #[test]
    fn closed_surfaces() {
        let tetrahedron = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        assert!(!allowed(&tetrahedron, [0, 1]), "would leave two triangles back to back");
        let octahedron =
            [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1], [5, 2, 1], [5, 3, 2], [5, 4, 3], [5, 1, 4]];
        for ends in [[0, 1], [1, 0], [1, 2], [5, 3]] {
            assert!(allowed(&octahedron, ends), "{ends:?}");
        }
        assert!(!allowed(&octahedron, [0, 5]) && !allowed(&octahedron, [1, 3]), "no edges");
        // Around a triangular tube: the ring 0, 1, 2 is no triangle, and would be pinched shut.
        let ring = |a: u32, b: u32| {
            (0..3).flat_map(move |k| {
                let l = (k + 1) % 3;
                [[a + k, a + l, b + k], [b + k, a + l, b + l]]
            })
        };
        let mut tube: Vec<[u32; 3]> = [ring(3, 0), ring(0, 6)].into_iter().flatten().collect();
        tube.extend([[3, 5, 4], [6, 7, 8]]);
        assert!(!allowed(&tube, [0, 1]));
        assert!(allowed(&tube, [0, 6]));
    }

    #[test]
    fn surfaces_with_a_border() {
        // A fan of six triangles around vertex 6.
        let fan: Vec<[u32; 3]> = (0..6).map(|k| [6, k, (k + 1) % 6]).collect();
        assert!(allowed(&fan, [6, 0]) && allowed(&fan, [0, 6]), "an edge from the border inwards");
        assert!(allowed(&fan, [0, 1]), "an edge of the border");
        assert!(!allowed(&[[0, 1, 2]], [0, 1]), "the last triangle");
        let strip = [[0, 1, 2], [1, 3, 2], [2, 3, 4]];
        assert!(!allowed(&strip, [1, 2]), "an edge across, between two vertices of the border");
        assert!(allowed(&strip, [0, 1]), "the outer side of an ear");
    }
}
