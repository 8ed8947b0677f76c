//! What is drawn of ground that is being blown to pieces is what the CPU says of it: the pages on
//! the GPU hold the tiles' bytes, the mesh stays watertight, and queries and colliders agree with it.

mod common;

use bevy::camera::primitives::Frustum;
use bevy::ecs::system::SystemState;
use bevy::math::primitives::ViewFrustum;
use bevy::math::{DVec2, DVec3};
use bevy::prelude::*;
use bevy::render::settings::WgpuSettings;
use bevy::time::TimeUpdateStrategy;
use bevy_tessera::bake::{BakeSettings, MemorySource, bake};
use bevy_tessera::edit::{
    Crater, Flatten, Raise, RedoEdit, Smooth, Stamp, StampImage, TerrainEdits, UndoEdit,
};
use bevy_tessera::lattice::{Node, NodeBounds};
use bevy_tessera::physics::{TerrainColliderPin, TerrainColliders};
use bevy_tessera::query::TerrainQuery;
use bevy_tessera::render::{NodeCulling, TerrainNodes};
use bevy_tessera::stream::{TerrainRegion, TerrainStreaming, TerrainTiles};
use bevy_tessera::terrain::{Terrain, TerrainCamera, TerrainSettings, TessellationPolicy};
use bevy_tessera::tessellate::{Partitioning, height};
use bevy_tessera::tile::{TILE_SAMPLES, TileAddress};
use bevy_tessera::view::TerrainViews;
use common::app;
use common::flight::FRAMES_PER_S;
use common::gpu::{Culled, Kernels, ReadBack};
use common::random::Random;
use common::virtual_source::{Outcome, VirtualSource};
use common::{manifold, page_textures};
use std::collections::HashSet;
use std::path::Path;
use std::sync::LazyLock;
use std::time::Duration;
use tempfile::TempDir;

/// Samples, a metre apart: 101 tiles, those at the rim cut off.
const SIZE: [u32; 2] = [1101, 901];
/// Heights that can be stored; the ground as it is baked lies between 60 m and 140 m.
const HEIGHTS_M: [f64; 2] = [-250.0, 600.0];
const MANIFEST: &str = "ground/terrain.ron";

/// Rolling ground with stones on it, baked once.
fn assets() -> &'static Path {
    static FOLDER: LazyLock<TempDir> = LazyLock::new(|| {
        let folder = tempfile::tempdir().unwrap();
        let heights = (0..SIZE[0] * SIZE[1])
            .map(|at| {
                let (x, z) = ((at % SIZE[0]) as f32, (at / SIZE[0]) as f32);
                let stone = (at.wrapping_mul(0x9e37_79b1) >> 24) as f32 / 512.0;
                100.0 + 30.0 * (x / 97.0).sin() * (z / 71.0).cos() + 4.0 * (x / 17.0).sin() + stone
            })
            .collect();
        let mut source = MemorySource::new(SIZE, heights).unwrap();
        let settings = BakeSettings {
            spacing_m: Some(1.0),
            height_range_m: Some(HEIGHTS_M[0]..=HEIGHTS_M[1]),
            ..default()
        };
        bake(&mut source, &folder.path().join("ground"), &settings, &()).unwrap();
        folder
    });
    FOLDER.path()
}

/// An app that draws the ground, and what changes it.
struct Field {
    kernels: Kernels,
    frames: u32,
}

impl Field {
    /// In an app that hasn't been finished.
    fn new(mut app: App, manifest: &'static str, picture: UVec2) -> Self {
        let frame = Duration::from_secs(1) / FRAMES_PER_S;
        app.insert_resource(TimeUpdateStrategy::ManualDuration(frame));
        let kernels = Kernels::start_in(app, manifest, TerrainSettings::default(), picture);
        assert!(kernels.state().is_ready(), "the root has come");
        Self { kernels, frames: 0 }
    }

    fn trigger<'a>(&mut self, event: impl Event<Trigger<'a>: Default>) {
        let world = self.kernels.app.world_mut();
        world.trigger(event);
        // What observers have queued.
        world.flush();
    }

    fn ground_m(&self, at: Vec2) -> f64 {
        let height = self.kernels.state().height(at.as_dvec2());
        height.expect("on the terrain").height_m
    }

    fn edit_count(&self) -> usize {
        let world = self.kernels.app.world();
        let edits = world.get::<TerrainEdits>(self.kernels.terrain);
        edits.and_then(TerrainEdits::log).expect("it has one").len()
    }

    fn resident(&self) -> HashSet<TileAddress> {
        let world = self.kernels.app.world();
        let tiles = world.get::<TerrainTiles>(self.kernels.terrain).unwrap();
        tiles.iter().map(|tile| *world.get(tile).unwrap()).collect()
    }

    /// Draws a frame and checks that it is whole, and that it is drawn from what the tiles hold.
    fn frame(&mut self) -> ReadBack {
        self.frames += 1;
        let frame = self.kernels.frame();
        let state = self.kernels.state();
        if let Err(broken) = state.validate() {
            panic!("frame {}: {broken}", self.frames);
        }
        if let Err(wrong) = manifold::check(
            state.lattice(),
            &frame.vertices,
            &frame.triangles,
            frame.settings.partitioning,
        ) {
            panic!("frame {}: {wrong}", self.frames);
        }
        self.check_pages();
        let faces_a_node = 1 << (2 * frame.lattice.faces_log2);
        let faces: Vec<_> = frame
            .nodes
            .iter()
            .flat_map(|node| (0..faces_a_node).map(|face| (*node, face)))
            .collect();
        let twin = frame.twin().build_with(&faces, frame.factors.clone());
        assert_eq!(twin.triangles, frame.triangles, "frame {}", self.frames);
        assert_eq!(twin.vertices.len(), frame.vertices.len());
        let half_a_step_m = 0.5 * frame.height_step_m;
        for (cpu, gpu) in twin.vertices.iter().zip(&frame.vertices) {
            assert_eq!((cpu.point, cpu.lambda), (gpu.point, gpu.lambda));
            assert!(
                (cpu.height_m - gpu.height_m).abs() <= half_a_step_m,
                "frame {}: {gpu:?} stands at {} m",
                self.frames,
                cpu.height_m
            );
        }
        frame
    }

    /// Checks that the pages on the GPU are the tiles.
    fn check_pages(&self) {
        let checked = page_textures::check(&self.kernels)
            .unwrap_or_else(|wrong| panic!("frame {}: {wrong}", self.frames));
        assert_eq!(checked, self.kernels.state().resident_count());
    }

    /// Draws a frame and checks the pages alone.
    fn pass(&mut self) -> ReadBack {
        self.frames += 1;
        let frame = self.kernels.frame();
        self.check_pages();
        frame
    }
}

/// Makes one edit of any kind, near `eye` more often than elsewhere.
fn edit_anywhere(field: &mut Field, random: &mut Random, eye: Vec2) {
    let last = Vec2::new((SIZE[0] - 1) as f32, (SIZE[1] - 1) as f32);
    let anywhere = Vec2::new(random.unit(), random.unit()) * last;
    let near = eye + 240.0 * Vec2::new(random.unit() - 0.5, random.unit() - 0.5);
    let tile_m = TILE_SAMPLES as f32;
    let place = match random.below(8) {
        0 => anywhere,
        // On a border, a corner, the rim, and a corner of the rim.
        1 => Vec2::new((near.x / tile_m).round() * tile_m, near.y),
        2 => (near / tile_m).round() * tile_m,
        3 => Vec2::new(near.x, random.pick(&[0.0, last.y])),
        4 if random.below(4) == 0 => {
            Vec2::new(random.pick(&[0.0, last.x]), random.pick(&[0.0, last.y]))
        }
        _ => near,
    };
    let place = place.clamp(Vec2::ZERO, last);
    let at = Vec3::new(place.x, 100.0, place.y);
    let size = 1.0 + 30.0 * random.unit().powi(3);
    match random.below(8) {
        0 => field.trigger(Raise {
            radius_m: size,
            by_m: 12.0 * random.unit() - 6.0,
            hardness: random.unit(),
            ..Raise::at(at)
        }),
        1 => field.trigger(Flatten {
            radius_m: size,
            strength: random.unit(),
            ..Flatten::at(at.with_y(70.0 + 60.0 * random.unit()))
        }),
        2 => field.trigger(Smooth {
            radius_m: 2.0 * size,
            ..Smooth::at(at)
        }),
        3 => {
            let samples = (0..64).map(|_| (random.next() >> 48) as u16 as i16);
            let image = StampImage {
                side: 8,
                samples: samples.collect(),
            };
            field.trigger(Stamp {
                side_m: size,
                turn: 6.0 * random.unit(),
                ..Stamp::at(at, image)
            });
        }
        _ => {
            let seed = random.next() as u32;
            field.trigger(Crater::at(at).radius(size).rough(random.unit(), seed));
        }
    }
}

#[test]
fn a_thousand_craters_leave_the_drawn_mesh_watertight() {
    // Fewer pages than tiles; for a while a second layer of the atlas.
    const PAGES: u32 = 30;
    const MORE_PAGES: u32 = 90;
    // Reads take up to six frames, in any order.
    let source = VirtualSource::new(assets(), |path, before| {
        let drawn = crc32fast::hash(format!("{} {before}", path.display()).as_bytes());
        (u64::from(drawn % 7), Outcome::Good)
    });
    let (builder, ticker) = (source.builder(), source);
    let mut app = app::app_after(assets(), false, WgpuSettings::default(), |app| {
        app.register_asset_source("late", builder);
    });
    app.insert_resource(TerrainStreaming::with_pages(PAGES));
    // Reads end as frames do.
    app.add_systems(First, move || ticker.tick());
    let mut field = Field::new(app, "late://ground/terrain.ron", UVec2::new(48, 720));
    let mut random = Random(77);
    let (mut made, mut came, mut went, mut undone) = (0, 0, 0, 0);
    let mut n = 0;
    let mut resident = field.resident();
    while made < 1000 {
        if n % 25 == 24 {
            let pages = if n == 24 { MORE_PAGES } else { PAGES };
            field
                .kernels
                .app
                .insert_resource(TerrainStreaming::with_pages(pages));
        }
        // Slowly on, and now and then to another place.
        let starts = [[80.0, 100.0], [700.0, 640.0], [120.0, 700.0], [800.0, 90.0]];
        let along = 6.0 * (n % 16) as f32;
        let plane = Vec2::from(starts[n / 16 % starts.len()]) + Vec2::new(along, 0.5 * along);
        let ground = field.ground_m(plane) as f32;
        let eye = Transform::from_xyz(plane.x, ground + 12.0, plane.y)
            .looking_to(Vec3::new(0.8, -0.3, 0.5), Vec3::Y);
        let camera = TerrainCamera {
            triangle_width_px: 24.0,
            max_vertices: 1 << 18,
            partitioning: Partitioning::ALL[n / 5 % Partitioning::ALL.len()],
            policy: match n / 5 % 2 {
                0 => TessellationPolicy::TriangleWidth,
                _ => TessellationPolicy::ScreenError { max_px: 8.0 },
            },
            ..default()
        };
        field.kernels.set_camera(eye, camera);
        // In some frames more than a page remembers the parts of, in others a few.
        let count = random.pick(&[0, 1, 3, 8, 20, 40]);
        for _ in 0..count.min(1000 - made) {
            edit_anywhere(&mut field, &mut random, plane);
            made += 1;
        }
        if n % 4 == 3 {
            let newest = field.edit_count() as u64;
            let sequence = [None, Some(1 + random.next() % newest)];
            field.trigger(UndoEdit {
                sequence: sequence[n / 4 % 2],
                ..default()
            });
            undone += 1;
            // Some of them come again, some later than what is made in between.
            if n % 8 == 7 {
                edit_anywhere(&mut field, &mut random, plane);
                field.trigger(RedoEdit::default());
            }
        }
        if n % 5 == 0 {
            field.frame();
        } else {
            field.pass();
        }
        let now = field.resident();
        came += now.difference(&resident).count();
        went += resident.difference(&now).count();
        resident = now;
        n += 1;
    }
    println!("{n} frames, {came} tiles came and {went} went, {undone} edits were taken back");
    assert!(field.edit_count() >= 950, "most edits are good ones");
    assert!(came > 40 && went > 20, "{came} came, {went} went");
    // What comes when all is quiet has its craters, too.
    for _ in 0..40 {
        field.pass();
    }
    field.frame();
}

/// The ground on disk, all of it wanted, with an eye at `from` that looks at `to`.
fn still(from: Vec3, to: Vec3, triangle_px: f32, build: impl FnOnce(&mut App)) -> Field {
    let mut app = app::app(assets(), false);
    build(&mut app);
    let mut field = Field::new(app, MANIFEST, UVec2::new(48, 360));
    // What is wanted doesn't depend on the triangles.
    look(&mut field, from, to, 64.0);
    app::settle(&mut field.kernels.app, 2000);
    look(&mut field, from, to, triangle_px);
    field
}

fn look(field: &mut Field, from: Vec3, to: Vec3, triangle_px: f32) {
    let camera = TerrainCamera {
        triangle_width_px: triangle_px,
        density: 0.0,
        ..default()
    };
    let eye = Transform::from_translation(from).looking_at(to, Vec3::Y);
    field.kernels.set_camera(eye, camera);
}

/// The heights that are drawn within `radius_m` of a place.
fn drawn_around(frame: &ReadBack, at: Vec2, radius_m: f32) -> Vec<f32> {
    let unit_m = frame.factor_view.unit_m;
    let near = frame
        .vertices
        .iter()
        .filter(|vertex| (vertex.point.as_vec2() * unit_m - at).length() <= radius_m);
    near.map(|vertex| vertex.height_m).collect()
}

#[test]
fn a_crater_is_drawn_in_the_next_frame() {
    /// What a system makes of the frame in which it is there.
    #[derive(Resource)]
    struct Shell(Crater);

    let (first, second) = (Vec3::new(470.0, 0.0, 400.0), Vec3::new(520.0, 0.0, 384.0));
    let eye = Vec3::new(490.0, 150.0, 340.0);
    let mut field = still(eye, second.with_y(100.0), 4.0, |app| {
        app.add_systems(
            Update,
            |shell: Option<Res<Shell>>, mut commands: Commands| {
                if let Some(shell) = shell {
                    commands.trigger(shell.0.clone());
                    commands.remove_resource::<Shell>();
                }
            },
        );
    });
    let is_dug = |frame: &ReadBack, at: Vec3, before_m: f64, dug_m: f32| {
        let drawn = drawn_around(frame, at.xz(), 1.5);
        assert!(drawn.len() >= 4, "only {} vertices there", drawn.len());
        for height_m in drawn {
            let wanted = before_m as f32 - dug_m;
            assert!(
                (height_m - wanted).abs() < 1.0,
                "{height_m} and not {wanted}"
            );
        }
    };
    // Triggered before `App::update`: that very update draws it (with pipelined rendering its picture
    // is shown one update later, as everything is).
    let before_m = field.ground_m(first.xz());
    is_dug(&field.pass(), first, before_m, 0.0);
    field.trigger(Crater::at(first).radius(12.0).depth(9.0));
    is_dug(&field.pass(), first, before_m, 9.0);
    // So it does what a system in `Update` triggers in it.
    let before_m = field.ground_m(second.xz());
    is_dug(&field.pass(), second, before_m, 0.0);
    let shell = Shell(Crater::at(second).radius(12.0).depth(9.0));
    field.kernels.app.insert_resource(shell);
    is_dug(&field.pass(), second, before_m, 9.0);
    // And so it is with what is taken back.
    field.trigger(UndoEdit::default());
    is_dug(&field.pass(), second, before_m, 0.0);
    is_dug(&field.pass(), first, field.ground_m(first.xz()), 0.0);
}

#[cfg(feature = "avian")]
mod with_bodies {
    use super::*;
    use avian3d::prelude::*;
    use bevy::time::Fixed;

    /// Checks the ground in a square around `middle` at level 0: what is drawn, what queries say and
    /// what bodies collide with. Returns the most that two of them differ by, in metres.
    fn compare(field: &mut Field, middle: IVec2, reach: i32) -> f64 {
        let frame = field.pass();
        let terrain = field.kernels.terrain;
        let world = field.kernels.app.world_mut();
        let mut state = SystemState::<(SpatialQuery, TerrainQuery)>::new(world);
        let (rays, query) = state.get(world).expect("valid");
        let quantum_m = f64::from(frame.height_step_m);
        let unit = 1 << frame.lattice.unit_log2;
        let drawn_m = |point: IVec2| {
            let stored = height(&frame.pages, &frame.lattice, point, 0).expect("resident");
            f64::from(frame.height_min_m) + f64::from(stored) * quantum_m
        };
        let collider_m = |x: f64, z: f64| {
            let from = Vec3::new(x as f32, 700.0, z as f32);
            let filter = SpatialQueryFilter::default();
            let hit = rays.cast_ray(from, Dir3::NEG_Y, 2000.0, true, &filter);
            let hit = hit.unwrap_or_else(|| panic!("no ground below ({x}, {z})"));
            700.0 - f64::from(hit.distance)
        };
        let last = frame.lattice.extent / unit;
        let (low, high) = (middle - reach, middle + reach);
        let (low, high) = (low.max(IVec2::ZERO), high.min(last));
        let mut most = 0.0_f64;
        for z in low.y..=high.y {
            for x in low.x..=high.x {
                let at = DVec2::new(f64::from(x), f64::from(z));
                let drawn = drawn_m(IVec2::new(x, z) * unit);
                let asked = query.height(terrain, at).expect("on the terrain");
                assert_eq!(asked.level, 0);
                // A ray exactly between two triangles may pass both.
                let beside = (at + 1e-3).min(last.as_dvec2() - 1e-3);
                let met = collider_m(beside.x, beside.y);
                let all = [drawn, asked.height_m, met];
                let differs = all.iter().copied().fold(f64::MIN, f64::max)
                    - all.iter().copied().fold(f64::MAX, f64::min);
                assert!(differs <= quantum_m, "({x}, {z}): {all:?}");
                most = most.max(differs);
            }
        }
        // What the kernels have drawn at the finest level, wherever that is in the square.
        let unit_m = f64::from(frame.factor_view.unit_m);
        let mut vertices = 0;
        for vertex in frame.vertices.iter().filter(|vertex| vertex.lambda == 0) {
            let sample = vertex.point / unit;
            if sample.cmplt(low).any() || sample.cmpgt(high).any() {
                continue;
            }
            let at = vertex.point.as_dvec2() * unit_m;
            let asked = query.height(terrain, at).expect("on the terrain").height_m;
            let differs = (asked - f64::from(vertex.height_m)).abs();
            assert!(differs <= quantum_m, "{vertex:?}: {asked} m");
            most = most.max(differs);
            vertices += 1;
        }
        assert!(vertices > 200, "only {vertices} vertices to be compared");
        most
    }

    #[test]
    fn mesh_query_and_collider_agree_in_fresh_craters() {
        let corner = IVec2::new(512, 384);
        let rim = IVec2::new(1100, 640);
        let eye = Vec3::new(500.0, 145.0, 330.0);
        let middle = Vec3::new(512.0, 100.0, 384.0);
        let mut field = still(eye, middle, 64.0, |app| {
            // A physics step a frame.
            app.insert_resource(Time::<Fixed>::from_hz(f64::from(FRAMES_PER_S)))
                .add_plugins(PhysicsPlugins::default());
        });
        let terrain = field.kernels.terrain;
        let regions = [corner, rim].map(|at| TerrainRegion::around(at.as_vec2(), 70.0));
        for region in regions {
            let pin = (Terrain::wait_for(terrain, region), TerrainColliderPin);
            field.kernels.app.world_mut().spawn(pin);
        }
        let is_covered = |field: &Field| {
            let all = field.kernels.app.world().resource::<TerrainColliders>();
            regions.iter().all(|&region| all.covers(terrain, region))
        };
        for _ in 0..1000 {
            if is_covered(&field) {
                break;
            }
            field.kernels.app.update();
        }
        assert!(is_covered(&field), "the colliders are there");
        app::settle(&mut field.kernels.app, 2000);
        look(&mut field, eye, middle, 5.0);
        compare(&mut field, corner, 60);
        let baked = field.ground_m(corner.as_vec2());
        let mut random = Random(5);
        let mut worst = 0.0_f64;
        for round in 0..4 {
            for n in 0..6 {
                let away = 90.0 * Vec2::new(random.unit() - 0.5, random.unit() - 0.5);
                // The first on a corner of four tiles, and the second on the terrain's rim.
                let at = match n {
                    0 => corner.as_vec2(),
                    1 => rim.as_vec2(),
                    _ => corner.as_vec2() + away,
                };
                let crater = Crater::at(Vec3::new(at.x, 0.0, at.y));
                let crater = crater.radius(4.0 + 12.0 * random.unit());
                field.trigger(crater.rough(0.8, random.next() as u32));
            }
            // One frame, and one physics step in it.
            worst = worst.max(compare(&mut field, corner, 60));
            // The eye is elsewhere; what stands at the rim is drawn coarsely, and level 0 is pinned.
            if round == 1 {
                for sequence in [None, None, Some(3)] {
                    field.trigger(UndoEdit {
                        sequence,
                        ..default()
                    });
                }
                worst = worst.max(compare(&mut field, corner, 60));
                field.trigger(RedoEdit::default());
                worst = worst.max(compare(&mut field, corner, 60));
            }
        }
        assert!(field.ground_m(corner.as_vec2()) < baked - 5.0);
        let (eye, there) = (
            Vec3::new(1060.0, 150.0, 620.0),
            Vec3::new(1100.0, 90.0, 640.0),
        );
        look(&mut field, eye, there, 64.0);
        app::settle(&mut field.kernels.app, 2000);
        look(&mut field, eye, there, 5.0);
        worst = worst.max(compare(&mut field, rim, 60));
        while field.ground_m(corner.as_vec2()) != baked {
            field.trigger(UndoEdit::default());
        }
        worst = worst.max(compare(&mut field, rim, 60));
        println!("they differ by {worst} m at most");
    }
}

/// Checks that whatever isn't among the nodes that were drawn lies outside of the view, and that those
/// that were drawn lie within the heights that their faces were culled by. Returns how many there are
/// of both.
fn check_culling(field: &mut Field) -> [usize; 2] {
    let frame = field.kernels.frame();
    let world = field.kernels.app.world();
    let terrain = field.kernels.terrain;
    let view = *world
        .get::<TerrainViews>(field.kernels.camera)
        .unwrap()
        .of(terrain)
        .unwrap();
    let frustum = world.get::<Frustum>(field.kernels.camera).unwrap();
    let drawn = world.get::<TerrainNodes>(field.kernels.camera).unwrap();
    let NodeCulling { heights_m, .. } = &drawn.culling[&terrain];
    let twin = frame.twin();
    let unit_m = frame.lattice.unit_m(1.0);
    let half_a_step_m = 0.5 * frame.height_step_m;
    for (node, &[lowest, highest]) in frame.nodes.iter().zip(heights_m) {
        for vertex in twin.build(std::slice::from_ref(node)).vertices {
            let is_within = vertex.height_m >= lowest - half_a_step_m
                && vertex.height_m <= highest + half_a_step_m;
            assert!(is_within, "{vertex:?} of {node:?}: {lowest} to {highest} m");
        }
    }
    let seen: HashSet<_> = frame.nodes.iter().copied().collect();
    let mut all = Vec::new();
    let mut keep = |_: &Node, _: &NodeBounds| true;
    view.lod
        .select(&frame.lattice, &mut keep, &mut |node| all.push(node));
    let mut dropped = 0;
    for node in all.iter().filter(|node| !seen.contains(node)) {
        dropped += 1;
        let vertices: Vec<_> = twin
            .build(std::slice::from_ref(node))
            .vertices
            .iter()
            .map(|vertex| {
                let plane = vertex.point.as_dvec2() * unit_m;
                DVec3::new(plane.x, f64::from(vertex.height_m), plane.y)
            })
            .collect();
        // All on the outer side of one plane: then no triangle crosses the frustum either.
        let far = ViewFrustum::FAR_PLANE_IDX;
        let outside = frustum.half_spaces[..far].iter().any(|plane| {
            let plane = plane.normal_d().as_dvec4();
            vertices
                .iter()
                .all(|vertex| plane.truncate().dot(*vertex) + plane.w < 0.0)
        });
        assert!(outside, "{node:?} was dropped and may be seen");
    }
    [dropped, frame.nodes.len()]
}

fn node_count(field: &Field) -> usize {
    let world = field.kernels.app.world();
    let drawn = world.get::<TerrainNodes>(field.kernels.camera).unwrap();
    drawn.nodes.get(&field.kernels.terrain).map_or(0, Vec::len)
}

#[test]
fn culling_follows_craters() {
    // Level, far above all that is baked: nothing is seen.
    let eye = Vec3::new(100.0, 330.0, 450.0);
    let mut field = still(eye, eye + Vec3::X, 16.0, |app| {
        app.insert_resource(Culled);
    });
    let narrow = PerspectiveProjection {
        fov: 0.2,
        ..default()
    };
    let camera = field.kernels.camera;
    let mut entity = field.kernels.app.world_mut().entity_mut(camera);
    entity.insert(Projection::Perspective(narrow));
    field.kernels.app.update();
    assert_eq!(node_count(&field), 0, "the ground is below the view");
    // A mountain is seen in the frame in which it rises, and in none after it has gone.
    let summit = Vec3::new(700.0, 0.0, 450.0);
    let mountain = Raise {
        radius_m: 150.0,
        by_m: 350.0,
        ..Raise::at(summit)
    };
    field.trigger(mountain);
    let [_, drawn] = check_culling(&mut field);
    assert!(drawn > 0, "the mountain is culled by what was there before");
    field.trigger(UndoEdit::default());
    field.kernels.app.update();
    assert_eq!(node_count(&field), 0, "the bounds are the baked ones again");
    // The same below: up into the sky from a pit, whose walls are above the eye.
    let mut entity = field.kernels.app.world_mut().entity_mut(camera);
    entity.insert(Projection::default());
    let mut random = Random(31);
    let (mut dropped, mut kept) = (0, 0);
    for n in 0..60 {
        let place = Vec3::new(
            random.unit() * (SIZE[0] - 1) as f32,
            100.0,
            random.unit() * (SIZE[1] - 1) as f32,
        );
        let by_m = random.pick(&[-320.0, -150.0, 5.0, 200.0, 450.0]);
        let radius_m = 8.0 + 120.0 * random.unit();
        field.trigger(Raise {
            radius_m,
            by_m,
            ..Raise::at(place)
        });
        if n % 5 == 4 {
            let sequence = 1 + random.next() % field.edit_count() as u64;
            field.trigger(UndoEdit {
                sequence: (n % 2 == 0).then_some(sequence),
                ..default()
            });
        }
        // What has changed is looked at from within, from beside it, or from far off.
        let ground_m = field.ground_m(place.xz()) as f32;
        let target = place.with_y(ground_m);
        let away = Vec3::new(
            random.unit() - 0.5,
            0.3 * random.unit(),
            random.unit() - 0.5,
        );
        let eye = target + away * random.pick(&[20.0, 200.0, 900.0]) + Vec3::Y * 3.0;
        look(&mut field, eye, target, 16.0);
        let [out, within] = check_culling(&mut field);
        dropped += out;
        kept += within;
    }
    assert!(dropped > 100, "only {dropped} nodes were dropped at all");
    assert!(kept > 100, "only {kept} nodes were kept at all");
}
