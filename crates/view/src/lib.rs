//! Window of a session: the object in the hand and the scene, the patches in contact in the colour of their
//! level of detail (as in Fig. 3.1 of the dissertation), contact forces as arrows, and force and depth over
//! time.
//!
//! [`show`] runs a session in real time behind a window (eframe). The picture in the window is drawn by a
//! [`Painter`], which needs no window, from a [`Picture`]. The engine does not depend on any of this: a
//! [`palpate::ContactMonitor`] provides snapshots, and never makes it wait.

mod camera;
mod painter;
mod picture;
mod window;

pub use camera::Camera;
pub use painter::{MeshOnGpu, Painter};
pub use picture::{Corner, LevelColor, Picture, mesh_corners};
pub use window::{ViewError, ViewOptions, show};
