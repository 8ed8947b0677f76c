//! What the bake's tests share: sources, readers of tiles, the command-line tool.
#![expect(dead_code, reason = "every test file uses its own part")]

use bevy_tessera::bake::{self, BakeReport, BakeSettings, HeightSource, MemorySource};
use bevy_tessera::terrain::{ManifestFile, TerrainManifest};
use bevy_tessera::tile::{DensityTile, ErrorTile, HeightTile, TileAddress, tile_path};
use std::path::{Path, PathBuf};

/// A rough landscape without any symmetry: waves, a cliff, and noise.
pub fn landscape(size: [u32; 2], seed: u32) -> Vec<f32> {
    let mut state = seed.wrapping_mul(2_654_435_761).wrapping_add(12345);
    let mut heights = Vec::new();
    for z in 0..size[1] {
        for x in 0..size[0] {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let noise = (state >> 16) as f32 / 65536.0;
            let (u, v) = (x as f32, z as f32);
            let waves = (u * 0.11).sin() * 20.0 + (v * 0.07 + u * 0.013).cos() * 30.0;
            let cliff = if x * 3 > z * 2 + 40 { 25.0 } else { 0.0 };
            heights.push(waves + cliff + noise * noise * 4.0);
        }
    }
    heights
}

pub fn source(size: [u32; 2], heights: Vec<f32>) -> MemorySource {
    MemorySource::new(size, heights).expect("as many heights as the size says")
}

/// Bakes heights into `dir`.
pub fn bake_heights(
    size: [u32; 2],
    heights: Vec<f32>,
    dir: &Path,
    settings: &BakeSettings,
) -> BakeReport {
    bake::bake(&mut source(size, heights), dir, settings, &()).expect("the bake succeeds")
}

pub fn manifest(dir: &Path) -> TerrainManifest {
    TerrainManifest::read(dir).expect("the manifest is good")
}

pub fn heights(dir: &Path, address: TileAddress) -> HeightTile {
    let path = dir.join(tile_path(address));
    let bytes = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    HeightTile::decode(&bytes, address).expect("the tile is good")
}

pub fn densities(dir: &Path, address: TileAddress) -> DensityTile {
    let path = dir.join(tile_path(address));
    let bytes = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    DensityTile::decode(&bytes, address).expect("the tile is good")
}

pub fn errors(dir: &Path, address: TileAddress) -> ErrorTile {
    let path = dir.join(tile_path(address));
    let bytes = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    ErrorTile::decode(&bytes, address).expect("the tile is good")
}

/// Every address of a terrain.
pub fn addresses(file: &ManifestFile) -> Vec<TileAddress> {
    let mut all = Vec::new();
    for level in 0..file.levels {
        let [columns, rows] = file.tiles(level);
        for z in 0..rows {
            all.extend((0..columns).map(|x| TileAddress::new(level, x, z)));
        }
    }
    all
}

/// All of a source's heights in metres.
pub fn read_all(source: &mut dyn HeightSource) -> Result<Vec<f32>, String> {
    let [width, height] = source.size();
    let mut all = Vec::new();
    let mut row = vec![0.0; width as usize];
    for _ in 0..height {
        source.read_row(&mut row).map_err(|e| e.to_string())?;
        all.extend_from_slice(&row);
    }
    Ok(all)
}

/// The folder of real files, or `None`, having said so.
pub fn data() -> Option<PathBuf> {
    let dir = std::env::var_os("TESSERA_DATA").map(PathBuf::from);
    if dir.is_none() {
        println!("skipped: TESSERA_DATA is not set");
    }
    dir
}

/// The files in a folder, sorted.
pub fn files(dir: &Path) -> Vec<PathBuf> {
    let mut all: Vec<PathBuf> = std::fs::read_dir(dir)
        .unwrap_or_else(|e| panic!("{}: {e}", dir.display()))
        .map(|entry| entry.expect("readable").path())
        .filter(|path| path.is_file())
        .collect();
    all.sort();
    all
}

/// What lies in a folder, sorted, hidden entries included.
pub fn entries(dir: &Path) -> Vec<String> {
    let mut all: Vec<String> = std::fs::read_dir(dir)
        .expect("the folder can be read")
        .map(|entry| {
            entry
                .expect("readable")
                .file_name()
                .to_string_lossy()
                .into_owned()
        })
        .collect();
    all.sort();
    all
}
