//! Objects ready to be touched: a hierarchy from a `.clod` file, a mesh file or a built-in model's name.

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use palpate_clod_build::{BuildError, BuildOptions, Stage, unwatched};
use palpate_collide::Shape;
use palpate_core::clod::ClodError;
use palpate_core::glam::DVec3;
use palpate_core::mesh::UvMesh;
use palpate_core::{Clod, TriMesh};
use palpate_mesh_io::{LoadError, LoadOptions, LoadWarning};
#[cfg(feature = "models")]
use palpate_models::{Model, ModelError};
use palpate_texture_pd::{BakeError, BakeOptions, BakeReport, HeightImage, SurfaceError, TexturedSurface};

use palpate_field::FieldOptions;

use crate::scene::cache;
use crate::scene::field::{Field, FieldError, welded};

/// Fields that an object keeps at most; the oldest goes first.
const FIELDS: usize = 4;

/// An object that can be grasped or put into the scene. Cheap to clone.
#[derive(Clone, Debug)]
pub struct Object {
    /// What the object was made from: a file's path or a model's name.
    pub name: String,
    /// The hierarchy that contact queries read.
    pub clod: Arc<Clod>,
    /// What the loader warned of.
    warnings: Arc<[LoadWarning]>,
    /// Made when first asked for.
    shape: Arc<OnceLock<Shape>>,
    texture: Option<Arc<TexturedSurface>>,
    /// The hierarchy's surface, made when first asked for.
    plain: Arc<OnceLock<Arc<TexturedSurface>>>,
    /// Fields made so far, each with what it was asked for with, the oldest first.
    fields: Arc<Mutex<Vec<KeptField>>>,
}

/// What a field was asked for with, and the field.
type KeptField = (FieldOptions, Arc<Field>);

/// How [`Object::open`] reads and builds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OpenOptions {
    /// Factor that turns the file's lengths into metres.
    pub scale: f64,
    /// Whether to make an oriented 2-manifold without self-intersection of the mesh, which building needs
    /// ([`repair`](palpate_mesh_io::repair)); what that changed is among the warnings.
    pub repair: bool,
    /// Whether to look for, and keep, the built hierarchy in the user's cache folder.
    pub cache: bool,
}

impl Default for OpenOptions {
    fn default() -> Self {
        Self { scale: 1.0, repair: false, cache: true }
    }
}

/// Why an object could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// A mesh file was refused.
    #[error(transparent)]
    Mesh(#[from] LoadError),
    /// The argument is neither a file nor a built-in model.
    #[cfg(feature = "models")]
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The argument is no file, and there are no built-in models without the feature `models`.
    #[cfg(not(feature = "models"))]
    #[error(
        "{name}: there is no such file; if a built-in model is meant, build palpate with the feature `models`"
    )]
    NoModels {
        /// The name given.
        name: String,
    },
    /// A mesh is too large for its indices.
    #[error(transparent)]
    Size(#[from] palpate_core::mesh::MeshError),
    /// A hierarchy could not be built from the mesh.
    #[error("{name}: {source}")]
    Build {
        /// The object's name.
        name: String,
        /// Why.
        source: BuildError,
    },
    /// A surface cannot be given a texture.
    #[error("{name}: {source}")]
    Texture {
        /// The object's name.
        name: String,
        /// Why.
        source: SurfaceError,
    },
    /// No texture could be baked.
    #[error("{name}: {source}")]
    Bake {
        /// The object's name.
        name: String,
        /// Why.
        source: BakeError,
    },
    /// A `.clod` file was refused.
    #[error("{path}: {source}")]
    Clod {
        /// The file.
        path: String,
        /// Why.
        source: ClodError,
    },
    /// A mesh was needed, but a `.clod` file holds none.
    #[error("{path} is a hierarchy, not a mesh; give the mesh file or the built-in model it was built from")]
    NotAMesh {
        /// The file.
        path: String,
    },
    /// An option that only a mesh can follow was given with a `.clod` file.
    #[error(
        "{path} is already built; give OpenOptions::scale and OpenOptions::repair when building it, or scale it with \
         Object::scaled"
    )]
    AlreadyBuilt {
        /// The file.
        path: String,
    },
}

/// A mesh with where it came from.
#[derive(Clone, Debug)]
pub struct NamedMesh {
    /// A file's path or a model's name.
    pub name: String,
    /// The mesh, exactly welded, m.
    pub mesh: TriMesh,
    /// What the loader warned of: content that was left out, a doubtful unit, a repair.
    pub warnings: Vec<LoadWarning>,
}

/// Reads a mesh file or generates a built-in model (`NAME` or `NAME@TRIANGLES`; feature `models`).
///
/// # Errors
/// If the file or the model's name is refused, or `argument` is a `.clod` file.
pub fn open_mesh(argument: &str, options: &OpenOptions) -> Result<NamedMesh, OpenError> {
    if is_clod(argument) {
        return Err(OpenError::NotAMesh { path: argument.to_owned() });
    }
    if names_file(argument) {
        let load = LoadOptions { scale: options.scale, repair: options.repair, ..LoadOptions::default() };
        let loaded = palpate_mesh_io::load(Path::new(argument), &load)?;
        return Ok(NamedMesh { name: argument.to_owned(), mesh: loaded.mesh, warnings: loaded.warnings });
    }
    let mut mesh = built_in(argument)?;
    if options.scale != 1.0 {
        mesh = scaled(mesh, options.scale, argument)?;
    }
    Ok(NamedMesh { name: argument.to_owned(), mesh, warnings: Vec::new() })
}

/// A built-in model, `NAME` or `NAME@TRIANGLES`.
fn built_in(name: &str) -> Result<TriMesh, OpenError> {
    #[cfg(feature = "models")]
    {
        let (model, triangles) = Model::parse(name)?;
        Ok(model.generate(triangles)?)
    }
    #[cfg(not(feature = "models"))]
    Err(OpenError::NoModels { name: name.to_owned() })
}

impl Object {
    /// Opens `argument`, a `.clod` file, a mesh file (.obj .stl .ply, and .gltf .glb with the feature `gltf`) or a built-in model
    /// (`NAME` or `NAME@TRIANGLES`; feature `models`), building its hierarchy where it has none. `progress` gets the stage and how much of it is
    /// done (0 to 1). What the loader warns of is among the object's [`warnings`](Self::warnings).
    ///
    /// # Errors
    /// If the argument is refused: the error says what, where and what to do.
    #[cfg_attr(feature = "tracing", tracing::instrument(skip(options, progress), err))]
    pub fn open(
        argument: &str,
        options: &OpenOptions,
        progress: &mut dyn FnMut(Stage, f64) -> ControlFlow<()>,
    ) -> Result<Self, OpenError> {
        if is_clod(argument) {
            if options.repair || options.scale != 1.0 {
                return Err(OpenError::AlreadyBuilt { path: argument.to_owned() });
            }
            let clod = Clod::load(Path::new(argument))
                .map_err(|source| OpenError::Clod { path: argument.to_owned(), source })?;
            return Ok(Self::from_clod(argument, clod));
        }
        let NamedMesh { name, mesh, warnings } = open_mesh(argument, options)?;
        let clod = if options.cache {
            cache::build_or_load(&mesh, &BuildOptions::default(), progress)
        } else {
            palpate_clod_build::build(&mesh, &BuildOptions::default(), progress)
        }
        .map_err(|source| OpenError::Build { name: name.clone(), source })?;
        Ok(Self { warnings: warnings.into(), ..Self::from_clod(&name, clod) })
    }

    /// Opens a built-in model, a mesh file or a `.clod` file as [`open`](Self::open) does, with the usual options: in metres, without
    /// repair, from the cache where it was built before.
    ///
    /// # Errors
    /// If the argument is refused: the error says what, where and what to do.
    pub fn model(argument: &str) -> Result<Self, OpenError> {
        Self::open(argument, &OpenOptions::default(), &mut unwatched)
    }

    /// What the loader warned of: content that was left out, a doubtful unit, a repair. Empty for an object that was not read
    /// from a mesh file.
    pub fn warnings(&self) -> &[LoadWarning] {
        &self.warnings
    }

    /// An object from a mesh that the host already has, m.
    ///
    /// # Errors
    /// If no hierarchy can be built from the mesh: it has to be an oriented 2-manifold, with or without boundary, that
    /// does not intersect itself ([`palpate_mesh_io::repair`] makes one of any other).
    #[cfg_attr(
        feature = "tracing",
        tracing::instrument(skip(mesh), fields(triangles = mesh.triangles().len()), err)
    )]
    pub fn from_mesh(name: &str, mesh: &TriMesh) -> Result<Self, OpenError> {
        let clod = palpate_clod_build::build(mesh, &BuildOptions::default(), &mut unwatched)
            .map_err(|source| OpenError::Build { name: name.to_owned(), source })?;
        Ok(Self::from_clod(name, clod))
    }

    /// An object from a mesh (m) with texture coordinates and an image of fine detail (m) that displaces it (§4.2.2): `crease`
    /// tells its sharp edges ([`corner_directions`](palpate_texture_pd::corner_directions), rad).
    ///
    /// # Errors
    /// As [`from_mesh`](Self::from_mesh), or if the mesh is empty or not finite.
    pub fn textured(name: &str, mesh: &UvMesh, image: &HeightImage, crease: f64) -> Result<Self, OpenError> {
        let surface = TexturedSurface::textured(mesh, image, crease)
            .map_err(|source| OpenError::Texture { name: name.to_owned(), source })?;
        Ok(Self::from_mesh(name, mesh.mesh())?.with_texture(surface))
    }

    /// An object from a coarse mesh, whose texture is baked from a detailed one in the same frame
    /// ([`bake`](palpate_texture_pd::bake)), with how true that is; `progress` is told how much is done (0 to 1).
    ///
    /// # Errors
    /// As [`from_mesh`](Self::from_mesh), or if nothing can be baked.
    pub fn detailed(
        name: &str,
        coarse: &TriMesh,
        detailed: &TriMesh,
        options: &BakeOptions,
        progress: &mut dyn FnMut(f64) -> ControlFlow<()>,
    ) -> Result<(Self, BakeReport), OpenError> {
        let baked = palpate_texture_pd::bake(coarse, detailed, options, progress)
            .map_err(|source| OpenError::Bake { name: name.to_owned(), source })?;
        let object = Self::textured(name, &baked.mesh, &baked.image, options.crease)?;
        Ok((object, baked.report))
    }

    /// An object from a hierarchy that the host already has.
    pub fn from_clod(name: &str, clod: impl Into<Arc<Clod>>) -> Self {
        Self {
            name: name.to_owned(),
            clod: clod.into(),
            warnings: Arc::default(),
            shape: Arc::default(),
            texture: None,
            plain: Arc::default(),
            fields: Arc::default(),
        }
    }

    /// The object with fine detail (§4.4): the hierarchy is that of its coarse mesh, which `texture` displaces, in the same
    /// frame. The detail is not looked at by contact queries, but where they find contacts.
    #[must_use]
    pub fn with_texture(self, texture: impl Into<Arc<TexturedSurface>>) -> Self {
        Self { texture: Some(texture.into()), ..self }
    }

    /// Its haptic texture, with the surface that this displaces.
    pub fn texture(&self) -> Option<&Arc<TexturedSurface>> {
        self.texture.as_ref()
    }

    /// The surface to be touched by textured ones: the textured one, or that of the hierarchy at full resolution.
    ///
    /// # Errors
    /// If the hierarchy has no triangle.
    pub(crate) fn surface(&self) -> Result<Arc<TexturedSurface>, SurfaceError> {
        if let Some(known) = self.texture.as_ref().or_else(|| self.plain.get()) {
            return Ok(known.clone());
        }
        let surface = Arc::new(TexturedSurface::from_triangles(self.triangles())?);
        Ok(self.plain.get_or_init(|| surface).clone())
    }

    /// The triangles of the surface at full resolution, by their corners, m.
    pub(crate) fn triangles(&self) -> impl Iterator<Item = [DVec3; 3]> {
        self.clod.leaves().iter().flat_map(|leaf| {
            let hull = self.clod.hull(&leaf);
            self.clod.patch(&leaf).iter().map(move |triangle| triangle.map(|corner| hull[corner as usize]))
        })
    }

    /// The distance field of the surface at full resolution. The first call with some options makes it, which takes seconds, or takes
    /// it from the user's cache folder; the last few are kept.
    ///
    /// # Errors
    /// If the surface is not closed.
    pub fn field(&self, options: FieldOptions) -> Result<Arc<Field>, FieldError> {
        let fields = || self.fields.lock().unwrap_or_else(PoisonError::into_inner);
        let kept =
            |fields: &[KeptField]| fields.iter().find(|(of, _)| *of == options).map(|kept| kept.1.clone());
        if let Some(known) = kept(&fields()) {
            return Ok(known);
        }
        let open = || FieldError::Open { name: self.name.clone() };
        // A hierarchy that was not built from a solid may still look closed, but nothing is known of its inside.
        let mesh = self.clod.source.solid.then(|| welded(self.triangles())).flatten().ok_or_else(open)?;
        // Nobody waits for the lock meanwhile.
        let made = Arc::new(cache::field(&mesh, &options));
        let mut fields = fields();
        if let Some(known) = kept(&fields) {
            return Ok(known);
        }
        if fields.len() == FIELDS {
            fields.remove(0);
        }
        fields.push((options, made.clone()));
        Ok(made)
    }

    /// The object made larger by a factor about its frame's origin, which takes as much memory again; `None` if the factor
    /// is not positive and finite, or extreme, or the object has a texture. Objects that are moved only are
    /// [placed](crate::Scene::with) at several poses instead, which shares everything.
    pub fn scaled(&self, factor: f64) -> Option<Self> {
        if self.texture.is_some() {
            return None;
        }
        Some(Self::from_clod(&self.name, self.clod.scaled(factor)?))
    }

    /// The hierarchy prepared for contact queries; the first call prepares it.
    pub fn shape(&self) -> &Shape {
        self.shape.get_or_init(|| Shape::new(self.clod.clone()))
    }

    /// Axis-aligned bounds of the surface at full resolution, mesh frame, m: the smallest and the largest x, y and z;
    /// `None` without triangles. Computed anew by each call.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        self.clod.bounds()
    }

    /// Radius of the bounding sphere, m.
    pub fn bounding_radius(&self) -> f64 {
        self.clod.bounding_radius()
    }
}

fn scaled(mesh: TriMesh, scale: f64, name: &str) -> Result<TriMesh, OpenError> {
    if !(scale.is_finite() && scale > 0.0) {
        return Err(LoadError::Scale { file: name.into(), scale }.into());
    }
    let vertices = mesh.vertices().iter().map(|&vertex| vertex * scale).collect();
    Ok(TriMesh::new(vertices, mesh.triangles().to_vec())?)
}

fn extension(argument: &str) -> Option<String> {
    Path::new(argument).extension().map(|extension| extension.to_string_lossy().to_lowercase())
}

fn is_clod(argument: &str) -> bool {
    extension(argument).as_deref() == Some("clod")
}

/// Whether the argument means a file: it has a file name's extension or a folder in it, or there is such a file.
pub(crate) fn names_file(argument: &str) -> bool {
    extension(argument).is_some()
        || argument.contains(std::path::is_separator)
        || Path::new(argument).exists()
}

#[cfg(test)]
mod tests {
    use super::*;

    const TETRAHEDRON: &str =
        "v 0 0 0\nv 10 0 0\nv 0 10 0\nv 0 0 10\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\nl 1 2\n";

    /// A file is opened as a model is, and what its loader warned of stays with the object and its clones.
    #[test]
    fn warnings_are_on_the_object() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let file = folder.path().join("tetrahedron.obj");
        std::fs::write(&file, TETRAHEDRON).expect("written");
        let path = file.to_str().expect("text");
        let object =
            Object::open(path, &OpenOptions { cache: false, ..OpenOptions::default() }, &mut unwatched);
        let object = object.expect("a tetrahedron").clone();
        let [LoadWarning::Lines { count: 1 }, LoadWarning::Units { suggested: Some(scale), .. }] =
            object.warnings()
        else {
            panic!("{:?}", object.warnings())
        };
        assert_eq!(*scale, 1e-3);
        assert_eq!(Object::model(path).expect("a tetrahedron").warnings(), object.warnings());
        let options = OpenOptions { scale: 1e-3, cache: false, ..OpenOptions::default() };
        let scaled = Object::open(path, &options, &mut unwatched).expect("a tetrahedron");
        assert_eq!(scaled.warnings(), [LoadWarning::Lines { count: 1 }]);

        // A hierarchy has no warnings, and takes no scale.
        let built = folder.path().join("tetrahedron.clod");
        scaled.clod.save(&built).expect("written");
        let path = built.to_str().expect("text");
        assert_eq!(Object::model(path).expect("a hierarchy").warnings(), []);
        let refused = Object::open(path, &options, &mut unwatched).expect_err("built already").to_string();
        assert!(refused.contains("OpenOptions::scale") && !refused.contains("--"), "{refused}");
    }

    #[test]
    fn a_field_is_made_once_of_the_closed_surface() {
        let object = Object::model("torus@2000").expect("a model");
        let options = |tolerance| FieldOptions { memory: 500_000, ..FieldOptions::new(tolerance) };
        let made = object.field(options(0.002)).expect("a closed surface");
        let again = object.clone().field(options(0.002)).expect("a closed surface");
        assert!(Arc::ptr_eq(&made, &again), "it is made once");
        let wider = object.field(options(0.004)).expect("a closed surface");
        assert!(!Arc::ptr_eq(&made, &wider), "another tolerance is another field");
        // Corners are shared as in the mesh that it was built from.
        let mesh = welded(object.triangles()).expect("triangles");
        assert_eq!(mesh.vertices().len(), object.clod.source.vertices as usize);
        assert_eq!(mesh.triangles().len(), object.clod.source.triangles as usize);
        assert!(mesh.validate().is_solid());

        let corners = vec![DVec3::ZERO, 0.1 * DVec3::X, 0.1 * DVec3::Y];
        let triangle = TriMesh::new(corners, vec![[0, 1, 2]]).expect("a mesh");
        let open = Object::from_mesh("sheet", &triangle).expect("an open surface");
        let refused = open.field(options(0.002)).expect_err("an open surface").to_string();
        assert!(refused.starts_with("sheet: ") && refused.contains("not closed"), "{refused}");
    }

    #[test]
    fn bounds_are_those_of_the_mesh_at_full_resolution() {
        let name = "spoon@3000";
        let mesh = open_mesh(name, &OpenOptions::default()).expect("a model").mesh;
        let corners = mesh.triangles().iter().flatten().map(|corner| mesh.vertices()[*corner as usize]);
        let (low, high) = corners.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), corner| {
            (low.min(corner), high.max(corner))
        });
        let object = Object::from_mesh(name, &mesh).expect("a good mesh");
        assert_eq!(object.bounds(), Some((low, high)));
        assert_eq!(object.shape().bounds(), object.bounds());
        assert_eq!(object.scaled(2.0).and_then(|large| large.bounds()), Some((2.0 * low, 2.0 * high)));
        // What bounds coarser levels reaches further.
        let all = &object.clod.vertices;
        let widest = all.iter().fold(DVec3::NEG_INFINITY, |high, vertex| high.max(*vertex));
        assert!(widest.cmpge(high).all() && widest != high, "{widest} {high}");
    }
}
