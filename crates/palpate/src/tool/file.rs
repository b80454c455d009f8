//! Files of tools with a hinge, in TOML:
//!
//! ```toml
//! limits = [0.0, 0.8]                # smallest and largest angle of the hinge, rad
//! stop_stiffness = 100.0             # stiffness of the hinge's stops, N·m/rad
//!
//! [first]                            # body that the device holds
//! model = "forceps-jaw"              # mesh file, .clod file or built-in model
//! mass = 0.05                        # kg
//!
//! [second]                           # body that rotates about the z axis of its hinge's frame
//! model = "forceps-jaw"
//! mass = 0.05
//! hinge.position = [0.0, 0.0, 0.0]   # position of the hinge's frame in the mesh's, m
//! hinge.rotation = [1.0, 0.0, 0.0, 0.0]   # quaternion x, y, z, w
//! ```

use std::ops::ControlFlow;
use std::path::Path;

use palpate_clod_build::Stage;
use palpate_core::glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

use super::hinged::HingedTool;
use crate::scene::file::{Entry, SceneFileError, one, read_toml, upright};

/// Contents of a tool file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ToolFile {
    /// Smallest and largest angle of the hinge, rad.
    pub limits: [f64; 2],
    /// Stiffness of the hinge's stops, N·m/rad.
    #[serde(default = "stop_stiffness")]
    pub stop_stiffness: f64,
    /// Body that the device holds.
    pub first: ToolPart,
    /// Body that rotates relative to the first.
    pub second: ToolPart,
}

/// Body of a tool file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ToolPart {
    /// Mesh file, `.clod` file or built-in model, as in [`Object::open`](crate::Object::open).
    pub model: String,
    /// Mass, kg.
    pub mass: f64,
    /// The hinge's frame in the mesh's frame; its z axis is the hinge's axis.
    #[serde(default)]
    pub hinge: HingeFrame,
    /// Factor on the mesh's lengths.
    #[serde(default = "one")]
    pub scale: f64,
    /// Whether to repair the mesh to an oriented 2-manifold without self-intersections.
    #[serde(default)]
    pub repair: bool,
}

/// Frame of a hinge in a tool file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HingeFrame {
    /// Position in the mesh's frame, m.
    #[serde(default)]
    pub position: DVec3,
    /// Rotation, a quaternion x, y, z, w that is normalised on reading.
    #[serde(default = "upright")]
    pub rotation: DQuat,
}

impl Default for HingeFrame {
    fn default() -> Self {
        Self { position: DVec3::ZERO, rotation: DQuat::IDENTITY }
    }
}

fn stop_stiffness() -> f64 {
    100.0
}

impl ToolFile {
    /// Reads a tool file.
    ///
    /// # Errors
    /// If the file cannot be read, or is no valid tool file; the message names the line and what is expected
    /// there.
    pub fn load(path: &Path) -> Result<Self, SceneFileError> {
        read_toml(path)
    }

    /// Opens the tool's objects. Relative paths start at the folder of `path`, the file that the tool was
    /// loaded from. `progress` receives the model, the stage, and the fraction of the stage that is done (0
    /// to 1).
    ///
    /// # Errors
    /// If an object cannot be opened, or its hinge or scale is invalid.
    pub fn open(
        &self,
        path: &Path,
        progress: &mut dyn FnMut(&str, Stage, f64) -> ControlFlow<()>,
    ) -> Result<HingedTool, SceneFileError> {
        let mut part = |number, ToolPart { model, hinge, scale, repair, .. }: &ToolPart| {
            let entry = Entry {
                number,
                model,
                pose: (hinge.position, hinge.rotation),
                scale: *scale,
                repair: *repair,
            };
            entry.open(path, progress)
        };
        let (first, in_first) = part(1, &self.first)?;
        let (second, in_second) = part(2, &self.second)?;
        Ok(HingedTool {
            first,
            second,
            hinge: [in_first, in_second],
            limits: self.limits,
            masses: [self.first.mass, self.second.mass],
            stop_stiffness: self.stop_stiffness,
        })
    }
}

#[cfg(all(test, feature = "models"))]
mod tests {
    use palpate_core::Pose;

    use super::*;

    fn written(text: &str) -> (tempfile::TempDir, std::path::PathBuf) {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("tool.toml");
        std::fs::write(&path, text).expect("written");
        (folder, path)
    }

    fn ignored(_: &str, _: Stage, _: f64) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    const FORCEPS: &str = "limits = [0.0, 0.8]\n[first]\nmodel = \"forceps-jaw@800\"\nmass = 0.05\n\
                           [second]\nmodel = \"forceps-jaw@800\"\nmass = 0.04\nhinge.rotation = [2, 0, 0, 0]\n";

    #[test]
    fn a_tool_file_is_read_opened_and_written() {
        let (_folder, path) = written(FORCEPS);
        let file = ToolFile::load(&path).expect("a tool");
        let tool = file.open(&path, &mut ignored).expect("two jaws");
        assert_eq!((tool.masses, tool.limits, tool.stop_stiffness), ([0.05, 0.04], [0.0, 0.8], 100.0));
        assert_eq!(tool.hinge[0], Pose::IDENTITY);
        let turned = tool.hinge[1].transform_vector(DVec3::Z);
        assert!((turned - DVec3::NEG_Z).length() < 1e-15, "{turned}");
        let again: ToolFile = toml::from_str(&toml::to_string(&file).expect("text")).expect("a tool");
        assert_eq!(again, file);
    }

    #[test]
    fn errors_name_the_line_or_the_object() {
        for (from, to, said) in [
            ("limits", "limit", "line 1: unknown field `limit`"),
            ("mass = 0.04\n", "", "missing field `mass`"),
            ("[2, 0, 0, 0]", "[0, 0, 0, 0]", "object 2, forceps-jaw@800: give a finite position"),
            ("mass = 0.05", "mass = 0.05\nscale = -1.0", "object 1, forceps-jaw@800: give a scale"),
        ] {
            let (_folder, path) = written(&FORCEPS.replacen(from, to, 1));
            let refused = ToolFile::load(&path).and_then(|file| file.open(&path, &mut ignored)).map(|_| ());
            let message = refused.expect_err(to).to_string();
            assert!(message.contains(said), "{message}");
        }
    }
}
