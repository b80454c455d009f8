//! Drivers of a session: in real time, on a simulated clock, or stepped by a host.

pub(crate) mod builder;
pub(crate) mod hosted;
pub(crate) mod lateness;
pub(crate) mod lockstep;
pub(crate) mod machine;
pub(crate) mod realtime;
pub(crate) mod renderer;
pub(crate) mod session;
pub(crate) mod settings_editor;
pub(crate) mod spawn;
