//! A window on a session: the object in the hand and the scene, the patches that touch in the colour of their level of detail
//! (as in Fig. 3.1 of the dissertation), what pushes where, and force and depth over time.
//!
//! [`show`] runs a session in real time behind a window (eframe). What the window shows is drawn by a [`Painter`], which needs no
//! window, from a [`Picture`]. The engine knows of none of this: it is watched ([`palpate::ContactMonitor`]), and never waits.

mod camera;
mod painter;
mod picture;
mod window;

pub use camera::Camera;
pub use painter::{MeshOnGpu, Painter};
pub use picture::{Corner, LevelColor, Picture, mesh_corners};
pub use window::{ViewError, ViewOptions, show};
