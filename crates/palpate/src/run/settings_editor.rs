//! Settings that change while a session runs, smoothly.
//!
//! What follows from them is reckoned in the caller's thread, and waits in lock-free rings for the two loops.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use palpate_device::Specification;
use rtrb::{Consumer, Producer, RingBuffer};

use crate::settings::live::{ContactTuning, HapticTuning};
use crate::settings::{DetailSettings, LiveSettings, Settings, SettingsError};
use crate::tool::gains::{Gains, Grasped};

/// Changes that may wait for a loop.
const WAITING: usize = 64;

/// Why settings were not changed.
#[derive(Debug, thiserror::Error)]
pub enum SettingsEditError {
    /// As when a session is made with them.
    #[error(transparent)]
    Refused(#[from] SettingsError),
    /// Contacts are found as representatives, which have no detail to leave out.
    #[error(
        "detail.error cannot change while contacts are found as representatives; make a new session with it"
    )]
    Detail,
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

    /// Goes over to other settings, in 0.2 s.
    ///
    /// # Errors
    /// If one is out of range, detail is to be left out where contacts are found as representatives, which have none to leave out, or too
    /// many changes wait; nothing is changed then.
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
        let Gains { coupling, velocity_lags, slew, max_damping, contacts: parameters, .. } = gains;
        let DetailSettings { error, interpolation, query_budget } = settings.detail;
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
