//! A body that nothing holds, in a host's world: pushed by what touches it.

use palpate::core::Twist;
use palpate::dynamics::{Body, BodyState};
use palpate::glam::{DMat3, DVec3};
use palpate::{DynamicBody, Object, Pose, Reactions, SceneEditor, SceneId};

/// A free rigid body, stepped explicitly.
pub struct FreeBody {
    id: SceneId,
    /// kg.
    pub mass: f64,
    /// About the centre of mass, body axes, kg·m².
    pub inertia: DMat3,
    center_of_mass: DVec3,
    /// Of the centre of mass.
    pub pose: Pose,
    /// Of the centre of mass, world axes.
    pub twist: Twist,
}

impl FreeBody {
    /// An object of a mass (kg) at rest, with the mesh's frame at a pose, told to a session with the host's period (s).
    pub fn new(
        object: &Object,
        id: SceneId,
        mass: f64,
        pose: Pose,
        period: f64,
        scene: &mut SceneEditor,
    ) -> Self {
        let center_of_mass = object.clod.source.center_of_mass;
        let inertia = object.clod.source.unit_inertia * mass;
        let mobility = DynamicBody { mass, inertia, center_of_mass, period };
        scene.set_dynamics(id, Some(mobility)).expect("a mobility");
        let pose = pose * Pose::from_translation(center_of_mass);
        Self { id, mass, inertia, center_of_mass, pose, twist: Twist::ZERO }
    }

    /// Pose of the mesh's frame.
    pub fn mesh_pose(&self) -> Pose {
        self.pose * Pose::from_translation(-self.center_of_mass)
    }

    /// Gives it an impulse (N·s), and an angular one about its centre of mass (N·m·s).
    pub fn push(&mut self, linear: DVec3, angular: DVec3) {
        let turn = DMat3::from_quat(self.pose.rotation);
        self.twist.linear += linear / self.mass;
        self.twist.angular += turn * self.inertia.inverse() * turn.transpose() * angular;
    }

    /// Kinetic energy, J.
    pub fn energy(&self) -> f64 {
        let body = Body::new(self.mass, self.inertia).expect("a body");
        body.kinetic_energy(&BodyState { pose: self.pose, twist: self.twist })
    }

    /// A step of its world: it takes what it was pushed with, moves on, and tells where it is. What others were pushed with is
    /// passed over.
    pub fn step(&mut self, dt: f64, reactions: &mut Reactions, scene: &mut SceneEditor) {
        while let Some(reaction) = reactions.take() {
            if reaction.object == self.id {
                self.push(reaction.linear, reaction.angular_about(self.pose.translation));
            }
        }
        self.pose = self.pose.moved(&self.twist, dt);
        let mesh = self.mesh_pose();
        let arm = mesh.translation - self.pose.translation;
        let twist = Twist { linear: self.twist.velocity_at(arm), angular: self.twist.angular };
        scene.set_motion(self.id, mesh, twist).expect("room");
    }
}
