//! A manifest may lack fine tiles in places: what isn't there is drawn from its ancestor.

mod common;

use bevy::prelude::*;
use bevy_tessera::bake::verify;
use bevy_tessera::stream::TerrainState;
use bevy_tessera::terrain::{
    INDEX_FILE, MANIFEST_FILE, TerrainCamera, TerrainManifest, TerrainSettings,
};
use bevy_tessera::tile::{HeightTile, TerrainTile, TileAddress, TileRange};
use common::gpu::{Kernels, bundled};
use common::{app, manifold};
use std::fs;
use std::path::Path;

/// Finest level that is kept in the terrain's western half.
const KEPT_LEVEL: u8 = 2;

/// Whether a tile lies in the half that is to be coarse.
fn is_west(manifest: &TerrainManifest, tile: TileAddress) -> bool {
    let half = manifest.file.tiles(KEPT_LEVEL)[0] / 2;
    tile.ancestor(KEPT_LEVEL).is_some_and(|tile| tile.x < half)
}

/// The bundled terrain without the fine tiles of its western half.
fn half_coarse(folder: &Path) {
    let from = bundled().join("jacksboro");
    let mut manifest = TerrainManifest::read(&from).unwrap();
    let tiles: Vec<_> = manifest.index.iter().map(|(tile, _)| tile).collect();
    let mut dropped = 0;
    for tile in tiles {
        if tile.level < KEPT_LEVEL && is_west(&manifest, tile) {
            manifest.index.set(tile, None);
            dropped += 1;
            continue;
        }
        let file = TerrainTile::path(tile);
        fs::create_dir_all(folder.join(&file).parent().unwrap()).unwrap();
        fs::copy(from.join(&file), folder.join(&file)).unwrap();
    }
    assert!(dropped > 20, "only {dropped} tiles were left out");
    // The ranges of what is left, from fine to coarse.
    let mut left: Vec<_> = manifest.index.iter().map(|(tile, _)| tile).collect();
    left.sort_by_key(|tile| tile.level);
    for tile in left {
        let bytes = fs::read(folder.join(TerrainTile::path(tile))).unwrap();
        let own = HeightTile::decode(&bytes, tile).unwrap().range();
        let children = tile.children().into_iter().flatten();
        let range = children
            .filter_map(|child| manifest.index.get(child))
            .fold(own, TileRange::union);
        manifest.index.set(tile, Some(range));
    }
    let index = manifest.index.encode();
    manifest.file.index_crc32 = crc32fast::hash(&index);
    fs::write(folder.join(INDEX_FILE), index).unwrap();
    let text = ron::to_string(&manifest.file).unwrap();
    fs::write(folder.join(MANIFEST_FILE), text).unwrap();
}

#[test]
fn what_is_not_stored_is_drawn_from_its_ancestor() {
    let folder = tempfile::tempdir().unwrap();
    half_coarse(&folder.path().join("jacksboro"));
    let report = verify(&folder.path().join("jacksboro"), &|_| {}).unwrap();
    assert!(report.faults.is_empty(), "{:?}", report.faults);

    let settings = TerrainSettings {
        leaf_level: -1,
        ..default()
    };
    let mut kernels = Kernels::start_on(folder.path(), settings, UVec2::new(96, 64));
    // Right above the seam between what is there and what isn't.
    let file = kernels.state().manifest().file.clone();
    let seam_tiles = file.tiles(KEPT_LEVEL)[0] / 2;
    let seam_m = f64::from(seam_tiles * (128 << KEPT_LEVEL)) * file.spacing_m;
    let eye = Transform::from_xyz(seam_m as f32, 700.0, 14e3);
    kernels.set_camera(eye, TerrainCamera::default());
    app::settle(&mut kernels.app, 400);
    let frame = kernels.frame();
    let state: &TerrainState = kernels.state();
    assert_eq!(
        state.failed().len(),
        0,
        "a tile that isn't stored was asked for"
    );
    state.validate().unwrap();
    let lattice = state.lattice();
    manifold::check(
        lattice,
        &frame.vertices,
        &frame.triangles,
        frame.settings.partitioning,
    )
    .unwrap();

    let seam = (seam_tiles << (7 + u32::from(KEPT_LEVEL)) << lattice.unit_log2).cast_signed();
    let mut fine = 0;
    for vertex in &frame.vertices {
        if vertex.point.x <= seam {
            let least = i32::from(KEPT_LEVEL) << 16;
            assert!(vertex.lambda >= least, "{vertex:?} reads what isn't stored");
        }
        fine += usize::from(vertex.lambda < 1 << 16);
    }
    assert!(fine > 0, "the eastern half is as coarse as the western");
}
