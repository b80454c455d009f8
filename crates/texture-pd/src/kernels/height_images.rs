use super::displaced::Textures;
use super::{FOLDED, Header, Image, NO_SURFACE, NOWHERE, Triangle, coordinate};
use crate::spline::Level;

/// Twin of `height_images` in `texture_depth.wgsl`: heights of displaced surfaces over the grid (Eq. 4.9). A
/// texel holds the bits of its height (m) and the index of its triangle.
///
/// This loop visits the triangles and the texels that each may cover. The GPU visits the texels, and all
/// triangles for each.
pub(crate) fn height_images(
    header: &Header,
    triangles: &[Triangle],
    images: &[Image],
    levels: &[Level],
    coefficients: &[f32],
    heights: &mut [[u32; 2]],
) {
    let textures = Textures { levels, coefficients };
    let grid = header.grid;
    let texels = (grid * grid).max(1) as usize;
    for (image, heights) in images.iter().zip(heights.chunks_exact_mut(texels)) {
        heights.fill([NO_SURFACE, NOWHERE]);
        for index in image.first..image.first + image.count {
            let triangle = &triangles[index as usize];
            let [columns, rows] = covered(triangle, grid, image.step);
            for row in rows {
                let v = coordinate(row, grid, image.step);
                let line = &mut heights[(row * grid) as usize..][..grid as usize];
                for column in columns.clone() {
                    let u = coordinate(column, grid, image.step);
                    let extent = (image.step, image.reach);
                    let Some(point) = triangle.above(u, v, extent, header.refinements, &textures) else {
                        continue;
                    };
                    let texel = &mut line[column as usize];
                    // The outermost surface is the visible one: the highest for A, the lowest for B.
                    let known = texel[0] != NO_SURFACE;
                    if !known || (point.height - f32::from_bits(texel[0])) * image.side > 0.0 {
                        *texel = [point.height.to_bits(), index | if point.folded { FOLDED } else { 0 }];
                    }
                }
            }
        }
    }
}

/// Returns the columns and rows of texels that a triangle may cover.
pub(crate) fn covered(triangle: &Triangle, grid: u32, step: f32) -> [std::ops::Range<u32>; 2] {
    [0, 1].map(|axis| {
        let [p, e1, e2] = triangle.plane.map(|edge| edge[axis]);
        let (low, high) = (p + e1.min(e2).min(0.0), p + e1.max(e2).max(0.0));
        // Rounded outwards, because edges have a tolerance.
        let index = |at: f32| at / step + 0.5 * grid as f32 - 0.5;
        let first = (index(low).floor().max(0.0)) as u32;
        let end = (index(high).ceil() + 1.0).clamp(0.0, grid as f32) as u32;
        first..end.max(first)
    })
}
