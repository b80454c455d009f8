//! Representative contacts in a session: those of distance fields, weighed by the area that they stand for.
//!
//! The proxy is planned with the deepest places of each cell. What the body feels is the law
//! ([`AreaLaw`](palpate_field::AreaLaw)) of the contacts at the proxy, each carried to where its plane has the body: their force at
//! the body's pose is **F** = −K k Σ w (δ + d) **n**. By levels each of K clusters pushes with k, and nearly all of them do wherever
//! bodies touch; so what the law takes for one place is K times as stiff. Contacts are looked for as much further than d as the proxy
//! lags behind the body. Where that is more than fields know, weights fade out on the last part of the way, so that none comes in with
//! a push.
//!
//! The law weighs all contacts together, whatever scene objects they are with. Then those with objects that stand still become
//! few planes ([`Merging`]), and so do those with each object that moves.

use std::sync::Arc;
use std::time::Duration;

use palpate_collide::{ObjectHandle, PatchContact, SceneQuery};
use palpate_core::clod::NO_NODE;
use palpate_core::glam::DVec3;
use palpate_core::{Contact, Pose};
use palpate_field::{AreaContact, AreaLaw, FieldOptions, FieldQuery, FieldSettings};

use super::group::ContactGroup;
use super::in_scene::InScene;
use crate::contact::merging::{Plane, Weighed};
use crate::contact::proxy::{ContactFinder, ProxyContact, QueryReport, carried};
use crate::contact::representative::{USUAL_ERROR, check_error, lattice, law};
use crate::scene::field::{Field, FieldError, field_options, find, new_query};
use crate::scene::object::Object;
use crate::settings::Settings;

/// How far is looked goes in steps of this, in tolerances.
const STEP: f64 = 0.5;

/// Weights fade out over this part of what fields know beyond d.
const FADING: f64 = 0.25;

/// Contacts that there is room for from the start: as many as there may be with four objects.
const MOST: usize = 1024;

/// EPS where none is asked for is no more than this part of the tolerance: as many samples are around a place as at the usual tolerance.
const USUAL_PART: f64 = 0.05;

/// What fields of a session are made with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FieldNeeds {
    options: FieldOptions,
    /// EPS, m.
    error: f64,
    budget: Option<Duration>,
}

impl FieldNeeds {
    /// For contacts within a tolerance (m).
    pub fn new(tolerance: f64, settings: &Settings, probe: &Object) -> Result<Self, FieldError> {
        if let Some(error) = settings.search.representative_error {
            check_error(error, probe)?;
        }
        let usual = (USUAL_ERROR * probe.bounding_radius()).min(USUAL_PART * tolerance);
        let error = settings.search.representative_error.unwrap_or(usual);
        Ok(Self {
            options: field_options(tolerance),
            error,
            budget: settings.detail.query_budget.map(Duration::from_secs_f64),
        })
    }

    /// d, m.
    pub fn tolerance(&self) -> f64 {
        self.options.tolerance
    }

    /// What fields are made with.
    pub fn options(&self) -> FieldOptions {
        self.options
    }

    /// EPS, m.
    pub fn error(&self) -> f64 {
        self.error
    }

    /// Limits the time of each query (s), or no longer.
    pub fn set_budget(&mut self, budget: Option<f64>) {
        self.budget = budget.map(Duration::from_secs_f64);
    }

    /// The field of an object, made if need be.
    pub fn of(&self, object: &Object) -> Result<Arc<Field>, FieldError> {
        object.field(self.options)
    }

    /// The lattice constant that the field of an object has, about, m.
    pub fn lattice(&self, object: &Object) -> f64 {
        lattice(object, &self.options)
    }

    /// What queries ask for that look as far as a reach (m): the error in proportion, so that they read as much.
    fn settings(&self, reach: f64) -> FieldSettings {
        let error = self.error * reach / self.options.tolerance;
        FieldSettings { error, budget: self.budget, ..FieldSettings::new(reach) }
    }
}

/// The probe's side of contacts by fields, with all workspaces.
#[derive(Debug)]
pub(super) struct ByFields {
    pub needs: FieldNeeds,
    probe: Arc<Field>,
    law: AreaLaw,
    /// K: how many times as stiff as one cluster a place is.
    stiffness: f64,
    /// By the places of the scene's objects.
    sides: Vec<Option<Side>>,
    /// What was found last, and with the mesh's frame at which pose, within which reach (m).
    found: Vec<AreaContact>,
    /// The places of the objects that they are with.
    places: Vec<usize>,
    at: Option<(Pose, f64)>,
    /// Contacts as the body has them.
    carried: Vec<AreaContact>,
    weights: Vec<f64>,
    /// Those of one group.
    weighed: Vec<Weighed>,
    planes: Vec<(Option<usize>, Plane)>,
}

/// A scene object's side. Queries go on from what they found last within the same reach, which is another one for the proxy than for
/// what is felt.
#[derive(Debug)]
struct Side {
    field: Arc<Field>,
    queries: [Option<FieldQuery>; 2],
}

/// What is looked for.
#[derive(Clone, Copy, Debug)]
enum Purpose {
    Proxy,
    Push,
}

impl ByFields {
    pub fn new(needs: FieldNeeds, probe: &Object, clusters: usize) -> Result<Self, FieldError> {
        let mut law = law(probe);
        // Its workspace grows with the contacts that it has seen.
        let contact = Contact {
            point: DVec3::ZERO,
            scene_point: DVec3::ZERO,
            normal: DVec3::Z,
            depth: f64::NEG_INFINITY,
        };
        law.weights(&[AreaContact { contact, area: 0.0 }; MOST], needs.tolerance(), &Pose::IDENTITY);
        Ok(Self {
            needs,
            probe: needs.of(probe)?,
            law,
            stiffness: clusters as f64,
            sides: Vec::new(),
            found: Vec::with_capacity(MOST),
            places: Vec::with_capacity(MOST),
            at: None,
            carried: Vec::with_capacity(MOST),
            weights: Vec::with_capacity(MOST),
            weighed: Vec::with_capacity(MOST),
            planes: Vec::with_capacity(64),
        })
    }

    /// Puts an object at a place, with a workspace if it is to have one from the start.
    pub fn insert(&mut self, place: usize, object: &Object, reserved: bool) -> Result<(), FieldError> {
        let field = self.needs.of(object)?;
        if self.sides.len() <= place {
            self.sides.resize_with(place + 1, || None);
        }
        let queries = [(); 2].map(|()| reserved.then(|| new_query(&self.probe, &field)));
        self.sides[place] = Some(Side { field, queries });
        self.at = None;
        Ok(())
    }

    /// Takes the object at a place out.
    pub fn remove(&mut self, place: usize) {
        if let Some(side) = self.sides.get_mut(place) {
            *side = None;
        }
        self.at = None;
    }

    /// What was found holds no longer.
    pub fn scene_has_changed(&mut self) {
        self.at = None;
    }

    /// How far it can look, m.
    pub fn furthest(&self) -> f64 {
        self.needs.options.band
    }

    /// Bytes of memory that workspaces and fields hold.
    pub fn bytes(&self) -> usize {
        let sides = || self.sides.iter().flatten();
        let queries = sides().flat_map(|side| &side.queries).flatten().map(FieldQuery::bytes).sum::<usize>();
        // Objects may share a field.
        let mut fields: Vec<&Arc<Field>> = vec![&self.probe];
        for Side { field, .. } in sides() {
            if !fields.iter().any(|known| Arc::ptr_eq(known, field)) {
                fields.push(field);
            }
        }
        queries + fields.into_iter().map(|field| field.bytes()).sum::<usize>()
    }

    /// Looks for contacts with all objects near, with the mesh's frame at a pose, if it did not do so last; `false` if an object
    /// could not be looked at.
    fn look(
        &mut self,
        purpose: Purpose,
        mesh: &Pose,
        reach: f64,
        scene: &mut SceneQuery,
        report: &mut QueryReport,
    ) -> bool {
        if self.at == Some((*mesh, reach)) {
            return true;
        }
        self.found.clear();
        self.places.clear();
        self.at = None;
        let Ok(invalid) = scene.find_near(mesh, reach) else {
            report.refused = true;
            return false;
        };
        let settings = self.needs.settings(reach);
        let near = |handle: ObjectHandle| Some((handle.place(), *scene.pose(handle)?));
        for (place, pose) in scene.near().filter_map(near) {
            let Some(Some(Side { field, queries })) = self.sides.get_mut(place) else { continue };
            let query = queries[purpose as usize].get_or_insert_with(|| new_query(&self.probe, field));
            find(query, (&self.probe, mesh), (field, &pose), &settings, &mut self.found);
            self.places.resize(self.found.len(), place);
        }
        report.refused |= invalid > 0;
        if invalid == 0 {
            self.at = Some((*mesh, reach));
        }
        invalid == 0
    }

    /// The deepest places of cells: with no area, since they are among what others stand for.
    fn deepest(&self) -> impl Iterator<Item = ProxyContact> {
        let pairs = self.found.iter().zip(&self.places).filter(|(found, _)| found.area == 0.0);
        pairs.map(|(found, &object)| {
            let contact = PatchContact {
                contact: found.contact,
                probe_node: NO_NODE,
                scene_node: NO_NODE,
                weight: 1.0,
            };
            ProxyContact::new(contact, object)
        })
    }

    /// The planes that push a body as the law has it, the strongest first, each with the place of the object that it is with, if
    /// that moves. The proxy is at one pose of the centre of mass and the body at another (m: how far they are apart), and
    /// `center` is that of the mesh's frame in the body's.
    pub fn planes(
        &mut self,
        (proxy, body): (&Pose, &Pose),
        lag: f64,
        to_mesh: &Pose,
        tolerance: f64,
        scene: &mut SceneQuery,
        (still, objects, moving): (&mut ContactGroup, &mut [Option<InScene>], &[usize]),
    ) -> &[(Option<usize>, Plane)] {
        let reach = (tolerance + in_steps(lag, tolerance)).min(self.furthest()).max(tolerance);
        // What cannot be looked at was counted when the proxy report.
        self.look(Purpose::Push, &(*proxy * *to_mesh), reach, scene, &mut QueryReport::default());
        self.carried.clear();
        self.carried.extend(
            self.found
                .iter()
                .map(|found| AreaContact { contact: carried(&found.contact, proxy, body), area: found.area }),
        );
        let mesh = *body * *to_mesh;
        self.weights.clear();
        self.weights.extend_from_slice(self.law.weights(&self.carried, tolerance, &mesh));
        let faded = FADING * (self.furthest() - tolerance);
        let furthest = self.furthest();
        for (weight, found) in self.weights.iter_mut().zip(&self.found) {
            *weight *= self.stiffness * ((found.contact.depth + furthest) / faded).clamp(0.0, 1.0);
        }
        self.merge(tolerance, &mesh, (still, objects, moving));
        &self.planes
    }

    /// Makes planes of the weighed contacts: of those with objects that stand still together, and of those with each that moves.
    fn merge(
        &mut self,
        tolerance: f64,
        mesh: &Pose,
        (still, objects, moving): (&mut ContactGroup, &mut [Option<InScene>], &[usize]),
    ) {
        let Self { carried, weights, places, weighed, planes, .. } = self;
        planes.clear();
        let gather = |weighed: &mut Vec<Weighed>, belongs: &dyn Fn(usize) -> bool| {
            weighed.clear();
            let all = carried.iter().zip(weights.iter()).zip(places.iter());
            weighed.extend(
                all.filter(|((_, weight), place)| **weight > 0.0 && belongs(**place))
                    .map(|((found, weight), _)| Weighed { contact: found.contact, weight: *weight }),
            );
        };
        gather(weighed, &|place| !moving.contains(&place));
        planes.extend(still.merging.run(weighed, tolerance, mesh).iter().map(|plane| (None, *plane)));
        for &place in moving {
            let Some(Some(InScene { moving: Some(moving), .. })) = objects.get_mut(place) else { continue };
            gather(weighed, &|of| of == place);
            let own = moving.1.merging.run(weighed, tolerance, mesh);
            planes.extend(own.iter().map(|plane| (Some(place), *plane)));
        }
        let push = |(_, plane): &(Option<usize>, Plane)| plane.weight * (plane.contact.depth + tolerance);
        // By insertion: they are few, and those that push alike keep their order.
        for index in 1..planes.len() {
            let mut at = index;
            while at > 0 && push(&planes[at - 1]) < push(&planes[at]) {
                planes.swap(at - 1, at);
                at -= 1;
            }
        }
    }
}

/// How far a body is from its proxy (m), in whole steps, so that how far is looked seldom changes.
pub(super) fn in_steps(lag: f64, tolerance: f64) -> f64 {
    (lag / (STEP * tolerance)).ceil() * STEP * tolerance
}

/// For a proxy.
pub(super) struct FieldFinder<'a> {
    pub by_fields: &'a mut ByFields,
    pub scene: &'a mut SceneQuery,
    /// m.
    pub reach: f64,
}

impl ContactFinder for FieldFinder<'_> {
    const CONTACTS_JUMP: bool = false;

    fn reach(&self) -> f64 {
        self.reach
    }

    fn find(&mut self, mesh: &Pose, report: &mut QueryReport) -> bool {
        self.by_fields.look(Purpose::Proxy, mesh, self.reach, self.scene, report)
    }

    fn contacts(&self) -> impl Iterator<Item = ProxyContact> {
        self.by_fields.deepest()
    }

    fn depths(&self) -> impl Iterator<Item = (usize, f64)> {
        self.by_fields.deepest().map(|found| (found.object, found.contact.contact.depth))
    }
}
