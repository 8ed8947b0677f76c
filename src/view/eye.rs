//! Two view points in one camera: the eye that the level of detail follows, and the one that sees
//! the picture (Cantlay 2011, "Debug Options").

use super::Optics;
use crate::render::{LightVolume, LightVolumes};
use crate::terrain::TerrainSystems;
use bevy::camera::CameraUpdateSystems;
use bevy::camera::primitives::Frustum;
use bevy::math::primitives::ViewFrustum;
use bevy::prelude::*;
use bevy::transform::TransformSystems;
use bevy::transform::helper::TransformHelper;
use bevy::transform::systems::{
    mark_dirty_trees, propagate_parent_transforms, sync_simple_transforms,
};

/// Which of a camera's two view points its `Transform` moves; put it on a
/// [`TerrainCamera`](crate::terrain::TerrainCamera) to look at the level of detail of one place from
/// another, which is how cracks are found. Without it both are one.
///
/// What doesn't move stays where it was in the frame before the one in which the value was set, which
/// is what the last picture shows; [`HeldTerrainEye`] says where. On a camera that is spawned with
/// the value it stays where the camera was spawned. It stays in the world, whatever the camera's
/// parents do.
///
/// Switched from one held point to the other, both stay where they are: the camera's `Transform`
/// jumps to the point that it moves from now on. What that frame did to the `Transform` is lost, and a
/// camera controller that keeps angles of its own turns the camera back to them. (Under a parent
/// that is scaled unevenly and turned, the place is found again only approximately.) Back at
/// [`EyeAndLod`](Self::EyeAndLod), or when the component is removed, both are where the `Transform`
/// is, in the same frame.
///
/// It takes effect as a part of Bevy's `TransformSystems::Propagate` in `PostUpdate`: whatever is
/// ordered before that set may change the value, and whatever is ordered after it reads the camera's
/// held or moved `GlobalTransform`.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Reflect)]
#[reflect(Component, Default, Debug, Clone, PartialEq, Hash)]
pub enum TerrainEye {
    /// Both.
    #[default]
    EyeAndLod,
    /// The eye that sees: level of detail, selection, culling and streaming stay those of the place
    /// that is left, as do the projection and the picture's height that they follow from. Ground
    /// that wasn't in view there is missing.
    ///
    /// Ground that throws shadows into that view stays, too: that which lights saw then. A light
    /// that is moved, turned or added later may lack casters. The shadows themselves are drawn for
    /// the eye that moves. Edits, and changed settings of the
    /// [`TerrainCamera`](crate::terrain::TerrainCamera), still change the mesh.
    EyeOnly,
    /// The eye that the level of detail follows: the picture stays that of the place that is left,
    /// and the camera's `GlobalTransform` with it. The ground is there that the moved eye would see,
    /// that the picture shows, or that throws shadows into it.
    ///
    /// What is parented to the camera follows its `Transform`.
    LodOnly,
}

/// The two view points of a camera whose [`TerrainEye`] holds one of them; there is none on others.
///
/// A game that moves its world's origin moves the one that is held along with everything else.
#[derive(Component, Clone, Copy, Debug, PartialEq, Reflect)]
#[reflect(Component, Debug, Clone, PartialEq)]
pub struct HeldTerrainEye {
    /// From where, and at what, the level of detail looks.
    pub lod: GlobalTransform,
    /// From where the picture is seen.
    pub eye: GlobalTransform,
    /// Projection of what the level of detail is culled by; the identity where the camera has no
    /// `Projection`.
    pub clip_from_lod_view: Mat4,
}

/// Nothing is culled by a far plane; this one is so far away that it never shows.
const FAR: f32 = 1e9;

impl HeldTerrainEye {
    /// What the level of detail is culled by. The far plane means nothing.
    pub(crate) fn lod_frustum(&self) -> Frustum {
        // As Bevy's projections do it, so that a plane has the same bits before it is held and after.
        let clip_from_world = self.clip_from_lod_view * self.lod.affine().inverse();
        Frustum(ViewFrustum::from_clip_from_world_custom_far(
            &clip_from_world,
            &self.lod.translation(),
            &self.lod.back(),
            FAR,
        ))
    }
}

/// What else the level of detail keeps of the place that is left; there while it is held.
#[derive(Component, Clone, Debug, Default)]
pub(crate) struct HeldLod {
    /// `None` until the camera has been computed for the first time.
    pub(super) optics: Option<Optics>,
    /// What lights saw; `None` until it has been computed.
    pub(crate) lights: Option<Vec<LightVolume>>,
}

/// What a camera's hold remembers from frame to frame.
#[derive(Component, Clone, Copy, Debug)]
struct Hold {
    /// What its [`TerrainEye`] was in the frame before: one that holds.
    eye: TerrainEye,
    /// The camera's `GlobalTransform` as its `Transform` has it.
    moving: GlobalTransform,
    /// Whether the camera has had no place before this frame.
    is_new: bool,
    /// To where the `Transform` has jumped in this frame; it says so in rounded numbers.
    jumped: Option<GlobalTransform>,
}

/// Held eyes. Part of [`TerrainPlugin`](crate::terrain::TerrainPlugin).
pub(crate) struct EyePlugin;

/// The systems that hold eyes, in `PostUpdate`.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum EyeSystems {
    /// In Bevy's `TransformSystems::Propagate`, before it propagates.
    Begin,
    /// In the same set, after it has propagated. `GlobalTransform` and [`HeldTerrainEye`] are final,
    /// but for its projection.
    Finish,
    /// Before [`TerrainSystems::View`].
    Project,
}

impl Plugin for EyePlugin {
    fn build(&self, app: &mut App) {
        app.register_type::<TerrainEye>()
            .register_type::<HeldTerrainEye>()
            .configure_sets(
                PostUpdate,
                (
                    EyeSystems::Begin
                        .in_set(TransformSystems::Propagate)
                        .before(mark_dirty_trees),
                    EyeSystems::Finish
                        .in_set(TransformSystems::Propagate)
                        .after(propagate_parent_transforms)
                        .after(sync_simple_transforms),
                    EyeSystems::Project
                        .after(EyeSystems::Finish)
                        .after(CameraUpdateSystems)
                        .before(TerrainSystems::View),
                ),
            )
            .add_systems(
                PostUpdate,
                (
                    begin_holds.in_set(EyeSystems::Begin),
                    finish_holds.in_set(EyeSystems::Finish),
                    project_holds.in_set(EyeSystems::Project),
                ),
            );
    }
}

type Begun = (
    Entity,
    Option<&'static TerrainEye>,
    Option<&'static mut Hold>,
    Option<&'static HeldTerrainEye>,
    &'static mut GlobalTransform,
    Option<&'static Projection>,
    Option<&'static Camera>,
);

type MayHold = Or<(With<TerrainEye>, With<Hold>)>;

type Projected = (
    &'static mut Hold,
    &'static mut HeldTerrainEye,
    Option<&'static mut HeldLod>,
    Option<&'static Projection>,
    Option<&'static Camera>,
);

/// Starts and ends holds, and undoes what a hold has done to a `GlobalTransform`, so that propagation
/// finds what it left there itself.
fn begin_holds(
    mut commands: Commands,
    mut cameras: Query<Begun, MayHold>,
    lights: LightVolumes,
    parents: Query<&ChildOf>,
    mut transforms: ParamSet<(TransformHelper, Query<&mut Transform>)>,
) {
    for (entity, eye, mut hold, held, mut transform, projection, camera) in &mut cameras {
        let before = hold
            .as_deref()
            .map_or(TerrainEye::EyeAndLod, |hold| hold.eye);
        if let Some(hold) = hold.as_deref()
            && before == TerrainEye::LodOnly
        {
            *transform.bypass_change_detection() = hold.moving;
        }
        let eye = eye.copied().unwrap_or_default();
        if eye == before {
            continue;
        }
        let mut camera_commands = commands.entity(entity);
        if eye == TerrainEye::EyeAndLod {
            transform.set_changed();
            camera_commands.try_remove::<(Hold, HeldTerrainEye, HeldLod)>();
            continue;
        }
        let clip_from_view =
            projection.map_or(Mat4::IDENTITY, |projection| projection.get_clip_from_view());
        let is_new = hold.is_none() && transform.is_added();
        // Held already, both points stay; otherwise both are where the camera was.
        let (held, jumped) = match (&hold, held) {
            (Some(_), Some(held)) => {
                let moved = if eye == TerrainEye::EyeOnly {
                    held.eye
                } else {
                    held.lod
                };
                transform.set_changed();
                (*held, Some(moved))
            }
            _ => (
                HeldTerrainEye {
                    lod: *transform,
                    eye: *transform,
                    clip_from_lod_view: clip_from_view,
                },
                None,
            ),
        };
        let jumped = jumped.filter(|jumped| jump(entity, jumped, &parents, &mut transforms));
        let new_hold = Hold {
            eye,
            moving: *transform,
            is_new,
            jumped,
        };
        match hold.as_deref_mut() {
            Some(hold) => *hold = new_hold,
            None => {
                camera_commands.try_insert(new_hold);
            }
        }
        camera_commands.try_insert(held);
        if eye == TerrainEye::EyeOnly {
            camera_commands.try_insert(HeldLod {
                optics: (!is_new).then(|| Optics::new(projection, camera)),
                lights: (!is_new).then(|| lights.of(entity).collect()),
            });
        } else {
            camera_commands.try_remove::<HeldLod>();
        }
    }
}

/// Moves a camera's `Transform` to a place in the world; false where there is no way to say it.
fn jump(
    camera: Entity,
    place: &GlobalTransform,
    parents: &Query<&ChildOf>,
    transforms: &mut ParamSet<(TransformHelper, Query<&mut Transform>)>,
) -> bool {
    let local = match parents.get(camera) {
        Ok(parent) => {
            let Ok(parent) = transforms.p0().compute_global_transform(parent.parent()) else {
                return false;
            };
            place.reparented_to(&parent)
        }
        Err(_) => place.compute_transform(),
    };
    if !local.is_finite() {
        return false;
    }
    let mut transforms = transforms.p1();
    let Ok(mut transform) = transforms.get_mut(camera) else {
        return false;
    };
    *transform = local;
    true
}

/// Puts held pictures back, and notes where the other points are.
fn finish_holds(mut cameras: Query<(&mut Hold, &mut HeldTerrainEye, &mut GlobalTransform)>) {
    for (mut hold, mut held, mut transform) in &mut cameras {
        // Propagation has marked it as changed.
        let transform = transform.bypass_change_detection();
        if let Some(exact) = hold.jumped.take() {
            *transform = exact;
        }
        let moving = *transform;
        hold.moving = moving;
        let mut now = *held;
        if hold.is_new || hold.eye == TerrainEye::EyeOnly {
            now.eye = moving;
        }
        if hold.is_new || hold.eye == TerrainEye::LodOnly {
            now.lod = moving;
        }
        held.set_if_neq(now);
        if hold.eye == TerrainEye::LodOnly {
            *transform = now.eye;
        }
    }
}

/// Notes what the level of detail sees through.
fn project_holds(mut cameras: Query<Projected>) {
    for (mut hold, mut held, lod, projection, camera) in &mut cameras {
        if (hold.is_new || hold.eye == TerrainEye::LodOnly)
            && let Some(projection) = projection
        {
            let clip_from_lod_view = projection.get_clip_from_view();
            held.set_if_neq(HeldTerrainEye {
                clip_from_lod_view,
                ..*held
            });
        }
        if hold.is_new {
            hold.is_new = false;
        }
        if let Some(mut lod) = lod
            && lod.optics.is_none()
        {
            lod.optics = Some(Optics::new(projection, camera));
        }
    }
}
