//! The plugin that gives the ground near bodies colliders.

use super::colliders::{
    TerrainBodyPin, TerrainCollider, TerrainColliderPin, TerrainColliders, follow_surface,
    hold_in_place, update_colliders,
};
use super::settings::TerrainPhysics;
use crate::edit::{TerrainEditRedone, TerrainEditUndone, TerrainEdited};
use crate::terrain::{TileEvicted, TileLoaded, TileReloaded};
use avian3d::prelude::{Physics, PhysicsSystems};
use bevy::ecs::intern::Interned;
use bevy::ecs::schedule::ScheduleLabel;
use bevy::prelude::*;

/// Gives the ground near bodies, and in regions with a [`TerrainColliderPin`], colliders.
///
/// Part of [`TerrainPlugins`](crate::TerrainPlugins). Does nothing where the game has no
/// `PhysicsPlugins`. Cost: some 300 ns a body and physics step, and some 100 µs after an edit the
/// size of a large crater.
#[derive(Clone, Copy, Debug)]
pub struct TerrainPhysicsPlugin {
    schedule: Interned<dyn ScheduleLabel>,
}

impl TerrainPhysicsPlugin {
    /// A plugin for physics that run in `schedule`: the one that `PhysicsPlugins::new` was given.
    /// By default it is `FixedPostUpdate`.
    #[must_use]
    pub fn new(schedule: impl ScheduleLabel) -> Self {
        Self {
            schedule: schedule.intern(),
        }
    }
}

impl Default for TerrainPhysicsPlugin {
    fn default() -> Self {
        Self::new(FixedPostUpdate)
    }
}

/// What the plugin does in the schedule of physics.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TerrainPhysicsSystems {
    /// Colliders are made, rewritten and removed; in `PhysicsSystems::First`. Edits that are applied
    /// before it are in colliders when the step begins.
    Update,
}

impl Plugin for TerrainPhysicsPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<TerrainPhysics>()
            .init_resource::<TerrainColliders>()
            .register_type::<TerrainPhysics>()
            .register_type::<TerrainCollider>()
            .register_type::<TerrainColliderPin>()
            .register_type::<TerrainBodyPin>()
            .add_observer(
                |event: On<TerrainEdited>, mut all: ResMut<TerrainColliders>| {
                    all.edited(event.entity, event.rect);
                },
            )
            .add_observer(
                |event: On<TerrainEditUndone>, mut all: ResMut<TerrainColliders>| {
                    all.edited(event.entity, event.rect);
                },
            )
            .add_observer(
                |event: On<TerrainEditRedone>, mut all: ResMut<TerrainColliders>| {
                    all.edited(event.entity, event.rect);
                },
            )
            .add_observer(|event: On<TileLoaded>, mut all: ResMut<TerrainColliders>| {
                all.tile_changed(event.entity, event.address, true);
            })
            .add_observer(
                |event: On<TileReloaded>, mut all: ResMut<TerrainColliders>| {
                    all.tile_changed(event.entity, event.address, false);
                },
            )
            .add_observer(
                |event: On<TileEvicted>, mut all: ResMut<TerrainColliders>| {
                    all.tile_changed(event.entity, event.address, false);
                },
            )
            .add_observer(
                |event: On<Remove, TerrainCollider>,
                 colliders: Query<&TerrainCollider>,
                 mut all: ResMut<TerrainColliders>| {
                    if let Ok(collider) = colliders.get(event.entity) {
                        all.removed(event.entity, collider);
                    }
                },
            )
            .configure_sets(
                self.schedule,
                TerrainPhysicsSystems::Update.in_set(PhysicsSystems::First),
            )
            .add_systems(
                self.schedule,
                (hold_in_place, follow_surface, update_colliders)
                    .chain()
                    .in_set(TerrainPhysicsSystems::Update)
                    .run_if(resource_exists::<Time<Physics>>),
            );
    }
}
