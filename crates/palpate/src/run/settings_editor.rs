//! Changes of settings while a session runs.
//!
//! The caller's thread computes the new gains; they wait in lock-free rings for the two loops, which change
//! to them smoothly.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use palpate_device::Specification;
use rtrb::{Consumer, Producer, RingBuffer};

use crate::scene::editor::SceneEditor;
use crate::settings::live::{ContactTuning, HapticTuning};
use crate::settings::{DetailSettings, LiveSettings, Response, Settings, SettingsError};
use crate::tool::gains::{Gains, Grasped};

/// Capacity of the ring of changes to a loop. When it is full, changes are refused.
const MAX_WAITING: usize = 64;

/// A change of settings was refused.
#[derive(Debug, thiserror::Error)]
pub enum SettingsEditError {
    /// A setting is out of range.
    #[error(transparent)]
    Refused(#[from] SettingsError),
    /// Contacts are found as representatives, which have no detail to leave out.
    #[error(
        "detail.error cannot change while contacts are found as representatives; make a new session with it"
    )]
    Detail,
    /// The ring of changes is full: the loops are slower than the host, or the session has ended.
    #[error("{MAX_WAITING} changes wait for the loops; make fewer, or check that the session still runs")]
    Full,
}

/// Editor of the settings of a session, usable from any thread. Made by
/// [`HapticRenderer::settings_editor`](crate::HapticRenderer::settings_editor).
///
/// A clone changes the same settings.
#[derive(Clone, Debug)]
pub struct SettingsEditor(Arc<Mutex<Edited>>);

/// State that all editors of a session's settings share. The loops never lock it: they hold the other ends of
/// the rings.
#[derive(Debug)]
struct Edited {
    settings: Settings,
    grasped: Grasped,
    specification: Specification,
    /// Editor of the session's scene, whose objects other settings may need more of.
    scene: SceneEditor,
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
        scene: SceneEditor,
        by_fields: bool,
    ) -> Self {
        let (haptic, contact) = (Vec::new(), Vec::new());
        let edited = Edited { settings, grasped, specification, scene, by_fields, haptic, contact };
        Self(Arc::new(Mutex::new(edited)))
    }

    /// Adds the ring of changes to a haptic loop.
    pub(crate) fn add_haptic_loop(&self) -> Consumer<HapticTuning> {
        let (tunings, waiting) = RingBuffer::new(MAX_WAITING);
        self.edited().haptic.push(tunings);
        waiting
    }

    /// Adds the ring of changes to a contact loop.
    pub(crate) fn add_contact_loop(&self) -> Consumer<ContactTuning> {
        let (tunings, waiting) = RingBuffer::new(MAX_WAITING);
        self.edited().contact.push(tunings);
        waiting
    }

    /// Settings that the session has, or is changing to.
    pub fn settings(&self) -> Settings {
        self.edited().settings
    }

    fn edited(&self) -> MutexGuard<'_, Edited> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes to other settings, smoothly over 0.2 s.
    ///
    /// # Errors
    /// If a setting is out of range, the error threshold changes while contacts are found as representatives,
    /// which have no detail to leave out, or too many changes wait. Nothing is changed then.
    pub fn set(&mut self, live: LiveSettings) -> Result<(), SettingsEditError> {
        let mut edited = self.edited();
        let edited = &mut *edited;
        let settings = edited.settings.with_live(&live);
        let gains = Gains::new(&settings, &edited.grasped, &edited.specification)?;
        if edited.by_fields && settings.detail.error != edited.settings.detail.error {
            return Err(SettingsEditError::Detail);
        }
        if edited.haptic.iter().any(Producer::is_full) || edited.contact.iter().any(Producer::is_full) {
            return Err(SettingsEditError::Full);
        }
        if settings.contact.response == Response::Constraints {
            // Now, since it takes longer than a contact step.
            edited.scene.prepare_constraints();
        }
        let Gains { coupling, velocity_lags, slew, max_damping, contacts: parameters, .. } = gains;
        let DetailSettings { error, interpolation, query_budget } = settings.detail;
        // Every ring has room by now, so all loops receive the change.
        for haptic in &mut edited.haptic {
            let tuning = HapticTuning { coupling, velocity_lags, slew, max_damping };
            haptic.push(tuning).map_err(|_| SettingsEditError::Full)?;
        }
        for contact in &mut edited.contact {
            let response = settings.contact.response;
            let tuning = ContactTuning { response, parameters, error, interpolation, query_budget };
            contact.push(tuning).map_err(|_| SettingsEditError::Full)?;
        }
        edited.settings = settings;
        Ok(())
    }
}
