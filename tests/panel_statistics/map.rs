//! The tab of the map.

use super::{Tab, hover, shapes, show, text_with, texts};
use crate::common::virtual_source::{Outcome, VirtualSource};
use crate::streaming_support::{World3, write_terrain};
use bevy::math::{DVec2, DVec3};
use bevy::prelude::*;
use bevy_egui::egui::{
    Event, Modifiers, MouseWheelUnit, PointerButton, Pos2, Rect, Shape, TouchPhase, vec2,
};
use bevy_tessera::debug::{
    MapColour, MapTab, StatisticsTabPlugin, TerrainCameraFlown, TerrainChoice,
};
use bevy_tessera::lattice::Node;
use bevy_tessera::render::TerrainNodes;
use bevy_tessera::stream::{TerrainPin, TerrainRegion, TerrainState, TerrainStreaming};
use bevy_tessera::terrain::{INDEX_FILE, MANIFEST_FILE, ManifestFile, Terrain, TerrainCamera};
use bevy_tessera::tile::{
    DENSITY_STORED, DensityTile, ErrorTile, HeightTile, TILE_STORED, TileAddress, TileIndex,
    TileRange, encode_tile, tile_path,
};
use bevy_tessera::view::{TerrainEye, TerrainViews};
use egui_kittest::kittest::Queryable as _;
use std::path::Path;

/// Metres between the samples of the tests' terrains.
const SPACING_M: f64 = 2.0;

/// A map of a terrain of `side` samples, all of it pinned and resident but what `faults` holds back.
struct Setup {
    world: World3,
    chosen: TerrainChoice,
}

impl Setup {
    fn new(side: u32, faults: impl Fn(&Path) -> (u64, Outcome) + Send + Sync + 'static) -> Self {
        let mut world = World3::in_app([side; 2], false, |app, assets| {
            let source = VirtualSource::new(assets, move |path, _| faults(path));
            app.register_asset_source("late", source.builder());
            app.add_systems(First, move || source.tick());
            app.add_plugins(StatisticsTabPlugin);
        });
        world.app.insert_resource(TerrainStreaming {
            retry_s: 1e6,
            load_timeout_s: 1e6,
            ..default()
        });
        let server = world.app.world().resource::<AssetServer>();
        let manifest = server.load("late://alps/terrain.ron");
        let terrain = world.app.world_mut().spawn(Terrain::new(manifest)).id();
        let middle = f64::from(side - 1) * SPACING_M / 2.0;
        let eye = Transform::from_xyz(middle as f32, 300.0, middle as f32)
            .looking_to(Vec3::new(1.0, -0.2, 0.3), Vec3::Y);
        let camera = (TerrainCamera::default(), TerrainNodes::default(), eye);
        let camera = world.app.world_mut().spawn(camera).id();
        world.app.world_mut().spawn(TerrainPin {
            terrain,
            region: TerrainRegion::EVERYTHING,
            finest_level: 0,
        });
        let chosen = TerrainChoice {
            camera: Some(camera),
            terrain: Some(terrain),
        };
        Self { world, chosen }
    }

    fn run_until(&mut self, done: impl Fn(&TerrainState) -> bool) {
        let terrain = self.chosen.terrain.unwrap();
        self.world.run_until("all has come that can", |world| {
            world.get::<TerrainState>(terrain).is_some_and(&done)
        });
    }

    /// The whole of it.
    fn settled(side: u32) -> Self {
        let mut setup = Self::new(side, |_| (0, Outcome::Good));
        setup.run_until(TerrainState::is_settled);
        setup
    }

    fn show(self) -> Tab<MapTab> {
        let World3 { app, dir } = self.world;
        show(app, MapTab::default(), self.chosen, Some(dir))
    }
}

fn map_rect(tab: &Tab<MapTab>) -> Rect {
    tab.get_by_label("Map of the quadtree").rect()
}

/// The ground below the pointer, as the map tells it.
fn ground_at(tab: &mut Tab<MapTab>, at: Pos2) -> DVec2 {
    hover(tab, at);
    let text = text_with(tab, " m, z ");
    let number = |name: &str| {
        let (_, rest) = text.split_once(name).unwrap();
        rest.split_once(" m").unwrap().0.parse::<f64>().unwrap()
    };
    DVec2::new(number("x "), number("z "))
}

/// Where the map shows a place.
fn screen_at(tab: &mut Tab<MapTab>, at_m: DVec2) -> Pos2 {
    let rect = map_rect(tab).shrink(20.0);
    let [low, high] = [rect.min, rect.max].map(|corner| ground_at(tab, corner));
    let part = ((at_m - low) / (high - low)).as_vec2();
    rect.min + vec2(part.x, part.y) * rect.size()
}

/// The colours of the map's squares that lie over a point, the lowest first.
fn colours_at(tab: &Tab<MapTab>, at: Pos2) -> Vec<MapColour> {
    let mut found = Vec::new();
    for shape in shapes(tab) {
        let Shape::Mesh(mesh) = shape else {
            continue;
        };
        for square in mesh.vertices.chunks_exact(4) {
            let rect = Rect::from_two_pos(square[0].pos, square[3].pos);
            let colours = MapColour::ALL.into_iter();
            let mut colours = colours.filter(|colour| colour.colour() == square[0].color);
            if rect.contains(at)
                && let Some(colour) = colours.next()
            {
                found.push(colour);
            }
        }
    }
    found
}

/// The middle of a tile, metres.
fn middle_of(tile: TileAddress) -> DVec2 {
    let side_m = 128.0 * SPACING_M * f64::from(1 << tile.level);
    (DVec2::new(tile.x.into(), tile.z.into()) + 0.5) * side_m
}

#[test]
fn tiles_have_the_colours_of_their_states() {
    const FAILED: TileAddress = TileAddress::new(0, 2, 3);
    const LATE: TileAddress = TileAddress::new(0, 5, 1);
    let mut setup = Setup::new(1025, |path| {
        let path = path.to_string_lossy();
        if path.ends_with("0/2_3.tile") {
            (0, Outcome::Failure)
        } else if path.ends_with("0/5_1.tile") {
            (1 << 40, Outcome::Good)
        } else {
            (0, Outcome::Good)
        }
    });
    setup.run_until(|state| {
        state.failed_count() == 1 && state.loading_count() == 1 && state.resident_count() == 83
    });
    let mut tab = setup.show();
    let top = |tab: &mut Tab<MapTab>, tile: TileAddress| {
        let at = screen_at(tab, middle_of(tile));
        *colours_at(tab, at).last().unwrap()
    };
    assert_eq!(top(&mut tab, FAILED), MapColour::Failed);
    assert_eq!(top(&mut tab, LATE), MapColour::Loading);
    for (x, z) in [(0, 0), (7, 7), (2, 2), (6, 1), (3, 3)] {
        let tile = TileAddress::new(0, x, z);
        assert_eq!(top(&mut tab, tile), MapColour::Resident, "{tile}");
    }
    // What is pointed at is said.
    let at = screen_at(&mut tab, middle_of(FAILED));
    hover(&mut tab, at);
    let said = text_with(&tab, "tile 0/2_3");
    assert!(
        said.contains("failed") && said.contains("the disk is on fire"),
        "{said}"
    );
    let state = tab
        .state()
        .app
        .world()
        .get::<TerrainState>(tab.state().chosen.terrain.unwrap());
    let bounds = state.unwrap().bounds(FAILED).unwrap();
    let height = format!("{:.1} to {:.1} m high", bounds.min_m.y, bounds.max_m.y);
    assert!(said.contains(&height), "{said} and {height}");
    let at = screen_at(&mut tab, middle_of(LATE));
    hover(&mut tab, at);
    text_with(&tab, "tile 0/5_1, level 0, loading");
    let corner = map_rect(&tab).min + vec2(2.0, 2.0);
    hover(&mut tab, corner);
    text_with(&tab, "beyond the terrain");

    // Of a level: its parents are resident everywhere, and what can't be had is absent.
    for (level, at, wanted) in [
        (1, middle_of(FAILED), MapColour::Resident),
        (0, middle_of(FAILED), MapColour::Failed),
    ] {
        tab.get_by_label("Tiles").click();
        tab.run_steps(3);
        tab.get_by_label(&format!("level {level}")).click();
        tab.run_steps(3);
        let at = screen_at(&mut tab, at);
        assert_eq!(
            *colours_at(&tab, at).last().unwrap(),
            wanted,
            "level {level}"
        );
        if level == 0 {
            assert_eq!(colours_at(&tab, at)[0], MapColour::Absent);
        }
    }
    // And back: its parent stands in for what can't be had.
    tab.get_by_label("Tiles").click();
    tab.run_steps(3);
    tab.get_by_label("finest resident").click();
    tab.run_steps(3);
    let at = screen_at(&mut tab, middle_of(FAILED));
    assert_eq!(colours_at(&tab, at)[0], MapColour::Resident);
    assert_eq!(top(&mut tab, FAILED), MapColour::Failed);
    hover(&mut tab, at);
    text_with(&tab, "tile 0/2_3");
}

#[test]
fn drawn_nodes_lie_over_their_tiles_and_culled_ones_are_outlined() {
    let setup = Setup::settled(1025);
    let (camera, terrain) = (setup.chosen.camera.unwrap(), setup.chosen.terrain.unwrap());
    let mut tab = setup.show();
    let world = tab.state_mut().app.world_mut();
    let view = *world
        .get::<TerrainViews>(camera)
        .unwrap()
        .of(terrain)
        .unwrap();
    let mut nodes: Vec<Node> = Vec::new();
    view.lod
        .select(&view.lattice, &mut |_, _| true, &mut |node| {
            nodes.push(node)
        });
    assert!(nodes.len() > 8);
    let unit_m = view.lattice.unit_m(SPACING_M);
    let middle_m = |node: &Node| {
        let bounds = node.bounds(&view.lattice).unwrap();
        (bounds.low + bounds.high).as_dvec2() * 0.5 * unit_m
    };
    // The camera draws every other one.
    let [drawn, culled]: [Vec<Node>; 2] =
        [0, 1].map(|rest| nodes.iter().copied().skip(rest).step_by(2).collect());
    world
        .get_mut::<TerrainNodes>(camera)
        .unwrap()
        .nodes
        .insert(terrain, drawn.clone());
    tab.run_steps(2);
    for node in drawn.iter().step_by(7) {
        let at = screen_at(&mut tab, middle_m(node));
        assert_eq!(*colours_at(&tab, at).last().unwrap(), MapColour::Drawn);
    }
    for node in culled.iter().step_by(7) {
        let at = screen_at(&mut tab, middle_m(node));
        assert_eq!(*colours_at(&tab, at).last().unwrap(), MapColour::Resident);
        let bounds = node.bounds(&view.lattice).unwrap();
        let top_m = DVec2::new(middle_m(node).x, f64::from(bounds.low.y) * unit_m);
        let edge = screen_at(&mut tab, top_m);
        let outlined = (-2..=2)
            .any(|dy| colours_at(&tab, edge + vec2(0.0, dy as f32)).contains(&MapColour::Culled));
        assert!(outlined, "{node:?}");
    }
    text_with(&tab, &format!("drawn {}", drawn.len()));
}

fn wheel(tab: &mut Tab<MapTab>, at: Pos2, lines: f32) {
    hover(tab, at);
    tab.event(Event::MouseWheel {
        unit: MouseWheelUnit::Line,
        delta: vec2(0.0, lines),
        phase: TouchPhase::Move,
        modifiers: Modifiers::NONE,
    });
    tab.run_steps(30);
}

#[test]
fn zooming_keeps_the_ground_under_the_pointer_dragging_takes_it_along_and_fit_shows_all() {
    let mut tab = Setup::settled(1025).show();
    let rect = map_rect(&tab);
    let at = rect.min + vec2(0.3, 0.6) * rect.size();
    let far = rect.center();
    let [before, far_before] = [at, far].map(|at| ground_at(&mut tab, at));
    wheel(&mut tab, at, 6.0);
    let [after, far_after] = [at, far].map(|at| ground_at(&mut tab, at));
    assert!(after.distance(before) < 1.0, "{before} and {after}");
    let grown = (far_before - before).length() / (far_after - after).length();
    assert!(grown > 1.3, "× {grown}");

    hover(&mut tab, at);
    tab.drag_at(at);
    tab.run_steps(1);
    hover(&mut tab, at + vec2(40.0, 10.0));
    hover(&mut tab, at + vec2(120.0, 30.0));
    tab.drop_at(at + vec2(120.0, 30.0));
    tab.run_steps(2);
    let dragged = ground_at(&mut tab, at + vec2(120.0, 30.0));
    assert!(dragged.distance(after) < 20.0, "{after} and {dragged}");
    let moved = ground_at(&mut tab, at);
    assert!(moved.distance(after) > 50.0);

    tab.get_by_label("Fit").click();
    tab.run_steps(2);
    assert!(ground_at(&mut tab, at).distance(before) < 1.0);

    // The eye stays in the middle while it is followed.
    tab.get_by_label("Follow eye").click();
    tab.run_steps(2);
    let camera = tab.state().chosen.camera.unwrap();
    let app = &mut tab.state_mut().app;
    app.world_mut()
        .get_mut::<Transform>(camera)
        .unwrap()
        .translation
        .x = 321.0;
    app.update();
    tab.run_steps(2);
    let middle = ground_at(&mut tab, rect.center());
    assert!((middle.x - 321.0).abs() < 5.0, "{middle}");
}

fn click(tab: &mut Tab<MapTab>, at: Pos2) {
    hover(tab, at);
    for pressed in [true, false] {
        tab.event(Event::PointerButton {
            pos: at,
            button: PointerButton::Primary,
            pressed,
            modifiers: Modifiers::NONE,
        });
        tab.run_steps(1);
    }
}

/// Clicks the map there and lets the camera arrive.
fn fly(tab: &mut Tab<MapTab>, at: Pos2) -> (Transform, u32) {
    let camera = tab.state().chosen.camera.unwrap();
    click(tab, at);
    let mut last = *tab.state().app.world().get::<Transform>(camera).unwrap();
    let mut frames = 0;
    for _ in 0..200 {
        tab.state_mut().app.update();
        tab.run_steps(1);
        let now = *tab.state().app.world().get::<Transform>(camera).unwrap();
        if now == last {
            break;
        }
        (last, frames) = (now, frames + 1);
    }
    (last, frames)
}

fn check_arrival(tab: &Tab<MapTab>, arrived: &Transform, at_m: DVec2, heading: Vec3) {
    let terrain = tab.state().chosen.terrain.unwrap();
    let state = tab
        .state()
        .app
        .world()
        .get::<TerrainState>(terrain)
        .unwrap();
    let eye = arrived.translation.as_dvec3();
    let target = DVec3::new(at_m.x, state.height(at_m).unwrap().height_m, at_m.y);
    let along = (target - eye).normalize();
    assert!(
        along.dot(arrived.forward().as_dvec3()) > 0.9995,
        "it looks there"
    );
    let above = eye.y - target.y;
    assert!((10.0..=300.0).contains(&above), "{above} m above the place");
    if let Some(ground) = state.height(DVec2::new(eye.x, eye.z)) {
        assert!(eye.y > ground.height_m + 3.0, "above the ground");
    }
    let flat = |along: Vec3| Vec2::new(along.x, along.z).normalize();
    let turned = flat(arrived.forward().as_vec3()).dot(flat(heading));
    assert!(turned > 0.999, "it keeps its heading");
    assert!(arrived.right().y.abs() < 1e-3, "upright");
}

#[test]
fn a_click_flies_the_camera_there() {
    let setup = Setup::settled(1025);
    let camera = setup.chosen.camera.unwrap();
    let mut tab = setup.show();
    let place = DVec2::new(1300.0, 620.0);
    let at = screen_at(&mut tab, place);
    let heading = Vec3::new(1.0, 0.0, 0.3);
    let (arrived, frames) = fly(&mut tab, at);
    assert!(frames > 10, "it glides, {frames} frames");
    let place = ground_at(&mut tab, at);
    check_arrival(&tab, &arrived, place, heading);

    // From close above the ground the other end of the terrain is far: there it jumps.
    let state = tab
        .state()
        .app
        .world()
        .get::<TerrainState>(tab.state().chosen.terrain.unwrap());
    let ground_m = state
        .unwrap()
        .height(DVec2::new(60.0, 60.0))
        .unwrap()
        .height_m as f32;
    let low = Transform::from_xyz(60.0, ground_m + 2.0, 60.0).looking_to(Vec3::Z, Vec3::Y);
    tab.state_mut()
        .app
        .world_mut()
        .entity_mut(camera)
        .insert(low);
    tab.state_mut().app.update();
    let at = screen_at(&mut tab, DVec2::new(1900.0, 1800.0));
    let place = ground_at(&mut tab, at);
    let (arrived, frames) = fly(&mut tab, at);
    assert_eq!(frames, 0, "it jumps");
    check_arrival(&tab, &arrived, place, Vec3::Z);

    // Beyond the terrain there is nowhere to fly to.
    let corner = map_rect(&tab).min + vec2(2.0, 2.0);
    let (stays, _) = fly(&mut tab, corner);
    assert_eq!(stays, arrived);
}

#[test]
fn whoever_moves_a_camera_ends_its_glide() {
    let setup = Setup::settled(1025);
    let camera = setup.chosen.camera.unwrap();
    let mut tab = setup.show();
    let at = screen_at(&mut tab, DVec2::new(1300.0, 620.0));
    click(&mut tab, at);
    for _ in 0..5 {
        tab.state_mut().app.update();
        tab.run_steps(1);
    }
    let mine = Transform::from_xyz(5.0, 700.0, 5.0);
    tab.state_mut()
        .app
        .world_mut()
        .entity_mut(camera)
        .insert(mine);
    for _ in 0..5 {
        tab.state_mut().app.update();
        tab.run_steps(1);
    }
    let now = tab.state().app.world().get::<Transform>(camera);
    assert_eq!(now, Some(&mine));
}

/// What was told of flights.
#[derive(Resource, Default)]
struct Heard(Vec<TerrainCameraFlown>);

fn hear(tab: &mut Tab<MapTab>) {
    let world = tab.state_mut().app.world_mut();
    world.init_resource::<Heard>();
    world.add_observer(|flown: On<TerrainCameraFlown>, mut heard: ResMut<Heard>| {
        heard.0.push(*flown);
    });
}

#[test]
fn a_flight_is_told_of_and_ends_at_its_goal_when_the_panel_is_closed() {
    let setup = Setup::settled(1025);
    let (camera, terrain) = (setup.chosen.camera.unwrap(), setup.chosen.terrain.unwrap());
    let mut tab = setup.show();
    hear(&mut tab);
    let at = screen_at(&mut tab, DVec2::new(1300.0, 620.0));
    let (arrived, frames) = fly(&mut tab, at);
    let heard = std::mem::take(&mut tab.state_mut().app.world_mut().resource_mut::<Heard>().0);
    assert!(heard.len() as u32 >= frames, "{} of {frames}", heard.len());
    for (at, flown) in heard.iter().enumerate() {
        let is_there = at + 1 == heard.len();
        let wanted = TerrainCameraFlown {
            entity: camera,
            terrain,
            is_there,
        };
        assert_eq!(*flown, wanted);
    }

    let place = DVec2::new(1500.0, 900.0);
    let at = screen_at(&mut tab, place);
    let place = ground_at(&mut tab, at);
    click(&mut tab, at);
    for _ in 0..3 {
        tab.state_mut().app.update();
        tab.run_steps(1);
    }
    let now = |tab: &Tab<MapTab>| *tab.state().app.world().get::<Transform>(camera).unwrap();
    let on_its_way = now(&tab);
    assert_ne!(on_its_way, arrived);
    // Closed.
    for _ in 0..3 {
        tab.state_mut().app.update();
    }
    check_arrival(&tab, &now(&tab), place, *arrived.forward());
    let last = tab
        .state()
        .app
        .world()
        .resource::<Heard>()
        .0
        .last()
        .copied();
    assert!(last.is_some_and(|flown| flown.is_there));
    // Opened again, it isn't moved.
    let there = now(&tab);
    tab.run_steps(4);
    assert_eq!(now(&tab), there);
}

#[test]
fn the_eye_that_the_level_of_detail_follows_flies_from_where_it_is() {
    let setup = Setup::settled(1025);
    let camera = setup.chosen.camera.unwrap();
    let mut tab = setup.show();
    let world = tab.state_mut().app.world_mut();
    world.entity_mut(camera).insert(TerrainEye::LodOnly);
    tab.state_mut().app.update();
    // The picture stays where it was; the other eye looks north, from lower down.
    let heading = Vec3::new(-0.2, 0.0, -1.0);
    let lod =
        Transform::from_xyz(900.0, 200.0, 900.0).looking_to(heading + Vec3::NEG_Y * 0.1, Vec3::Y);
    tab.state_mut()
        .app
        .world_mut()
        .entity_mut(camera)
        .insert(lod);
    tab.state_mut().app.update();
    tab.run_steps(2);
    let at = screen_at(&mut tab, DVec2::new(1000.0, 620.0));
    let (arrived, _) = fly(&mut tab, at);
    let place = ground_at(&mut tab, at);
    check_arrival(&tab, &arrived, place, heading);
}

/// The finest level of the huge terrain that is stored.
const STORED: u8 = 5;

/// Writes a terrain of 131,073² samples of which only the coarse tiles are stored.
fn write_huge(folder: &Path) -> ManifestFile {
    let file = write_terrain(&folder.join("small"), [129; 2]);
    let size = [131_073; 2];
    let mut file = ManifestFile {
        size,
        levels: ManifestFile::levels_for(size),
        ..file
    };
    let mut index = TileIndex::new(&file);
    for level in STORED..file.levels {
        let [columns, rows] = file.tiles(level);
        for (x, z) in (0..rows).flat_map(|z| (0..columns).map(move |x| (x, z))) {
            let range = TileRange { min: 500, max: 500 };
            index.set(TileAddress::new(level, x, z), Some(range));
        }
    }
    let encoded = index.encode();
    file.index_crc32 = crc32fast::hash(&encoded);
    std::fs::create_dir_all(folder).unwrap();
    std::fs::write(folder.join(INDEX_FILE), &encoded).unwrap();
    std::fs::write(folder.join(MANIFEST_FILE), ron::to_string(&file).unwrap()).unwrap();
    let heights = vec![500; (TILE_STORED * TILE_STORED) as usize];
    let heights = HeightTile::from_samples(heights.into()).unwrap();
    let texels = vec![128; (DENSITY_STORED * DENSITY_STORED) as usize];
    let densities = DensityTile::from_samples(texels.into()).unwrap();
    for (address, _) in index.iter() {
        let bytes = encode_tile(
            address,
            file.stamp(),
            &heights,
            &densities,
            &ErrorTile::flat(),
        );
        let path = folder.join(tile_path(address));
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }
    file
}

#[test]
fn a_map_of_a_huge_terrain_is_a_bounded_number_of_shapes() {
    let mut world = World3::new([129; 2]);
    write_huge(&world.dir.path().join("huge"));
    let server = world.app.world().resource::<AssetServer>();
    let manifest = server.load("huge/terrain.ron");
    let terrain = world.app.world_mut().spawn(Terrain::new(manifest)).id();
    let eye = Transform::from_xyz(131e3, 300.0, 131e3).looking_to(Vec3::X, Vec3::Y);
    let camera = (TerrainCamera::default(), TerrainNodes::default(), eye);
    let camera = world.app.world_mut().spawn(camera).id();
    world.app.world_mut().spawn(TerrainPin {
        terrain,
        region: TerrainRegion::EVERYTHING,
        finest_level: STORED,
    });
    // Without the checks of every frame, which visit each of a million cells.
    let is_full = |world: &World3| {
        let state = world.app.world().get::<TerrainState>(terrain);
        state.is_some_and(|state| state.resident_count() > 1100)
    };
    for _ in 0..20_000 {
        if is_full(&world) {
            break;
        }
        world.app.update();
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    assert!(is_full(&world));
    let state = world.state(terrain);
    let [columns, rows] = state.pages().tiles(0);
    assert!(columns * rows > 1_000_000);
    let resident = state.resident_count();
    let World3 { app, dir } = world;
    let chosen = TerrainChoice {
        camera: Some(camera),
        terrain: Some(terrain),
    };
    let mut tab = show(app, MapTab::default(), chosen, Some(dir));
    let vertices = |tab: &Tab<MapTab>| -> usize {
        shapes(tab)
            .iter()
            .filter_map(|shape| match shape {
                Shape::Mesh(mesh) => Some(mesh.vertices.len()),
                _ => None,
            })
            .sum()
    };
    let middle = map_rect(&tab).center();
    let mut most = 0;
    // From all of it down to a few samples, and at the finest level chosen too.
    for step in 0..40 {
        assert!(shapes(&tab).len() < 120, "{} shapes", shapes(&tab).len());
        most = most.max(vertices(&tab));
        if step == 20 {
            tab.get_by_label("Tiles").click();
            tab.run_steps(3);
            tab.get_by_label("level 0").click();
            tab.run_steps(3);
        }
        wheel(&mut tab, middle, if step < 20 { 10.0 } else { -10.0 });
    }
    // A square and two lines a tile, four corners each; nodes besides.
    assert!(most > 4 * resident, "{most} of {resident}");
    assert!(most < 12 * (2 * resident + 3000), "{most} of {resident}");
    let said = texts(&tab);
    assert!(
        said.iter()
            .any(|(text, _)| text.contains(&format!("resident {resident}")))
    );
}
