//! No hole below the horizon: over a real landscape, from five places, nothing of a glaring
//! background shows anywhere below the first ground in a column of pixels.

mod common;

use bevy::prelude::*;
use bevy_tessera::render::{TerrainNodes, TerrainRenderSystems};
use bevy_tessera::stream::TerrainState;
use bevy_tessera::terrain::TerrainCamera;
use common::gpu;
use common::stage::{NOTHING, Stage};
use image::RgbImage;
use std::path::Path;

const SIZE: [u32; 2] = [480, 300];
const SPACING_M: f32 = 30.0;

/// Pixels below the first ground of their column that show the background.
fn holes(picture: &RgbImage) -> Vec<[u32; 2]> {
    let mut holes = Vec::new();
    for x in 0..picture.width() {
        let mut ground = false;
        for y in 0..picture.height() {
            let nothing = picture.get_pixel(x, y).0 == NOTHING;
            if nothing && ground {
                holes.push([x, y]);
            }
            ground |= !nothing;
        }
    }
    holes
}

/// The elevation model's heights, read from its file.
struct Heights(image::ImageBuffer<image::Luma<u16>, Vec<u16>>);

impl Heights {
    fn read() -> Self {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/elevation/jacksboro_u16.png");
        Self(image::open(path).unwrap().into_luma16())
    }

    /// The height of the nearest sample, metres.
    fn at(&self, x: f32, z: f32) -> f32 {
        let sample =
            |place: f32, last: u32| (place / SPACING_M).round().clamp(0.0, last as f32) as u32;
        let (x, z) = (
            sample(x, self.0.width() - 1),
            sample(z, self.0.height() - 1),
        );
        200.0 + 0.02 * f32::from(self.0.get_pixel(x, z).0[0])
    }
}

/// Where the camera stands: place, metres above the ground there, direction as seen on a compass
/// with north along -z, and how far down it looks, all in degrees.
const EYES: [(f32, f32, f32, f32, f32); 5] = [
    (15_000.0, 15_000.0, 60.0, 20.0, 4.0),
    (9_000.0, 20_000.0, 350.0, 75.0, 12.0),
    (20_000.0, 8_000.0, 12.0, 200.0, 2.0),
    (24_000.0, 21_000.0, 900.0, 310.0, 14.0),
    (6_000.0, 6_000.0, 2500.0, 135.0, 18.0),
];

fn eye(heights: &Heights, number: usize) -> Transform {
    let (x, z, above, compass, down) = EYES[number];
    Transform::from_xyz(x, heights.at(x, z) + above, z).with_rotation(
        Quat::from_rotation_y(-compass.to_radians()) * Quat::from_rotation_x(-down.to_radians()),
    )
}

/// Nodes over this place are not drawn, where it is set.
#[derive(Resource, Default)]
struct Torn(Option<Vec2>);

fn tear(torn: Res<Torn>, mut cameras: Query<&mut TerrainNodes>, terrains: Query<&TerrainState>) {
    let Some(place) = torn.0 else { return };
    for mut nodes in &mut cameras {
        for (terrain, nodes) in &mut nodes.nodes {
            let lattice = terrains.get(*terrain).unwrap().lattice();
            let point = (place.as_dvec2() / lattice.unit_m(f64::from(SPACING_M))).as_ivec2();
            nodes.retain(|node| {
                let past = node.origin + lattice.node_size(node.level);
                !(point.cmpge(node.origin).all() && point.cmplt(past).all())
            });
        }
    }
}

fn stage() -> Stage {
    Stage::with(
        "horizon",
        gpu::bundled(),
        "jacksboro/terrain.ron",
        SIZE,
        false,
        default(),
        |app| {
            app.init_resource::<Torn>()
                .add_systems(PostUpdate, tear.after(TerrainRenderSystems::Cull));
        },
    )
}

#[test]
fn no_background_shows_below_the_horizon() {
    let heights = Heights::read();
    let mut stage = stage();
    stage.prop((
        DirectionalLight::default(),
        Transform::from_xyz(1.0, 0.8, 0.6).looking_at(Vec3::ZERO, Vec3::Y),
    ));
    for number in 0..EYES.len() {
        for (way, width) in [("coarse", 24.0), ("fine", 3.0)] {
            let name = format!("eye_{number}_{way}");
            let picture = stage.picture(&name, eye(&heights, number), 1, |camera| {
                camera.insert(TerrainCamera {
                    triangle_width_px: width,
                    ..default()
                });
            });
            let holes = holes(&picture);
            assert!(
                holes.is_empty(),
                "{name}: {} holes, as at {:?}",
                holes.len(),
                holes[0]
            );
            for x in 0..SIZE[0] {
                let first = (0..SIZE[1]).find(|y| picture.get_pixel(x, *y).0 != NOTHING);
                let first = first.unwrap_or(SIZE[1]);
                assert!(first < SIZE[1] / 2, "{name}: column {x} begins at {first}");
            }
        }
    }
}

#[test]
fn a_node_that_is_not_drawn_is_seen_as_a_hole() {
    let heights = Heights::read();
    let mut stage = stage();
    let number = 3;
    let eye = eye(&heights, number);
    let whole = stage.picture("whole", eye, 1, |_| {});
    assert_eq!(holes(&whole), Vec::<[u32; 2]>::new());
    // Where the middle of the picture meets the ground.
    let mut place = eye.translation;
    while place.y > heights.at(place.x, place.z) {
        place += eye.forward() * 10.0;
    }
    stage
        .app
        .insert_resource(Torn(Some(Vec2::new(place.x, place.z))));
    let torn = stage.picture("torn", eye, 1, |_| {});
    let holes = holes(&torn);
    assert!(holes.len() > 100, "{}", holes.len());
}

#[test]
fn a_single_pixel_of_background_is_a_hole() {
    let mut picture = RgbImage::from_pixel(8, 8, image::Rgb([10, 20, 30]));
    for x in 0..8 {
        for y in 0..3 {
            picture.put_pixel(x, y, image::Rgb(NOTHING));
        }
    }
    assert!(holes(&picture).is_empty());
    picture.put_pixel(5, 6, image::Rgb(NOTHING));
    assert_eq!(holes(&picture), [[5, 6]]);
}
