//! All that is stored of one tile.

use super::{
    DensityTile, ErrorTile, HeightTile, TileAddress, TileFormatError, TileKind, format::of_terrain,
};
use crate::terrain::TerrainManifest;

/// What packed tiles start with.
pub(super) const PACK_MAGIC: [u8; 8] = *b"TSRPACK\0";

/// Whether bytes are those of a packed tile, as far as their start tells.
pub(crate) fn is_packed(bytes: &[u8]) -> bool {
    bytes.starts_with(&PACK_MAGIC)
}

/// One tile: what its file holds, and what streaming loads.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "ecs", derive(bevy::asset::Asset, bevy::reflect::TypePath))]
pub struct TerrainTile {
    /// The tile's heights with their border, 133² samples.
    pub heights: HeightTile,
    /// How finely its ground deserves to be tessellated.
    pub densities: DensityTile,
    /// How far triangles may be from its ground.
    pub errors: ErrorTile,
    /// [Stamp](crate::terrain::ManifestFile::stamp) of the terrain that the tile belongs to.
    pub stamp: u32,
}

impl TerrainTile {
    /// The bytes of the tile's file: a section each, the heights' first.
    #[must_use]
    pub fn encode(&self, address: TileAddress) -> Vec<u8> {
        super::encode_tile(
            address,
            self.stamp,
            &self.heights,
            &self.densities,
            &self.errors,
        )
    }

    /// Reads what [`encode`](Self::encode) wrote or, with the feature `archive`, what `pack` did,
    /// whose address nothing vouches for but where it was found.
    ///
    /// # Errors
    /// Where what is packed can't be unpacked, and where a section is missing, short, damaged, of another format or version, another tile's
    /// than `expected`, or of another terrain than the first; the first such section in the file's
    /// order is named.
    pub fn decode(bytes: &[u8], expected: TileAddress) -> Result<Self, TileFormatError> {
        if is_packed(bytes) {
            #[cfg(feature = "archive")]
            return Self::unpack(bytes).map_err(TileFormatError::Packed);
            #[cfg(not(feature = "archive"))]
            return Err(TileFormatError::PackedUnsupported);
        }
        let (heights, stamp) = HeightTile::decode_stamped(bytes, expected)?;
        let same = |kind, found| {
            let wanted = stamp;
            if found == wanted {
                Ok(())
            } else {
                Err(TileFormatError::MixedStamps {
                    kind,
                    found,
                    wanted,
                })
            }
        };
        let (densities, found) = DensityTile::decode_stamped(bytes, expected)?;
        same(TileKind::Density, found)?;
        let (errors, found) = ErrorTile::decode_stamped(bytes, expected)?;
        same(TileKind::Error, found)?;
        Ok(Self {
            heights,
            densities,
            errors,
            stamp,
        })
    }

    /// Checks that the tile is the terrain's at `address`, as far as the manifest tells: that it has
    /// the terrain's stamp, and that its heights lie within the range that the index has for it.
    /// Whoever culls by the index may then count on it. Looks at every height: some microseconds.
    ///
    /// # Errors
    /// Where it belongs to another terrain, where the index has no such tile, and where a height
    /// lies outside the index's range.
    pub fn check(
        &self,
        manifest: &TerrainManifest,
        address: TileAddress,
    ) -> Result<(), TileFormatError> {
        of_terrain(((), self.stamp), manifest.file.stamp())?;
        let wanted = manifest.index.get(address);
        let wanted = wanted.ok_or(TileFormatError::NotInIndex)?;
        let found = self.heights.range();
        if wanted.covers(found) {
            Ok(())
        } else {
            Err(TileFormatError::Range { found, wanted })
        }
    }

    /// The file in the terrain's folder that holds the tile.
    #[must_use]
    pub fn path(address: TileAddress) -> String {
        super::tile_path(address)
    }
}
