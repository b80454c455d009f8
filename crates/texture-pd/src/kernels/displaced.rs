//! A displaced triangle as a height function over the grid (Eq. 4.9).

use super::Triangle;
use crate::ceiling::{Ceiling, Ceilings, RADIUS};
use crate::spline::{self, Level};

/// Points this far outside a triangle, as a part of it, still count, so that no texel falls between neighbours.
const EDGE: f32 = 1e-5;
/// Displaced by no more than this part of a step along the grid, a point needs no search.
const STILL: f32 = 1e-3;
/// From a point that misses its texel by no more than this part of a step the last of Newton's steps is taken, with what it
/// changes the height by to first order.
const MISS: f32 = 0.05;
/// A point that is displaced to a texel may be this far outside of the triangle, in texels of the texture: further away the
/// triangle's plane says nothing of the surface, and an atlas holds other charts.
const BEYOND: f32 = 2.0;
/// The surface is folded where displacing shrinks the triangle's area as seen along n below this part of it.
const FOLD: f32 = 0.1;

/// A point of a displaced triangle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Point {
    pub s: f32,
    pub t: f32,
    pub height: f32,
    pub folded: bool,
}

/// Height with its derivatives by u and v.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct HeightJet {
    pub height: f32,
    pub u: f32,
    pub v: f32,
    pub uu: f32,
    pub uv: f32,
    pub vv: f32,
}

/// The textures' levels and their coefficients.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Textures<'a> {
    pub levels: &'a [Level],
    pub coefficients: &'a [f32],
}

/// How much further out a displaced triangle is than the flat one at most, at the same texel, m.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lift<'a> {
    /// Anywhere.
    most: f32,
    /// The ceiling of the displacement, and what tilted directions add to it: none where the displaced point may be far from
    /// the flat one.
    local: Option<(Ceiling<'a>, f32)>,
}

impl Triangle {
    #[inline]
    fn texel(&self, s: f32, t: f32) -> (f32, f32) {
        let [uv0, d1, d2] = &self.texture;
        let along = |i: usize| uv0[i] + s * d1[i] + t * d2[i];
        (along(0), along(1))
    }

    /// Of the flat triangle, along u (0) or v (1).
    #[inline]
    fn place(&self, s: f32, t: f32, axis: usize) -> f32 {
        let [p0, e1, e2] = &self.plane;
        p0[axis] + s * e1[axis] + t * e2[axis]
    }

    #[inline]
    fn base(&self, s: f32, t: f32) -> f32 {
        let [p0, e1, e2] = self.rise;
        p0 + s * e1 + t * e2
    }

    /// Its edges along an axis.
    #[inline]
    fn edges(&self, axis: usize) -> [f32; 2] {
        let [_, e1, e2] = if axis < 2 { self.plane.map(|edge| edge[axis]) } else { self.rise };
        [e1, e2]
    }

    #[inline]
    fn direction(&self, s: f32, t: f32, axis: usize) -> f32 {
        let [n0, m1, m2] = &self.directions;
        n0[axis] + s * m1[axis] + t * m2[axis]
    }

    /// Where (u, v), m, is on the flat triangle, and its height there, if it is within `reach`.
    #[inline(always)]
    pub(crate) fn flat(&self, u: f32, v: f32, reach: f32) -> Option<(f32, f32, f32)> {
        let [p0, e1, e2] = self.plane;
        let (du, dv) = (u - p0[0], v - p0[1]);
        let s = (du * e2[1] - dv * e2[0]) * self.inverse_area;
        let t = (e1[0] * dv - e1[1] * du) * self.inverse_area;
        let base = self.base(s, t);
        let outside = s < -EDGE || t < -EDGE || s + t > 1.0 + EDGE || base.abs() > reach;
        (!outside).then_some((s, t, base))
    }

    /// From where to where along u the line at v crosses the triangle, m: everywhere where rounding leaves that open, and from
    /// beyond to before where it does not cross.
    pub(crate) fn crossing(&self, v: f32) -> [f32; 2] {
        let [p0, e1, e2] = self.plane;
        let dv = v - p0[1];
        // s = s₀ + su (u − u₀) and so on: each of s, t and 1 − s − t is not negative on one side.
        let (s0, su) = (-dv * e2[0] * self.inverse_area, e2[1] * self.inverse_area);
        let (t0, tu) = (e1[0] * dv * self.inverse_area, -e1[1] * self.inverse_area);
        let (mut from, mut to) = (f32::NEG_INFINITY, f32::INFINITY);
        for (start, slope) in [(s0, su), (t0, tu), (1.0 - s0 - t0, -su - tu)] {
            let root = p0[0] - (start + EDGE) / slope;
            if slope > 0.0 && root.is_finite() {
                from = from.max(root);
            } else if slope < 0.0 && root.is_finite() {
                to = to.min(root);
            }
        }
        [from, to]
    }

    /// How much further out the displaced triangle is than the flat one.
    pub(crate) fn lift<'a>(&self, textures: &Textures, ceilings: &'a Ceilings) -> Lift<'a> {
        let [n0, m1, m2] = self.directions;
        let corners = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]
            .map(|[s, t]| [0, 1, 2].map(|axis| n0[axis] + s * m1[axis] + t * m2[axis]));
        let most = |of: &dyn Fn(&[f32; 3]) -> f32| corners.iter().map(of).fold(0.0, f32::max);
        let tilt = most(&|n| n[0].hypot(n[1]));
        let upright = most(&|n| n[2].abs());
        let [_, e1, e2] = self.plane;
        // How steep over the grid something is that changes so along both edges.
        let slope = |[along_1, along_2]: [f32; 2]| {
            let u = (along_1 * e2[1] - along_2 * e1[1]) * self.inverse_area;
            let v = (along_2 * e1[0] - along_1 * e2[0]) * self.inverse_area;
            u.hypot(v)
        };
        let [_, r1, r2] = self.rise;
        let [_, m1, m2] = self.directions;
        let [_, d1, d2] = self.texture;
        // The displaced point is so far from the flat one at most, along the grid.
        let away = self.most * tilt;
        let risen = away * slope([r1, r2]);
        // Where not all directions point outwards, displacements inwards may reach out as well.
        let outwards = corners.iter().all(|n| n[2] * self.inverse_area >= 0.0);
        let most = if outwards { self.outwards } else { self.most } * upright + risen;
        let texels = [0, 1].map(|axis| away * slope([d1[axis], d2[axis]]));
        let near = texels.iter().all(|texels| *texels <= RADIUS as f32);
        let sideways = risen + self.most * away * slope([m1[2], m2[2]]);
        let level = (outwards && near).then(|| (self.level as usize).checked_sub(1)).flatten();
        Lift { most, local: level.map(|level| (ceilings.of(level, &textures.levels[level]), sideways)) }
    }

    /// How much further out the displaced triangle is than the flat one above a point of that, m.
    #[inline]
    pub(crate) fn lift_at(&self, lift: &Lift, s: f32, t: f32) -> f32 {
        let Some((ceiling, sideways)) = lift.local else { return lift.most };
        let (x, y) = self.texel(s, t);
        (ceiling.around(x, y) * self.direction(s, t, 2).abs() + sideways).min(lift.most)
    }

    /// The point above (u, v), m, unless the triangle is not there or its flat surface is further than `reach` away along n.
    ///
    /// The displaced surface above (u, v) is that of another point of the triangle, where its direction is not n: it is
    /// found by at most `refinements` of Newton's steps. Where they do not find it, as the surface is folded, or find it
    /// outside of the triangle, it is approximated by the point's own displacement, as in the dissertation.
    #[inline]
    pub(crate) fn above(
        &self,
        u: f32,
        v: f32,
        (step, reach): (f32, f32),
        refinements: u32,
        textures: &Textures,
    ) -> Option<Point> {
        let (mut s, mut t, base) = self.flat(u, v, reach)?;
        if self.level == 0.0 {
            return Some(Point { s, t, height: base, folded: false });
        }
        let level = &textures.levels[self.level as usize - 1];
        let upright = |s: f32, t: f32| {
            let (x, y) = self.texel(s, t);
            let displacement = spline::value(level, textures.coefficients, x, y);
            self.base(s, t) + displacement * self.direction(s, t, 2)
        };
        let (tilt_u, tilt_v) = (self.most * self.direction(s, t, 0), self.most * self.direction(s, t, 1));
        let still = STILL * step;
        if tilt_u * tilt_u + tilt_v * tilt_v <= still * still || refinements == 0 {
            return Some(Point { s, t, height: upright(s, t), folded: false });
        }
        let [_, e1, e2] = &self.plane;
        let [_, m1, m2] = &self.directions;
        let [_, d1, d2] = &self.texture;
        let start = (s, t);
        for _ in 0..=refinements {
            let (x, y) = self.texel(s, t);
            let [h, hx, hy] = spline::slope(level, textures.coefficients, x, y);
            let hs = hx * d1[0] + hy * d1[1];
            let ht = hx * d2[0] + hy * d2[1];
            let [nu, nv] = [0, 1].map(|axis| self.direction(s, t, axis));
            let miss_u = self.place(s, t, 0) + h * nu - u;
            let miss_v = self.place(s, t, 1) + h * nv - v;
            let us = e1[0] + hs * nu + h * m1[0];
            let vs = e1[1] + hs * nv + h * m1[1];
            let ut = e2[0] + ht * nu + h * m2[0];
            let vt = e2[1] + ht * nv + h * m2[1];
            let area = us * vt - ut * vs;
            if area * self.inverse_area < FOLD {
                break;
            }
            let ds = (miss_v * ut - miss_u * vt) / area;
            let dt = (vs * miss_u - us * miss_v) / area;
            (s, t) = (s + ds, t + dt);
            if miss_u.abs() + miss_v.abs() <= MISS * step {
                if self.is_beyond(s, t) {
                    break;
                }
                let height = self.base(s, t) + (h + hs * ds + ht * dt) * self.direction(s, t, 2);
                return Some(Point { s, t, height, folded: false });
            }
        }
        let (s, t) = start;
        Some(Point { s, t, height: upright(s, t), folded: true })
    }

    /// Whether a point is outside of the triangle and too far.
    #[inline]
    fn is_beyond(&self, s: f32, t: f32) -> bool {
        let outside = (-s).max(-t).max(s + t - 1.0).max(0.0);
        let [_, d1, d2] = &self.texture;
        let square = (d1[0] * d1[0] + d1[1] * d1[1]).max(d2[0] * d2[0] + d2[1] * d2[1]);
        outside * outside * square > BEYOND * BEYOND
    }

    /// The height function at a point of the displaced triangle, with its derivatives.
    ///
    /// A folded surface gets those of the approximate height function (Eq. 4.9), which displaces along n alone: its area along
    /// the grid may be 0, and what is divided by it without bounds.
    pub(super) fn jet(&self, &Point { s, t, height, folded }: &Point, textures: &Textures) -> HeightJet {
        let texture = match self.level as usize {
            0 => spline::Jet::default(),
            level => {
                let (x, y) = self.texel(s, t);
                spline::jet(&textures.levels[level - 1], textures.coefficients, x, y)
            }
        };
        let [_, [ax, ay], [bx, by]] = self.texture;
        let h = texture.value;
        let (hs, ht) = (texture.x * ax + texture.y * ay, texture.x * bx + texture.y * by);
        let second = |px: f32, py: f32, qx: f32, qy: f32| {
            texture.xx * px * qx + texture.xy * (px * qy + py * qx) + texture.yy * py * qy
        };
        let (hss, hst, htt) = (second(ax, ay, ax, ay), second(ax, ay, bx, by), second(bx, by, bx, by));
        // Derivatives of the displaced point along each axis: by s, t, ss, st, tt.
        let along = |axis: usize| {
            let n = self.direction(s, t, axis);
            let [_, m1, m2] = self.directions.map(|direction| direction[axis]);
            let [e1, e2] = self.edges(axis);
            [
                e1 + hs * n + h * m1,
                e2 + ht * n + h * m2,
                hss * n + 2.0 * hs * m1,
                hst * n + hs * m2 + ht * m1,
                htt * n + 2.0 * ht * m2,
            ]
        };
        let flat = |axis: usize| {
            let [e1, e2] = self.edges(axis);
            [e1, e2, 0.0, 0.0, 0.0]
        };
        let area = |u: &[f32; 5], v: &[f32; 5]| u[0] * v[1] - u[1] * v[0];
        let (mut by_u, mut by_v) = (along(0), along(1));
        let shrunk = area(&by_u, &by_v) * self.inverse_area;
        if folded || shrunk < FOLD || shrunk.is_nan() {
            (by_u, by_v) = (flat(0), flat(1));
        }
        let area = area(&by_u, &by_v);
        let ([us, ut, uss, ust, utt], [vs, vt, vss, vst, vtt]) = (by_u, by_v);
        let [ws, wt, wss, wst, wtt] = along(2);
        let u = (ws * vt - wt * vs) / area;
        let v = (us * wt - ut * ws) / area;
        let (kss, kst, ktt) = (wss - u * uss - v * vss, wst - u * ust - v * vst, wtt - u * utt - v * vtt);
        // Of s and t by u and v.
        let (su, sv, tu, tv) = (vt / area, -ut / area, -vs / area, us / area);
        HeightJet {
            height,
            u,
            v,
            uu: kss * su * su + 2.0 * kst * su * tu + ktt * tu * tu,
            uv: kss * su * sv + kst * (su * tv + sv * tu) + ktt * tu * tv,
            vv: kss * sv * sv + 2.0 * kst * sv * tv + ktt * tv * tv,
        }
    }
}
