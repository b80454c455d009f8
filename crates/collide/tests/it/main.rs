//! The integration tests, linked once: a module a subject.

mod contact_set;
mod containment;
mod convex;
mod jaws;
mod no_allocation;
mod oracle;
mod query;
mod scene_query;
mod solids;
