//! A preview's densities, made on the GPU from the height pages that lie there, are the CPU's
//! within one quantum, for every filter; they are made anew when the settings change and at no
//! other time; and the ground shows them while the component is there, and not a frame longer.

mod common;

use bevy::core_pipeline::prepass::{DeferredPrepass, DepthPrepass};
use bevy::prelude::*;
use bevy::render::RenderApp;
use bevy::render::error_handler::{RenderErrorHandler, RenderErrorPolicy};
use bevy::render::render_resource::{
    BufferDescriptor, BufferUsages, CommandEncoderDescriptor, MapMode, PollType,
};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use bevy::render::settings::{WgpuSettings, WgpuSettingsPriority};
use bevy_tessera::bake::{BakeSettings, MemorySource, bake};
use bevy_tessera::density::{
    DensityExtent, DensityFilter, DensityKernel, DensityScratch, DensitySettings, tile_densities,
};
use bevy_tessera::render::{GpuDensityPreview, GpuDensityPreviews, TerrainDensityPreview};
use bevy_tessera::stream::TerrainStreaming;
use bevy_tessera::stream::{TerrainState, TerrainTiles, TileData, TilePage};
use bevy_tessera::terrain::ManifestFile;
use bevy_tessera::tile::{HeightTile, TerrainTile, TileAddress};
use common::app;
use common::gpu::bundled;
use common::random::Random;
use common::scene::{Scene, assets_with_hills, hills, linear, mean_difference, pixel};
use common::stage::{NOTHING, Stage};
use image::RgbImage;
use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

const SIZE: [u32; 2] = [160, 100];

/// The asset folder with the landscapes that tests make: hills; a rough one with cliffs, terraces
/// and level ground, of an odd size; and one that is two samples wide.
fn assets() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let folder = assets_with_hills("density_preview");
        let mut random = Random(5);
        let (across, down) = (411_u32, 302_u32);
        let mut heights = Vec::new();
        for z in 0..down {
            for x in 0..across {
                let place = Vec2::new(x as f32, z as f32);
                let rough = match (x / 103, z / 76) {
                    // Level, terraced, rough, and cliffs of hundreds of metres.
                    (0, _) => 40.0,
                    (1, _) => (0.07 * place.x + 0.03 * place.y).floor() * 6.0,
                    (2, n) => 10.0_f32.powi(n as i32 - 2) * random.unit(),
                    _ => 300.0 * f32::from(u8::from((x / 9 + z / 7) % 3 == 0)),
                };
                heights
                    .push(100.0 + 12.0 * (0.05 * place.x).sin() * (0.04 * place.y).cos() + rough);
            }
        }
        let bake_of = |name: &str, size: [u32; 2], heights: Vec<f32>| {
            let mut source = MemorySource::new(size, heights)
                .unwrap()
                .with_spacing_m(2.0);
            let settings = BakeSettings::default();
            bake(&mut source, &folder.join(name), &settings, &()).unwrap();
        };
        bake_of("rough", [across, down], heights);
        let narrow = (0..2 * 300)
            .map(|n| 20.0 * ((n / 2) as f32 * 0.7).sin())
            .collect();
        bake_of("narrow", [2, 300], narrow);
        folder
    })
}

fn eye() -> Transform {
    Transform::from_xyz(130.0, 115.0, 590.0).looking_at(Vec3::new(370.0, 30.0, 310.0), Vec3::Y)
}

fn stage(terrain: &str) -> Stage {
    let mut stage = Stage::new("density_preview", assets(), terrain, SIZE);
    stage.aim(eye(), |_| {});
    app::settle(&mut stage.app, 2000);
    stage
}

fn show(stage: &mut Stage, settings: DensitySettings) {
    let terrain = stage.terrain;
    stage
        .app
        .world_mut()
        .entity_mut(terrain)
        .insert(TerrainDensityPreview {
            settings,
            opacity: 1.0,
        });
}

fn preview(stage: &Stage) -> Option<&GpuDensityPreview> {
    let render = stage.app.sub_app(RenderApp).world();
    render.resource::<GpuDensityPreviews>().get(stage.terrain)
}

/// The densities of all pages, as they lie on the GPU.
fn read(stage: &Stage) -> Vec<u8> {
    let render = stage.app.sub_app(RenderApp).world();
    let device = render.resource::<RenderDevice>();
    let queue = render.resource::<RenderQueue>();
    let buffer = preview(stage).unwrap().densities().unwrap();
    let staging = device.create_buffer(&BufferDescriptor {
        label: Some("read_back"),
        size: buffer.size(),
        usage: BufferUsages::MAP_READ | BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor::default());
    encoder.copy_buffer_to_buffer(buffer, 0, &staging, 0, buffer.size());
    queue.submit([encoder.finish()]);
    let slice = staging.slice(..);
    slice.map_async(MapMode::Read, |result| result.unwrap());
    device.poll(PollType::wait_indefinitely()).unwrap();
    slice.get_mapped_range().to_vec()
}

fn file(stage: &Stage) -> ManifestFile {
    let state = stage.app.world().get::<TerrainState>(stage.terrain);
    state.unwrap().manifest().file.clone()
}

/// Resident tiles with their pages and heights.
fn resident(stage: &Stage) -> Vec<(TileAddress, u32, HeightTile)> {
    let world = stage.app.world();
    let tiles = world.get::<TerrainTiles>(stage.terrain).unwrap();
    let data = world.resource::<Assets<TerrainTile>>();
    tiles
        .iter()
        .map(|tile| {
            let handle = &world.get::<TileData>(tile).unwrap().0;
            (
                *world.get::<TileAddress>(tile).unwrap(),
                world.get::<TilePage>(tile).unwrap().0,
                data.get(handle).unwrap().heights.clone(),
            )
        })
        .collect()
}

/// What a comparison found.
#[derive(Debug, Default)]
struct Compared {
    pages: usize,
    levels: HashSet<u8>,
    largest_difference: u8,
    /// Texels that differ, and those that are neither 0 nor 255.
    different: usize,
    between: usize,
}

/// Compares the densities on the GPU with the CPU's of the same heights.
fn compare(stage: &Stage, settings: &DensitySettings) -> Compared {
    let file = file(stage);
    let gpu = read(stage);
    let mut scratch = DensityScratch::default();
    let mut out = Compared::default();
    for (address, page, heights) in resident(stage) {
        let kernel =
            DensityKernel::new(settings, file.height_step_m, file.spacing_m, address.level);
        let mut cpu = [0; 1024];
        let (x, z) = address.first_sample();
        tile_densities(
            &kernel,
            &DensityExtent::new(file.size, address.level),
            [x, z],
            heights.samples(),
            &mut scratch,
            &mut cpu,
        );
        for (cpu, gpu) in cpu.iter().zip(&gpu[page as usize * 1024..][..1024]) {
            out.largest_difference = out.largest_difference.max(cpu.abs_diff(*gpu));
            out.different += usize::from(cpu != gpu);
            out.between += usize::from((1..255).contains(cpu));
        }
        out.pages += 1;
        out.levels.insert(address.level);
    }
    out
}

fn settings(filter: DensityFilter, gain: f32, exponent: f32) -> DensitySettings {
    DensitySettings {
        filter,
        gain,
        exponent,
        ..default()
    }
}

/// Every filter with several gains and exponents on the terrain that the stage shows.
fn every_setting(stage: &mut Stage, name: &str, pages: usize, levels: usize) {
    for filter in DensityFilter::ALL {
        for gain in [0.5, 1.0, 4.0] {
            for exponent in [1.0, 2.0, 0.5] {
                let settings = settings(filter, gain, exponent);
                show(stage, settings.clone());
                stage.app.update();
                let found = compare(stage, &settings);
                eprintln!("{name}, {filter}, {gain}, {exponent}: {found:?}");
                assert!(
                    found.pages >= pages && found.levels.len() >= levels,
                    "{found:?}"
                );
                assert!(found.largest_difference <= 1, "{filter}, {gain}: {found:?}");
                // Rounding differs here and there, not all over.
                assert!(found.different * 20 <= found.pages * 1024, "{found:?}");
                if (filter, exponent) == (DensityFilter::Mean, 1.0) {
                    assert!(found.between * 20 > found.pages * 1024, "{found:?}");
                }
            }
        }
    }
}

#[test]
fn every_resident_page_has_the_cpus_densities_within_one_quantum() {
    let mut on_rough = stage("rough/terrain.ron");
    every_setting(&mut on_rough, "rough", 12, 3);
    // In whole, the bundled elevation model has hundreds of tiles: some of them do.
    let mut on_hills = stage("hills/terrain.ron");
    every_setting(&mut on_hills, "hills", 9, 3);
}

#[test]
fn real_ground_has_the_cpus_densities_within_one_quantum() {
    let manifest = "jacksboro/terrain.ron";
    let mut stage = Stage::new("density_preview", bundled(), manifest, SIZE);
    stage.app.insert_resource(TerrainStreaming::with_pages(80));
    stage.aim(Transform::from_xyz(15e3, 900.0, 15e3), |_| {});
    app::settle(&mut stage.app, 2000);
    every_setting(&mut stage, "jacksboro", 40, 3);
}

#[test]
fn tiles_that_stream_in_later_get_their_densities_too() {
    let manifest = "jacksboro/terrain.ron";
    let mut stage = Stage::new("density_preview", bundled(), manifest, SIZE);
    let wanted = DensitySettings::default();
    stage.app.insert_resource(TerrainStreaming::with_pages(40));
    // From the very beginning, before any tile is there.
    show(&mut stage, wanted.clone());
    let mut before = HashSet::new();
    for x in [4e3, 26e3, 14e3] {
        stage.aim(Transform::from_xyz(x, 700.0, 12e3), |_| {});
        app::settle(&mut stage.app, 2000);
        let found = compare(&stage, &wanted);
        assert!(
            found.pages > 20 && found.largest_difference <= 1,
            "{found:?}"
        );
        let now: HashSet<_> = resident(&stage).iter().map(|tile| tile.0).collect();
        assert!(now.difference(&before).count() > 5, "the eye must move on");
        before = now;
    }
}

#[test]
fn densities_are_made_when_something_changes_and_at_no_other_time() {
    let mut stage = stage("hills/terrain.ron");
    assert!(preview(&stage).is_none(), "nothing without a component");
    show(&mut stage, DensitySettings::default());
    stage.app.update();
    let pages = resident(&stage).len() as u64;
    let made = |stage: &Stage| preview(stage).unwrap().made_pages();
    assert_eq!(made(&stage), pages);
    let first = read(&stage);
    for _ in 0..5 {
        stage.app.update();
    }
    assert_eq!(made(&stage), pages, "nothing changed");

    // Settings that change nothing here, and the opacity.
    let terrain = stage.terrain;
    let edit = |stage: &mut Stage, edit: &dyn Fn(&mut TerrainDensityPreview)| {
        let world = stage.app.world_mut();
        edit(&mut world.get_mut::<TerrainDensityPreview>(terrain).unwrap());
        stage.app.update();
    };
    edit(&mut stage, &|preview| {
        preview.settings.filter_size = 5;
        preview.opacity = 0.3;
    });
    assert_eq!(made(&stage), pages);

    edit(&mut stage, &|preview| preview.settings.gain = 2.5);
    assert_eq!(made(&stage), 2 * pages);
    let louder = settings(DensityFilter::Mean, 2.5, 1.0);
    assert!(compare(&stage, &louder).largest_difference <= 1);
    assert_ne!(read(&stage), first);

    // What can't be used shows nothing, and what follows it does again.
    edit(&mut stage, &|preview| preview.settings.gain = f32::NAN);
    assert!(preview(&stage).is_none());
    edit(&mut stage, &|preview| preview.settings.gain = 1.0);
    assert_eq!(made(&stage), pages);
    assert_eq!(read(&stage), first);

    let world = stage.app.world_mut();
    world.entity_mut(terrain).remove::<TerrainDensityPreview>();
    stage.app.update();
    assert!(preview(&stage).is_none());
    show(&mut stage, DensitySettings::default());
    stage.app.world_mut().entity_mut(terrain).despawn();
    stage.app.update();
    assert!(preview(&stage).is_none());
}

#[test]
fn a_terrain_two_samples_wide_has_the_cpus_densities_too() {
    let mut stage = stage("narrow/terrain.ron");
    let settings = settings(DensityFilter::Mean, 4.0, 1.0);
    show(&mut stage, settings.clone());
    stage.app.update();
    let compared = compare(&stage, &settings);
    assert!(compared.pages >= 3, "{compared:?}");
    assert!(compared.largest_difference <= 1, "{compared:?}");
}

/// Share of the ground's pixels of which something can be said.
fn share_of(picture: &RgbImage, says: impl Fn(Vec3) -> bool) -> f32 {
    let ground: Vec<_> = (0..(picture.width() * picture.height()) as usize)
        .map(|index| pixel(picture, index))
        .filter(|pixel| *pixel != NOTHING)
        .collect();
    assert!(ground.len() > 3000);
    let said = ground.iter().filter(|pixel| says(linear(**pixel))).count();
    said as f32 / ground.len() as f32
}

fn picture(stage: &mut Stage, name: &str, deferred: bool) -> RgbImage {
    stage.picture(name, eye(), 4, |camera| {
        if deferred {
            camera.insert((DepthPrepass, DeferredPrepass));
        }
    })
}

fn is_red(color: Vec3) -> bool {
    color.x > 2.0 * color.y
}

fn is_green(color: Vec3) -> bool {
    color.y > 2.0 * color.x
}

fn the_ground_shows_it(mut stage: Stage, way: &str, deferred: bool) {
    stage.prop((
        DirectionalLight {
            illuminance: 4_000.0,
            ..default()
        },
        Transform::default().looking_to(Vec3::NEG_Y, Vec3::Z),
    ));
    let terrain = stage.terrain;
    let name = |what: &str| format!("{way}_{what}");
    let bare = picture(&mut stage, &name("bare"), deferred);
    assert!(share_of(&bare, is_red) < 0.01 && share_of(&bare, is_green) < 0.01);
    show(&mut stage, settings(DensityFilter::Mean, 0.001, 1.0));
    let low = picture(&mut stage, &name("low"), deferred);
    assert!(
        share_of(&low, is_green) > 0.98,
        "{}",
        share_of(&low, is_green)
    );
    show(&mut stage, settings(DensityFilter::Mean, 1000.0, 1.0));
    let high = picture(&mut stage, &name("high"), deferred);
    assert!(share_of(&high, is_red) > 0.8, "{}", share_of(&high, is_red));
    show(&mut stage, settings(DensityFilter::Mean, 20.0, 1.0));
    let mixed = picture(&mut stage, &name("mixed"), deferred);
    let (red, green) = (share_of(&mixed, is_red), share_of(&mixed, is_green));
    assert!(red > 0.05 && green > 0.05, "{red} red, {green} green");
    let world = stage.app.world_mut();
    world
        .get_mut::<TerrainDensityPreview>(terrain)
        .unwrap()
        .opacity = 0.0;
    let clear = picture(&mut stage, &name("clear"), deferred);
    assert!(mean_difference(&bare, &clear) < 0.05);
    let world = stage.app.world_mut();
    world.entity_mut(terrain).remove::<TerrainDensityPreview>();
    let after = picture(&mut stage, &name("after"), deferred);
    assert_eq!(mean_difference(&bare, &after), 0.0);
}

#[test]
fn the_ground_shows_the_preview_in_forward_and_deferred_rendering() {
    the_ground_shows_it(stage("hills/terrain.ron"), "forward", false);
    the_ground_shows_it(stage("hills/terrain.ron"), "deferred", true);
}

#[test]
fn the_ground_shows_the_preview_on_a_device_with_webgpus_limits_only() {
    let settings = WgpuSettings {
        priority: WgpuSettingsPriority::WebGPU,
        ..default()
    };
    let (name, terrain) = ("density_preview", "hills/terrain.ron");
    let stage = Stage::with(name, assets(), terrain, SIZE, true, settings, |_| {});
    the_ground_shows_it(stage, "webgpu", false);
}

#[test]
fn a_lost_device_recovers_with_the_preview() {
    let mut stage = stage("hills/terrain.ron");
    let recover = RenderErrorHandler(|_, _, _| RenderErrorPolicy::Recover(default()));
    stage.app.insert_resource(recover);
    let wanted = settings(DensityFilter::Mean, 4.0, 1.0);
    show(&mut stage, wanted.clone());
    stage.app.update();
    let before = read(&stage);
    let render = stage.app.sub_app(RenderApp).world();
    let device = render.resource::<RenderDevice>().clone();
    // Bevy reads its own buffers back meanwhile; what is still on its way must arrive first.
    let _ = device.poll(PollType::wait_indefinitely());
    device.wgpu_device().destroy();
    let _ = device.poll(PollType::wait_indefinitely());
    for _ in 0..20 {
        stage.app.update();
    }
    assert!(compare(&stage, &wanted).largest_difference <= 1);
    assert_eq!(read(&stage), before);
}

#[test]
fn each_place_shows_the_density_of_the_texel_that_it_lies_in() {
    // From straight above, where the ground is at level 0 all over.
    let mut stage = Stage::new("density_preview", assets(), "hills/terrain.ron", [200, 200]);
    stage.app.insert_resource(GlobalAmbientLight {
        brightness: 3000.0,
        ..default()
    });
    let wanted = settings(DensityFilter::Mean, 10.0, 1.0);
    show(&mut stage, wanted.clone());
    let middle = Vec3::new(300.0, 0.0, 300.0);
    let above =
        Transform::from_translation(middle + Vec3::Y * 250.0).looking_to(Vec3::NEG_Y, Vec3::NEG_Z);
    let seen = stage.picture("above", above, 4, |_| {});
    let scene = Scene::new(hills);
    let hits = scene.look(&above, [200, 200]);
    let gpu = read(&stage);
    let pages: Vec<_> = resident(&stage)
        .into_iter()
        .filter(|tile| tile.0.level == 0)
        .collect();
    let (mut right, mut asked) = (0, 0);
    for (index, hit) in hits.iter().enumerate() {
        let Some(hit) = hit else { continue };
        let sample = Vec2::new(hit.point.x, hit.point.z) / 2.0;
        let texel = (sample / 4.0).floor();
        // Texels' rims may fall to either side.
        if ((sample / 4.0 - texel - 0.5).abs().max_element()) > 0.35 {
            continue;
        }
        let address = TileAddress::new(0, texel.x as u32 / 32, texel.y as u32 / 32);
        let page = pages.iter().find(|tile| tile.0 == address).unwrap().1;
        let at = (texel.y as usize % 32) * 32 + texel.x as usize % 32;
        let density = f32::from(gpu[page as usize * 1024 + at]) / 255.0;
        let color = linear(pixel(&seen, index));
        // How much of red there is, whatever the light.
        let wanted = Vec3::new(0.1, 0.6, 0.1).lerp(Vec3::new(0.85, 0.1, 0.05), density);
        let share = |color: Vec3| color.x / (color.x + color.y);
        asked += 1;
        right += usize::from((share(color) - share(wanted)).abs() < 0.03);
    }
    eprintln!("{right} of {asked} places show their texel's density");
    assert!(
        asked > 10_000 && right * 100 > asked * 97,
        "{right} of {asked}"
    );
}
