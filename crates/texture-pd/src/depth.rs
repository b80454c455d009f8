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
//! given point, both in world axes. They are computed
//!
//! - from the texture's slopes and curvatures at the largest overlap, or at all texels that count in the
//!   smooth maximum. The point (u, v, h_A) of A lies over B's height function, so its motion changes the
//!   overlap by the gradient (−∂h_B/∂u, −∂h_B/∂v, 1), and to second order by h_B's curvature. The maximum
//!   moves as well. By the envelope theorem that does not change the first derivative, and adds to the
//!   second: −φ_qs φ_ss⁻¹ φ_sq for the largest overlap, and the covariance of the gradients over τ for the
//!   smooth maximum. For the smooth maximum these are the exact derivatives of the computed δ.
//! - or from central differences of δ as in the dissertation (Eq. 4.8, 5.57, 5.58): 11 configurations of A
//!   for the gradient, 51 with the second derivatives. (∂δ/∂n is 1, and second derivatives by n are 0.)
//!
//! At the end of a surface the largest overlap is not a stationary point. Where B ends and A does not, A
//! slides over the point of B, so the gradient uses A's slopes; second derivatives are neglected there.

use glam::{DMat3, DVec2, DVec3};
use palpate_core::Pose;

use crate::backend::{Backend, BackendError};
use crate::batch::{Batch, MAX_GRID, SurfaceId, SurfaceSet};
use crate::domain::Domain;
use crate::kernels::{Answer, NOWHERE, coordinate};
use crate::maximum::{self, LocalDepth};
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
    /// ignored.
    pub reach: f64,
    /// Part of the grid in which overlaps count.
    pub domain: Domain,
}

/// Method by which derivatives are computed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Derivatives {
    /// From slopes and curvatures at the maximum.
    Maximum,
    /// By central differences.
    Differences {
        /// Step of translations, m.
        shift: f64,
        /// Step of rotations, rad.
        turn: f64,
        /// Whether second derivatives are computed as well.
        second: bool,
    },
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
    /// Method by which derivatives are computed.
    pub derivatives: Derivatives,
    /// Maximum number of Newton steps to the point that is displaced to a texel. 0 gives the dissertation's
    /// approximate height function (Eq. 4.9), which uses the displacement of the point below the texel.
    pub refinements: u32,
    /// Choice of a texture's level.
    pub filter: TextureFilter,
}

impl Default for DepthSettings {
    /// A grid of 50 × 50, the largest overlap, derivatives there, 5 Newton steps, filtered textures.
    fn default() -> Self {
        Self {
            grid: 50,
            temperature: 0.0,
            derivatives: Derivatives::Maximum,
            refinements: 5,
            filter: TextureFilter::Footprint,
        }
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
        let mut answers = self.answers.chunks_exact(settings.configurations());
        self.depths.extend(contacts.iter().map(|contact| {
            let answers = if contact.is_usable() { answers.next()? } else { return None };
            contact.depth(answers, settings)
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
            surface.gather(&view, &field, 0.0, &mut self.near);
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

    /// Adds a contact's images and pairs to the batch: one image of B, and one of A for each configuration.
    fn add(&mut self, surfaces: &SurfaceSet, contact: &TextureContact, settings: &DepthSettings) {
        let Self { batch, near, .. } = self;
        let step = contact.step(settings);
        let footprint = if settings.filter == TextureFilter::Footprint { step } else { 0.0 };
        let axes = contact.axes();
        let seen = |batch: &mut Batch, id: SurfaceId, view: &View, side: f64, near: &[u32]| {
            let first = batch.triangles.len();
            let (surface, level) = (surfaces.surface(id), surfaces.first_level(id));
            let seen = near.iter().filter_map(|&index| surface.triangle(index, view, side, footprint, level));
            batch.triangles.extend(seen);
            batch.push_image(first, side, step, contact.reach)
        };
        // One image of B serves all configurations; its triangles face against n.
        let field = |side| Field { half: contact.half_size, reach: contact.reach, side };
        let view = View::new(&contact.pose_b, &axes, contact.point);
        near.clear();
        surfaces.surface(contact.b).gather(&view, &field(-1.0), 0.0, near);
        let b = seen(batch, contact.b, &view, -1.0, near);

        let view = View::new(&contact.pose_a, &axes, contact.point);
        let center = axes.transpose() * (contact.center - contact.point);
        near.clear();
        let margin = contact.margin(center, settings);
        surfaces.surface(contact.a).gather(&view, &field(1.0), margin, near);
        // Triangles of A are gathered once, with a margin for all configurations.
        let clips = contact.domain.clips(&axes, contact.point);
        for [shift, turn] in configurations(&settings.derivatives) {
            let a = seen(batch, contact.a, &view.moved(shift, turn, center), 1.0, near);
            batch.push_pair(a, b, settings.temperature, clips);
        }
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
        if let Derivatives::Differences { shift, turn, .. } = self.derivatives {
            for (name, value) in [("shift", shift), ("turn", turn)] {
                if !(value.is_finite() && value > 0.0) {
                    return refuse(name, value, "a step above 0");
                }
            }
        }
        Ok(())
    }

    /// Number of pairs of images per contact.
    fn configurations(&self) -> usize {
        configurations(&self.derivatives).count()
    }
}

/// Number of differentiated motions: translations along u and v, and rotations about u, v and n. ∂δ/∂n is 1.
const UNKNOWNS: usize = 5;

/// Iterates over the shifts and turns of A, in a contact's frame, at which central differences need the
/// depth: none; each motion forwards and backwards; and, for second derivatives, each pair of motions with
/// all four combinations of signs: (+, +), (−, +), (+, −), (−, −).
fn configurations(derivatives: &Derivatives) -> impl Iterator<Item = [DVec3; 2]> {
    let (steps, first, second) = match *derivatives {
        Derivatives::Maximum => ([0.0; 2], false, false),
        Derivatives::Differences { shift, turn, second } => ([shift, turn], true, second),
    };
    let unit = move |unknown: usize, sign: f64| match unknown {
        0 => [DVec3::X * sign * steps[0], DVec3::ZERO],
        1 => [DVec3::Y * sign * steps[0], DVec3::ZERO],
        _ => [DVec3::ZERO, DVec3::AXES[unknown - 2] * sign * steps[1]],
    };
    let sum = |a: [DVec3; 2], b: [DVec3; 2]| [a[0] + b[0], a[1] + b[1]];
    let single = (0..UNKNOWNS).filter(move |_| first).flat_map(move |i| [unit(i, 1.0), unit(i, -1.0)]);
    let pairs = (0..UNKNOWNS).flat_map(|i| (i + 1..UNKNOWNS).map(move |j| (i, j)));
    let double = pairs.filter(move |_| second).flat_map(move |(i, j)| {
        [(1.0, 1.0), (-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)].map(|(p, q)| sum(unit(i, p), unit(j, q)))
    });
    std::iter::once([DVec3::ZERO; 2]).chain(single).chain(double)
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

    /// Returns the largest distance by which a point in the grid moves in any configuration, m.
    fn margin(&self, center: DVec3, settings: &DepthSettings) -> f64 {
        match settings.derivatives {
            Derivatives::Maximum => 0.0,
            Derivatives::Differences { shift, turn, .. } => {
                2.0 * (shift + turn * (center.length() + 2.0 * self.half_size + self.reach))
            }
        }
    }

    /// Returns the depth from the answers for a contact's pairs.
    fn depth(&self, answers: &[Answer], settings: &DepthSettings) -> Option<TextureDepth> {
        let step = self.step(settings);
        let [answer, moved @ ..] = answers else { return None };
        if answer.texel == NOWHERE {
            return None;
        }
        let at = |index: u32| f64::from(coordinate(index, settings.grid, step as f32));
        let at = |texel: u32| DVec2::new(at(texel % settings.grid), at(texel / settings.grid));
        let smooth = |answer: &Answer| {
            maximum::smooth(answer, at(answer.texel), settings.temperature, step, self.half_size)
        };
        let local = if settings.temperature > 0.0 {
            smooth(answer)?
        } else {
            maximum::largest(answer, at(answer.texel), step)
        };
        let axes = self.axes();
        let local = match settings.derivatives {
            Derivatives::Maximum => local.about(axes.transpose() * (self.center - self.point)),
            Derivatives::Differences { shift, turn, second } => {
                // As in the dissertation, the depth at the texels, without a maximum between them.
                let depth = |answer: &Answer| match answer.texel {
                    NOWHERE => None,
                    _ if settings.temperature > 0.0 => smooth(answer).map(|local| local.depth),
                    _ => Some(f64::from(answer.depth)),
                };
                differences([shift, turn], second, depth(answer)?, |index| depth(&moved[index]))?
            }
        };
        // From the contact's frame to the world.
        let at = at(answer.texel);
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

/// Returns the depth with its central differences (Eq. 4.8, 5.57, 5.58). `depth` gives the depths of
/// [`configurations`] in order, without the first, which is `here`.
fn differences(
    [shift, turn]: [f64; 2],
    second: bool,
    here: f64,
    depth: impl Fn(usize) -> Option<f64>,
) -> Option<LocalDepth> {
    // Motions 2 to 4 are rotations: components 3 to 5 of the gradient.
    let component = |unknown: usize| if unknown < 2 { unknown } else { unknown + 1 };
    let step = |unknown: usize| if unknown < 2 { shift } else { turn };
    let mut local = LocalDepth { depth: here, gradient: [0.0; 6], second: [[0.0; 6]; 6] };
    local.gradient[2] = 1.0;
    let mut next = 0;
    let mut take = || {
        next += 1;
        depth(next - 1)
    };
    for i in 0..UNKNOWNS {
        let (forwards, backwards) = (take()?, take()?);
        // Eq. 4.8: (δ₊ − δ₋) / 2h.
        local.gradient[component(i)] = (forwards - backwards) / (2.0 * step(i));
        if second {
            // Eq. 5.57: (δ₊ − 2 δ + δ₋) / h².
            local.second[component(i)][component(i)] =
                (forwards - 2.0 * here + backwards) / (step(i) * step(i));
        }
    }
    for i in 0..UNKNOWNS {
        for j in i + 1..UNKNOWNS {
            if second {
                let [both, first, other, neither] = [take()?, take()?, take()?, take()?];
                // Eq. 5.58: (δ₊₊ − δ₋₊ − δ₊₋ + δ₋₋) / 4 h_i h_j.
                let mixed = (both - first - other + neither) / (4.0 * step(i) * step(j));
                local.second[component(i)][component(j)] = mixed;
                local.second[component(j)][component(i)] = mixed;
            }
        }
    }
    Some(local)
}
