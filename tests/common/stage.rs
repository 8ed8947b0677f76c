//! An app with one terrain, whose cameras and lights change from picture to picture.

use super::app;
use super::scene::Scene;
use bevy::core_pipeline::tonemapping::{DebandDither, Tonemapping};
use bevy::ecs::world::EntityWorldMut;
use bevy::light::{DirectionalLightShadowMap, PointLightShadowMap};
use bevy::prelude::*;
use bevy::render::settings::WgpuSettings;
use bevy_tessera::terrain::{Terrain, TerrainCamera};
use image::RgbImage;
use std::path::{Path, PathBuf};

/// What is seen where nothing is drawn.
pub const NOTHING: [u8; 3] = [255, 0, 255];

pub struct Stage {
    pub app: App,
    pub size: [u32; 2],
    pub terrain: Entity,
    pub target: Handle<Image>,
    pub camera: Option<Entity>,
    props: Vec<Entity>,
    test: &'static str,
}

impl Stage {
    /// A stage whose asset folder is `assets` and whose terrain lies at `manifest` in it.
    pub fn new(test: &'static str, assets: &Path, manifest: &str, size: [u32; 2]) -> Self {
        Self::with(
            test,
            assets,
            manifest,
            size,
            false,
            WgpuSettings::default(),
            |_| {},
        )
    }

    /// The same; `build` may change the app before it is finished.
    pub fn with(
        test: &'static str,
        assets: &Path,
        manifest: &str,
        size: [u32; 2],
        pipelined: bool,
        settings: WgpuSettings,
        build: impl FnOnce(&mut App),
    ) -> Self {
        let mut app = app::app_on(assets, pipelined, settings);
        app.insert_resource(DirectionalLightShadowMap { size: 1024 })
            .insert_resource(PointLightShadowMap { size: 512 });
        build(&mut app);
        app::finish(&mut app);
        let target = app::target(&mut app, size[0], size[1]);
        let manifest = app
            .world()
            .resource::<AssetServer>()
            .load(manifest.to_owned());
        let terrain = app.world_mut().spawn(Terrain::new(manifest)).id();
        Self {
            app,
            size,
            terrain,
            target,
            camera: None,
            props: Vec::new(),
            test,
        }
    }

    /// Spawns something that [`clear`](Self::clear) despawns.
    pub fn prop(&mut self, bundle: impl Bundle) -> Entity {
        let entity = self.app.world_mut().spawn(bundle).id();
        self.props.push(entity);
        entity
    }

    pub fn clear(&mut self) {
        for prop in self.props.drain(..) {
            self.app.world_mut().despawn(prop);
        }
    }

    /// Grey cubes where the scene has its boxes.
    pub fn boxes(&mut self, scene: &Scene) {
        for &(low, high) in &scene.boxes {
            let mesh = Mesh::from(Cuboid::from_size(high - low));
            let mesh = self
                .app
                .world_mut()
                .resource_mut::<Assets<Mesh>>()
                .add(mesh);
            let material = StandardMaterial {
                base_color: Color::linear_rgb(0.12, 0.13, 0.2),
                perceptual_roughness: 0.9,
                reflectance: 0.2,
                ..default()
            };
            let mut materials = self
                .app
                .world_mut()
                .resource_mut::<Assets<StandardMaterial>>();
            let material = materials.add(material);
            self.prop((
                Mesh3d(mesh),
                MeshMaterial3d(material),
                Transform::from_translation(0.5 * (low + high)),
            ));
        }
    }

    /// Puts the one camera at `eye`, over a background that shows where nothing is drawn, with no
    /// anti-aliasing and no tone mapping; `dress` adds what a picture is about.
    pub fn aim(&mut self, eye: Transform, dress: impl FnOnce(&mut EntityWorldMut)) -> Entity {
        if let Some(camera) = self.camera.take() {
            self.app.world_mut().despawn(camera);
        }
        let target = self.target.clone();
        let mut camera = self.app.world_mut().spawn(bare_camera(eye, &target));
        // Pictures are compared with the ground itself, so no triangle is spared.
        camera.insert(TerrainCamera {
            density: 0.0,
            ..default()
        });
        dress(&mut camera);
        let camera = camera.id();
        self.camera = Some(camera);
        camera
    }

    /// Streams everything in, draws `frames` more frames and takes the next one's picture.
    pub fn shoot(&mut self, name: &str, frames: u32) -> RgbImage {
        app::settle(&mut self.app, 2000);
        for _ in 0..frames {
            self.app.update();
        }
        let target = self.target.clone();
        let picture = app::picture(&mut self.app, &target);
        self.save(name, &picture);
        picture
    }

    /// [`aim`](Self::aim), then [`shoot`](Self::shoot).
    pub fn picture(
        &mut self,
        name: &str,
        eye: Transform,
        frames: u32,
        dress: impl FnOnce(&mut EntityWorldMut),
    ) -> RgbImage {
        self.aim(eye, dress);
        self.shoot(name, frames)
    }

    /// Saves a picture for whoever wants to look at it.
    pub fn save(&self, name: &str, picture: &RgbImage) {
        let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(self.test);
        std::fs::create_dir_all(&folder).unwrap();
        picture.save(folder.join(format!("{name}.png"))).unwrap();
    }
}

/// A camera that sees no terrain.
pub fn bare_camera(eye: Transform, target: &Handle<Image>) -> impl Bundle {
    (
        Camera3d::default(),
        Camera {
            clear_color: ClearColorConfig::Custom(Color::srgb_u8(
                NOTHING[0], NOTHING[1], NOTHING[2],
            )),
            ..default()
        },
        Projection::from(PerspectiveProjection {
            far: 10_000.0,
            ..default()
        }),
        app::into_image(target),
        eye,
        Tonemapping::None,
        DebandDither::Disabled,
        Msaa::Off,
    )
}

/// Pixels that something was drawn at.
pub fn covered(picture: &RgbImage) -> Vec<bool> {
    picture.pixels().map(|pixel| pixel.0 != NOTHING).collect()
}
