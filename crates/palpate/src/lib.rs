//! palpate: 6-DoF haptic rendering. A user holds a device, the device holds a virtual object, and palpate computes the
//! force and torque of touching other objects, at 1 kHz.
//!
//! A session is a [`HapticRenderer`]: an [`Object`] in the hand, a [`Scene`] around it, a [`device::HapticDevice`] and
//! [`Settings`]. It runs in real time ([`HapticRenderer::run_realtime`]), on a simulated clock and reproducibly
//! ([`HapticRenderer::run_lockstep`]), or in the loops of a host ([`HapticRenderer::into_loops`]).
//!
//! The parts are crates of their own, re-exported here: [`core`], [`collide`], [`dynamics`], [`device`], and offline
//! [`mesh_io`] and [`clod_build`], and with the feature `models` the built-in ones.
//!
#![cfg_attr(
    any(doc, all(doctest, feature = "models")),
    doc = "The [guide](guide) goes from the concepts to embedding and troubleshooting."
)]
#![cfg_attr(docsrs, feature(doc_cfg))]

mod articulated;
mod builder;
mod cache;
mod contact_loop;
pub mod explore;
mod gains;
#[cfg(any(doc, all(doctest, feature = "models")))]
pub mod guide;
mod haptic_loop;
mod hosted;
mod invariants;
mod lateness;
mod lockstep;
mod machine;
mod merging;
mod moving;
mod object;
mod output;
mod placement;
mod presence;
mod proxy;
mod reactions;
mod realtime;
mod record;
mod renderer;
pub mod representative;
mod scene;
mod scene_editor;
#[cfg(feature = "scene-files")]
mod scene_file;
mod session;
mod settings;
mod settings_editor;
mod size;
mod spawn;
mod telemetry;
mod textures;
mod tracking;
mod walls;
mod watch;
mod workspace;

pub use articulated::{
    ARTICULATED_COLUMNS, ArticulatedError, ArticulatedLockstep, ArticulatedLoop, ArticulatedRecord,
    ArticulatedRenderer, ArticulatedSession, ArticulatedTool, GripperSettings, ToolBody,
};
pub use builder::RendererBuilder;
pub use cache::cache_folder;
pub use contact_loop::{ContactLoop, ContactUpdate};
pub use haptic_loop::HapticLoop;
pub use hosted::{HostError, HostedSession, HostedStepper};
pub use invariants::{ENERGY_BOUND, FAULT_TIME, Invariant, Invariants, Kept, RUNAWAY_SPEED, WARMTH};
pub use lateness::{WakeLateness, measure_wake_lateness};
pub use lockstep::ContactTiming;
pub use machine::{MachineLoad, MachineSample};
pub use moving::Mobility;
pub use object::{NamedMesh, Object, OpenError, OpenOptions, open_mesh};
pub use palpate_clod_build as clod_build;
pub use palpate_collide as collide;
pub use palpate_core as core;
pub use palpate_core::{Contact, Pose, TriMesh, Twist, Wrench, glam};
pub use palpate_device as device;
pub use palpate_dynamics as dynamics;
pub use palpate_dynamics::IntegratorKind;
pub use palpate_mesh_io as mesh_io;
pub use palpate_mesh_io::LoadWarning;
#[cfg(feature = "models")]
pub use palpate_models as models;
pub use palpate_realtime as threads;
pub use palpate_texture_pd as texture_pd;
pub use placement::{HandlePlace, HandlePlacement};
pub use reactions::{Reaction, Reactions};
pub use record::{COLUMNS, Record, RecordWriter};
pub use renderer::{HapticRenderer, RendererError};
pub use scene::{Placed, Scene};
pub use scene_editor::{EditError, SceneEditor, SceneId};
#[cfg(feature = "scene-files")]
pub use scene_file::{ObjectEntry, SceneFile, SceneFileError};
pub use session::{Clock, ContactSummary, HapticSummary, RealtimeSetup, Session, Summary};
pub use settings::{
    ContactSearch, Settings, SettingsError, TextureBackend, TextureDerivatives, TextureSettings,
};
pub use settings_editor::{SettingsEditError, SettingsEditor};
pub use size::UnitsError;
pub use spawn::{RunningSession, SessionHandle, SessionPanic};
pub use telemetry::{ContactTelemetry, Events, HapticTelemetry, Percentiles, Times};
pub use textures::TextureError;
pub use watch::{Push, Sight, TouchingPatches, Watch, level_color};
