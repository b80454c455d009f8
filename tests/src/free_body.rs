//! Free body in a host's world, pushed by contacts.

use palpate::core::Twist;
use palpate::dynamics::{Body, BodyState};
use palpate::glam::{DMat3, DVec3};
use palpate::{DynamicBody, Object, Pose, Reactions, SceneEditor, SceneId};

/// Free rigid body, integrated explicitly.
pub struct FreeBody {
    id: SceneId,
    /// Mass, kg.
    pub mass: f64,
    /// Inertia about the centre of mass, body axes, kg·m².
    pub inertia: DMat3,
    center_of_mass: DVec3,
    /// Pose of the centre of mass.
    pub pose: Pose,
    /// Twist of the centre of mass, world axes.
    pub twist: Twist,
}

impl FreeBody {
    /// Returns an object of a mass (kg) at rest, with the mesh's frame at a pose, and registers it with a
    /// session by the host's period (s) and gravity (m/s²), which the host applies.
    pub fn new(
        object: &Object,
        id: SceneId,
        mass: f64,
        pose: Pose,
        (period, gravity): (f64, DVec3),
        scene: &mut SceneEditor,
    ) -> Self {
        let center_of_mass = object.clod.source.center_of_mass;
        let inertia = object.clod.source.unit_inertia * mass;
        let mobility = DynamicBody { mass, inertia, center_of_mass, gravity, period };
        scene.set_dynamics(id, Some(mobility)).expect("a mobility");
        let pose = pose * Pose::from_translation(center_of_mass);
        Self { id, mass, inertia, center_of_mass, pose, twist: Twist::ZERO }
    }

    /// Returns the pose of the mesh's frame.
    pub fn mesh_pose(&self) -> Pose {
        self.pose * Pose::from_translation(-self.center_of_mass)
    }

    /// Applies an impulse (N·s) and an angular impulse about the centre of mass (N·m·s).
    pub fn push(&mut self, linear: DVec3, angular: DVec3) {
        let turn = DMat3::from_quat(self.pose.rotation);
        self.twist.linear += linear / self.mass;
        self.twist.angular += turn * self.inertia.inverse() * turn.transpose() * angular;
    }

    /// Returns the kinetic energy, J.
    pub fn energy(&self) -> f64 {
        let body = Body::new(self.mass, self.inertia).expect("a body");
        body.kinetic_energy(&BodyState { pose: self.pose, twist: self.twist })
    }

    /// Applies the contact impulses on it. Impulses on other objects are discarded.
    pub fn take(&mut self, reactions: &mut Reactions) {
        while let Some(reaction) = reactions.take() {
            if reaction.object == self.id {
                self.push(reaction.linear, reaction.angular_about(self.pose.translation));
            }
        }
    }

    /// Takes a step of its world: applies the contact impulses on it, moves on, and reports its pose.
    pub fn step(&mut self, dt: f64, reactions: &mut Reactions, scene: &mut SceneEditor) {
        self.take(reactions);
        self.pose = self.pose.moved(&self.twist, dt);
        let mesh = self.mesh_pose();
        let arm = mesh.translation - self.pose.translation;
        let twist = Twist { linear: self.twist.velocity_at(arm), angular: self.twist.angular };
        scene.set_motion(self.id, mesh, twist).expect("room");
    }
}
