//! Lines over a terrain are where what they stand for is, and nowhere while they are off.

mod common;

use bevy::gizmos::config::GizmoConfigStore;
use bevy::gizmos::{GizmoAsset, GizmoHandles};
use bevy::prelude::*;
use bevy::render::settings::WgpuSettings;
use bevy_tessera::edit::{Raise, TerrainEdits, UndoEdit};
use bevy_tessera::gizmos::{TerrainGizmos, TerrainGizmosPlugin};
use bevy_tessera::render::ComparisonCamera;
use bevy_tessera::stream::{TileBounds, TileOf};
use bevy_tessera::tile::TileAddress;
use bevy_tessera::view::HeldTerrainEye;
use common::scene::{Scene, assets_with_hills, hills};
use common::stage::Stage;
use image::RgbImage;
use std::any::TypeId;

const SIZE: [u32; 2] = [320, 240];
const GREEN: Color = Color::srgb(0.0, 1.0, 0.0);
const GREEN_PIXEL: [u8; 3] = [0, 255, 0];

struct Lines {
    stage: Stage,
    scene: Scene,
    place: Transform,
}

impl Lines {
    fn new(test: &'static str, place: Transform) -> Self {
        let assets = assets_with_hills(test);
        let mut stage = Stage::with(
            test,
            &assets,
            "hills/terrain.ron",
            SIZE,
            false,
            WgpuSettings::default(),
            |app| {
                app.add_plugins(TerrainGizmosPlugin);
            },
        );
        let terrain = stage.terrain;
        stage.app.world_mut().entity_mut(terrain).insert(place);
        let eye = Transform::from_xyz(384.0, 420.0, 760.0);
        let eye = eye.looking_at(Vec3::new(384.0, 20.0, 330.0), Vec3::Y);
        let eye = Transform::from_matrix(place.to_matrix() * eye.to_matrix()).with_scale(Vec3::ONE);
        stage.aim(eye, |_| ());
        common::app::settle(&mut stage.app, 2000);
        Self {
            stage,
            scene: Scene::new(hills),
            place,
        }
    }

    fn world(&mut self) -> &mut World {
        self.stage.app.world_mut()
    }

    /// Sets the group, with lines that nothing hides.
    fn set(&mut self, set: impl FnOnce(&mut TerrainGizmos)) {
        let mut store = self.world().resource_mut::<GizmoConfigStore>();
        let (config, gizmos) = store.config_mut::<TerrainGizmos>();
        // A bias of -1 puts lines on the near plane, where rounding hides them.
        config.depth_bias = -0.9;
        *gizmos = TerrainGizmos::default();
        set(gizmos);
    }

    fn trigger<'a>(&mut self, event: impl Event<Trigger<'a>: Default>) {
        self.world().trigger(event);
        self.world().flush();
    }

    /// Vertices of lines and of strips in the last frame.
    fn vertices(&self) -> (Vec<Vec3>, Vec<Vec3>) {
        let world = self.stage.app.world();
        let handles = world.resource::<GizmoHandles>().handles();
        let Some(Some(handle)) = handles.get(&TypeId::of::<TerrainGizmos>()) else {
            return (Vec::new(), Vec::new());
        };
        let lines = world.resource::<Assets<GizmoAsset>>().get(handle);
        let buffer = lines.expect("it is there").buffer();
        let lines = buffer.list_positions.clone();
        (lines, buffer.strip_positions.clone())
    }

    /// Colours of the lines' ends.
    fn colors(&self) -> Vec<LinearRgba> {
        let world = self.stage.app.world();
        let handles = world.resource::<GizmoHandles>().handles();
        let Some(Some(handle)) = handles.get(&TypeId::of::<TerrainGizmos>()) else {
            return Vec::new();
        };
        let lines = world.resource::<Assets<GizmoAsset>>().get(handle);
        lines.expect("it is there").buffer().list_colors.clone()
    }

    fn picture(&mut self, name: &str) -> RgbImage {
        self.stage.shoot(name, 1)
    }

    /// Where a place in the terrain's own space is on the screen, if it is in the middle of it.
    fn on_screen(&self, local: Vec3) -> Option<Vec2> {
        self.seen(self.place.transform_point(local))
    }

    fn seen(&self, place: Vec3) -> Option<Vec2> {
        let world = self.stage.app.world();
        let camera = self.stage.camera.expect("aimed");
        let eye = world.get::<GlobalTransform>(camera).expect("an eye");
        let camera = world.get::<Camera>(camera).expect("a camera");
        let at = camera.world_to_viewport(eye, place).ok()?;
        let edge = Vec2::splat(4.0);
        let size = Vec2::new(SIZE[0] as f32, SIZE[1] as f32);
        (at.cmpgt(edge).all() && at.cmplt(size - edge).all()).then_some(at)
    }
}

/// Whether a pixel of that colour is within two of a place.
fn is_near(picture: &RgbImage, at: Vec2, color: [u8; 3]) -> bool {
    let (x, y) = (at.x as i32, at.y as i32);
    (-2..=2)
        .any(|dy| (-2..=2).any(|dx| picture.get_pixel((x + dx) as u32, (y + dy) as u32).0 == color))
}

fn count(picture: &RgbImage, color: [u8; 3]) -> usize {
    picture.pixels().filter(|pixel| pixel.0 == color).count()
}

fn middles_of_edges(bounds: &TileBounds) -> Vec<Vec3> {
    let (min, max) = (bounds.min_m, bounds.max_m);
    let middle = 0.5 * (min + max);
    let mut middles = Vec::new();
    for axis in 0..3 {
        for corner in 0..4 {
            let mut at = middle;
            // The two bits are the ends along the other axes.
            at[(axis + 1) % 3] = [min, max][corner & 1][(axis + 1) % 3];
            at[(axis + 2) % 3] = [min, max][corner >> 1][(axis + 2) % 3];
            middles.push(at);
        }
    }
    middles
}

fn bounds_of_tiles_are_drawn_where_they_are(test: &'static str, place: Transform) {
    let mut lines = Lines::new(test, place);
    let nothing = lines.picture("off");
    assert_eq!(count(&nothing, GREEN_PIXEL), 0);
    assert_eq!(lines.vertices().0.len(), 0);

    let world = lines.world();
    let mut tiles = world.query_filtered::<(&TileAddress, &TileBounds), With<TileOf>>();
    let tiles: Vec<_> = tiles.iter(world).map(|(a, b)| (*a, *b)).collect();
    // Boxes of several levels share edges: all are as green.
    lines.set(|gizmos| {
        gizmos.tiles = true;
        gizmos.tile_colors = [GREEN; 8];
    });
    let picture = lines.picture("tiles");
    let mut looked_at = 0;
    for (tile, bounds) in &tiles {
        for at in middles_of_edges(bounds) {
            if let Some(at) = lines.on_screen(at) {
                assert!(is_near(&picture, at, GREEN_PIXEL), "{tile:?} at {at}");
                looked_at += 1;
            }
        }
    }
    assert!(looked_at >= 20, "{looked_at} edges are seen");
    // Lines are few: most of the ground is as it was.
    let drawn = count(&picture, GREEN_PIXEL);
    assert!(drawn > 100 && drawn < (SIZE[0] * SIZE[1] / 4) as usize);

    lines.set(|gizmos| gizmos.tiles = true);
    lines.stage.app.update();
    let gizmos = TerrainGizmos::default();
    let (ends, _) = lines.vertices();
    let colors = lines.colors();
    assert_eq!(ends.len(), 24 * tiles.len());
    for (tile, bounds) in &tiles {
        let corner = lines.place.transform_point(bounds.min_m);
        let color = LinearRgba::from(gizmos.tile_color(tile.level));
        let mut drawn = ends.iter().zip(&colors);
        let is_there = drawn.any(|(end, at)| end.distance(corner) < 0.05 && *at == color);
        assert!(is_there, "no corner of {tile:?} in its level's colour");
    }
    lines.set(|_| ());
    let off = lines.picture("off_again");
    assert!(off == nothing, "lines that are off leave nothing behind");
    assert_eq!(lines.vertices().0.len(), 0);
}

#[test]
fn bounds_of_tiles_are_drawn_where_they_are_while_they_are_on() {
    bounds_of_tiles_are_drawn_where_they_are("gizmos_tiles", Transform::IDENTITY);
}

#[test]
fn bounds_of_a_turned_moved_and_scaled_terrains_tiles_are_drawn_where_they_are() {
    let place = Transform::from_xyz(-500.0, 80.0, 1200.0)
        .with_rotation(Quat::from_rotation_y(0.7))
        .with_scale(Vec3::splat(0.4));
    bounds_of_tiles_are_drawn_where_they_are("gizmos_turned", place);
}

#[test]
fn only_the_nearest_tiles_get_boxes() {
    let mut lines = Lines::new("gizmos_nearest", Transform::IDENTITY);
    lines.set(|gizmos| {
        gizmos.tiles = true;
        gizmos.most_tiles = 3;
    });
    lines.stage.app.update();
    let (few, _) = lines.vertices();
    assert_eq!(few.len(), 3 * 24);
    let camera = lines.stage.camera.unwrap();
    let eye = lines.world().get::<GlobalTransform>(camera).unwrap();
    let eye = eye.translation();
    let world = lines.world();
    let mut tiles = world.query::<&TileBounds>();
    let away = |min: Vec3, max: Vec3| eye.distance(eye.clamp(min, max));
    let mut nearest: Vec<f32> = tiles
        .iter(world)
        .map(|tile| away(tile.min_m, tile.max_m))
        .collect();
    nearest.sort_by(f32::total_cmp);
    for tile in few.chunks_exact(24) {
        let min = tile.iter().copied().reduce(Vec3::min).unwrap();
        let max = tile.iter().copied().reduce(Vec3::max).unwrap();
        assert!(away(min, max) <= nearest[2] + 1e-3);
    }
    let within = 0.5 * (nearest[0] + nearest[nearest.len() - 1]);
    let near = nearest.iter().filter(|away| **away <= within).count();
    lines.set(|gizmos| {
        gizmos.tiles = true;
        gizmos.tiles_within_m = within;
    });
    lines.stage.app.update();
    assert_eq!(lines.vertices().0.len(), 24 * near);
    lines.set(|gizmos| {
        gizmos.tiles = true;
        gizmos.most_tiles = 0;
    });
    lines.stage.app.update();
    assert_eq!(lines.vertices().0.len(), 0);
}

#[test]
fn rectangles_of_edits_lie_on_the_ground_the_newest_brightest_and_undone_ones_not_at_all() {
    let place = Transform::from_xyz(40.0, -10.0, 0.0)
        .with_rotation(Quat::from_rotation_y(0.3))
        .with_scale(Vec3::splat(0.5));
    let mut lines = Lines::new("gizmos_edits", place);
    let places = [Vec2::new(300.0, 420.0), Vec2::new(470.0, 430.0)];
    for at in places {
        let at = lines.scene.ground(at.x, at.y);
        // 40 m on the terrain.
        lines.trigger(Raise::at(place.transform_point(at)).radius(20.0).by(0.0));
    }
    lines.set(|gizmos| {
        gizmos.edits = true;
        gizmos.edit_color = GREEN;
    });
    let picture = lines.picture("two");
    let dim = Srgba::from(LinearRgba::rgb(0.0, 0.3, 0.0)).to_u8_array_no_alpha();
    for (at, color) in places.into_iter().zip([dim, GREEN_PIXEL]) {
        for way in [-1.0, -0.5, 0.0, 0.5, 1.0] {
            // Reaches are rounded to samples, so that the side lies up to one further out.
            for side in [Vec2::new(way, 1.0), Vec2::new(-1.0, way)] {
                let at = at + 40.0 * side;
                let at = lines.on_screen(lines.scene.ground(at.x, at.y)).unwrap();
                assert!(is_near(&picture, at, color), "{color:?} at {at}");
            }
        }
    }
    let (_, strips) = lines.vertices();
    let (newest, oldest) = strips.split_at(strips.len() / 2);
    assert!(newest.len() == oldest.len() && newest.len() > 16);
    for strip in [newest, oldest] {
        let inside = place.to_matrix().inverse();
        // Bevy ends a strip with what is no place.
        for &point in strip.iter().filter(|point| point.is_finite()) {
            let local = inside.transform_point3(point);
            let ground = lines.scene.ground(local.x, local.z);
            assert!(local.distance(ground) < 0.3, "{local} hangs");
        }
    }

    let active = |lines: &mut Lines| {
        let terrain = lines.stage.terrain;
        let edits = lines.world().get::<TerrainEdits>(terrain).unwrap();
        edits.log().unwrap().active_count()
    };
    lines.trigger(UndoEdit::default());
    assert_eq!(active(&mut lines), 1);
    let picture = lines.picture("one");
    assert_eq!(count(&picture, dim), 0);
    assert_eq!(lines.vertices().1.len(), newest.len());
    let corner = places[1] + 40.0;
    let corner = lines.on_screen(lines.scene.ground(corner.x, corner.y));
    assert!(!is_near(&picture, corner.unwrap(), GREEN_PIXEL));

    lines.set(|gizmos| {
        gizmos.edits = true;
        gizmos.most_edits = 0;
    });
    lines.stage.app.update();
    assert_eq!(lines.vertices().1.len(), 0);
}

#[test]
fn a_held_eyes_frustum_is_drawn_up_to_its_reach() {
    let mut lines = Lines::new("gizmos_eye", Transform::IDENTITY);
    let projection = PerspectiveProjection {
        fov: 0.6,
        aspect_ratio: 1.5,
        near: 20.0,
        ..default()
    };
    let from = Transform::from_xyz(180.0, 200.0, 420.0);
    let from = from.looking_at(Vec3::new(500.0, 100.0, 300.0), Vec3::Y);
    let camera = lines.stage.camera.unwrap();
    let eye = *lines.world().get::<GlobalTransform>(camera).unwrap();
    let clip_from_lod_view = bevy::camera::CameraProjection::get_clip_from_view(&projection);
    lines.world().spawn(HeldTerrainEye {
        lod: from.into(),
        eye,
        clip_from_lod_view,
    });
    lines.set(|gizmos| gizmos.held_eye_color = GREEN);
    let off = lines.picture("off");
    assert_eq!(count(&off, GREEN_PIXEL), 0);
    lines.set(|gizmos| {
        gizmos.held_eyes = true;
        gizmos.held_eye_color = GREEN;
        gizmos.held_eye_reach_m = 300.0;
    });
    let picture = lines.picture("on");
    let corner = |x: f32, y: f32, depth: f32| {
        let up = (0.3_f32).tan();
        from.transform_point(Vec3::new(x * up * 1.5, y * up, -1.0) * depth)
    };
    let mut edges = Vec::new();
    for [x, y] in [[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]] {
        edges.push((corner(x, y, 20.0), corner(x, y, 300.0)));
        for depth in [20.0, 300.0] {
            edges.push((corner(x, y, depth), corner(-x, y, depth)));
            edges.push((corner(x, y, depth), corner(x, -y, depth)));
        }
    }
    let mut looked_at = 0;
    for (from, to) in edges {
        for part in [0.2, 0.5, 0.8] {
            if let Some(at) = lines.seen(from.lerp(to, part)) {
                assert!(is_near(&picture, at, GREEN_PIXEL), "nothing at {at}");
                looked_at += 1;
            }
        }
    }
    assert!(looked_at > 20, "{looked_at} places are seen");
    let cross = lines.seen(from.translation).unwrap();
    assert!(is_near(&picture, cross, GREEN_PIXEL), "no cross at {cross}");

    // The second camera of a comparison has the same held eye, which is drawn once. (Of a camera that
    // is none, so that nobody takes it away.)
    let drawn = lines.vertices().0.len();
    lines.world().spawn((
        ComparisonCamera(Entity::PLACEHOLDER),
        HeldTerrainEye {
            lod: from.into(),
            eye,
            clip_from_lod_view,
        },
    ));
    lines.stage.app.update();
    assert_eq!(lines.vertices().0.len(), drawn);
}
