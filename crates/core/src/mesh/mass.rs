//! Volume, centre of mass and inertia of a solid, as polyhedral integrals.

use glam::{DMat3, DVec3};

use super::{MeshError, TriMesh};

/// Mass properties of a solid of uniform density.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MassProperties {
    /// Mass, kg.
    pub mass: f64,
    /// Volume, m³.
    pub volume: f64,
    /// Centre of mass, m, in the mesh's frame.
    pub center_of_mass: DVec3,
    /// Inertia tensor about the centre of mass, kg·m², in the mesh's axes.
    pub inertia: DMat3,
}

impl TriMesh {
    /// Mass properties at a uniform density (kg/m³).
    pub fn mass_properties(&self, density: f64) -> Result<MassProperties, MeshError> {
        let _ = density;
        Err(MeshError::NoVolume)
    }
}
