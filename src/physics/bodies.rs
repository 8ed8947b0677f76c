//! The bodies that need ground, as boxes.

use avian3d::dynamics::solver::islands::BodyIslandNode;
use avian3d::dynamics::solver::solver_body::SolverBody;
use avian3d::prelude::{
    ColliderAabb, LinearVelocity, RigidBody, RigidBodyColliders, RigidBodyDisabled, Sensor,
    Sleeping,
};
use bevy::ecs::system::SystemParam;
use bevy::math::Affine3A;
use bevy::prelude::*;

/// A body that moves, or could.
#[derive(Clone, Copy, Debug)]
pub(super) struct Body {
    pub(super) entity: Entity,
    pub(super) is_dynamic: bool,
    pub(super) is_sleeping: bool,
    pub(super) velocity: Vec3,
    centre: Vec3,
    half: Vec3,
}

/// A box along the axes of a terrain's own space.
#[derive(Clone, Copy, Debug)]
pub(super) struct LocalBox {
    pub(super) centre: Vec3,
    pub(super) half: Vec3,
}

/// Dynamic and kinematic bodies, asleep or awake.
type Moving = (
    Or<(With<SolverBody>, With<BodyIslandNode>)>,
    Without<RigidBodyDisabled>,
);
type MovingBody = (
    Entity,
    &'static RigidBody,
    &'static LinearVelocity,
    &'static RigidBodyColliders,
    Has<Sleeping>,
);

/// Everything that is known of bodies.
#[derive(SystemParam)]
pub(super) struct Bodies<'w, 's> {
    bodies: Query<'w, 's, MovingBody, Moving>,
    // A sensor may be as large as a country.
    boxes: Query<'w, 's, &'static ColliderAabb, Without<Sensor>>,
}

impl Bodies<'_, '_> {
    /// Writes all bodies into `bodies` that have a box and are dynamic, or also kinematic.
    pub(super) fn collect(&self, kinematic: bool, bodies: &mut Vec<Body>) {
        bodies.clear();
        for (entity, kind, velocity, colliders, is_sleeping) in &self.bodies {
            if !(kind.is_dynamic() || kinematic && kind.is_kinematic()) {
                continue;
            }
            let boxes = colliders
                .iter()
                .filter_map(|collider| self.boxes.get(collider).ok());
            let (min, max) = boxes.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(min, max), own| {
                (min.min(own.min), max.max(own.max))
            });
            // No collider, or one that hasn't a place yet.
            if !(min.cmple(max).all() && min.is_finite() && max.is_finite()) {
                continue;
            }
            let is_moving = velocity.0.is_finite() && !is_sleeping;
            bodies.push(Body {
                entity,
                is_dynamic: kind.is_dynamic(),
                is_sleeping,
                velocity: if is_moving { velocity.0 } else { Vec3::ZERO },
                centre: (min + max) * 0.5,
                half: (max - min) * 0.5,
            });
        }
    }
}

impl Body {
    /// The box in the space that `to_local` leads to.
    pub(super) fn within(&self, to_local: &Affine3A) -> LocalBox {
        let axes = to_local.matrix3;
        LocalBox {
            centre: to_local.transform_point3(self.centre),
            half: Vec3::from(
                axes.x_axis.abs() * self.half.x
                    + axes.y_axis.abs() * self.half.y
                    + axes.z_axis.abs() * self.half.z,
            ),
        }
    }
}
