//! Settings that change while a session runs, smoothly.
//!
//! What follows from them is reckoned in the caller's thread, and waits in lock-free rings for the two loops.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use palpate_device::Specification;
use rtrb::{Consumer, Producer, RingBuffer};

use crate::settings::live::{ContactTuning, HapticTuning};
use crate::settings::{Settings, SettingsError};
use crate::tool::gains::{Gains, Grasped};

/// Changes that may wait for a loop.
const WAITING: usize = 64;

/// Why settings were not changed.
#[derive(Debug, thiserror::Error)]
pub enum SettingsEditError {
    /// As when a session is made with them.
    #[error(transparent)]
    Refused(#[from] SettingsError),
    /// This one is what the session was made with.
    #[error("{0} cannot change while a session runs; make a new session with it")]
    Fixed(&'static str),
    /// As many changes as may wait for the loops do: they are slower than the host, or the session has ended.
    #[error("{WAITING} changes wait; make fewer, or see whether the session still runs")]
    Full,
}

/// Changes the settings of a session, from any thread. Made by
/// [`HapticRenderer::settings_editor`](crate::HapticRenderer::settings_editor).
///
/// A clone changes the same settings.
#[derive(Clone, Debug)]
pub struct SettingsEditor(Arc<Mutex<Edited>>);

/// What all editors of a session's settings share. The loops never wait for it: they have the other ends of the rings.
#[derive(Debug)]
struct Edited {
    settings: Settings,
    grasped: Grasped,
    specification: Specification,
    /// Whether contacts are found in fields, which have no detail to leave out.
    by_fields: bool,
    haptic: Vec<Producer<HapticTuning>>,
    contact: Vec<Producer<ContactTuning>>,
}

impl SettingsEditor {
    pub(crate) fn new(
        settings: Settings,
        grasped: Grasped,
        specification: Specification,
        by_fields: bool,
    ) -> Self {
        let (haptic, contact) = (Vec::new(), Vec::new());
        Self(Arc::new(Mutex::new(Edited { settings, grasped, specification, by_fields, haptic, contact })))
    }

    /// The changes for a haptic loop.
    pub(crate) fn tunes_haptic(&self) -> Consumer<HapticTuning> {
        let (tunings, waiting) = RingBuffer::new(WAITING);
        self.edited().haptic.push(tunings);
        waiting
    }

    /// The changes for a contact loop.
    pub(crate) fn tunes_contact(&self) -> Consumer<ContactTuning> {
        let (tunings, waiting) = RingBuffer::new(WAITING);
        self.edited().contact.push(tunings);
        waiting
    }

    /// The settings that the session has, or is going over to.
    pub fn settings(&self) -> Settings {
        self.edited().settings
    }

    fn edited(&self) -> MutexGuard<'_, Edited> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Goes over to other settings, in 0.2 s: stiffness, damping and friction of contacts, those of the coupling, the detail that is
    /// left out with its interpolation, the time of queries, how fast the wrench may change, and the passivity controller.
    ///
    /// # Errors
    /// If one is out of range, one of the others differs from what the session was made with, or too many changes wait;
    /// nothing is changed then. The detail that is left out is one of the others where contacts are found as representatives.
    pub fn set(&mut self, settings: Settings) -> Result<(), SettingsEditError> {
        let mut edited = self.edited();
        let edited = &mut *edited;
        let gains = Gains::new(&settings, &edited.grasped, &edited.specification)?;
        if let Some(name) = fixed_difference(&edited.settings, &settings) {
            return Err(SettingsEditError::Fixed(name));
        }
        if edited.by_fields && settings.error != edited.settings.error {
            return Err(SettingsEditError::Fixed("error"));
        }
        if edited.haptic.iter().any(Producer::is_full) || edited.contact.iter().any(Producer::is_full) {
            return Err(SettingsEditError::Full);
        }
        let Gains { coupling, velocity_lags, slew, max_damping, contacts: parameters, .. } = gains;
        let Settings { error, interpolation, query_budget, .. } = settings;
        // Each has room.
        for haptic in &mut edited.haptic {
            let tuning = HapticTuning { coupling, velocity_lags, slew, max_damping };
            haptic.push(tuning).map_err(|_| SettingsEditError::Full)?;
        }
        for contact in &mut edited.contact {
            let tuning = ContactTuning { parameters, error, interpolation, query_budget };
            contact.push(tuning).map_err(|_| SettingsEditError::Full)?;
        }
        edited.settings = settings;
        Ok(())
    }
}

/// The first setting that cannot change, and does.
fn fixed_difference(before: &Settings, after: &Settings) -> Option<&'static str> {
    let same = [
        ("rate", before.rate == after.rate),
        ("mass", before.mass == after.mass),
        ("tolerance", before.tolerance == after.tolerance),
        ("search", before.search == after.search),
        ("representative_error", before.representative_error == after.representative_error),
        ("clusters", before.clusters == after.clusters),
        ("braking", before.braking == after.braking),
        ("proxy", before.proxy == after.proxy),
        ("textures", before.textures == after.textures),
        ("grasp", before.grasp == after.grasp),
        ("handle", before.handle == after.handle),
        ("contact_timeout", before.contact_timeout == after.contact_timeout),
        ("integrator", before.integrator == after.integrator),
        ("engagement", before.engagement == after.engagement),
        ("workspace_scale", before.workspace_scale == after.workspace_scale),
        ("device_frame", before.device_frame == after.device_frame),
        ("clutch_button", before.clutch_button == after.clutch_button),
    ];
    same.into_iter().find(|(_, same)| !same).map(|(name, _)| name)
}
