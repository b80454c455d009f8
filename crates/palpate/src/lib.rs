//! palpate: 6-DoF haptic rendering. A user holds a device, the device holds a virtual object, and palpate
//! computes the force and torque of contact with other objects, at 1 kHz.
//!
//! A session is a [`HapticRenderer`]: an [`Object`] in the hand, a [`Scene`] around it, a
//! [`device::HapticDevice`] and [`Settings`]. It runs in real time ([`HapticRenderer::run_realtime`]),
//! reproducibly on a simulated clock ([`HapticRenderer::run_lockstep`]), or in the loops of a host
//! ([`HapticRenderer::into_loops`]).
//!
//! The parts are separate crates, re-exported here: [`core`], [`collide`], [`dynamics`] and [`device`] for
//! sessions, [`mesh_io`] and [`clod_build`] for offline work, and the built-in `models` with the feature of
//! that name.
#![cfg_attr(
    any(doc, all(doctest, feature = "models")),
    doc = "The [guide](guide) leads from the concepts to embedding and troubleshooting."
)]
//! # Layers
//!
//! Each folder uses only those before it:
//!
//! 1. `telemetry`: counts, times and records
//! 2. `settings`: settings of a session
//! 3. `scene`: objects, their fields and poses
//! 4. `constraints`: contacts as constraints, for both loops
//! 5. `penalties`: contacts as springs, as in the dissertation
//! 6. `search`: how penalty contacts are searched for, and representative contacts
//! 7. `contact_loop`: the contact loop
//! 8. `tool`: tools that the device holds, and their gains
//! 9. `haptic`: the haptic loop
//! 10. `run`: the renderer, and the drivers that run the loops
//! 11. `explore`, `guide`: tasks for an emulated hand, and the guide
#![cfg_attr(docsrs, feature(doc_cfg))]

mod constraints;
mod contact_loop;
pub mod explore;
#[cfg(any(doc, all(doctest, feature = "models")))]
pub mod guide;
mod haptic;
mod penalties;
mod run;
pub mod scene;
mod search;
pub mod settings;
pub mod telemetry;
pub mod tool;

pub use contact_loop::monitor::{
    ContactForce, ContactMonitor, ContactSnapshot, TouchingPatches, level_color,
};
pub use contact_loop::{ContactLoop, ContactUpdate, Guarded, Pull};
pub use haptic::HapticLoop;
pub use haptic::reactions::{Reaction, Reactions};
pub use palpate_clod_build as clod_build;
pub use palpate_collide as collide;
pub use palpate_core as core;
pub use palpate_core::{Contact, Pose, TriMesh, Twist, Wrench, glam};
pub use palpate_device as device;
pub use palpate_dynamics as dynamics;
pub use palpate_mesh_io as mesh_io;
pub use palpate_mesh_io::LoadWarning;
#[cfg(feature = "models")]
pub use palpate_models as models;
pub use palpate_realtime as threads;
pub use palpate_texture_pd as texture_pd;
pub use run::builder::RendererBuilder;
pub use run::hosted::{HostedSession, HostedStepper};
pub use run::lockstep::{ContactTiming, LockstepSession};
pub use run::renderer::HapticRenderer;
pub use run::session::{Session, Summary};
pub use run::settings_editor::SettingsEditor;
pub use run::spawn::{RunningSession, SessionHandle};
pub use scene::cache::cache_folder;
pub use scene::editor::SceneEditor;
#[cfg(feature = "scene-files")]
pub use scene::file::SceneFile;
pub use scene::moving::DynamicBody;
pub use scene::object::{Object, OpenOptions, open_mesh};
pub use scene::placement::HandlePlacement;
pub use scene::{Scene, SceneId};
pub use search::representative;
pub use settings::Settings;
pub use telemetry::Events;
pub use telemetry::record::Recorded;
pub use telemetry::record::{Record, RecordWriter};

/// Load of the machine during a session, and how late it wakes a thread.
pub mod machine {
    pub use crate::run::lateness::{WakeLateness, measure_wake_lateness};
    pub use crate::run::machine::{MachineLoad, MachineSample};
}

/// Parts of a session's [`Summary`], and the clock that it ran by.
pub mod summary {
    pub use crate::run::session::{Clock, ContactSummary, HapticSummary, RealtimeSetup};
}

/// Errors of the facade.
pub mod errors {
    pub use crate::penalties::textures::TextureError;
    pub use crate::run::hosted::HostError;
    pub use crate::run::renderer::RendererError;
    pub use crate::run::settings_editor::SettingsEditError;
    pub use crate::run::spawn::SessionPanic;
    pub use crate::scene::editor::EditError;
    #[cfg(feature = "scene-files")]
    pub use crate::scene::file::SceneFileError;
    pub use crate::scene::object::OpenError;
    pub use crate::scene::size::UnitsError;
    pub use crate::settings::SettingsError;
    pub use crate::tool::error::ToolError;
}

/// Bounds on every wrench that is written to a device, and how well they were kept.
pub mod promises {
    pub use crate::haptic::heat::ACTUATOR_HEATING;
    pub use crate::haptic::invariants::{
        ENERGY_BOUND, FAULT_TIME, Invariant, InvariantRecord, Invariants, RUNAWAY_SPEED,
    };
}
