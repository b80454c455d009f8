//! Scenes as files, in TOML:
//!
//! ```toml
//! # Mesh files, by paths from this file's folder, .clod files and built-in models.
//! [[object]]
//! model = "lower-jaw"
//!
//! [[object]]
//! model = "ellipsoid@500"
//! position = [0.0, 0.0, 0.05]        # of its mesh's frame in the world, m
//! rotation = [0.0, 0.0, 0.0, 1.0]    # quaternion x, y, z, w
//! scale = 0.5                        # factor on its lengths
//! repair = true                      # make an oriented 2-manifold without self-intersection of it
//!
//! # What differs from the usual settings; see Settings.
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

/// A scene and settings as a file has them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneFile {
    /// The objects, in their order.
    #[serde(default, rename = "object", skip_serializing_if = "Vec::is_empty")]
    pub objects: Vec<ObjectEntry>,
    /// What to render with.
    #[serde(default)]
    pub settings: Settings,
}

/// An object of a scene file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectEntry {
    /// A mesh file, a `.clod` file or a built-in model, as [`Object::open`] takes them.
    pub model: String,
    /// Of its mesh's frame in the world, m.
    #[serde(default)]
    pub position: DVec3,
    /// Quaternion x, y, z, w; made of unit length.
    #[serde(default = "upright")]
    pub rotation: DQuat,
    /// Factor on its lengths.
    #[serde(default = "one")]
    pub scale: f64,
    /// Whether to make an oriented 2-manifold without self-intersection of it.
    #[serde(default)]
    pub repair: bool,
}

pub(crate) fn upright() -> DQuat {
    DQuat::IDENTITY
}

pub(crate) fn one() -> f64 {
    1.0
}

/// Why a scene file was refused.
#[derive(Debug, thiserror::Error)]
pub enum SceneFileError {
    /// It cannot be read.
    #[error("{path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// It is no scene: says where.
    #[error("{path}: {message}")]
    Format {
        /// The file.
        path: PathBuf,
        /// What, in which line, and what would do.
        message: String,
    },
    /// An object's pose or scale is none.
    #[error("{path}: object {number}, {model}: {what}")]
    Object {
        /// The file.
        path: PathBuf,
        /// Counted from 1.
        number: usize,
        /// Its model.
        model: String,
        /// What is wrong, and what would do.
        what: &'static str,
    },
    /// An object cannot be opened.
    #[error(transparent)]
    Open(#[from] OpenError),
}

impl SceneFile {
    /// Reads a file.
    ///
    /// # Errors
    /// If it cannot be read, or is no scene file: with the line, and what would do.
    pub fn load(path: &Path) -> Result<Self, SceneFileError> {
        read_toml(path)
    }

    /// Opens the objects, with paths from the folder of `path`, the file that this was loaded from; with their [warnings](Object::warnings).
    /// `progress` gets the model, the stage, and how much of that is done (0 to 1).
    ///
    /// # Errors
    /// If an object cannot be opened or placed.
    pub fn open(
        &self,
        path: &Path,
        progress: &mut dyn FnMut(&str, Stage, f64) -> ControlFlow<()>,
    ) -> Result<Scene, SceneFileError> {
        let folder = path.parent().unwrap_or(Path::new("."));
        let mut scene = Scene::new();
        for (index, ObjectEntry { model, position, rotation, scale, repair }) in
            self.objects.iter().enumerate()
        {
            let refuse = |what| SceneFileError::Object {
                path: path.to_owned(),
                number: index + 1,
                model: model.clone(),
                what,
            };
            let pose = Pose::new(*position, rotation.normalize());
            if !pose.is_valid() {
                return Err(refuse("give a finite position and a quaternion that is not zero"));
            }
            if !(scale.is_finite() && *scale > 0.0) {
                return Err(refuse("give a scale above 0"));
            }
            let object = open_model(folder, model, (*scale, *repair), progress)?
                .ok_or_else(|| refuse("give a scale that is less extreme"))?;
            scene = scene.with(object, pose);
        }
        Ok(scene)
    }
}

/// Reads a TOML file: an error says in which line, and what would do.
pub(crate) fn read_toml<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, SceneFileError> {
    let text = std::fs::read_to_string(path)
        .map_err(|source| SceneFileError::Read { path: path.to_owned(), source })?;
    toml::from_str(&text).map_err(|error| {
        let line = error.span().map(|span| 1 + text[..span.start.min(text.len())].matches('\n').count());
        let place = line.map_or_else(String::new, |line| format!("line {line}: "));
        SceneFileError::Format { path: path.to_owned(), message: format!("{place}{}", error.message()) }
    })
}

/// Opens a model that a file in `folder` names, at a scale and repaired if asked for; `None` where it cannot be scaled so.
pub(crate) fn open_model(
    folder: &Path,
    model: &str,
    (scale, repair): (f64, bool),
    progress: &mut dyn FnMut(&str, Stage, f64) -> ControlFlow<()>,
) -> Result<Option<Object>, OpenError> {
    let file = folder.join(model);
    let argument = if names_file(model) { file.to_string_lossy().into_owned() } else { model.to_owned() };
    let built = Path::new(model).extension().is_some_and(|extension| extension == "clod");
    let options = OpenOptions { scale: if built { 1.0 } else { scale }, repair, ..OpenOptions::default() };
    let object = Object::open(&argument, &options, &mut |stage, done| progress(model, stage, done))?;
    Ok(if built && scale != 1.0 { object.scaled(scale) } else { Some(object) })
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
    fn a_file_is_the_scene_that_it_says() {
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
        // What is written is read again.
        let again: SceneFile = toml::from_str(&toml::to_string(&file).expect("text")).expect("a scene");
        assert_eq!(again, file);
    }

    #[test]
    fn refusals_say_what_and_where() {
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
