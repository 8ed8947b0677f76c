//! Overlays in every way that Bevy renders; and nothing of them while none is on.

use super::common::app;
use super::common::scene::{linear, mean_difference, pixel};
use super::common::stage::{NOTHING, Stage, bare_camera, covered};
use super::{SIZE, assets, difference, eye, look, share, shows, stage, unlit, values};
use bevy::core_pipeline::prepass::{
    DeferredPrepass, DepthPrepass, MotionVectorPrepass, NormalPrepass,
};
use bevy::core_pipeline::tonemapping::{DebandDither, Tonemapping};
use bevy::diagnostic::DiagnosticsStore;
use bevy::ecs::world::EntityWorldMut;
use bevy::prelude::*;
use bevy::render::RenderApp;
use bevy::render::error_handler::{RenderErrorHandler, RenderErrorPolicy};
use bevy::render::render_resource::{PipelineCache, PipelineDescriptor, PollType};
use bevy::render::renderer::RenderDevice;
use bevy::render::settings::{WgpuSettings, WgpuSettingsPriority};
use bevy_tessera::render::{
    GpuTerrainMeshes, GpuTerrainOverlays, TerrainDensityPreview, TerrainDiagnostics,
    TerrainOverlay, TerrainOverlays, TerrainStatistics,
};
use bevy_tessera::stream::{PAGE_BYTES, TerrainStreaming};
use bevy_tessera::terrain::TerrainCamera;
use image::RgbImage;

fn sun(stage: &mut Stage) {
    stage.prop((
        DirectionalLight {
            illuminance: 12_000.0,
            ..default()
        },
        Transform::from_xyz(0.75, 0.6, 0.45).looking_at(Vec3::ZERO, Vec3::Y),
    ));
}

/// Labels of the pipelines that only overlays use.
fn overlay_pipelines(stage: &Stage) -> Vec<String> {
    let cache = stage
        .app
        .sub_app(RenderApp)
        .world()
        .resource::<PipelineCache>();
    let labels = cache.pipelines().filter_map(|pipeline| {
        let label = match &pipeline.descriptor {
            PipelineDescriptor::RenderPipelineDescriptor(descriptor) => &descriptor.label,
            PipelineDescriptor::ComputePipelineDescriptor(descriptor) => &descriptor.label,
        };
        label.as_ref().map(ToString::to_string)
    });
    labels
        .filter(|label| label.contains("overlay") || label.contains("faces"))
        .collect()
}

fn has_buffers(stage: &Stage) -> bool {
    let render = stage.app.sub_app(RenderApp).world();
    let mesh = render
        .resource::<GpuTerrainMeshes>()
        .get(stage.camera.unwrap(), stage.terrain)
        .unwrap();
    mesh.triangle_faces().is_some() || mesh.part_errors().is_some()
}

#[test]
fn while_none_is_on_pictures_are_the_same_and_nothing_of_overlays_is_there() {
    let mut stage = stage("hills");
    sun(&mut stage);
    let bare = stage.picture("off_bare", eye(), 4, |_| {});
    let off = |stage: &mut Stage, name, overlays: TerrainOverlays| {
        let seen = look(stage, name, eye(), overlays, |_| {});
        assert!(!has_buffers(stage), "{name}");
        assert!(seen == bare, "{name}");
    };
    off(&mut stage, "off_default", TerrainOverlays::default());
    off(&mut stage, "off_unlit", unlit(&[]));
    let no_number = TerrainOverlays::default().with(TerrainOverlay::Level, f32::NAN);
    off(&mut stage, "off_nan", no_number);
    assert_eq!(overlay_pipelines(&stage), Vec::<String>::new());

    let on = TerrainOverlays::only(TerrainOverlay::Level);
    let seen = look(&mut stage, "off_on", eye(), on, |_| {});
    assert!(mean_difference(&seen, &bare) > 10.0);
    assert!(has_buffers(&stage));
    let mut made = overlay_pipelines(&stage);
    made.sort();
    assert_eq!(
        made,
        ["terrain_faces_pipeline", "terrain_main_overlay_pipeline"]
    );
    // On the same camera.
    let camera = stage.camera.unwrap();
    stage
        .app
        .world_mut()
        .entity_mut(camera)
        .remove::<TerrainOverlays>();
    let seen = stage.shoot("off_again", 2);
    assert!(seen == bare);
    assert!(!has_buffers(&stage));
    assert_eq!(overlay_pipelines(&stage).len(), 2, "none is queued again");
}

/// Everything that is ground without overlays is, with one, in a colour of its legend: no crack, no
/// pixel that the prepass keeps for itself.
fn covers_the_ground(stage: &mut Stage, way: &str, dress: impl Fn(&mut EntityWorldMut)) {
    let bare = stage.picture(&format!("{way}_bare"), eye(), 4, &dress);
    let overlays = unlit(&[TerrainOverlay::EdgeFactor]);
    let name = format!("{way}_edge_factor");
    let seen = look(stage, &name, eye(), overlays, &dress);
    assert_eq!(covered(&seen), covered(&bare), "{way}");
    let found = values(&seen, TerrainOverlay::EdgeFactor);
    assert!(found[found.len() - 1] - found[0] > 0.5, "{way}: {found:?}");
}

#[test]
fn the_ground_is_covered_forward_deferred_and_after_any_prepass() {
    let mut stage = stage("hills");
    sun(&mut stage);
    covers_the_ground(&mut stage, "forward", |_| {});
    covers_the_ground(&mut stage, "depth", |camera| {
        camera.insert(DepthPrepass);
    });
    covers_the_ground(&mut stage, "prepasses", |camera| {
        camera.insert((DepthPrepass, NormalPrepass, MotionVectorPrepass));
    });
    covers_the_ground(&mut stage, "deferred", |camera| {
        camera.insert((DepthPrepass, DeferredPrepass));
    });
    covers_the_ground(&mut stage, "deferred_motion", |camera| {
        camera.insert((DepthPrepass, DeferredPrepass, MotionVectorPrepass));
    });
}

#[test]
fn multisampled_and_orthographic_pictures_show_overlays_too() {
    let mut stage = stage("hills");
    let overlays = unlit(&[TerrainOverlay::Level]);
    let seen = look(&mut stage, "msaa", eye(), overlays.clone(), |camera| {
        camera.insert((Msaa::Sample4, DepthPrepass));
    });
    // Silhouettes are mixed with what is behind them.
    let level = share(&seen, |it| shows(it, TerrainOverlay::Level, 0.0));
    assert!(level > 0.97, "{level}");
    let seen = look(&mut stage, "orthographic", eye(), overlays, |camera| {
        let mut parallel = OrthographicProjection::default_3d();
        parallel.scale = 2.0;
        camera.insert(Projection::Orthographic(parallel));
    });
    let level = share(&seen, |it| shows(it, TerrainOverlay::Level, 0.0));
    assert!(level > 0.99, "{level}");
}

#[test]
fn overlays_are_lit_like_the_ground_unless_they_are_to_match_their_legend() {
    let mut stage = stage("hills");
    sun(&mut stage);
    let lit = TerrainOverlays::only(TerrainOverlay::Level);
    assert!(lit.lit);
    for (way, deferred) in [("forward", false), ("deferred", true)] {
        let dress = |camera: &mut EntityWorldMut| {
            if deferred {
                camera.insert((DepthPrepass, DeferredPrepass));
            }
        };
        let seen = look(&mut stage, &format!("lit_{way}"), eye(), lit.clone(), dress);
        let legend = share(&seen, |it| shows(it, TerrainOverlay::Level, 0.0));
        assert!(legend < 0.1, "{way}: {legend}");
        // Blue all over, and as bright as the light falls.
        let blue = share(&seen, |it| it[2] > it[0].saturating_mul(2));
        assert!(blue > 0.95, "{way}: {blue}");
        let bright = |part: f32| {
            let mut all: Vec<u8> = super::ground(&seen).iter().map(|it| it[2]).collect();
            all.sort_unstable();
            all[(all.len() as f32 * part) as usize]
        };
        assert!(bright(0.9) > bright(0.1).saturating_add(20), "{way}");
        let flat = unlit(&[TerrainOverlay::Level]);
        let seen = look(&mut stage, &format!("unlit_{way}"), eye(), flat, dress);
        let legend = share(&seen, |it| shows(it, TerrainOverlay::Level, 0.0));
        assert_eq!(legend, 1.0, "{way}");
    }
}

#[test]
fn what_is_not_lit_has_its_legends_colours_under_any_tone_mapping() {
    let mut stage = stage("halves");
    sun(&mut stage);
    let as_bevy_does = |camera: &mut EntityWorldMut| {
        camera.insert((Tonemapping::default(), DebandDither::Enabled));
    };
    let overlay = TerrainOverlay::Density;
    let density = unlit(&[overlay]);
    let seen = look(&mut stage, "tone_mapped", eye(), density, as_bevy_does);
    let stops = (0..=2000).map(|step| overlay.legend_color(step as f32 / 2000.0));
    let stops: Vec<_> = stops.collect();
    let exact = share(&seen, |it| {
        stops.iter().any(|stop| difference(it, *stop) <= 2.0)
    });
    assert_eq!(exact, 1.0);
    for density in [0.0, 1.0] {
        let on = share(&seen, |it| {
            difference(it, overlay.legend_color(density)) <= 2.0
        });
        assert!(on > 0.02, "density {density} in {on}");
    }
    // One that covers half lies over the ground as it is seen without.
    let faint = unlit(&[]).with(TerrainOverlay::Level, 1e-6);
    let tone = |camera: &mut EntityWorldMut| {
        camera.insert(Tonemapping::default());
    };
    let ground = look(&mut stage, "tone_mapped_bare", eye(), faint, tone);
    let half = unlit(&[]).with(TerrainOverlay::Level, 0.5);
    let half = look(&mut stage, "tone_mapped_half", eye(), half, tone);
    let level = TerrainOverlay::Level.legend_color(0.0);
    let right = ground.pixels().zip(half.pixels()).all(|(ground, half)| {
        let under = linear(ground.0);
        let mixed = LinearRgba::rgb(under.x, under.y, under.z) * 0.5 + level * 0.5;
        ground.0 == NOTHING || difference(half.0, mixed) < 3.0
    });
    assert!(right, "what lies below an overlay isn't the ground");
}

#[test]
fn what_overlays_take_is_counted() {
    let mut stage = stage("plain");
    let camera = stage.aim(eye(), |_| {});
    let counted = |stage: &mut Stage, name: &str| {
        stage.shoot(name, 8);
        let world = stage.app.world();
        let statistics = world.get::<TerrainStatistics>(camera).unwrap();
        let store = world.resource::<DiagnosticsStore>();
        let memory = store.get(&TerrainDiagnostics::MESH_MEMORY).unwrap();
        let mib = memory.value().unwrap();
        let view = statistics.terrains[&stage.terrain];
        (view.gpu_bytes, (mib * 1024.0 * 1024.0).round() as u64)
    };
    let before = counted(&mut stage, "counted_before");
    let overlays = unlit(&[TerrainOverlay::Density]);
    stage.app.world_mut().entity_mut(camera).insert(overlays);
    let with = counted(&mut stage, "counted_with");
    let render = stage.app.sub_app(RenderApp).world();
    let meshes = render.resource::<GpuTerrainMeshes>();
    let mesh = meshes.get(camera, stage.terrain).unwrap();
    let own = mesh.triangle_faces().unwrap().size()
        + mesh.part_errors().unwrap().size()
        + size_of::<GpuTerrainOverlays>() as u64;
    assert_eq!(with.0 - before.0, own);
    // Densities are there once, a KiB a page.
    let shared = with.1 - before.1 - own;
    assert!(shared > 0 && shared.is_multiple_of(1024), "{shared} bytes");
    let world = stage.app.world_mut();
    world.entity_mut(camera).remove::<TerrainOverlays>();
    assert_eq!(counted(&mut stage, "counted_after"), before);
}

#[test]
fn a_camera_beside_one_with_overlays_sees_none() {
    let mut stage = stage("hills");
    sun(&mut stage);
    let alone = stage.picture("alone", eye(), 4, |_| {});
    let other = app::target(&mut stage.app, SIZE[0], SIZE[1]);
    stage.prop((
        bare_camera(eye(), &other),
        TerrainCamera {
            density: 0.0,
            ..default()
        },
        unlit(&[TerrainOverlay::Slope]),
    ));
    let beside = stage.shoot("beside", 4);
    assert!(beside == alone);
    let overlaid = app::picture(&mut stage.app, &other);
    stage.save("beside_other", &overlaid);
    values(&overlaid, TerrainOverlay::Slope);
}

#[test]
fn a_preview_of_densities_may_be_shown_below() {
    let mut stage = stage("plain");
    let terrain = stage.terrain;
    let mut terrain = stage.app.world_mut().entity_mut(terrain);
    terrain.insert(TerrainDensityPreview {
        opacity: 1.0,
        ..default()
    });
    let wire = unlit(&[TerrainOverlay::Wireframe]);
    for (way, deferred) in [("forward", false), ("deferred", true)] {
        let name = format!("preview_{way}");
        let seen = look(&mut stage, &name, eye(), wire.clone(), |camera| {
            // Wide enough for lines to be black.
            let mut settings = camera.get_mut::<TerrainCamera>().unwrap();
            settings.triangle_width_px = 24.0;
            if deferred {
                camera.insert((DepthPrepass, DeferredPrepass));
            }
        });
        let green = share(&seen, |it| it[1] > 30 && linear(it).y > 2.0 * linear(it).x);
        let black = share(&seen, |it| shows(it, TerrainOverlay::Wireframe, 0.0));
        assert!(green > 0.3 && black > 0.01, "{way}: {green}, {black}");
    }
}

fn every_overlay(stage: &mut Stage, name: &str) -> Vec<RgbImage> {
    let picture = |overlay: TerrainOverlay| {
        let name = format!("{name}_{}", overlay.name().replace(' ', "_"));
        let seen = look(stage, &name, eye(), unlit(&[overlay]), |_| {});
        assert!(covered(&seen).iter().filter(|it| **it).count() > 3000);
        seen
    };
    TerrainOverlay::ALL.map(picture).into()
}

#[test]
fn a_device_with_webgpus_limits_draws_the_same() {
    let settings = WgpuSettings {
        priority: WgpuSettingsPriority::WebGPU,
        ..default()
    };
    let terrain = "hills/terrain.ron";
    let mut narrow = Stage::with("overlays", assets(), terrain, SIZE, true, settings, |_| {});
    let found = every_overlay(&mut narrow, "webgpu");
    drop(narrow);
    let wanted = every_overlay(&mut stage("hills"), "native");
    for (overlay, (found, wanted)) in TerrainOverlay::ALL.iter().zip(found.iter().zip(&wanted)) {
        let mean = mean_difference(found, wanted);
        assert!(mean < 0.3, "{overlay:?}: {mean}");
    }
}

#[test]
fn a_lost_device_recovers_with_its_overlays() {
    let mut stage = stage("halves");
    let recover = RenderErrorHandler(|_, _, _| RenderErrorPolicy::Recover(default()));
    stage.app.insert_resource(recover);
    let overlays = unlit(&[TerrainOverlay::Density]).with(TerrainOverlay::ErrorBound, 0.5);
    let before = look(&mut stage, "lost_before", eye(), overlays, |_| {});
    let render = stage.app.sub_app(RenderApp).world();
    let device = render.resource::<RenderDevice>().clone();
    // Bevy reads its own buffers back meanwhile; what is still on its way must arrive first.
    let _ = device.poll(PollType::wait_indefinitely());
    device.wgpu_device().destroy();
    let _ = device.poll(PollType::wait_indefinitely());
    for _ in 0..20 {
        stage.app.update();
    }
    let after = stage.shoot("lost_after", 4);
    assert!(before == after);
    assert!(share(&after, |it| it != NOTHING) == 1.0 && pixel(&after, 0) != [0; 3]);
}

#[test]
fn what_streams_in_later_shows_its_density_too() {
    let mut stage = stage("halves");
    // Before any tile is there, and page by page.
    stage.app.insert_resource(TerrainStreaming {
        upload_bytes_per_frame: PAGE_BYTES,
        ..default()
    });
    let overlays = unlit(&[TerrainOverlay::Density]);
    stage.aim(eye(), |camera| {
        camera.insert(overlays.clone());
    });
    let seen = stage.shoot("streamed", 2);
    let red = share(&seen, |it| shows(it, TerrainOverlay::Density, 1.0));
    let green = share(&seen, |it| shows(it, TerrainOverlay::Density, 0.0));
    assert!(red > 0.02 && green > 0.2, "{red}, {green}");
}
