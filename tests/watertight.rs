//! The mesh is watertight: two triangles that meet anywhere meet in the same integers.

mod common;

use bevy_tessera::detail::{DetailKernel, DetailRule, TerrainDetail};
use bevy_tessera::lattice::{Lattice, LodSettings, Node, ResidencyField, ViewLod};
use bevy_tessera::tessellate::{FaceFactors, FactorView, PageSource, Partitioning, ViewMesh};
use bevy_tessera::tile::TileAddress;
use common::manifold;
use common::random::Random;
use glam::{IVec2, UVec2, Vec2};

/// Heights that differ between levels at every point, so that reading the wrong one shows.
struct Noise;

impl PageSource for Noise {
    fn errors(&self, tile: TileAddress, x: i32, z: i32) -> Option<[u8; 8]> {
        let density = self.density(tile, x, z)?;
        Some(std::array::from_fn(|k| density / 4 + 9 * k as u8))
    }

    fn density(&self, tile: TileAddress, x: i32, z: i32) -> Option<u8> {
        let texel = i64::from(tile.x) * 32 + i64::from(x) + 7919 * i64::from(tile.z * 32);
        let hash = (texel * 31 + i64::from(z) * 977 + i64::from(tile.level) * 53) * 2_654_435_761;
        Some((hash >> 9) as u8)
    }

    fn height(&self, tile: TileAddress, x: i32, z: i32) -> Option<u16> {
        let x = i64::from(tile.x) * 128 + i64::from(x);
        let z = i64::from(tile.z) * 128 + i64::from(z);
        let hash = (x * 73 + z * 179 + i64::from(tile.level) * 977).wrapping_mul(2_654_435_761);
        Some(20_000 + ((hash >> 7) & 0xfff) as u16)
    }
}

struct Case {
    lattice: Lattice,
    settings: LodSettings,
}

fn cases() -> Vec<Case> {
    let case = |size, levels, leaf_level, faces, reach, morph| Case {
        lattice: Lattice::new(size, levels, leaf_level, faces).unwrap(),
        settings: LodSettings { reach, morph },
    };
    vec![
        case([4097, 4097], 6, 0, 4, 4.0, 1.0),
        case([3000, 2100], 6, 0, 4, 4.0, 1.0),
        case([1055, 995], 5, -2, 8, 3.0, 0.5),
        case([130, 700], 4, -3, 2, 5.5, 1.0),
    ]
}

/// A field in which every corner asks for a level of its own.
fn ragged_field(lattice: &Lattice, random: &mut Random) -> ResidencyField {
    let mut field = ResidencyField::new(lattice, 0);
    for corner in &mut field.corners {
        *corner = random.below((lattice.root_level + 1) << 8) as u16;
    }
    field
}

fn build(
    case: &Case,
    random: &mut Random,
    eye: IVec2,
    floor: i32,
    partitioning: Partitioning,
    max_error_px: f32,
) -> Result<usize, String> {
    let Case { lattice, settings } = case;
    let lod = ViewLod::new(lattice, settings, eye, floor, true).unwrap();
    let mut nodes = Vec::new();
    lod.select(lattice, &mut |_, _| true, &mut |node: Node| {
        nodes.push(node)
    });
    let mut levels: Vec<i32> = nodes.iter().map(|node| node.level).collect();
    levels.sort_unstable();
    levels.dedup();
    let field = ragged_field(lattice, random);
    let view = FactorView {
        eye,
        eye_fraction: Vec2::new(0.25, 0.75),
        eye_height_m: 60.0,
        unit_m: lattice.unit_m(1.0) as f32,
        segments_per_radian: [12.0, 40.0, 90.0][random.below(3) as usize],
        segments_per_m: 0.0,
        min_triangle_m: 0.1,
        max_factor: 64.0,
        density_strength: 1.0,
        focal_px: 900.0,
        px_per_m: 0.0,
        max_error_px,
        error_units_per_m: 6400.0,
    };
    let detail = DetailKernel::new(
        &TerrainDetail {
            rule: DetailRule::Slope {
                from_deg: 5.0,
                to_deg: 60.0,
            },
            ..Default::default()
        },
        lattice,
        1.0,
    );
    let mesh = ViewMesh {
        lattice,
        lod: &lod,
        field: &field,
        factor_view: &view,
        partitioning,
        pages: &Noise,
        height_min_m: -100.0,
        height_step_m: 0.01,
        max_vertices: u32::MAX,
        max_triangles: u32::MAX,
        culling: None,
        detail: random.below(2).eq(&0).then_some(&detail),
    }
    .build(&nodes);
    manifold::check(lattice, &mesh.vertices, &mesh.triangles, partitioning)?;
    Ok(levels.len())
}

#[test]
fn the_twin_is_watertight_from_everywhere() {
    let mut random = Random(7);
    let mut deep = 0;
    for case in cases() {
        for n in 0..20 {
            let extent = case.lattice.extent;
            let eye = IVec2::new(
                random.below(extent.x + extent.x / 2),
                random.below(extent.y),
            );
            let leaf = case.lattice.node_size(case.lattice.leaf_level);
            let floor = [0, leaf / 3, 2 * leaf][random.below(3) as usize];
            let partitioning = Partitioning::ALL[n % Partitioning::ALL.len()];
            let max_error_px = [0.0, 0.0, 1.0, 8.0][n % 4];
            match build(&case, &mut random, eye, floor, partitioning, max_error_px) {
                Ok(levels) => deep += usize::from(levels >= 3),
                Err(wrong) => {
                    panic!("eye {eye}, floor {floor}, {partitioning:?}, {max_error_px} px: {wrong}")
                }
            }
        }
    }
    assert!(
        deep >= 40,
        "only {deep} views of 80 had three levels in view"
    );
}

/// A mesh whose tear must be seen: an eye over a corner of many levels.
fn twin_of_a_broken_view(
    break_lod: impl Fn(&mut ViewLod),
    break_factors: impl Fn(&mut [FaceFactors]),
) -> Result<(), String> {
    let lattice = Lattice::new([4097, 4097], 6, 0, 4).unwrap();
    let eye = lattice.extent / 3;
    let mut lod = ViewLod::new(&lattice, &LodSettings::default(), eye, 0, true).unwrap();
    break_lod(&mut lod);
    let mut nodes = Vec::new();
    lod.select(&lattice, &mut |_, _| true, &mut |node: Node| {
        nodes.push(node)
    });
    let field = ResidencyField::new(&lattice, 0);
    let view = FactorView {
        eye,
        eye_fraction: Vec2::ZERO,
        eye_height_m: 60.0,
        unit_m: lattice.unit_m(1.0) as f32,
        segments_per_radian: 40.0,
        segments_per_m: 0.0,
        min_triangle_m: 0.1,
        max_factor: 64.0,
        density_strength: 1.0,
        focal_px: 900.0,
        px_per_m: 0.0,
        max_error_px: 0.0,
        error_units_per_m: 6400.0,
    };
    let twin = ViewMesh {
        lattice: &lattice,
        lod: &lod,
        field: &field,
        factor_view: &view,
        partitioning: Partitioning::FractionalOdd,
        pages: &Noise,
        height_min_m: 0.0,
        height_step_m: 0.01,
        max_vertices: u32::MAX,
        max_triangles: u32::MAX,
        culling: None,
        detail: None,
    };
    let faces: Vec<_> = nodes
        .iter()
        .flat_map(|node| (0..16).map(|face| (*node, face)))
        .collect();
    let mut factors: Vec<_> = faces
        .iter()
        .map(|(node, face)| twin.classify(node, *face))
        .collect();
    break_factors(&mut factors);
    let mesh = twin.build_with(&faces, factors);
    manifold::check(&lattice, &mesh.vertices, &mesh.triangles, twin.partitioning)
}

#[test]
fn a_view_with_nothing_broken_passes_the_check() {
    twin_of_a_broken_view(|_| {}, |_| {}).unwrap();
}

#[test]
fn the_check_sees_a_morph_zone_that_ends_too_late() {
    // Rule 3 broken: nodes meet coarser ones before they are fully morphed.
    let torn = twin_of_a_broken_view(
        |lod| {
            for (start, log2) in lod.morph_start.iter_mut().zip(lod.zone_log2) {
                *start = start.saturating_add(1 << log2);
            }
        },
        |_| {},
    );
    assert!(torn.is_err());
}

#[test]
fn the_check_sees_an_edge_that_two_faces_cut_differently() {
    // Rule 4 broken: one face asks for more along an edge that it shares.
    let torn = twin_of_a_broken_view(
        |_| {},
        |factors| {
            let middle = factors.len() / 2;
            factors[middle].edges[1] += 3 * bevy_tessera::tessellate::FACTOR_ONE;
        },
    );
    assert!(torn.is_err());
}

#[test]
fn a_reach_without_room_for_the_morph_is_refused_because_it_tears() {
    let lattice = Lattice::new([4097, 4097], 6, 0, 4).unwrap();
    let settings = LodSettings {
        reach: 2.5,
        morph: 1.0,
    };
    let refused = ViewLod::new(&lattice, &settings, IVec2::ZERO, 0, true).unwrap_err();
    assert!(refused.to_string().contains("raise reach to at least 4"));
}

#[test]
fn the_last_point_of_a_terrain_lies_on_its_rim() {
    for case in cases() {
        let last = case.lattice.extent;
        let field = ResidencyField::new(&case.lattice, 2);
        assert_eq!(field.at(last), 2 << 8);
        assert!(field.cells.cmpge(UVec2::ONE).all());
    }
}

#[cfg(feature = "examples")]
mod on_the_gpu {
    use super::common::gpu::Kernels;
    use super::common::random::Random;
    use super::common::{self, manifold};
    use bevy::prelude::*;
    use bevy_tessera::bake::{BakeSettings, MemorySource, bake};
    use bevy_tessera::stream::{PAGE_BYTES, TerrainStreaming};
    use bevy_tessera::terrain::{
        TerrainCamera, TerrainSettings, TerrainSystems, TessellationPolicy,
    };
    use bevy_tessera::tessellate::Partitioning;
    use bevy_tessera::view::TerrainViews;
    use std::path::Path;

    const EYES: usize = 200;

    /// The kernels' mesh from so many eyes: on level boundaries, over tile corners, far outside and
    /// anywhere, with every partitioning under every policy.
    fn watertight_from_two_hundred_eyes(assets: &Path, spacing_m: f32, seed: u64) {
        let settings = TerrainSettings {
            // Small nodes, so that several levels meet on a terrain of a thousand samples.
            leaf_level: -2,
            ..default()
        };
        let mut kernels = Kernels::start_on(assets, settings, UVec2::new(96, 64));
        // The field is to be in motion in most frames.
        kernels.app.insert_resource(TerrainStreaming {
            upload_bytes_per_frame: 6 * PAGE_BYTES,
            ..TerrainStreaming::with_pages(90)
        });
        let file = kernels.state().manifest().file.clone();
        let size = Vec2::new(file.size[0] as f32, file.size[1] as f32) * spacing_m;
        let tile = 128.0 * spacing_m;
        let mut random = Random(seed);
        let mut deep = 0;
        for n in 0..EYES {
            let anywhere = Vec2::new(random.unit() * 1.1 - 0.05, random.unit() * 1.1 - 0.05) * size;
            let plane = match n % 8 {
                // Over a tile's corner.
                0 => (anywhere / tile).round() * tile,
                // Where a level ends: so many nodes of it away from a tile's corner.
                1 => (anywhere / tile).round() * tile + random.pick(&[1.0, 2.0, 4.0]) * tile,
                2 => anywhere + 20.0 * size,
                _ => anywhere,
            };
            let above = (5.0 + random.unit().powi(4) * 160.0) * spacing_m;
            let place = Vec3::new(plane.x, file.height_m(20_000) as f32 + above, plane.y);
            let towards = Vec3::new(random.unit() - 0.5, -0.3, random.unit() - 0.5);
            let camera = TerrainCamera {
                partitioning: Partitioning::ALL[n % Partitioning::ALL.len()],
                policy: match n % 4 {
                    0 | 1 => TessellationPolicy::TriangleWidth,
                    _ => TessellationPolicy::ScreenError {
                        max_px: random.pick(&[0.5, 2.0, 8.0]),
                    },
                },
                triangle_width_px: random.pick(&[2.0, 4.0, 8.0]),
                faces_per_side: 4,
                max_vertices: 1 << 19,
                ..default()
            };
            let eye = Transform::from_translation(place).looking_to(towards, Vec3::Y);
            kernels.set_camera(eye, camera);
            let frame = kernels.frame();
            deep += usize::from(frame.levels() >= 3);
            let lattice = kernels.state().lattice();
            if let Err(wrong) = manifold::check(
                lattice,
                &frame.vertices,
                &frame.triangles,
                frame.settings.partitioning,
            ) {
                panic!("eye {n} at {place}: {wrong}");
            }
        }
        assert!(
            deep * 2 > EYES,
            "only {deep} of {EYES} views had three levels in view"
        );
    }

    #[test]
    fn the_kernels_are_watertight_from_two_hundred_eyes_over_a_real_terrain() {
        watertight_from_two_hundred_eyes(common::gpu::bundled(), 30.0, 5);
    }

    /// Bakes ground that a function makes, under the name that the kernels' stage looks for.
    fn baked(height_m: impl Fn(f32, f32) -> f32, size: u32, spacing_m: f64) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let heights = (0..size * size)
            .map(|at| height_m((at % size) as f32, (at / size) as f32))
            .collect();
        let settings = BakeSettings {
            spacing_m: Some(spacing_m),
            ..Default::default()
        };
        let mut source = MemorySource::new([size, size], heights).unwrap();
        bake(
            &mut source,
            &folder.path().join("jacksboro"),
            &settings,
            &(),
        )
        .unwrap();
        folder
    }

    #[test]
    fn the_kernels_are_watertight_from_two_hundred_eyes_over_cliffs() {
        let steps = |x: f32, z: f32| 60.0 * ((x + 0.4 * z) / 37.0).floor().rem_euclid(3.0);
        let folder = baked(steps, 900, 1.0);
        watertight_from_two_hundred_eyes(folder.path(), 1.0, 6);
    }

    #[test]
    fn the_kernels_are_watertight_from_two_hundred_eyes_over_hills() {
        let hills = |x: f32, z: f32| 90.0 * (x / 61.0).sin() * (z / 47.0).cos() + 0.1 * x;
        let folder = baked(hills, 1025, 2.0);
        watertight_from_two_hundred_eyes(folder.path(), 2.0, 7);
    }

    #[test]
    fn the_check_sees_kernels_that_morph_too_late() {
        let mut kernels = Kernels::start(TerrainSettings::default(), UVec2::new(96, 64));
        kernels.app.add_systems(
            PostUpdate,
            (|mut cameras: Query<&mut TerrainViews>| {
                for mut views in &mut cameras {
                    for view in &mut views.views {
                        for (start, log2) in view.lod.morph_start.iter_mut().zip(view.lod.zone_log2)
                        {
                            *start = start.saturating_add(1 << log2);
                        }
                    }
                }
            })
            .after(TerrainSystems::View)
            .before(TerrainSystems::Stream),
        );
        let eye = Transform::from_xyz(15e3, 700.0, 15e3);
        kernels.set_camera(eye, TerrainCamera::default());
        let torn = (0..5).any(|_| {
            let frame = kernels.frame();
            let lattice = kernels.state().lattice();
            manifold::check(
                lattice,
                &frame.vertices,
                &frame.triangles,
                frame.settings.partitioning,
            )
            .is_err()
        });
        assert!(torn);
    }
}
