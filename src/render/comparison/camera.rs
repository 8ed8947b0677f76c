//! The second camera of a comparison, and how it follows the first.

use super::TerrainComparison;
use crate::render::TerrainOverlays;
use crate::terrain::{TerrainCamera, TerrainSystems};
use crate::view::{EyeSystems, HeldLod, HeldTerrainEye};
use bevy::asset::AssetEventSystems;
use bevy::camera::visibility::{NoCpuCulling, RenderLayers, VisibilitySystems};
use bevy::camera::{
    CameraMainTextureUsages, CameraOutputMode, CameraUpdateSystems, CompositingSpace, Exposure,
    Hdr, ImageRenderTarget, MainPassResolutionOverride, RenderTarget,
};
use bevy::core_pipeline::oit::OrderIndependentTransparencySettings;
use bevy::core_pipeline::prepass::background_motion_vectors::NoBackgroundMotionVectors;
use bevy::core_pipeline::prepass::{
    DeferredPrepass, DeferredPrepassDoubleBuffer, DepthPrepass, DepthPrepassDoubleBuffer,
    MotionVectorPrepass, NormalPrepass,
};
use bevy::core_pipeline::tonemapping::{DebandDither, Tonemapping};
use bevy::ecs::component::{ComponentId, ComponentInfo, Components};
use bevy::ecs::entity::EntityCloner;
use bevy::ecs::lifecycle::HookContext;
use bevy::ecs::world::DeferredWorld;
use bevy::image::Image;
use bevy::light::cluster::ClusterConfig;
use bevy::light::{
    AmbientLight, AtmosphereEnvironmentMapLight, EnvironmentMapLight, GeneratedEnvironmentMapLight,
    ShadowFilteringMethod, Skybox, VolumetricFog,
};
use bevy::pbr::{
    AtmosphereSettings, ContactShadows, DistanceFog, ScreenSpaceAmbientOcclusion,
    ScreenSpaceReflections, ScreenSpaceTransmission,
};
use bevy::platform::collections::HashSet;
use bevy::prelude::*;
use bevy::reflect::TypeRegistry;
use bevy::render::camera::{CameraRenderGraph, MipBias, TemporalJitter, camera_system};
use bevy::render::occlusion_culling::OcclusionCulling;
use bevy::render::render_resource::TextureFormat;
use bevy::render::sync_world::SyncToRenderWorld;
use bevy::render::texture::ManualTextureViews;
use bevy::render::view::{ColorGrading, NoIndirectDrawing};
use bevy::transform::TransformSystems;
use std::any::TypeId;

/// Marks the second camera of a [`TerrainComparison`]; holds the one that is compared.
///
/// Filter it out (`Without<ComparisonCamera>`) where a game looks for its own cameras. It has a
/// `Camera3d`, a [`TerrainCamera`] and what else draws its picture ([`ComparedComponents`] says what), and
/// nothing of what the game has put on the first camera besides. It draws into an image, so that neither pointers nor user interfaces
/// find it. It comes and goes with the comparison: despawn or change the comparison instead.
#[derive(Component, Clone, Copy, Debug, PartialEq, Eq, Reflect)]
#[component(immutable)]
#[reflect(Component, Debug, Clone, PartialEq)]
pub struct ComparisonCamera(pub Entity);

/// Which components the second camera of a [`TerrainComparison`] takes over from the first.
///
/// All of Bevy's that say what a camera's picture looks like are in it, and all that are handed to
/// the renderer by Bevy's `ExtractComponentPlugin` or `SyncComponentPlugin`, as effects are, Bevy's
/// and a game's. Of those, what needs a `Transform` (lights, meshes) stands in the world by itself and
/// isn't taken over. A game adds what its effects need besides, and leaves out what they don't:
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_tessera::render::ComparedComponents;
/// #[derive(Component, Clone)]
/// struct Rain;
///
/// #[derive(Component, Clone)]
/// struct Player;
///
/// fn setup(mut compared: ResMut<ComparedComponents>) {
///     compared.add::<Rain>().leave_out::<Player>();
/// }
/// ```
#[derive(Resource, Debug)]
pub struct ComparedComponents {
    types: HashSet<TypeId>,
    left_out: HashSet<TypeId>,
}

/// Crates whose components are all taken over where their types are registered: they are effects, and
/// this crate doesn't know them.
const EFFECT_CRATES: [&str; 2] = ["bevy_post_process::", "bevy_anti_alias::"];

macro_rules! types {
    ($($component:ty),* $(,)?) => {
        [$(TypeId::of::<$component>()),*]
    };
}

impl Default for ComparedComponents {
    fn default() -> Self {
        let types = types![
            AmbientLight,
            AtmosphereEnvironmentMapLight,
            AtmosphereSettings,
            Camera,
            Camera3d,
            CameraMainTextureUsages,
            CameraRenderGraph,
            ClusterConfig,
            ColorGrading,
            CompositingSpace,
            ContactShadows,
            DebandDither,
            DeferredPrepass,
            DeferredPrepassDoubleBuffer,
            DepthPrepass,
            DepthPrepassDoubleBuffer,
            DistanceFog,
            EnvironmentMapLight,
            Exposure,
            GeneratedEnvironmentMapLight,
            Hdr,
            MainPassResolutionOverride,
            MipBias,
            MotionVectorPrepass,
            Msaa,
            NoBackgroundMotionVectors,
            NoCpuCulling,
            NoIndirectDrawing,
            NormalPrepass,
            OcclusionCulling,
            OrderIndependentTransparencySettings,
            Projection,
            RenderLayers,
            ScreenSpaceAmbientOcclusion,
            ScreenSpaceReflections,
            ScreenSpaceTransmission,
            ShadowFilteringMethod,
            Skybox,
            TemporalJitter,
            TerrainOverlays,
            Tonemapping,
            VolumetricFog,
        ];
        Self {
            types: types.into_iter().collect(),
            left_out: HashSet::default(),
        }
    }
}

impl ComparedComponents {
    /// Takes over `C`, too.
    pub fn add<C: Component + Clone>(&mut self) -> &mut Self {
        self.left_out.remove(&TypeId::of::<C>());
        self.types.insert(TypeId::of::<C>());
        self
    }

    /// Doesn't take over `C`, though the renderer is handed it.
    pub fn leave_out<C: Component>(&mut self) -> &mut Self {
        self.types.remove(&TypeId::of::<C>());
        self.left_out.insert(TypeId::of::<C>());
        self
    }

    /// Whether a component is taken over, as far as it has a type.
    fn hold(&self, info: &ComponentInfo, components: &Components, types: &TypeRegistry) -> bool {
        let Some(type_id) = info.type_id() else {
            return false;
        };
        if self.types.contains(&type_id) || self.left_out.contains(&type_id) {
            return self.types.contains(&type_id);
        }
        // Neither types nor components need have names: that takes features of Bevy. But what the
        // renderer is handed requires its entity to be known there.
        let required = info.required_components();
        let requires = |id| required.iter_ids().any(|other| Some(other) == id);
        let is_handed_on = requires(components.component_id::<SyncToRenderWorld>());
        let is_placed = requires(components.component_id::<Transform>());
        is_handed_on && !is_placed
            || types.get_type_info(type_id).is_some_and(|info| {
                let path = info.type_path();
                EFFECT_CRATES.iter().any(|name| path.starts_with(name))
            })
    }
}

/// On a camera that is compared: its second camera, from the second frame on.
///
/// In the first one there may be cameras that no plugin has seen yet, and bevy_egui takes the first
/// camera that it sees for the one to draw on.
#[derive(Component, Debug, Default)]
#[component(clone_behavior = Ignore, on_remove = despawn_other)]
pub(super) struct Compared {
    pub(super) other: Option<Entity>,
}

fn despawn_other(mut world: DeferredWorld, context: HookContext) {
    let other = world
        .get::<Compared>(context.entity)
        .and_then(|compared| compared.other);
    if let Some(other) = other {
        world.commands().entity(other).try_despawn();
    }
}

fn end_comparison(removed: On<Remove, TerrainComparison>, mut commands: Commands) {
    commands.entity(removed.entity).try_remove::<Compared>();
}

pub(super) fn build(app: &mut App) {
    app.init_resource::<ComparedComponents>()
        .add_observer(end_comparison)
        .add_systems(
            PostUpdate,
            (
                follow_components
                    .in_set(CameraUpdateSystems)
                    .after(camera_system)
                    .before(AssetEventSystems)
                    .before(VisibilitySystems::UpdateFrusta)
                    .run_if(
                        any_with_component::<TerrainComparison>
                            .or_else(any_with_component::<Compared>),
                    ),
                follow_transforms
                    .in_set(TransformSystems::Propagate)
                    .after(EyeSystems::Finish),
                follow_eyes
                    .after(EyeSystems::Project)
                    .before(TerrainSystems::View),
            ),
        );
}

/// Cameras that can be compared.
type Mains = QueryState<
    (
        Entity,
        &'static TerrainComparison,
        Option<&'static Compared>,
    ),
    (With<Camera3d>, With<TerrainCamera>),
>;

/// Spawns second cameras, and brings them up to date with the first ones.
fn follow_components(
    world: &mut World,
    mains: &mut Mains,
    compared: &mut QueryState<(Entity, Has<TerrainComparison>), With<Compared>>,
) {
    let mains: Vec<_> = mains
        .iter(world)
        .map(|(entity, comparison, compared)| {
            let other = compared.map(|compared| compared.other);
            (entity, comparison.other.clone(), other)
        })
        .collect();
    // Those that are no cameras any more.
    let ended: Vec<_> = compared
        .iter(world)
        .map(|(entity, _)| entity)
        .filter(|entity| mains.iter().all(|(main, ..)| main != entity))
        .collect();
    for entity in ended {
        world.entity_mut(entity).remove::<Compared>();
    }
    for (main, settings, other) in mains {
        match other {
            None => {
                world.entity_mut(main).insert(Compared::default());
            }
            Some(other) => follow(world, main, other, settings),
        }
    }
}

fn follow(world: &mut World, main: Entity, other: Option<Entity>, settings: TerrainCamera) {
    let camera = world.get::<Camera>(main);
    let size = camera.and_then(Camera::physical_target_size);
    let scale_factor = camera.and_then(Camera::target_scaling_factor);
    let (Some(size), Some(scale_factor)) =
        (size.filter(|size| size.min_element() > 0), scale_factor)
    else {
        // Nothing to draw into: nothing to compare.
        if let Some(mut camera) = other.and_then(|other| world.get_mut::<Camera>(other)) {
            camera.is_active = false;
        }
        return;
    };
    let format = target_format(world, main);
    let other = other.filter(|other| world.get::<ComparisonCamera>(*other).is_some());
    let is_new = other.is_none();
    let other = other.unwrap_or_else(|| {
        let image = world
            .resource_mut::<Assets<Image>>()
            .add(target(size, format));
        let place = world.get::<GlobalTransform>(main).copied();
        let place = place.unwrap_or_default();
        let other = world.spawn((
            ComparisonCamera(main),
            Name::new("terrain comparison"),
            RenderTarget::Image(ImageRenderTarget {
                handle: image,
                scale_factor,
            }),
            place.compute_transform(),
            place,
            settings.clone(),
        ));
        let other = other.id();
        world
            .entity_mut(main)
            .insert(Compared { other: Some(other) });
        other
    });
    if let Some(mut known) = world.get_mut::<TerrainCamera>(other) {
        known.set_if_neq(settings);
    }
    fit_target(world, other, size, scale_factor, format);
    let is_active = |camera| world.get::<Camera>(camera).map(|camera| camera.is_active);
    let was_off = is_active(main) != is_active(other);
    copy_components(world, main, other, is_new || was_off);
}

/// An image of the same kind as what the first camera draws into.
fn target(size: UVec2, format: TextureFormat) -> Image {
    let mut image = Image::new_target_texture(size.x, size.y, format, None);
    // Nobody fills it from the CPU.
    image.data = None;
    image.copy_on_resize = false;
    image.texture_descriptor.label = Some("terrain_comparison_target");
    image
}

/// The format of what a camera draws into, as far as it is known outside the renderer.
fn target_format(world: &World, camera: Entity) -> TextureFormat {
    let image = |image: &Image| {
        let view = image.texture_view_descriptor.as_ref();
        view.and_then(|view| view.format)
            .unwrap_or(image.texture_descriptor.format)
    };
    match world.get::<RenderTarget>(camera) {
        Some(RenderTarget::Image(target)) => {
            let images = world.resource::<Assets<Image>>();
            images.get(&target.handle).map(image)
        }
        Some(RenderTarget::TextureView(view)) => {
            let views = world.get_resource::<ManualTextureViews>();
            views.and_then(|views| Some(views.get(view)?.view_format))
        }
        _ => None,
    }
    .unwrap_or(TextureFormat::Rgba8UnormSrgb)
}

/// Follows a target that was resized.
fn fit_target(
    world: &mut World,
    other: Entity,
    size: UVec2,
    scale_factor: f32,
    format: TextureFormat,
) {
    let Some(RenderTarget::Image(drawn)) = world.get::<RenderTarget>(other) else {
        return;
    };
    if drawn.scale_factor != scale_factor {
        let handle = drawn.handle.clone();
        let drawn = ImageRenderTarget {
            handle,
            scale_factor,
        };
        world
            .entity_mut(other)
            .insert(RenderTarget::Image(drawn.clone()));
    }
    let Some(RenderTarget::Image(drawn)) = world.get::<RenderTarget>(other) else {
        return;
    };
    let id = drawn.handle.id();
    let mut images = world.resource_mut::<Assets<Image>>();
    let fits = images
        .get(id)
        .is_some_and(|image| image.size() == size && image.texture_descriptor.format == format);
    if !fits && let Some(mut image) = images.get_mut(id) {
        *image = target(size, format);
    }
}

/// Copies what has changed of the first camera's components, or all of them.
fn copy_components(world: &mut World, main: Entity, other: Entity, all: bool) {
    let (last_run, this_run) = (world.last_change_tick(), world.change_tick());
    let (mut changed, mut gone): (Vec<ComponentId>, Vec<ComponentId>) = default();
    world.resource_scope(|world, compared: Mut<ComparedComponents>| {
        let registry = world.resource::<AppTypeRegistry>().clone();
        let registry = registry.read();
        let is_compared = |id: ComponentId| {
            let components = world.components();
            let info = components.get_info(id);
            info.is_some_and(|info| compared.hold(info, components, &registry))
        };
        let (Ok(from), Ok(to)) = (world.get_entity(main), world.get_entity(other)) else {
            return;
        };
        let from_ids = from.archetype().components().iter().copied();
        changed.extend(from_ids.filter(|id| {
            let ticks = from.get_change_ticks_by_id(*id);
            let is_changed = ticks.is_some_and(|ticks| ticks.is_changed(last_run, this_run));
            (all || is_changed || !to.contains_id(*id)) && is_compared(*id)
        }));
        let to_ids = to.archetype().components().iter().copied();
        gone.extend(to_ids.filter(|id| !from.contains_id(*id) && is_compared(*id)));
    });
    if !changed.is_empty() {
        let mut cloner = EntityCloner::build_opt_in(world);
        cloner.without_required_components(|cloner| {
            cloner.allow_by_ids(changed);
        });
        cloner.clone_entity(main, other);
        let order = world.get::<Camera>(main).map_or(0, |camera| camera.order);
        if let Some(mut camera) = world.get_mut::<Camera>(other) {
            let camera = camera.bypass_change_detection();
            // Drawn before, so that its picture is there.
            camera.order = order.saturating_sub(1);
            // Bevy draws nothing of a camera that puts nothing out.
            camera.output_mode = CameraOutputMode::default();
            if matches!(camera.clear_color, ClearColorConfig::None) {
                camera.clear_color = ClearColorConfig::Default;
            }
        }
    }
    if !gone.is_empty() {
        world.entity_mut(other).remove_by_ids(&gone);
    }
}

type Followed = (
    Option<Ref<'static, HeldTerrainEye>>,
    Option<Ref<'static, HeldLod>>,
);

/// Puts second cameras where the first ones are.
fn follow_transforms(
    mains: Query<&GlobalTransform, Without<ComparisonCamera>>,
    mut others: Query<(&ComparisonCamera, &mut GlobalTransform, &mut Transform)>,
) {
    for (main, mut place, mut transform) in &mut others {
        let Ok(main) = mains.get(main.0) else {
            continue;
        };
        // The exact place; propagation is not to round it.
        if place.set_if_neq(*main) {
            *transform.bypass_change_detection() = main.compute_transform();
        }
    }
}

/// Gives second cameras the held eyes of the first ones.
fn follow_eyes(
    mut commands: Commands,
    mains: Query<Followed, Without<ComparisonCamera>>,
    others: Query<(Entity, &ComparisonCamera, Has<HeldTerrainEye>, Has<HeldLod>)>,
) {
    for (other, main, has_eye, has_lod) in &others {
        let Ok((eye, lod)) = mains.get(main.0) else {
            continue;
        };
        let mut commands = commands.entity(other);
        match eye {
            Some(eye) if !has_eye || eye.is_changed() => {
                commands.try_insert(*eye);
            }
            None if has_eye => {
                commands.try_remove::<HeldTerrainEye>();
            }
            _ => {}
        }
        match lod {
            Some(lod) if !has_lod || lod.is_changed() => {
                commands.try_insert(HeldLod::clone(&lod));
            }
            None if has_lod => {
                commands.try_remove::<HeldLod>();
            }
            _ => {}
        }
    }
}
