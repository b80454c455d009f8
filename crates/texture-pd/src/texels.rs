//! Sizes of the texels of an image on the surface that it covers.

use glam::{DVec2, DVec3};
use palpate_core::mesh::UvMesh;

/// Size of a texel, as a part of the mesh's bounding radius, above which a warning says that the texture is
/// too coarse for fine detail.
const MAX_TEXEL_RATIO: f64 = 1.0 / 20.0;
/// Size of a texel, as a part of the mesh's bounding radius, below which a warning says that no contact
/// resolves it.
const MIN_TEXEL_RATIO: f64 = 1e-6;
/// Stretch of texels above which they count as distorted.
const MAX_STRETCH: f64 = 4.0;
/// Share of the area with distorted texels above which there is a warning.
const MAX_STRETCHED_SHARE: f64 = 0.01;
/// Ratio of a triangle's area in the texture to the square of its longest side, below which it counts as
/// having no area.
const MIN_AREA_RATIO: f64 = 1e-12;

/// Sizes of texels on a surface. The size of a texel is the square root of the area that it covers; only
/// triangles with an area both in space and in the texture count.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TexelReport {
    /// Smallest size, m. This and the next two are 0 if no triangle counts.
    pub smallest: f64,
    /// Median of the triangles' sizes, m.
    pub median: f64,
    /// Largest size, m.
    pub largest: f64,
    /// Largest ratio of a texel's longest to its shortest extent, which are the singular values of the map
    /// from texels to the surface. 1 if texels are squares, and 0 if no triangle counts.
    pub largest_stretch: f64,
    /// Number of triangles without area in the texture: each is displaced by the texels of a line or a
    /// point.
    pub zero_area: usize,
    /// Warnings for the user, one line each.
    pub warnings: Vec<String>,
}

/// Returns the sizes on a mesh of the texels of an image of `size` (width and height).
pub fn texel_sizes(mesh: &UvMesh, size: [u32; 2]) -> TexelReport {
    let texels = DVec2::new(f64::from(size[0]), f64::from(size[1]));
    let mut report = TexelReport::default();
    let mut sizes = Vec::new();
    let (mut area, mut stretched) = (0.0, 0.0);
    for (triangle, corners) in mesh.coordinates().iter().enumerate() {
        let corners = corners.map(|uv| uv * texels);
        let sides = [corners[1] - corners[0], corners[2] - corners[0]];
        if !has_area(sides) {
            report.zero_area += 1;
            continue;
        }
        let [a, b, c] = mesh.mesh().corners(triangle);
        let Some(texel) = Texel::new([b - a, c - a], sides) else { continue };
        report.largest_stretch = report.largest_stretch.max(texel.stretch);
        area += texel.triangle;
        if texel.stretch > MAX_STRETCH {
            stretched += texel.triangle;
        }
        sizes.push(texel.size);
    }
    sizes.sort_unstable_by(f64::total_cmp);
    if let (Some(&smallest), Some(&largest)) = (sizes.first(), sizes.last()) {
        (report.smallest, report.median, report.largest) = (smallest, sizes[sizes.len() / 2], largest);
    }
    report.warnings = warnings(&report, &sizes, mesh.mesh().bounding_sphere().radius, stretched / area);
    report
}

fn has_area(sides: [DVec2; 2]) -> bool {
    let [p, q] = sides;
    let longest = p.length_squared().max(q.length_squared()).max((q - p).length_squared());
    p.perp_dot(q).abs() > MIN_AREA_RATIO * longest
}

fn warnings(report: &TexelReport, sizes: &[f64], radius: f64, stretched: f64) -> Vec<String> {
    let mut warnings = Vec::new();
    let n = sizes.len();
    let coarse = sizes.iter().filter(|size| **size > MAX_TEXEL_RATIO * radius).count();
    if coarse > 0 {
        warnings.push(format!(
            "texels of {coarse} of {n} triangles are larger than a twentieth of the bounding radius, up to {:.3e} m: use a \
             finer image, or repeat it more often",
            report.largest
        ));
    }
    let fine = sizes.iter().filter(|size| **size < MIN_TEXEL_RATIO * radius).count();
    if fine > 0 {
        warnings.push(format!(
            "texels of {fine} of {n} triangles are smaller than a millionth of the bounding radius, down to {:.3e} m: use a \
             coarser image, or repeat it less often",
            report.smallest
        ));
    }
    if stretched > MAX_STRETCHED_SHARE {
        warnings.push(format!(
            "texels are stretched by more than {MAX_STRETCH} on {:.0} % of the area, up to {:.3}: unwrap the model with less \
             distortion",
            100.0 * stretched,
            report.largest_stretch
        ));
    }
    if report.zero_area > 0 {
        warnings.push(format!(
            "triangles without area in the texture, each displaced by one texel's value or those of a line: {}",
            report.zero_area
        ));
    }
    warnings
}

/// A texel on a triangle.
struct Texel {
    /// Side of a square of the same area, m.
    size: f64,
    stretch: f64,
    /// Area of the triangle, m².
    triangle: f64,
}

impl Texel {
    /// Creates a texel from two sides of a triangle in space (m) and the same sides in texels. `None` if the
    /// triangle has no area in space, or numbers overflow.
    fn new([e, f]: [DVec3; 2], [p, q]: [DVec2; 2]) -> Option<Self> {
        let twice = e.cross(f).length();
        let determinant = p.perp_dot(q);
        // Columns of the map from texels to the surface.
        let along = (e * q.y - f * p.y) / determinant;
        let across = (f * p.x - e * q.x) / determinant;
        let [a, b, c] = [along.length_squared(), along.dot(across), across.length_squared()];
        // Singular values of the map are √(mean ± spread); their product is the area of a texel, so their
        // ratio, the stretch, is (mean + spread) / area.
        let (mean, spread) = (0.5 * (a + c), (0.5 * (a - c)).hypot(b));
        let texel = twice / determinant.abs();
        let size = texel.sqrt();
        let stretch = (mean + spread) / texel;
        let usable = size > 0.0 && size.is_finite() && stretch.is_finite();
        // Rounding may give a little less than 1.
        usable.then_some(Self { size, stretch: stretch.max(1.0), triangle: 0.5 * twice })
    }
}

#[cfg(test)]
mod tests {
    use palpate_core::TriMesh;

    use super::*;

    /// A square of 0.1 m. `uv` maps its corners, (0, 0) to (1, 1), to texture coordinates.
    fn square(uv: impl Fn(DVec2) -> DVec2) -> UvMesh {
        let corners = [DVec2::ZERO, DVec2::X, DVec2::ONE, DVec2::Y];
        let triangles = [[0, 1, 2], [0, 2, 3]];
        let mesh = TriMesh::new(
            corners.map(|p| 0.1 * p.extend(0.0)).to_vec(),
            triangles.map(|t| t.map(|v| v as u32)).to_vec(),
        );
        UvMesh::new(mesh.unwrap(), triangles.map(|t| t.map(|v| uv(corners[v]))).to_vec()).unwrap()
    }

    #[test]
    fn texels_of_a_square_have_its_side_over_the_images() {
        let report = texel_sizes(&square(|p| p), [100, 100]);
        for size in [report.smallest, report.median, report.largest] {
            assert!((size - 0.001).abs() < 1e-15, "{size}");
        }
        assert!((report.largest_stretch - 1.0).abs() < 1e-12, "{report:?}");
        assert!(report.warnings.is_empty() && report.zero_area == 0, "{report:?}");
        // Rotating and mirroring change nothing.
        let turned =
            texel_sizes(&square(|p| DVec2::from_angle(0.7).rotate(DVec2::new(p.y, p.x))), [100, 100]);
        assert!(
            (turned.median - 0.001).abs() < 1e-12 && (turned.largest_stretch - 1.0).abs() < 1e-9,
            "{turned:?}"
        );
    }

    #[test]
    fn stretch_is_the_ratio_of_a_texels_sides() {
        let report = texel_sizes(&square(|p| p), [800, 100]);
        assert!((report.largest_stretch - 8.0).abs() < 1e-9, "{report:?}");
        assert!((report.median - (0.001_f64 * 0.000_125).sqrt()).abs() < 1e-12, "{report:?}");
        assert!(report.warnings.iter().any(|w| w.contains("stretched")), "{report:?}");
        // A shear by 1 has the golden ratio's square.
        let sheared = texel_sizes(&square(|p| DVec2::new(p.x + p.y, p.y)), [100, 100]);
        let expected = 1.5 + 1.25_f64.sqrt();
        assert!((sheared.largest_stretch - expected).abs() < 1e-9, "{sheared:?}");
    }

    #[test]
    fn coarse_and_fine_texels_and_missing_areas_are_reported() {
        let coarse = texel_sizes(&square(|p| p), [10, 10]);
        assert!(coarse.warnings.iter().any(|w| w.contains("twentieth")), "{coarse:?}");
        let fine = texel_sizes(&square(|p| 1000.0 * p), [4096, 4096]);
        assert!(fine.warnings.iter().any(|w| w.contains("millionth")), "{fine:?}");
        for collapse in [DVec2::ZERO, DVec2::new(1.0, 0.3)] {
            let flat = texel_sizes(&square(|p| collapse * p.x), [64, 64]);
            assert_eq!((flat.zero_area, flat.largest, flat.largest_stretch), (2, 0.0, 0.0), "{flat:?}");
            assert!(flat.warnings.len() == 1 && flat.warnings[0].contains("without area"), "{flat:?}");
        }
        // Overflowing numbers give no size, and no NaN.
        let huge = texel_sizes(&square(|p| 1e300 * p), [64, 64]);
        assert!(huge.largest.is_finite() && huge.largest_stretch.is_finite(), "{huge:?}");
    }
}
