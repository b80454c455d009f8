//! The state of the contact loop, in groups.

use palpate_collide::QuerySettings;
use palpate_core::Contact;
use palpate_dynamics::ContactParameters;
use rtrb::Consumer;

use super::monitor::{ContactForce, MonitorFeed};
use super::touching::Patches;
use crate::constraints::guard::Guard;
use crate::constraints::pairs::Pairs;
use crate::penalties::group::ContactGroup;
use crate::penalties::lookahead::Lookahead;
use crate::penalties::proxy::Proxy;
use crate::penalties::textures::Textures;
use crate::scene::editor::{Edit, SceneEditor};
use crate::search::ByLevels;
use crate::search::by_fields::ByFields;
use crate::settings::live::{ContactTuning, Ramp};

/// What the search for constraints knows from step to step.
#[derive(Debug)]
pub(super) struct ConstraintSearch {
    pub guard: Guard,
    /// Distances from the scene objects.
    pub pairs: Pairs,
}

/// The search for penalty contacts, with its workspaces.
#[derive(Debug)]
pub(super) struct PenaltySearch {
    pub proxy: Proxy,
    pub settings: QuerySettings,
    /// Contacts with all scene objects that are not textured and do not move.
    pub still: ContactGroup,
    /// Contact search in fields, or the reason for the search by levels.
    pub by_fields: Result<Box<ByFields>, ByLevels>,
    /// Texture stage, if an object is textured.
    pub textures: Option<Textures>,
    pub braking: bool,
    pub lookahead: Lookahead,
}

impl PenaltySearch {
    /// Whether contacts are found in fields.
    pub fn is_by_fields(&self) -> bool {
        self.by_fields.is_ok() && self.textures.is_none()
    }

    /// Whether the object at a place, or the probe with it, is textured.
    pub fn is_textured(&self, place: usize) -> bool {
        self.textures.as_ref().is_some_and(|textures| textures.has(place))
    }

    /// Discards the contacts found so far: the scene has changed.
    pub fn scene_has_changed(&mut self) {
        self.proxy.scene_has_changed();
        if let Ok(fields) = &mut self.by_fields {
            fields.scene_has_changed();
        }
    }

    /// Gives the proxy the recesses of the textures.
    pub fn keep_recesses(&mut self) {
        self.proxy.set_recesses(self.textures.as_ref().map_or_else(Vec::new, Textures::recesses));
    }
}

/// What changes the scene and the settings while the loop runs.
#[derive(Debug, Default)]
pub(super) struct Live {
    /// Pending changes of the scene, and the editor that sends them.
    pub edits: Option<Consumer<Edit>>,
    pub editor: Option<SceneEditor>,
    pub tunings: Option<Consumer<ContactTuning>>,
    /// Ramp of gains and s₀ to tuned ones.
    pub tuning: Option<Ramp<(ContactParameters, f64)>>,
}

/// When the loop steps.
#[derive(Clone, Copy, Debug)]
pub(super) struct Timing {
    /// Time of the last step, s.
    pub time: f64,
    /// Times between the last step and the one before, and between that and the one before it, s.
    pub interval: f64,
    pub before: f64,
}

impl Timing {
    /// Before the first step.
    pub const NONE: Self = Self { time: f64::NAN, interval: f64::NAN, before: f64::NAN };

    /// A step at a time (s).
    pub fn pass(&mut self, time: f64) {
        *self = Self { time, interval: time - self.time, before: self.interval };
    }
}

/// What contact monitors see.
#[derive(Debug)]
pub(super) struct Shown {
    /// Feed of the monitors, if there are any.
    pub monitored: Option<MonitorFeed>,
    /// The search for the patches that touch.
    pub patches: Patches,
}

impl Shown {
    /// Adds the penalty force −k (δ + d) **n** of a contact to the snapshot, if there is a monitor.
    pub fn add(&mut self, contact: &Contact, gains: &ContactParameters) {
        let Some(monitored) = &mut self.monitored else { return };
        let Contact { point, normal, depth, .. } = *contact;
        let force = normal * (-gains.stiffness * (depth + gains.tolerance));
        monitored.snapshot().add_force(ContactForce { point, normal, force, depth });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_are_those_between_steps() {
        let mut timing = Timing::NONE;
        let after = |timing: &mut Timing, time: f64| {
            timing.pass(time);
            (timing.interval, timing.before)
        };
        assert!(after(&mut timing, 1.0).0.is_nan(), "there was no step before");
        let (interval, before) = after(&mut timing, 1.5);
        assert!(interval == 0.5 && before.is_nan());
        assert_eq!(after(&mut timing, 1.75), (0.25, 0.5));
    }
}
