//! The guide: from the concepts to troubleshooting.
//!
//! Read the first two chapters first; after that, each stands by itself.
//!
//! 1. [Concepts](concepts): two loops, levels of detail, the virtual coupling and the tolerance, in pictures.
//! 2. [A first scene](first_scene): a complete program.
//! 3. [Own models](own_models): formats, scale, repair, hierarchies built ahead of time.
//! 4. [Contact queries](contact_queries): contacts, distances and forces of two objects, without a session.
//! 5. [Choosing accuracy](choosing_accuracy): detail that may be left out, the time that this saves, and how
//!    to measure it.
//! 6. [Stability](stability): its causes, and changes that help when a session buzzes.
//! 7. [Devices](devices): how to open them, and how to write a driver.
//! 8. [Embedding](embedding): sessions in a program's own threads or beside them.
//! 9. [Troubleshooting](troubleshooting): symptom, cause, remedy.
//!
//! `docs/glossary.md` in the repository explains the terms. This module exists only in the documentation;
//! programs do not see it. Every example is a test.

/// Two loops, levels of detail, the virtual coupling and the tolerance, in four pictures.
#[doc = include_str!("../docs/guide/concepts/loops.md")]
#[doc = include_str!("../docs/guide/concepts/loops.svg")]
#[doc = ""]
#[doc = include_str!("../docs/guide/concepts/after-loops.md")]
#[doc = include_str!("../docs/guide/concepts/levels.svg")]
#[doc = ""]
#[doc = include_str!("../docs/guide/concepts/after-levels.md")]
#[doc = include_str!("../docs/guide/concepts/coupling.svg")]
#[doc = ""]
#[doc = include_str!("../docs/guide/concepts/after-coupling.md")]
#[doc = include_str!("../docs/guide/concepts/tolerance.svg")]
#[doc = ""]
#[doc = include_str!("../docs/guide/concepts/after-tolerance.md")]
pub mod concepts {}

/// An object in the hand, one around it, a device, and a session.
#[doc = include_str!("../docs/guide/first-scene.md")]
pub mod first_scene {}

/// Steps from a mesh file to an object that is felt.
#[doc = include_str!("../docs/guide/own-models.md")]
pub mod own_models {}

/// Contacts, distances and forces of two objects, without a session.
#[doc = include_str!("../docs/guide/contact-queries.md")]
pub mod contact_queries {}

/// Detail that may be left out, and the time that this saves.
#[doc = include_str!("../docs/guide/choosing-accuracy.md")]
pub mod choosing_accuracy {}

/// Causes of instability, and remedies when a session buzzes.
#[doc = include_str!("../docs/guide/stability.md")]
pub mod stability {}

/// Names of devices, how to open them, and how to write a driver.
#[doc = include_str!("../docs/guide/devices.md")]
pub mod devices {}

/// Sessions in a program's own threads or beside them.
#[doc = include_str!("../docs/guide/embedding.md")]
pub mod embedding {}

/// Symptom, cause, remedy.
#[doc = include_str!("../docs/guide/troubleshooting.md")]
pub mod troubleshooting {}
