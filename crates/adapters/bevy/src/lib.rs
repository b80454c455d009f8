//! Plugins for [Bevy](https://bevy.org): entities that are felt, and one that is in the hand.
//!
//! The haptic session runs in threads of its own and is never stepped by a schedule. Once a frame,
//! [`HapticPlugins`] sends it the poses and velocities of felt entities, and moves the grasped entity to the
//! latest pose from the session's mailbox. Contact impulses on entities with a [`Movable`] arrive as
//! [`ContactImpulse`] messages, and contact forces on the grasped object as [`HapticContacts`].
//!
//! Lengths are metres. Only Bevy's application, entities and transforms are used, in `f32`; the session
//! itself is in `f64`.
//!
//! ```no_run
//! use bevy_app::App;
//! use bevy_transform::components::Transform;
//! use palpate::device::{Emulation, Task};
//! use palpate::{HapticRenderer, Object, Pose, Scene, explore};
//! use palpate_bevy::{Felt, Grasped, HapticPlugins, Haptics};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let (probe, ball) = (Object::model("ellipsoid@500")?, Object::model("golf-ball@5000")?);
//! let scene = Scene::new().with(ball.clone(), Pose::IDENTITY);
//! let device = Emulation::default().open(explore::path(Task::default(), &probe, &scene)?)?;
//! let session = HapticRenderer::builder(probe).on(Box::new(device))?.spawn()?;
//!
//! let mut app = App::new();
//! app.add_plugins(HapticPlugins).insert_resource(Haptics::new(session));
//! app.world_mut().spawn((Felt::new(ball), Transform::default()));
//! app.world_mut().spawn((Grasped, Transform::default()));
//! app.run();
//! # Ok(())
//! # }
//! ```

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use bevy_app::{App, Plugin, PluginGroup, PluginGroupBuilder, PostUpdate, PreUpdate};
use bevy_ecs::prelude::*;
use bevy_math::{DQuat, DVec3};
use bevy_transform::TransformSystems;
use bevy_transform::components::{GlobalTransform, Transform};
use palpate::errors::EditError;
use palpate::{ContactForce, DynamicBody, Object, Pose, RunningSession, SceneId, Twist, glam};

/// Plugin group of [`GraspedPlugin`] and [`FeltPlugin`].
#[derive(Clone, Copy, Debug, Default)]
pub struct HapticPlugins;

impl PluginGroup for HapticPlugins {
    fn build(self) -> PluginGroupBuilder {
        PluginGroupBuilder::start::<Self>().add(GraspedPlugin).add(FeltPlugin)
    }
}

/// Moves [`Grasped`] entities to the grasped object, and publishes contacts, before each update.
#[derive(Clone, Copy, Debug, Default)]
pub struct GraspedPlugin;

impl Plugin for GraspedPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<HapticContacts>()
            .add_message::<ContactImpulse>()
            .add_systems(PreUpdate, (place_grasped, publish_contacts).in_set(HapticSystems::Receive));
    }
}

/// Sends [`Felt`] entities to the session, after transforms have been propagated.
#[derive(Clone, Copy, Debug, Default)]
pub struct FeltPlugin;

impl Plugin for FeltPlugin {
    fn build(&self, app: &mut App) {
        app.add_systems(
            PostUpdate,
            (forget_session, forget_felt, add_felt, move_felt, send_dynamics)
                .chain()
                .in_set(HapticSystems::Send)
                .after(TransformSystems::Propagate),
        );
    }
}

/// System sets of the exchange with the session.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum HapticSystems {
    /// In `PreUpdate`: state of the session is written to the world.
    Receive,
    /// In `PostUpdate`, after transforms have been propagated: changes of the world are sent to the session.
    Send,
}

/// Running session. Without it the plugins do nothing; when it is removed the session ends.
#[derive(Resource, Debug)]
pub struct Haptics {
    /// Locked by at most one system at a time.
    session: Mutex<RunningSession>,
    /// Number that identifies the session.
    number: u64,
    entities: HashMap<SceneId, Entity>,
}

impl Haptics {
    /// Wraps a session started by [`HapticRenderer::spawn`](palpate::HapticRenderer::spawn).
    pub fn new(session: RunningSession) -> Self {
        static SESSIONS: AtomicU64 = AtomicU64::new(0);
        let number = SESSIONS.fetch_add(1, Ordering::Relaxed);
        Self { session: Mutex::new(session), number, entities: HashMap::new() }
    }

    /// Returns the session, for example to change its settings or to read the wrench on its device.
    pub fn session(&mut self) -> &mut RunningSession {
        self.session.get_mut().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the entity of an object of the session's scene.
    pub fn entity(&self, object: SceneId) -> Option<Entity> {
        self.entities.get(&object).copied()
    }
}

/// Entity in the hand: its transform is that of the grasped object's mesh, in the world. It should have no
/// parent.
#[derive(Component, Clone, Copy, Debug, Default)]
#[require(Transform)]
pub struct Grasped;

/// Entity that is felt where its transform puts it, with its scale. A scale that differs between axes counts
/// as its largest component.
#[derive(Component, Clone, Debug)]
#[require(Transform)]
pub struct Felt {
    object: Object,
}

impl Felt {
    /// Returns the component for the shape of an object, whose mesh has the entity's frame. The hierarchy is
    /// prepared for queries when the entity is first seen; [`Object::shape`] does so before.
    pub fn new(object: Object) -> Self {
        Self { object }
    }

    /// Returns the object.
    pub fn object(&self) -> &Object {
        &self.object
    }
}

/// Felt entity that contacts push back, by [`ContactImpulse`]s, which the application applies.
#[derive(Component, Clone, Copy, Debug)]
pub struct Movable(pub DynamicBody);

/// Contact impulse on a felt entity since the last frame. There may be several per frame.
#[derive(Message, Clone, Copy, Debug, PartialEq)]
pub struct ContactImpulse {
    /// Pushed entity.
    pub entity: Entity,
    /// Impulse, N·s, world axes.
    pub linear: DVec3,
    /// Angular impulse about the world's origin, N·m·s, world axes.
    pub angular: DVec3,
}

/// Contact forces on the grasped object in the latest contact step, for drawing.
#[derive(Resource, Clone, Debug, Default)]
pub struct HapticContacts {
    /// Points (m) and forces (N), world axes.
    pub forces: Vec<ContactForce>,
}

/// State of an entity as last sent to the session.
#[derive(Component, Debug)]
struct Sent {
    id: SceneId,
    pose: Pose,
    /// Scale of the transform.
    scale: f64,
    moving: bool,
}

fn place_grasped(haptics: Option<ResMut<Haptics>>, mut grasped: Query<&mut Transform, With<Grasped>>) {
    let Some(mut haptics) = haptics else { return };
    let Some(pose) = haptics.bypass_change_detection().session().object_pose() else { return };
    for mut transform in &mut grasped {
        transform.translation = to_bevy(pose.translation).as_vec3();
        let glam::DQuat { x, y, z, w } = pose.rotation;
        transform.rotation = DQuat::from_xyzw(x, y, z, w).as_quat();
    }
}

fn publish_contacts(
    haptics: Option<ResMut<Haptics>>,
    mut contacts: ResMut<HapticContacts>,
    mut impulses: MessageWriter<ContactImpulse>,
) {
    let Some(mut haptics) = haptics else { return };
    let haptics = haptics.bypass_change_detection();
    contacts.forces.clear();
    contacts.forces.extend_from_slice(&haptics.session().contacts.latest().forces);
    while let Some(reaction) = haptics.session().reactions.take() {
        if let Some(entity) = haptics.entity(reaction.object) {
            let (linear, angular) = (to_bevy(reaction.linear), to_bevy(reaction.angular));
            impulses.write(ContactImpulse { entity, linear, angular });
        }
    }
}

/// Removes the state that was sent to another session, when a new one starts.
fn forget_session(
    haptics: Option<Res<Haptics>>,
    sent: Query<Entity, With<Sent>>,
    mut known: Local<Option<u64>>,
    mut commands: Commands,
) {
    let Some(haptics) = haptics else { return };
    if known.replace(haptics.number) != Some(haptics.number) {
        for entity in &sent {
            commands.entity(entity).remove::<Sent>();
        }
    }
}

/// Removes entities that are no longer felt, or have changed.
fn forget_felt(
    haptics: Option<ResMut<Haptics>>,
    mut removed: RemovedComponents<Felt>,
    changed: Query<Entity, (With<Sent>, Changed<Felt>)>,
    mut leaving: Local<Vec<SceneId>>,
    mut commands: Commands,
) {
    let Some(mut haptics) = haptics else {
        removed.clear();
        leaving.clear();
        return;
    };
    let haptics = haptics.bypass_change_detection();
    for entity in removed.read().chain(&changed) {
        let id = haptics.entities.iter().find(|(_, known)| **known == entity).map(|(id, _)| *id);
        if let Some(id) = id {
            haptics.entities.remove(&id);
            leaving.push(id);
        }
        if let Ok(mut entity) = commands.get_entity(entity) {
            entity.try_remove::<Sent>();
        }
    }
    // Removals without room are repeated in the next frame.
    leaving.retain(|&id| haptics.session().scene.remove(id) == Err(EditError::Full));
}

/// Adds entities that are to be felt.
fn add_felt(
    haptics: Option<ResMut<Haptics>>,
    new: Query<(Entity, &Felt, &GlobalTransform), Without<Sent>>,
    mut commands: Commands,
) {
    let Some(mut haptics) = haptics else { return };
    let haptics = haptics.bypass_change_detection();
    for (entity, felt, transform) in &new {
        let (pose, scale) = placed(transform);
        let scaled = if scale == 1.0 { Some(felt.object.clone()) } else { felt.object.scaled(scale) };
        let Some(id) = scaled.and_then(|object| haptics.session().scene.add(&object, pose).ok()) else {
            continue;
        };
        haptics.entities.insert(id, entity);
        commands.entity(entity).insert(Sent { id, pose, scale, moving: false });
    }
}

/// Sends poses of felt entities, and their velocities since the last frame.
fn move_felt(
    haptics: Option<ResMut<Haptics>>,
    mut felt: Query<(&Felt, &GlobalTransform, &mut Sent)>,
    mut last: Local<Option<Instant>>,
) {
    let now = Instant::now();
    let since = last.replace(now).map_or(0.0, |last| (now - last).as_secs_f64());
    let Some(mut haptics) = haptics else { return };
    let haptics = haptics.bypass_change_detection();
    for (felt, transform, mut sent) in &mut felt {
        let (pose, scale) = placed(transform);
        if (pose, scale) == (sent.pose, sent.scale) && !sent.moving {
            continue;
        }
        let scene = &mut haptics.session().scene;
        let offset = pose.translation - sent.pose.translation;
        let outcome = if scale != sent.scale {
            // An object that cannot have this scale keeps its size.
            let object = felt.object.scaled(scale);
            object.map_or(Ok(false), |object| scene.replace(sent.id, &object, pose).map(|()| false))
        } else if since == 0.0 || offset.length() > felt.object.bounding_radius() * scale {
            // It was placed elsewhere, without passing through the space between.
            scene.set_pose(sent.id, pose).map(|()| false)
        } else {
            let angular = sent.pose.rotation_vector_to(&pose) / since;
            let twist = Twist { linear: offset / since, angular };
            // Sent once more when it has come to rest.
            scene.set_motion(sent.id, pose, twist).map(|()| twist != Twist::ZERO)
        };
        if let Ok(moving) = outcome {
            *sent = Sent { pose, scale, moving, ..*sent };
        }
    }
}

type NewlyMovable = Or<(Added<Sent>, Changed<Movable>)>;

/// Sends which entities contacts push back.
fn send_dynamics(
    haptics: Option<ResMut<Haptics>>,
    movable: Query<(&Sent, &Movable), NewlyMovable>,
    mut fixed: RemovedComponents<Movable>,
    sent: Query<&Sent>,
    mut late: Local<Vec<(SceneId, Option<DynamicBody>)>>,
) {
    let Some(mut haptics) = haptics else {
        fixed.clear();
        return;
    };
    let scene = &mut haptics.bypass_change_detection().session().scene;
    let now_fixed = fixed.read().filter_map(|entity| sent.get(entity).ok()).map(|sent| (sent.id, None));
    late.extend(movable.iter().map(|(sent, movable)| (sent.id, Some(movable.0))).chain(now_fixed));
    // Changes without room are repeated in the next frame.
    late.retain(|&(id, dynamics)| scene.set_dynamics(id, dynamics) == Err(EditError::Full));
}

/// Returns the pose and the scale of a transform.
fn placed(transform: &GlobalTransform) -> (Pose, f64) {
    let (scale, rotation, translation) = transform.to_scale_rotation_translation();
    let [x, y, z] = translation.as_dvec3().to_array();
    let turn = rotation.as_dquat().normalize();
    let rotation = glam::DQuat::from_xyzw(turn.x, turn.y, turn.z, turn.w);
    (Pose::new(glam::DVec3::new(x, y, z), rotation), f64::from(scale.abs().max_element()))
}

fn to_bevy(vector: glam::DVec3) -> DVec3 {
    DVec3::from_array(vector.to_array())
}
