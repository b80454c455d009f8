//! Scene files, in TOML:
//!
//! ```toml
//! # Mesh files and .clod files, by paths relative to this file's folder, and built-in models.
//! [[object]]
//! model = "lower-jaw"
//!
//! [[object]]
//! model = "ellipsoid@500"
//! position = [0.0, 0.0, 0.05]        # position of the mesh's frame in the world, m
//! rotation = [0.0, 0.0, 0.0, 1.0]    # quaternion x, y, z, w
//! scale = 0.5                        # factor on the mesh's lengths
//! repair = true                      # repair the mesh to an oriented 2-manifold without self-intersections
//!
//! # Settings that differ from the defaults; see Settings.
//! [settings.contact]
//! friction = 0.3
//! stiffness = 1000.0
//! ```

use std::path::{Path, PathBuf};

use palpate_clod_build::Stage;
use palpate_core::Pose;
use palpate_core::glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};
use std::ops::ControlFlow;

use crate::scene::Scene;
use crate::scene::object::{Object, OpenError, OpenOptions, names_file};
use crate::settings::Settings;

/// Contents of a scene file: objects and settings.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneFile {
    /// Objects, in the file's order.
    #[serde(default, rename = "object", skip_serializing_if = "Vec::is_empty")]
    pub objects: Vec<ObjectEntry>,
    /// Settings of the session.
    #[serde(default)]
    pub settings: Settings,
}

/// Object of a scene file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectEntry {
    /// Mesh file, `.clod` file or built-in model, as in [`Object::open`].
    pub model: String,
    /// Position of the mesh's frame in the world, m.
    #[serde(default)]
    pub position: DVec3,
    /// Rotation, a quaternion x, y, z, w that is normalised on reading.
    #[serde(default = "upright")]
    pub rotation: DQuat,
    /// Factor on the mesh's lengths.
    #[serde(default = "one")]
    pub scale: f64,
    /// Whether to repair the mesh to an oriented 2-manifold without self-intersections.
    #[serde(default)]
    pub repair: bool,
}

pub(crate) fn upright() -> DQuat {
    DQuat::IDENTITY
}

pub(crate) fn one() -> f64 {
    1.0
}

/// A scene or tool file was refused.
#[derive(Debug, thiserror::Error)]
pub enum SceneFileError {
    /// The file cannot be read.
    #[error("{path}: {source}")]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// The file is not a valid scene or tool.
    #[error("{path}: {message}")]
    Format {
        /// Path of the file.
        path: PathBuf,
        /// The line, the fault, and what is expected there.
        message: String,
    },
    /// The pose or scale of an object is invalid.
    #[error("{path}: object {number}, {model}: {what}")]
    Object {
        /// Path of the file.
        path: PathBuf,
        /// Number of the object, from 1.
        number: usize,
        /// Model of the object.
        model: String,
        /// The fault, and what to give instead.
        what: &'static str,
    },
    /// An object cannot be opened.
    #[error(transparent)]
    Open(#[from] OpenError),
}

impl SceneFile {
    /// Reads a scene file.
    ///
    /// # Errors
    /// If the file cannot be read, or is no valid scene file; the message names the line and what is expected
    /// there.
    pub fn load(path: &Path) -> Result<Self, SceneFileError> {
        read_toml(path)
    }

    /// Opens the objects, with their [warnings](Object::warnings). Relative paths start at the folder of
    /// `path`, the file that the scene was loaded from. `progress` receives the model, the stage, and the
    /// fraction of the stage that is done (0 to 1).
    ///
    /// # Errors
    /// If an object cannot be opened or placed.
    pub fn open(
        &self,
        path: &Path,
        progress: &mut dyn FnMut(&str, Stage, f64) -> ControlFlow<()>,
    ) -> Result<Scene, SceneFileError> {
        let mut scene = Scene::new();
        for (number, ObjectEntry { model, position, rotation, scale, repair }) in (1..).zip(&self.objects) {
            let pose = (*position, *rotation);
            let entry = Entry { number, model, pose, scale: *scale, repair: *repair };
            let (object, pose) = entry.open(path, progress)?;
            scene = scene.with(object, pose);
        }
        Ok(scene)
    }
}

/// Model and frame that a scene or tool file gives for one object.
pub(crate) struct Entry<'a> {
    /// Number of the object in the file, from 1.
    pub number: usize,
    pub model: &'a str,
    pub pose: (DVec3, DQuat),
    pub scale: f64,
    pub repair: bool,
}

impl Entry<'_> {
    /// Opens the object of an entry of the file at `path`, and normalises its pose.
    pub fn open(
        &self,
        path: &Path,
        progress: &mut dyn FnMut(&str, Stage, f64) -> ControlFlow<()>,
    ) -> Result<(Object, Pose), SceneFileError> {
        let Self { number, model, pose: (position, rotation), scale, repair } = *self;
        let refuse =
            |what| SceneFileError::Object { path: path.to_owned(), number, model: model.to_owned(), what };
        let pose = Pose::new(position, rotation.normalize());
        if !pose.is_valid() {
            return Err(refuse("give a finite position and a quaternion that is not zero"));
        }
        if !(scale.is_finite() && scale > 0.0) {
            return Err(refuse("give a scale above 0"));
        }
        let file = path.parent().unwrap_or(Path::new(".")).join(model);
        let argument = if names_file(model) { file.to_string_lossy().into_owned() } else { model.to_owned() };
        let built = Path::new(model).extension().is_some_and(|extension| extension == "clod");
        let options =
            OpenOptions { scale: if built { 1.0 } else { scale }, repair, ..OpenOptions::default() };
        let object = Object::open(&argument, &options, &mut |stage, done| progress(model, stage, done))?;
        let object = if built && scale != 1.0 { object.scaled(scale) } else { Some(object) };
        Ok((object.ok_or_else(|| refuse("give a scale that is less extreme"))?, pose))
    }
}

/// Reads a TOML file. An error names the line, and what is expected there.
pub(crate) fn read_toml<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, SceneFileError> {
    let text = std::fs::read_to_string(path)
        .map_err(|source| SceneFileError::Read { path: path.to_owned(), source })?;
    toml::from_str(&text).map_err(|error| {
        let line = error.span().map(|span| 1 + text[..span.start.min(text.len())].matches('\n').count());
        let place = line.map_or_else(String::new, |line| format!("line {line}: "));
        SceneFileError::Format { path: path.to_owned(), message: format!("{place}{}", error.message()) }
    })
}

#[cfg(test)]
mod tests {
    use palpate_clod_build::Stage;

    use super::*;
    use crate::settings::ContactSettings;

    fn written(text: &str) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("scene.toml");
        std::fs::write(&path, text).expect("written");
        (folder, path)
    }

    fn ignored(_: &str, _: Stage, _: f64) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }

    #[test]
    fn a_scene_file_is_read_opened_and_written() {
        let (folder, path) = written(
            "[[object]]\nmodel = \"ellipsoid@200\"\n\
             [[object]]\nmodel = \"part.obj\"\nposition = [0.0, 0.1, 0]\nrotation = [0, 0, 2.0, 0]\nscale = 0.5\n\
             [settings]\ncontact.friction = 0.25\n",
        );
        let obj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n";
        std::fs::write(folder.path().join("part.obj"), obj).expect("written");
        let file = SceneFile::load(&path).expect("a scene");
        assert_eq!(
            file.settings,
            Settings {
                contact: ContactSettings { friction: 0.25, ..ContactSettings::default() },
                ..Settings::default()
            }
        );
        let scene = file.open(&path, &mut ignored).expect("objects");
        assert!(scene.objects().iter().all(|placed| placed.object.warnings().is_empty()));
        let [first, second] = scene.objects() else { panic!("{} objects", scene.objects().len()) };
        assert_eq!(first.pose, Pose::IDENTITY);
        assert_eq!(second.pose, Pose::new(DVec3::Y * 0.1, DQuat::from_xyzw(0.0, 0.0, 1.0, 0.0)));
        let whole = second.object.clod.vertices.iter().copied().fold(DVec3::ZERO, DVec3::max);
        assert_eq!(whole, DVec3::splat(0.5));
        // A written file reads back the same.
        let again: SceneFile = toml::from_str(&toml::to_string(&file).expect("text")).expect("a scene");
        assert_eq!(again, file);
    }

    #[test]
    fn errors_name_the_line_or_the_object() {
        for (text, said) in [
            ("[[object]]\nmodle = \"x\"\n", "line 2: unknown field `modle`"),
            ("[[object]]\nmodel = \"x\"\nposition = [1.0]\n", "line 3"),
            ("\n[settings.contact]\nfriktion = 1.0\n", "line 3: unknown field `friktion`"),
            ("[[object]]\nmodel = \"no-such\"\n", "no-such"),
            ("[[object]]\nmodel = \"no.obj\"\n", "no.obj"),
            (
                "[[object]]\nmodel = \"ellipsoid\"\nscale = -1.0\n",
                "object 1, ellipsoid: give a scale above 0",
            ),
            (
                "[[object]]\nmodel = \"ellipsoid\"\nrotation = [0, 0, 0, 0]\n",
                "object 1, ellipsoid: give a finite",
            ),
            ("[[object]\n", "line 1"),
        ] {
            let (_folder, path) = written(text);
            let refused = SceneFile::load(&path).and_then(|file| file.open(&path, &mut ignored)).map(|_| ());
            let message = refused.expect_err(text).to_string();
            assert!(message.contains(said), "{text}: {message}");
        }
        let missing =
            SceneFile::load(Path::new("/nowhere/scene.toml")).expect_err("nothing there").to_string();
        assert!(missing.contains("/nowhere/scene.toml"), "{missing}");
    }
}
