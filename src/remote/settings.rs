//! Which components and resources may be set, and what each of them can't be.

#[cfg(feature = "render")]
use crate::edit::mask::MaskSettings;
#[cfg(feature = "gizmos")]
use crate::gizmos::TerrainGizmos;
#[cfg(feature = "avian")]
use crate::physics::TerrainPhysics;
#[cfg(feature = "render")]
use crate::render::{
    ComparisonCamera, ComparisonView, TerrainComparison, TerrainDensityPreview, TerrainMaterial,
    TerrainOverlays,
};
use crate::stream::{TerrainState, TerrainStreaming};
use crate::terrain::{TerrainCamera, TerrainSettings};
#[cfg(feature = "render")]
use crate::view::TerrainEye;
use crate::{
    detail::TerrainDetail,
    lattice::{LatticeError, LodSettings},
};
use bevy::ecs::component::Mutable;
use bevy::prelude::*;
use bevy::reflect::{GetTypeRegistration, TypeRegistry, Typed};

/// Settings that may be set from outside.
pub(super) trait Setting: Reflect + Typed + GetTypeRegistration + Clone {
    /// Everything that is wrong with these, a sentence each. `owner` is what knows whether they are in
    /// use already, and `old` what they were.
    fn faults(&self, old: &Self, owner: Option<EntityRef>) -> Vec<String>;
}

/// A copy of some settings, where there are any.
type SettingsCopy = Option<Box<dyn Reflect>>;

/// Where settings of a kind lie, and how they are read and written.
pub(super) struct Settable {
    /// By what name they go.
    pub(super) name: &'static str,
    /// The entities that have them; `None` for what belongs to none.
    pub(super) owners: Option<fn(&mut World) -> Vec<Entity>>,
    /// A copy of them.
    pub(super) read: fn(&World, Option<Entity>) -> SettingsCopy,
    /// Puts another copy in their place. What isn't of their kind is left alone.
    pub(super) write: fn(&mut World, Option<Entity>, Box<dyn Reflect>),
    /// [`Setting::faults`] of the first.
    pub(super) faults: fn(&dyn Reflect, &dyn Reflect, Option<EntityRef>) -> Vec<String>,
    /// Makes their types known.
    pub(super) register: fn(&mut TypeRegistry),
}

impl Settable {
    const fn component<T: Setting + Component<Mutability = Mutable>>(name: &'static str) -> Self {
        Self {
            name,
            owners: Some(|world| {
                let mut owners = world.query_filtered::<Entity, With<T>>();
                let mut owners: Vec<_> = owners.iter(world).collect();
                // A comparison's second camera is nobody's to set.
                #[cfg(feature = "render")]
                owners.retain(|owner| world.get::<ComparisonCamera>(*owner).is_none());
                owners.sort_unstable();
                owners
            }),
            read: |world, entity| {
                let settings = world.get::<T>(entity?)?.clone();
                Some(Box::new(settings))
            },
            write: |world, entity, settings| {
                let place = entity.and_then(|entity| world.get_mut::<T>(entity));
                if let (Some(mut place), Ok(settings)) = (place, settings.downcast::<T>()) {
                    *place = *settings;
                }
            },
            faults: faults::<T>,
            register: TypeRegistry::register::<T>,
        }
    }

    const fn resource<T: Setting + Resource<Mutability = Mutable>>(name: &'static str) -> Self {
        Self {
            name,
            owners: None,
            read: |world, _| {
                let settings = world.get_resource::<T>()?.clone();
                Some(Box::new(settings))
            },
            write: |world, _, settings| {
                let place = world.get_resource_mut::<T>();
                if let (Some(mut place), Ok(settings)) = (place, settings.downcast::<T>()) {
                    *place = *settings;
                }
            },
            faults: faults::<T>,
            register: TypeRegistry::register::<T>,
        }
    }

    /// A group of gizmos, which lies in a resource with all others.
    #[cfg(feature = "gizmos")]
    const fn gizmos<T: Setting + GizmoConfigGroup>(name: &'static str) -> Self {
        Self {
            name,
            owners: None,
            read: |world, _| {
                let (_, group) = world
                    .get_resource::<GizmoConfigStore>()?
                    .get_config::<T>()?;
                Some(Box::new(group.clone()))
            },
            write: |world, _, settings| {
                let store = world.get_resource_mut::<GizmoConfigStore>();
                if let (Some(mut store), Ok(settings)) = (store, settings.downcast::<T>())
                    && let Some((_, place)) = store.get_config_mut::<T>()
                {
                    *place = *settings;
                }
            },
            faults: faults::<T>,
            register: TypeRegistry::register::<T>,
        }
    }
}

/// All of them.
pub(super) const SETTABLE: &[Settable] = &[
    Settable::component::<TerrainCamera>("TerrainCamera"),
    Settable::component::<TerrainSettings>("TerrainSettings"),
    Settable::component::<TerrainDetail>("TerrainDetail"),
    Settable::resource::<TerrainStreaming>("TerrainStreaming"),
    #[cfg(feature = "render")]
    Settable::component::<TerrainMaterial>("TerrainMaterial"),
    #[cfg(feature = "render")]
    Settable::component::<TerrainOverlays>("TerrainOverlays"),
    #[cfg(feature = "render")]
    Settable::component::<TerrainComparison>("TerrainComparison"),
    #[cfg(feature = "render")]
    Settable::component::<TerrainDensityPreview>("TerrainDensityPreview"),
    #[cfg(feature = "render")]
    Settable::component::<TerrainEye>("TerrainEye"),
    #[cfg(feature = "render")]
    Settable::component::<MaskSettings>("MaskSettings"),
    #[cfg(feature = "avian")]
    Settable::resource::<TerrainPhysics>("TerrainPhysics"),
    #[cfg(feature = "gizmos")]
    Settable::gizmos::<TerrainGizmos>("TerrainGizmos"),
];

fn faults<T: Setting>(
    settings: &dyn Reflect,
    old: &dyn Reflect,
    owner: Option<EntityRef>,
) -> Vec<String> {
    match (settings.downcast_ref::<T>(), old.downcast_ref::<T>()) {
        (Some(settings), Some(old)) => settings.faults(old, owner),
        _ => Vec::new(),
    }
}

impl Setting for TerrainCamera {
    fn faults(&self, _: &Self, _: Option<EntityRef>) -> Vec<String> {
        let mut faults = Vec::new();
        let _ = self.checked(|error| faults.push(error.to_string()));
        // A bad morph zone hides a bad reach.
        let reach = self.lod.reach;
        if !LodSettings::MORPHS.contains(&self.lod.morph)
            && !LodSettings::REACH_RANGE.contains(&reach)
        {
            let error = LatticeError::Reach(reach);
            faults.push(format!("TerrainCamera::lod can't be used: {error}"));
        }
        faults
    }
}

impl Setting for TerrainSettings {
    fn faults(&self, old: &Self, owner: Option<EntityRef>) -> Vec<String> {
        let mut faults = Vec::new();
        let _ = self.checked(|error| faults.push(error.to_string()));
        if !(-8..=0).contains(&self.leaf_level) {
            let error = LatticeError::LeafLevel(self.leaf_level);
            faults.push(format!(
                "TerrainSettings::leaf_level can't be used: {error}"
            ));
        } else if self.leaf_level != old.leaf_level
            && owner.is_some_and(|owner| owner.contains::<TerrainState>())
        {
            faults.push(
                "TerrainSettings::leaf_level is read once, when the manifest has loaded: set it \
                 where the terrain is spawned"
                    .to_owned(),
            );
        }
        faults
    }
}

impl Setting for TerrainDetail {
    fn faults(&self, _: &Self, _: Option<EntityRef>) -> Vec<String> {
        let mut faults = Vec::new();
        let _ = self.checked(|error| faults.push(error.to_string()));
        faults
    }
}

impl Setting for TerrainStreaming {
    fn faults(&self, _: &Self, _: Option<EntityRef>) -> Vec<String> {
        let mut faults = Vec::new();
        let _ = self.checked(|error| faults.push(error.to_string()));
        faults
    }
}

#[cfg(feature = "avian")]
impl Setting for TerrainPhysics {
    fn faults(&self, _: &Self, _: Option<EntityRef>) -> Vec<String> {
        let mut faults = Vec::new();
        let _ = self.checked(|error| faults.push(error.to_string()));
        faults
    }
}

/// A fault where a number lies outside of its range; not a number lies in none.
#[cfg(feature = "render")]
fn outside(name: &str, value: f32, (least, most): (f32, f32)) -> Option<String> {
    let inside = (least..=most).contains(&value);
    (!inside).then(|| format!("{name} is {value}: use a number from {least} to {most}"))
}

#[cfg(feature = "render")]
impl Setting for TerrainMaterial {
    fn faults(&self, _: &Self, _: Option<EntityRef>) -> Vec<String> {
        let parameters = (0..).zip(&self.parameters);
        let wild = parameters.filter(|(_, parameter)| !parameter.is_finite());
        wild.map(|(index, parameter)| {
            format!("TerrainMaterial::parameters[{index}] is {parameter}: use finite numbers")
        })
        .collect()
    }
}

#[cfg(feature = "render")]
impl Setting for TerrainOverlays {
    fn faults(&self, _: &Self, _: Option<EntityRef>) -> Vec<String> {
        let opacities = (0..).zip(self.opacities);
        opacities
            .filter_map(|(index, opacity)| {
                let name = format!("TerrainOverlays::opacities[{index}]");
                outside(&name, opacity, (0.0, 1.0))
            })
            .collect()
    }
}

#[cfg(feature = "render")]
impl Setting for TerrainComparison {
    fn faults(&self, _: &Self, _: Option<EntityRef>) -> Vec<String> {
        let mut faults = Vec::new();
        let _ = self.other.checked(|error| {
            faults.push(format!("TerrainComparison::other can't be used: {error}"));
        });
        faults.extend(match self.view {
            ComparisonView::Split { divider } => {
                outside("TerrainComparison::view.divider", divider, (0.0, 1.0))
            }
            ComparisonView::Difference { gain } => {
                outside("TerrainComparison::view.gain", gain, (1.0, 64.0))
            }
        });
        faults
    }
}

#[cfg(feature = "render")]
impl Setting for TerrainDensityPreview {
    fn faults(&self, _: &Self, _: Option<EntityRef>) -> Vec<String> {
        let faults = self.settings.faults();
        let settings =
            faults.map(|error| format!("TerrainDensityPreview::settings can't be used: {error}"));
        let opacity = outside("TerrainDensityPreview::opacity", self.opacity, (0.0, 1.0));
        settings.chain(opacity).collect()
    }
}

#[cfg(feature = "render")]
impl Setting for TerrainEye {
    fn faults(&self, _: &Self, _: Option<EntityRef>) -> Vec<String> {
        Vec::new()
    }
}

#[cfg(feature = "render")]
impl Setting for MaskSettings {
    fn faults(&self, _: &Self, _: Option<EntityRef>) -> Vec<String> {
        let range = (f32::MIN_POSITIVE, f32::MAX);
        let texels = outside("MaskSettings::texels_per_m", self.texels_per_m, range);
        texels.into_iter().collect()
    }
}

#[cfg(feature = "gizmos")]
impl Setting for TerrainGizmos {
    fn faults(&self, _: &Self, _: Option<EntityRef>) -> Vec<String> {
        let within = Self::TILES_WITHIN_RANGE.into_inner();
        let reach = Self::HELD_EYE_REACH_RANGE.into_inner();
        let within = outside("TerrainGizmos::tiles_within_m", self.tiles_within_m, within);
        let reach = outside(
            "TerrainGizmos::held_eye_reach_m",
            self.held_eye_reach_m,
            reach,
        );
        within.into_iter().chain(reach).collect()
    }
}
