//! Lines over a terrain: bounds of its tiles, rectangles of its edits, a held eye's view.
//!
//! They are off until [`TerrainGizmos`] says otherwise, and cost nothing then:
//!
//! ```no_run
//! # use bevy::prelude::*;
//! # use bevy_tessera::gizmos::{TerrainGizmos, TerrainGizmosPlugin};
//! fn show_tiles(mut store: ResMut<GizmoConfigStore>) {
//!     let (config, gizmos) = store.config_mut::<TerrainGizmos>();
//!     config.line.width = 1.5;
//!     gizmos.tiles = true;
//! }
//! # App::new().add_plugins((DefaultPlugins, TerrainGizmosPlugin)).add_systems(Startup, show_tiles);
//! ```

mod edits;
pub(crate) mod shapes;

use crate::render::ComparisonCamera;
use crate::stream::{TerrainState, TileBounds, TileOf};
use crate::terrain::{TerrainCamera, TerrainSystems};
use crate::tile::TileAddress;
use crate::view::HeldTerrainEye;
use bevy::gizmos::config::GizmoConfigGroup;
use bevy::prelude::*;
pub(crate) use edits::edit_corners;
use shapes::{BOX_EDGES, box_corners, frustum_corners};
use std::ops::RangeInclusive;

/// How much nearer than the ground lines count, so that those that lie on it are seen: some percent of
/// their distance.
pub(crate) const DEPTH_BIAS: f32 = -0.004;

/// Draws [`TerrainGizmos`]. Needs Bevy's `GizmoPlugin` and, to be seen, its `GizmoRenderPlugin`, both in
/// `DefaultPlugins`.
#[derive(Clone, Copy, Debug, Default)]
pub struct TerrainGizmosPlugin;

/// What draws [`TerrainGizmos`], in `PostUpdate` after
/// [`TerrainSystems::Stream`]: a frame's lines are those of its
/// tiles, edits and eyes.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct TerrainGizmoSystems;

impl Plugin for TerrainGizmosPlugin {
    fn build(&self, app: &mut App) {
        app.init_gizmo_group::<TerrainGizmos>()
            .configure_sets(
                PostUpdate,
                TerrainGizmoSystems.after(TerrainSystems::Stream),
            )
            .add_systems(
                PostUpdate,
                (
                    draw_tiles.run_if(wants(|gizmos| gizmos.tiles)),
                    edits::draw_edits.run_if(wants(|gizmos| gizmos.edits)),
                    draw_held_eyes.run_if(wants(|gizmos| gizmos.held_eyes)),
                )
                    .in_set(TerrainGizmoSystems),
            );
        let mut store = app.world_mut().resource_mut::<GizmoConfigStore>();
        store.config_mut::<TerrainGizmos>().0.depth_bias = DEPTH_BIAS;
    }
}

fn wants(
    what: impl Fn(&TerrainGizmos) -> bool + Send + Sync + 'static,
) -> impl FnMut(Res<GizmoConfigStore>) -> bool + Send + Sync + 'static {
    move |store| {
        let config = store.get_config::<TerrainGizmos>();
        config.is_some_and(|(config, gizmos)| config.enabled && what(gizmos))
    }
}

/// Which lines are drawn over terrains, and in which colours; set it through Bevy's
/// `GizmoConfigStore`, whose `GizmoConfig` of this group has the lines' width and style, and how far
/// they are drawn in front of the ground (`depth_bias`).
#[derive(GizmoConfigGroup, Clone, Debug, PartialEq, Reflect)]
#[reflect(Default, Debug, Clone, PartialEq)]
pub struct TerrainGizmos {
    /// Boxes around resident tiles, a colour a level: the ground of a tile, edits included, lies within
    /// its box.
    pub tiles: bool,
    /// Rectangles of the edits in the log, laid on the ground, the newest brightest; those that were
    /// undone aren't drawn.
    pub edits: bool,
    /// The frustum of the eye that the level of detail follows, where a
    /// [`TerrainEye`](crate::view::TerrainEye) holds one of a camera's two, with a cross at the eye.
    pub held_eyes: bool,
    /// Colours of the levels, the finest first; coarser ones begin again.
    pub tile_colors: [Color; 8],
    /// The most boxes that are drawn: those nearest to the cameras. 24 vertices each, every frame.
    pub most_tiles: u32,
    /// Boxes further than this from all cameras aren't drawn, in metres, 0 or more; `f32::MAX` for none
    /// too far.
    pub tiles_within_m: f32,
    /// Colour of the newest edit.
    pub edit_color: Color,
    /// The most rectangles that are drawn: those of the newest edits.
    pub most_edits: u32,
    /// Colour of held eyes.
    pub held_eye_color: Color,
    /// How deep frusta are drawn, in metres, above 0: most projections have no end.
    pub held_eye_reach_m: f32,
}

impl Default for TerrainGizmos {
    fn default() -> Self {
        Self {
            tiles: false,
            edits: false,
            held_eyes: false,
            tile_colors: [
                Color::srgb(1.0, 0.25, 0.2),
                Color::srgb(1.0, 0.65, 0.1),
                Color::srgb(0.95, 0.95, 0.2),
                Color::srgb(0.35, 0.9, 0.3),
                Color::srgb(0.2, 0.9, 0.9),
                Color::srgb(0.3, 0.5, 1.0),
                Color::srgb(0.7, 0.4, 1.0),
                Color::srgb(1.0, 0.4, 0.8),
            ],
            most_tiles: 1024,
            tiles_within_m: f32::MAX,
            edit_color: Color::srgb(1.0, 0.6, 0.1),
            most_edits: 256,
            held_eye_color: Color::srgb(1.0, 1.0, 1.0),
            held_eye_reach_m: 1000.0,
        }
    }
}

impl TerrainGizmos {
    /// Distances of boxes that make sense, in metres.
    pub const TILES_WITHIN_RANGE: RangeInclusive<f32> = 0.0..=f32::MAX;
    /// Depths of frusta that make sense, in metres.
    pub const HELD_EYE_REACH_RANGE: RangeInclusive<f32> = f32::MIN_POSITIVE..=f32::MAX;

    /// The colour of a level's boxes.
    #[must_use]
    pub fn tile_color(&self, level: u8) -> Color {
        self.tile_colors[usize::from(level) % self.tile_colors.len()]
    }
}

type Tile<'a> = (&'a TileOf, &'a TileAddress, &'a TileBounds);

/// The boxes of the nearest tiles.
fn draw_tiles(
    tiles: Query<Tile>,
    terrains: Query<&GlobalTransform, With<TerrainState>>,
    cameras: Query<&GlobalTransform, With<TerrainCamera>>,
    mut nearest: Local<Vec<(f32, Entity, u8, TileBounds)>>,
    mut gizmos: Gizmos<TerrainGizmos>,
) {
    let within = gizmos.config_ext.tiles_within_m;
    let most = gizmos.config_ext.most_tiles as usize;
    nearest.clear();
    for (of, address, bounds) in &tiles {
        let Ok(transform) = terrains.get(of.0) else {
            continue;
        };
        let affine = transform.affine();
        let local_from_world = affine.inverse();
        let scale = affine.matrix3.x_axis.length();
        let distances = cameras.iter().map(|camera| {
            let eye = local_from_world.transform_point3(camera.translation());
            scale * eye.distance(eye.clamp(bounds.min_m, bounds.max_m))
        });
        // Without a camera that sees terrains none is nearer than others.
        let distance = distances.min_by(f32::total_cmp).unwrap_or(0.0);
        if distance <= within {
            nearest.push((distance, of.0, address.level, *bounds));
        }
    }
    if nearest.len() > most {
        if most > 0 {
            nearest.select_nth_unstable_by(most - 1, |a, b| a.0.total_cmp(&b.0));
        }
        nearest.truncate(most);
    }
    for &(_, terrain, level, bounds) in &*nearest {
        if let Ok(transform) = terrains.get(terrain) {
            let color = gizmos.config_ext.tile_color(level);
            let corners = box_corners(bounds.min_m, bounds.max_m);
            let corners = corners.map(|corner| transform.transform_point(corner));
            for [from, to] in BOX_EDGES {
                gizmos.line(corners[from], corners[to], color);
            }
        }
    }
}

/// What held eyes see, and where they are.
fn draw_held_eyes(
    held: Query<&HeldTerrainEye, Without<ComparisonCamera>>,
    mut gizmos: Gizmos<TerrainGizmos>,
) {
    let color = gizmos.config_ext.held_eye_color;
    let reach_m = gizmos.config_ext.held_eye_reach_m;
    for held in &held {
        // As large wherever it is seen from.
        let away = held.lod.translation().distance(held.eye.translation());
        let at = Isometry3d::new(held.lod.translation(), held.lod.rotation());
        gizmos.cross(at, (0.02 * away).max(0.25), color);
        let Some(corners) = frustum_corners(held.clip_from_lod_view, reach_m) else {
            continue;
        };
        let corners = corners.map(|corner| held.lod.transform_point(corner));
        for [from, to] in BOX_EDGES {
            gizmos.line(corners[from], corners[to], color);
        }
    }
}
