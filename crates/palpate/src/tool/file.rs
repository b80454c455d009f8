//! Tools with a hinge as files, in TOML:
//!
//! ```toml
//! limits = [0.0, 0.8]                # smallest and largest angle of the hinge, rad
//! stop_stiffness = 100.0             # of the hinge's stops, N·m/rad
//!
//! [first]                            # the body that the device holds
//! model = "forceps-jaw"              # mesh file, .clod file or built-in model
//! mass = 0.05                        # kg
//!
//! [second]                           # the body that turns against it, about the z axis of its hinge's frame
//! model = "forceps-jaw"
//! mass = 0.05
//! hinge.position = [0.0, 0.0, 0.0]   # of the hinge's frame in the mesh's, m
//! hinge.rotation = [1.0, 0.0, 0.0, 0.0]
//! ```

use std::ops::ControlFlow;
use std::path::Path;

use palpate_clod_build::Stage;
use palpate_core::Pose;
use palpate_core::glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

use super::hinged::HingedTool;
use crate::scene::file::{SceneFileError, one, open_model, read_toml, upright};
use crate::scene::object::Object;

/// A tool with a hinge as a file has it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ToolFile {
    /// Smallest and largest angle of the hinge, rad.
    pub limits: [f64; 2],
    /// Stiffness of the hinge's stops, N·m/rad.
    #[serde(default = "stop_stiffness")]
    pub stop_stiffness: f64,
    /// The body that the device holds.
    pub first: ToolPart,
    /// The body that turns against it.
    pub second: ToolPart,
}

/// A body of a tool file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ToolPart {
    /// A mesh file, a `.clod` file or a built-in model, as [`Object::open`] takes them.
    pub model: String,
    /// Mass, kg.
    pub mass: f64,
    /// The hinge's frame in the mesh's frame; its z axis is the hinge's axis.
    #[serde(default)]
    pub hinge: HingeFrame,
    /// Factor on the mesh's lengths.
    #[serde(default = "one")]
    pub scale: f64,
    /// Whether to make an oriented 2-manifold without self-intersection of the mesh.
    #[serde(default)]
    pub repair: bool,
}

/// A hinge's frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HingeFrame {
    /// Position in the mesh's frame, m.
    #[serde(default)]
    pub position: DVec3,
    /// Quaternion x, y, z, w; made of unit length.
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
    /// Reads a file.
    ///
    /// # Errors
    /// If it cannot be read, or is no tool file: with the line, and what would do.
    pub fn load(path: &Path) -> Result<Self, SceneFileError> {
        read_toml(path)
    }

    /// Opens the tool's objects, with paths from the folder of `path`, the file that this was loaded from. `progress` gets the model,
    /// the stage, and how much of that is done (0 to 1).
    ///
    /// # Errors
    /// If an object cannot be opened, or its hinge or scale is invalid.
    pub fn open(
        &self,
        path: &Path,
        progress: &mut dyn FnMut(&str, Stage, f64) -> ControlFlow<()>,
    ) -> Result<HingedTool, SceneFileError> {
        let folder = path.parent().unwrap_or(Path::new("."));
        let mut part = |number: usize, part: &ToolPart| -> Result<(Object, Pose), SceneFileError> {
            let refuse = |what| SceneFileError::Object {
                path: path.to_owned(),
                number,
                model: part.model.clone(),
                what,
            };
            let hinge = Pose::new(part.hinge.position, part.hinge.rotation.normalize());
            if !hinge.is_valid() {
                return Err(refuse("give a hinge with a finite position and a quaternion that is not zero"));
            }
            if !(part.scale.is_finite() && part.scale > 0.0) {
                return Err(refuse("give a scale above 0"));
            }
            let object = open_model(folder, &part.model, (part.scale, part.repair), progress)?
                .ok_or_else(|| refuse("give a scale that is less extreme"))?;
            Ok((object, hinge))
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
    fn a_file_is_the_tool_that_it_says() {
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
    fn refusals_say_what_and_where() {
        for (from, to, said) in [
            ("limits", "limit", "line 1: unknown field `limit`"),
            ("mass = 0.04\n", "", "missing field `mass`"),
            ("[2, 0, 0, 0]", "[0, 0, 0, 0]", "object 2, forceps-jaw@800: give a hinge"),
            ("mass = 0.05", "mass = 0.05\nscale = -1.0", "object 1, forceps-jaw@800: give a scale"),
        ] {
            let (_folder, path) = written(&FORCEPS.replacen(from, to, 1));
            let refused = ToolFile::load(&path).and_then(|file| file.open(&path, &mut ignored)).map(|_| ());
            let message = refused.expect_err(to).to_string();
            assert!(message.contains(said), "{message}");
        }
    }
}
