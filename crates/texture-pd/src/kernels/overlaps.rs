use bytemuck::{Pod, Zeroable};

use super::displaced::{HeightJet, Point, Textures};
use super::{FOLDED, Header, Image, NO_SURFACE, NOWHERE, Pair, Triangle, coordinate};
use crate::spline::Level;

/// Overlaps this many temperatures below the largest weigh nothing.
pub(crate) const LEAST: f32 = -8.0;
/// Weights fall off over this part of the grid, from its border inwards.
const BORDER: f32 = 0.1;

/// What is known of a pair. Sums are over texels, weighted; gradients and second derivatives are by how A moves: along u, v
/// and n, and about those axes through the frame's origin.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct Answer {
    /// The largest overlap h_A − h_B, m.
    pub(crate) depth: f32,
    /// Its texel, or [`NOWHERE`].
    pub(crate) texel: u32,
    /// How many texels have both surfaces, and in how many of them one is folded.
    pub(crate) shared: u32,
    pub(crate) folded: u32,
    /// Sum of the weights; of these sums nothing is known where the temperature is 0.
    pub(crate) weight: f32,
    /// Sum of the gradient's differences from that at the largest overlap, and of the products of those (the upper
    /// triangle, row by row).
    pub(crate) gradient: [f32; 6],
    pub(crate) spread: [f32; 21],
    /// Sum of the overlaps' second derivatives (likewise).
    pub(crate) curvature: [f32; 21],
    /// Height and derivatives of A and B at the largest overlap: by u, v, uu, uv, vv.
    pub(crate) jet_a: [f32; 6],
    pub(crate) jet_b: [f32; 6],
    /// Bit 0: the largest overlap is where A ends; bit 1: where B does.
    pub(crate) ends: u32,
    pub(crate) unused: [u32; 2],
}

impl Default for Answer {
    fn default() -> Self {
        Self { texel: NOWHERE, ..Zeroable::zeroed() }
    }
}

/// The images of a pair.
struct Images<'a> {
    header: &'a Header,
    triangles: &'a [Triangle],
    textures: Textures<'a>,
    /// Image and heights of A and of B.
    sides: [(&'a Image, &'a [[u32; 2]]); 2],
    known: Option<Known<'a>>,
    /// Where the texels of A and B begin among all.
    first: [usize; 2],
}

/// What a backend knows beside the heights, to spare work.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Known<'a> {
    /// Where in its triangle the point of each texel of each image is.
    pub points: &'a [[f32; 2]],
    /// The texels of the pair that need be looked at, all in its domain.
    pub texels: &'a [u32],
}

/// What is at a texel of both images.
struct Sample {
    u: f32,
    v: f32,
    a: HeightJet,
    b: HeightJet,
    ends: u32,
}

/// Twin of `overlaps` in `texture_depth.wgsl`: the directional penetration depth of pairs of images (Eq. 4.10), and what its
/// derivatives are made of.
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

/// The answer to one pair.
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
        let reference = deepest.gradient();
        for (texel, overlap, _) in self.overlaps() {
            let below = (overlap - answer.depth) / pair.temperature;
            if below >= LEAST {
                let weight = below.exp() * self.taper(pair, texel);
                if weight > 0.0 {
                    answer.add(weight, &self.sample(texel, false), &reference);
                }
            }
        }
        answer
    }

    /// The largest overlap, its texel (of equal ones the first), and counts.
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

    /// The texels that are looked at and have both surfaces, the overlap there (m), and whether one of them is folded.
    fn overlaps(&self) -> impl Iterator<Item = (u32, f32, u32)> {
        let [(_, of_a), (_, of_b)] = self.sides;
        let (all, some) = match self.known {
            None => (0..of_a.len() as u32, &[][..]),
            Some(known) => (0..0, known.texels),
        };
        all.chain(some.iter().copied()).filter_map(|texel| {
            let (a, b) = (of_a[texel as usize], of_b[texel as usize]);
            let folded = ((a[1] | b[1]) & FOLDED) >> 31;
            let both = a[0] != NO_SURFACE && b[0] != NO_SURFACE;
            both.then(|| (texel, f32::from_bits(a[0]) - f32::from_bits(b[0]), folded))
        })
    }

    /// How far inside the pair's domain a texel is, m: negative outside.
    #[inline]
    fn margin(&self, pair: &Pair, texel: u32) -> f32 {
        let grid = self.header.grid;
        let [u, v] = [texel % grid, texel / grid].map(|index| coordinate(index, grid, self.sides[0].0.step));
        pair.clips.margin(u, v)
    }

    /// How much a texel counts for where it is on the grid: 1, but less towards the border, and 0 there; likewise in the last
    /// step before the border of the pair's domain, and 0 outside.
    fn taper(&self, pair: &Pair, texel: u32) -> f32 {
        let grid = self.header.grid;
        let (column, row) = (texel % grid, texel / grid);
        let inwards = column.min(row).min(grid - 1 - column).min(grid - 1 - row);
        let part = ((inwards as f32 + 0.5) / (BORDER * grid as f32)).min(1.0);
        let within = (self.margin(pair, texel) / self.sides[0].0.step).clamp(0.0, 1.0);
        part * part * (3.0 - 2.0 * part) * within
    }

    /// What is at a texel; of the one side that its gradient does not ask for the height alone, unless all is wanted.
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

    /// Whether a surface ends, within the grid, next to a texel.
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
    /// Whether A slides over the point of B there, in place of a point of A over B: B ends there, and A does not.
    fn on_b(&self) -> bool {
        self.ends == 2
    }

    /// The overlap's gradient, as A moves along u, v, n and turns about them.
    fn gradient(&self) -> [f32; 6] {
        let (slope_u, slope_v) = if self.on_b() { (self.a.u, self.a.v) } else { (self.b.u, self.b.v) };
        let [x, y, z] = [self.u, self.v, self.a.height];
        let [gu, gv, gn] = [-slope_u, -slope_v, 1.0];
        [gu, gv, gn, y * gn - z * gv, z * gu - x * gn, x * gv - y * gu]
    }

    /// The overlap's second derivatives, of the point of A there over B: the upper triangle, row by row. Those of a point of
    /// B are left out.
    fn curvature(&self) -> [f32; 21] {
        if self.on_b() {
            return [0.0; 21];
        }
        let [x, y, z] = [self.u, self.v, self.a.height];
        let [gu, gv, gn] = [-self.b.u, -self.b.v, 1.0];
        let (a, b, c) = (-self.b.uu, -self.b.uv, -self.b.vv);
        // The point moves by w × r as A turns by w: columns of −H [r]×, for H = [a b 0; b c 0; 0 0 0].
        let by_turn = |p: f32, q: f32| [-q * z, p * z, q * x - p * y];
        let (row_u, row_v) = (by_turn(a, b), by_turn(b, c));
        // [r]×ᵀ H [r]×, whose rows are combinations of those.
        let turn = |i: usize, j: usize| {
            let of = |row: &[f32; 3]| row[j];
            [-z * of(&row_v), z * of(&row_u), x * of(&row_v) - y * of(&row_u)][i]
        };
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
