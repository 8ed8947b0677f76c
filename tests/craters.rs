//! Craters and other edits change the ground that is resident at once, and the ground that streams in
//! later in the same way; what is taken back is as if it had never been.

#[path = "craters/logs.rs"]
mod logs;
mod streaming_support;

use bevy::ecs::system::SystemState;
use bevy::math::DVec2;
use bevy::prelude::*;
use bevy_tessera::edit::{
    Crater, EditLog, Flatten, MergeEdits, Raise, RedoEdit, Smooth, Stamp, StampImage,
    TerrainEditRedone, TerrainEditRefused, TerrainEditUndone, TerrainEdited, TerrainEdits,
    UndoEdit,
};
use bevy_tessera::query::TerrainQuery;
use bevy_tessera::stream::{
    PAGE_BYTES, TerrainPin, TerrainRegion, TerrainState, TerrainStreaming, TileBounds, TileOf,
};
use bevy_tessera::terrain::{Terrain, TerrainSettings};
use bevy_tessera::tile::{TILE_SAMPLES, TileAddress, TileRange};
use streaming_support::World3;

const SIZE: [u32; 2] = [700, 500];
const SPACING_M: f32 = 2.0;
const EVERYTHING: TerrainRegion = TerrainRegion::EVERYTHING;

/// What was told of edits.
#[derive(Resource, Default, Debug)]
struct Heard {
    edited: Vec<TerrainEdited>,
    undone: Vec<u64>,
    redone: Vec<u64>,
    refused: Vec<String>,
}

struct Grounds {
    world: World3,
    terrain: Entity,
}

impl Grounds {
    /// A terrain of which only the root is resident.
    fn new() -> Self {
        Self::of(SIZE)
    }

    fn of(size: [u32; 2]) -> Self {
        let mut world = World3::new(size);
        world
            .app
            .init_resource::<Heard>()
            .add_observer(|event: On<TerrainEdited>, mut heard: ResMut<Heard>| {
                heard.edited.push(*event.event());
            })
            .add_observer(|event: On<TerrainEditUndone>, mut heard: ResMut<Heard>| {
                heard.undone.push(event.sequence);
            })
            .add_observer(|event: On<TerrainEditRedone>, mut heard: ResMut<Heard>| {
                heard.redone.push(event.sequence);
            })
            .add_observer(|event: On<TerrainEditRefused>, mut heard: ResMut<Heard>| {
                heard.refused.push(event.reason.clone());
            });
        let terrain = world.spawn(TerrainSettings {
            root_levels: 1,
            ..default()
        });
        world.settle(terrain);
        Self { world, terrain }
    }

    /// A terrain that is resident as a whole.
    fn whole() -> Self {
        let mut grounds = Self::new();
        grounds.pin(EVERYTHING);
        grounds
    }

    fn pin(&mut self, region: TerrainRegion) -> Entity {
        let pin = Terrain::wait_for(self.terrain, region);
        let pin = self.world.app.world_mut().spawn(pin).id();
        self.world.settle(self.terrain);
        pin
    }

    fn trigger<'a>(&mut self, event: impl Event<Trigger<'a>: Default>) {
        self.world.app.world_mut().trigger(event);
        // What observers have queued.
        self.world.app.world_mut().flush();
    }

    fn state(&self) -> &TerrainState {
        self.world.state(self.terrain)
    }

    fn log(&self) -> &EditLog {
        let edits = self.world.app.world().get::<TerrainEdits>(self.terrain);
        edits.and_then(TerrainEdits::log).expect("it has loaded")
    }

    fn heard(&self) -> &Heard {
        self.world.app.world().resource::<Heard>()
    }

    fn hash(&self) -> u128 {
        let hash = self.state().ground_hash(&EVERYTHING);
        hash.expect("all of it is resident")
    }

    fn height(&mut self, x: f32, z: f32) -> f64 {
        let mut state = SystemState::<TerrainQuery>::new(self.world.app.world_mut());
        let query = state.get(self.world.app.world()).expect("valid");
        let at_m = DVec2::new(x.into(), z.into());
        let height = query.height(self.terrain, at_m);
        height.expect("on the terrain").height_m
    }
}

/// Numbers that look random.
struct Draw(u32);

impl Draw {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.0 >> 8) as f32 / (1 << 24) as f32
    }

    fn place(&mut self) -> Vec3 {
        // Some beyond the edge.
        let x = (self.next() * 1.04 - 0.02) * (SIZE[0] - 1) as f32 * SPACING_M;
        let z = (self.next() * 1.04 - 0.02) * (SIZE[1] - 1) as f32 * SPACING_M;
        Vec3::new(x, 100.0, z)
    }

    fn image(&mut self) -> StampImage {
        let samples = (0..64).map(|_| ((self.next() - 0.5) * 65_534.0) as i16);
        StampImage {
            side: 8,
            samples: samples.collect(),
        }
    }

    /// Makes one of all kinds of edits.
    fn edit(&mut self, grounds: &mut Grounds) {
        let at = self.place();
        let size = 2.0 + 30.0 * self.next() * self.next();
        match (self.next() * 8.0) as u32 {
            0 => grounds.trigger(Raise {
                radius_m: size,
                by_m: 6.0 * self.next() - 3.0,
                hardness: self.next(),
                ..Raise::at(at)
            }),
            1 => grounds.trigger(Flatten {
                radius_m: size,
                strength: self.next(),
                ..Flatten::at(at.with_y(40.0 + 60.0 * self.next()))
            }),
            2 => grounds.trigger(Smooth {
                radius_m: 2.0 * size,
                ..Smooth::at(at)
            }),
            3 => {
                let image = self.image();
                grounds.trigger(Stamp {
                    side_m: size,
                    turn: 6.0 * self.next(),
                    ..Stamp::at(at, image)
                });
            }
            _ => {
                let seed = (self.next() * 1e6) as u32;
                grounds.trigger(Crater::at(at).radius(size).rough(self.next(), seed));
            }
        }
    }
}

#[test]
fn a_crater_is_there_when_its_trigger_returns() {
    let mut grounds = Grounds::whole();
    let (x, z) = (511.0, 333.0);
    let before = grounds.height(x, z);
    let elsewhere = grounds.height(x + 60.0, z);
    let version = grounds.state().pages_version();
    grounds.trigger(
        Crater::at(Vec3::new(x, 0.0, z))
            .radius(16.0)
            .depth(5.0)
            .rim(2.0),
    );
    let after = grounds.height(x, z);
    assert!((before - after - 5.0).abs() < 0.5, "{before} to {after}");
    assert_eq!(grounds.height(x + 60.0, z), elsewhere);
    // Somewhere on the rim it is higher.
    let rim = (0..32).any(|step| {
        let (sin, cos) = (step as f32 * 0.196).sin_cos();
        let place = (x + 18.0 * cos, z + 18.0 * sin);
        let stored = streaming_support::stored_height(
            (place.0 / SPACING_M) as u32,
            (place.1 / SPACING_M) as u32,
        );
        grounds.height(place.0, place.1) > f64::from(stored) * 0.01 - 100.0 + 1.0
    });
    assert!(rim, "no rim");
    assert_ne!(grounds.state().pages_version(), version, "it is drawn");
    let [edited] = grounds.heard().edited[..] else {
        panic!("{:?}", grounds.heard());
    };
    assert_eq!((edited.entity, edited.sequence), (grounds.terrain, 1));
    assert!(!edited.clamped);
    assert!(edited.region.min_m.x < x - 16.0 && edited.region.max_m.y > z + 16.0);
    grounds.world.frame();
}

#[test]
fn ground_that_comes_later_is_as_if_it_had_been_there() {
    let mut there = Grounds::whole();
    let mut late = Grounds::new();
    let mut draws = [Draw(7), Draw(7)];
    for number in 0..60 {
        draws[0].edit(&mut there);
        draws[1].edit(&mut late);
        if number % 12 == 0 {
            // Some of it comes, and some of it goes again, while edits are made.
            let at = Vec2::new(100.0 * (number / 10) as f32, 300.0);
            let pin = late.pin(TerrainRegion::around(at, 200.0));
            there.world.frame();
            if number % 24 == 0 {
                late.world.app.world_mut().despawn(pin);
                late.world.frame();
            }
        }
    }
    // Smoothing captures what it sees, so the edits themselves may differ; made the same, they are.
    let diff = there.log().diff(0);
    let mut late = Grounds::new();
    late.trigger(MergeEdits {
        terrain: None,
        diff,
    });
    assert!(late.log() == there.log());
    for (x, z) in [(900.0, 500.0), (100.0, 900.0), (500.0, 100.0)] {
        late.pin(TerrainRegion::around(Vec2::new(x, z), 150.0));
    }
    late.pin(EVERYTHING);
    assert!(there.heard().edited.len() > 40);
    assert_eq!(late.hash(), there.hash());
    assert_eq!(there.heard().edited.len(), there.log().len());
}

#[test]
fn edits_made_while_tiles_are_on_their_way_are_in_them() {
    let mut there = Grounds::whole();
    let mut late = Grounds::new();
    let pin = Terrain::wait_for(late.terrain, EVERYTHING);
    late.world.app.world_mut().spawn(pin);
    for number in 0..50 {
        let at = Vec3::new(20.0 + 27.0 * number as f32, 0.0, 500.0);
        for grounds in [&mut there, &mut late] {
            grounds.trigger(Crater::at(at).radius(20.0));
            if number % 7 == 3 {
                grounds.trigger(UndoEdit::default());
            }
            grounds.world.frame();
        }
    }
    late.world.settle(late.terrain);
    assert_eq!(late.hash(), there.hash());
    assert!(late.log() == there.log());
}

#[test]
fn undo_restores_the_bytes_and_redo_the_edits() {
    let mut grounds = Grounds::whole();
    let baked = grounds.hash();
    let mut draw = Draw(3);
    let mut hashes = vec![baked];
    while hashes.len() < 25 {
        let known = grounds.log().len();
        draw.edit(&mut grounds);
        if grounds.log().len() > known {
            hashes.push(grounds.hash());
        }
    }
    let edited = hashes.clone();
    while let Some(wanted) = hashes.pop() {
        assert_eq!(grounds.hash(), wanted);
        if !hashes.is_empty() {
            grounds.trigger(UndoEdit::default());
        }
    }
    let ranges = |grounds: &Grounds| {
        let index = &grounds.state().ground_bounds().index;
        index.iter().collect::<Vec<_>>()
    };
    let index: Vec<_> = grounds.state().manifest().index.iter().collect();
    assert_eq!(ranges(&grounds), index, "bounds are the baked ones again");
    let refused = grounds.heard().refused.len();
    grounds.trigger(UndoEdit::default());
    let heard = &grounds.heard().refused;
    assert_eq!(heard.len(), refused + 1, "{heard:?}");
    assert!(heard[refused].contains("no edit left"), "{heard:?}");
    for wanted in &edited[1..] {
        grounds.trigger(RedoEdit::default());
        assert_eq!(grounds.hash(), *wanted);
    }
    // In the middle, and again.
    for sequence in [3, 11, 17] {
        grounds.trigger(UndoEdit {
            sequence: Some(sequence),
            ..default()
        });
        assert_ne!(Some(&grounds.hash()), edited.last());
    }
    for sequence in [17, 3, 11] {
        grounds.trigger(RedoEdit {
            sequence: Some(sequence),
            ..default()
        });
    }
    assert_eq!(Some(&grounds.hash()), edited.last());
    assert_eq!(grounds.heard().undone.len(), 24 + 3);
    assert_eq!(grounds.heard().redone.len(), 24 + 3);
    grounds.world.frame();
}

#[test]
fn a_late_joiner_has_the_same_ground() {
    let mut server = Grounds::whole();
    let mut client = Grounds::whole();
    let mut draw = Draw(99);
    for round in 0..6 {
        for _ in 0..5 {
            draw.edit(&mut server);
        }
        if round % 2 == 1 {
            server.trigger(UndoEdit {
                sequence: Some(3 * round),
                ..default()
            });
        }
        if round == 3 {
            server.trigger(RedoEdit {
                sequence: Some(3),
                ..default()
            });
        }
        if round == 2 || round == 3 || round == 5 {
            let diff = server.log().diff(client.log().last_sequence());
            client.trigger(MergeEdits {
                terrain: None,
                diff,
            });
            assert_eq!(client.hash(), server.hash(), "round {round}");
        }
    }
    assert!(client.heard().refused.is_empty(), "{:?}", client.heard());
    // A log that was loaded takes the place of another.
    let log = server.log().clone();
    let mut other = Grounds::whole();
    other.trigger(Crater::at(Vec3::new(300.0, 0.0, 300.0)));
    let terrain = other.terrain;
    let edits = TerrainEdits::new(log);
    other
        .world
        .app
        .world_mut()
        .entity_mut(terrain)
        .insert(edits);
    other.world.frame();
    assert_eq!(other.hash(), server.hash());
}

#[test]
fn neighbours_agree_on_their_borders_after_any_edits() {
    let mut grounds = Grounds::whole();
    let mut draw = Draw(1234);
    for _ in 0..40 {
        draw.edit(&mut grounds);
    }
    // On a corner of four tiles, and on the terrain's.
    let tile_m = TILE_SAMPLES as f32 * SPACING_M;
    for at in [[tile_m; 2], [0.0; 2], [1398.0, 998.0], [2.0 * tile_m, 0.0]] {
        grounds.trigger(Crater::at(Vec3::new(at[0], 0.0, at[1])).radius(25.0));
    }
    let state = grounds.state();
    for level in 0..state.manifest().file.levels {
        let [across, down] = state.manifest().file.tiles(level);
        for (x, z) in (0..down).flat_map(|z| (0..across).map(move |x| (x, z))) {
            let tile = |x, z| state.tile_data(TileAddress::new(level, x, z));
            let own = tile(x, z).expect("resident");
            if let Some(east) = tile(x + 1, z) {
                for (column, row) in (-2..=2).flat_map(|x| (-2..=130).map(move |z| (x, z))) {
                    let here = own.heights.get(column + 128, row);
                    assert_eq!(here, east.heights.get(column, row), "{level} {x} {z}");
                }
            }
            if let Some(south) = tile(x, z + 1) {
                for (column, row) in (-2..=130).flat_map(|x| (-2..=2).map(move |z| (x, z))) {
                    let here = own.heights.get(column, row + 128);
                    assert_eq!(here, south.heights.get(column, row), "{level} {x} {z}");
                }
            }
        }
    }
}

#[test]
fn bounds_follow_the_ground() {
    let mut grounds = Grounds::whole();
    let mut draw = Draw(5);
    for _ in 0..20 {
        draw.edit(&mut grounds);
        grounds.world.frame();
    }
    grounds.trigger(Raise {
        radius_m: 30.0,
        by_m: -100.0,
        ..Raise::at(Vec3::new(400.0, 0.0, 300.0))
    });
    grounds.world.frame();
    let state = grounds.state();
    for (address, baked) in state.manifest().index.iter() {
        let own = state.tile_data(address).expect("resident").heights.range();
        let bounds = state.ground_range(address).expect("stored");
        assert!(bounds.covers(own), "{address}");
        let children = address.children().into_iter().flatten();
        let below = children.filter_map(|child| state.ground_range(child));
        let exact = below.fold(own, TileRange::union);
        // Where nothing was changed, a parent's range is what the index has.
        assert!(bounds == exact || bounds == exact.union(baked), "{address}");
    }
    assert_ne!(
        state.ground_range(state.root()),
        state.manifest().index.get(state.root()),
        "some crater is below all that was baked"
    );
    let bounds = state.ground_bounds().clone();
    let file = bounds.file.clone();
    let world = grounds.world.app.world_mut();
    let mut tiles = world.query_filtered::<(&TileAddress, &TileBounds), With<TileOf>>();
    for (address, shown) in tiles.iter(world) {
        let range = bounds.index.get(*address).expect("stored");
        assert_eq!(*shown, TileBounds::new(&file, *address, range), "{address}");
    }
}

#[test]
fn what_cannot_be_is_refused_and_says_why() {
    let mut grounds = Grounds::whole();
    let baked = grounds.hash();
    let middle = Vec3::new(700.0, 0.0, 500.0);
    let mut refused = 0;
    for (crater, words) in [
        (
            Crater::at(middle).radius(f32::NAN),
            "Crater::radius_m is NaN",
        ),
        (
            Crater {
                radius_m: 0.0,
                ..Crater::at(middle)
            },
            "use a number above 0",
        ),
        (
            Crater {
                radius_m: -3.0,
                ..Crater::at(middle)
            },
            "Crater::radius_m is -3",
        ),
        (
            Crater {
                radius_m: 1e30,
                ..Crater::at(middle)
            },
            "is the most",
        ),
        (
            Crater {
                radius_m: f32::INFINITY,
                ..Crater::at(middle)
            },
            "above 0",
        ),
        (
            Crater {
                depth_m: -1.0,
                ..Crater::at(middle)
            },
            "Raise makes hills",
        ),
        (
            Crater {
                depth_m: f32::NAN,
                ..Crater::at(middle)
            },
            "Crater::depth_m is NaN",
        ),
        (
            Crater {
                roughness: f32::NAN,
                ..Crater::at(middle)
            },
            "from 0 to 1",
        ),
        (
            Crater {
                density_per_m: f32::NAN,
                ..Crater::at(middle)
            },
            "density_per_m",
        ),
        (Crater::at(Vec3::NAN), "use a place in the world"),
        (
            Crater::at(Vec3::new(-500.0, 0.0, 100.0)),
            "beyond the terrain",
        ),
        (
            Crater::at(Vec3::new(1e30, 0.0, 100.0)),
            "beyond the terrain",
        ),
        (
            Crater::at(middle).on(Entity::PLACEHOLDER),
            "meets no terrain",
        ),
    ] {
        grounds.trigger(crater.clone());
        refused += 1;
        let heard = &grounds.heard().refused;
        assert_eq!(heard.len(), refused, "{crater:?}");
        assert!(heard[refused - 1].contains(words), "{:?}", heard.last());
    }
    assert_eq!(grounds.hash(), baked);
    assert!(grounds.log().is_empty());
    // A tiny one becomes a small one, and one that only reaches over the edge is one.
    grounds.trigger(Crater {
        radius_m: 1e-3,
        ..Crater::at(middle)
    });
    grounds.trigger(Crater::at(Vec3::new(-3.0, 0.0, 100.0)).radius(8.0));
    assert_eq!(grounds.log().len(), 2);
    assert_eq!(grounds.heard().refused.len(), refused);
}

#[test]
fn ground_is_cut_off_at_the_ends_of_its_range_and_says_so() {
    let mut grounds = Grounds::whole();
    let at = Vec3::new(700.0, 0.0, 500.0);
    for _ in 0..8 {
        grounds.trigger(Crater::at(at).radius(30.0).depth(120.0));
    }
    let clamped: Vec<_> = grounds
        .heard()
        .edited
        .iter()
        .map(|edit| edit.clamped)
        .collect();
    assert!(!clamped[0] && clamped[7], "{clamped:?}");
    assert!((grounds.height(700.0, 500.0) + 100.0).abs() < 0.02);
    grounds.trigger(Raise {
        radius_m: 60.0,
        by_m: 1e6,
        ..Raise::at(at)
    });
    let top = -100.0 + 0.01 * f64::from(u16::MAX);
    assert!((grounds.height(700.0, 500.0) - top).abs() < 0.02);
    assert!(
        grounds
            .heard()
            .edited
            .last()
            .is_some_and(|edit| edit.clamped)
    );
    assert!(grounds.heard().refused.is_empty());
}

#[test]
fn a_terrain_that_is_moved_turned_and_scaled_is_hit_where_the_world_says() {
    let mut grounds = Grounds::whole();
    let transform = Transform::from_xyz(5000.0, 300.0, -2000.0)
        .with_rotation(Quat::from_rotation_y(0.7))
        .with_scale(Vec3::splat(3.0));
    let terrain = grounds.terrain;
    let world = grounds.world.app.world_mut();
    world.entity_mut(terrain).insert(transform);
    grounds.world.frame();
    let local = Vec3::new(511.0, 0.0, 333.0);
    let before = grounds.height(local.x, local.z);
    let at = transform.transform_point(local);
    grounds.trigger(Crater::at(at).radius(48.0).depth(15.0));
    let after = grounds.height(local.x, local.z);
    assert!((before - after - 5.0).abs() < 0.5, "{before} to {after}");
    let [edited] = grounds.heard().edited[..] else {
        panic!("{:?}", grounds.heard());
    };
    let middle = (edited.region.min_m + edited.region.max_m) / 2.0;
    assert!((middle - local.xz()).length() < 3.0, "{edited:?}");
    let reach = (edited.region.max_m - edited.region.min_m).x / 2.0;
    assert!((16.0..32.0).contains(&reach), "{edited:?}");
}

#[test]
fn smoothing_smooths_and_flattening_flattens() {
    let mut grounds = Grounds::whole();
    let (x, z) = (600.0, 400.0);
    let rough = |grounds: &mut Grounds| {
        let mut sum = 0.0;
        for step in -6..6 {
            let at = x + 2.0 * step as f32;
            let bend = grounds.height(at - 2.0, z) - 2.0 * grounds.height(at, z)
                + grounds.height(at + 2.0, z);
            sum += bend.abs();
        }
        sum
    };
    let image = Draw(4).image();
    grounds.trigger(Stamp {
        side_m: 20.0,
        by_m: 4.0,
        ..Stamp::at(Vec3::new(x, 0.0, z), image)
    });
    let before = rough(&mut grounds);
    grounds.trigger(Smooth {
        radius_m: 60.0,
        ..Smooth::at(Vec3::new(x, 0.0, z))
    });
    let smooth = rough(&mut grounds);
    assert!(smooth < 0.6 * before, "{before} to {smooth}");
    let level = Vec3::new(x, 77.0, z);
    grounds.trigger(Flatten {
        radius_m: 60.0,
        hardness: 0.5,
        ..Flatten::at(level)
    });
    for step in -10..=10 {
        let height = grounds.height(x + 2.0 * step as f32, z);
        assert!((height - 77.0).abs() < 0.011, "{height} at {step}");
    }
}

#[test]
fn pins_do_not_hold_what_edits_need() {
    // A tile that goes and comes again has its edits.
    let mut grounds = Grounds::new();
    let region = TerrainRegion::around(Vec2::new(600.0, 400.0), 50.0);
    let pin = grounds.pin(region);
    grounds.trigger(Crater::at(Vec3::new(600.0, 0.0, 400.0)).radius(20.0));
    let dug = grounds.height(600.0, 400.0);
    let hash = grounds.state().ground_hash(&region);
    assert!(hash.is_some());
    let world = grounds.world.app.world_mut();
    world.despawn(pin);
    // As many pages as another place needs.
    world.resource_mut::<TerrainStreaming>().page_bytes = 7 * PAGE_BYTES;
    let elsewhere = grounds.pin(TerrainRegion::around(Vec2::new(1200.0, 800.0), 150.0));
    assert_eq!(grounds.state().ground_hash(&region), None, "it has gone");
    grounds.world.app.world_mut().despawn(elsewhere);
    let world = grounds.world.app.world_mut();
    *world.resource_mut() = TerrainStreaming::default();
    let pin = TerrainPin {
        terrain: grounds.terrain,
        region,
        finest_level: 0,
    };
    grounds.world.app.world_mut().spawn(pin);
    grounds.world.settle(grounds.terrain);
    assert_eq!(grounds.state().ground_hash(&region), hash);
    assert_eq!(grounds.height(600.0, 400.0), dug);
}

#[test]
fn what_many_edits_made_of_a_tile_is_kept_and_is_the_same_as_making_it_again() {
    let mut grounds = Grounds::new();
    let region = TerrainRegion::around(Vec2::new(600.0, 400.0), 50.0);
    let pin = grounds.pin(region);
    let mut draw = Draw(8);
    for _ in 0..300 {
        let at = Vec3::new(570.0 + 60.0 * draw.next(), 0.0, 370.0 + 60.0 * draw.next());
        grounds.trigger(Crater::at(at).radius(2.0 + 6.0 * draw.next()));
    }
    for _ in 0..400 {
        grounds.world.frame();
        if !grounds.log().snapshots().is_empty() {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    let hash = grounds.state().ground_hash(&region).expect("resident");
    // Gone and come again, from its snapshot and what came after it.
    let world = grounds.world.app.world_mut();
    world.despawn(pin);
    world.resource_mut::<TerrainStreaming>().page_bytes = 7 * PAGE_BYTES;
    let elsewhere = grounds.pin(TerrainRegion::around(Vec2::new(1200.0, 800.0), 150.0));
    assert_eq!(grounds.state().ground_hash(&region), None, "it has gone");
    for _ in 0..100 {
        grounds.world.frame();
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    let snapshots: Vec<_> = grounds.log().snapshots().into_iter().cloned().collect();
    let of_finest = |level| {
        snapshots
            .iter()
            .any(|snapshot| snapshot.address.level == level)
    };
    assert!(of_finest(0), "{} snapshots", snapshots.len());
    assert!(snapshots.iter().all(|snapshot| snapshot.sequence <= 300));
    let world = grounds.world.app.world_mut();
    world.despawn(elsewhere);
    *world.resource_mut() = TerrainStreaming::default();
    grounds.pin(region);
    assert_eq!(grounds.state().ground_hash(&region), Some(hash));
    // A log without snapshots makes the same of it, and so does one that was saved with them.
    let saved = EditLog::decode(&grounds.log().encode()).expect("just encoded");
    assert!(!saved.snapshots().is_empty());
    let bare = EditLog::from_ron(&grounds.log().to_ron()).expect("just written");
    assert!(bare.snapshots().is_empty());
    for log in [saved, bare] {
        let mut other = Grounds::new();
        let terrain = other.terrain;
        let edits = TerrainEdits::new(log);
        other
            .world
            .app
            .world_mut()
            .entity_mut(terrain)
            .insert(edits);
        other.world.frame();
        other.pin(region);
        assert_eq!(other.state().ground_hash(&region), Some(hash));
        // What a snapshot holds can be taken back.
        other.trigger(UndoEdit {
            sequence: Some(1),
            ..default()
        });
        assert_ne!(other.state().ground_hash(&region), Some(hash));
        other.trigger(RedoEdit::default());
        assert_eq!(other.state().ground_hash(&region), Some(hash));
    }
    // A damaged one is made again.
    let mut damaged = grounds.log().clone();
    for snapshot in snapshots {
        damaged.remove_snapshot(snapshot.address);
        let bytes = snapshot.bytes[..snapshot.bytes.len() / 2].into();
        assert!(damaged.keep_snapshot(bevy_tessera::edit::TileSnapshot { bytes, ..snapshot }));
    }
    let mut other = Grounds::new();
    let terrain = other.terrain;
    let edits = TerrainEdits::new(damaged);
    other
        .world
        .app
        .world_mut()
        .entity_mut(terrain)
        .insert(edits);
    other.world.frame();
    other.pin(region);
    assert_eq!(other.state().ground_hash(&region), Some(hash));
}
