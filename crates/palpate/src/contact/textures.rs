//! The texture stage of the contact loop (§4.4, §5.4.4): coarse contacts with textured objects are looked at again, in the
//! images of their detail.
//!
//! An object's hierarchy is that of its coarse mesh, its texture displaces it. What sticks out of the coarse mesh may touch
//! before it does, so contacts are looked for by so much further away, and what lies back in it lets coarse meshes sink into
//! one another (the proxy may go as deep). Each cluster of contacts with an object is looked at in a grid around its
//! representative, of which it has the texels that are nearest to it.
//!
//! The grid is fitted to where both surfaces are, and its four quarters are looked at by themselves: surfaces that touch on
//! both flanks of a groove, or at the corners of a face, have several contacts, and one alone would let the body fall from each
//! to the next. Where quarters find the same contact, about their common corner, they are [joined]. What counts as the same is
//! told by the gradients of their depths, continuously.

use std::fmt;
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, TryRecvError};
use std::time::Duration;

use arrayvec::ArrayVec;
use palpate_collide::{Cluster, Clustering, PatchContact};
use palpate_core::glam::DVec3;
use palpate_core::{Pose, Twist};
use palpate_dynamics::CurvedContact;
use palpate_texture_pd::{
    Backend, BackendError, DepthError, DepthQuery, DepthSettings, Domain, Fallback, HalfSpace, SurfaceError,
    SurfaceId, SurfaceSet, TextureContact, TextureDepth, TexturedSurface, TooManyTexels,
};

use crate::scene::object::Object;
use crate::settings::{Settings, TextureBackend, TextureSettings};
use crate::telemetry::Events;

/// τ by default, in tolerances.
const SMOOTHNESS: f64 = 0.5;

/// Of a cluster's grid a quarter reaches this part of its half size past the middle, so that overlaps there are not at the
/// border of the quarter's grid.
const BEYOND: f64 = 0.25;

/// Quarters have contacts of their own where the gradients of their depths differ by this much (at the body's lever for
/// turns), and less and less so the closer these are.
const DISTINCT: f64 = 1.0;

/// The temperature, in tolerances, with which quarters go over into each other where the largest overlap alone is looked at.
const HARD: f64 = 1e-3;

/// Of less than this share of a contact the others of its grid are enough.
const NEGLIGIBLE: f64 = 1e-3;

/// Of a grid.
const QUARTERS: usize = 4;

/// How long a contact step waits for a GPU at most, before the processor computes its textured contacts: some periods of a contact
/// loop, which a hand feels as a short lag.
const DEADLINE: Duration = Duration::from_millis(20);

/// The part of a grid that may be folded before it is counted as no height field.
const MOSTLY: f64 = 0.1;

/// Why textures cannot be rendered.
#[derive(Debug, thiserror::Error)]
pub enum TextureError {
    /// An object's surface is empty or not finite.
    #[error("{name}: {source}")]
    Surface {
        /// The object's name.
        name: String,
        /// Why.
        source: SurfaceError,
    },
    /// All textures together are too large.
    #[error(transparent)]
    Size(#[from] TooManyTexels),
    /// A setting is out of range.
    #[error(transparent)]
    Depth(#[from] DepthError),
    /// A GPU was asked for that there is not.
    #[error(transparent)]
    Backend(#[from] BackendError),
}

/// A backend that is made elsewhere.
type Coming = Receiver<Result<Box<dyn Backend>, TextureError>>;

/// What the stage needs for a scene with textures.
pub(crate) struct Textures {
    surfaces: SurfaceSet,
    probe: SurfaceId,
    /// By the scene's order; none where neither object is textured.
    pairs: Vec<Option<Pair>>,
    settings: DepthSettings,
    backend: Fallback,
    /// How many of its failures were counted.
    failures: u64,
    /// What takes its place.
    coming: Option<Coming>,
    query: DepthQuery,
    grids: Vec<TextureContact>,
    /// The scene object of each four of them.
    grid_objects: Vec<usize>,
    found: Vec<Found>,
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
    /// How far both surfaces stick out of their coarse ones at most, m, and lie back in them.
    protrusion: f64,
    recess: f64,
}

/// A textured contact.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Found {
    /// By the scene's order.
    pub object: usize,
    pub contact: CurvedContact,
    /// Of the stiffness, 0 to 1.
    pub share: f64,
    /// Distance of texels, m.
    pub texel: f64,
}

impl Textures {
    /// `None` for a scene without textures, whose objects are given by their places. Waits for its backend to be made.
    ///
    /// # Errors
    /// If a texture cannot be rendered, or a GPU is asked for that there is not.
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
            textures.set_backend(make()?);
        }
        Ok(textures)
    }

    /// As [`new`](Self::new), in a contact step: with the backend of the textures that were before, and where there were none
    /// with the processor until one is made, in a thread.
    ///
    /// # Errors
    /// If a texture cannot be rendered: nothing has changed.
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
                std::mem::swap(&mut textures.backend, &mut before.backend);
                textures.failures = before.failures;
                textures.coming = before.coming.take();
            }
            (Some(textures), None) => textures.coming = textures.maker(settings).map(elsewhere),
            (None, _) => {}
        }
        if let Some(before) = std::mem::replace(before, textures).filter(|before| before.backend.has_other())
        {
            // A device takes its time to be dropped.
            let _ = std::thread::Builder::new().spawn(move || drop(before));
        }
        Ok(())
    }

    /// With the processor for a backend.
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
        let TextureSettings { grid, half_size, temperature, .. } = settings.textures;
        let mut surfaces = SurfaceSet::default();
        let own = surface(probe)?;
        let id = surfaces.add(&own)?;
        let pair = |object: &Option<&Object>| {
            let Some(object) = object.filter(|object| is_textured(probe, object)) else { return Ok(None) };
            let other = surface(object)?;
            let [[back, out], [other_back, other_out]] = [&own, &other].map(|surface| surface.displacement());
            let resolved = 0.5 * f64::from(grid) * own.texel().min(other.texel());
            Ok(Some(Pair {
                surface: surfaces.add(&other)?,
                clustering: Clustering::new(settings.search.clusters),
                contacts: Vec::new(),
                half_size: half_size.unwrap_or(resolved.min(lever)),
                protrusion: out + other_out,
                recess: -back - other_back,
            }))
        };
        let pairs = objects.iter().map(pair).collect::<Result<Vec<_>, TextureError>>()?;
        // As many texels in a length as the whole grid has.
        let grid = (f64::from(grid) * quarter_size(1.0)).ceil().max(2.0) as u32;
        let depth = DepthSettings {
            grid,
            temperature: temperature.unwrap_or(SMOOTHNESS * tolerance),
            ..DepthSettings::default()
        };
        Ok(Some(Self {
            surfaces,
            probe: id,
            pairs,
            settings: depth,
            backend: Fallback::default(),
            failures: 0,
            coming: None,
            query: DepthQuery::new(),
            grids: Vec::new(),
            grid_objects: Vec::new(),
            found: Vec::new(),
            lever,
        }))
    }

    /// What makes the backend that the settings ask for, if that is not the processor: the GPU's, or the faster of both for as
    /// many contacts as there may be with one object.
    #[cfg(feature = "gpu")]
    fn maker(
        &self,
        settings: &Settings,
    ) -> Option<impl FnOnce() -> Result<Box<dyn Backend>, TextureError> + Send + use<>> {
        let chosen = settings.textures.backend;
        if chosen == TextureBackend::Processor {
            return None;
        }
        let contacts = self.typical_contacts(settings.search.clusters);
        let (surfaces, depth) = (self.surfaces.clone(), self.settings);
        Some(move || -> Result<Box<dyn Backend>, TextureError> {
            if chosen == TextureBackend::Auto {
                return Ok(Box::new(palpate_texture_pd::AutoBackend::new(&surfaces, &contacts, &depth)?));
            }
            let mut gpu = palpate_texture_pd::WgpuBackend::new()?;
            // The first batch uploads the textures. What it fails at, others fail at as well, which is counted.
            let _ = DepthQuery::new().run(&surfaces, &contacts, &depth, &mut gpu);
            Ok(Box::new(gpu))
        })
    }

    #[cfg(not(feature = "gpu"))]
    #[expect(clippy::unused_self, reason = "there is one backend only")]
    fn maker(
        &self,
        settings: &Settings,
    ) -> Option<impl FnOnce() -> Result<Box<dyn Backend>, TextureError> + Send + use<>> {
        let missing = || {
            let reason = "palpate was built without its feature `gpu`".to_owned();
            Err(BackendError::NoAdapter { reason }.into())
        };
        (settings.textures.backend == TextureBackend::Gpu).then_some(missing)
    }

    /// As many contacts as there may be with one object, where the largest triangles touch.
    #[cfg(feature = "gpu")]
    fn typical_contacts(&self, clusters: usize) -> Vec<TextureContact> {
        let Some(pair) = self.pairs.iter().flatten().next() else { return Vec::new() };
        let (point, normal) = self.surfaces.surface(self.probe).middle();
        let (touched, facing) = self.surfaces.surface(pair.surface).middle();
        let rotation = palpate_core::glam::DQuat::from_rotation_arc(normal, -facing);
        let pose = Pose::new(touched - rotation * point, rotation);
        let contact = self.grid(pair, &pose, pose.translation, &Pose::IDENTITY, (touched, -facing));
        quarters(&contact).repeat(clusters)
    }

    /// Takes over the backend that is made elsewhere once it is.
    fn take_what_came(&mut self, events: &mut Events) {
        match self.coming.as_ref().map(Receiver::try_recv) {
            None | Some(Err(TryRecvError::Empty)) => {}
            Some(Ok(Ok(backend))) => self.set_backend(backend),
            Some(Ok(Err(_)) | Err(TryRecvError::Disconnected)) => {
                events.texture_backend_lost += 1;
                self.coming = None;
            }
        }
    }

    pub fn set_backend(&mut self, mut backend: Box<dyn Backend>) {
        backend.set_deadline(DEADLINE);
        self.backend = Fallback::new(backend);
        self.failures = 0;
        self.coming = None;
    }

    pub fn backend(&self) -> &str {
        self.backend.name()
    }

    /// How much further than d coarse contacts with any object are looked for, m.
    pub fn protrusion(&self) -> f64 {
        self.pairs.iter().flatten().fold(0.0, |most, pair| most.max(pair.protrusion))
    }

    /// How deep coarse meshes may sink into each scene object, m.
    pub fn recesses(&self) -> Vec<f64> {
        self.pairs.iter().map(|pair| pair.as_ref().map_or(0.0, |pair| pair.recess)).collect()
    }

    /// Whether contacts with a scene object are textured.
    pub fn has(&self, object: usize) -> bool {
        self.pairs.get(object).is_some_and(Option::is_some)
    }

    /// Forgets the coarse contacts.
    pub fn clear(&mut self) {
        self.pairs.iter_mut().flatten().for_each(|pair| pair.contacts.clear());
    }

    /// Takes a coarse contact with a scene object, as found at the pose of [`run`](Self::run), if it is near enough to count;
    /// `tolerance`: d, m.
    pub fn take(&mut self, object: usize, contact: &PatchContact, tolerance: f64) -> bool {
        let Some(Some(pair)) = self.pairs.get_mut(object) else { return false };
        let near = contact.contact.depth > -(tolerance + pair.protrusion);
        if near {
            pair.contacts.push(*contact);
        }
        near
    }

    /// The textured contacts of the probe with its mesh and centre of mass at a pose; `pose_of` those of scene objects.
    pub fn run(
        &mut self,
        mesh: &Pose,
        center: DVec3,
        pose_of: impl Fn(usize) -> Option<Pose>,
        tolerance: f64,
        events: &mut Events,
    ) -> &[Found] {
        self.take_what_came(events);
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
        self.look(tolerance, events);
        &self.found
    }

    /// The grid of a contact at a point with a normal.
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

    /// Finds the depths in all grids, on the processor if need be.
    fn look(&mut self, tolerance: f64, events: &mut Events) {
        let Self { surfaces, settings, backend, query, grids, grid_objects, found, lever, .. } = self;
        found.clear();
        if grids.is_empty() {
            return;
        }
        let looked = query.run(surfaces, grids, settings, backend).is_ok();
        let failures = backend.failures();
        events.texture_backend_lost += failures - std::mem::replace(&mut self.failures, failures);
        if !looked {
            events.contact_refused += 1;
            return;
        }
        let looked_at = grids.chunks(QUARTERS).zip(query.depths().chunks(QUARTERS));
        for ((grids, depths), &object) in looked_at.zip(&*grid_objects) {
            let mut quarters: ArrayVec<_, QUARTERS> = ArrayVec::new();
            for depth in depths.iter().flatten() {
                events.texture_folded += u64::from(depth.folded > MOSTLY);
                if !depth.is_finite() {
                    events.contact_refused += 1;
                    continue;
                }
                let TextureDepth { depth, linear, angular, second, point, .. } = *depth;
                quarters.push(CurvedContact { point, depth, linear, angular, second, lever: *lever });
            }
            let texel = grids.first().map_or(0.0, |grid| 2.0 * grid.half_size / f64::from(settings.grid));
            let joined = joined(&quarters, settings.temperature, tolerance);
            found.extend(joined.into_iter().map(|(contact, share)| Found { object, contact, share, texel }));
        }
        found.sort_unstable_by(|a, b| b.contact.depth.total_cmp(&a.contact.depth));
    }
}

impl Found {
    /// δ once the body has moved on by a small motion, m.
    pub fn depth_after(&self, motion: &Twist) -> f64 {
        let CurvedContact { depth, linear, angular, .. } = self.contact;
        depth + linear.dot(motion.linear) + angular.dot(motion.angular)
    }

    /// dδ/dt, m/s.
    pub fn rate(&self, twist: &Twist) -> f64 {
        self.contact.linear.dot(twist.linear) + self.contact.angular.dot(twist.angular)
    }

    /// Whether the body slides further than a texel in a time (s), so that detail that is felt may be missed, or felt at another
    /// frequency (§4.6.2).
    pub fn is_undersampled(&self, twist: &Twist, center: DVec3, time: f64) -> bool {
        let velocity = twist.velocity_at(self.contact.point - center);
        velocity.reject_from(self.contact.linear).length() * time > self.texel
    }
}

/// What a thread makes, where one can be had.
fn elsewhere(make: impl FnOnce() -> Result<Box<dyn Backend>, TextureError> + Send + 'static) -> Coming {
    let (send, coming) = mpsc::sync_channel(1);
    // Whoever waits for it learns from the channel that there is no thread.
    let _ = std::thread::Builder::new().name("palpate-gpu-start".into()).spawn(move || {
        // The scene may have no texture any more.
        let _ = send.send(make());
    });
    coming
}

/// The quarters of a grid.
fn quarters(grid: &TextureContact) -> [TextureContact; QUARTERS] {
    let (u, v) = grid.normal.any_orthonormal_pair();
    let half_size = quarter_size(grid.half_size);
    [(u, v), (-u, v), (u, -v), (-u, -v)].map(|(u, v)| {
        let mut domain = grid.domain;
        for direction in [-u, -v] {
            // Where there is no room for it, quarters see more of the same, which they share.
            let _ = domain.cut(HalfSpace { through: grid.point, direction });
        }
        let point = grid.point + (u + v) * (grid.half_size - half_size);
        TextureContact { point, half_size, domain, ..*grid }
    })
}

/// Half the size of a quarter's grid, m, of half that of the whole one.
fn quarter_size(half_size: f64) -> f64 {
    0.5 * (1.0 + BEYOND) * half_size
}

/// The contacts of a grid's quarters, each joined with those that are alike: the smooth maximum over them, of which each has
/// the share of the stiffness that it contributes. Quarters that are all alike so make the smooth maximum over the whole grid,
/// with its derivatives; ones that differ make contacts of their own.
fn joined(
    quarters: &[CurvedContact],
    temperature: f64,
    tolerance: f64,
) -> ArrayVec<(CurvedContact, f64), QUARTERS> {
    let soft = temperature.max(HARD * tolerance);
    let join = |own: &CurvedContact| {
        let likeness: ArrayVec<f64, QUARTERS> = quarters.iter().map(|other| likeness(own, other)).collect();
        let alike = || quarters.iter().zip(&likeness).filter(|(_, likeness)| **likeness > 0.0);
        let deepest = alike().fold(own.depth, |deepest, (other, _)| deepest.max(other.depth));
        let weight = |depth: f64| ((depth - deepest) / soft).exp();
        let total: f64 = alike().map(|(other, likeness)| likeness * weight(other.depth)).sum();
        let weighted = || alike().map(|(other, likeness)| (other, likeness * weight(other.depth) / total));
        let mut contact = CurvedContact {
            point: weighted().map(|(one, weight)| one.point * weight).sum(),
            depth: deepest + soft * total.ln(),
            linear: weighted().map(|(one, weight)| one.linear * weight).sum(),
            angular: weighted().map(|(one, weight)| one.angular * weight).sum(),
            second: [[0.0; 6]; 6],
            ..*own
        };
        for (one, weight) in weighted() {
            let (linear, angular) = (one.linear - contact.linear, one.angular - contact.angular);
            let apart = [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z];
            for (i, row) in contact.second.iter_mut().enumerate() {
                for (j, value) in row.iter_mut().enumerate() {
                    *value += weight * (one.second[i][j] + apart[i] * apart[j] / soft);
                }
            }
        }
        (contact, weight(own.depth) / total)
    };
    quarters.iter().map(join).filter(|(_, share)| *share > NEGLIGIBLE).collect()
}

/// 1 for contacts that push in the same way, less for others, and 0 for those that are distinct.
fn likeness(a: &CurvedContact, b: &CurvedContact) -> f64 {
    let apart = (a.linear - b.linear).length().hypot((a.angular - b.angular).length() / a.lever);
    let alike = (1.0 - apart / DISTINCT).clamp(0.0, 1.0);
    alike * alike * (3.0 - 2.0 * alike)
}

impl fmt::Debug for Textures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let textured = self.pairs.iter().flatten().count();
        write!(f, "Textures of {textured} pairs on {}", self.backend.name())
    }
}

fn is_textured(probe: &Object, other: &Object) -> bool {
    probe.texture().is_some() || other.texture().is_some()
}

fn surface(object: &Object) -> Result<Arc<TexturedSurface>, TextureError> {
    object.surface().map_err(|source| TextureError::Surface { name: object.name.clone(), source })
}

#[cfg(all(test, feature = "gpu"))]
mod tests {
    use std::time::Instant;

    use palpate_core::TriMesh;
    use palpate_core::glam::DVec2;
    use palpate_core::mesh::UvMesh;
    use palpate_texture_pd::{HeightImage, Wrap};

    use super::*;

    /// A tetrahedron, all of its texture at one height.
    fn object() -> Object {
        let corners = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|corner| corner * 0.01).to_vec();
        let mesh = TriMesh::new(corners, vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]).unwrap();
        let mesh = UvMesh::projected(mesh, |corner| DVec2::new(corner.x, corner.y) * 100.0).unwrap();
        let image = HeightImage::new(2, 2, vec![1e-4; 4], [Wrap::Clamp; 2]).unwrap();
        Object::textured("tetrahedron", &mesh, &image, 1.0).unwrap()
    }

    /// The processor serves until a backend has been made elsewhere; that stays as objects come and go.
    #[test]
    fn backend_is_made_elsewhere_taken_in_when_ready_and_kept() {
        let (probe, other) = (object(), object());
        let mut settings = Settings::default();
        settings.textures.backend = TextureBackend::Gpu;
        let mut textures = None;
        let renew = |textures: &mut Option<Textures>, objects: &[Option<&Object>]| {
            Textures::renew(textures, &probe, objects, &settings, 1e-3, 0.02).unwrap();
        };
        let mut events = Events::default();
        let mut run = |textures: &mut Textures| {
            textures.run(&Pose::IDENTITY, DVec3::ZERO, |_| None, 1e-3, &mut events);
            (textures.backend().to_owned(), events.texture_backend_lost)
        };
        renew(&mut textures, &[Some(&other)]);
        let made = textures.as_mut().unwrap();
        assert_eq!(made.backend(), "CPU");
        let begun = Instant::now();
        while run(made).0 == "CPU" {
            assert!(begun.elapsed().as_secs() < 60, "no backend came");
            std::thread::sleep(Duration::from_millis(5));
        }
        let (name, lost) = run(made);
        assert_eq!(lost, 0);
        renew(&mut textures, &[Some(&other), Some(&other)]);
        let renewed = textures.as_ref().unwrap();
        assert!(renewed.backend() == name && renewed.coming.is_none(), "{renewed:?}");
        renew(&mut textures, &[]);
        assert!(textures.is_none());
    }

    /// One that could not be made is counted.
    #[test]
    fn backend_that_could_not_be_made_is_counted() {
        let mut textures = None;
        let (probe, other) = (object(), object());
        Textures::renew(&mut textures, &probe, &[Some(&other)], &Settings::default(), 1e-3, 0.02).unwrap();
        let textures = textures.as_mut().unwrap();
        let mut events = Events::default();
        for make in [false, true] {
            let made = || Err(BackendError::NoAdapter { reason: "none".into() }.into());
            textures.coming = Some(if make { elsewhere(made) } else { mpsc::sync_channel(1).1 });
            let begun = Instant::now();
            while textures.coming.is_some() {
                assert!(begun.elapsed().as_secs() < 60, "nothing came");
                textures.run(&Pose::IDENTITY, DVec3::ZERO, |_| None, 1e-3, &mut events);
            }
        }
        assert_eq!((events.texture_backend_lost, textures.backend()), (2, "CPU"));
    }
}
