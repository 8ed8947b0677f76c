//! Grounds made in memory, of which any tiles may be resident.

use bevy_tessera::density::DensitySettings;
use bevy_tessera::query::{BlockRanges, GroundReader, GroundSource};
use bevy_tessera::terrain::{MANIFEST_MAGIC, MANIFEST_VERSION, ManifestFile};
use bevy_tessera::tile::{HeightTile, TILE_BORDER, TILE_STORED, TileAddress, TileIndex, TileRange};
use glam::{DVec2, DVec3};
use std::collections::HashMap;

pub struct TestGround {
    pub file: ManifestFile,
    pub index: TileIndex,
    pub tiles: HashMap<TileAddress, (HeightTile, BlockRanges)>,
    pub has_blocks: bool,
    pub has_ranges: bool,
}

impl GroundSource for TestGround {
    fn file(&self) -> &ManifestFile {
        &self.file
    }

    fn heights(&self, address: TileAddress) -> Option<&HeightTile> {
        self.tiles.get(&address).map(|(heights, _)| heights)
    }

    fn range(&self, address: TileAddress) -> Option<TileRange> {
        self.index.get(address).filter(|_| self.has_ranges)
    }

    fn blocks(&self, address: TileAddress) -> Option<&BlockRanges> {
        let (_, blocks) = self.tiles.get(&address)?;
        self.has_blocks.then_some(blocks)
    }
}

impl TestGround {
    /// A ground of `size` samples whose stored heights at level 0 a function gives. Coarser levels
    /// hold every other sample of the finer ones, raised by `lift` a level, so that grounds of
    /// different levels are apart. All tiles are resident that `is_resident` doesn't refuse and whose
    /// parents are.
    pub fn new(
        size: [u32; 2],
        lift: u16,
        height: &dyn Fn(u32, u32) -> u16,
        is_resident: &mut dyn FnMut(TileAddress) -> bool,
    ) -> Self {
        let file = ManifestFile {
            format: MANIFEST_MAGIC.to_owned(),
            version: MANIFEST_VERSION,
            size,
            spacing_m: 1.5,
            height_min_m: -40.0,
            height_step_m: 0.01,
            levels: ManifestFile::levels_for(size),
            density: DensitySettings::default(),
            index_crc32: 0,
        };
        let mut index = TileIndex::new(&file);
        let mut tiles = HashMap::new();
        for level in 0..file.levels {
            let [columns, rows] = file.tiles(level);
            for z in 0..rows {
                for x in 0..columns {
                    let address = TileAddress::new(level, x, z);
                    let heights = tile(size, address, lift, height);
                    let children = address.children().into_iter().flatten();
                    let range = children
                        .filter_map(|child| index.get(child))
                        .fold(heights.range(), TileRange::union);
                    index.set(address, Some(range));
                    let blocks = BlockRanges::new(&heights);
                    tiles.insert(address, (heights, blocks));
                }
            }
        }
        for level in (0..file.levels - 1).rev() {
            let [columns, rows] = file.tiles(level);
            for z in 0..rows {
                for x in 0..columns {
                    let address = TileAddress::new(level, x, z);
                    if !tiles.contains_key(&address.parent()) || !is_resident(address) {
                        tiles.remove(&address);
                    }
                }
            }
        }
        Self {
            file,
            index,
            tiles,
            has_blocks: true,
            has_ranges: true,
        }
    }

    /// Metres from the first sample to the last.
    pub fn extent_m(&self) -> DVec2 {
        DVec2::from(self.file.size.map(|samples| f64::from(samples - 1))) * self.file.spacing_m
    }

    pub fn height_m(&self, at_m: DVec2) -> f64 {
        let ground = GroundReader::new(self).height(at_m);
        ground.expect("on the terrain").height_m
    }

    /// Metres of a point above the ground.
    pub fn clearance_m(&self, point_m: DVec3) -> f64 {
        point_m.y - self.height_m(DVec2::new(point_m.x, point_m.z))
    }
}

fn tile(
    size: [u32; 2],
    address: TileAddress,
    lift: u16,
    height: &dyn Fn(u32, u32) -> u16,
) -> HeightTile {
    let (first_x, first_z) = address.first_sample();
    let mut samples = Vec::new();
    for row in 0..TILE_STORED {
        for column in 0..TILE_STORED {
            let at = |first: u32, offset: u32, last: u32| {
                let sample = (first + offset).saturating_sub(TILE_BORDER);
                (sample << address.level).min(last)
            };
            let stored = height(
                at(first_x, column, size[0] - 1),
                at(first_z, row, size[1] - 1),
            );
            samples.push(stored + lift * u16::from(address.level));
        }
    }
    HeightTile::from_samples(samples.into()).expect("133 x 133")
}
