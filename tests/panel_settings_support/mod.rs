//! A world with everything that the panel can set, and hands for its controls.

use bevy::prelude::*;
use bevy_egui::egui::{self, accesskit};
use bevy_tessera::debug::{TerrainChoice, TerrainDebugTab};
use bevy_tessera::detail::TerrainDetail;
use bevy_tessera::edit::mask::MaskSettings;
use bevy_tessera::gizmos::TerrainGizmos;
use bevy_tessera::physics::TerrainPhysics;
use bevy_tessera::render::{
    TerrainComparison, TerrainDensityPreview, TerrainMaterial, TerrainOverlays, TerrainStatistics,
};
use bevy_tessera::stream::TerrainStreaming;
use bevy_tessera::terrain::{Terrain, TerrainCamera, TerrainSettings};
use bevy_tessera::view::TerrainEye;
use egui_kittest::Harness;
use egui_kittest::kittest::{NodeT, Queryable};

pub use accesskit::Role;

/// Everything that the panel can set.
#[derive(Clone, Debug, PartialEq)]
pub struct Everything {
    pub camera: TerrainCamera,
    pub measure: bool,
    pub savings: bool,
    pub terrain: TerrainSettings,
    pub material: Option<TerrainMaterial>,
    pub detail: Option<TerrainDetail>,
    pub preview: Option<TerrainDensityPreview>,
    pub mask: Option<MaskSettings>,
    pub streaming: TerrainStreaming,
    pub physics: TerrainPhysics,
    pub overlays: Option<TerrainOverlays>,
    pub eye: Option<TerrainEye>,
    pub comparison: Option<TerrainComparison>,
    pub gizmos: TerrainGizmos,
}

impl Everything {
    /// Settings that are all at their defaults, where they are there at all.
    pub fn new() -> Self {
        Self {
            camera: default(),
            measure: false,
            savings: false,
            terrain: default(),
            material: None,
            detail: None,
            preview: None,
            mask: None,
            streaming: default(),
            physics: default(),
            overlays: None,
            eye: None,
            comparison: None,
            gizmos: default(),
        }
    }

    /// Whether all of it can be used as it is.
    pub fn refused(&self) -> Vec<String> {
        let mut refused = Vec::new();
        let _ = self.camera.checked(|error| refused.push(error.to_string()));
        let _ = self
            .terrain
            .checked(|error| refused.push(error.to_string()));
        let _ = self
            .streaming
            .checked(|error| refused.push(error.to_string()));
        let _ = self
            .physics
            .checked(|error| refused.push(error.to_string()));
        if let Some(detail) = &self.detail {
            let _ = detail.checked(|error| refused.push(error.to_string()));
        }
        if let Some(preview) = &self.preview {
            refused.extend(
                preview
                    .settings
                    .validate()
                    .err()
                    .map(|error| error.to_string()),
            );
            if !(0.0..=1.0).contains(&preview.opacity) {
                refused.push("preview opacity".to_owned());
            }
        }
        if let Some(TerrainMaterial { parameters, .. }) = &self.material {
            let is_fine = |parameter: &Vec4| {
                parameter.cmpge(Vec4::ZERO).all() && parameter.cmple(Vec4::ONE).all()
            };
            if !parameters.iter().all(is_fine) {
                refused.push("material".to_owned());
            }
        }
        if let Some(mask) = &self.mask
            && !MaskSettings::TEXELS_PER_M_RANGE.contains(&mask.texels_per_m)
        {
            refused.push("mask".to_owned());
        }
        if !TerrainSettings::LEAF_LEVEL_RANGE.contains(&self.terrain.leaf_level) {
            refused.push("leaf level".to_owned());
        }
        refused
    }
}

/// A tab and the world that it works on.
pub struct Bench {
    pub world: World,
    pub tab: Box<dyn TerrainDebugTab>,
    pub camera: Entity,
    pub terrain: Entity,
}

impl Bench {
    pub fn new(tab: impl TerrainDebugTab) -> Self {
        let mut world = World::new();
        world.init_resource::<TerrainStreaming>();
        world.init_resource::<TerrainPhysics>();
        let mut store = GizmoConfigStore::default();
        store.insert(GizmoConfig::default(), TerrainGizmos::default());
        world.insert_resource(store);
        let camera = world
            .spawn((TerrainCamera::default(), TerrainStatistics::default()))
            .id();
        let terrain = world
            .spawn((Terrain::default(), TerrainSettings::default()))
            .id();
        Self {
            world,
            tab: Box::new(tab),
            camera,
            terrain,
        }
    }

    pub fn everything(&self) -> Everything {
        let (camera, terrain) = (
            self.world.entity(self.camera),
            self.world.entity(self.terrain),
        );
        let store = self.world.resource::<GizmoConfigStore>();
        let statistics = camera.get::<TerrainStatistics>().unwrap();
        Everything {
            camera: camera.get::<TerrainCamera>().unwrap().clone(),
            measure: statistics.measure_triangle_sizes,
            savings: statistics.measure_savings,
            terrain: terrain.get::<TerrainSettings>().unwrap().clone(),
            material: terrain.get::<TerrainMaterial>().cloned(),
            detail: terrain.get::<TerrainDetail>().cloned(),
            preview: terrain.get::<TerrainDensityPreview>().cloned(),
            mask: terrain.get::<MaskSettings>().cloned(),
            streaming: self.world.resource::<TerrainStreaming>().clone(),
            physics: self.world.resource::<TerrainPhysics>().clone(),
            overlays: camera.get::<TerrainOverlays>().cloned(),
            eye: camera.get::<TerrainEye>().copied(),
            comparison: camera.get::<TerrainComparison>().cloned(),
            gizmos: store.config::<TerrainGizmos>().1.clone(),
        }
    }

    /// Sets all of it.
    pub fn set(&mut self, all: &Everything) {
        fn put<T: Component>(mut entity: EntityWorldMut, value: Option<T>) {
            match value {
                Some(value) => entity.insert(value),
                None => entity.remove::<T>(),
            };
        }
        let all = all.clone();
        let (camera, terrain, world) = (self.camera, self.terrain, &mut self.world);
        world.entity_mut(camera).insert(all.camera);
        let mut statistics = world.get_mut::<TerrainStatistics>(camera).unwrap();
        statistics.measure_triangle_sizes = all.measure;
        statistics.measure_savings = all.savings;
        put(world.entity_mut(camera), all.overlays);
        put(world.entity_mut(camera), all.eye);
        put(world.entity_mut(camera), all.comparison);
        world.entity_mut(terrain).insert(all.terrain);
        put(world.entity_mut(terrain), all.material);
        put(world.entity_mut(terrain), all.detail);
        put(world.entity_mut(terrain), all.preview);
        put(world.entity_mut(terrain), all.mask);
        world.insert_resource(all.streaming);
        world.insert_resource(all.physics);
        let mut store = world.resource_mut::<GizmoConfigStore>();
        *store.config_mut::<TerrainGizmos>().1 = all.gizmos;
    }

    pub fn chosen(&self) -> TerrainChoice {
        TerrainChoice {
            camera: Some(self.camera),
            terrain: Some(self.terrain),
        }
    }
}

pub type Panel = Harness<'static, Bench>;

/// The tab in a panel that is as high as it takes, with all its groups open.
pub fn harness(bench: Bench, groups: &[&str]) -> Panel {
    let mut panel = Harness::builder()
        .with_size([360.0, 2600.0])
        .with_max_steps(20)
        .build_ui_state(
            |ui, bench: &mut Bench| {
                let chosen = bench.chosen();
                bench.tab.ui(ui, &mut bench.world, chosen);
            },
            bench,
        );
    for group in groups {
        click(&mut panel, Role::Button, group);
    }
    panel
}

/// What is done to a control.
#[derive(Clone, Copy, Debug)]
pub enum Act {
    /// A number's text is replaced by this one.
    Type(&'static str),
    /// One of a list is chosen.
    Choose(&'static str),
    /// A check box is clicked.
    Check,
    /// A radio button is.
    Radio,
    /// A button is.
    Press,
}

pub fn act(panel: &mut Panel, label: &str, act: Act) {
    match act {
        Act::Type(text) => type_number(panel, label, text),
        Act::Choose(choice) => {
            click(panel, Role::ComboBox, label);
            click(panel, Role::Button, choice);
        }
        Act::Check => click(panel, Role::CheckBox, label),
        Act::Radio => click(panel, Role::RadioButton, label),
        Act::Press => click(panel, Role::Button, label),
    }
    panel.run();
}

pub fn click(panel: &mut Panel, role: Role, label: &str) {
    panel.get_by_role_and_label(role, label).click();
    panel.step();
    panel.run();
}

pub fn is_shown(panel: &Panel, role: Role, label: &str) -> bool {
    panel.query_by_role_and_label(role, label).is_some()
}

/// Clicks a number, which selects its text, types another and presses Enter.
pub fn type_number(panel: &mut Panel, label: &str, text: &str) {
    click(panel, Role::SpinButton, label);
    panel.event(egui::Event::Text(text.to_owned()));
    panel.step();
    panel.key_press(egui::Key::Enter);
    panel.step();
    panel.run();
}

/// Sets a slider as assistive technology does.
pub fn slide(panel: &mut Panel, label: &str, value: f64) {
    let (target_node, target_tree) = panel
        .get_by_role_and_label(Role::Slider, label)
        .accesskit_node()
        .locate();
    panel.event(egui::Event::AccessKitActionRequest(
        accesskit::ActionRequest {
            action: accesskit::Action::SetValue,
            target_node,
            target_tree,
            data: Some(accesskit::ActionData::NumericValue(value)),
        },
    ));
    panel.step();
    panel.run();
}

/// Presses a button and returns what it put on the clipboard.
pub fn copied(panel: &mut Panel, label: &str) -> String {
    panel.get_by_role_and_label(Role::Button, label).click();
    panel.step();
    let commands = &panel.output().platform_output.commands;
    let text = commands.iter().find_map(|command| match command {
        egui::OutputCommand::CopyText(text) => Some(text.clone()),
        _ => None,
    });
    let text = text.unwrap_or_else(|| panic!("{label} copies nothing"));
    panel.run();
    text
}
