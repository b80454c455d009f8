//! Plugins for [Bevy](https://bevy.org): entities that are felt, and one that is in the hand.
//!
//! The haptic session runs in threads of its own and is never stepped by a schedule: [`HapticPlugins`] only tells it, once a frame, where
//! felt entities are and how fast they move, and puts the grasped entity where the session's mailbox says that it is. What contacts push
//! entities with comes as [`ContactImpulse`] messages, for those that have a [`Movable`], and where they push as [`HapticContacts`].
//!
//! Lengths are metres. Only Bevy's application, entities and transforms are used, in `f32`; the session itself is in `f64`.
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

/// Both plugins: [`GraspedPlugin`] and [`FeltPlugin`].
#[derive(Clone, Copy, Debug, Default)]
pub struct HapticPlugins;

impl PluginGroup for HapticPlugins {
    fn build(self) -> PluginGroupBuilder {
        PluginGroupBuilder::start::<Self>().add(GraspedPlugin).add(FeltPlugin)
    }
}

/// Puts [`Grasped`] entities where the session has the object in the hand, and tells contacts, before each update.
#[derive(Clone, Copy, Debug, Default)]
pub struct GraspedPlugin;

impl Plugin for GraspedPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<HapticContacts>()
            .add_message::<ContactImpulse>()
            .add_systems(PreUpdate, (place_grasped, tell_contacts).in_set(HapticSystems::Receive));
    }
}

/// Tells the session of [`Felt`] entities, after transforms have been propagated.
#[derive(Clone, Copy, Debug, Default)]
pub struct FeltPlugin;

impl Plugin for FeltPlugin {
    fn build(&self, app: &mut App) {
        app.add_systems(
            PostUpdate,
            (forget_session, forget_felt, add_felt, move_felt, tell_mobility)
                .chain()
                .in_set(HapticSystems::Send)
                .after(TransformSystems::Propagate),
        );
    }
}

/// When the session is heard and told.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum HapticSystems {
    /// In `PreUpdate`: what the session says is put into the world.
    Receive,
    /// In `PostUpdate`, after transforms have been propagated: what the world says is told to the session.
    Send,
}

/// The session. Without it the plugins do nothing; when it is removed the session ends.
#[derive(Resource, Debug)]
pub struct Haptics {
    /// Never locked but by one system at a time.
    session: Mutex<RunningSession>,
    /// Which session it is.
    number: u64,
    entities: HashMap<SceneId, Entity>,
}

impl Haptics {
    /// A session that runs, begun by [`HapticRenderer::spawn`](palpate::HapticRenderer::spawn).
    pub fn new(session: RunningSession) -> Self {
        static SESSIONS: AtomicU64 = AtomicU64::new(0);
        let number = SESSIONS.fetch_add(1, Ordering::Relaxed);
        Self { session: Mutex::new(session), number, entities: HashMap::new() }
    }

    /// The session, as to change its settings or to see what its device is sent.
    pub fn session(&mut self) -> &mut RunningSession {
        self.session.get_mut().unwrap_or_else(PoisonError::into_inner)
    }

    /// The entity of an object of the session's scene.
    pub fn entity(&self, object: SceneId) -> Option<Entity> {
        self.entities.get(&object).copied()
    }
}

/// The entity that is in the hand: its transform is that of the grasped object's mesh, in the world. It should have no parent.
#[derive(Component, Clone, Copy, Debug, Default)]
#[require(Transform)]
pub struct Grasped;

/// An entity that is felt where its transform puts it, with its scale if that is the same along all axes; others are taken for the
/// largest.
#[derive(Component, Clone, Debug)]
#[require(Transform)]
pub struct Felt {
    object: Object,
}

impl Felt {
    /// With the shape of an object, its mesh's frame being the entity's. What a hierarchy needs to be queried is prepared when the
    /// entity is first seen; [`Object::shape`] does so before.
    pub fn new(object: Object) -> Self {
        Self { object }
    }

    /// The object.
    pub fn object(&self) -> &Object {
        &self.object
    }
}

/// A felt entity that contacts push back, by [`ContactImpulse`]s, for whatever moves it.
#[derive(Component, Clone, Copy, Debug)]
pub struct Movable(pub DynamicBody);

/// What contacts pushed a felt entity with since the last frame. Where several sessions' steps lie between, there are several.
#[derive(Message, Clone, Copy, Debug, PartialEq)]
pub struct ContactImpulse {
    /// The entity.
    pub entity: Entity,
    /// Impulse, N·s, world axes.
    pub linear: DVec3,
    /// Angular impulse about the world's origin, N·m·s, world axes.
    pub angular: DVec3,
}

/// Where contacts push the grasped object, as of the latest contact step, for drawing.
#[derive(Resource, Clone, Debug, Default)]
pub struct HapticContacts {
    /// Points (m) and forces (N), world axes.
    pub forces: Vec<ContactForce>,
}

/// What the session knows of an entity.
#[derive(Component, Debug)]
struct Told {
    id: SceneId,
    pose: Pose,
    /// Of the transform.
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

fn tell_contacts(
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

/// A session that has just begun knows nothing of what another was told.
fn forget_session(
    haptics: Option<Res<Haptics>>,
    told: Query<Entity, With<Told>>,
    mut known: Local<Option<u64>>,
    mut commands: Commands,
) {
    let Some(haptics) = haptics else { return };
    if known.replace(haptics.number) != Some(haptics.number) {
        for entity in &told {
            commands.entity(entity).remove::<Told>();
        }
    }
}

/// Takes out what is felt no longer, or is felt otherwise.
fn forget_felt(
    haptics: Option<ResMut<Haptics>>,
    mut removed: RemovedComponents<Felt>,
    changed: Query<Entity, (With<Told>, Changed<Felt>)>,
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
            entity.try_remove::<Told>();
        }
    }
    // Where too many changes wait they leave in the next frame.
    leaving.retain(|&id| haptics.session().scene.remove(id) == Err(EditError::Full));
}

/// Adds what is to be felt and is not yet.
fn add_felt(
    haptics: Option<ResMut<Haptics>>,
    new: Query<(Entity, &Felt, &GlobalTransform), Without<Told>>,
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
        commands.entity(entity).insert(Told { id, pose, scale, moving: false });
    }
}

/// Tells where what is felt is, and how fast it moved since the last frame.
fn move_felt(
    haptics: Option<ResMut<Haptics>>,
    mut felt: Query<(&Felt, &GlobalTransform, &mut Told)>,
    mut last: Local<Option<Instant>>,
) {
    let now = Instant::now();
    let since = last.replace(now).map_or(0.0, |last| (now - last).as_secs_f64());
    let Some(mut haptics) = haptics else { return };
    let haptics = haptics.bypass_change_detection();
    for (felt, transform, mut told) in &mut felt {
        let (pose, scale) = placed(transform);
        if (pose, scale) == (told.pose, told.scale) && !told.moving {
            continue;
        }
        let scene = &mut haptics.session().scene;
        let way = pose.translation - told.pose.translation;
        let outcome = if scale != told.scale {
            // An object that cannot be scaled so keeps its size.
            let object = felt.object.scaled(scale);
            object.map_or(Ok(false), |object| scene.replace(told.id, &object, pose).map(|()| false))
        } else if since == 0.0 || way.length() > felt.object.bounding_radius() * scale {
            // It is elsewhere, and did not get there through what is between.
            scene.set_pose(told.id, pose).map(|()| false)
        } else {
            let angular = told.pose.rotation_vector_to(&pose) / since;
            let twist = Twist { linear: way / since, angular };
            // Told once more when it has come to rest.
            scene.set_motion(told.id, pose, twist).map(|()| twist != Twist::ZERO)
        };
        if let Ok(moving) = outcome {
            *told = Told { pose, scale, moving, ..*told };
        }
    }
}

type NewlyMovable = Or<(Added<Told>, Changed<Movable>)>;

/// Says what contacts push back.
fn tell_mobility(
    haptics: Option<ResMut<Haptics>>,
    movable: Query<(&Told, &Movable), NewlyMovable>,
    mut fixed: RemovedComponents<Movable>,
    told: Query<&Told>,
    mut late: Local<Vec<(SceneId, Option<DynamicBody>)>>,
) {
    let Some(mut haptics) = haptics else {
        fixed.clear();
        return;
    };
    let scene = &mut haptics.bypass_change_detection().session().scene;
    let now_fixed = fixed.read().filter_map(|entity| told.get(entity).ok()).map(|told| (told.id, None));
    late.extend(movable.iter().map(|(told, movable)| (told.id, Some(movable.0))).chain(now_fixed));
    // Where too many changes wait they are told in the next frame.
    late.retain(|&(id, mobility)| scene.set_dynamics(id, mobility) == Err(EditError::Full));
}

/// The pose that a transform means, and its scale.
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
