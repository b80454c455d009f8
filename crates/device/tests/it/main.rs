//! The integration tests, linked as one program: a module a subject.

#[cfg(feature = "haply")]
mod haply;
mod hid_codecs;
#[cfg(feature = "hid")]
mod hid_pid;
#[cfg(all(feature = "hid", target_os = "linux"))]
mod hid_umockdev;
mod link;
mod no_allocation;
mod pump_thread;
mod recording;
mod stamps;
mod withheld;
