//! A terrain that is larger than the memory, and what flying over it shows.

use super::virtual_source::{Outcome, VirtualSource};
use bevy_tessera::bake::{BakeSettings, MemorySource, bake};
use bevy_tessera::lattice::{Lattice, ONE, ResidencyField, ViewLod};
use bevy_tessera::tessellate::{PageSource, height};
use glam::IVec2;
use std::path::Path;
use std::sync::LazyLock;
use tempfile::TempDir;

/// Samples a side, a metre apart: 1365 tiles.
pub const SIDE: u32 = 4097;
/// The virtual frames a second.
pub const FRAMES_PER_S: u32 = 60;

/// Hills of 80 m with stones on them, baked once for all tests of a process, as `hills` in a folder.
pub fn hills() -> &'static Path {
    static FOLDER: LazyLock<TempDir> = LazyLock::new(|| {
        let folder = tempfile::tempdir().unwrap();
        let wave = |at: usize, length: f32| (at as f32 / length).sin();
        let side = SIDE as usize;
        let rows: Vec<[f32; 3]> = (0..side)
            .map(|at| [wave(at, 211.0), wave(at, 61.0), wave(at, 7.0)])
            .collect();
        let heights = (0..side * side)
            .map(|at| {
                let (x, z) = (rows[at % side], rows[at / side]);
                let stone = (at as u32).wrapping_mul(0x9e37_79b1) >> 24;
                60.0 * x[0] * z[0] + 15.0 * x[1] * z[1] + 0.8 * x[2] * z[2] + stone as f32 / 1024.0
            })
            .collect();
        let mut source = MemorySource::new([SIDE, SIDE], heights).unwrap();
        let settings = BakeSettings {
            spacing_m: Some(1.0),
            ..Default::default()
        };
        bake(&mut source, &folder.path().join("hills"), &settings, &()).unwrap();
        folder
    });
    FOLDER.path()
}

/// A number that follows from a path and how often it was read, and looks like a draw.
fn draw(path: &Path, before: u32, salt: u32) -> u32 {
    let text = path.to_string_lossy();
    crc32fast::hash(format!("{text} {before} {salt}").as_bytes())
}

/// Reads that take up to half a second, in any order; one in a hundred fails, and as many come
/// damaged.
pub fn rough_weather(root: &Path) -> VirtualSource {
    VirtualSource::new(root, |path, before| {
        let late = u64::from(draw(path, before, 1) % (FRAMES_PER_S / 2 + 1));
        let is_tile = path
            .extension()
            .is_some_and(|extension| extension == "tile");
        let outcome = match draw(path, before, 2) % 200 {
            0 | 1 if is_tile => Outcome::Failure,
            2 | 3 if is_tile => Outcome::Corrupt,
            _ => Outcome::Good,
        };
        (late, outcome)
    })
}

/// The level of detail that a view asks for at a place, 16.16.
pub fn detail(lattice: &Lattice, lod: &ViewLod, p: IVec2) -> i32 {
    let level = (lattice.leaf_level..=lattice.root_level)
        .find(|&level| lod.morph(lattice, p, level) < ONE)
        .unwrap_or(lattice.root_level);
    lod.detail(lattice, p, level)
}

/// The stored height that is drawn at a place; `None` where it is read from a tile that isn't there.
pub fn drawn(
    pages: &impl PageSource,
    lattice: &Lattice,
    lod: &ViewLod,
    field: &ResidencyField,
    p: IVec2,
) -> Option<f32> {
    let lambda = detail(lattice, lod, p).max(field.at(p) << 8);
    height(pages, lattice, p, lambda.min(lattice.root_level * ONE))
}
