//! What each overlay shows of ground that is known.

use super::common::app;
use super::common::scene::{Scene, hills, linear, pixel};
use super::common::stage::NOTHING;
use super::{
    SIZE, SPACING_M, afar, assets, difference, down, eye, look, place, share, shows, stage, unlit,
    value_of, values,
};
use bevy::ecs::world::EntityWorldMut;
use bevy::prelude::*;
use bevy_tessera::edit::mask::TerrainMask;
use bevy_tessera::edit::{Change, EDIT_UNITS, Edit};
use bevy_tessera::lattice::LodSettings;
use bevy_tessera::render::{TerrainOverlay, TerrainOverlays};
use bevy_tessera::stream::TerrainState;
use bevy_tessera::terrain::{
    INDEX_FILE, MANIFEST_FILE, TerrainCamera, TerrainManifest, TessellationPolicy,
};
use bevy_tessera::tessellate::Partitioning;
use bevy_tessera::tile::{HeightTile, TerrainTile, TileAddress, TileRange};
use std::fs;

/// The middle of all landscapes.
const MIDDLE: Vec2 = Vec2::new(384.0, 320.0);

#[test]
fn density_is_that_of_the_texel_green_where_it_is_plain_and_red_where_it_is_rough() {
    let mut stage = stage("halves");
    let overlays = unlit(&[TerrainOverlay::Density]);
    let px_m = 1.0;
    let seen = down(&mut stage, "density", MIDDLE, px_m, overlays, |_| {});
    let world = stage.app.world();
    let state = world.get::<TerrainState>(stage.terrain).unwrap();
    let (mut right, mut asked) = (0, 0);
    let (mut green, mut red) = (0, 0);
    for index in 0..(SIZE[0] * SIZE[1]) as usize {
        let texel = place(MIDDLE, px_m, index) / SPACING_M / 4.0;
        // Texels' rims may fall to either side.
        if (texel.fract() - 0.5).abs().max_element() > 0.4 {
            continue;
        }
        let [x, z] = texel.floor().to_array().map(|at| at as u32);
        let tile = state
            .tile_data(TileAddress::new(0, x / 32, z / 32))
            .expect("the finest tiles are resident");
        let own = tile.densities.own_texels();
        let density = f32::from(own[(z % 32 * 32 + x % 32) as usize]) / 255.0;
        asked += 1;
        let shown = pixel(&seen, index);
        right += usize::from(shows(shown, TerrainOverlay::Density, density));
        green += usize::from(density == 0.0);
        red += usize::from(density > 0.9);
    }
    assert!(right * 100 > asked * 99, "{right} of {asked}");
    assert!(
        green * 3 > asked && red * 3 > asked,
        "{green}, {red} of {asked}"
    );
}

#[test]
fn a_level_has_one_colour_and_several_levels_have_several() {
    let mut stage = stage("hills");
    let overlays = unlit(&[TerrainOverlay::Level]);
    let near = down(
        &mut stage,
        "level_near",
        MIDDLE,
        0.5,
        overlays.clone(),
        |_| {},
    );
    assert_eq!(
        share(&near, |it| shows(it, TerrainOverlay::Level, 0.0)),
        1.0
    );
    let far = look(&mut stage, "level_far", afar(), overlays, |camera| {
        camera.get_mut::<TerrainCamera>().unwrap().lod = LodSettings {
            reach: 2.5,
            morph: 0.25,
        };
    });
    let of_level = |level| share(&far, |it| shows(it, TerrainOverlay::Level, level));
    let levels = [0.0, 1.0, 2.0].map(of_level);
    assert!(levels[..2].iter().all(|share| *share > 0.05), "{levels:?}");
    assert!(levels.iter().sum::<f32>() > 0.999, "{levels:?}");
}

#[test]
fn factors_are_those_that_the_camera_asks_for() {
    let mut stage = stage("plain");
    let overlays = unlit(&[TerrainOverlay::EdgeFactor]);
    for max_factor in [1.0, 4.0, 64.0] {
        let name = format!("edge_factor_{max_factor}");
        // Finer than can be had everywhere.
        let seen = down(&mut stage, &name, MIDDLE, 0.1, overlays.clone(), |camera| {
            let mut settings = camera.get_mut::<TerrainCamera>().unwrap();
            settings.max_factor = max_factor;
            settings.triangle_width_px = 1.0;
            settings.min_triangle_m = Some(0.01);
        });
        let all = share(&seen, |it| {
            shows(it, TerrainOverlay::EdgeFactor, max_factor.log2())
        });
        assert_eq!(all, 1.0, "{max_factor}");
    }
    let mixed = look(&mut stage, "edge_factor", eye(), overlays, |camera| {
        camera.get_mut::<TerrainCamera>().unwrap().faces_per_side = 8;
    });
    let found = values(&mixed, TerrainOverlay::EdgeFactor);
    assert!(found[found.len() - 1] - found[0] > 0.7, "{found:?}");
}

#[test]
fn triangles_are_red_where_they_are_too_large_blue_where_too_small_and_near_white_at_the_target() {
    let mut stage = stage("plain");
    let overlays = unlit(&[TerrainOverlay::TriangleSize]);
    let overlay = TerrainOverlay::TriangleSize;
    let mut seen = |name: &str, width_px, max_factor, faces_per_side| {
        look(&mut stage, name, eye(), overlays.clone(), |camera| {
            let mut settings = camera.get_mut::<TerrainCamera>().unwrap();
            settings.triangle_width_px = width_px;
            settings.max_factor = max_factor;
            settings.min_triangle_m = Some(0.01);
            settings.faces_per_side = faces_per_side;
        })
    };
    let large = seen("triangle_size_large", 1.0, 1.0, 2);
    let beyond = share(&large, |it| value_of(it, overlay).unwrap() > 1.0);
    assert!(beyond > 0.99, "{beyond}");
    let small = seen("triangle_size_small", 256.0, 64.0, 32);
    assert_eq!(
        share(&small, |it| value_of(it, overlay).unwrap() < -1.0),
        1.0
    );
    let met = seen("triangle_size_met", 6.0, 64.0, 4);
    let found = values(&met, overlay);
    let middle = found[found.len() / 2];
    assert!(middle.abs() < 0.2, "the middle is {middle} octaves off");
    let within = |octaves: f32| share(&met, |it| value_of(it, overlay).unwrap().abs() < octaves);
    let [near, far] = [0.2, 0.5].map(within);
    assert!(near > 0.6 && far > 0.9, "{near}, {far}");
}

#[test]
fn vertices_near_the_eye_stand_in_their_own_place_and_further_off_they_morph() {
    let mut stage = stage("hills");
    let overlays = unlit(&[TerrainOverlay::Morph]);
    let near = down(
        &mut stage,
        "morph_near",
        MIDDLE,
        0.5,
        overlays.clone(),
        |_| {},
    );
    assert_eq!(
        share(&near, |it| shows(it, TerrainOverlay::Morph, 0.0)),
        1.0
    );
    let far = look(&mut stage, "morph_far", afar(), overlays, |camera| {
        camera.get_mut::<TerrainCamera>().unwrap().lod = LodSettings {
            reach: 4.0,
            morph: 1.0,
        };
    });
    let found = values(&far, TerrainOverlay::Morph);
    let part = |from: f32, to: f32| {
        let within = found.iter().filter(|value| (from..=to).contains(*value));
        within.count() as f32 / found.len() as f32
    };
    assert!(part(0.0, 0.01) > 0.05, "{}", part(0.0, 0.01));
    assert!(part(0.2, 0.8) > 0.02, "{}", part(0.2, 0.8));
}

/// Leaves the finest tiles of a landscape's western half out.
fn leave_out_the_west(name: &str) {
    let (from, to) = (assets().join("plain"), assets().join(name));
    let mut manifest = TerrainManifest::read(&from).unwrap();
    let half = manifest.file.tiles(0)[0] / 2;
    let tiles: Vec<_> = manifest.index.iter().map(|(tile, _)| tile).collect();
    for tile in tiles {
        if tile.level == 0 && tile.x < half {
            manifest.index.set(tile, None);
            continue;
        }
        let file = TerrainTile::path(tile);
        fs::create_dir_all(to.join(&file).parent().unwrap()).unwrap();
        fs::copy(from.join(&file), to.join(&file)).unwrap();
    }
    let mut left: Vec<_> = manifest.index.iter().map(|(tile, _)| tile).collect();
    left.sort_by_key(|tile| tile.level);
    for tile in left {
        let bytes = fs::read(to.join(TerrainTile::path(tile))).unwrap();
        let own = HeightTile::decode(&bytes, tile).unwrap().range();
        let children = tile.children().into_iter().flatten();
        let range = children
            .filter_map(|child| manifest.index.get(child))
            .fold(own, TileRange::union);
        manifest.index.set(tile, Some(range));
    }
    let index = manifest.index.encode();
    manifest.file.index_crc32 = crc32fast::hash(&index);
    fs::write(to.join(INDEX_FILE), index).unwrap();
    let text = ron::to_string(&manifest.file).unwrap();
    fs::write(to.join(MANIFEST_FILE), text).unwrap();
}

#[test]
fn where_fine_tiles_are_missing_what_is_resident_falls_short() {
    leave_out_the_west("half_coarse");
    let mut stage = stage("half_coarse");
    let overlays = unlit(&[TerrainOverlay::Residency]);
    let centre = Vec2::new(60.0, 320.0);
    let west = down(
        &mut stage,
        "residency_west",
        centre,
        0.5,
        overlays.clone(),
        |_| {},
    );
    let short = share(&west, |it| shows(it, TerrainOverlay::Residency, 1.0));
    assert_eq!(short, 1.0);
    let centre = Vec2::new(700.0, 320.0);
    let east = down(&mut stage, "residency_east", centre, 0.5, overlays, |_| {});
    let fine = share(&east, |it| shows(it, TerrainOverlay::Residency, 0.0));
    assert_eq!(fine, 1.0);
}

#[test]
fn normals_and_slopes_are_those_of_the_ground() {
    for (terrain, normal) in [
        ("plain", Vec3::Y),
        ("tilted", Vec3::new(-0.5, 1.0, 0.0).normalize()),
    ] {
        let mut stage = stage(terrain);
        let overlays = unlit(&[TerrainOverlay::Normals]);
        let name = format!("normals_{terrain}");
        let seen = down(&mut stage, &name, MIDDLE, 0.5, overlays, |_| {});
        let shown = LinearRgba::from_vec3(normal * 0.5 + 0.5);
        assert_eq!(
            share(&seen, |it| difference(it, shown) < 3.0),
            1.0,
            "{terrain}"
        );
        let overlays = unlit(&[TerrainOverlay::Slope]);
        let name = format!("slope_{terrain}");
        let seen = down(&mut stage, &name, MIDDLE, 0.5, overlays, |_| {});
        let degrees = normal.y.acos().to_degrees();
        let right = share(&seen, |it| shows(it, TerrainOverlay::Slope, degrees));
        assert_eq!(right, 1.0, "{terrain}");
    }
}

#[test]
fn errors_are_none_on_a_plain_as_allowed_under_their_policy_and_beyond_where_nothing_is_cut() {
    let overlay = TerrainOverlay::ErrorBound;
    let mut plain = stage("plain");
    let seen = look(&mut plain, "error_plain", eye(), unlit(&[overlay]), |_| {});
    assert_eq!(share(&seen, |it| shows(it, overlay, 0.0)), 1.0);
    drop(plain);
    let mut stage = stage("hills");
    let seen = look(
        &mut stage,
        "error_kept",
        eye(),
        unlit(&[overlay]),
        |camera| {
            camera.get_mut::<TerrainCamera>().unwrap().policy =
                TessellationPolicy::ScreenError { max_px: 2.0 };
        },
    );
    let found = values(&seen, overlay);
    assert!(found[found.len() - 1] < 1.02, "{:?}", found.last());
    assert!(
        found[found.len() / 2] > 0.05,
        "{:?}",
        found[found.len() / 2]
    );
    let seen = look(
        &mut stage,
        "error_beyond",
        eye(),
        unlit(&[overlay]),
        |camera| {
            camera.get_mut::<TerrainCamera>().unwrap().max_factor = 1.0;
        },
    );
    let found = values(&seen, overlay);
    assert!(found[found.len() / 2] > 1.5, "{:?}", found[found.len() / 2]);
}

#[test]
fn craters_are_scorched_and_the_rest_is_untouched() {
    let mut stage = stage("plain");
    let centre = Vec2::new(208.0, 304.0);
    stage.aim(eye(), |_| {});
    app::settle(&mut stage.app, 2000);
    stage.app.update();
    let units = |metres: f32| (metres / SPACING_M * EDIT_UNITS as f32).round();
    let edit = Edit {
        centre: centre.to_array().map(|at| units(at) as i32),
        reach: units(12.0) as u32,
        change: Change::Crater {
            depth: 100,
            rim: 30,
            bowl: 43_690,
            roughness: 64,
            seed: 1,
            density: 255,
            scorch: 255,
            may_clamp: false,
        },
    };
    let terrain = stage.terrain;
    let mut mask = stage
        .app
        .world_mut()
        .get_mut::<TerrainMask>(terrain)
        .unwrap();
    mask.apply(&edit);
    let overlay = TerrainOverlay::Destruction;
    let px_m = 0.25;
    let seen = down(
        &mut stage,
        "destruction",
        centre,
        px_m,
        unlit(&[overlay]),
        |_| {},
    );
    let mut scorched = 0;
    for index in 0..(SIZE[0] * SIZE[1]) as usize {
        let far_m = place(centre, px_m, index).distance(centre);
        if far_m < 3.0 {
            assert!(shows(pixel(&seen, index), overlay, 1.0), "{far_m}");
            scorched += 1;
        } else if far_m > 12.5 {
            assert!(shows(pixel(&seen, index), overlay, 0.0), "{far_m}");
        }
    }
    assert!(scorched > 300);
    let found = values(&seen, overlay);
    let between = found.iter().filter(|value| (0.1..0.9).contains(*value));
    assert!(between.count() > 20);
}

#[test]
fn borders_are_lines_where_tiles_end_and_nowhere_else() {
    let mut stage = stage("plain");
    let overlay = TerrainOverlay::PageBorders;
    // Around a corner of four tiles of 256 m.
    let centre = Vec2::new(260.3, 250.7);
    let px_m = 0.5;
    let seen = down(
        &mut stage,
        "page_borders",
        centre,
        px_m,
        unlit(&[overlay]),
        |_| {},
    );
    let line = overlay.legend_color(0.0);
    let (mut on, mut off) = (0, 0);
    for index in 0..(SIZE[0] * SIZE[1]) as usize {
        let place = place(centre, px_m, index);
        let from = (place - 256.0).abs().min_element() / px_m;
        let is_line = difference(pixel(&seen, index), line) < 3.0;
        if from < 0.4 {
            assert!(is_line, "{place}");
            on += 1;
        } else if from > 1.7 {
            assert!(!is_line, "{place}");
            off += 1;
        }
    }
    assert!(on > 200 && off > 20_000, "{on}, {off}");
}

#[test]
fn the_wireframe_lies_on_the_edges_of_triangles_and_leaves_their_middles_free() {
    let mut stage = stage("plain");
    let overlay = TerrainOverlay::Wireframe;
    let (centre, px_m) = (Vec2::new(300.5, 290.5), 1.0);
    let dress = |camera: &mut EntityWorldMut| {
        let mut settings = camera.get_mut::<TerrainCamera>().unwrap();
        settings.max_factor = 1.0;
        settings.partitioning = Partitioning::Integer;
    };
    let bare = down(&mut stage, "wire_none", centre, px_m, unlit(&[]), dress);
    let seen = down(&mut stage, "wire", centre, px_m, unlit(&[overlay]), dress);
    // A tile of 256 m has four faces a side, each of two triangles.
    let face_m = 64.0;
    let (mut on, mut off) = (0, 0);
    let wire = overlay.legend_color(0.0);
    for index in 0..(SIZE[0] * SIZE[1]) as usize {
        let place = place(centre, px_m, index);
        let in_face = place - (place / face_m).floor() * face_m;
        let to_side = in_face.min(face_m - in_face).min_element();
        let to_diagonal = (in_face.x - in_face.y).abs() / 2.0_f32.sqrt();
        let from_px = to_side.min(to_diagonal) / px_m;
        let shown = pixel(&seen, index);
        if from_px < 0.1 {
            assert!(difference(shown, wire) < 3.0, "{place}: {shown:?}");
            on += 1;
        } else if from_px > 1.3 {
            // Overlays alone are lit in neither picture.
            assert_ne!(shown, [0; 3], "{place}");
            off += 1;
        }
    }
    assert!(on > 50 && off > 15_000, "{on}, {off}");
    assert_ne!(bare, seen);
}

#[test]
fn the_wireframe_of_triangles_as_wide_as_few_pixels_leaves_the_ground_to_be_seen() {
    let mut stage = stage("plain");
    let mut bright = |name: &str, width_px: f32, overlays: TerrainOverlays| {
        let name = format!("wire_{name}_{width_px}");
        let seen = look(&mut stage, &name, eye(), overlays, |camera| {
            let mut settings = camera.get_mut::<TerrainCamera>().unwrap();
            settings.triangle_width_px = width_px;
            settings.min_triangle_m = Some(0.01);
        });
        let ground = super::ground(&seen);
        let sum: f32 = ground.iter().map(|it| linear(*it).element_sum()).sum();
        sum / ground.len() as f32
    };
    let wire = || unlit(&[TerrainOverlay::Wireframe]);
    // As good as none; without any the ground is lit.
    let none = unlit(&[]).with(TerrainOverlay::Wireframe, 1e-6);
    let bare = bright("bare", 6.0, none);
    for width_px in [2.0, 4.0, 6.0, 12.0] {
        let left = bright("dense", width_px, wire()) / bare;
        assert!((0.55..0.97).contains(&left), "{width_px} px: {left}");
    }
}

#[test]
fn overlays_lie_over_each_other_in_their_order() {
    let mut stage = stage("tilted");
    let both = unlit(&[TerrainOverlay::Level]).with(TerrainOverlay::Slope, 0.25);
    let seen = down(&mut stage, "both", MIDDLE, 0.5, both, |_| {});
    let level = TerrainOverlay::Level.legend_color(0.0);
    let slope = TerrainOverlay::Slope.legend_color(0.5_f32.atan().to_degrees());
    let mixed = level * 0.75 + slope * 0.25;
    assert_eq!(share(&seen, |it| difference(it, mixed) < 3.0), 1.0);
    // Whatever lies on top covers what is below.
    let covered = unlit(&[TerrainOverlay::Level, TerrainOverlay::Slope]);
    let seen = down(&mut stage, "covered", MIDDLE, 0.5, covered, |_| {});
    assert_eq!(share(&seen, |it| difference(it, slope) < 3.0), 1.0);
}

#[test]
fn opacities_that_are_no_numbers_or_too_large_are_none_or_full() {
    let overlays = TerrainOverlays::default()
        .with(TerrainOverlay::Slope, f32::NAN)
        .with(TerrainOverlay::Level, 7.0)
        .with(TerrainOverlay::Morph, -1.0);
    assert_eq!(overlays.opacity(TerrainOverlay::Slope), 0.0);
    assert_eq!(overlays.opacity(TerrainOverlay::Level), 1.0);
    assert_eq!(overlays.opacity(TerrainOverlay::Morph), 0.0);
    assert!(overlays.is_on());
    assert!(
        !TerrainOverlays::default()
            .with(TerrainOverlay::Slope, f32::NAN)
            .is_on()
    );
}

#[test]
fn each_overlay_shows_colours_of_its_legend_and_nothing_else() {
    let mut stage = stage("hills");
    for overlay in TerrainOverlay::ALL {
        let name = format!("all_{}", overlay.name().replace(' ', "_"));
        let seen = look(&mut stage, &name, eye(), unlit(&[overlay]), |camera| {
            if overlay == TerrainOverlay::Wireframe {
                let mut settings = camera.get_mut::<TerrainCamera>().unwrap();
                settings.triangle_width_px = 24.0;
            }
        });
        let lines = [TerrainOverlay::PageBorders, TerrainOverlay::Wireframe];
        if lines.contains(&overlay) {
            let on = share(&seen, |it| shows(it, overlay, 0.0));
            assert!(on > 0.002, "{overlay:?}: {on}");
        } else if overlay == TerrainOverlay::Normals {
            let scene = Scene::new(hills);
            let hits = scene.look(&eye(), SIZE);
            let (mut right, mut asked) = (0, 0);
            for (index, hit) in hits.iter().enumerate() {
                let shown = pixel(&seen, index);
                let Some(hit) = hit.filter(|_| shown != NOTHING) else {
                    continue;
                };
                let color = LinearRgba::from_vec3(scene.normal(hit.point) * 0.5 + 0.5);
                asked += 1;
                right += usize::from(difference(shown, color) < 8.0);
            }
            assert!(right * 100 > asked * 97, "{right} of {asked}");
        } else {
            values(&seen, overlay);
        }
    }
}
