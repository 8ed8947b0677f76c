//! Bombs, craters, and debris that settles on what they leave: the bundled landscape at a scale of
//! 1 : 30, so that a crater of some metres is one.
//!
//! ```sh
//! cargo run --release --features examples --example destruction
//! ```
//!
//! Left mouse button to throw a bomb, right to look, W A S D Q E to fly; Z takes the last crater
//! back, Y makes it again, F5 saves, F9 loads; F3 opens the terrain's panel.

mod kit;

use avian3d::prelude::*;
use bevy::camera_controller::free_camera::{FreeCamera, FreeCameraPlugin};
use bevy::light::CascadeShadowConfigBuilder;
use bevy::light::light_consts::lux;
use bevy::pbr::{DistanceFog, FogFalloff};
use bevy::prelude::*;
use bevy::time::TimeUpdateStrategy;
use bevy::window::PrimaryWindow;
use bevy_tessera::TerrainPlugins;
use bevy_tessera::debug::brush::TerrainBrush;
use bevy_tessera::edit::{
    Crater, EditLog, RedoEdit, TerrainEditRefused, TerrainEdited, TerrainEdits, UndoEdit,
};
use bevy_tessera::terrain::{Terrain, TerrainCamera, TerrainReady};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Where the camera stands, and what it looks at.
const EYE: Vec3 = Vec3::new(645.0, 69.0, 550.0);
const LOOK: Vec3 = Vec3::new(700.0, 40.0, 470.0);
const HELP: &str = "\
Left mouse button: throw a bomb (with Shift: a big one)
Right mouse button: look around   W A S D Q E: fly
Z: undo   Y: redo   F5: save   F9: load   F3: panel";

fn main() -> AppExit {
    let mut arguments = kit::Arguments::parse();
    let is_headless = arguments.headless;
    // Long enough for what was thrown to land.
    arguments.frames.get_or_insert(24);
    let mut app = kit::app_on(&kit::BATTLEFIELD, arguments);
    app.add_plugins((TerrainPlugins, FreeCameraPlugin, PhysicsPlugins::default()))
        .insert_resource(ClearColor(Color::srgb(0.66, 0.75, 0.84)))
        .insert_resource(GlobalAmbientLight {
            brightness: 600.0,
            ..default()
        })
        .init_resource::<Shapes>()
        .add_systems(Startup, setup)
        .add_systems(Update, (throw, keys, sweep))
        .add_observer(begin)
        .add_observer(tell)
        .add_observer(tell_refused);
    kit::add_panel(&mut app);
    if is_headless {
        // Pictures take as long as they take; the game goes on at its own pace.
        let frame = Duration::from_millis(150);
        app.insert_resource(TimeUpdateStrategy::ManualDuration(frame));
    }
    app.run()
}

/// What bombs and debris look like.
#[derive(Resource)]
struct Shapes {
    bomb: Handle<Mesh>,
    stone: Handle<Mesh>,
    iron: Handle<StandardMaterial>,
    earth: Handle<StandardMaterial>,
}

impl FromWorld for Shapes {
    fn from_world(world: &mut World) -> Self {
        let mut meshes = world.resource_mut::<Assets<Mesh>>();
        let bomb = meshes.add(Sphere::new(0.5));
        let stone = meshes.add(Cuboid::from_length(1.0));
        let mut materials = world.resource_mut::<Assets<StandardMaterial>>();
        let mut material = |color, perceptual_roughness| {
            materials.add(StandardMaterial {
                base_color: color,
                perceptual_roughness,
                ..default()
            })
        };
        Self {
            iron: material(Color::srgb(0.06, 0.06, 0.07), 0.4),
            earth: material(Color::srgb(0.20, 0.15, 0.11), 0.95),
            bomb,
            stone,
        }
    }
}

/// What explodes where it lands.
#[derive(Component)]
struct Bomb {
    crater_m: f32,
}

/// What flies about then, and disappears after a while.
#[derive(Component)]
struct Debris {
    since_s: f32,
}

/// The line of text that says what has happened.
#[derive(Component)]
struct Message;

fn setup(mut commands: Commands, assets: Res<AssetServer>, terrain: Res<kit::TerrainPath>) {
    let manifest = assets.load(terrain.0.clone());
    commands.spawn((Name::new("ground"), Terrain::new(manifest)));
    commands.spawn((
        Name::new("fly camera"),
        TerrainCamera::default(),
        FreeCamera {
            walk_speed: 20.0,
            run_speed: 80.0,
            ..default()
        },
        Camera3d::default(),
        IsDefaultUiCamera,
        Transform::from_translation(EYE).looking_at(LOOK, Vec3::Y),
        DistanceFog {
            color: Color::srgb(0.66, 0.75, 0.84),
            falloff: FogFalloff::from_visibility_squared(2500.0),
            ..default()
        },
    ));
    commands.spawn((
        DirectionalLight {
            shadow_maps_enabled: true,
            illuminance: lux::FULL_DAYLIGHT * 0.6,
            ..default()
        },
        Transform::from_xyz(-1.0, 0.6, 0.35).looking_at(Vec3::ZERO, Vec3::Y),
        CascadeShadowConfigBuilder {
            num_cascades: 3,
            first_cascade_far_bound: 60.0,
            maximum_distance: 600.0,
            ..default()
        }
        .build(),
    ));
    commands.spawn((
        Text::new(HELP),
        TextFont::from_font_size(16.0),
        Node {
            position_type: PositionType::Absolute,
            top: px(10),
            left: px(12),
            ..default()
        },
    ));
    commands.spawn((
        Message,
        Text::default(),
        TextFont::from_font_size(16.0),
        Node {
            position_type: PositionType::Absolute,
            bottom: px(10),
            left: px(12),
            ..default()
        },
    ));
}

/// A salvo to begin with: where there is no mouse, all there is.
fn begin(_ready: On<TerrainReady>, mut commands: Commands, shapes: Res<Shapes>) {
    for number in 0..7 {
        let around = Quat::from_rotation_y(number as f32 * 0.9 - 2.7) * Vec3::Z;
        let target = LOOK + around * (8.0 + 6.0 * number as f32) * Vec3::new(1.0, 0.0, 1.0);
        let from = target.with_y(110.0 + 9.0 * number as f32);
        let crater_m = 3.5 + 1.5 * (number % 4) as f32;
        commands
            .spawn(bomb(&shapes, from, Vec3::NEG_Y * 25.0, crater_m))
            .observe(explode);
    }
}

fn bomb(shapes: &Shapes, from: Vec3, velocity: Vec3, crater_m: f32) -> impl Bundle {
    (
        Bomb { crater_m },
        Mesh3d(shapes.bomb.clone()),
        MeshMaterial3d(shapes.iron.clone()),
        Transform::from_translation(from).with_scale(Vec3::splat(0.1 * crater_m + 0.4)),
        RigidBody::Dynamic,
        Collider::sphere(0.5),
        LinearVelocity(velocity),
        CollisionEventsEnabled,
        SweptCcd::default(),
    )
}

/// Whether the panel's brush is.
fn is_on(brush: Option<Res<TerrainBrush>>) -> bool {
    brush.is_some_and(|brush| brush.on)
}

/// Throws bombs from the camera to where the mouse points.
fn throw(
    mut commands: Commands,
    buttons: Res<ButtonInput<MouseButton>>,
    keys: Res<ButtonInput<KeyCode>>,
    windows: Query<&Window, With<PrimaryWindow>>,
    cameras: Query<(&Camera, &GlobalTransform), With<TerrainCamera>>,
    shapes: Res<Shapes>,
    brush: Option<Res<TerrainBrush>>,
) {
    // While the panel's brush is on, the mouse is its.
    if is_on(brush) || !buttons.just_pressed(MouseButton::Left) {
        return;
    }
    let place = windows.iter().find_map(Window::cursor_position);
    let (Some(place), Ok((camera, transform))) = (place, cameras.single()) else {
        return;
    };
    let Ok(ray) = camera.viewport_to_world(transform, place) else {
        return;
    };
    let crater_m = if keys.pressed(KeyCode::ShiftLeft) {
        12.0
    } else {
        4.0
    };
    let from = ray.origin + ray.direction * 3.0;
    commands
        .spawn(bomb(&shapes, from, ray.direction * 90.0, crater_m))
        .observe(explode);
}

/// Bombs explode where they land: a crater, and earth in the air.
fn explode(
    hit: On<CollisionStart>,
    mut commands: Commands,
    bombs: Query<(&Bomb, &Transform)>,
    shapes: Res<Shapes>,
    time: Res<Time>,
) {
    let Ok((bomb, transform)) = bombs.get(hit.collider1) else {
        return;
    };
    let at = transform.translation;
    let size = bomb.crater_m;
    commands.entity(hit.collider1).despawn();
    let seed = at.x.to_bits() ^ at.z.to_bits().rotate_left(16);
    commands.trigger(Crater::at(at).radius(size).rough(0.4, seed));
    for number in 0..14 {
        let turn = number as f32 * 2.399_963 + seed as f32 * 1e-6;
        let lift = 5.0 + 3.0 * ((number * 7) % 5) as f32;
        let away = Vec3::new(turn.cos(), 0.0, turn.sin());
        let scale = 0.25 + 0.12 * (number % 4) as f32;
        commands.spawn((
            Debris {
                since_s: time.elapsed_secs(),
            },
            Mesh3d(shapes.stone.clone()),
            MeshMaterial3d(shapes.earth.clone()),
            Transform::from_translation(at + away * (0.6 * size) + Vec3::Y * (1.5 + 0.3 * size))
                .with_rotation(Quat::from_rotation_x(turn))
                .with_scale(Vec3::splat(scale)),
            RigidBody::Dynamic,
            Collider::cuboid(1.0, 1.0, 1.0),
            LinearVelocity(away * (2.0 + size) + Vec3::Y * lift),
            AngularVelocity(Vec3::new(turn.sin(), 1.0, turn.cos()) * 5.0),
        ));
    }
}

/// Debris doesn't stay for ever, and what misses the terrain doesn't fall for ever.
fn sweep(
    mut commands: Commands,
    debris: Query<(Entity, &Debris)>,
    bodies: Query<(Entity, &Transform), With<RigidBody>>,
    time: Res<Time>,
) {
    for (entity, debris) in &debris {
        if time.elapsed_secs() - debris.since_s > 40.0 {
            commands.entity(entity).try_despawn();
        }
    }
    for (entity, transform) in &bodies {
        if transform.translation.y < -500.0 {
            commands.entity(entity).try_despawn();
        }
    }
}

/// Where the log is saved.
fn save_path() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("destruction.edits")
}

fn keys(
    mut commands: Commands,
    keys: Res<ButtonInput<KeyCode>>,
    terrains: Query<(Entity, &TerrainEdits)>,
    mut messages: Query<&mut Text, With<Message>>,
    brush: Option<Res<TerrainBrush>>,
) {
    let mut say = |text: String| {
        for mut message in &mut messages {
            message.0.clone_from(&text);
        }
    };
    // The brush has keys of its own.
    let is_game = !is_on(brush);
    if is_game && keys.just_pressed(KeyCode::KeyZ) {
        commands.trigger(UndoEdit::default());
    }
    if is_game && keys.just_pressed(KeyCode::KeyY) {
        commands.trigger(RedoEdit::default());
    }
    let Ok((terrain, edits)) = terrains.single() else {
        return;
    };
    let path = save_path();
    if keys.just_pressed(KeyCode::F5)
        && let Some(log) = edits.log()
    {
        match log.save(&path) {
            Ok(()) => say(format!("saved {} edits in {}", log.len(), path.display())),
            Err(error) => say(error.to_string()),
        }
    }
    if keys.just_pressed(KeyCode::F9) {
        match EditLog::load(&path) {
            Ok(log) => {
                say(format!("loaded {} edits", log.len()));
                commands.entity(terrain).insert(TerrainEdits::new(log));
            }
            Err(error) => say(error.to_string()),
        }
    }
}

fn tell(edited: On<TerrainEdited>, mut messages: Query<&mut Text, With<Message>>) {
    for mut message in &mut messages {
        message.0 = format!("edit {}", edited.sequence);
    }
}

fn tell_refused(refused: On<TerrainEditRefused>, mut messages: Query<&mut Text, With<Message>>) {
    for mut message in &mut messages {
        message.0.clone_from(&refused.reason);
    }
}
