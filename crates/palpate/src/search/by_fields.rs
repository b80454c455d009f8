//! Representative contacts of a session, found in distance fields and weighted by the area that they
//! represent.
//!
//! The proxy's motion is planned with the deepest places of each cell. The body feels the area law
//! ([`AreaLaw`](palpate_field::AreaLaw)) of the contacts at the proxy, each carried to the body's pose with
//! its plane fixed: **F** = −K k Σ w (δ + d) **n**. In the search by levels each of K clusters pushes with k,
//! and nearly all of them do wherever bodies touch; so a place of contact is K times as stiff here as one
//! cluster. The reach exceeds d by the lag of the proxy behind the body. Weights fade out near the limit of
//! what fields cover, so that no contact appears with a push.
//!
//! The law weights all contacts together, whichever scene objects they are with. Then the contacts with still
//! objects are reduced to few planes ([`Merging`](crate::penalties::merging::Merging)), and so are those with
//! each moving object.

use std::sync::Arc;
use std::time::Duration;

use palpate_collide::{ObjectHandle, PatchContact, SceneQuery};
use palpate_core::clod::NO_NODE;
use palpate_core::glam::DVec3;
use palpate_core::{Contact, Pose};
use palpate_field::{AreaContact, AreaLaw, FieldOptions, FieldQuery, FieldSettings};

use crate::penalties::group::ContactGroup;
use crate::penalties::in_scene::InScene;
use crate::penalties::merging::{Plane, WeightedContact};
use crate::penalties::proxy::{ContactFinder, ProxyContact, QueryReport, carried};
use crate::scene::field::{Field, FieldError, field_options, find, new_query};
use crate::scene::object::Object;
use crate::search::representative::{DEFAULT_ERROR, check_error, lattice, law};
use crate::settings::Settings;

/// Steps in which the reach changes, in tolerances d. With smaller ones it changes often, and queries start
/// from scratch.
const REACH_STEP: f64 = 0.5;

/// Fraction of the depth of fields beyond d over which weights fade out. With less, contacts appear with a
/// push.
const FADE_SHARE: f64 = 0.25;

/// Number of contacts that there is room for from the start: those with four objects, at most.
const RESERVED: usize = 1024;

/// Largest default EPS, in tolerances d: then a place of contact has as many samples as with the default
/// tolerance.
const MAX_DEFAULT_ERROR: f64 = 0.05;

/// Options that the fields of a session are made with, and limits of its queries.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FieldNeeds {
    options: FieldOptions,
    /// EPS, m.
    error: f64,
    budget: Option<Duration>,
}

impl FieldNeeds {
    /// Derives them from the settings, for contacts within a tolerance (m).
    pub fn new(tolerance: f64, settings: &Settings, probe: &Object) -> Result<Self, FieldError> {
        if let Some(error) = settings.search.representative_error {
            check_error(error, probe)?;
        }
        let default = (DEFAULT_ERROR * probe.bounding_radius()).min(MAX_DEFAULT_ERROR * tolerance);
        let error = settings.search.representative_error.unwrap_or(default);
        let budget = settings.detail.query_budget.map(Duration::from_secs_f64);
        Ok(Self { options: field_options(tolerance), error, budget })
    }

    /// d, m.
    pub fn tolerance(&self) -> f64 {
        self.options.tolerance
    }

    /// Options that fields are made with.
    pub fn options(&self) -> FieldOptions {
        self.options
    }

    /// EPS, m.
    pub fn error(&self) -> f64 {
        self.error
    }

    /// Sets or removes the time limit of each query, s.
    pub fn set_budget(&mut self, budget: Option<f64>) {
        self.budget = budget.map(Duration::from_secs_f64);
    }

    /// The field of an object, made if it does not exist.
    pub fn of(&self, object: &Object) -> Result<Arc<Field>, FieldError> {
        object.field(self.options)
    }

    /// Approximate lattice constant of an object's field, m.
    pub fn lattice(&self, object: &Object) -> f64 {
        lattice(object, &self.options)
    }

    /// Settings of queries within a reach (m). The error grows with the reach, so that the cost stays the
    /// same.
    pub fn settings(&self, reach: f64) -> FieldSettings {
        let error = self.error * reach / self.options.tolerance;
        FieldSettings { error, budget: self.budget, ..FieldSettings::new(reach) }
    }
}

/// The contact search in fields, with all workspaces.
#[derive(Debug)]
pub(crate) struct ByFields {
    pub needs: FieldNeeds,
    probe: Arc<Field>,
    law: AreaLaw,
    /// K: stiffness of a place of contact, in stiffnesses of a cluster.
    stiffness: f64,
    /// Scene objects by their places.
    sides: Vec<Option<Side>>,
    /// Contacts of the last query.
    found: Vec<AreaContact>,
    /// Places of the scene objects that they are with.
    places: Vec<usize>,
    /// Pose of the mesh's frame and reach (m) of the last query, unless the scene has changed since.
    at: Option<(Pose, f64)>,
    /// Contacts carried to the body's pose.
    carried: Vec<AreaContact>,
    weights: Vec<f64>,
    /// Weighted contacts of one group.
    weighted: Vec<WeightedContact>,
    planes: Vec<(Option<usize>, Plane)>,
}

/// A scene object's field and its queries, one for each [`Purpose`]. A query goes on from its last one if the
/// reach is the same, and the two purposes have different reaches.
#[derive(Debug)]
struct Side {
    field: Arc<Field>,
    queries: [Option<FieldQuery>; 2],
}

/// Use of the contacts of a query.
#[derive(Clone, Copy, Debug)]
enum Purpose {
    Proxy,
    Push,
}

impl ByFields {
    pub fn new(needs: FieldNeeds, probe: &Object, clusters: usize) -> Result<Self, FieldError> {
        let mut law = law(probe);
        let field = needs.of(probe)?;
        // The law's workspace grows with the number of contacts; a call with many makes room for them.
        let contact = Contact {
            point: DVec3::ZERO,
            scene_point: DVec3::ZERO,
            normal: DVec3::Z,
            depth: f64::NEG_INFINITY,
        };
        law.weights(&[AreaContact { contact, area: 0.0 }; RESERVED], needs.tolerance(), &Pose::IDENTITY);
        Ok(Self {
            needs,
            probe: field,
            law,
            stiffness: clusters as f64,
            sides: Vec::new(),
            found: Vec::with_capacity(RESERVED),
            places: Vec::with_capacity(RESERVED),
            at: None,
            carried: Vec::with_capacity(RESERVED),
            weights: Vec::with_capacity(RESERVED),
            weighted: Vec::with_capacity(RESERVED),
            planes: Vec::with_capacity(64),
        })
    }

    /// Puts an object at a place, with a workspace from the start if `reserved`.
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

    /// Removes the object at a place.
    pub fn remove(&mut self, place: usize) {
        if let Some(side) = self.sides.get_mut(place) {
            *side = None;
        }
        self.at = None;
    }

    /// Discards the result of the last query: the scene has changed.
    pub fn scene_has_changed(&mut self) {
        self.at = None;
    }

    /// Largest reach, m.
    pub fn max_reach(&self) -> f64 {
        self.needs.options.band
    }

    /// Memory that workspaces and fields hold, bytes.
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

    /// Finds the contacts with all objects near, with the mesh's frame at a pose, unless the last query was
    /// the same; `false` if an object could not be queried.
    fn query(
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
            let Some(Some(Side { field, queries, .. })) = self.sides.get_mut(place) else { continue };
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

    /// The deepest places of cells. They have no area, since other contacts represent theirs.
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

    /// Returns the planes that push the body with the area law's force, the strongest first, each with the
    /// place of its scene object if that moves. `proxy` and `body` are poses of the centre of mass, `lag` (m)
    /// apart; `to_mesh` is the mesh's frame in the body's.
    pub fn planes(
        &mut self,
        (proxy, body): (&Pose, &Pose),
        lag: f64,
        to_mesh: &Pose,
        tolerance: f64,
        scene: &mut SceneQuery,
        (still, objects, moving): (&mut ContactGroup, &mut [Option<InScene>], &[usize]),
    ) -> &[(Option<usize>, Plane)] {
        let reach = (tolerance + in_steps(lag, tolerance)).min(self.max_reach()).max(tolerance);
        // Objects that cannot be queried were counted with the proxy's query.
        self.query(Purpose::Push, &(*proxy * *to_mesh), reach, scene, &mut QueryReport::default());
        self.carried.clear();
        self.carried.extend(
            self.found
                .iter()
                .map(|found| AreaContact { contact: carried(&found.contact, proxy, body), area: found.area }),
        );
        let mesh = *body * *to_mesh;
        self.weights.clear();
        self.weights.extend_from_slice(self.law.weights(&self.carried, tolerance, &mesh));
        let max_reach = self.max_reach();
        let fade = FADE_SHARE * (max_reach - tolerance);
        for (weight, found) in self.weights.iter_mut().zip(&self.found) {
            *weight *= self.stiffness * ((found.contact.depth + max_reach) / fade).clamp(0.0, 1.0);
        }
        self.merge(tolerance, &mesh, (still, objects, moving));
        &self.planes
    }

    /// Reduces the weighted contacts to planes: those with still objects together, those with each moving
    /// object by themselves.
    fn merge(
        &mut self,
        tolerance: f64,
        mesh: &Pose,
        (still, objects, moving): (&mut ContactGroup, &mut [Option<InScene>], &[usize]),
    ) {
        let Self { carried, weights, places, weighted, planes, .. } = self;
        planes.clear();
        let gather = |weighted: &mut Vec<WeightedContact>, belongs: &dyn Fn(usize) -> bool| {
            weighted.clear();
            let all = carried.iter().zip(weights.iter()).zip(places.iter());
            weighted.extend(
                all.filter(|((_, weight), place)| **weight > 0.0 && belongs(**place))
                    .map(|((found, weight), _)| WeightedContact { contact: found.contact, weight: *weight }),
            );
        };
        gather(weighted, &|place| !moving.contains(&place));
        planes.extend(still.merging.run(weighted, tolerance, mesh).iter().map(|plane| (None, *plane)));
        for &place in moving {
            let Some(Some(InScene { moving: Some(moving), .. })) = objects.get_mut(place) else { continue };
            gather(weighted, &|of| of == place);
            let own = moving.1.merging.run(weighted, tolerance, mesh);
            planes.extend(own.iter().map(|plane| (Some(place), *plane)));
        }
        let push = |(_, plane): &(Option<usize>, Plane)| plane.weight * (plane.contact.depth + tolerance);
        // Insertion sort: there are few planes, and it is stable without allocating.
        for index in 1..planes.len() {
            let mut at = index;
            while at > 0 && push(&planes[at - 1]) < push(&planes[at]) {
                planes.swap(at - 1, at);
                at -= 1;
            }
        }
    }
}

/// The lag of the proxy (m), rounded up to whole steps, so that the reach seldom changes.
pub(crate) fn in_steps(lag: f64, tolerance: f64) -> f64 {
    (lag / (REACH_STEP * tolerance)).ceil() * REACH_STEP * tolerance
}

/// The proxy's contact search in fields.
pub(crate) struct FieldFinder<'a> {
    pub by_fields: &'a mut ByFields,
    pub scene: &'a mut SceneQuery,
    /// Reach, m.
    pub reach: f64,
}

impl ContactFinder for FieldFinder<'_> {
    const CONTACTS_JUMP: bool = false;

    fn reach(&self) -> f64 {
        self.reach
    }

    fn find(&mut self, mesh: &Pose, report: &mut QueryReport) -> bool {
        self.by_fields.query(Purpose::Proxy, mesh, self.reach, self.scene, report)
    }

    fn contacts(&self) -> impl Iterator<Item = ProxyContact> {
        self.by_fields.deepest()
    }

    fn depths(&self) -> impl Iterator<Item = (usize, f64)> {
        self.by_fields.deepest().map(|found| (found.object, found.contact.contact.depth))
    }
}
