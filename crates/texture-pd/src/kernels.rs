//! The twin on the CPU of each WGSL entry point: the same bindings in the same layout, the same answers.
//!
//! The answers are equal bit for bit, as WGSL rounds a subtraction correctly, but for overlaps below 1.2e-38 m,
//! which a GPU may flush to zero.

/// Texel of a pair that shares none.
pub(crate) const NOWHERE: u32 = u32::MAX;
/// Bits of 2⁶⁴: a height of that magnitude or beyond (m), an infinity or a NaN is no surface.
const NO_SURFACE: u32 = 0x5f80_0000;

/// Twin of `directional_depth` in `directional_depth.wgsl`, with the bindings that the entry point has.
pub(crate) fn directional_depth(texels: u32, heights: &[f32], pairs: &[[u32; 2]], overlaps: &mut [[u32; 2]]) {
    let is_surface = |height: f32| height.to_bits() & 0x7fff_ffff < NO_SURFACE;
    for (&[a, b], overlap) in pairs.iter().zip(overlaps) {
        let patch = |start: u32| &heights[start as usize..][..texels as usize];
        let mut best: Option<(f32, u32)> = None;
        for ((&a, &b), texel) in patch(a).iter().zip(patch(b)).zip(0..) {
            if is_surface(a) && is_surface(b) && best.is_none_or(|(depth, _)| a - b > depth) {
                best = Some((a - b, texel));
            }
        }
        let (depth, texel) = best.unwrap_or((0.0, NOWHERE));
        *overlap = [depth.to_bits(), texel];
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    /// Arguments as the shader binds them: texels of a patch, heights, starts of the pairs, answers.
    type Twin = fn(u32, &[f32], &[[u32; 2]], &mut [[u32; 2]]);

    /// The twin of each entry point. A new kernel joins with a test that runs both on the same inputs.
    const TWINS: &[(&str, Twin)] = &[("directional_depth", directional_depth)];

    #[test]
    fn every_entry_point_has_a_twin() {
        let entry_points = palpate_shaders::SHADERS.iter().flat_map(|shader| shader.entry_points).copied();
        let twins = TWINS.iter().map(|&(name, _)| name);
        assert_eq!(entry_points.collect::<BTreeSet<_>>(), twins.collect());
    }
}
