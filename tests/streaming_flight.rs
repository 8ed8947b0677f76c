//! Flying over a terrain that is far larger than the memory, with tiles that come late, damaged or
//! not at all: every frame is watertight, reads nothing that isn't there, and nothing jumps.

mod common;

use bevy::prelude::*;
use bevy::render::settings::WgpuSettings;
use bevy::time::TimeUpdateStrategy;
use bevy_tessera::stream::{TerrainState, TerrainStreamer, TerrainStreaming};
use bevy_tessera::terrain::{Terrain, TerrainCamera, TerrainSettings};
use bevy_tessera::tessellate::height;
use common::app;
use common::flight::{FRAMES_PER_S, SIDE, drawn, hills, rough_weather};
use common::gpu::{Kernels, ReadBack};
use common::manifold;
use common::virtual_source::VirtualSource;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// A twentieth of the terrain's tiles.
const PAGES: u32 = 68;
/// As high as a screen, so that pixels are as large, and narrow, so that they are few.
const PICTURE: UVec2 = UVec2::new(48, 720);

/// Memory is measured of the process, in which tests would otherwise run side by side.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

fn alone() -> MutexGuard<'static, ()> {
    ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner)
}

struct Flight {
    kernels: Kernels,
    source: VirtualSource,
    frames: u32,
}

impl Flight {
    fn new(pages: u32, picture: UVec2) -> Self {
        let source = rough_weather(hills());
        let builder = source.builder();
        let mut app = app::app_after(hills(), false, WgpuSettings::default(), |app| {
            app.register_asset_source("late", builder);
        });
        let frame = Duration::from_secs(1) / FRAMES_PER_S;
        app.insert_resource(TimeUpdateStrategy::ManualDuration(frame))
            .insert_resource(TerrainStreaming {
                retry_s: 0.5,
                ..TerrainStreaming::with_pages(pages)
            });
        let ticker = source.clone();
        // Reads end as frames do.
        app.add_systems(First, move || ticker.tick());
        let settings = TerrainSettings::default();
        let kernels = Kernels::start_in(app, "late://hills/terrain.ron", settings, picture);
        assert!(kernels.state().is_ready(), "the root has come");
        Self {
            kernels,
            source,
            frames: 0,
        }
    }

    fn streamer(&self) -> &TerrainStreamer {
        self.kernels.app.world().resource()
    }

    fn place(&mut self, eye: Transform) {
        // Coarse triangles: what tiles do doesn't depend on them.
        let camera = TerrainCamera {
            triangle_width_px: 24.0,
            max_vertices: 1 << 18,
            ..default()
        };
        self.kernels.set_camera(eye, camera);
    }

    /// Draws a frame and checks all that holds in every frame.
    fn frame(&mut self) -> ReadBack {
        self.frames += 1;
        let frame = self.kernels.frame();
        let state = self.kernels.state();
        if let Err(broken) = state.validate() {
            panic!("frame {}: {broken}", self.frames);
        }
        assert!(self.streamer().pages_used() <= self.streamer().page_numbers());
        if let Err(wrong) = manifold::check(
            state.lattice(),
            &frame.vertices,
            &frame.triangles,
            frame.settings.partitioning,
        ) {
            panic!("frame {}: {wrong}", self.frames);
        }
        // What the GPU has read of its pages is what the tiles hold.
        let half_a_step_m = 0.5 * frame.height_step_m;
        for vertex in &frame.vertices {
            let stored = height(&frame.pages, &frame.lattice, vertex.point, vertex.lambda);
            let stored = stored.expect("every vertex is read from tiles that are there");
            let height_m = frame.height_min_m + stored * frame.height_step_m;
            assert!(
                (vertex.height_m - height_m).abs() <= half_a_step_m,
                "frame {}: {vertex:?} stands at {height_m} m",
                self.frames
            );
        }
        frame
    }

    /// Draws a frame and discards it.
    fn pass(&mut self) {
        self.kernels.app.update();
    }
}

fn eye_at(place: Vec3) -> Transform {
    Transform::from_translation(place).looking_to(Vec3::new(0.8, -0.25, 0.55), Vec3::Y)
}

/// Fixed places on the ground around the path.
fn places(frame: &ReadBack) -> Vec<IVec2> {
    let unit = 1 << frame.lattice.unit_log2;
    let centre = frame.lod.eye;
    let rings = (0..24).flat_map(|ring| {
        let radius = 20.0 * 1.22_f32.powi(ring);
        (0..24).map(move |spoke| {
            let angle = spoke as f32 * std::f32::consts::TAU / 24.0;
            Vec2::from_angle(angle) * radius
        })
    });
    rings
        .map(|offset| centre + (offset * unit as f32).as_ivec2())
        .filter(|p| p.min_element() >= 0 && (frame.lattice.extent - p).min_element() >= 0)
        .collect()
}

/// By how many pixels the ground at `p` has moved between two frames: because the eye has moved, and
/// because tiles have come and gone.
fn moved_px(before: &ReadBack, now: &ReadBack, p: IVec2) -> [f32; 2] {
    let was = drawn(
        &before.pages,
        &before.lattice,
        &before.lod,
        &before.field,
        p,
    );
    let is = drawn(&now.pages, &now.lattice, &now.lod, &now.field, p);
    let as_before = drawn(&before.pages, &now.lattice, &now.lod, &before.field, p);
    let [was, is, as_before] = [was, is, as_before].map(|height| height.expect("it is resident"));
    let view = &now.factor_view;
    let away = (p - view.eye).as_vec2() - view.eye_fraction;
    let up_m = now.height_min_m + is * now.height_step_m - view.eye_height_m;
    let distance_m = (away * view.unit_m).extend(up_m).length();
    let px = now.height_step_m * view.focal_px / distance_m;
    [(is - was).abs() * px, (is - as_before).abs() * px]
}

#[test]
fn a_flight_is_whole_and_smooth_however_late_tiles_come() {
    let _alone = alone();
    let tiles = hills().join("hills/tile");
    let tiles = (0..6).map(|level| tiles.join(level.to_string()).read_dir().unwrap().count());
    assert!(tiles.sum::<usize>() as u32 >= 20 * PAGES);
    let mut flight = Flight::new(PAGES, PICTURE);
    let mut worst = [0.0_f32; 2];
    let mut short = 0;
    let mut moving = 0;
    for (speed_m_s, frames) in [(5.0, 40), (50.0, 80), (300.0, 120)] {
        let start = Vec3::new(700.0, 110.0, 900.0);
        let along = Vec3::new(0.8, 0.0, 0.6) * (speed_m_s / FRAMES_PER_S as f32);
        // A teleport to begin with.
        flight.place(eye_at(start));
        for _ in 0..3 {
            flight.frame();
        }
        let mut before = flight.frame();
        let points = places(&before);
        for n in 0..frames {
            flight.place(eye_at(start + along * n as f32));
            let now = flight.frame();
            moving += u32::from(now.field != before.field);
            short = short.max(flight.kernels.state().levels_short());
            for &p in &points {
                let moved = moved_px(&before, &now, p);
                if moved[1] > worst[1] {
                    println!("{speed_m_s} m/s, frame {n}, {p}: {moved:?} px");
                }
                worst = [worst[0].max(moved[0]), worst[1].max(moved[1])];
            }
            before = now;
        }
    }
    println!("most pixels a frame: {worst:?}, by streaming alone the second; short {short} levels");
    assert!(moving > 60, "only in {moving} frames did detail come or go");
    assert!(worst[1] < 0.25, "{worst:?}");
    let failed = flight.kernels.state().failed().len();
    println!(
        "{failed} tiles are failed, {} reads",
        flight.source.read_count()
    );
}

#[test]
fn jumps_second_cameras_resizes_and_moved_terrains_are_whole() {
    let _alone = alone();
    let mut flight = Flight::new(PAGES, UVec2::new(64, 48));
    let mut random = common::random::Random(9);
    let terrain = flight.kernels.terrain;
    let second = TerrainCamera::default();
    for step in 0..60 {
        let anywhere = Vec3::new(
            random.unit() * SIDE as f32,
            90.0 + 60.0 * random.unit(),
            random.unit() * SIDE as f32,
        );
        match step {
            // A second camera far off, which takes half of the pages.
            10 => {
                let app = &mut flight.kernels.app;
                let target = app::target(app, 64, 64);
                let eye = eye_at(Vec3::new(3700.0, 120.0, 3500.0));
                let camera = (
                    Camera3d::default(),
                    second.clone(),
                    app::into_image(&target),
                    eye,
                );
                app.world_mut().spawn((camera, Msaa::Off));
            }
            // The picture gets another size.
            20 => {
                let target = app::target(&mut flight.kernels.app, 96, 33);
                let camera = flight.kernels.camera;
                let mut camera = flight.kernels.app.world_mut().entity_mut(camera);
                camera.insert(app::into_image(&target));
            }
            // Fewer pages, and then more than at first.
            30 => {
                flight
                    .kernels
                    .app
                    .insert_resource(TerrainStreaming::with_pages(20));
            }
            40 => {
                flight
                    .kernels
                    .app
                    .insert_resource(TerrainStreaming::with_pages(300));
            }
            // The terrain moves and turns, and the world's origin lies 100 km off.
            50.. => {
                let placed = Transform::from_xyz(1e5 + step as f32, -20.0, -1e5)
                    .with_rotation(Quat::from_rotation_y(0.1 * step as f32));
                let mut terrain = flight.kernels.app.world_mut().entity_mut(terrain);
                terrain.insert(placed);
                flight.place(placed * eye_at(anywhere));
                flight.pass();
            }
            _ => {}
        }
        if step < 50 {
            // A cut every other frame, and a step else.
            flight.place(eye_at(anywhere));
        }
        for _ in 0..3 {
            flight.frame();
        }
    }
    let limit = flight.streamer().pages();
    assert_eq!(limit, 300);
    assert!(
        flight.streamer().pages_used() > 30,
        "more than the 20 of before"
    );
}

/// Bytes of this process that are in memory.
fn resident_bytes() -> u64 {
    let statm = std::fs::read_to_string("/proc/self/statm").unwrap();
    let pages: u64 = statm.split(' ').nth(1).unwrap().parse().unwrap();
    pages * 4096
}

#[test]
fn drawing_three_hundred_frames_takes_no_more_memory_than_a_hundred() {
    let _alone = alone();
    let mut flight = Flight::new(PAGES, UVec2::new(64, 36));
    let mut memory = Vec::new();
    for n in 0..400 {
        let turn = n as f32 / 40.0 * std::f32::consts::TAU;
        let around = Vec3::new(
            2000.0 + 1500.0 * turn.cos(),
            130.0,
            2000.0 + 1500.0 * turn.sin(),
        );
        flight.place(eye_at(around));
        flight.pass();
        if n == 200 {
            // Despawned and spawned again.
            let world = flight.kernels.app.world_mut();
            let manifest = world
                .get::<Terrain>(flight.kernels.terrain)
                .unwrap()
                .clone();
            world.despawn(flight.kernels.terrain);
            flight.kernels.app.update();
            flight.kernels.terrain = flight.kernels.app.world_mut().spawn(manifest).id();
        }
        if n % 20 == 0 {
            memory.push(resident_bytes() >> 20);
        }
    }
    assert!(flight.streamer().pages_used() <= PAGES);
    let state = flight
        .kernels
        .app
        .world()
        .get::<TerrainState>(flight.kernels.terrain);
    assert!(state.unwrap().resident_count() > 40);
    println!("MiB in memory: {memory:?}");
    let early = memory[3..8].iter().max().unwrap();
    let late = memory[memory.len() - 5..].iter().max().unwrap();
    assert!(late <= &(early + 24), "{memory:?}");
}
