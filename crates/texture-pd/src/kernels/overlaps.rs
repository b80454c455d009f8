use bytemuck::{Pod, Zeroable};

use super::displaced::{HeightJet, Point, Textures};
use super::{FOLDED, Header, Image, NO_SURFACE, NOWHERE, Pair, Triangle, coordinate};
use crate::spline::Level;

/// Smallest exponent (h_A − h_B − δ) / τ of an overlap that counts in the smooth maximum. A texel that is
/// left out has less than e⁻⁸ of the largest weight; with a higher value δ jumps where texels come in.
pub(crate) const MIN_EXPONENT: f32 = -8.0;
/// Width of the border of the grid over which weights fall to 0, as a part of the grid's side. Without it δ
/// jumps where surfaces enter the grid.
const TAPER_WIDTH: f32 = 0.1;

/// Result of a pair of images. Sums are over texels, weighted. Gradients and second derivatives are by the
/// motion of A: translation along u, v and n, and rotation about those axes through the frame's origin.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Answer {
    /// Largest overlap h_A − h_B, m (Eq. 4.10).
    pub(crate) depth: f32,
    /// Texel of the largest overlap, or [`NOWHERE`].
    pub(crate) texel: u32,
    /// Number of texels with both surfaces, and of those with a folded surface.
    pub(crate) shared: u32,
    pub(crate) folded: u32,
    /// Sum of the weights. This sum and the following ones are 0 if the temperature is 0.
    pub(crate) weight: f32,
    /// Sum of the gradients' differences from the gradient at the largest overlap, and of the outer products
    /// of those differences (upper triangle, row by row).
    pub(crate) gradient: [f32; 6],
    pub(crate) spread: [f32; 21],
    /// Sum of the overlaps' second derivatives (upper triangle, row by row).
    pub(crate) curvature: [f32; 21],
    /// Height of A and B at the largest overlap, and its derivatives by u, v, uu, uv, vv.
    pub(crate) jet_a: [f32; 6],
    pub(crate) jet_b: [f32; 6],
    /// Bit 0: A ends next to the largest overlap. Bit 1: B ends there.
    pub(crate) ends: u32,
    pub(crate) unused: [u32; 2],
}

impl Default for Answer {
    fn default() -> Self {
        Self { texel: NOWHERE, ..Zeroable::zeroed() }
    }
}

/// Images of a pair, with all that they refer to.
struct Images<'a> {
    header: &'a Header,
    triangles: &'a [Triangle],
    textures: Textures<'a>,
    /// Image and heights of A and B.
    sides: [(&'a Image, &'a [[u32; 2]]); 2],
    known: Option<Known<'a>>,
    /// Index of the first texel of A and B among all images.
    first: [usize; 2],
}

/// Results that a backend has besides the heights, which save work.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Known<'a> {
    /// Point in its triangle, (s, t), of each texel of each image.
    pub points: &'a [[f32; 2]],
    /// Texels of the pair to compare, all in its domain.
    pub texels: &'a [u32],
}

/// Surfaces of both images at a texel.
struct Sample {
    u: f32,
    v: f32,
    a: HeightJet,
    b: HeightJet,
    ends: u32,
}

/// Twin of `overlaps` in `texture_depth.wgsl`: the directional penetration depth of pairs of images (Eq.
/// 4.10), and the sums from which its derivatives are computed.
#[expect(clippy::too_many_arguments, reason = "the bindings of the entry point")]
pub(crate) fn overlaps(
    header: &Header,
    triangles: &[Triangle],
    images: &[Image],
    levels: &[Level],
    coefficients: &[f32],
    heights: &[[u32; 2]],
    pairs: &[Pair],
    answers: &mut [Answer],
) {
    let textures = Textures { levels, coefficients };
    for (pair, answer) in pairs.iter().zip(answers) {
        *answer = pair_answer(header, triangles, images, textures, heights, None, pair);
    }
}

/// Returns the answer for one pair.
pub(crate) fn pair_answer(
    header: &Header,
    triangles: &[Triangle],
    images: &[Image],
    textures: Textures,
    heights: &[[u32; 2]],
    known: Option<Known>,
    pair: &Pair,
) -> Answer {
    let texels = (header.grid * header.grid) as usize;
    let first = [pair.a, pair.b].map(|image| image as usize * texels);
    let side = |image: u32, first: usize| (&images[image as usize], &heights[first..][..texels]);
    let sides = [side(pair.a, first[0]), side(pair.b, first[1])];
    Images { header, triangles, textures, sides, known, first }.compare(pair)
}

impl Images<'_> {
    /// Finds the largest overlap and, if τ > 0, sums up the smooth maximum.
    fn compare(&self, pair: &Pair) -> Answer {
        let mut answer = self.largest(pair);
        if answer.texel == NOWHERE {
            return answer;
        }
        let deepest = self.sample(answer.texel, true);
        let words = |jet: &HeightJet| [jet.height, jet.u, jet.v, jet.uu, jet.uv, jet.vv];
        (answer.jet_a, answer.jet_b, answer.ends) = (words(&deepest.a), words(&deepest.b), deepest.ends);
        if pair.temperature == 0.0 {
            return answer;
        }
        // Weights exp((h_A − h_B − δ) / τ), relative to the largest overlap δ so that they stay within (0,
        // 1]. Gradients g are summed up relative to the largest overlap's, since sums of g itself lose digits
        // in f32.
        let reference = deepest.gradient();
        for (texel, overlap, _) in self.overlaps() {
            let below = (overlap - answer.depth) / pair.temperature;
            if below >= MIN_EXPONENT {
                let weight = below.exp() * self.taper(pair, texel);
                if weight > 0.0 {
                    answer.add(weight, &self.sample(texel, false), &reference);
                }
            }
        }
        answer
    }

    /// Returns the largest overlap (Eq. 4.10), the first texel that has it, and the counts.
    fn largest(&self, pair: &Pair) -> Answer {
        let mut answer = Answer::default();
        for (texel, overlap, folded) in self.overlaps() {
            if self.margin(pair, texel) < 0.0 {
                continue;
            }
            answer.shared += 1;
            answer.folded += folded;
            if answer.texel == NOWHERE || overlap > answer.depth {
                (answer.depth, answer.texel) = (overlap, texel);
            }
        }
        answer
    }

    /// Iterates over the compared texels with both surfaces: the texel, the overlap (m), and 1 if a surface
    /// is folded.
    fn overlaps(&self) -> impl Iterator<Item = (u32, f32, u32)> {
        let [(_, heights_a), (_, heights_b)] = self.sides;
        let (all, some) = match self.known {
            None => (0..heights_a.len() as u32, &[][..]),
            Some(known) => (0..0, known.texels),
        };
        all.chain(some.iter().copied()).filter_map(|texel| {
            let (a, b) = (heights_a[texel as usize], heights_b[texel as usize]);
            let folded = ((a[1] | b[1]) & FOLDED) >> 31;
            let both = a[0] != NO_SURFACE && b[0] != NO_SURFACE;
            both.then(|| (texel, f32::from_bits(a[0]) - f32::from_bits(b[0]), folded))
        })
    }

    /// Returns the distance of a texel to the border of the pair's domain, m: negative outside.
    #[inline]
    fn margin(&self, pair: &Pair, texel: u32) -> f32 {
        let grid = self.header.grid;
        let [u, v] = [texel % grid, texel / grid].map(|index| coordinate(index, grid, self.sides[0].0.step));
        pair.clips.margin(u, v)
    }

    /// Returns the weight of a texel's position: 1, falling to 0 towards the border of the grid (smoothstep
    /// over [`TAPER_WIDTH`]) and over the last step before the border of the pair's domain.
    fn taper(&self, pair: &Pair, texel: u32) -> f32 {
        let grid = self.header.grid;
        let (column, row) = (texel % grid, texel / grid);
        let inwards = column.min(row).min(grid - 1 - column).min(grid - 1 - row);
        let part = ((inwards as f32 + 0.5) / (TAPER_WIDTH * grid as f32)).min(1.0);
        let within = (self.margin(pair, texel) / self.sides[0].0.step).clamp(0.0, 1.0);
        part * part * (3.0 - 2.0 * part) * within
    }

    /// Returns the surfaces at a texel. Unless `all` is set, the side that the gradient does not need has its
    /// height only.
    fn sample(&self, texel: u32, all: bool) -> Sample {
        let grid = self.header.grid;
        let step = self.sides[0].0.step;
        let (u, v) = (coordinate(texel % grid, grid, step), coordinate(texel / grid, grid, step));
        let ends = [0, 1].map(|side| u32::from(self.ends(texel, side)));
        let mut sample =
            Sample { u, v, a: HeightJet::default(), b: HeightJet::default(), ends: ends[0] | ends[1] << 1 };
        let [a, b] = [0, 1].map(|side| {
            if all || (side == 0) == sample.on_b() {
                return self.jet(texel, side, [u, v]);
            }
            let height = f32::from_bits(self.sides[side].1[texel as usize][0]);
            HeightJet { height, ..HeightJet::default() }
        });
        (sample.a, sample.b) = (a, b);
        sample
    }

    /// Returns the height and its derivatives of A (`side` 0) or B (1) at a texel.
    fn jet(&self, texel: u32, side: usize, [u, v]: [f32; 2]) -> HeightJet {
        let (image, heights) = self.sides[side];
        let [height, index] = heights[texel as usize];
        let height = f32::from_bits(height);
        let triangle = &self.triangles[(index & !FOLDED) as usize];
        let folded = index & FOLDED != 0;
        if let Some(known) = self.known {
            let [s, t] = known.points[self.first[side] + texel as usize];
            return triangle.jet(&Point { s, t, height, folded }, &self.textures);
        }
        let refinements = if folded { 0 } else { self.header.refinements };
        let point = triangle.above(u, v, (image.step, image.reach), refinements, &self.textures);
        let point = point.unwrap_or(Point { s: 0.0, t: 0.0, height, folded });
        triangle.jet(&Point { folded, ..point }, &self.textures)
    }

    /// Returns whether a surface ends next to a texel, within the grid.
    fn ends(&self, texel: u32, side: usize) -> bool {
        let grid = self.header.grid;
        let heights = self.sides[side].1;
        let (column, row) = (texel % grid, texel / grid);
        let none = |there: bool, at: u32| there && heights[at as usize][0] == NO_SURFACE;
        none(column > 0, texel.wrapping_sub(1))
            || none(column + 1 < grid, texel + 1)
            || none(row > 0, texel.wrapping_sub(grid))
            || none(row + 1 < grid, texel + grid)
    }
}

impl Sample {
    /// Returns whether A slides over a point of B, instead of a point of A over B: B ends there, and A does
    /// not.
    fn on_b(&self) -> bool {
        self.ends == 2
    }

    /// Returns the gradient of the overlap h_A − h_B by the motion of A along u, v, n and about them.
    ///
    /// A point r = (u, v, h_A) of A over B: g = (−∂h_B/∂u, −∂h_B/∂v, 1) by translation, and r × g by
    /// rotation.
    fn gradient(&self) -> [f32; 6] {
        let (slope_u, slope_v) = if self.on_b() { (self.a.u, self.a.v) } else { (self.b.u, self.b.v) };
        let [x, y, z] = [self.u, self.v, self.a.height];
        let [gu, gv, gn] = [-slope_u, -slope_v, 1.0];
        [gu, gv, gn, y * gn - z * gv, z * gu - x * gn, x * gv - y * gu]
    }

    /// Returns the overlap's second derivatives for a point of A over B: upper triangle, row by row. For a
    /// point of B they are neglected.
    ///
    /// With H = −∇²h_B and J = (1, −[r]×), by which A's motion moves r, they are Jᵀ H J. The second-order
    /// displacement ½ θ × (θ × r) of r by a turn θ adds ½ (r gᵀ + g rᵀ) − (g · r) 1 to the rotational block.
    fn curvature(&self) -> [f32; 21] {
        if self.on_b() {
            return [0.0; 21];
        }
        let [x, y, z] = [self.u, self.v, self.a.height];
        let [gu, gv, gn] = [-self.b.u, -self.b.v, 1.0];
        let (a, b, c) = (-self.b.uu, -self.b.uv, -self.b.vv);
        // A turn by θ moves the point by θ × r: rows of −H [r]×, with H = [a b 0; b c 0; 0 0 0].
        let by_turn = |p: f32, q: f32| [-q * z, p * z, q * x - p * y];
        let (row_u, row_v) = (by_turn(a, b), by_turn(b, c));
        // [r]×ᵀ H [r]×: its rows are combinations of those rows.
        let turn = |i: usize, j: usize| [-z * row_v[j], z * row_u[j], x * row_v[j] - y * row_u[j]][i];
        let along = gu * x + gv * y + gn * z;
        let (r, g) = ([x, y, z], [gu, gv, gn]);
        let full = |i: usize, j: usize| {
            turn(i, j) + 0.5 * (r[i] * g[j] + g[i] * r[j]) - if i == j { along } else { 0.0 }
        };
        [
            a,
            b,
            0.0,
            row_u[0],
            row_u[1],
            row_u[2], //
            c,
            0.0,
            row_v[0],
            row_v[1],
            row_v[2], //
            0.0,
            0.0,
            0.0,
            0.0, //
            full(0, 0),
            full(0, 1),
            full(0, 2), //
            full(1, 1),
            full(1, 2), //
            full(2, 2),
        ]
    }
}

impl Answer {
    /// Adds a texel to the sums: Σ w, Σ w (g − g₀), Σ w (g − g₀)(g − g₀)ᵀ and Σ w ∇²(h_A − h_B).
    fn add(&mut self, weight: f32, sample: &Sample, reference: &[f32; 6]) {
        let gradient = sample.gradient();
        let curvature = sample.curvature();
        self.weight += weight;
        let difference: [f32; 6] = std::array::from_fn(|i| gradient[i] - reference[i]);
        let mut at = 0;
        for i in 0..6 {
            self.gradient[i] += weight * difference[i];
            for j in i..6 {
                self.spread[at] += weight * difference[i] * difference[j];
                self.curvature[at] += weight * curvature[at];
                at += 1;
            }
        }
    }
}
