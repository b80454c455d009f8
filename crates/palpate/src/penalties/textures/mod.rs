//! Textured contacts (§4.4, §5.4.4): coarse contacts with textured objects are evaluated again on the images
//! of their detail.
//!
//! An object's hierarchy is that of its coarse mesh; its texture displaces the surface. Where it displaces it
//! outwards, contact begins before the coarse meshes touch, so coarse contacts are searched for at a distance
//! larger by the [protrusion](Textures::protrusion). Where it displaces it inwards, coarse meshes may sink
//! into each other by the [recess](Textures::recesses), and the proxy goes as deep.
//!
//! Each cluster of coarse contacts with an object has a grid around its representative, with the texels that
//! are nearest to it. The grid is fitted to where both surfaces are, and evaluated in [quarters].

mod backend;
mod error;
mod quarters;

use std::fmt;
use std::sync::Arc;

use arrayvec::ArrayVec;
use palpate_collide::{Cluster, Clustering, PatchContact};
use palpate_core::glam::DVec3;
use palpate_core::{Pose, Twist};
use palpate_dynamics::CurvedContact;
use palpate_texture_pd::{
    Backend, DepthQuery, DepthSettings, Domain, SurfaceId, SurfaceSet, TextureContact, TextureDepth,
    TexturedSurface,
};

use self::backend::{Computing, Maker, maker};
pub use self::error::TextureError;
use self::quarters::{QUARTERS, joined, quarter_size, quarters};
use crate::scene::object::Object;
use crate::settings::{Settings, TextureSettings};
use crate::telemetry::Events;

/// Default temperature τ, in tolerances d. Less lets forces jump between texels, more rounds the texture off.
const DEFAULT_TEMPERATURE: f64 = 0.5;

/// Part of a grid that may be folded as seen along the normal; above it the depth is counted as approximate.
const MAX_FOLDED: f64 = 0.1;

/// The textured contacts of a probe with a scene.
pub(crate) struct Textures {
    surfaces: SurfaceSet,
    probe: SurfaceId,
    /// A pair for each scene object, in order; `None` where neither object is textured.
    pairs: Vec<Option<Pair>>,
    settings: DepthSettings,
    computing: Computing,
    query: DepthQuery,
    grids: Vec<TextureContact>,
    /// Scene object of each four grids.
    grid_objects: Vec<usize>,
    found: Vec<TexturedContact>,
    /// Bounding radius of the probe about its centre of mass, m.
    lever: f64,
}

/// The probe and a scene object, one of which is textured.
struct Pair {
    surface: SurfaceId,
    clustering: Clustering,
    contacts: Vec<PatchContact>,
    /// Half the side of grids, m.
    half_size: f64,
    /// Largest outward displacement of both surfaces together, m.
    protrusion: f64,
    /// Largest inward displacement, m.
    recess: f64,
}

/// A textured contact.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TexturedContact {
    /// Index of the scene object.
    pub object: usize,
    pub contact: CurvedContact,
    /// Share of the contact stiffness, 0 to 1.
    pub share: f64,
    /// Distance between texels, m.
    pub texel: f64,
}

impl Textures {
    /// Returns `None` for a scene without textures. An object that is gone is `None` in `objects`. Waits
    /// until the backend is made.
    ///
    /// # Errors
    /// If a texture cannot be rendered, or the settings ask for a GPU and there is none.
    pub fn new(
        probe: &Object,
        objects: &[Option<&Object>],
        settings: &Settings,
        tolerance: f64,
        lever: f64,
    ) -> Result<Option<Self>, TextureError> {
        let mut textures = Self::on_processor(probe, objects, settings, tolerance, lever)?;
        if let Some(textures) = &mut textures
            && let Some(make) = textures.maker(settings)
        {
            textures.computing.set(make()?);
        }
        Ok(textures)
    }

    /// Like [`new`](Self::new), but in a contact step: keeps the backend of `before`. Where there was none,
    /// the processor computes until a thread has made one.
    ///
    /// # Errors
    /// If a texture cannot be rendered; `before` is then unchanged.
    pub fn renew(
        before: &mut Option<Self>,
        probe: &Object,
        objects: &[Option<&Object>],
        settings: &Settings,
        tolerance: f64,
        lever: f64,
    ) -> Result<(), TextureError> {
        let mut textures = Self::on_processor(probe, objects, settings, tolerance, lever)?;
        match (&mut textures, before.as_mut()) {
            (Some(textures), Some(before)) => {
                textures.computing = std::mem::take(&mut before.computing);
            }
            (Some(textures), None) => {
                if let Some(make) = textures.maker(settings) {
                    textures.computing.set_when_made(make);
                }
            }
            (None, _) => {}
        }
        let before = std::mem::replace(before, textures);
        if let Some(before) = before.filter(|before| before.computing.has_other()) {
            // To drop a GPU device takes longer than a contact step.
            let _ = std::thread::Builder::new().spawn(move || drop(before));
        }
        Ok(())
    }

    /// Like [`new`](Self::new), with the processor as the backend.
    fn on_processor(
        probe: &Object,
        objects: &[Option<&Object>],
        settings: &Settings,
        tolerance: f64,
        lever: f64,
    ) -> Result<Option<Self>, TextureError> {
        if objects.iter().flatten().all(|object| !is_textured(probe, object)) {
            return Ok(None);
        }
        let TextureSettings { grid, temperature, .. } = settings.textures;
        let mut surfaces = SurfaceSet::default();
        let own = surface(probe)?;
        let id = surfaces.add(&own)?;
        let pair = |object: &Option<&Object>| {
            let Some(object) = object.filter(|object| is_textured(probe, object)) else { return Ok(None) };
            let other = surface(object)?;
            Ok(Some(Pair::new(surfaces.add(&other)?, [&own, &other], settings, lever)))
        };
        let pairs = objects.iter().map(pair).collect::<Result<Vec<_>, TextureError>>()?;
        // A quarter has as many texels per length as the whole grid would have.
        let grid = (f64::from(grid) * quarter_size(1.0)).ceil().max(2.0) as u32;
        let depth = DepthSettings {
            grid,
            temperature: temperature.unwrap_or(DEFAULT_TEMPERATURE * tolerance),
            ..DepthSettings::default()
        };
        Ok(Some(Self {
            surfaces,
            probe: id,
            pairs,
            settings: depth,
            computing: Computing::default(),
            query: DepthQuery::new(),
            grids: Vec::new(),
            grid_objects: Vec::new(),
            found: Vec::new(),
            lever,
        }))
    }

    /// Returns the maker of the backend that the settings ask for, if that is not the processor.
    fn maker(&self, settings: &Settings) -> Option<Maker> {
        let typical = || self.typical_contacts(settings.search.clusters);
        maker(settings.textures.backend, &self.surfaces, self.settings, typical)
    }

    /// As many contacts as there may be with one object, where the largest triangles touch.
    fn typical_contacts(&self, clusters: usize) -> Vec<TextureContact> {
        let Some(pair) = self.pairs.iter().flatten().next() else { return Vec::new() };
        let (point, normal) = self.surfaces.surface(self.probe).middle();
        let (touched, facing) = self.surfaces.surface(pair.surface).middle();
        let rotation = palpate_core::glam::DQuat::from_rotation_arc(normal, -facing);
        let pose = Pose::new(touched - rotation * point, rotation);
        let contact = self.grid(pair, &pose, pose.translation, &Pose::IDENTITY, (touched, -facing));
        quarters(&contact).repeat(clusters)
    }

    /// Replaces the backend.
    pub fn set_backend(&mut self, backend: Box<dyn Backend>) {
        self.computing.set(backend);
    }

    /// Name of the backend.
    pub fn backend(&self) -> &str {
        self.computing.name()
    }

    /// Distance beyond the tolerance d at which coarse contacts with any object are searched for, m.
    pub fn protrusion(&self) -> f64 {
        self.pairs.iter().flatten().fold(0.0, |most, pair| most.max(pair.protrusion))
    }

    /// Depth by which coarse meshes may sink into each scene object, m.
    pub fn recesses(&self) -> Vec<f64> {
        self.pairs.iter().map(|pair| pair.as_ref().map_or(0.0, |pair| pair.recess)).collect()
    }

    /// Whether contacts with a scene object are textured.
    pub fn has(&self, object: usize) -> bool {
        self.pairs.get(object).is_some_and(Option::is_some)
    }

    /// Removes the coarse contacts.
    pub fn clear(&mut self) {
        self.pairs.iter_mut().flatten().for_each(|pair| pair.contacts.clear());
    }

    /// Adds a coarse contact with a scene object, found at the pose of [`run`](Self::run), if it is near
    /// enough to touch at the tolerance d (m). Returns whether it is.
    pub fn take(&mut self, object: usize, contact: &PatchContact, tolerance: f64) -> bool {
        let Some(Some(pair)) = self.pairs.get_mut(object) else { return false };
        let near = contact.contact.depth > -(tolerance + pair.protrusion);
        if near {
            pair.contacts.push(*contact);
        }
        near
    }

    /// Finds the textured contacts of the probe, with its mesh at a pose and its centre of mass at `center`;
    /// `pose_of` gives the poses of scene objects.
    pub fn run(
        &mut self,
        mesh: &Pose,
        center: DVec3,
        pose_of: impl Fn(usize) -> Option<Pose>,
        tolerance: f64,
        events: &mut Events,
    ) -> &[TexturedContact] {
        self.computing.update(events);
        let mut pairs = std::mem::take(&mut self.pairs);
        self.grids.clear();
        self.grid_objects.clear();
        for (object, pair) in pairs.iter_mut().enumerate() {
            let Some(pair) = pair else { continue };
            let Some(pose) = pose_of(object) else { continue };
            pair.clustering.run(&pair.contacts, tolerance + pair.protrusion, mesh);
            let clusters = pair.clustering.clusters();
            for (i, &Cluster { contact, .. }) in clusters.iter().enumerate() {
                let others = clusters.iter().enumerate().filter(|(j, _)| *j != i);
                let others = others.map(|(_, cluster)| cluster.contact.point);
                let grid = self.grid(pair, mesh, center, &pose, (contact.point, contact.normal));
                let domain = Domain::nearest(contact.point, others, contact.normal);
                let grid = TextureContact { domain, ..grid };
                let margin = pair.protrusion + pair.recess;
                if let Some(fitted) = self.query.fitted(&self.surfaces, &grid, margin) {
                    self.grids.extend(quarters(&fitted));
                    self.grid_objects.push(object);
                }
            }
        }
        self.pairs = pairs;
        self.evaluate(tolerance, events);
        &self.found
    }

    /// Returns the grid of a contact at a point with a normal.
    fn grid(
        &self,
        pair: &Pair,
        pose_a: &Pose,
        center: DVec3,
        pose_b: &Pose,
        (point, normal): (DVec3, DVec3),
    ) -> TextureContact {
        TextureContact {
            a: self.probe,
            pose_a: *pose_a,
            center,
            b: pair.surface,
            pose_b: *pose_b,
            normal,
            point,
            half_size: pair.half_size,
            reach: pair.half_size + pair.protrusion + pair.recess,
            domain: Domain::WHOLE,
        }
    }

    /// Evaluates the depths in all grids.
    fn evaluate(&mut self, tolerance: f64, events: &mut Events) {
        let Self { surfaces, settings, computing, query, grids, grid_objects, found, lever, .. } = self;
        found.clear();
        if grids.is_empty() || !computing.run(query, surfaces, grids, settings, events) {
            return;
        }
        let evaluated = grids.chunks(QUARTERS).zip(query.depths().chunks(QUARTERS));
        for ((grids, depths), &object) in evaluated.zip(&*grid_objects) {
            let mut quarters: ArrayVec<_, QUARTERS> = ArrayVec::new();
            for depth in depths.iter().flatten() {
                events.texture_folded += u64::from(depth.folded > MAX_FOLDED);
                if !depth.is_finite() {
                    events.contact_refused += 1;
                    continue;
                }
                let TextureDepth { depth, linear, angular, second, point, .. } = *depth;
                quarters.push(CurvedContact { point, depth, linear, angular, second, lever: *lever });
            }
            let texel = grids.first().map_or(0.0, |grid| 2.0 * grid.half_size / f64::from(settings.grid));
            let joined = joined(&quarters, settings.temperature, tolerance);
            let contacts =
                joined.into_iter().map(|(contact, share)| TexturedContact { object, contact, share, texel });
            found.extend(contacts);
        }
        found.sort_unstable_by(|a, b| b.contact.depth.total_cmp(&a.contact.depth));
    }
}

impl Pair {
    /// The pair of a probe's surface and another, which is `surface` among the surfaces; grids are at most as
    /// large as `lever` (m).
    fn new(surface: SurfaceId, [own, other]: [&TexturedSurface; 2], settings: &Settings, lever: f64) -> Self {
        let TextureSettings { grid, half_size, .. } = settings.textures;
        let [[back, out], [other_back, other_out]] = [own, other].map(TexturedSurface::displacement);
        let resolved = 0.5 * f64::from(grid) * own.texel().min(other.texel());
        Self {
            surface,
            clustering: Clustering::new(settings.search.clusters),
            contacts: Vec::new(),
            half_size: half_size.unwrap_or(resolved.min(lever)),
            protrusion: out + other_out,
            recess: -back - other_back,
        }
    }
}

impl TexturedContact {
    /// Returns the depth after the body has moved by a small motion, to first order, m.
    pub fn depth_after(&self, motion: &Twist) -> f64 {
        let CurvedContact { depth, linear, angular, .. } = self.contact;
        depth + linear.dot(motion.linear) + angular.dot(motion.angular)
    }

    /// Returns the rate of the depth, dδ/dt, m/s.
    pub fn rate(&self, twist: &Twist) -> f64 {
        self.contact.linear.dot(twist.linear) + self.contact.angular.dot(twist.angular)
    }

    /// Returns whether the body slides further than a texel in a time (s), so that detail may be missed or
    /// felt at another frequency (§4.6.2).
    pub fn is_undersampled(&self, twist: &Twist, center: DVec3, time: f64) -> bool {
        let velocity = twist.velocity_at(self.contact.point - center);
        velocity.reject_from(self.contact.linear).length() * time > self.texel
    }
}

impl fmt::Debug for Textures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let textured = self.pairs.iter().flatten().count();
        write!(f, "Textures of {textured} pairs on {}", self.computing.name())
    }
}

fn is_textured(probe: &Object, other: &Object) -> bool {
    probe.texture().is_some() || other.texture().is_some()
}

fn surface(object: &Object) -> Result<Arc<TexturedSurface>, TextureError> {
    object.surface().map_err(|source| TextureError::Surface { name: object.name.clone(), source })
}

#[cfg(test)]
mod tests;
