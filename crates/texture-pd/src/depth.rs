//! Directional penetration depth of textured surfaces in contact, and its derivatives (§4.3.3, §4.4, §5.4.4).
//!
//! A contact has a direction **n** out of the moving surface A, and a point. Both surfaces are height
//! functions along **n** over a square grid around the point (Eq. 4.9). The depth is the largest overlap h_A
//! − h_B (Eq. 4.10), or a smooth maximum of the overlaps:
//!
//! δ = τ ln (Σ exp((h_A − h_B) / τ) · area of a texel / 2 π τ ρ), with ρ half the side of the grid,
//!
//! summed over the texels. For a single maximum whose principal curvatures have the product 1/ρ² both
//! definitions give the same δ. Where the largest overlap jumps from one place to another, the smooth maximum
//! blends the two while their depths differ by a few temperatures τ.
//!
//! Contacts side by side would all find the same largest overlap, so each evaluates only its [`Domain`]. Over
//! the last step before the border of a domain, the weight of texels in the smooth maximum falls to 0.
//! Borders move with the contacts' points, and without this taper δ would jump by more than τ with each row
//! of texels that enters.
//!
//! Derivatives are by the motion of A: a translation, and a rotation (right-handed rotation vector) about a
//! given point, both in world axes. They come from the texture's slopes and curvatures at the largest
//! overlap, or at all texels that count in the smooth maximum. The point (u, v, h_A) of A lies over B's
//! height function, so its motion changes the overlap by the gradient (−∂h_B/∂u, −∂h_B/∂v, 1), and to second
//! order by h_B's curvature. The maximum moves as well. By the envelope theorem that does not change the
//! first derivative, and adds to the second: −φ_qs φ_ss⁻¹ φ_sq for the largest overlap, and the covariance of
//! the gradients over τ for the smooth maximum. For the smooth maximum these are the exact derivatives of the
//! computed δ. (The dissertation takes central differences of δ, of 11 configurations of A for the gradient
//! and 51 with the second derivatives: Eq. 4.8, 5.57, 5.58. The tests compare with them.)
//!
//! At the end of a surface the largest overlap is not a stationary point. Where B ends and A does not, A
//! slides over the point of B, so the gradient uses A's slopes; second derivatives are neglected there.

use glam::{DMat3, DVec2, DVec3};
use palpate_core::Pose;

use crate::backend::{Backend, BackendError};
use crate::batch::{Batch, MAX_GRID, SurfaceId, SurfaceSet};
use crate::domain::Domain;
use crate::kernels::{Answer, NOWHERE, coordinate};
use crate::maximum;
use crate::surface::{Field, View};

/// A contact between two surfaces, as coarse collision detection found it.
#[derive(Clone, Copy, Debug)]
pub struct TextureContact {
    /// The moving surface A.
    pub a: SurfaceId,
    /// Pose of A's mesh in the world.
    pub pose_a: Pose,
    /// Centre of A's rotations, usually its centre of mass, world, m.
    pub center: DVec3,
    /// The other surface B.
    pub b: SurfaceId,
    /// Pose of B's mesh in the world.
    pub pose_b: Pose,
    /// Unit normal **n** out of A, world axes.
    pub normal: DVec3,
    /// Centre of the grid, world, m.
    pub point: DVec3,
    /// Half the side ρ of the grid, m.
    pub half_size: f64,
    /// Largest distance along **n** of undisplaced surfaces from the point, m; those farther away are
    /// ignored. With less than both surfaces are displaced, so is what that brings near.
    pub reach: f64,
    /// Part of the grid in which overlaps count.
    pub domain: Domain,
}

/// Choice of a texture's level.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TextureFilter {
    /// The finest level.
    Finest,
    /// The coarsest level whose texels are no larger than the grid's, to avoid aliasing (§4.6.2).
    #[default]
    Footprint,
}

/// Settings of depth queries.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthSettings {
    /// Number of texels along a side of the grid: 50 in the dissertation (§4.5.2).
    pub grid: u32,
    /// Temperature τ of the smooth maximum, m; 0 for the largest overlap itself. The smooth maximum averages
    /// over about √(τ R), where R is the gap's radius of curvature. If that is less than a texel's side, the
    /// depth depends on the position of the texels.
    pub temperature: f64,
    /// Maximum number of Newton steps to the point that is displaced to a texel. 0 gives the dissertation's
    /// approximate height function (Eq. 4.9), which uses the displacement of the point below the texel.
    pub refinements: u32,
    /// Choice of a texture's level.
    pub filter: TextureFilter,
}

impl Default for DepthSettings {
    /// A grid of 50 × 50, the largest overlap, derivatives there, 5 Newton steps, filtered textures.
    fn default() -> Self {
        Self { grid: 50, temperature: 0.0, refinements: 5, filter: TextureFilter::Footprint }
    }
}

/// Reason why depths could not be computed.
#[derive(Debug, thiserror::Error)]
pub enum DepthError {
    /// A setting is out of range.
    #[error("{name} is {value}; give {expected}")]
    Setting {
        /// Name of the setting.
        name: &'static str,
        /// Value that was given.
        value: f64,
        /// Accepted values.
        expected: &'static str,
    },
    /// The backend failed.
    #[error(transparent)]
    Backend(#[from] BackendError),
}

/// Directional penetration depth of a contact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TextureDepth {
    /// Depth δ_n, m: negative where the surfaces are apart along **n**.
    pub depth: f64,
    /// Derivative ∂δ/∂x by translations of A, world axes.
    pub linear: DVec3,
    /// Derivative ∂δ/∂θ by rotations of A about the contact's centre, world axes, m/rad.
    pub angular: DVec3,
    /// Second derivatives by translation and rotation, 1/m, 1, and m: symmetric.
    pub second: [[f64; 6]; 6],
    /// Point of A at the largest overlap, world, m.
    pub point: DVec3,
    /// Point of B at the largest overlap, world, m.
    pub scene_point: DVec3,
    /// Share of the compared texels with a surface that is folded as seen along **n**, so that its height is
    /// an approximation (§4.6.1).
    pub folded: f64,
}

impl TextureDepth {
    /// Returns whether the depth, its derivatives and the points are finite.
    pub fn is_finite(&self) -> bool {
        let Self { depth, linear, angular, second, point, scene_point, folded } = self;
        let vectors = [linear, angular, point, scene_point];
        depth.is_finite()
            && folded.is_finite()
            && vectors.iter().all(|vector| vector.is_finite())
            && second.as_flattened().iter().all(|value| value.is_finite())
    }
}

/// Workspace of depth queries.
#[derive(Clone, Debug, Default)]
pub struct DepthQuery {
    batch: Batch,
    answers: Vec<Answer>,
    near: Vec<u32>,
    depths: Vec<Option<TextureDepth>>,
}

impl DepthQuery {
    /// An empty workspace.
    pub fn new() -> Self {
        Self::default()
    }

    /// Computes the depth of each contact, in order. It is `None` where the surfaces share no texel of the
    /// domain, or the contact is not finite.
    ///
    /// Allocates only to grow its workspace, apart from the backend's own allocations.
    ///
    /// # Errors
    /// If a setting is out of range, or the backend fails.
    pub fn run(
        &mut self,
        surfaces: &SurfaceSet,
        contacts: &[TextureContact],
        settings: &DepthSettings,
        backend: &mut dyn Backend,
    ) -> Result<&[Option<TextureDepth>], DepthError> {
        settings.check()?;
        self.batch.clear(settings.grid, settings.refinements);
        for contact in contacts.iter().filter(|contact| contact.is_usable()) {
            self.add(surfaces, contact, settings);
        }
        backend.evaluate(surfaces, &self.batch, &mut self.answers)?;
        self.depths.clear();
        let mut answers = self.answers.iter();
        self.depths.extend(contacts.iter().map(|contact| {
            let answer = if contact.is_usable() { answers.next()? } else { return None };
            contact.depth(answer, settings)
        }));
        Ok(&self.depths)
    }

    /// Returns the contact with its grid moved and shrunk to the part where both undisplaced surfaces are, by
    /// their triangles' bounding boxes, plus a `margin` (m). `None` if there is no such part, or the contact
    /// is not finite.
    pub fn fitted(
        &mut self,
        surfaces: &SurfaceSet,
        contact: &TextureContact,
        margin: f64,
    ) -> Option<TextureContact> {
        if !contact.is_usable() {
            return None;
        }
        let axes = contact.axes();
        let (mut low, mut high) = (DVec2::splat(-contact.half_size), DVec2::splat(contact.half_size));
        for (id, pose, side) in [(contact.a, &contact.pose_a, 1.0), (contact.b, &contact.pose_b, -1.0)] {
            let view = View::new(pose, &axes, contact.point);
            let field = Field { half: contact.half_size, reach: contact.reach, side };
            self.near.clear();
            let surface = surfaces.surface(id);
            surface.gather(&view, &field, &mut self.near);
            let [least, most] = surface.extent(&self.near, &view);
            (low, high) = (low.max(least), high.min(most));
        }
        let half = 0.5 * (high - low);
        (half.min_element() > 0.0).then(|| {
            let middle = low.midpoint(high);
            TextureContact {
                point: contact.point + axes * middle.extend(0.0),
                half_size: (half.max_element() + margin).min(contact.half_size),
                ..*contact
            }
        })
    }

    /// Depths of the last run, in the order of its contacts.
    pub fn depths(&self) -> &[Option<TextureDepth>] {
        &self.depths
    }

    /// Adds a contact's images of B and A and the pair of them to the batch.
    fn add(&mut self, surfaces: &SurfaceSet, contact: &TextureContact, settings: &DepthSettings) {
        let Self { batch, near, .. } = self;
        let step = contact.step(settings);
        let footprint = if settings.filter == TextureFilter::Footprint { step } else { 0.0 };
        let axes = contact.axes();
        let mut image = |id: SurfaceId, pose: &Pose, side: f64| {
            let (surface, level) = (surfaces.surface(id), surfaces.first_level(id));
            let view = View::new(pose, &axes, contact.point);
            near.clear();
            surface.gather(&view, &Field { half: contact.half_size, reach: contact.reach, side }, near);
            let first = batch.triangles.len();
            let seen =
                near.iter().filter_map(|&index| surface.triangle(index, &view, side, footprint, level));
            batch.triangles.extend(seen);
            batch.push_image(first, side, step, contact.reach)
        };
        let b = image(contact.b, &contact.pose_b, -1.0);
        let a = image(contact.a, &contact.pose_a, 1.0);
        batch.push_pair(a, b, settings.temperature, contact.domain.clips(&axes, contact.point));
    }
}

impl DepthSettings {
    fn check(&self) -> Result<(), DepthError> {
        let refuse = |name, value, expected| Err(DepthError::Setting { name, value, expected });
        if !(2..=MAX_GRID).contains(&self.grid) {
            return refuse("grid", self.grid.into(), "2 to 1024 texels");
        }
        if !(self.temperature.is_finite() && self.temperature >= 0.0) {
            return refuse("temperature", self.temperature, "metres, 0 or more");
        }
        Ok(())
    }
}

impl TextureContact {
    fn is_usable(&self) -> bool {
        let lengths = [self.half_size, self.reach];
        self.pose_a.is_valid()
            && self.pose_b.is_valid()
            && self.center.is_finite()
            && self.point.is_finite()
            && self.normal.is_normalized()
            && self.domain.is_finite()
            && lengths.iter().all(|length| length.is_finite() && *length > 0.0)
    }

    /// Returns the axes u, v and n.
    fn axes(&self) -> DMat3 {
        let (u, v) = self.normal.any_orthonormal_pair();
        DMat3::from_cols(u, v, self.normal)
    }

    /// Distance between texels, m.
    fn step(&self, settings: &DepthSettings) -> f64 {
        2.0 * self.half_size / f64::from(settings.grid)
    }

    /// Returns the depth from the answer for a contact's pair of images.
    fn depth(&self, answer: &Answer, settings: &DepthSettings) -> Option<TextureDepth> {
        if answer.texel == NOWHERE {
            return None;
        }
        let step = self.step(settings);
        let at = |index: u32| f64::from(coordinate(index, settings.grid, step as f32));
        let at = DVec2::new(at(answer.texel % settings.grid), at(answer.texel / settings.grid));
        let local = if settings.temperature > 0.0 {
            maximum::smooth(answer, at, settings.temperature, step, self.half_size)?
        } else {
            maximum::largest(answer, at, step)
        };
        let axes = self.axes();
        let local = local.about(axes.transpose() * (self.center - self.point));
        // From the contact's frame to the world.
        let world = |height: f32| self.point + axes * at.extend(height.into());
        let (linear, angular, second) = local.in_axes(&axes);
        Some(TextureDepth {
            depth: local.depth,
            linear,
            angular,
            second,
            point: world(answer.jet_a[0]),
            scene_point: world(answer.jet_b[0]),
            folded: f64::from(answer.folded) / f64::from(answer.shared),
        })
    }
}
