//! Stages of the contact loop in words. Each line says what runs with the scene as it is, or what ran before
//! and no longer does, so that none says "on" of what contacts as constraints have no use for.

use super::ContactLoop;
use crate::penalties::in_scene::InScene;
use crate::scene::object::Object;
use crate::settings::{ContactSettings, Response, SearchSettings, Settings, TextureSettings, UnusedSetting};

/// Largest number of objects that a line names.
const MAX_NAMED: usize = 4;

/// Objects that contacts are penalties with.
#[derive(Clone, Debug, PartialEq)]
enum Penalties {
    /// None: contacts are constraints.
    None,
    /// Some, in words; contacts with the others are constraints.
    Some(String),
    /// None any more: contacts are constraints now.
    Before,
    /// All, for a reason.
    All(&'static str),
}

impl ContactLoop {
    /// Takes note of what a step runs.
    pub(super) fn note(&mut self, constraints: bool, penalties: bool) {
        self.ran.constraints |= constraints;
        self.ran.penalties |= penalties;
    }

    /// The scene objects.
    pub(crate) fn scene_objects(&self) -> impl Iterator<Item = &Object> {
        self.scene.iter().map(|InScene { object, .. }| object)
    }

    /// Stages of the loop and what runs in each, with the settings as they are.
    pub(crate) fn stages(&self, settings: &Settings) -> [(&'static str, String); 10] {
        let of_penalties = |on: bool, how: &str| match (self.by_penalties(), on) {
            (Penalties::None, _) => "off: contacts are constraints".to_owned(),
            (_, false) => "off: by its setting".to_owned(),
            (Penalties::Some(with), true) => format!("{how}, for penalties with {with}"),
            (Penalties::Before, true) => format!("{how}, for penalties before"),
            (Penalties::All(_), true) => how.to_owned(),
        };
        let SearchSettings { clusters, braking, proxy, .. } = settings.search;
        let watched = if self.is_watched() { "on: contacts are shown" } else { "off: no monitor" };
        [
            ("braking", of_penalties(braking, "on: by its setting")),
            ("clustering", of_penalties(true, &format!("on beyond {clusters} contacts"))),
            ("contact query", self.query_stage()),
            ("contact response", self.response_stage()),
            ("contact search", self.search_stage(settings)),
            ("interpolation between levels", self.interpolation_stage(settings)),
            ("proxy", of_penalties(proxy, "on: by its setting")),
            ("textures", self.texture_stage()),
            ("time-critical queries", self.budget_stage(settings)),
            ("watch", watched.to_owned()),
        ]
    }

    /// Settings that are given and that nothing uses, with the scene as it is.
    pub(crate) fn unused(&self, settings: &Settings) -> Vec<UnusedSetting> {
        let Settings { contact, search, detail, textures, .. } = settings;
        let (default, default_search) = (ContactSettings::default(), SearchSettings::default());
        let by_fields = self.is_by_fields();
        let constraints = match self.by_penalties() {
            Penalties::None => Some("contacts are constraints"),
            _ => None,
        };
        let full = constraints.map(|_| "constraints are found at full resolution");
        let fields = by_fields.then_some("contacts are found in distance fields");
        let levels = (!by_fields).then_some("contacts are found by levels of detail");
        let whole = (detail.error == 0.0 && detail.query_budget.is_none()).then_some("no detail is left out");
        let plain = self.penalties.textures.is_none().then_some("no object has a haptic texture");
        let penalties = (!self.may_constrain).then_some("the integrator takes penalty contacts alone");
        let given = [
            ("contact.response", contact.response == Response::Constraints, penalties),
            ("contact.stiffness", contact.stiffness != default.stiffness, constraints),
            ("contact.damping", contact.damping.is_some(), constraints),
            ("search.clusters", search.clusters != default_search.clusters, constraints),
            ("search.braking", !search.braking, constraints),
            ("search.proxy", !search.proxy, constraints),
            ("search.representative_error", search.representative_error.is_some(), levels),
            ("detail.error", detail.error > 0.0, full.or(fields)),
            ("detail.interpolation", !detail.interpolation, full.or(fields).or(whole)),
            ("detail.query_budget", detail.query_budget.is_some(), constraints),
            ("textures", *textures != TextureSettings::default(), plain),
        ];
        let unused = given.into_iter().filter(|(_, is_given, _)| *is_given);
        unused.filter_map(|(name, _, why)| Some(UnusedSetting { name, why: why? })).collect()
    }

    /// Objects that contacts are penalties with.
    fn by_penalties(&self) -> Penalties {
        match self.response {
            Response::Penalty if !self.may_constrain => {
                return Penalties::All("the integrator takes penalty contacts alone");
            }
            Response::Penalty => return Penalties::All("by the setting"),
            Response::Constraints if self.probe.features().is_none() => {
                return Penalties::All("the body has no surface");
            }
            Response::Constraints => {}
        }
        let textured = |place| self.penalties.is_textured(place);
        let places = self.scene.objects.iter().enumerate().filter(|(place, _)| !self.is_guarded(*place));
        let mut named: Vec<String> = places
            .filter_map(|(place, object)| {
                let why = if textured(place) { "textured" } else { "light" };
                Some(format!("{} ({why})", object.as_ref()?.object.name))
            })
            .collect();
        if named.is_empty() {
            return if self.ran.penalties { Penalties::Before } else { Penalties::None };
        }
        let more = named.len().saturating_sub(MAX_NAMED);
        named.truncate(MAX_NAMED);
        let more = if more > 0 { format!(" and {more} more") } else { String::new() };
        Penalties::Some(format!("{}{more}", named.join(", ")))
    }

    fn response_stage(&self) -> String {
        match self.by_penalties() {
            Penalties::None => "constraints".to_owned(),
            Penalties::Some(with) => format!("constraints; penalties with {with}"),
            Penalties::Before => "constraints; penalties before".to_owned(),
            Penalties::All(why) if self.ran.constraints => format!("penalties: {why}; constraints before"),
            Penalties::All(why) => format!("penalties: {why}"),
        }
    }

    fn query_stage(&self) -> String {
        match self.scene_objects().count().max(self.ran.objects) {
            0 => "off: the scene is empty".to_owned(),
            1 => "on: one scene object".to_owned(),
            n => format!("on: {n} scene objects"),
        }
    }

    fn search_stage(&self, settings: &Settings) -> String {
        let radius = self.probe.bounding_radius();
        let found = match (self.search(), settings.search.representative_error) {
            (Err(why), _) => format!("levels of detail: {why}"),
            (Ok(_), Some(error)) => format!("distance fields, depth error about {error} m"),
            (Ok(error), None) => {
                let percent = 100.0 * error / radius;
                format!("distance fields, depth error about {percent:.2} % of the probe's radius")
            }
        };
        match self.by_penalties() {
            Penalties::All(_) => found,
            Penalties::None => "on the meshes: contacts are constraints".to_owned(),
            _ => format!("on the meshes; for penalties: {found}"),
        }
    }

    fn interpolation_stage(&self, settings: &Settings) -> String {
        let error = self.error();
        if self.by_penalties() == Penalties::None {
            "off: constraints are found at full resolution".to_owned()
        } else if error > 0.0 && self.is_by_fields() {
            "off: contacts are found in distance fields".to_owned()
        } else if error > 0.0 && !settings.detail.interpolation {
            format!("off by its setting: detail is left out up to {error} m")
        } else if error > 0.0 {
            format!("on: detail is left out up to {error} m")
        } else if settings.detail.error > 0.0 {
            "off: every object is one convex hull".to_owned()
        } else {
            "off: full resolution is set".to_owned()
        }
    }

    fn budget_stage(&self, settings: &Settings) -> String {
        match settings.detail.query_budget {
            None => "off: no limit is set".to_owned(),
            Some(_) if self.by_penalties() == Penalties::None => {
                "off: constraints are found without a limit".to_owned()
            }
            Some(seconds) => format!("on: at most {} µs each", 1e6 * seconds),
        }
    }

    fn texture_stage(&self) -> String {
        let Some(backend) = self.texture_backend() else {
            return "off: no object has a haptic texture".to_owned();
        };
        let scene = self.scene_objects().map(|object| ("scene", object));
        let textured = std::iter::once(("probe", &self.probe)).chain(scene);
        let textured = textured.filter(|(_, object)| object.texture().is_some());
        let textured: Vec<String> =
            textured.map(|(role, object)| format!("{role} {}", object.name)).collect();
        format!("on, computed by {backend}: {}", textured.join(", "))
    }
}
