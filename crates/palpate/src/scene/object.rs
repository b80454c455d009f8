//! Objects of a session: hierarchies from `.clod` files, mesh files and built-in models, with their textures
//! and fields.

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

use palpate_field::{FeatureMesh, FieldOptions};

use crate::scene::cache;
use crate::scene::field::{Field, FieldError, Fitness, check_place, welded};

/// Largest number of fields that an object keeps; the oldest is dropped first. With fewer, sessions with
/// several tolerances make fields again; with more, they take more memory.
const MAX_FIELDS: usize = 4;

/// Object that can be grasped or placed in the scene. Cheap to clone.
#[derive(Clone, Debug)]
pub struct Object {
    /// Source of the object: a file's path or a model's name.
    pub name: String,
    /// Hierarchy that contact queries read.
    pub clod: Arc<Clod>,
    /// Warnings of the loader.
    warnings: Arc<[LoadWarning]>,
    /// Hierarchy prepared for queries, made on first use.
    shape: Arc<OnceLock<Shape>>,
    texture: Option<Arc<TexturedSurface>>,
    /// Surface of the hierarchy without texture, made on first use.
    plain: Arc<OnceLock<Arc<TexturedSurface>>>,
    /// Linked features of the surface at full resolution, made on first use; `None` without triangles.
    features: Arc<OnceLock<Option<Arc<FeatureMesh>>>>,
    /// Fields made so far with their options, the oldest first.
    fields: Arc<Mutex<Vec<KeptField>>>,
    /// How well fields with some options would stand for it, the oldest first.
    fitness: Arc<Mutex<Vec<(FieldOptions, Fitness)>>>,
}

/// Field with the options that it was made with.
type KeptField = (FieldOptions, Arc<Field>);

/// Options of [`Object::open`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OpenOptions {
    /// Factor from the file's lengths to metres.
    pub scale: f64,
    /// Whether to repair the mesh to an oriented 2-manifold without self-intersections, which a hierarchy
    /// needs ([`repair`](palpate_mesh_io::repair)); the changes are listed in the warnings.
    pub repair: bool,
    /// Whether to load the built hierarchy from the user's cache folder, and store it there.
    pub cache: bool,
}

impl Default for OpenOptions {
    fn default() -> Self {
        Self { scale: 1.0, repair: false, cache: true }
    }
}

/// An object could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// A mesh file was refused.
    #[error(transparent)]
    Mesh(#[from] LoadError),
    /// The argument is neither a file nor a built-in model.
    #[cfg(feature = "models")]
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The argument is not a file, and there are no built-in models without the feature `models`.
    #[cfg(not(feature = "models"))]
    #[error(
        "{name}: there is no such file; if a built-in model is meant, build palpate with the feature `models`"
    )]
    NoModels {
        /// Name given.
        name: String,
    },
    /// A mesh is too large for its indices.
    #[error(transparent)]
    Size(#[from] palpate_core::mesh::MeshError),
    /// A hierarchy could not be built from the mesh.
    #[error("{name}: {source}")]
    Build {
        /// Name of the object.
        name: String,
        /// Cause.
        source: BuildError,
    },
    /// A surface cannot be given a texture.
    #[error("{name}: {source}")]
    Texture {
        /// Name of the object.
        name: String,
        /// Cause.
        source: SurfaceError,
    },
    /// No texture could be baked.
    #[error("{name}: {source}")]
    Bake {
        /// Name of the object.
        name: String,
        /// Cause.
        source: BakeError,
    },
    /// A `.clod` file was refused.
    #[error("{path}: {source}")]
    Clod {
        /// Path of the file.
        path: String,
        /// Cause.
        source: ClodError,
    },
    /// A mesh was needed, but a `.clod` file holds only a hierarchy.
    #[error("{path} is a hierarchy, not a mesh; give the mesh file or the built-in model it was built from")]
    NotAMesh {
        /// Path of the file.
        path: String,
    },
    /// An option that applies only to meshes was given with a `.clod` file.
    #[error(
        "{path} is already built; give OpenOptions::scale and OpenOptions::repair when building it, or scale it with \
         Object::scaled"
    )]
    AlreadyBuilt {
        /// Path of the file.
        path: String,
    },
}

/// Mesh with its source.
#[derive(Clone, Debug)]
pub struct NamedMesh {
    /// Path of the file or name of the model.
    pub name: String,
    /// Mesh with exactly equal vertices welded, m.
    pub mesh: TriMesh,
    /// Warnings of the loader: content that was left out, a doubtful unit, a repair, openings.
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
        let mut loaded = palpate_mesh_io::load(Path::new(argument), &load)?;
        loaded.warnings.extend(LoadWarning::of_openings(&loaded.mesh));
        return Ok(NamedMesh { name: argument.to_owned(), mesh: loaded.mesh, warnings: loaded.warnings });
    }
    let mut mesh = built_in(argument)?;
    if options.scale != 1.0 {
        mesh = scaled(mesh, options.scale, argument)?;
    }
    Ok(NamedMesh { name: argument.to_owned(), mesh, warnings: Vec::new() })
}

/// Generates a built-in model, `NAME` or `NAME@TRIANGLES`.
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
    /// Opens `argument`: a `.clod` file, a mesh file (.obj .stl .ply, and .gltf .glb with the feature `gltf`)
    /// or a built-in model (`NAME` or `NAME@TRIANGLES`; feature `models`). Builds the hierarchy of a mesh.
    /// `progress` receives the stage and the fraction of it that is done (0 to 1). Warnings of the loader are
    /// in the object's [`warnings`](Self::warnings).
    ///
    /// # Errors
    /// If the argument is refused; the message names the fault, its place, and what to do.
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
            let object = Self::from_clod(argument, clod);
            let open = welded(object.triangles()).and_then(|mesh| LoadWarning::of_openings(&mesh));
            return Ok(Self { warnings: open.into_iter().collect(), ..object });
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

    /// Opens a built-in model, a mesh file or a `.clod` file as [`open`](Self::open) does, with the default
    /// options: in metres, without repair, from the cache if it was built before.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn model(argument: &str) -> Result<Self, OpenError> {
        Self::open(argument, &OpenOptions::default(), &mut unwatched)
    }

    /// Warnings of the loader: content that was left out, a doubtful unit, a repair, openings. Empty for an
    /// object that was not read from a file.
    pub fn warnings(&self) -> &[LoadWarning] {
        &self.warnings
    }

    /// Makes an object from a mesh (m).
    ///
    /// # Errors
    /// If no hierarchy can be built from the mesh: it must be an oriented 2-manifold, with or without
    /// boundary, that does not intersect itself ([`palpate_mesh_io::repair`] makes one from any other mesh).
    #[cfg_attr(
        feature = "tracing",
        tracing::instrument(skip(mesh), fields(triangles = mesh.triangles().len()), err)
    )]
    pub fn from_mesh(name: &str, mesh: &TriMesh) -> Result<Self, OpenError> {
        let clod = palpate_clod_build::build(mesh, &BuildOptions::default(), &mut unwatched)
            .map_err(|source| OpenError::Build { name: name.to_owned(), source })?;
        Ok(Self::from_clod(name, clod))
    }

    /// Makes an object from a mesh (m) with texture coordinates and an image of fine detail (m) that
    /// displaces it (§4.2.2). Edges whose triangles' normals differ by more than `crease` (rad) are sharp
    /// ([`corner_directions`](palpate_texture_pd::corner_directions)).
    ///
    /// # Errors
    /// As [`from_mesh`](Self::from_mesh), or if the mesh is empty or not finite.
    pub fn textured(name: &str, mesh: &UvMesh, image: &HeightImage, crease: f64) -> Result<Self, OpenError> {
        let surface = TexturedSurface::textured(mesh, image, crease)
            .map_err(|source| OpenError::Texture { name: name.to_owned(), source })?;
        Ok(Self::from_mesh(name, mesh.mesh())?.with_texture(surface))
    }

    /// Makes an object from a coarse mesh, with a texture baked from a detailed mesh in the same frame
    /// ([`bake`](palpate_texture_pd::bake)), and a report of the accuracy. `progress` receives the fraction
    /// that is done (0 to 1).
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

    /// Makes an object from a hierarchy.
    pub fn from_clod(name: &str, clod: impl Into<Arc<Clod>>) -> Self {
        Self {
            name: name.to_owned(),
            clod: clod.into(),
            warnings: Arc::default(),
            shape: Arc::default(),
            texture: None,
            plain: Arc::default(),
            features: Arc::default(),
            fields: Arc::default(),
            fitness: Arc::default(),
        }
    }

    /// Adds fine detail (§4.4): `texture` displaces the coarse mesh that the hierarchy was built from, in the
    /// same frame. Contact queries ignore the detail; it is sampled where they find contacts.
    #[must_use]
    pub fn with_texture(self, texture: impl Into<Arc<TexturedSurface>>) -> Self {
        Self { texture: Some(texture.into()), ..self }
    }

    /// Haptic texture, with the surface that it displaces.
    pub fn texture(&self) -> Option<&Arc<TexturedSurface>> {
        self.texture.as_ref()
    }

    /// Surface that textured objects touch: the textured one, or that of the hierarchy at full resolution.
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

    /// Corners of the triangles of the surface at full resolution, m.
    pub(crate) fn triangles(&self) -> impl Iterator<Item = [DVec3; 3]> {
        self.clod.leaves().iter().flat_map(|leaf| {
            let hull = self.clod.hull(&leaf);
            self.clod.patch(&leaf).iter().map(move |triangle| triangle.map(|corner| hull[corner as usize]))
        })
    }

    /// Linked features of the surface at full resolution; `None` without triangles.
    pub(crate) fn features(&self) -> Option<Arc<FeatureMesh>> {
        let made = || welded(self.triangles()).map(|mesh| Arc::new(FeatureMesh::new(&mesh)));
        self.features.get_or_init(made).clone()
    }

    /// Linked features of the surface, if they are made by now.
    pub(crate) fn known_features(&self) -> Option<Arc<FeatureMesh>> {
        self.features.get().cloned().flatten()
    }

    /// Distance field of the surface at full resolution. The first call with given options makes the field,
    /// which takes seconds, or loads it from the user's cache folder; the last few fields are kept.
    ///
    /// # Errors
    /// If the surface is not closed, or too far from the frame's origin for double precision.
    pub fn field(&self, options: FieldOptions) -> Result<Arc<Field>, FieldError> {
        if let Some(known) = self.kept_field(&options) {
            return Ok(known);
        }
        let mesh = self.solid()?;
        let features = || self.features_of(&mesh);
        // No lock is held while the field is made. Another thread may make the same field meanwhile.
        let made = cache::stored_field(&mesh, features, &options)
            .unwrap_or_else(|| cache::make_field(&mesh, features(), &options));
        Ok(self.keep_field(options, made))
    }

    /// How well a distance field with given options stands for the surface. It takes a fraction of a second,
    /// and no field is made for it.
    ///
    /// # Errors
    /// As [`field`](Self::field).
    pub(crate) fn fitness(&self, options: &FieldOptions) -> Result<Fitness, FieldError> {
        if let Some(known) = self.kept_field(options) {
            return Ok(known.fitness());
        }
        let all = || self.fitness.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, known)) = all().iter().find(|(of, _)| of == options) {
            return Ok(*known);
        }
        let mesh = self.solid()?;
        if let Some(stored) = cache::stored_field(&mesh, || self.features_of(&mesh), options) {
            return Ok(self.keep_field(*options, stored).fitness());
        }
        let found = Fitness::of(&mesh, options);
        let mut all = all();
        if all.len() == MAX_FIELDS {
            all.remove(0);
        }
        all.push((*options, found));
        Ok(found)
    }

    fn kept_field(&self, options: &FieldOptions) -> Option<Arc<Field>> {
        let fields = self.fields.lock().unwrap_or_else(PoisonError::into_inner);
        fields.iter().find(|(of, _)| of == options).map(|kept| kept.1.clone())
    }

    /// Keeps a field that was made with some options, unless there is one; returns the one that is kept.
    fn keep_field(&self, options: FieldOptions, made: Field) -> Arc<Field> {
        let mut fields = self.fields.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, known)) = fields.iter().find(|(of, _)| *of == options) {
            return known.clone();
        }
        if fields.len() == MAX_FIELDS {
            fields.remove(0);
        }
        let made = Arc::new(made);
        fields.push((options, made.clone()));
        made
    }

    /// Linked features of the surface, whose [welded](Self::solid) mesh is at hand.
    fn features_of(&self, mesh: &TriMesh) -> Arc<FeatureMesh> {
        let made = || Arc::new(FeatureMesh::new(mesh));
        self.features.get_or_init(|| Some(made())).clone().unwrap_or_else(made)
    }

    /// The surface at full resolution, if it has an inside.
    fn solid(&self) -> Result<TriMesh, FieldError> {
        // A hierarchy that was not built from a solid may still look closed, but its inside is not defined.
        let mesh = self.clod.source.solid.then(|| welded(self.triangles())).flatten();
        let mesh = mesh.ok_or_else(|| FieldError::Open { name: self.name.clone() })?;
        check_place(&self.name, &mesh)?;
        Ok(mesh)
    }

    /// Scales the object about its frame's origin; `None` if the factor is not positive and finite, or too
    /// extreme, or the object has a texture. The scaled object takes as much memory again; copies of the same
    /// size at several poses ([`Scene::with`](crate::Scene::with)) share all memory.
    pub fn scaled(&self, factor: f64) -> Option<Self> {
        if self.texture.is_some() {
            return None;
        }
        Some(Self::from_clod(&self.name, self.clod.scaled(factor)?))
    }

    /// Hierarchy prepared for contact queries; the first call prepares it.
    pub fn shape(&self) -> &Shape {
        self.shape.get_or_init(|| Shape::new(self.clod.clone()))
    }

    /// Axis-aligned bounds of the surface at full resolution, mesh frame, m: the smallest and the largest x,
    /// y and z; `None` without triangles. Each call computes them.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        self.clod.bounds()
    }

    /// Radius of the bounding sphere, m.
    pub fn bounding_radius(&self) -> f64 {
        self.clod.bounding_radius()
    }

    /// Radius of a sphere about a point of the mesh's frame that contains the bounding sphere, m.
    pub(crate) fn radius_about(&self, point: DVec3) -> f64 {
        self.bounding_radius() + self.clod.source.center.distance(point)
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

/// Whether the argument names a file: it has an extension or a path separator, or such a file exists.
pub(crate) fn names_file(argument: &str) -> bool {
    extension(argument).is_some()
        || argument.contains(std::path::is_separator)
        || Path::new(argument).exists()
}

#[cfg(all(test, feature = "models"))]
mod tests {
    use super::*;

    const TETRAHEDRON: &str =
        "v 0 0 0\nv 10 0 0\nv 0 10 0\nv 0 0 10\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\nl 1 2\n";

    /// Warnings of the loader stay with the object and its clones.
    #[test]
    fn loader_warnings_stay_with_the_object() {
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

        // A hierarchy has no warnings, and accepts no scale.
        let built = folder.path().join("tetrahedron.clod");
        scaled.clod.save(&built).expect("written");
        let path = built.to_str().expect("text");
        assert_eq!(Object::model(path).expect("a hierarchy").warnings(), []);
        let refused = Object::open(path, &options, &mut unwatched).expect_err("built already").to_string();
        assert!(refused.contains("OpenOptions::scale") && !refused.contains("--"), "{refused}");
    }

    #[test]
    fn a_field_is_made_once_and_only_for_closed_surfaces() {
        let object = Object::model("torus@2000").expect("a model");
        let options = |tolerance| FieldOptions { memory: 500_000, ..FieldOptions::new(tolerance) };
        let made = object.field(options(0.002)).expect("a closed surface");
        let again = object.clone().field(options(0.002)).expect("a closed surface");
        assert!(Arc::ptr_eq(&made, &again), "the field is made once");
        let wider = object.field(options(0.004)).expect("a closed surface");
        assert!(!Arc::ptr_eq(&made, &wider), "another tolerance is another field");
        // Corners are shared as in the source mesh.
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

    /// A field that would be refused took 22 s and 48 MB to be made, for two parts of 40 triangles.
    #[test]
    fn the_fitness_of_a_field_is_known_before_it_is_made() {
        let object = Object::model("torus@2000").expect("a model");
        // Unlike those of other tests, whose fields may be in the user's cache.
        let tolerance = 0.0317 * object.bounding_radius();
        let options = FieldOptions { memory: 300_000, ..FieldOptions::new(tolerance) };
        let known = object.fitness(&options).expect("a closed surface");
        assert!(object.kept_field(&options).is_none(), "no field was made");
        let mesh = object.solid().expect("a closed surface");
        let made = Field::new(&mesh, object.features_of(&mesh), &options);
        assert_eq!(made.fitness(), known);
        assert!(known.error > 0.0 && known.error < options.tolerance, "{known:?}");

        // Where positions are too coarse, there is no field to ask about.
        let moved = |away: f64| {
            let vertices = mesh.vertices().iter().map(|vertex| *vertex + DVec3::X * away).collect();
            TriMesh::new(vertices, mesh.triangles().to_vec()).expect("a mesh")
        };
        let radius = mesh.bounding_sphere().radius;
        assert_eq!(check_place("ring", &moved(1e8 * radius)), Ok(()));
        let refused = check_place("ring", &moved(1e10 * radius)).expect_err("too far").to_string();
        assert!(refused.starts_with("ring: ") && refused.contains("move it to the origin"), "{refused}");
    }

    #[test]
    fn bounds_are_those_of_the_full_resolution_mesh() {
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
        // Hulls of coarser levels reach further.
        let all = &object.clod.vertices;
        let widest = all.iter().fold(DVec3::NEG_INFINITY, |high, vertex| high.max(*vertex));
        assert!(widest.cmpge(high).all() && widest != high, "{widest} {high}");
    }
}
