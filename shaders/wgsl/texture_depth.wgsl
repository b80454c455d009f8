// Directional penetration depth of textured surfaces (§4.4): images of their heights over a common grid (Eq.
// 4.9), and the largest overlap of pairs of images (Eq. 4.10) with the sums from which its derivatives are
// computed.
//
// Coordinates are in a contact's frame: u and v along the grid and n along the penetration direction, from
// the centre of the grid, in metres. The CPU twins in crates/texture-pd/src/kernels derive the equations.

struct Header {
    // Texels along a side of an image.
    grid: u32,
    images: u32,
    pairs: u32,
    // Maximum number of Newton steps per texel.
    refinements: u32,
}

struct Image {
    // Index of its first triangle, and their number.
    first: u32,
    count: u32,
    // 1 for the highest surface along n, -1 for the lowest.
    side: f32,
    // Distance between texels.
    step: f32,
    // Largest distance along n of undisplaced surfaces from the origin; those farther away are ignored.
    reach: f32,
    unused_a: u32,
    unused_b: u32,
    unused_c: u32,
}

struct Pair {
    a: u32,
    b: u32,
    // Temperature of the smooth maximum; 0 for the largest overlap alone.
    temperature: f32,
    // Number of half-planes x u + y v <= z, with (x, y) of length 1, outside of which overlaps do not count.
    clip_count: u32,
    clips: array<vec4<f32>, 8>,
}

@group(0) @binding(0) var<uniform> header: Header;
// Seven vectors per triangle; see `load_triangle`.
@group(0) @binding(1) var<storage, read> triangles: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> images: array<Image>;
// Levels of the textures: first coefficient, width, height, and wrap mode: bits 0 and 1 along u, 2 and 3
// along v.
@group(0) @binding(3) var<storage, read> levels: array<vec4<u32>>;
@group(0) @binding(4) var<storage, read> coefficients: array<f32>;
// Bits of the height and index of the triangle, for each texel of each image.
@group(0) @binding(5) var<storage, read_write> heights: array<vec2<u32>>;
@group(0) @binding(6) var<storage, read> pairs: array<Pair>;
// ANSWER_WORDS words per pair.
@group(0) @binding(7) var<storage, read_write> answers: array<u32>;

// Index of a texel or a triangle that does not exist.
const NOWHERE: u32 = 0xffffffffu;
// Bits of the height of a texel without a surface: 2^64 m.
const NO_SURFACE: u32 = 0x5f800000u;
// Flag in a texel's triangle index: the displaced surface is folded there.
const FOLDED: u32 = 0x80000000u;

// Barycentric tolerance of a triangle's edges, so that no texel falls between neighbouring triangles.
const EDGE_TOLERANCE: f32 = 1e-5;
// Largest displacement along the grid that is neglected, in steps of the grid.
const NEGLIGIBLE_SHIFT: f32 = 1e-3;
// Distance from the texel at which Newton's method takes its last step, in steps of the grid. That step
// changes the height to first order only.
const NEWTON_TOLERANCE: f32 = 0.05;
// Ratio of the displaced to the flat area, as seen along n, below which the surface counts as folded.
const MIN_AREA_RATIO: f32 = 0.1;
// Largest distance outside of the triangle of the point found, in texels of the texture.
const MAX_OUTSIDE_TEXELS: f32 = 2.0;

// Coordinate of a texel's centre along u or v.
fn coordinate(index: u32, step: f32) -> f32 {
    return (f32(index) + 0.5 - 0.5 * f32(header.grid)) * step;
}

// --- Displacement: a cubic B-spline ---

// Displacement and its derivatives by x and y, in texels.
struct Jet {
    value: f32,
    x: f32,
    y: f32,
    xx: f32,
    xy: f32,
    yy: f32,
}

// Index of the coefficient that stands for index i of n: wrap is 0 to repeat, 1 to clamp, 2 to mirror.
fn wrapped(i: i32, n: u32, wrap: u32) -> u32 {
    let size = i32(n);
    if wrap == 1u { return u32(clamp(i, 0, size - 1)); }
    let period = select(2 * size, size, wrap == 0u);
    let j = ((i % period) + period) % period;
    return u32(select(2 * size - 1 - j, j, j < size));
}

// Cubic B-spline basis of the four coefficients around a point at f from the second one, and its derivatives.
fn weights(f: f32) -> vec4<f32> {
    let g = 1.0 - f;
    return vec4(
        g * g * g / 6.0,
        (f * f * (3.0 * f - 6.0) + 4.0) / 6.0,
        (g * g * (3.0 * g - 6.0) + 4.0) / 6.0,
        f * f * f / 6.0,
    );
}

fn slopes(f: f32) -> vec4<f32> {
    let g = 1.0 - f;
    return vec4(-0.5 * g * g, 0.5 * f * (3.0 * f - 4.0), -0.5 * g * (3.0 * g - 4.0), 0.5 * f * f);
}

fn curvatures(f: f32) -> vec4<f32> {
    let g = 1.0 - f;
    return vec4(g, 3.0 * f - 2.0, 3.0 * g - 2.0, f);
}

// The 4 x 4 coefficients around a point, a row each, and its offset from the second column (f) and row (g).
struct Taps {
    rows: mat4x4<f32>,
    f: f32,
    g: f32,
}

// Loads the coefficients around a point in texels; the centre of the first texel is at 0.5.
fn taps_at(level: vec4<u32>, at: vec2<f32>) -> Taps {
    let p = at - 0.5;
    let corner = floor(p);
    let first = vec2<i32>(corner) - 1;
    var columns: vec4<u32>;
    for (var i = 0; i < 4; i++) { columns[i] = wrapped(first.x + i, level.y, level.w & 3u); }
    var rows: mat4x4<f32>;
    for (var j = 0; j < 4; j++) {
        let begin = level.x + wrapped(first.y + j, level.z, level.w >> 2u) * level.y;
        rows[j] = vec4(
            coefficients[begin + columns.x],
            coefficients[begin + columns.y],
            coefficients[begin + columns.z],
            coefficients[begin + columns.w],
        );
    }
    return Taps(rows, p.x - corner.x, p.y - corner.y);
}

// h = w(f)^T C w(g). Derivatives replace w by its derivative on either side.
fn spline_value(level: vec4<u32>, at: vec2<f32>) -> f32 {
    let taps = taps_at(level, at);
    return dot(weights(taps.f) * taps.rows, weights(taps.g));
}

fn spline_slope(level: vec4<u32>, at: vec2<f32>) -> vec3<f32> {
    let taps = taps_at(level, at);
    let rows = weights(taps.f) * taps.rows;
    let across = weights(taps.g);
    return vec3(dot(rows, across), dot(slopes(taps.f) * taps.rows, across), dot(rows, slopes(taps.g)));
}

fn spline_jet(level: vec4<u32>, at: vec2<f32>) -> Jet {
    let taps = taps_at(level, at);
    let rows = weights(taps.f) * taps.rows;
    let rows_x = slopes(taps.f) * taps.rows;
    let rows_xx = curvatures(taps.f) * taps.rows;
    let across = weights(taps.g);
    let across_y = slopes(taps.g);
    return Jet(
        dot(rows, across),
        dot(rows_x, across),
        dot(rows, across_y),
        dot(rows_xx, across),
        dot(rows_x, across_y),
        dot(rows, curvatures(taps.g)),
    );
}

// --- Displaced triangles ---

// A flat triangle p0 + s e1 + t e2, displaced by h(uv0 + s d1 + t d2) along n0 + s m1 + t m2.
struct Triangle {
    p0: vec3<f32>,
    e1: vec3<f32>,
    e2: vec3<f32>,
    n0: vec3<f32>,
    m1: vec3<f32>,
    m2: vec3<f32>,
    uv0: vec2<f32>,
    d1: vec2<f32>,
    d2: vec2<f32>,
    // Index of the texture's level plus one; 0 without a texture.
    level: f32,
    // Largest magnitude of the displacement.
    max_displacement: f32,
    // Inverse of twice the signed area as seen along n.
    inverse_area: f32,
}

fn load_triangle(index: u32) -> Triangle {
    let at = index * 7u;
    let a = triangles[at];
    let b = triangles[at + 1u];
    let c = triangles[at + 2u];
    let d = triangles[at + 3u];
    let e = triangles[at + 4u];
    let f = triangles[at + 5u];
    let g = triangles[at + 6u];
    return Triangle(
        vec3(a.xy, c.x), vec3(a.zw, c.y), vec3(b.xy, c.z), d.xyz, vec3(d.w, e.xy), vec3(e.zw, f.x),
        f.yz, vec2(f.w, g.x), g.yz, b.w, c.w, b.z,
    );
}

// Returns whether a point is in a triangle as seen along n. It loads the first two vectors only.
fn covers(index: u32, at: vec2<f32>) -> bool {
    let a = triangles[index * 7u];
    let b = triangles[index * 7u + 1u];
    let d = at - a.xy;
    let s = (d.x * b.y - d.y * b.x) * b.z;
    let t = (a.z * d.y - a.w * d.x) * b.z;
    return s >= -EDGE_TOLERANCE && t >= -EDGE_TOLERANCE && s + t <= 1.0 + EDGE_TOLERANCE;
}

struct Point {
    found: bool,
    folded: bool,
    s: f32,
    t: f32,
    height: f32,
}

// Eq. 4.9: the displacement of a point, taken along n.
fn upright(tri: Triangle, level: vec4<u32>, s: f32, t: f32) -> f32 {
    let displacement = spline_value(level, tri.uv0 + s * tri.d1 + t * tri.d2);
    return tri.p0.z + s * tri.e1.z + t * tri.e2.z + displacement * (tri.n0.z + s * tri.m1.z + t * tri.m2.z);
}

// Returns whether a point is farther outside of the triangle than MAX_OUTSIDE_TEXELS.
fn is_beyond(tri: Triangle, s: f32, t: f32) -> bool {
    let outside = max(max(-s, -t), max(s + t - 1.0, 0.0));
    let square = max(dot(tri.d1, tri.d1), dot(tri.d2, tri.d2));
    return outside * outside * square > MAX_OUTSIDE_TEXELS * MAX_OUTSIDE_TEXELS;
}

// Finds the point of the displaced triangle above `at`, if the flat triangle is there and within `reach`
// along n. Newton's method searches the point that is displaced to `at`. Where it does not converge because
// the surface is folded, or leads outside of the triangle, the height is approximated by the displacement of
// the point below `at` (Eq. 4.9).
fn above(tri: Triangle, at: vec2<f32>, step: f32, reach: f32, refinements: u32) -> Point {
    // Cramer's rule for s e1 + t e2 = at - p0.
    let d = at - tri.p0.xy;
    var s = (d.x * tri.e2.y - d.y * tri.e2.x) * tri.inverse_area;
    var t = (tri.e1.x * d.y - tri.e1.y * d.x) * tri.inverse_area;
    let base = tri.p0.z + s * tri.e1.z + t * tri.e2.z;
    if s < -EDGE_TOLERANCE || t < -EDGE_TOLERANCE || s + t > 1.0 + EDGE_TOLERANCE || abs(base) > reach {
        return Point(false, false, 0.0, 0.0, 0.0);
    }
    if tri.level == 0.0 { return Point(true, false, s, t, base); }
    let level = levels[u32(tri.level) - 1u];
    let tilt = tri.max_displacement * (tri.n0.xy + s * tri.m1.xy + t * tri.m2.xy);
    if dot(tilt, tilt) <= NEGLIGIBLE_SHIFT * step * NEGLIGIBLE_SHIFT * step || refinements == 0u {
        return Point(true, false, s, t, upright(tri, level, s, t));
    }
    // Newton's method for (s, t): p = b + h d is to be above `at`. With d = n0 + s m1 + t m2, dp/ds = e1 +
    // h_s d + h m1 and dp/dt = e2 + h_t d + h m2.
    let start = vec2(s, t);
    for (var i = 0u; i <= refinements; i++) {
        let h = spline_slope(level, tri.uv0 + s * tri.d1 + t * tri.d2);
        let direction = tri.n0 + s * tri.m1 + t * tri.m2;
        let miss = tri.p0.xy + s * tri.e1.xy + t * tri.e2.xy + h.x * direction.xy - at;
        let by_s = tri.e1.xy + dot(h.yz, tri.d1) * direction.xy + h.x * tri.m1.xy;
        let by_t = tri.e2.xy + dot(h.yz, tri.d2) * direction.xy + h.x * tri.m2.xy;
        let area = by_s.x * by_t.y - by_t.x * by_s.y;
        // The determinant of the Jacobian is the displaced area. Where it vanishes the surface is folded.
        if area * tri.inverse_area < MIN_AREA_RATIO { break; }
        let ds = (miss.y * by_t.x - miss.x * by_t.y) / area;
        let dt = (by_s.y * miss.x - by_s.x * miss.y) / area;
        s += ds;
        t += dt;
        if abs(miss.x) + abs(miss.y) <= NEWTON_TOLERANCE * step {
            if is_beyond(tri, s, t) { break; }
            // The displacement changes by h_s ds + h_t dt in this last step, to first order.
            let displacement = h.x + dot(h.yz, tri.d1) * ds + dot(h.yz, tri.d2) * dt;
            let upright = tri.n0.z + s * tri.m1.z + t * tri.m2.z;
            return Point(true, false, s, t, tri.p0.z + s * tri.e1.z + t * tri.e2.z + displacement * upright);
        }
    }
    return Point(true, true, start.x, start.y, upright(tri, level, start.x, start.y));
}

// Height and its derivatives by u and v.
struct HeightJet {
    height: f32,
    u: f32,
    v: f32,
    uu: f32,
    uv: f32,
    vv: f32,
}

// Returns the height function at a point with its derivatives. A folded surface gets those of the approximate
// height function (Eq. 4.9), which displaces along n alone: derivatives of the true one are divided by the
// displaced area, which may be 0 there.
fn height_jet(tri: Triangle, point: Point) -> HeightJet {
    let s = point.s;
    let t = point.t;
    var h = Jet(0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    if tri.level != 0.0 {
        h = spline_jet(levels[u32(tri.level) - 1u], tri.uv0 + s * tri.d1 + t * tri.d2);
    }
    let slope = vec2(h.x, h.y);
    let curvature = mat2x2(h.xx, h.xy, h.xy, h.yy);
    // Chain rule from texels to s and t.
    let hs = dot(slope, tri.d1);
    let ht = dot(slope, tri.d2);
    let hss = dot(tri.d1, curvature * tri.d1);
    let hst = dot(tri.d1, curvature * tri.d2);
    let htt = dot(tri.d2, curvature * tri.d2);
    // Derivatives of the displaced point p = b + h n by s and t.
    let n = tri.n0 + s * tri.m1 + t * tri.m2;
    var by_s = tri.e1 + hs * n + h.value * tri.m1;
    var by_t = tri.e2 + ht * n + h.value * tri.m2;
    var by_ss = hss * n + 2.0 * hs * tri.m1;
    var by_st = hst * n + hs * tri.m2 + ht * tri.m1;
    var by_tt = htt * n + 2.0 * ht * tri.m2;
    var area = by_s.x * by_t.y - by_t.x * by_s.y;
    if point.folded || !(area * tri.inverse_area >= MIN_AREA_RATIO) {
        by_s = vec3(tri.e1.xy, by_s.z);
        by_t = vec3(tri.e2.xy, by_t.z);
        by_ss = vec3(0.0, 0.0, by_ss.z);
        by_st = vec3(0.0, 0.0, by_st.z);
        by_tt = vec3(0.0, 0.0, by_tt.z);
        area = by_s.x * by_t.y - by_t.x * by_s.y;
    }
    // Slopes of the height w over the grid, from w_s = w_u u_s + w_v v_s and w_t = w_u u_t + w_v v_t.
    let u = (by_s.z * by_t.y - by_t.z * by_s.y) / area;
    let v = (by_s.x * by_t.z - by_t.x * by_s.z) / area;
    // Curvatures by s and t, without the part that the bending of u and v over s and t makes.
    let kss = by_ss.z - u * by_ss.x - v * by_ss.y;
    let kst = by_st.z - u * by_st.x - v * by_st.y;
    let ktt = by_tt.z - u * by_tt.x - v * by_tt.y;
    // Derivatives of s and t by u and v, from the inverse of the Jacobian.
    let su = by_t.y / area;
    let sv = -by_t.x / area;
    let tu = -by_s.y / area;
    let tv = by_s.x / area;
    return HeightJet(
        point.height,
        u,
        v,
        kss * su * su + 2.0 * kst * su * tu + ktt * tu * tu,
        kss * su * sv + kst * (su * tv + sv * tu) + ktt * tu * tv,
        kss * sv * sv + 2.0 * kst * sv * tv + ktt * tv * tv,
    );
}

// --- Images ---

// One invocation per texel; images are numbered along y and then z.
@compute @workgroup_size(64)
fn height_images(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let texels = header.grid * header.grid;
    let texel = workgroup.x * 64u + lane;
    let number = workgroup.z * workgroups.y + workgroup.y;
    if texel >= texels || number >= header.images { return; }
    let image = images[number];
    let at = vec2(coordinate(texel % header.grid, image.step), coordinate(texel / header.grid, image.step));
    var best = vec2(NO_SURFACE, NOWHERE);
    var height = 0.0;
    for (var index = image.first; index < image.first + image.count; index++) {
        if !covers(index, at) { continue; }
        let point = above(load_triangle(index), at, image.step, image.reach, header.refinements);
        // The outermost surface is the visible one: the highest for A, the lowest for B.
        if point.found && (best.y == NOWHERE || (point.height - height) * image.side > 0.0) {
            height = point.height;
            best = vec2(bitcast<u32>(height), index | select(0u, FOLDED, point.folded));
        }
    }
    heights[number * texels + texel] = best;
}

// --- Pairs of images ---

const LANES: u32 = 256u;
const ANSWER_WORDS: u32 = 68u;
// Smallest exponent of an overlap that counts in the smooth maximum.
const MIN_EXPONENT: f32 = -8.0;
// Width of the border of the grid over which weights fall to 0, as a part of the grid's side.
const TAPER_WIDTH: f32 = 0.1;

struct Overlap {
    depth: f32,
    texel: u32,
    shared_texels: u32,
    folded: u32,
}

// Surfaces of both images at a texel.
struct Sample {
    at: vec2<f32>,
    a: HeightJet,
    b: HeightJet,
    // Bit 0: A ends next to the texel. Bit 1: B ends there.
    ends: u32,
}

// Number of sums over texels: the weight; the gradients' differences from the gradient at the largest
// overlap; the outer products of those; and the overlaps' second derivatives. Matrices are upper triangles of
// 6 x 6, row by row.
const SUMS: u32 = 49u;

var<workgroup> largest: array<Overlap, LANES>;
var<workgroup> partial: array<f32, LANES>;

fn is_better(candidate: Overlap, than: Overlap) -> bool {
    if candidate.texel == NOWHERE { return false; }
    if than.texel == NOWHERE { return true; }
    return candidate.depth > than.depth || (candidate.depth == than.depth && candidate.texel < than.texel);
}

// Distance of a texel to the border of a pair's domain: negative outside.
fn margin(number: u32, texel: u32) -> f32 {
    var least = 1e30;
    let step = images[pairs[number].a].step;
    let at = vec2(coordinate(texel % header.grid, step), coordinate(texel / header.grid, step));
    for (var i = 0u; i < pairs[number].clip_count; i++) {
        let clip = pairs[number].clips[i];
        least = min(least, clip.z - dot(clip.xy, at));
    }
    return least;
}

// Weight of a texel's position: it falls to 0 towards the border of the grid and over the last step of the
// domain.
fn taper(number: u32, texel: u32) -> f32 {
    let last = header.grid - 1u;
    let column = texel % header.grid;
    let row = texel / header.grid;
    let inwards = min(min(column, row), min(last - column, last - row));
    let part = min((f32(inwards) + 0.5) / (TAPER_WIDTH * f32(header.grid)), 1.0);
    let within = clamp(margin(number, texel) / images[pairs[number].a].step, 0.0, 1.0);
    return part * part * (3.0 - 2.0 * part) * within;
}

// Returns whether a surface ends next to a texel, within the grid.
fn ends(image: u32, texel: u32) -> bool {
    let start = image * header.grid * header.grid;
    let column = texel % header.grid;
    let row = texel / header.grid;
    let last = header.grid - 1u;
    if column > 0u && heights[start + texel - 1u].x == NO_SURFACE { return true; }
    if column < last && heights[start + texel + 1u].x == NO_SURFACE { return true; }
    if row > 0u && heights[start + texel - header.grid].x == NO_SURFACE { return true; }
    return row < last && heights[start + texel + header.grid].x == NO_SURFACE;
}

// Height and derivatives of an image's surface at a texel. A folded one is found without Newton steps.
fn surface(image: u32, texel: u32, at: vec2<f32>) -> HeightJet {
    let known = heights[image * header.grid * header.grid + texel];
    let tri = load_triangle(known.y & ~FOLDED);
    let folded = (known.y & FOLDED) != 0u;
    var point = above(tri, at, images[image].step, images[image].reach, select(header.refinements, 0u, folded));
    if !point.found { point = Point(true, false, 0.0, 0.0, bitcast<f32>(known.x)); }
    point.folded = folded;
    return height_jet(tri, point);
}

fn sample_at(number: u32, texel: u32) -> Sample {
    let a = pairs[number].a;
    let b = pairs[number].b;
    let step = images[a].step;
    let at = vec2(coordinate(texel % header.grid, step), coordinate(texel / header.grid, step));
    let ending = select(0u, 1u, ends(a, texel)) | select(0u, 2u, ends(b, texel));
    return Sample(at, surface(a, texel, at), surface(b, texel, at), ending);
}

// Gradient of the overlap h_A - h_B by the motion of A along u, v, n and about them. A point r = (u, v, h_A)
// of A over B: g = (-dh_B/du, -dh_B/dv, 1) by translation, and r x g by rotation. Where only B ends, A slides
// over a point of B.
fn gradient(known: Sample) -> array<f32, 6> {
    var g = vec3(-known.b.u, -known.b.v, 1.0);
    if known.ends == 2u { g = vec3(-known.a.u, -known.a.v, 1.0); }
    let turn = cross(vec3(known.at, known.a.height), g);
    return array(g.x, g.y, g.z, turn.x, turn.y, turn.z);
}

// Second derivatives of the overlap for a point of A over B: upper triangle, row by row. With H = -grad^2 h_B
// and J = (1, -[r]x), by which A's motion moves r, they are J^T H J. The second-order displacement
// 0.5 w x (w x r) of r by a turn w adds 0.5 (r g^T + g r^T) - (g . r) 1 to the rotational block. For a point
// of B they are neglected.
fn curvature(known: Sample) -> array<f32, 21> {
    if known.ends == 2u { return array<f32, 21>(); }
    let r = vec3(known.at, known.a.height);
    let g = vec3(-known.b.u, -known.b.v, 1.0);
    let a = -known.b.uu;
    let b = -known.b.uv;
    let c = -known.b.vv;
    let row_u = vec3(-b * r.z, a * r.z, b * r.x - a * r.y);
    let row_v = vec3(-c * r.z, b * r.z, c * r.x - b * r.y);
    let along = dot(g, r);
    let turn_x = -r.z * row_v + 0.5 * (r.x * g + g.x * r) - vec3(along, 0.0, 0.0);
    let turn_y = r.z * row_u + 0.5 * (r.y * g + g.y * r) - vec3(0.0, along, 0.0);
    let turn_z = r.x * row_v - r.y * row_u + 0.5 * (r.z * g + g.z * r) - vec3(0.0, 0.0, along);
    return array(
        a, b, 0.0, row_u.x, row_u.y, row_u.z,
        c, 0.0, row_v.x, row_v.y, row_v.z,
        0.0, 0.0, 0.0, 0.0,
        turn_x.x, turn_x.y, turn_x.z,
        turn_y.y, turn_y.z,
        turn_z.z,
    );
}

// Adds a texel to the sums.
fn add(sums: ptr<function, array<f32, SUMS>>, weight: f32, known: Sample, origin: array<f32, 6>) {
    let slope = gradient(known);
    let second = curvature(known);
    (*sums)[0] += weight;
    var at = 0u;
    for (var i = 0u; i < 6u; i++) {
        let difference = slope[i] - origin[i];
        (*sums)[1u + i] += weight * difference;
        for (var j = i; j < 6u; j++) {
            (*sums)[7u + at] += weight * difference * (slope[j] - origin[j]);
            (*sums)[28u + at] += weight * second[at];
            at += 1u;
        }
    }
}

// Finds the largest overlap (Eq. 4.10) and the first texel that has it. Each invocation visits its texels in
// ascending order, and the reduction prefers the lower texel, so the result does not depend on the schedule.
fn find_largest(number: u32, lane: u32) -> Overlap {
    let texels = header.grid * header.grid;
    let first_a = pairs[number].a * texels;
    let first_b = pairs[number].b * texels;
    var mine = Overlap(0.0, NOWHERE, 0u, 0u);
    for (var texel = lane; texel < texels; texel += LANES) {
        let a = heights[first_a + texel];
        let b = heights[first_b + texel];
        if a.x == NO_SURFACE || b.x == NO_SURFACE || margin(number, texel) < 0.0 { continue; }
        mine.shared_texels += 1u;
        mine.folded += ((a.y | b.y) & FOLDED) >> 31u;
        let overlap = bitcast<f32>(a.x) - bitcast<f32>(b.x);
        if mine.texel == NOWHERE || overlap > mine.depth {
            mine.depth = overlap;
            mine.texel = texel;
        }
    }
    largest[lane] = mine;
    workgroupBarrier();
    for (var width = LANES / 2u; width > 0u; width /= 2u) {
        if lane < width {
            let other = largest[lane + width];
            var kept = largest[lane];
            if is_better(other, kept) {
                kept.depth = other.depth;
                kept.texel = other.texel;
            }
            kept.shared_texels += other.shared_texels;
            kept.folded += other.folded;
            largest[lane] = kept;
        }
        workgroupBarrier();
    }
    return workgroupUniformLoad(&largest[0]);
}

fn store(at: u32, value: f32) {
    answers[at] = bitcast<u32>(value);
}

fn store_jet(at: u32, jet: HeightJet) {
    store(at, jet.height);
    store(at + 1u, jet.u);
    store(at + 2u, jet.v);
    store(at + 3u, jet.uu);
    store(at + 4u, jet.uv);
    store(at + 5u, jet.vv);
}

// One workgroup per pair; pairs are numbered along x and then y.
@compute @workgroup_size(256)
fn overlaps(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let number = workgroup.y * workgroups.x + workgroup.x;
    if number >= header.pairs { return; }
    let answer = number * ANSWER_WORDS;
    let best = find_largest(number, lane);
    if best.texel == NOWHERE {
        if lane < ANSWER_WORDS { answers[answer + lane] = select(0u, NOWHERE, lane == 1u); }
        return;
    }
    let deepest = sample_at(number, best.texel);
    let origin = gradient(deepest);

    // Smooth maximum: weights exp((h_A - h_B - depth) / temperature), relative to the largest overlap so that
    // they stay within (0, 1].
    var sums: array<f32, SUMS>;
    let temperature = pairs[number].temperature;
    if temperature > 0.0 {
        let texels = header.grid * header.grid;
        let first_a = pairs[number].a * texels;
        let first_b = pairs[number].b * texels;
        for (var texel = lane; texel < texels; texel += LANES) {
            let a = heights[first_a + texel];
            let b = heights[first_b + texel];
            if a.x == NO_SURFACE || b.x == NO_SURFACE { continue; }
            let below = (bitcast<f32>(a.x) - bitcast<f32>(b.x) - best.depth) / temperature;
            if below < MIN_EXPONENT { continue; }
            let weight = exp(below) * taper(number, texel);
            if weight > 0.0 { add(&sums, weight, sample_at(number, texel), origin); }
        }
    }
    // One tree reduction per sum: workgroup memory holds one value per invocation.
    for (var i = 0u; i < SUMS; i++) {
        partial[lane] = sums[i];
        workgroupBarrier();
        for (var width = LANES / 2u; width > 0u; width /= 2u) {
            if lane < width { partial[lane] += partial[lane + width]; }
            workgroupBarrier();
        }
        if lane == 0u { store(answer + 4u + i, partial[0]); }
        workgroupBarrier();
    }
    if lane == 0u {
        store(answer, best.depth);
        answers[answer + 1u] = best.texel;
        answers[answer + 2u] = best.shared_texels;
        answers[answer + 3u] = best.folded;
        store_jet(answer + 53u, deepest.a);
        store_jet(answer + 59u, deepest.b);
        answers[answer + 65u] = deepest.ends;
        answers[answer + 66u] = 0u;
        answers[answer + 67u] = 0u;
    }
}
