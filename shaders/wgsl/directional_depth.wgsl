// Directional penetration depth of pairs of surface patches (Eq. 4.10): for each pair, the largest overlap
// h_A - h_B over the texels where both patches have a surface, and the texel where it is reached.
//
// One workgroup a pair. Each invocation walks the texels in rising order and keeps the first of equal overlaps; the
// tree that joins the invocations prefers the lower texel, so that the answer does not depend on how the work is split.

struct Batch {
    pairs: u32,
    // Texels of a patch.
    texels: u32,
}

struct Overlap {
    depth: f32,
    texel: u32,
}

@group(0) @binding(0) var<uniform> batch: Batch;
// Bits of the heights, one patch after another: WGSL lets a compiler assume that no f32 is NaN or infinite, so that
// those, which mark a texel without a surface, have to be told apart as integers.
@group(0) @binding(1) var<storage, read> heights: array<u32>;
// For each pair, where the heights of A and of B begin.
@group(0) @binding(2) var<storage, read> pairs: array<vec2<u32>>;
@group(0) @binding(3) var<storage, read_write> overlaps: array<Overlap>;

const WORKGROUP: u32 = 64u;
// In place of a texel: the patches share none.
const NOWHERE: u32 = 0xffffffffu;
// Bits of 2^64: a height of that magnitude or beyond (m), an infinity or a NaN is no surface.
const NO_SURFACE: u32 = 0x5f800000u;

var<workgroup> best: array<Overlap, WORKGROUP>;

fn is_surface(bits: u32) -> bool {
    return (bits & 0x7fffffffu) < NO_SURFACE;
}

fn is_better(candidate: Overlap, than: Overlap) -> bool {
    if candidate.texel == NOWHERE { return false; }
    if than.texel == NOWHERE { return true; }
    return candidate.depth > than.depth || (candidate.depth == than.depth && candidate.texel < than.texel);
}

@compute @workgroup_size(64)
fn directional_depth(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let pair = workgroup.y * workgroups.x + workgroup.x;
    if pair >= batch.pairs { return; }

    let start = pairs[pair];
    var mine = Overlap(0.0, NOWHERE);
    for (var texel = lane; texel < batch.texels; texel += WORKGROUP) {
        let a = heights[start.x + texel];
        let b = heights[start.y + texel];
        if is_surface(a) && is_surface(b) {
            let candidate = Overlap(bitcast<f32>(a) - bitcast<f32>(b), texel);
            if is_better(candidate, mine) { mine = candidate; }
        }
    }
    best[lane] = mine;
    workgroupBarrier();

    for (var width = WORKGROUP / 2u; width > 0u; width /= 2u) {
        if lane < width && is_better(best[lane + width], best[lane]) {
            best[lane] = best[lane + width];
        }
        workgroupBarrier();
    }
    if lane == 0u { overlaps[pair] = best[0]; }
}
