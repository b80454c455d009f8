//! A displaced triangle as a height function over the grid (Eq. 4.9).
//!
//! The displaced point is p(s, t) = b(s, t) + h(uv(s, t)) d(s, t): b is the point of the flat triangle, d the
//! interpolated direction of displacement, and h the displacement in the texture. The height at (u, v) is the
//! n-component of p where its u and v components are (u, v).

use super::Triangle;
use crate::ceiling::{Ceiling, Ceilings, RADIUS};
use crate::spline::{self, Level};

/// Barycentric tolerance of a triangle's edges: points this far outside still count. Smaller values let
/// texels fall between neighbouring triangles.
const EDGE_TOLERANCE: f32 = 1e-5;
/// Largest displacement along the grid that is neglected, in steps of the grid. Larger values misplace the
/// height; smaller ones cost Newton steps.
const NEGLIGIBLE_SHIFT: f32 = 1e-3;
/// Distance from the texel at which Newton's method takes its last step, in steps of the grid. That step
/// changes the height to first order only, so larger values cost accuracy.
const NEWTON_TOLERANCE: f32 = 0.05;
/// Largest distance outside of the triangle of the point found, in texels of the texture. Farther away the
/// triangle's plane does not describe the surface, and an atlas holds other charts.
const MAX_OUTSIDE_TEXELS: f32 = 2.0;
/// Ratio of the displaced to the flat area, as seen along n, below which the surface counts as folded. At
/// smaller values slopes and curvatures, which are divided by the area, grow without bound.
const MIN_AREA_RATIO: f32 = 0.1;

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

/// Levels of all textures, and their coefficients.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Textures<'a> {
    pub levels: &'a [Level],
    pub coefficients: &'a [f32],
}

/// Upper bound of the height of a displaced triangle above the flat one at the same texel, m.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lift<'a> {
    /// Bound for the whole triangle, m.
    bound: f32,
    /// Local bound of the displacement, and the height (m) that tilted directions add to it. `None` if the
    /// displaced point may be far from the flat one.
    local: Option<(Ceiling<'a>, f32)>,
}

impl Triangle {
    /// Returns the texture coordinates at a point of the triangle, in texels.
    #[inline]
    fn texel(&self, s: f32, t: f32) -> (f32, f32) {
        let [uv0, d1, d2] = &self.texture;
        let along = |i: usize| uv0[i] + s * d1[i] + t * d2[i];
        (along(0), along(1))
    }

    /// Returns the coordinate of a point of the flat triangle along u (0) or v (1), m.
    #[inline]
    fn place(&self, s: f32, t: f32, axis: usize) -> f32 {
        let [p0, e1, e2] = &self.plane;
        p0[axis] + s * e1[axis] + t * e2[axis]
    }

    /// Returns the height of a point of the flat triangle, m.
    #[inline]
    fn base(&self, s: f32, t: f32) -> f32 {
        let [p0, e1, e2] = self.rise;
        p0 + s * e1 + t * e2
    }

    /// Returns the components of e₁ and e₂ along an axis, m.
    #[inline]
    fn edges(&self, axis: usize) -> [f32; 2] {
        let [_, e1, e2] = if axis < 2 { self.plane.map(|edge| edge[axis]) } else { self.rise };
        [e1, e2]
    }

    /// Returns the component of the displacement direction along an axis.
    #[inline]
    fn direction(&self, s: f32, t: f32, axis: usize) -> f32 {
        let [n0, m1, m2] = &self.directions;
        n0[axis] + s * m1[axis] + t * m2[axis]
    }

    /// Returns s, t and the height (m) of the flat triangle at (u, v), m, if it is there and within `reach`.
    #[inline(always)]
    pub(crate) fn flat(&self, u: f32, v: f32, reach: f32) -> Option<(f32, f32, f32)> {
        let [p0, e1, e2] = self.plane;
        // Cramer's rule for s e₁ + t e₂ = (u, v) − p₀.
        let (du, dv) = (u - p0[0], v - p0[1]);
        let s = (du * e2[1] - dv * e2[0]) * self.inverse_area;
        let t = (e1[0] * dv - e1[1] * du) * self.inverse_area;
        let base = self.base(s, t);
        let outside =
            s < -EDGE_TOLERANCE || t < -EDGE_TOLERANCE || s + t > 1.0 + EDGE_TOLERANCE || base.abs() > reach;
        (!outside).then_some((s, t, base))
    }

    /// Returns the range of u, m, in which the line at v crosses the triangle. It is unbounded where rounding
    /// leaves it open, and reversed where the line misses the triangle.
    pub(crate) fn crossing(&self, v: f32) -> [f32; 2] {
        let [p0, e1, e2] = self.plane;
        let dv = v - p0[1];
        // s = s₀ + su (u − u₀) and so on: each of s, t and 1 − s − t is not negative on one side.
        let (s0, su) = (-dv * e2[0] * self.inverse_area, e2[1] * self.inverse_area);
        let (t0, tu) = (e1[0] * dv * self.inverse_area, -e1[1] * self.inverse_area);
        let (mut from, mut to) = (f32::NEG_INFINITY, f32::INFINITY);
        for (start, slope) in [(s0, su), (t0, tu), (1.0 - s0 - t0, -su - tu)] {
            let root = p0[0] - (start + EDGE_TOLERANCE) / slope;
            if slope > 0.0 && root.is_finite() {
                from = from.max(root);
            } else if slope < 0.0 && root.is_finite() {
                to = to.min(root);
            }
        }
        [from, to]
    }

    /// Returns a bound of the height of the displaced triangle above the flat one.
    pub(crate) fn lift<'a>(&self, textures: &Textures, ceilings: &'a Ceilings) -> Lift<'a> {
        let [n0, m1, m2] = self.directions;
        let corners = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]
            .map(|[s, t]| [0, 1, 2].map(|axis| n0[axis] + s * m1[axis] + t * m2[axis]));
        let largest = |of: &dyn Fn(&[f32; 3]) -> f32| corners.iter().map(of).fold(0.0, f32::max);
        let tilt = largest(&|n| n[0].hypot(n[1]));
        let upright = largest(&|n| n[2].abs());
        let [_, e1, e2] = self.plane;
        // Length of the gradient over the grid of a quantity that changes by these amounts along the edges.
        let slope = |[along_1, along_2]: [f32; 2]| {
            let u = (along_1 * e2[1] - along_2 * e1[1]) * self.inverse_area;
            let v = (along_2 * e1[0] - along_1 * e2[0]) * self.inverse_area;
            u.hypot(v)
        };
        let [_, r1, r2] = self.rise;
        let [_, m1, m2] = self.directions;
        let [_, d1, d2] = self.texture;
        // Largest distance along the grid of the displaced point from the flat one.
        let away = self.max_displacement * tilt;
        let risen = away * slope([r1, r2]);
        // If a direction points inwards, negative displacements raise the surface as well.
        let outwards = corners.iter().all(|n| n[2] * self.inverse_area >= 0.0);
        let bound = if outwards { self.max_outwards } else { self.max_displacement } * upright + risen;
        let texels = [0, 1].map(|axis| away * slope([d1[axis], d2[axis]]));
        let near = texels.iter().all(|texels| *texels <= RADIUS as f32);
        let sideways = risen + self.max_displacement * away * slope([m1[2], m2[2]]);
        let level = (outwards && near).then(|| (self.level as usize).checked_sub(1)).flatten();
        Lift { bound, local: level.map(|level| (ceilings.of(level, &textures.levels[level]), sideways)) }
    }

    /// Returns the bound of the height above a point of the flat triangle, m.
    #[inline]
    pub(crate) fn lift_at(&self, lift: &Lift, s: f32, t: f32) -> f32 {
        let Some((ceiling, sideways)) = lift.local else { return lift.bound };
        let (x, y) = self.texel(s, t);
        (ceiling.around(x, y) * self.direction(s, t, 2).abs() + sideways).min(lift.bound)
    }

    /// Finds the point of the displaced triangle above (u, v), m. `None` if the flat triangle is not there,
    /// or farther than `reach` along n.
    ///
    /// Where directions are not along n, the point above (u, v) is the displacement of another point of the
    /// triangle. At most `refinements` Newton steps find it. Where they do not converge because the surface
    /// is folded, or lead outside of the triangle, the height is approximated by the displacement of the
    /// point below (u, v), as in the dissertation (Eq. 4.9).
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
        // Eq. 4.9: the displacement of the point below the texel, taken along n.
        let upright = |s: f32, t: f32| {
            let (x, y) = self.texel(s, t);
            let displacement = spline::value(level, textures.coefficients, x, y);
            self.base(s, t) + displacement * self.direction(s, t, 2)
        };
        let (tilt_u, tilt_v) = (
            self.max_displacement * self.direction(s, t, 0),
            self.max_displacement * self.direction(s, t, 1),
        );
        let negligible = NEGLIGIBLE_SHIFT * step;
        if tilt_u * tilt_u + tilt_v * tilt_v <= negligible * negligible || refinements == 0 {
            return Some(Point { s, t, height: upright(s, t), folded: false });
        }
        let [_, e1, e2] = &self.plane;
        let [_, m1, m2] = &self.directions;
        let [_, d1, d2] = &self.texture;
        // Newton's method for (s, t): the u and v components of p(s, t) are to be (u, v). With d = n₀ + s m₁
        // + t m₂, ∂p/∂s = e₁ + h_s d + h m₁ and ∂p/∂t = e₂ + h_t d + h m₂.
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
            // The determinant of the Jacobian is the displaced area. Where it vanishes, or changes its sign,
            // the surface is folded, and several points may be above (u, v).
            let area = us * vt - ut * vs;
            if area * self.inverse_area < MIN_AREA_RATIO {
                break;
            }
            let ds = (miss_v * ut - miss_u * vt) / area;
            let dt = (vs * miss_u - us * miss_v) / area;
            (s, t) = (s + ds, t + dt);
            if miss_u.abs() + miss_v.abs() <= NEWTON_TOLERANCE * step {
                if self.is_beyond(s, t) {
                    break;
                }
                // The displacement changes by h_s ds + h_t dt in this last step, to first order.
                let height = self.base(s, t) + (h + hs * ds + ht * dt) * self.direction(s, t, 2);
                return Some(Point { s, t, height, folded: false });
            }
        }
        let (s, t) = start;
        Some(Point { s, t, height: upright(s, t), folded: true })
    }

    /// Returns whether a point is farther outside of the triangle than [`MAX_OUTSIDE_TEXELS`].
    #[inline]
    fn is_beyond(&self, s: f32, t: f32) -> bool {
        let outside = (-s).max(-t).max(s + t - 1.0).max(0.0);
        let [_, d1, d2] = &self.texture;
        let square = (d1[0] * d1[0] + d1[1] * d1[1]).max(d2[0] * d2[0] + d2[1] * d2[1]);
        outside * outside * square > MAX_OUTSIDE_TEXELS * MAX_OUTSIDE_TEXELS
    }

    /// Returns the height function at a point of the displaced triangle, with its derivatives.
    ///
    /// A folded surface gets the derivatives of the approximate height function (Eq. 4.9), which displaces
    /// along n alone: derivatives of the true one are divided by the displaced area, which may be 0 there.
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
        // Chain rule from texels to s and t: h_s = ∇h · d₁, h_st = d₁ᵀ ∇²h d₂.
        let (hs, ht) = (texture.x * ax + texture.y * ay, texture.x * bx + texture.y * by);
        let second = |px: f32, py: f32, qx: f32, qy: f32| {
            texture.xx * px * qx + texture.xy * (px * qy + py * qx) + texture.yy * py * qy
        };
        let (hss, hst, htt) = (second(ax, ay, ax, ay), second(ax, ay, bx, by), second(bx, by, bx, by));
        // Derivatives of a component of p = b + h d: p_s, p_t, p_ss, p_st, p_tt, with d linear in s and t.
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
        if folded || shrunk < MIN_AREA_RATIO || shrunk.is_nan() {
            (by_u, by_v) = (flat(0), flat(1));
        }
        let area = area(&by_u, &by_v);
        let ([us, ut, uss, ust, utt], [vs, vt, vss, vst, vtt]) = (by_u, by_v);
        let [ws, wt, wss, wst, wtt] = along(2);
        // Slopes of the height w over the grid: w_s = w_u u_s + w_v v_s and w_t = w_u u_t + w_v v_t, solved
        // for w_u, w_v.
        let u = (ws * vt - wt * vs) / area;
        let v = (us * wt - ut * ws) / area;
        // Curvatures by s and t, without the part that the bending of u and v over s and t makes:
        // k_st = w_st − w_u u_st − w_v v_st.
        let (kss, kst, ktt) = (wss - u * uss - v * vss, wst - u * ust - v * vst, wtt - u * utt - v * vtt);
        // Derivatives of s and t by u and v, from the inverse of the Jacobian; then w_uv = k_st transformed
        // by them.
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
