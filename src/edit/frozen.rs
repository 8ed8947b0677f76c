//! Edited tiles as bytes: what snapshots hold.

use super::EditedTile;
use super::tile::{OWN, SIDE, TileState};
use crate::tile::{TerrainTile, TileAddress};
use flate2::Compression;
use flate2::read::DeflateDecoder;
use flate2::write::DeflateEncoder;
use serde::{Deserialize, Serialize};
use std::io::{Read, Write};
use std::sync::Arc;
use xxhash_rust::xxh3::xxh3_64;

/// The version of the bytes that this crate writes and reads. Others are replayed anew.
const VERSION: u8 = 1;
/// The most bytes that a tile unpacks to: heights, texels and sums, each number at its longest.
const MOST: u64 = (SIDE * SIDE * 3 + OWN * (3 * 2 + 7 * 5) + 64) as u64;

/// A tile's state, as differences from how it was baked.
#[derive(Serialize, Deserialize)]
struct Frozen {
    version: u8,
    /// Of the baked tile: what was made of another is worth nothing.
    base: u64,
    heights: Vec<u16>,
    floors: Vec<u8>,
    boosts: Vec<u8>,
    densities: Vec<u8>,
    sums: Vec<u32>,
}

/// Tells a baked tile from others of the same place.
fn fingerprint(base: &TerrainTile) -> u64 {
    let heights = base.heights.samples().iter().flat_map(|h| h.to_le_bytes());
    let mut bytes: Vec<u8> = heights.collect();
    bytes.extend_from_slice(base.densities.samples());
    bytes.extend_from_slice(base.errors.texels().as_flattened());
    xxh3_64(&bytes)
}

impl EditedTile {
    /// The tile's state as bytes, up to some tens of kilobytes: what a [`TileSnapshot`](super::TileSnapshot)
    /// holds. Takes about a millisecond.
    #[must_use]
    pub fn freeze(&self) -> Arc<[u8]> {
        let TileState {
            floors,
            boosts,
            sums,
        } = self.state();
        let (base, tile) = (self.base(), self.tile());
        let pairs = tile.heights.samples().iter().zip(base.heights.samples());
        let frozen = Frozen {
            version: VERSION,
            base: fingerprint(base),
            heights: pairs
                .map(|(new, old)| {
                    // Small differences of either sign become small numbers.
                    let by = new.wrapping_sub(*old) as i16;
                    ((by << 1) ^ (by >> 15)) as u16
                })
                .collect(),
            floors: floors.to_vec(),
            boosts: boosts.to_vec(),
            densities: tile.densities.own_texels().to_vec(),
            sums: sums.as_flattened().to_vec(),
        };
        let mut packed = DeflateEncoder::new(Vec::new(), Compression::fast());
        let bytes = postcard::to_stdvec(&frozen).unwrap_or_default();
        // Writing to memory doesn't fail.
        let written = packed.write_all(&bytes);
        debug_assert!(written.is_ok());
        packed.finish().unwrap_or_default().into()
    }

    /// The tile that [`freeze`](Self::freeze) made these bytes of; `None` where they are damaged, of
    /// another version, or of a tile that was baked otherwise. Takes some hundred microseconds.
    #[must_use]
    pub fn thaw(address: TileAddress, base: TerrainTile, bytes: &[u8]) -> Option<Self> {
        let mut unpacked = Vec::new();
        let mut packed = DeflateDecoder::new(bytes).take(MOST + 1);
        packed.read_to_end(&mut unpacked).ok()?;
        let frozen: Frozen = postcard::from_bytes(&unpacked).ok()?;
        let fits = frozen.version == VERSION
            && frozen.heights.len() == SIDE * SIDE
            && frozen.densities.len() == OWN
            && frozen.base == fingerprint(&base);
        if !fits {
            return None;
        }
        let state = TileState {
            floors: frozen.floors.into_boxed_slice().try_into().ok()?,
            boosts: frozen.boosts.into_boxed_slice().try_into().ok()?,
            sums: frozen.sums.as_chunks::<OWN>().0.to_vec(),
        };
        if state.sums.as_flattened().len() != frozen.sums.len() {
            return None;
        }
        let heights = frozen.heights.iter().zip(base.heights.samples());
        let heights = heights.map(|(&by, &old)| {
            let by = (by >> 1) as i16 ^ -((by & 1) as i16);
            old.wrapping_add(by as u16)
        });
        let heights: Vec<u16> = heights.collect();
        Self::of_state(address, base, state, &heights, &frozen.densities)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::edit::{Change, Edit, EditGround, EditScratch};
    use crate::terrain::test_manifest_file;
    use crate::tile::{DensityTile, ErrorTile, HeightTile};

    fn baked(seed: usize) -> TerrainTile {
        let noise = |at: usize| 20_000 + (at * 7919 % 257 + seed) as u16;
        TerrainTile {
            heights: HeightTile::from_samples((0..SIDE * SIDE).map(noise).collect())
                .expect("133 x 133"),
            densities: DensityTile::from_samples(vec![90; 35 * 35].into()).expect("35 x 35"),
            errors: ErrorTile::from_texels(vec![[9; 8]; OWN].into()).expect("32 x 32"),
            stamp: 5,
        }
    }

    fn edit(number: i32) -> Edit {
        let change = if number % 5 == 3 {
            Change::Flatten {
                to: 20_300,
                strength: 50_000,
                hardness: 128,
                least: -400,
                most: 400,
            }
        } else {
            Change::Crater {
                depth: 300,
                rim: 80,
                bowl: 40_000,
                roughness: 60,
                seed: number as u32,
                density: 200,
                scorch: 0,
                may_clamp: number % 2 == 0,
            }
        };
        Edit {
            centre: [64 * (number * 37 % 160 - 10), 64 * (number * 53 % 150)],
            reach: 64 * (3 + number as u32 % 40),
            change,
        }
    }

    #[test]
    fn a_thawed_tile_is_the_frozen_one_and_goes_on_like_it() {
        let file = test_manifest_file([300, 300]);
        let ground = EditGround::new(&file);
        let scratch = &mut EditScratch::default();
        let address = TileAddress::new(0, 0, 0);
        let mut tile = EditedTile::new(address, baked(0));
        for number in 0..40 {
            if number % 13 == 0 {
                let bytes = tile.freeze();
                assert!(bytes.len() < 40_000, "{} bytes", bytes.len());
                let mut thawed =
                    EditedTile::thaw(address, baked(0), &bytes).expect("what was just frozen");
                assert_eq!(thawed, tile, "after {number} edits");
                let raster = ground.raster(&edit(number), scratch);
                thawed.apply(&ground, &raster, scratch);
                tile.apply(&ground, &raster, scratch);
                assert_eq!(thawed, tile);
                continue;
            }
            let raster = ground.raster(&edit(number), scratch);
            tile.apply(&ground, &raster, scratch);
        }
        assert_ne!(tile.tile(), tile.base());
    }

    #[test]
    fn bytes_that_are_damaged_or_of_another_tile_are_worth_nothing() {
        let file = test_manifest_file([300, 300]);
        let ground = EditGround::new(&file);
        let scratch = &mut EditScratch::default();
        let address = TileAddress::new(0, 0, 0);
        let mut tile = EditedTile::new(address, baked(0));
        let raster = ground.raster(&edit(1), scratch);
        tile.apply(&ground, &raster, scratch);
        let bytes = tile.freeze();
        assert!(EditedTile::thaw(address, baked(1), &bytes).is_none());
        for length in (0..bytes.len()).step_by(7) {
            assert!(EditedTile::thaw(address, baked(0), &bytes[..length]).is_none());
        }
        for at in 0..bytes.len() {
            let mut damaged = bytes.to_vec();
            damaged[at] ^= 0x55;
            // May be read as something, the file around it has a checksum; but nothing panics.
            let _ = EditedTile::thaw(address, baked(0), &damaged);
        }
        let bomb = {
            let mut packed = DeflateEncoder::new(Vec::new(), Compression::best());
            packed.write_all(&vec![0; 1 << 24]).expect("memory");
            packed.finish().expect("memory")
        };
        assert!(EditedTile::thaw(address, baked(0), &bomb).is_none());
    }
}
